"""Settings that all tests share."""

from __future__ import annotations

import signal

import pytest
from hypothesis import settings

# Times of single examples say nothing on a busy machine with two workers; what must be fast has a test of its own.
settings.register_profile("dashpot", deadline=None)
settings.load_profile("dashpot")

# A shell starts what runs in the background deaf to Ctrl-C, and so would be the commands that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run the tests marked long, and only those")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests marked long (minutes of Monte Carlo, fuzzing, browsers) run with --long; without it, the others do."""
    wanted = bool(config.getoption("--long"))
    chosen = [item for item in items if (item.get_closest_marker("long") is not None) == wanted]
    config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
    items[:] = chosen
