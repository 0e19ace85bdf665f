"""BLAS on one thread as long as anyone computes, and on as many as before afterwards."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest
import scipy.linalg  # brings the second BLAS

import dashpot
from dashpot.numerics.blas_threads import THREADS, one_blas_thread, pools
from tests.rigs import channels, paper_rig, perfect


@pytest.fixture
def two_threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Every BLAS on two threads, and an environment that asks for nothing."""
    assert scipy.linalg.norm([3.0, 4.0]) == 5.0
    if not pools():
        pytest.skip("this NumPy has another BLAS than OpenBLAS")
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    before = [(put, get()) for get, put in pools()]
    for put, _ in before:
        put(2)
    yield
    for put, count in before:
        put(count)


def counts() -> set[int]:
    return {get() for get, _ in pools()}


@pytest.mark.usefixtures("two_threads")
def test_one_thread_inside_and_as_many_as_before_outside() -> None:
    with one_blas_thread():
        with one_blas_thread():
            assert counts() == {1}
        assert counts() == {1}
    assert counts() == {2}
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        raise ZeroDivisionError
    assert counts() == {2}


@pytest.mark.usefixtures("two_threads")
def test_calls_that_overlap_leave_as_many_threads_as_before() -> None:
    entered, first_left = Barrier(2), Barrier(2)

    def first() -> None:
        with one_blas_thread():
            entered.wait(10)
        first_left.wait(10)

    def second() -> set[int]:
        with one_blas_thread():
            entered.wait(10)
            first_left.wait(10)
            return counts()

    with ThreadPoolExecutor(2) as executor:
        one, other = executor.submit(first), executor.submit(second)
        assert (one.result(), other.result()) == (None, {1})
    assert counts() == {2}


def test_what_the_environment_says_stands(two_threads: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with one_blas_thread():
        assert counts() == {2}


@pytest.mark.usefixtures("two_threads")
def test_an_identification_computes_on_one_thread() -> None:
    rig, seen = paper_rig(), channels(paper_rig())
    met: list[set[int]] = []
    dashpot.identify(rig.model, perfect(rig, seen), "oiv", progress=lambda *_: met.append(counts()))
    assert met == [{1}]
    assert counts() == {2}
