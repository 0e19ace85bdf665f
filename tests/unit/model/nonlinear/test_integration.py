"""Integration in time against scipy, against harmonic balance, and slopes against differences."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from dashpot.model.dynamics import matrices
from dashpot.model.network import Model
from dashpot.model.nonlinear.harmonic_balance import periodic_response
from dashpot.model.nonlinear.harmonics import Drive
from dashpot.model.nonlinear.integration import Integrator, forcing
from dashpot.model.nonlinear.shooting import integrate
from dashpot.numerics.kernel import using
from tests.nonlinear_rigs import LAWS, two_masses

STEP = 1 / 200


def sweep(samples=301):
    time = STEP * np.arange(samples)
    return time, (1e-3 * np.sin(2 * np.pi * (2 + 2 * time) * time) + 3e-4 * np.cos(9 * time))[:, None]


def by_scipy(model, theta, time, u):
    """The motion by an explicit Runge-Kutta method of order 8, of the matrices, with the same spline of the input."""
    p, constants = model.parameters(theta), model.inner_constants(theta)
    parts = matrices(model, p)
    law = model.elements[-1].force_law
    spline = CubicSpline(time, u, axis=0)
    b, d = model.B[-1], model.D[-1]

    def rates(t, s):
        x, v = s[:2], s[2:]
        drive, rate = spline(t), spline(t, 1)
        elongation, speed = b @ x + d @ drive, b @ v + d @ rate
        at = law(np.array([elongation]), np.array([speed]), np.zeros(1), constants)
        force = (
            parts.G @ drive
            + parts.F @ rate
            - parts.K @ x
            - parts.C @ v
            - b * p[-1] * float(np.ravel(at.value)[0])
        )
        return np.concatenate([v, np.linalg.solve(parts.M, force)])

    return solve_ivp(
        rates, (0, time[-1]), np.zeros(4), "DOP853", time, rtol=1e-11, atol=1e-14, max_step=STEP / 2
    ).y.T


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "substeps", "tolerance"),
    [
        ("cubic", 1, 1e-6),
        ("v**3", 1, 1e-6),
        pytest.param("d**3 + b*d**2", 1, 1e-6, marks=pytest.mark.long),
        ("gap", 8, 1e-5),
        ("coulomb", 4, 1e-4),
    ],
)
def test_the_motion_is_that_of_another_integrator(law, substeps, tolerance):
    model, theta = two_masses(law)
    time, u = sweep(151)
    machine = Integrator(model, theta, forcing(STEP, u), substeps)
    motion = integrate(machine, np.zeros(4))
    reference = by_scipy(model, theta, time, u)
    assert motion.closed
    error = np.max(np.abs(motion.state - reference), axis=0) / np.max(np.abs(reference), axis=0)
    assert np.max(error) < tolerance


def test_a_linear_rig_is_integrated_exactly():
    model, theta = two_masses("cubic")
    theta[5] = 0.0
    _, u = sweep()
    machine = Integrator(model, theta, forcing(STEP, u), 1)
    motion = integrate(machine, np.array([1e-3, 0, 0, 0.01]))
    fine = Integrator(model, theta, forcing(STEP, u), 5)
    again = integrate(fine, np.array([1e-3, 0, 0, 0.01]))
    assert np.max(np.abs(motion.state - again.state) / np.max(np.abs(again.state), axis=0)) < 1e-10


STOPS = ("gap", "one-sided", "bilinear")
FRICTION = ("coulomb", "stribeck", "jenkins", "backlash", "bouc-wen")


@pytest.mark.parametrize("law", LAWS)
def test_a_motion_that_starts_on_the_settled_one_stays_on_it(law):
    """Harmonic balance and integration agree to 1e-6 for smooth laws, 1e-5 for stops, 1e-3 for friction."""
    tolerance, substeps = (1e-5, 16) if law in STOPS else (1e-3, 4) if law in FRICTION else (1e-6, 2)
    model, theta = two_masses(law)
    frequency, period, cycles = 5.0, 96, 4
    amplitude = 5e-4 if law == "quintic" else 1e-3  # at the greater one Newton's method needs a start nearby
    U = np.zeros((1, 44, 1), dtype=complex)
    U[0, 1, 0] = amplitude
    at = periodic_response(
        model, model.parameters(theta)[None], model.inner_constants(theta)[None],
        Drive(np.array([2 * np.pi * frequency]), U, np.zeros((1, 44, 0))), times=2048,
    )  # fmt: skip
    assert np.all(at.converged)
    rates = 2j * np.pi * frequency * np.arange(44)[:, None]
    states = [state[0, 0] for state in at.forces.states if state.size]
    start = np.concatenate([np.sum(at.X[0], axis=0).real, np.sum(rates * at.X[0], axis=0).real, states])
    time = np.arange(period * cycles + 1) / (period * frequency)
    u = amplitude * np.cos(2 * np.pi * frequency * time)[:, None]
    motion = integrate(Integrator(model, theta, forcing(1 / (period * frequency), u), substeps), start)
    turns = np.exp(2j * np.pi * frequency * np.outer(time, np.arange(44)))
    settled = (turns @ at.X[0]).real
    assert motion.closed
    assert np.max(np.abs(motion.state[:, :2] - settled)) < tolerance * np.max(np.abs(settled))


QUICK = ("cubic", "jenkins")


@pytest.mark.parametrize(
    "law", [*QUICK, *(pytest.param(law, marks=pytest.mark.long) for law in LAWS if law not in QUICK)]
)
def test_slopes_are_differences(law):
    model, theta = two_masses(law)
    u = 3 * sweep(61)[1]  # far enough that springs close their gaps and friction slips
    machine = Integrator(model, theta, forcing(STEP, u), 2)
    start = np.zeros(machine.states)
    start[:2] = 2e-4
    motion = integrate(machine, start, slopes=True)
    for j in range(len(theta)):
        step = 1e-6 * theta[j]
        ends = []
        for sign in (1, -1):
            moved = theta.copy()
            moved[j] += sign * step
            ends.append(integrate(Integrator(model, moved, forcing(STEP, u), 2), start, motion).state)
        difference = (ends[0] - ends[1])[:, :2] / (2 * step)
        own = motion.slope[:, :2, machine.states + j]
        assert np.max(np.abs(own)) > 0, model.unknowns[j].name
        assert np.max(np.abs(difference - own)) < 1e-6 * np.max(np.abs(own)), model.unknowns[j].name
    for j in range(4):
        ends = []
        for sign in (1, -1):
            moved = start.copy()
            moved[j] += sign * 1e-9
            ends.append(integrate(machine, moved, motion).state[:, :2])
        own = motion.slope[:, :2, j]
        assert np.max(np.abs((ends[0] - ends[1]) / 2e-9 - own)) < 1e-3 * np.max(np.abs(own))


@pytest.mark.parametrize("samples", [5, 301])
def test_forces_that_a_step_cannot_follow_leave_the_motion_open(samples, monkeypatch):
    """A hardening so steep that Newton's matrix of a step is singular; one segment, and many."""
    model, theta = two_masses("cubic")
    machine = Integrator(model, theta, forcing(STEP, sweep(samples)[1]), 1)
    monkeypatch.setattr(machine, "_matrix", lambda at: np.zeros((len(at.by_d), 4, 4)))
    with using("numpy"):
        assert not integrate(machine, np.zeros(4)).closed


@pytest.mark.parametrize("law", ["cubic", "coulomb", "bouc-wen"])
def test_a_motion_nearby_leads_to_the_same_motion(law):
    model, theta = two_masses(law)
    _, u = sweep(81)
    near = integrate(
        Integrator(model, theta, forcing(STEP, u), 2), np.zeros(4 + (law == "bouc-wen")), slopes=True
    )
    machine = Integrator(model, 1.02 * theta, forcing(STEP, u), 2)
    start = np.full(machine.states, 1e-5)
    alone, led = integrate(machine, start), integrate(machine, start, near)
    assert led.closed
    assert np.max(np.abs(led.state - alone.state) / np.max(np.abs(alone.state), axis=0)) < 1e-8


def test_a_rig_without_mass_is_refused():
    from dashpot.errors import ModelError

    model, theta = two_masses("cubic")
    light = Model(model.coordinates, model.inputs, model.elements[1:])
    with pytest.raises(ModelError, match="no mass"):
        Integrator(light, theta[1:], forcing(STEP, sweep()[1]), 1)
