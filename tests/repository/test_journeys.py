"""Journeys through every command give what they gave when they were recorded (benchmarks/journeys.py)."""

import json

import numpy as np
import pytest

from benchmarks import journeys

ACCEPT = "where the change is meant: python3 dev.py bench journeys --accept ID…"


@pytest.mark.slow
def test_a_sample_of_journeys_gives_what_was_recorded() -> None:
    different = journeys.compared(journeys.sample(20, quick=0.6))
    assert not different, f"{json.dumps(different, indent=1, ensure_ascii=False)}\n{ACCEPT}"


@pytest.mark.long
def test_many_journeys_give_what_was_recorded() -> None:
    different = journeys.compared(journeys.sample(120, seed=1, quick=4.0))
    assert not different, f"{json.dumps(different, indent=1, ensure_ascii=False)}\n{ACCEPT}"


def test_few_journeys_depend_on_the_processor() -> None:
    recorded = journeys.reference().values()
    assert sum(bool(result.get("by_processor")) for result in recorded) < 0.05 * len(recorded)


def _result(value: float, text: str = "k 1.23 N/m") -> journeys.Result:
    return {
        "codes": [0],
        "text": text,
        "files": {"e.json": {"k": {"value": value, "sd": 0.1}, "codes": ["a"]}},
    }


@pytest.mark.parametrize(
    ("changed", "leaf"),
    [
        (_result(5.0 + 1e-3), "value"),
        (_result(np.nan), "value"),
        (_result(5.0) | {"codes": [3]}, "codes"),
        (_result(5.0, "k 1.23 N/mm"), "transcript"),
        (_result(5.0, "k 1.26 N/m"), "transcript"),
        (_result(5.0, "k   1.23 N/m"), "transcript"),
        (_result(5.0) | {"files": {}}, "e.json"),
    ],
)
def test_what_differs_is_named(changed: journeys.Result, leaf: str) -> None:
    (line,) = journeys.differences(_result(5.0), changed, journeys.Tolerance(strict=False))
    assert leaf in line


def test_rounding_is_no_difference() -> None:
    other = _result(5.0 + 1e-6, "k 1.24 N/m")
    assert not journeys.differences(_result(5.0), other, journeys.Tolerance(strict=False))
    assert journeys.differences(_result(5.0), other, journeys.Tolerance(strict=True))


def test_every_command_has_a_journey() -> None:
    from dashpot.app.commands import COMMANDS

    ran = {
        step[0]
        for journey in journeys.listed.journeys().values()
        for step in journey.steps
        if not callable(step) and step
    }
    assert not set(COMMANDS) - ran
