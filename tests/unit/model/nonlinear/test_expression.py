"""Expressions of laws: values, slopes, units, and what is refused."""

import numpy as np
import pytest

from dashpot.errors import ModelError
from dashpot.model.nonlinear.expression import dimensions, parse
from dashpot.model.nonlinear.force_law import force_law

KNOWN = {"d": (1.0, 0.0), "v": (1.0, -1.0)}


@pytest.mark.parametrize(
    ("text", "python"),
    [
        ("-d**2", lambda d, v, a: -(d**2)),
        ("2**-d", lambda d, v, a: 2**-d),
        ("d - v - a", lambda d, v, a: d - v - a),
        ("d/v/a", lambda d, v, a: d / v / a),
        ("2**3**d", lambda d, v, a: 2 ** (3**d)),
        ("(d + v)*a - +d", lambda d, v, a: (d + v) * a - d),
        (
            "tanh(v/a) + exp(-d) * sqrt(a) + log(a)",
            lambda d, v, a: np.tanh(v / a) + np.exp(-d) * np.sqrt(a) + np.log(a),
        ),
        (
            "max(d, a) - min(v, 0.1) + abs(v)*sign(d)",
            lambda d, v, a: np.maximum(d, a) - np.minimum(v, 0.1) + abs(v) * np.sign(d),
        ),
        (
            "where(d > a, d*v, a*v) + sin(d)*cos(v)",
            lambda d, v, a: np.where(d > a, d * v, a * v) + np.sin(d) * np.cos(v),
        ),
        ("where(d <= a, 1, 2)*d + abs(v)**a", lambda d, v, a: np.where(d <= a, 1, 2) * d + abs(v) ** a),
    ],
)  # fmt: skip
def test_values_are_pythons_and_slopes_are_differences(text, python):
    rng = np.random.default_rng(1)
    d, v, a = rng.uniform(-2, 2, 200), rng.uniform(-2, 2, 200), rng.uniform(0.3, 2, 200)
    at = parse(text)({"d": d, "v": v, "a": a})
    assert np.allclose(at.value, python(d, v, a), rtol=1e-13, atol=1e-13)
    step = 1e-6
    for name, move in (("d", (step, 0, 0)), ("v", (0, step, 0)), ("a", (0, 0, step))):
        up = python(d + move[0], v + move[1], a + move[2])
        down = python(d - move[0], v - move[1], a - move[2])
        slope = np.broadcast_to(at.slopes.get(name, 0.0), d.shape)
        assert np.allclose(slope, (up - down) / (2 * step), rtol=2e-6, atol=2e-6), name


@pytest.mark.parametrize(
    "text",
    ["", "d +", "d**", "(d", "d)", "foo(d)", "max(d)", "d/0", "__import__('os')", "d; v", "where(d, 1, 2)", "d if v",
     "1" * 600, "(" * 60 + "d" + ")" * 60, "-" * 90 + "d", "d**1e-320"],
)  # fmt: skip
def test_what_is_no_expression_is_refused(text):
    with pytest.raises(ModelError):
        parse(text)


@pytest.mark.parametrize(
    ("text", "unit", "constants"),
    [
        ("d**3", (3, 0), {}),
        ("v*abs(v)", (2, -2), {}),
        ("tanh(v/v0)", (0, 0), {"v0": (1, -1)}),
        ("tanh(v/0.002)", (0, 0), {}),
        ("d*(1 + (d/d0)**2)", (1, 0), {"d0": (1, 0)}),
        ("d*(1 + d)", (2, 0), {}),
        ("d**2 + b*d**3", (2, 0), {"b": (-1, 0)}),
        ("max(d - gap, 0) + min(d + gap, 0)", (1, 0), {"gap": (1, 0)}),
        ("sqrt(abs(d))*d", (1.5, 0), {}),
        ("d*abs(d)**nu", (2, 0), {"nu": (0, 0)}),
    ],
)
def test_units_follow_from_the_expression(text, unit, constants):
    own, names = dimensions(parse(text), KNOWN)
    assert own == unit
    assert names == constants


def test_slopes_of_what_is_not_chosen_do_not_count() -> None:
    at = parse("where(d > 0, d**1.5, 2*d) + max(sqrt(d), v)")(
        {"d": np.array([4.0, -1.0]), "v": np.array([1.0, 3.0])}
    )
    assert at.value[0] == 10.0
    assert np.array_equal(at.slopes["d"][:1], [3.25])
    assert parse("where(d > 0, d**1.5, 2*d)")({"d": np.array([-1.0])}).slopes["d"] == 2.0


@pytest.mark.parametrize("text", ["d + v", "tanh(d)", "exp(v)", "max(d, v)", "where(d > v, d, d)"])
def test_units_that_make_no_sense_are_refused(text):
    with pytest.raises(ModelError, match="units"):
        dimensions(parse(text), KNOWN)


def test_a_misspelt_law_is_named():
    with pytest.raises(ModelError, match="cubic"):
        force_law("cubci")


@pytest.mark.parametrize(("text", "crosses"), [("d/(d - a)", True), ("d/(a + d*d)", False), ("d**3", False)])
def test_a_division_by_zero_within_a_motion_is_seen(text, crosses):
    d = np.linspace(-1, 1, 50)
    assert parse(text).crosses_pole({"d": d, "v": d, "a": np.full(1, 0.5)}) == crosses
