"""Units: what laboratories write, and factors that are known from elsewhere."""

import math

import pytest

from dashpot.errors import UsageError
from dashpot.units import QUANTITIES, scale, sensitivity, si_unit

INCH, POUND, GRAVITY = 0.0254, 0.45359237, 9.80665  # exact by definition

KNOWN = [
    ("m", "displacement", False, 1.0),
    ("mm", "displacement", False, 1e-3),
    ("millimetres", "displacement", False, 1e-3),
    ("µm", "displacement", False, 1e-6),
    ("μm", "displacement", False, 1e-6),
    ("um", "displacement", False, 1e-6),
    ("in", "displacement", False, INCH),
    ("mil", "displacement", False, INCH / 1000),
    ("mm/s", "velocity", False, 1e-3),
    ("mm s^-1", "velocity", False, 1e-3),
    ("ips", "velocity", False, INCH),
    ("m/s^2", "acceleration", False, 1.0),
    ("m/s2", "acceleration", False, 1.0),
    ("m/s²", "acceleration", False, 1.0),
    ("m s-2", "acceleration", False, 1.0),
    ("m·s⁻²", "acceleration", False, 1.0),
    ("m/s/s", "acceleration", False, 1.0),
    ("m/sec**2", "acceleration", False, 1.0),
    ("m s^(-2)", "acceleration", False, 1.0),
    ("g", "acceleration", False, GRAVITY),
    ("gn", "acceleration", False, GRAVITY),
    ("g0", "acceleration", False, GRAVITY),
    ("G", "acceleration", False, GRAVITY),
    ("mg", "acceleration", False, GRAVITY / 1000),
    ("Gal", "acceleration", False, 0.01),
    ("N", "force", False, 1.0),
    ("kN", "force", False, 1e3),
    ("lbf", "force", False, POUND * GRAVITY),
    ("lb", "force", False, POUND * GRAVITY),
    ("kgf", "force", False, GRAVITY),
    ("kg", "mass", False, 1.0),
    ("g", "mass", False, 1e-3),
    ("t", "mass", False, 1e3),
    ("lb", "mass", False, POUND),
    ("lbf*s^2/in", "mass", False, POUND * GRAVITY / INCH),
    ("N s²/m", "mass", False, 1.0),
    ("N·s/m", "damping", False, 1.0),
    ("N*s/m", "damping", False, 1.0),
    ("Ns/m", "damping", False, 1.0),
    ("N-s/m", "damping", False, 1.0),
    ("N/(m/s)", "damping", False, 1.0),
    ("kg/s", "damping", False, 1.0),
    ("lbf s/in", "damping", False, POUND * GRAVITY / INCH),
    ("N/m", "stiffness", False, 1.0),
    ("N/mm", "stiffness", False, 1e3),
    ("lbf/in", "stiffness", False, POUND * GRAVITY / INCH),
    ("lb/in", "stiffness", False, POUND * GRAVITY / INCH),
    ("rad", "displacement", True, 1.0),
    ("deg", "displacement", True, math.pi / 180),
    ("°", "displacement", True, math.pi / 180),
    ("rad/s", "velocity", True, 1.0),
    ("deg/s", "velocity", True, math.pi / 180),
    ("rpm", "velocity", True, 2 * math.pi / 60),
    ("rad/s²", "acceleration", True, 1.0),
    ("N·m", "force", True, 1.0),
    ("Nm", "force", True, 1.0),
    ("ft-lb", "force", True, 12 * INCH * POUND * GRAVITY),
    ("kg m^2", "mass", True, 1.0),
    ("kg·cm²", "mass", True, 1e-4),
    ("N·m·s/rad", "damping", True, 1.0),
    ("N·m·s", "damping", True, 1.0),
    ("N·m/rad", "stiffness", True, 1.0),
    ("N·m/deg", "stiffness", True, 180 / math.pi),
    ("Hz", "frequency", False, 1.0),
    ("kHz", "frequency", False, 1e3),
    ("1/s", "frequency", False, 1.0),
    ("rad/s", "frequency", False, 1 / (2 * math.pi)),
    ("rpm", "frequency", False, 1 / 60),
    ("s", "time", False, 1.0),
    ("ms", "time", False, 1e-3),
    ("min", "time", False, 60.0),
]


