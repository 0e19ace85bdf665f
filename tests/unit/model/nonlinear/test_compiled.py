"""Harmonic balance in the compiled kernel against its twins in NumPy."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.nonlinear import harmonic_balance
from dashpot.model.nonlinear.alternating import compiled_rig
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law
from dashpot.model.nonlinear.harmonic_balance import (
    harmonic_unit_forces,
    periodic_response,
    slopes,
    truncation,
)
from dashpot.model.nonlinear.harmonics import Drive
from dashpot.numerics.kernel import using
from tests.kernels import apart, compiled, instruction_sets, instructions
from tests.nonlinear_rigs import LAWS, chain

TWINS = 1e-11
STATELESS = [name for name in LAWS if name not in ("jenkins", "backlash", "bouc-wen")]
ORDERS, FREQUENCIES = 9, np.array([4.0, 6.0, 8.0, 9.0, 12.0])


def _drive(model: Model) -> Drive:
    rng = np.random.default_rng(2)
    sizes = np.array([1e-5, 1e-3, 1e-4, 1e-4, 1e-5, 0, 0, 0, 0, 0])[:, None]
    count, r, s = len(FREQUENCIES), len(model.displacement_inputs), len(model.force_inputs)
    turned = np.exp(2j * np.pi * rng.random((count, ORDERS + 1, r + s)))
    turned[:, 0] = 1.0
    q = sizes * turned * np.array([*[1.0] * r, *[3e4] * s])
    return Drive(2 * np.pi * FREQUENCIES, q[..., :r], q[..., r:])


def _results(model: Model, theta: Real) -> dict[str, Any]:
    """All that has a twin, by what it is."""
    drive = _drive(model)
    count, m = len(FREQUENCIES), len(theta)
    p, constants = (
        np.tile(part, (count, 1)) for part in (model.parameters(theta), model.inner_constants(theta))
    )
    at = periodic_response(model, p, constants, drive, grow=False)
    a = harmonic_unit_forces(model, drive, at)
    rng = np.random.default_rng(7)
    along_U, along_f = (
        rng.standard_normal((1, *part.shape[1:], m)) + 1j * rng.standard_normal((1, *part.shape[1:], m))
        for part in (drive.U, drive.f)
    )
    along = model.T, model.constants_map[0]
    sets = {
        "": slopes(model, p, drive, at, a, *along),
        " with inputs": slopes(model, p, drive, at, a, *along, along_U, along_f),
    }
    return {
        "start": harmonic_balance._linear_start(model, p, constants, drive, 256),
        "motion": at.X, "elongations": at.delta, "converged": at.converged.astype(float), "a": a,
        "slope": at.forces.slope, "by constant": np.concatenate(at.forces.by_constant, axis=-1),
        "inverse": at.linear.inverse, "receptance": at.linear.receptance,
        "truncation": 1 + truncation(model, p, constants, drive, at),
        **{f"{name}{k}": getattr(own, name) for k, own in sets.items() for name in ("X", "unit_forces", "delta")},
    }  # fmt: skip


def _require_twins(model: Model, theta: Real, name: str, within: float = TWINS) -> None:
    with using("numpy"):
        assert compiled_rig(model) is None
        twin = _results(model, theta)
    assert np.any(twin["converged"])
    with instructions(name), using("compiled"):
        assert compiled_rig(model) is not None
        found = _results(model, theta)
    for key, values in twin.items():
        assert values.shape == found[key].shape
        if values.size:
            assert apart(found[key], values) < within, key


def _bent(name: str, kind: Kind, first: str, second: str, law: ForceLaw) -> Element:
    return replace(between(name, kind, first, second), force_law=law)


@pytest.mark.parametrize("name", instruction_sets())
@pytest.mark.parametrize("law", STATELESS)
def test_responses_and_slopes_are_those_of_numpy(law: str, name: str) -> None:
    compiled()
    _require_twins(*chain(law, 2), name)


@pytest.mark.parametrize("name", instruction_sets())
@pytest.mark.parametrize(("ground", "within"), [(Kind.SPRING, TWINS), (Kind.DAMPER, 1e-6)])
def test_several_elements_forces_and_floating_rigs_too(ground: Kind, within: float, name: str) -> None:
    """What nothing holds at order 0 is held by a spring 1e-10 of the others, which multiplies rounding."""
    compiled()
    gap = [Constant("gap", 4e-4)]
    linear = (
        mass("m1", "x1"), mass("m2", "x2"), between("k", Kind.SPRING, "x1", "x2"),
        between("c", Kind.DAMPER, "x1", "x2"), between("g", ground, "x1", "ground"),
    )  # fmt: skip
    bent = (
        _bent("q", Kind.SPRING, "x1", "x2", force_law("cubic")),
        _bent("s", Kind.SPRING, "x2", "u", force_law("gap", gap)),
        _bent("w", Kind.DAMPER, "x2", "ground", force_law("tanh(v/v0)", [Constant("v0", 0.03)])),
    )
    model = Model(("x1", "x2"), (Input("u"), Input("f", "force", {"x1": 1.0})), (*linear, *bent))
    theta = np.array([3.0, 2.7, 4600.0, 20.0, 900.0, 1e9, 6000.0, 5.0])
    _require_twins(model, theta, name, within)


LAWS_OF_EVERY_FUNCTION = {
    "d*exp(-abs(d)/a)": {"a": 2e-3},
    "a*sin(d/a) + d*cos(v/b)": {"a": 5e-3, "b": 0.4},
    "sign(d)*abs(d)**e": {"e": 1.5},
    "d*log(1 + (d/a)**2)": {"a": 1e-3},
    "d*sqrt(1 + (d/a)**2)": {"a": 1e-3},
    "where(d > 0, d**1.5, r*d)": {"r": 0.02},
    "where(v <= a, v, 2*v - a)": {"a": 0.01},
    "min(max(d, -a), b*2)": {"a": 8e-4, "b": 4e-4},
    "-d**9/(1 - d/a)": {"a": 1.0},
}


@pytest.mark.parametrize("law", LAWS_OF_EVERY_FUNCTION)
def test_every_function_of_expressions_is_that_of_numpy(law: str) -> None:
    compiled()
    values = LAWS_OF_EVERY_FUNCTION[law]
    constants = [Constant(name) for name in values]
    elements = (
        mass("m", "x1", value=2.0), between("k", Kind.SPRING, "x1", "u"), between("c", Kind.DAMPER, "x1", "u"),
        _bent("q", Kind.SPRING, "x1", "u", force_law(law, constants)),
    )  # fmt: skip
    model = Model(("x1",), (Input("u"),), elements)
    _require_twins(model, np.array([4600.0, 20.0, 300.0, *values.values()]), instruction_sets()[-1])


def test_laws_with_a_state_and_kernels_without_harmonic_balance_are_left_to_numpy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kernel = compiled()
    assert compiled_rig(chain("jenkins", 1)[0]) is None
    monkeypatch.delattr(kernel, "NonlinearRig")
    model, theta = chain("cubic", 1)
    assert compiled_rig(model) is None
    assert np.all(_results(model, theta)["converged"])


def test_the_kernel_refuses_programs_that_are_none() -> None:
    kernel = compiled()
    model, _ = chain("cubic", 1)
    arrays = model.B, model.D, model.S, model.nonlinear.astype(np.int64), np.zeros(2, dtype=np.int64)
    steps = np.array([0, 1]), np.array([99]), np.array([0]), np.array([0.0])
    with pytest.raises(ValueError, match="no such step"):
        kernel.NonlinearRig(*map(np.ascontiguousarray, arrays), *steps)
    steps = np.array([0, 1]), np.array([5]), np.array([0]), np.array([0.0])
    with pytest.raises(ValueError, match="lacks an operand"):
        kernel.NonlinearRig(*map(np.ascontiguousarray, arrays), *steps)
