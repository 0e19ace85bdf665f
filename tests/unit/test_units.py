"""Units: what laboratories write, and factors that are known from elsewhere."""

import math

import pytest

from dashpot.errors import UsageError
from dashpot.units import QUANTITIES, scale, sensitivity, si_unit

INCH, POUND, GRAVITY = 0.0254, 0.45359237, 9.80665  # exact by definition

# By quantity, and whether of angles: what a unit is in SI units.
FACTORS = {
    ("displacement", False): {
        "m": 1.0,
        "mm | millimetres": 1e-3,
        "µm | μm | um": 1e-6,
        "in": INCH,
        "mil": INCH / 1000,
    },
    ("velocity", False): {"mm/s | mm s^-1 | mmps": 1e-3, "mps": 1.0, "ips": INCH},
    ("acceleration", False): {
        "m/s^2 | m/s2 | mps2 | m/s² | m s-2 | m·s⁻² | m/s/s | m/sec**2 | m s^(-2)": 1.0,
        "g | gn | g0 | G": GRAVITY,
        "mg": GRAVITY / 1000,
        "Gal": 0.01,
    },
    ("force", False): {"N": 1.0, "kN": 1e3, "lbf | lb": POUND * GRAVITY, "kgf": GRAVITY},
    ("mass", False): {
        "kg | N s²/m": 1.0,
        "g": 1e-3,
        "t": 1e3,
        "lb": POUND,
        "lbf*s^2/in": POUND * GRAVITY / INCH,
    },
    ("damping", False): {
        "N·s/m | N*s/m | Ns/m | N-s/m | N/(m/s) | kg/s": 1.0,
        "lbf s/in": POUND * GRAVITY / INCH,
    },
    ("stiffness", False): {"N/m": 1.0, "N/mm": 1e3, "lbf/in | lb/in": POUND * GRAVITY / INCH},
    ("displacement", True): {"rad": 1.0, "deg | °": math.pi / 180},
    ("velocity", True): {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": 2 * math.pi / 60},
    ("acceleration", True): {"rad/s²": 1.0},
    ("force", True): {"N·m | Nm": 1.0, "ft-lb": 12 * INCH * POUND * GRAVITY},
    ("mass", True): {"kg m^2": 1.0, "kg·cm²": 1e-4},
    ("damping", True): {"N·m·s/rad | N·m·s": 1.0},
    ("stiffness", True): {"N·m/rad": 1.0, "N·m/deg": 180 / math.pi},
    ("frequency", False): {"Hz | 1/s": 1.0, "kHz": 1e3, "rad/s": 1 / (2 * math.pi), "rpm": 1 / 60},
    ("time", False): {"s": 1.0, "ms": 1e-3, "min": 60.0},
}
KNOWN = [
    (unit, *of, factor)
    for of, units in FACTORS.items()
    for text, factor in units.items()
    for unit in text.split(" | ")
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


NO_UNITS = "m^|(m|m)|N//m|/m|m/|*|^2|m^^2|()|2 m|m\n;|\x00|µ|((((((((((m))))))))))|kN^99*kN^99|m^-99/km^99|m²³⁴|٣m|m^٣"


@pytest.mark.parametrize("unit", ["", " ", *NO_UNITS.split("|")])
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
    assert sensitivity("4.2 px/mm", "px", "displacement") == pytest.approx(4200)
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
