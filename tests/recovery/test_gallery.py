"""The twelve journeys of the gallery: from a raw file to the true values, by at most two commands, in seconds."""

import importlib.util
import re
import sys
from types import ModuleType

import pytest

from tests.documents import ROOT

FOLDER = ROOT / "examples" / "14_journeys"
README = (FOLDER / "README.md").read_text(encoding="utf-8")
NAMES = re.findall(r"^## (.+)$", README, re.MULTILINE)


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    found = importlib.util.spec_from_file_location("journeys", FOLDER / "journeys.py")
    assert found
    assert found.loader
    module = sys.modules["journeys"] = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


@pytest.mark.long
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("name", NAMES)
def test_a_journey_comes_to_the_true_values_in_time(gallery: ModuleType, name: str) -> None:
    result = gallery.go(next(journey for journey in gallery.JOURNEYS if journey.name == name))
    assert result.seconds < 20
    assert result.p > 0.001
    assert result.over_bound < 1.2


def test_every_journey_has_its_row_and_at_most_two_commands() -> None:
    assert re.findall(r"^\| \[(.+?)\]\(", README, re.MULTILINE) == NAMES
    assert len(NAMES) == 12
    for block in re.findall(r"^## .+?^```\w+\n(.*?)^```", README, re.MULTILINE | re.DOTALL):
        assert len(block.splitlines()) <= 2
