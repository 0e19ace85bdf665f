"""Quantities, shares and lists of frequencies as they are written in commands and study files."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dashpot.errors import UsageError
from dashpot.quantities import amount, band, fraction, frequencies, quantity, quantity_of_unit


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("3", [3]),
        ("1,2,5", [1, 2, 5]),
        ("5, 2", [5, 2]),
        ("1:10:3", [1, 4, 7, 10]),
        ("1:10:4", [1, 5, 9]),
        ("1:10/4", [1, 4, 7, 10]),
        ("1:100/3log", [1, 10, 100]),
        ("0.5:1:0.1", [0.5, 0.6, 0.7, 0.8, 0.9, 1.0]),
        ("1,2:4:1,10", [1, 2, 3, 4, 10]),
        ("1 Hz:3 Hz:1 Hz", [1, 2, 3]),
        ("1:3:1 kHz", [1000, 2000, 3000]),
        ("1:3 kHz/3", [1000, 2000, 3000]),
        ("60:180 rpm/3", [1, 2, 3]),
    ],
)
def test_lists_and_ranges_of_frequencies(text: str, expected: list[float]) -> None:
    np.testing.assert_allclose(frequencies(text), expected, rtol=1e-12)


@given(start=st.floats(0.1, 50), step=st.floats(0.01, 3), count=st.integers(1, 200))
def test_a_step_that_divides_the_range_reaches_its_end(start: float, step: float, count: int) -> None:
    found = frequencies(f"{start!r}:{start + count * step!r}:{step!r}")
    assert len(found) == count + 1
    assert found[-1] == pytest.approx(start + count * step, rel=1e-9)


@given(start=st.floats(0.1, 50), width=st.floats(0.1, 50), count=st.integers(2, 300))
def test_a_number_of_points_is_that_number_evenly_spaced(start: float, width: float, count: int) -> None:
    stop = start + width
    np.testing.assert_allclose(
        frequencies(f"{start!r}:{stop!r}/{count}"), np.linspace(start, stop, count), rtol=1e-12
    )


@pytest.mark.parametrize(
    "text",
    ["", "x", "1:3", "5:1:1", "1:1:1", "1:2:0", "1:2:-1", "0", "-1", "nan", "inf", "1e308", "1:2:nan", "1:10/1",
     "1:10/0", "1:1e6:1e-9", "1:2/9999999", "1,,2", "1:2:3:4", "1:10/4.5", "3 kg", "1:10:1e-320"],
)  # fmt: skip
def test_what_is_no_list_of_frequencies_is_refused_with_a_cure(text: str) -> None:
    with pytest.raises(UsageError) as refused:
        frequencies(text)
    (problem,) = refused.value.problems
    assert problem.cure


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        ("5mm", "displacement", 0.005),
        ("2 mm", "displacement", 0.002),
        ("10min", "time", 600),
        ("1.5 h", "time", 5400),
        ("90", "time", 90),
        ("4.6 kN/m", "stiffness", 4600),
        ("2gn", "acceleration", 2 * 9.80665),
        ("-3", "mass", -3),
    ],
)
def test_a_quantity_is_in_si(text: str, kind: str, expected: float) -> None:
    assert quantity(text, kind) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("text", ["", "kg", "nan", "inf", "1e308", "-1e308", "1e-300", "1e400", "3 3", "5 %"])
def test_what_is_no_quantity_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        quantity(text, "mass")


def test_shares() -> None:
    assert fraction("5%") == fraction("5 %") == fraction("0.05") == 0.05
    for text in ("", "%", "nan", "inf%", "1e308", "five", "5 mm"):
        with pytest.raises(UsageError):
            fraction(text)


def test_bands() -> None:
    assert band("0.5:25") == band("0.5 : 25 Hz") == (0.5, 25.0)
    assert band("1:2 kHz") == (1000.0, 2000.0)
    for text in ("25:0.5", "1", "1:2:3", "0:5", "1:nan"):
        with pytest.raises(UsageError):
            band(text)


def test_an_amount_keeps_its_unit_until_the_quantity_is_known() -> None:
    drive = amount("2 deg")
    assert drive.si("displacement", angular=True) == pytest.approx(np.pi / 90)
    with pytest.raises(UsageError):
        drive.si("displacement")
    assert str(drive) == "2 deg"


def test_units_of_parameters_name_their_quantity() -> None:
    assert quantity_of_unit("kg") == ("mass", False)
    assert quantity_of_unit("N·m·s/rad") == ("damping", True)
    assert quantity_of_unit("1") is None
