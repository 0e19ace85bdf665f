"""Results as pandas DataFrames: a row for each mode, line, window or unknown, SI units."""

import numpy as np
import pytest

import dashpot
from dashpot.estimate.comparison import Comparison
from dashpot.fleet.tracking import Track
from dashpot.free.modes import MeasuredModes, Stabilisation
from dashpot.free.response import MeasuredResponse

pytest.importorskip("pandas")
A, B, U = (dashpot.Channel(name, {name: 1}) for name in ("a", "b", "u"))


def test_responses() -> None:
    H = np.arange(6).reshape(3, 2, 1) * (1 + 1j)
    found = MeasuredResponse(
        (U,), (A, B), np.arange(1.0, 4.0), H, np.tile(2 * np.eye(2) + 0j, (3, 1, 1)), np.ones((3, 2)),
        np.ones(3, dtype=np.int64), "local",
    ).to_dataframe()  # fmt: skip
    assert (found.index.name, list(found.columns[:2])) == ("frequency_hz", ["a/u", "a/u_sd"])
    assert found.loc[2.0, "b/u"] == 3 + 3j
    assert found["a/u_sd"].tolist() == [1.0, 1.0, 1.0]


def test_modes() -> None:
    nothing = np.zeros((1, 0))
    found = MeasuredModes(
        (), (A, B), np.array([-1 + 20j]), np.eye(2)[None], np.array([[1, 0.5 + 0j]]), np.array([[0.0, 0.1]]),
        nothing.astype(complex), nothing, np.zeros(1), np.zeros((1, 2), complex), np.zeros((1, 2), complex),
        np.nan, np.nan, 2, Stabilisation(np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0, bool)),
    ).to_dataframe()  # fmt: skip
    assert found.loc[1, "frequency_hz"] == pytest.approx(abs(-1 + 20j) / 2 / np.pi)
    assert (found.loc[1, "b"], found.loc[1, "b_sd"]) == (0.5, 0.1)


def test_tracks() -> None:
    one = np.ones((2, 1))
    found = Track(
        "rig", ("k",), ("N/m",), np.arange(2.0), np.arange(1.0, 3.0), 5 * one, one, 6 * one, one, np.ones(1),
        np.ones((1, 2)), 1.0, (), 0.01,
    ).to_dataframe()  # fmt: skip
    assert found.index.tolist() == [0.0, 1.0]
    assert found["k"].tolist() == [5.0, 5.0]


def test_comparisons() -> None:
    found = Comparison("rig", ("k", "c"), ("N/m", "N·s/m"), {}, {}).to_dataframe()
    assert found.loc["c", "unit"] == "N·s/m"
