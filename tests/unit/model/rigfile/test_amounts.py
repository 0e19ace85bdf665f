"""Amounts with units of their own, and shares in per cent, wherever a rig file has a quantity."""

import pytest

from dashpot.errors import ModelError
from dashpot.model.elements import Element, Kind
from dashpot.model.rigfile import Rig, parse_rig, write_rig
from dashpot.units import STANDARD_GRAVITY

RIG = """
coordinates = ["x1", "x2", "pitch"]
angles = ["pitch"]
[inputs]
u = {}
f = { kind = "force", at = { x1 = "50 %", pitch = "30 cm" } }
[masses]
m1 = { at = "x1", value = "2500 g", sd = "1 %" }
m2 = { at = "x2", guess = "3 kg", min = "500 g", max = 10 }
J = { at = "pitch", value = "250 kg·cm^2", sd = "5 kg cm^2" }
[springs]
k1 = { between = ["x1", "x2"], value = "4.6 kN/m", sd = 0.05, unit = "kN/m" }
k2 = { along = { x2 = 1, pitch = "40 cm", u = -1 }, value = 4.6, sd = "100 N/m", unit = "kN/m" }
kt = { at = "pitch", value = "3 N·m/deg" }
k3 = { between = ["x2", "u"], same_as = "k1", times = "50 %" }
[dampers]
c = { between = ["x1", "ground"], value = "30 N·s/m", sd = "10%" }
[channels]
x1 = { of = "x1", unit = "mm", noise = "50 µm", delay = "2 ms", rate = "1.2 kHz" }
x2 = { of = "x2", unit = "mm", noise = "1 %" }
a2 = { of = "x2", quantity = "acceleration", unit = "g", noise = "0.1 m/s²", relative_noise = "2 %" }
v1 = { of = "x1", quantity = "acceleration", unit = "V", gain = "100 mV/g", noise = "3 mV", delay = "unknown" }
far = { of = { x1 = 1, pitch = "-25 cm" } }
"""


@pytest.fixture(scope="module")
def rig() -> Rig:
    return parse_rig(RIG)


def element(rig: Rig, name: str) -> Element:
    return next(element for element in rig.model.elements if element.name == name)


def test_parameters_with_their_units(rig: Rig) -> None:
    m1, m2, J = (element(rig, name) for name in ("m1", "m2", "J"))
    assert (m1.value, m1.sd) == (2.5, 0.025)
    assert (m2.guess, m2.lower, m2.upper) == (3.0, 0.5, 10.0)
    assert J.value == pytest.approx(0.025)
    assert J.sd == pytest.approx(5e-4)
    assert (element(rig, "c").value, element(rig, "c").sd) == (30.0, 3.0)
    assert element(rig, "kt").value == pytest.approx(3 * 180 / 3.141592653589793)


def test_a_unit_in_the_number_goes_before_the_unit_of_the_entry(rig: Rig) -> None:
    """k1 has its value in the number's unit and its sd in the entry's, k2 the other way round."""
    assert (element(rig, "k1").value, element(rig, "k1").sd) == (4600.0, 50.0)
    assert (element(rig, "k2").value, element(rig, "k2").sd) == (4600.0, 100.0)


def test_factors_are_shares_or_the_arms_of_angles(rig: Rig) -> None:
    assert dict(element(rig, "k2").along) == {"x2": 1.0, "pitch": 0.4, "u": -1.0}
    assert dict(rig.model.inputs[1].at) == {"x1": 0.5, "pitch": 0.3}
    assert element(rig, "k3").times == 0.5
    assert dict(rig.channels[4].of) == {"x1": 1.0, "pitch": -0.25}


def test_channels_with_their_units(rig: Rig) -> None:
    x1, x2, a2, v1, _ = rig.channels
    assert (x1.noise, x1.delay, x1.rate) == pytest.approx((0.05, 0.002, 1200.0))
    assert (x2.noise, x2.relative_noise) == (0.0, 0.01)
    assert (a2.noise, a2.relative_noise) == pytest.approx((0.1 / STANDARD_GRAVITY, 0.02))
    assert v1.noise == pytest.approx(3e-3)
    assert v1.delay is None


def test_it_is_the_rig_that_plain_numbers_make(rig: Rig) -> None:
    """Written in SI units and read again."""
    again = parse_rig(write_rig(rig))
    assert again.model == rig.model
    assert again.channels == rig.channels


