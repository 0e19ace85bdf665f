"""Simulated releases: the static shape, the decay of theory, and what cannot be."""

import numpy as np
import pytest

import dashpot

TEXT = """
coordinates = ["x1", "x2"]
[masses]
m1 = { at = "x1", value = 2.0 }
m2 = { at = "x2", value = 1.0 }
[springs]
k1 = { between = ["x1", "x2"], value = 1000 }
k2 = { between = ["x2", "ground"], value = 3000 }
[dampers]
c = { between = ["x2", "ground"], guess = 3 }
[channels]
x1 = { of = "x1", unit = "mm" }
x2 = { of = "x2", unit = "mm" }
"""
CUBIC = TEXT.replace(
    "[dampers]", 'q = { between = ["x1", "ground"], law = "cubic", guess = 1e-9 }\n[dampers]'
)


def test_a_release_begins_with_the_static_shape_and_decays_as_the_modes_do() -> None:
    rig = dashpot.parse_rig(TEXT)
    (record,) = rig.simulate({"c": 3.0}, release={"x1": 0.004}, samples=400, rate=100)
    assert record.values[0] == pytest.approx([4e-3, 1e-3])  # k1 / (k1 + k2) of it at x2
    K, C = np.array([[1000.0, -1000], [-1000, 4000]]), np.diag([0.0, 3.0])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag([0.5, 1]) @ K, -np.diag([0.5, 1]) @ C]])
    rates, shapes = np.linalg.eig(A)
    start = np.linalg.solve(shapes, [4e-3, 1e-3, 0, 0])
    expected = (shapes[:2] * start) @ np.exp(rates[:, None] * record.time)
    np.testing.assert_allclose(record.values.T, expected.real, atol=1e-12)
    (nearly,) = dashpot.parse_rig(CUBIC).simulate({"c": 3.0}, release={"x1": 0.004}, samples=400, rate=100)
    np.testing.assert_allclose(nearly.values, record.values, atol=1e-7)


def test_what_cannot_be_released_is_said() -> None:
    rig = dashpot.parse_rig(TEXT)
    for options in (
        {},
        {"release": {"x1": 0.01}},
        {"release": {"x9": 0.01}, "rate": 100},
        {"frequencies": "1:2:1", "release": {"x1": 0.01}, "rate": 100},
    ):
        with pytest.raises(dashpot.UsageError):
            rig.simulate({"c": 3.0}, **options)
