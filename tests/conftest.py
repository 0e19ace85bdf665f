"""Settings that all tests share."""

from __future__ import annotations

import pytest
from hypothesis import settings

# Times of single examples say nothing on a busy machine with two workers; what must be fast has a test of its own.
settings.register_profile("dashpot", deadline=None)
settings.load_profile("dashpot")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run the tests marked long, and only those")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests marked long (minutes of Monte Carlo, fuzzing, browsers) run with --long; without it, the others do."""
    wanted = bool(config.getoption("--long"))
    chosen = [item for item in items if (item.get_closest_marker("long") is not None) == wanted]
    config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
    items[:] = chosen
