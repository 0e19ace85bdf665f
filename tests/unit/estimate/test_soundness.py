"""Estimates read from files: whatever a hand or a fault has changed is one clear line, never a number."""

import json
from collections.abc import Callable
from typing import Any

import pytest

from dashpot.errors import DataError
from dashpot.estimate.result import Estimate
from tests.fuzz import corpus


def _content() -> dict[str, Any]:
    content = json.loads(corpus.files()["estimate.json"])
    assert isinstance(content, dict)
    return content


def _put(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        inner: Any = content
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value

    return change


def _drop(*path: Any) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        inner: Any = content
        for key in path[:-1]:
            inner = inner[key]
        del inner[path[-1]]

    return change


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_put("covariance", 0, 0, value=-1e-4), "the variance of m1"),
        (_put("covariance", 0, 1, value=1.0), "covariance: not symmetric"),
        (_put("parameters", "m1", "value", value=None), "m1: no value"),
        (_put("parameters", "m1", "value", value=10**400), "not a dashpot estimate"),
        (_put("covariance", 0, 0, value=10**400), "not a dashpot estimate"),
        (_drop("covariance", 0), "covariance"),
        (_drop("covariance", 0, 0), "not a dashpot estimate"),
        (_drop("covariance"), "'covariance' is missing"),
        (_put("covariance", value=[]), "covariance"),
        (_put("order", value=["m1", "m1", "c1", "c2"]), "m1 is named twice"),
        (_put("order", 0, value=3), "not a dashpot estimate"),
        (_put("parameters", "m1", "bound_sd", value=-1.0), "m1: bound_sd is negative"),
        (_put("parameters", "m1", "min", value=5.0), None),
        (_put("parameters", value=[]), "not a dashpot estimate"),
        (_put("rig", value={}), "a name, a unit"),
        (_put("intervals_count", value=None), "a name, a unit"),
        (_put("parameters", "m1", "value", value=1e308), "m1: 1e\\+308"),
        (_put("tied", value=[["k9", "k8", 2.0, "N/m"]]), "tied: k8"),
        (_put("stated", value=[["k8", 2.0, 0.1]]), "stated: k8"),
        (_put("stated", value=[["k1", 2.0, 0.0]]), "stated: k1"),
    ],
)
def test_changed_estimates_are_refused(change: Callable[[dict[str, Any]], None], told: str | None) -> None:
    content = _content()
    change(content)
    if told is None:
        Estimate.from_json(json.dumps(content), "e.json")
        return
    with pytest.raises(DataError, match=told) as error:
        Estimate.from_json(json.dumps(content), "e.json")
    assert all(str(problem).startswith("e.json: ") for problem in error.value.problems)


def test_a_sound_estimate_is_read_as_it_was_written() -> None:
    text = corpus.files()["estimate.json"].decode()
    assert Estimate.from_json(text).to_json() == text
