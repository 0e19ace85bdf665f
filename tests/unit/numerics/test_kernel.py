"""The choice between the compiled kernel and NumPy."""

from collections.abc import Iterator

import pytest

from dashpot.errors import UsageError
from dashpot.numerics import kernel as choice


@pytest.fixture(autouse=True)
def environment_read_again() -> Iterator[None]:
    choice.environment.cache_clear()
    yield
    choice.environment.cache_clear()


def test_numpy_is_what_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(choice.VARIABLE, "numpy")
    assert choice.kernel() is None
    assert choice.description() == "numpy"


def test_a_choice_that_is_none_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(choice.VARIABLE, "fortran")
    with pytest.raises(UsageError, match="fortran"):
        choice.kernel()
    with pytest.raises(UsageError, match="fortran"), choice.using("fortran"):
        pass


def test_without_the_package_auto_is_numpy_and_compiled_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(choice.VARIABLE, raising=False)
    monkeypatch.setattr(choice, "_compiled", lambda: None)
    assert choice.kernel() is None
    with choice.using("compiled"), pytest.raises(UsageError, match="not installed"):
        choice.kernel()


def test_a_choice_lasts_as_long_as_its_context(monkeypatch: pytest.MonkeyPatch) -> None:
    module = object()
    monkeypatch.setenv(choice.VARIABLE, "compiled")
    monkeypatch.setattr(choice, "_compiled", lambda: module)
    with choice.using("numpy"):
        assert choice.kernel() is None
    assert choice.kernel() is module


@pytest.mark.parametrize(("given", "count"), [("3", 3), ("0", 1), ("", 1), ("1024", 1024)])
def test_threads_are_a_number(monkeypatch: pytest.MonkeyPatch, given: str, count: int) -> None:
    monkeypatch.setenv(choice.THREADS, given)
    assert choice.threads() == count


@pytest.mark.parametrize("given", ["many", "²", "٣", "-1", "1025", "9" * 23, "9" * 5000])
def test_threads_that_are_no_number_are_one_line(monkeypatch: pytest.MonkeyPatch, given: str) -> None:
    monkeypatch.setenv(choice.THREADS, given)
    with pytest.raises(UsageError, match=choice.THREADS):
        choice.threads()
