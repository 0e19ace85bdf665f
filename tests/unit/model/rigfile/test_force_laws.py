"""Laws of springs and dampers in rig files."""

import pytest

from dashpot.errors import ModelError
from dashpot.model.rigfile import parse_rig, write_rig

RIG = """coordinates = ["x1"]
[inputs]
u = { kind = "displacement" }
[masses]
m = { at = "x1", value = 1.0 }
[springs]
k = { between = ["x1", "u"] }
"""


@pytest.mark.parametrize(
    ("entry", "unknowns"),
    [
        ('k3 = { between = ["x1", "u"], law = "d**3" }', {"k3": "N/m³"}),
        ('k3 = { between = ["x1", "u"], law = "cubic", value = 5.0 }', {}),
        ('k2 = { between = ["x1", "u"], law = "d*abs(d)", value = -3.0, sd = 1.0 }', {"k2": "N/m²"}),
        ('f = { between = ["x1", "u"], law = "tanh(v/v0)", v0 = 0.002 }', {"f": "N"}),
        ('f = { between = ["x1", "u"], law = "coulomb", v0 = "unknown" }', {"f": "N", "f.v0": "m/s"}),
        (
            'g = { between = ["x1", "u"], law = "gap", gap = { guess = 1e-3, min = 0.0 } }',
            {"g": "N/m", "g.gap": "m"},
        ),
        ('j = { between = ["x1", "u"], law = "jenkins" }', {"j": "N/m", "j.slip": "m"}),
        (
            'b = { between = ["x1", "u"], law = "bouc-wen", nu = 1.0 }',
            {"b": "N/m", "b.gamma": "1/m", "b.delta": "1/m"},
        ),
        ('[dampers]\nc = { between = ["x1", "u"], law = "quadratic" }', {"c": "N·s²/m²"}),
    ],
)
def test_laws_are_read_and_written(entry, unknowns):
    rig = parse_rig(RIG + entry)
    assert {u.name: u.unit for u in rig.model.unknowns} == {"k": "N/m", **unknowns}
    again = parse_rig(write_rig(rig))
    assert again.model == rig.model


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('g = { between = ["x1", "u"], law = "gap", gap = -0.001 }', "springs.g.gap: gap of the law"),
        ('g = { between = ["x1", "u"], law = "tanh(v/w)", w = { guess = 0 } }', "springs.g.w: w of the law"),
        ('k3 = { between = ["x1", "u"], law = "tanh(v/w)" }', "springs.k3.law: the law 'tanh.v/w.'"),
        ('k3 = { between = ["x1", "u"], law = "d**3", b = 1.0 }', "has no constant b"),
        ('k3 = { between = ["x1", "u"], law = "1/d" }', "divides by zero"),
        ('k3 = { between = ["x1", "u"], law = "d/0" }', "divides by zero"),
        ('f = { between = ["x1", "u"], law = "sign(v)" }', "jumps where v"),
        ('f = { between = ["x1", "u"], law = "d*sign(v)" }', "jumps where v"),
        ('k3 = { between = ["x1", "u"], law = "d**1.5" }', "is not defined"),
        ('k3 = { between = ["x1", "u"], law = "d + v" }', "no consistent units"),
        ('k3 = { between = ["x1", "u"], law = "open(d)" }', "there is no function"),
        ('k3 = { between = ["x1", "u"], law = "2" }', "depends on neither"),
        ('k3 = { between = ["x1", "u"], law = "d**3", unit = "N/m" }', "the unit follows"),
        ('k3 = { between = ["x1", "u"], law = "gap", gap = "wide" }', "springs.k3.gap"),
        ('k3 = { between = ["x1", "u"], law = "gap", gap = { min = 2.0, max = 1.0 } }', "is not below"),
        ('[inerters]\nb = { between = ["x1", "u"], law = "d**3" }', "laws belong to springs"),
    ],
)
def test_faults_are_named_in_one_line_at_their_place(entry, message):
    with pytest.raises(ModelError, match=message) as caught:
        parse_rig(RIG + entry)
    assert len(caught.value.problems) == 1
    assert caught.value.problems[0].where is not None
