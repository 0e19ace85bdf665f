"""Settings that all tests share."""

import gc
import signal

import pytest
from hypothesis import settings

# Times of single examples say nothing on a busy machine with two workers; what must be fast has a test of its own.
settings.register_profile("dashpot", deadline=None)
settings.load_profile("dashpot")

# A shell starts background jobs with Ctrl-C ignored, nohup with SIGHUP ignored. Commands that the tests start and
# interrupt would inherit that; handlers are not inherited. This process itself goes on ignoring a closed terminal.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run the tests marked long or slow, and only those")
    parser.addoption("--slow", action="store_true", help="run those marked slow as well")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests marked long (minutes of Monte Carlo, fuzzing, browsers) run with --long, slow ones (seconds) with it too.

    Without it all others run; with --slow the slow ones among them.
    """
    long = bool(config.getoption("--long"))
    apart = {"long"} if config.getoption("--slow") and not long else {"long", "slow"}
    others = [item for item in items if any(mark.name in apart for mark in item.iter_markers()) != long]
    config.hook.pytest_deselected(items=others)
    left_out = set(others)
    items[:] = [item for item in items if item not in left_out]


def pytest_collection_finish() -> None:
    """What collecting made stays to the end: the collector of garbage need not look through it again and again."""
    gc.collect()
    gc.freeze()