@pytest.mark.parametrize(("unit", "quantity", "angular", "factor"), KNOWN)
def test_factors(unit: str, quantity: str, angular: bool, factor: float) -> None:
    assert scale(unit, quantity, angular) == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("angular", [False, True])
def test_the_si_unit_of_each_quantity_has_the_factor_1(quantity: str, angular: bool) -> None:
    assert scale(si_unit(quantity, angular), quantity, angular) == pytest.approx(1.0, rel=1e-15)


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("angular", [False, True])
def test_every_unit_that_a_message_offers_is_accepted(quantity: str, angular: bool) -> None:
    with pytest.raises(UsageError) as caught:
        scale("furlong", quantity, angular)
    offered = str(caught.value).split("use ")[1].split(", ")
    assert len(offered) >= 2
    for unit in offered:
        assert scale(unit, quantity, angular) > 0


@pytest.mark.parametrize(
    ("unit", "quantity", "angular"),
    [
        ("mm", "acceleration", False),
        ("kg", "acceleration", False),
        ("m", "displacement", True),
        ("rad", "displacement", False),
        ("Hz", "velocity", True),
        ("1/s", "velocity", True),
        ("N", "stiffness", False),
        ("N/m", "stiffness", True),
        ("mV/g", "acceleration", False),
        ("V", "acceleration", False),
        ("1", "displacement", False),
    ],
)
def test_units_of_something_else(unit: str, quantity: str, angular: bool) -> None:
    with pytest.raises(UsageError, match=r"is not a unit.*; .*use "):
        scale(unit, quantity, angular)


def test_the_message_names_the_quantity_and_what_is_accepted() -> None:
    with pytest.raises(UsageError) as caught:
        scale("mm", "acceleration")
    assert str(caught.value).startswith('"mm" is not a unit of acceleration; use m/s², mm/s², g, gn')


def test_a_wrong_case_is_recognised() -> None:
    with pytest.raises(UsageError, match='did you mean "mm"'):
        scale("MM", "displacement")


@pytest.mark.parametrize(
    "unit",
    [
        "",
        " ",
        "m^",
        "(m",
        "m)",
        "N//m",
        "/m",
        "m/",
        "*",
        "^2",
        "m^^2",
        "()",
        "2 m",
        "m\n;",
        "\x00",
        "µ",
        "((((((((((m))))))))))",
        "kN^99*kN^99",
        "m^-99/km^99",
        "m²³⁴",
        "٣m",
        "m^٣",
    ],
)
def test_what_is_no_unit_is_one_clear_line(unit: str) -> None:
    with pytest.raises(UsageError) as caught:
        scale(unit, "displacement")
    assert "\n" not in str(caught.value)


def test_an_unknown_quantity() -> None:
    with pytest.raises(UsageError, match="not a quantity"):
        scale("m", "speed")


def test_voltages_and_counts_only_where_the_channel_is_not_calibrated() -> None:
    assert scale("V", "acceleration", uncalibrated=True) == 1.0
    assert scale("mV", "force", uncalibrated=True) == pytest.approx(1e-3)
    assert scale("count", "displacement", uncalibrated=True) == 1.0
    assert scale("g", "acceleration", uncalibrated=True) == GRAVITY
    with pytest.raises(UsageError, match="gain"):
        scale("mV", "acceleration")


def test_sensitivities() -> None:
    assert sensitivity("100 mV/g", "V", "acceleration") == pytest.approx(0.1 / GRAVITY)
    assert sensitivity("10.2 mV/(m/s²)", "mV", "acceleration") == pytest.approx(0.0102)
    assert sensitivity("-22.5mV/N", "V", "force") == pytest.approx(-0.0225)
    assert sensitivity("3200 counts/g", "count", "acceleration") == pytest.approx(3200 / GRAVITY)
    assert sensitivity("2 V/rad", "V", "displacement", True) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("100 mV/N", "V"),
        ("100 counts/g", "V"),
        ("mV/g", "V"),
        ("100", "V"),
        ("100 mV/g", "m/s²"),
        ("0 V/g", "V"),
        ("1 V/grr", "V"),
    ],
)
def test_what_is_no_sensitivity(text: str, unit: str) -> None:
    with pytest.raises(UsageError):
        sensitivity(text, unit, "acceleration")
