"""Processes that share out work, and what is left of them."""

from __future__ import annotations

import threading
from multiprocessing import active_children

import pytest

from dashpot.app.workers import mapping

pytestmark = pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")


@pytest.mark.parametrize("stopped", [False, True])
def test_nothing_of_the_processes_is_left(stopped: bool) -> None:
    # A thread of the pool that lives on until the interpreter ends may then write into a pipe that is closed.
    threads, hook = set(threading.enumerate()), threading.excepthook
    try:
        with mapping(2) as share_out:
            results = share_out(abs, range(-9, 0))
            assert next(iter(results)) in range(1, 10)
            if stopped:
                raise KeyboardInterrupt
            assert len(list(results)) == 8
    except KeyboardInterrupt:
        assert stopped
    finally:
        threading.excepthook = hook
    assert not [left for left in set(threading.enumerate()) - threads if "Executor" in type(left).__name__]
    assert not active_children()
