"""Rigs with values for the tests of exports, and what their channels show."""

import numpy as np

from dashpot.check.residuals import channel_response
from dashpot.export.identified_rig import identified_rig
from dashpot.model.rigfile import parse_rig

TWO_MASSES = """
name = "Two masses"
coordinates = ["x1", "x2"]
[inputs]
u = {}
[masses]
m1 = { at = "x1", guess = 3 }
m2 = { at = "x2", value = 2.7, sd = 0.01 }
[springs]
k1 = { between = ["x1", "x2"], value = 4600 }
k2 = { between = ["x2", "u"], guess = 4600 }
[dampers]
c1 = { between = ["x1", "x2"], guess = 20 }
c2 = { between = ["x2", "u"], guess = 30 }
[channels]
x1 = { of = "x1", unit = "mm" }
x2 = { of = "x2", unit = "mm" }
u = { of = "u", unit = "mm" }
"""

# A lever, a tip mass, two moved points, a force, an element's force and a reaction; {…}: what makes it improper
LEVER = """
name = "Lever & <tip>"
coordinates = ["x1", "x2"]
[inputs]
u = {{}}
w = {{}}
f = {{ kind = "force", at = "x1" }}
[masses]
m1 = {{ at = "x1", value = 1.0, sd = 0.1 }}
m2 = {{ at = "x2", guess = 2.0 }}
tip = {{ along = {{ x1 = 1, x2 = 0.5 }}, guess = 0.3 }}
{inerter}
[springs]
k1 = {{ between = ["x1", "x2"], guess = 1000 }}
k2 = {{ between = ["x2", "u"], guess = 2000 }}
k3 = {{ between = ["x2", "w"], same_as = "k2", times = 0.25 }}
[dampers]
c1 = {{ between = ["x1", "x2"], guess = 4 }}
{damper}
[channels]
x1 = {{ of = "x1"{quantity} }}
x2 = {{ of = {{ x2 = 1, u = -1 }}, quantity = "velocity", unit = "mm/s" }}
force = {{ of = "c1", quantity = "force" }}
reaction = {{ of = "u", quantity = "force" }}
f = {{ of = "f" }}
"""
VARIANTS = {
    "springs to the base": {},
    "a damper to the base": {"damper": 'c2 = { between = ["x2", "u"], guess = 6 }'},
    "an inerter to the base": {"inerter": '[inerters]\nb = { between = ["x2", "u"], guess = 0.4 }'},
    "an accelerometer": {"quantity": ', quantity = "acceleration"'},
}
EMPTY = {"damper": "", "inerter": "", "quantity": ""}


def two_masses():
    return identified_rig(parse_rig(TWO_MASSES, "rig.toml"))


def lever(variant: str):
    return identified_rig(parse_rig(LEVER.format(**EMPTY | VARIANTS[variant]), "rig.toml"))


def nonlinear():
    text = TWO_MASSES.replace("guess = 20 }", 'guess = 20, law = "v*abs(v)" }')
    return identified_rig(parse_rig(text, "rig.toml"))


def hysteretic():
    text = TWO_MASSES.replace("[dampers]", '[hysteretic]\nh = { at = "x1", value = 10 }\n[dampers]')
    return identified_rig(parse_rig(text, "rig.toml"))


def expected_response(rig, system, omega):
    """Amplitudes of the outputs per unit of what is given: dashpot's own response over (jω)^d."""
    order = {"displacement": 0, "velocity": 1, "acceleration": 2, "force": 0}
    rates = np.array([order[port.quantity] for port in system.inputs])
    G = channel_response(rig.model, rig.p, rig.outputs, omega)
    return G / ((1j * omega)[:, None] ** rates)[:, None, :]
