"""Signals that come at an awkward moment."""

from __future__ import annotations

import signal

import pytest

from dashpot.app import signals


@pytest.mark.parametrize("meanwhile", [KeyboardInterrupt(), signals.Ended(signal.SIGTERM)])
def test_a_signal_that_comes_while_another_one_is_put_off_is_lost_without_a_word(monkeypatch, meanwhile):
    begun = []

    class Timer:
        """A thread in whose beginning one more signal comes."""

        def __init__(self, *_):
            self.ident = None

        def start(self):
            begun.append(self)
            if len(begun) == 1:
                raise meanwhile
            self.ident = 1

    monkeypatch.setattr(signals, "Timer", Timer)
    signals._come_again(signal.SIGINT)
    assert len(begun) == 2


def test_where_no_thread_can_be_begun_it_is_not_tried_for_ever(monkeypatch):
    tried = []

    class Timer:
        """A thread that cannot be begun."""

        ident = None

        def __init__(self, *_):
            pass

        def start(self):
            tried.append(self)
            raise RuntimeError

    monkeypatch.setattr(signals, "Timer", Timer)
    signals._come_again(signal.SIGINT)
    assert len(tried) == 1
