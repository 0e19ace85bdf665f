"""Harmonic balance, laws with a state and motions in time in the compiled kernel against their twins in NumPy."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.nonlinear import harmonic_balance
from dashpot.model.nonlinear.alternating import alternate, compiled_laws, compiled_rig, rated_states
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law
from dashpot.model.nonlinear.harmonic_balance import (
    harmonic_unit_forces,
    periodic_response,
    slopes,
    truncation,
)
from dashpot.model.nonlinear.harmonics import Drive
from dashpot.model.nonlinear.integration import Integrator, Motion, forcing
from dashpot.model.nonlinear.shooting import integrate
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


def test_balance_of_laws_with_a_state_and_kernels_without_it_are_left_to_numpy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kernel = compiled()
    assert compiled_rig(chain("jenkins", 1)[0]) is None
    monkeypatch.delattr(kernel, "NonlinearRig")
    monkeypatch.delattr(kernel, "StateLaws")
    model, theta = chain("cubic", 1)
    assert compiled_rig(model) is None
    assert compiled_laws(model.laws) is None
    assert np.all(_results(model, theta)["converged"])


RATED = {
    "bouc-wen": {"gamma": 800.0, "delta": -300.0, "nu": 1.4},
    "maxwell": {"tau": 0.02},
    "lugre": {"slip": 2e-4, "ratio": 1.6, "vs": 0.02, "tau": 1e-3},
}


@pytest.mark.parametrize("name", instruction_sets())
@pytest.mark.parametrize("law", RATED)
def test_states_in_dwells_and_along_histories_are_those_of_numpy(law: str, name: str) -> None:
    """Newton's method ends within 1e-11 of the elongation in dwells and within 1e-9 along a history."""
    compiled()
    own = force_law(law, [Constant(key) for key in RATED[law]])
    model = Model((), (Input("u"),), (_bent("q", Kind.SPRING, "u", "ground", own),))
    rng = np.random.default_rng(4)
    q = 1e-3 * rng.standard_normal((5, 1, 9)) / (1 + np.arange(9)) ** 2
    omega, values = 2 * np.pi * FREQUENCIES, np.array([*RATED[law].values()])
    constants = values * np.exp(rng.uniform(-0.2, 0.2, (5, len(values))))
    time = np.arange(501) / 500
    d = 1e-3 * np.sin(2 * np.pi * (3 * time + 4 * time**2))
    v = np.gradient(d, time)

    def found() -> list[Real]:
        at = alternate(model, constants, omega, q, 128)
        near = alternate(model, constants, omega, 1.01 * q, 128, start=at, slopes=False)
        parts = (at.a, at.slope, at.by_constant[0], at.states[0], near.a, near.states[0])
        return [*parts, rated_states(own, d, v, 1 / 500, values)[None]]

    with using("numpy"):
        twins = found()
    with instructions(name), using("compiled"):
        for values_, twin in zip(found(), twins, strict=True):
            assert values_.shape == twin.shape
            assert apart(values_, twin) < 1e-8


MOVING = {
    "cubic": ({}, 1e9, Kind.SPRING),
    "coulomb": ({"v0": 0.01}, 4.0, Kind.DAMPER),
    "jenkins": ({"slip": 3e-4}, 4000.0, Kind.SPRING),
    "backlash": ({"gap": 3e-4}, 3000.0, Kind.SPRING),
    **{law: (RATED[law], 3000.0, Kind.SPRING) for law in RATED},
}


def _motion(laws: tuple[str, ...], count: int) -> list[Motion]:
    """Two masses on a shaken base, or none, with the laws: from rest, from that motion, and from a slower one."""
    points = [f"x{k}" for k in range(1, count + 1)]
    links = list(zip(["u", *points][: count + 1], [*points, "ground"], strict=True))
    elements = [mass(f"m{k}", point) for k, point in enumerate(points)]
    elements += [between(f"k{k}", Kind.SPRING, *link) for k, link in enumerate(links)]
    elements += [between(f"c{k}", Kind.DAMPER, *link) for k, link in enumerate(links)]
    theta = [2.0] * count + [3000.0] * len(links) + [8.0] * len(links)
    for k, law in enumerate(laws):
        constants, p, kind = MOVING[law]
        given = force_law(law, [Constant(name) for name in constants], damper=kind is Kind.DAMPER)
        elements.append(_bent(f"q{k}", kind, *links[k % len(links)], given))
        theta += [p, *constants.values()]
    pushed = (Input("f", "force", {points[0]: 1.0}),) if count else ()
    model = Model(tuple(points), (Input("u"), *pushed), tuple(elements))
    time = np.arange(150) / 200
    shaken = 1e-3 * np.sin(2 * np.pi * (3 * time + 4 * time**2))
    drive = forcing(1 / 200, np.column_stack([shaken, *(3 * np.cos(20 * time) for _ in pushed)]))
    order = [names.index(u.name) for names in [_names(elements, laws)] for u in model.unknowns]
    machine = Integrator(model, np.array(theta)[order], drive, 2, np.full(len(pushed), 0.1))
    first = integrate(machine, np.zeros(machine.states), slopes=True)
    start = np.full(machine.states, 1e-5)
    return [first, integrate(machine, start, first, slopes=True), integrate(machine, 0 * start, first)]


def _names(elements: list[Element], laws: tuple[str, ...]) -> list[str]:
    """Of all parameters in the order of `_motion`."""
    linear = [element.name for element in elements[: len(elements) - len(laws)]]
    return linear + [
        name
        for k, law in enumerate(laws)
        for name in (f"q{k}", *(f"q{k}.{constant}" for constant in MOVING[law][0]))
    ]


@pytest.mark.parametrize("name", instruction_sets())
@pytest.mark.parametrize(
    ("laws", "count"),
    [*(((law,), 1) for law in MOVING), (("lugre",), 0), (("jenkins", "coulomb", "bouc-wen"), 2)],
)
def test_motions_and_their_slopes_are_those_of_numpy(laws: tuple[str, ...], count: int, name: str) -> None:
    compiled()
    with using("numpy"):
        twins = _motion(laws, count)
    with instructions(name), using("compiled"):
        found = _motion(laws, count)
    for motion, twin in zip(found, twins, strict=True):
        assert motion.closed
        assert twin.closed
        size = 1 / (np.max(np.abs(twin.state), axis=0) + 1e-300)
        assert apart(motion.state, twin.state, size) < 1e-8
        assert (motion.slope is None) == (twin.slope is None)
        if motion.slope is not None and twin.slope is not None:
            largest = np.max(np.abs(twin.slope), axis=0)
            assert (
                np.max(np.abs(motion.slope - twin.slope) / (largest + 1e-9 * np.max(largest) + 1e-300)) < 1e-6
            )
