"""Processes that share out work, and what is left of them."""

import os
import signal
import struct
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import active_children
from pathlib import Path
from types import FrameType

import pytest

from dashpot.app.workers import mapping

pytestmark = pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")


@contextmanager
def nothing_left() -> Iterator[None]:
    """Neither processes of a pool nor the thread that looks after them.

    One that lives on until the interpreter ends may then write into a pipe that is closed, or never end.
    """
    threads, hook = set(threading.enumerate()), threading.excepthook
    try:
        yield
    finally:
        threading.excepthook = hook
    assert not [left for left in set(threading.enumerate()) - threads if "Executor" in type(left).__name__]
    assert not active_children()


@pytest.mark.parametrize("stopped", [False, True])
def test_nothing_of_the_processes_is_left(stopped: bool) -> None:
    with nothing_left():
        try:
            with mapping(2) as share_out:
                results = share_out(abs, range(-9, 0))
                assert next(iter(results)) in range(1, 10)
                if stopped:
                    raise KeyboardInterrupt
                assert len(list(results)) == 8
        except KeyboardInterrupt:
            assert stopped


def _half_told(path: Path) -> None:
    """Tell the parent of a result that is long, and nothing of it."""
    frame: FrameType | None = sys._getframe()
    while frame is not None and "result_queue" not in frame.f_locals:
        frame = frame.f_back
    os.write(frame.f_locals["result_queue"]._writer.fileno(), struct.pack("!i", 1000))
    path.touch()
    time.sleep(600)


def _interrupted_when(path: Path) -> None:
    while not path.exists():
        time.sleep(0.01)
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def _shared_out(told: Path) -> None:
    with mapping(2) as share_out:
        threading.Thread(target=_interrupted_when, args=(told,)).start()
        list(share_out(_half_told, [told]))


def test_a_result_that_is_cut_off_is_not_waited_for(tmp_path: Path) -> None:
    with nothing_left(), pytest.raises(KeyboardInterrupt):
        _shared_out(tmp_path / "told")


def _ended_once(path: Path) -> str:
    """A worker that is killed at its first task."""
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


@pytest.mark.slow
def test_what_killed_processes_were_at_is_computed_again(tmp_path: Path) -> None:
    tasks = [tmp_path / f"{k}" for k in range(7)]
    for task in tasks[1:]:
        task.touch()
    with nothing_left(), mapping(2) as share_out:
        assert sorted(share_out(_ended_once, tasks)) == [task.name for task in tasks]
