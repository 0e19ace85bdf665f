"""Signals that come at an awkward moment."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from dashpot.app import signals

SWALLOWED_AGAIN_AND_AGAIN = """
import os, signal, sys, time
from dashpot.app import cli

def swallowing():
    for name in sys.argv[1:]:
        try:
            os.kill(os.getpid(), getattr(signal, name))
            time.sleep(20)
        except BaseException:
            pass

def work(*args, **options):
    for _ in range(30):
        swallowing()
    time.sleep(20)

cli.cli.main = work
cli.main()
"""


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no alarm wakes the process")
@pytest.mark.parametrize("names", [["SIGINT"], ["SIGTERM", "SIGINT"], ["SIGINT", "SIGHUP", "SIGTERM"]])
def test_requests_that_are_swallowed_again_and_again_come_again_without_a_word(names: list[str]) -> None:
    """A thread that is begun for it, and cut off by the next signal, had left a traceback."""
    done = subprocess.run(
        [sys.executable, "-c", SWALLOWED_AGAIN_AND_AGAIN, *names], capture_output=True, text=True, timeout=15
    )
    assert done.returncode in {128 + getattr(signal, name) for name in names}
    assert done.stderr.startswith("dashpot: ")
    assert len(done.stderr.splitlines()) == 1


def test_where_there_is_no_alarm_a_thread_brings_it_again(monkeypatch: pytest.MonkeyPatch) -> None:
    begun = []

    class Timer:
        """A thread that cannot be begun."""

        def __init__(self, *given: object) -> None:
            begun.append(given)

        def start(self) -> None:
            raise RuntimeError

    monkeypatch.setattr(signals, "Timer", Timer)
    signals._come_again()
    assert begun == [(signals.PAUSE, signals._again)]


def test_what_has_been_answered_does_not_come_again(monkeypatch: pytest.MonkeyPatch) -> None:
    raised: list[int] = []
    monkeypatch.setattr(signal, "raise_signal", raised.append)
    monkeypatch.setattr(signals, "_latest", None)
    signals._again()
    assert raised == []
    monkeypatch.setattr(signals, "_asked", {signal.SIGINT})
    signals._again()
    assert raised == [signal.SIGINT]
