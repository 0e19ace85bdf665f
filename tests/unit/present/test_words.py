"""Digits as the uncertainty allows."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dashpot.present.words import aligned, alike, percent, probability, short, value_and_sd


@pytest.mark.parametrize(
    ("value", "sd", "texts"),
    [
        (2.99958, 0.00070, ("2.99958", "0.00070")),
        (4599.04, 1.84, ("4599.0", "1.8")),
        (463210.0, 12345.0, ("463000", "12000")),
        (0.3, 12.0, ("0", "12")),
        (-0.04, 12.0, ("0", "12")),
        (9.96, 0.0996, ("9.96", "0.10")),
        (-8.14, 0.11, ("-8.14", "0.11")),
        (1.23456e8, 2.1e5, ("1.2346e8", "0.0021e8")),
        (1.5e-9, 2e-11, ("1.500e-9", "0.020e-9")),
        (4.5405191, 3.8e-6, ("4.5405191", "0.0000038")),
        (2.7, 0.0, ("2.7", "0")),
        (8.7172752469882102, 8.3e-21, ("8.71728", "0")),
        (2e-9, 0.0, ("2e-9", "0")),
        (2e7, 0.0, ("2e7", "0")),
        (2.7, math.nan, ("2.7", "–")),
        (2.7, math.inf, ("2.7", "–")),
        (math.nan, 1.0, ("–", "1.0")),
    ],
)
def test_rounded(value: float, sd: float, texts: tuple[str, str]) -> None:
    assert value_and_sd(value, sd) == texts


@given(st.floats(-1e12, 1e12), st.floats(1e-12, 1e12))
def test_rounding_loses_less_than_a_twentieth_of_the_sd(value: float, sd: float) -> None:
    assume(sd > 1e-14 * abs(value))  # else it is rounding
    text, spread = value_and_sd(value, sd)
    # Two digits of the sd: half a unit of the last is at most a twentieth of it.
    assert abs(float(text) - value) <= 0.0501 * sd + 1e-15 * abs(value)
    assert abs(float(spread) - sd) <= 0.0501 * sd


def test_ends_of_an_interval_share_their_digits() -> None:
    assert alike((4595.41, 4602.7), 1.84) == ["4595.4", "4602.7"]
    assert alike((-math.inf, 4602.7), 1.84) == ["–", "4602.7"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.00999996, "0.0100"), (0.0, "0"), (1234.5, "1230"), (1.5, "1.50"), (3e-9, "3.00e-9"), (2e12, "2.00e12"),
     (math.nan, "–"), (-0.5, "-0.500")],
)  # fmt: skip
def test_short(value: float, text: str) -> None:
    assert short(value) == text


def test_shares_and_probabilities() -> None:
    assert [percent(0.02, 3.0), percent(1.0, 0.0), percent(5e3, 1.0), percent(1, -8)] == [
        "0.67",
        "–",
        ">999",
        "12",
    ]
    assert [probability(0.31), probability(1e-9), probability(math.nan)] == ["0.31", "< 1e-6", "–"]


def test_points_below_each_other() -> None:
    assert aligned(["1.5", "20", "3.25"]) == ["1.5 ", "20   ", "3.25"]
    assert aligned([]) == []