@pytest.mark.parametrize(
    ("law", "value", "si"),
    [("d**3", "2 N/mm^3", 2e9), ("d**3", "2 kN/m³", 2e3), ("v*abs(v)", "5 N·s²/m²", 5.0)],
)
def test_parameters_of_nonlinear_laws(law: str, value: str, si: float) -> None:
    section = "dampers" if "v" in law else "springs"
    text = f'coordinates = ["x"]\n[masses]\nm = {{ at = "x" }}\n[{section}]\n'
    rig = parse_rig(text + f'p = {{ at = "x", law = "{law}", value = "{value}", sd = "1 %" }}\n')
    parameter = element(rig, "p")
    assert parameter.value == pytest.approx(si, rel=1e-12)
    assert parameter.sd == pytest.approx(0.01 * si, rel=1e-12)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('value = "4600 kg"', 'springs.k.value: "kg"'),
        ('value = "4600 bananas"', 'springs.k.value: "bananas"'),
        ('value = 3, sd = "1 kg"', 'springs.k.sd: "kg"'),
        ('sd = "1 %"', "springs.k.sd: an sd of 1"),
        ('guess = "1 %"', "springs.k.guess: 1 % is a share"),
        ('value = 0, sd = "1 %"', "springs.k: sd is 0"),
        ('value = "1e40 N/m"', "springs.k.value: '1e40"),
        ('value = "4.6.1 N/m"', "springs.k.value"),
        ('value = "N/m"', 'springs.k.value: "N/m"'),
        ('law = "d**3", value = "2 N/m"', 'springs.k.value: "N/m"'),
        ('same_as = "q", times = "3 m"', 'springs.k.times: "3 m"'),
    ],
)
def test_what_is_no_amount_is_told_at_its_key(entry: str, message: str) -> None:
    text = f'coordinates = ["x"]\n[masses]\nm = {{ at = "x" }}\n[springs]\nk = {{ at = "x", {entry} }}\n'
    with pytest.raises(ModelError) as caught:
        parse_rig(text)
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"rig.toml:5: {message}")


def test_what_python_shows_of_a_rig_is_one_short_line(rig: Rig) -> None:
    assert repr(rig) == ("<Rig 3 coordinates, 2 inputs, 8 elements, 6 unknowns, 5 channels, from rig.toml>")
    assert repr(parse_rig('name = "Beam"\n' + RIG).model) == (
        "<Model Beam: 3 coordinates, 2 inputs, 8 elements, 6 unknowns>"
    )
    assert repr(element(rig, "k1")) == "<Element k1: spring, x1 - x2, 4600 ± 50>"
    assert repr(element(rig, "k2")) == "<Element k2: spring, x2 + 0.4 pitch - u, 4600 ± 100>"
    assert repr(element(rig, "k3")) == "<Element k3: spring, x2 - u, 0.5 × k1>"
    assert repr(element(rig, "m2")) == "<Element m2: mass, x2, unknown, guess 3>"
    assert repr(Element("q", Kind.DAMPER, {"a": -1.0, "b": 1.0})) == "<Element q: damper, -a + b, unknown>"


def test_inner_constants_of_laws_take_units() -> None:
    text = 'coordinates = ["x"]\n[masses]\nm = { at = "x" }\n[dampers]\n'
    law = 'fc = { at = "x", law = "tanh(v/v0)", value = "2 kN", v0 = '
    for constant, expected in (
        ('"2 mm/s"', (0.002, None, None)),
        ('{ value = "2 mm/s", sd = "10 %" }', (0.002, 0.0002, None)),
        ('{ guess = "3 mm/s", min = "1 mm/s", max = 1 }', (None, None, 0.003)),
    ):
        fc = element(parse_rig(f"{text}{law}{constant} }}\n"), "fc")
        assert fc.value == 2000.0
        (v0,) = fc.force_law.constants
        for number, wanted in zip((v0.value, v0.sd, v0.guess), expected, strict=True):
            assert number == (None if wanted is None else pytest.approx(wanted))
    with pytest.raises(ModelError, match=r'rig.toml:5: dampers.fc.v0.value: "mm"'):
        parse_rig(f'{text}{law}"2 mm" }}\n')
