"""Stability of periodic motions: Floquet multipliers from the linearised motion over one period (THEORY §9).

The product of the tangents of all steps of a period is the monodromy matrix.  Where no law has a state the tangents
follow from the slopes of the laws along the motion of the harmonic balance, all steps and dwells at once.  States of
laws are states of the motion: there the period is cut into segments, integrated side by side from the states of the
harmonic balance.
Source: Nayfeh and Balachandran (1995), Applied Nonlinear Dynamics, section 3.2.
"""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.errors import ModelError
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import period_basis
from dashpot.model.nonlinear.balance import solved
from dashpot.model.nonlinear.harmonic_balance import Periodic
from dashpot.model.nonlinear.harmonics import Drive, complex_of, real_of
from dashpot.model.nonlinear.integration import Integrator
from dashpot.model.nonlinear.propagation import NODES, forcing, propagator

SEGMENTS = 32  # of a period, integrated side by side
FEWEST = 128  # instants of a period
MARGIN = 1e-6  # by which a multiplier may exceed 1: rounding of what does not decay


def floquet_multipliers(model: Model, theta: Real, drive: Drive, at: Periodic) -> Complex:
    """Multipliers of the state over one period, (N, states), largest first; NaN where the response did not converge.

    theta (unknowns,) of all N dwells.  Raises ModelError where the motion cannot be integrated: a coordinate without
    mass, or a hysteretic damper.
    """
    times = max(FEWEST, 4 * (drive.orders + 1))
    times += -times % SEGMENTS
    laws = [e.force_law for e in model.elements if e.force_law is not None]
    if any(law.has_state for law in laws):
        monodromy = _integrated(model, theta, drive, at, times)
    else:
        monodromy = _along_motions(model, theta, drive, at, times)
    return np.where(at.converged[:, None], _eigenvalues(monodromy), np.nan)


def _along_motions(model: Model, theta: Real, drive: Drive, at: Periodic, times: int) -> Real:
    """Monodromy matrices of a rig whose laws have no state, (N, 2 n, 2 n), from the slopes of the laws."""
    p, Bn = model.parameters(theta), model.B[model.nonlinear]
    n, nodes = model.n, 4 * len(model.nonlinear)
    by_d, by_v = _law_slopes(model, model.inner_constants(theta), drive.omega, at.delta, times)
    monodromy = np.empty((len(drive.omega), 2 * n, 2 * n))
    with np.errstate(all="ignore"):
        for row, omega in enumerate(drive.omega):
            step = propagator(model, p, 2 * np.pi / (float(omega) * times))
            pulled = np.moveaxis(step.Wn, 1, 2).reshape(4, 2 * n, nodes)
            reach_d, reach_v = (
                (Bn @ pulled[:, :n]).reshape(nodes, nodes),
                (Bn @ pulled[:, n:]).reshape(nodes, nodes),
            )
            free_d, free_v = (
                (Bn @ step.E[:, :n]).reshape(nodes, 2 * n),
                (Bn @ step.E[:, n:]).reshape(nodes, 2 * n),
            )
            d, v = by_d[row][..., None], by_v[row][..., None]
            forces = solved(np.eye(nodes) - d * reach_d - v * reach_v, d * free_d + v * free_v)
            monodromy[row] = _product(step.E[3] + pulled[3] @ forces)
    return monodromy


def _law_slopes(model: Model, constants: Real, omega: Real, delta: Real, times: int) -> tuple[Real, Real]:
    """∂φ/∂d and ∂φ/∂v at the Lobatto points of the steps of a period, (N, times, 4 e), points before elements."""
    N, e, W = delta.shape
    there, rate, _ = period_basis((W - 1) // 2, times)
    angle = 2 * np.pi / times * np.arange((W + 1) // 2)
    by_d, by_v = np.zeros((2, N, times, len(NODES), e))
    for row, (index, inner) in enumerate(zip(model.nonlinear, model.constant_slices, strict=True)):
        law = model.elements[int(index)].force_law
        assert law is not None
        g = np.broadcast_to(constants[inner], (N, inner.stop - inner.start))
        for node, share in enumerate(NODES):
            q = real_of(complex_of(delta[:, row]) * np.exp(1j * share * angle))
            d, v = q @ there.T, omega[:, None] * (q @ rate.T)
            slopes = law(d, v, d, g).slopes
            by_d[..., node, row], by_v[..., node, row] = slopes.get("d", 0.0), slopes.get("v", 0.0)
    return by_d.reshape(N, times, -1), by_v.reshape(N, times, -1)


def _product(tangents: Real) -> Real:
    """The last of (times, n, n) times … times the first, pair by pair."""
    while len(tangents) > 1:
        if len(tangents) % 2:
            tangents = np.concatenate([tangents, np.eye(tangents.shape[-1])[None]])
        tangents = tangents[1::2] @ tangents[::2]
    product: Real = tangents[0]
    return product


def _eigenvalues(monodromy: Real) -> Complex:
    """Multipliers, largest first, (N, states); infinite where the matrix is not finite."""
    finite = np.all(np.isfinite(monodromy), axis=(-2, -1))
    values = np.linalg.eigvals(np.where(finite[:, None, None], monodromy, 0.0)).astype(np.complex128)
    order = np.argsort(-np.abs(values), axis=-1)
    return np.where(finite[:, None], np.take_along_axis(values, order, axis=-1), np.inf)


def stable_motions(model: Model, theta: Real, drive: Drive, at: Periodic) -> Bools | None:
    """Whether each motion returns to itself after a small disturbance, (N,); None where that cannot be told."""
    try:
        multipliers = floquet_multipliers(model, theta, drive, at)
    except ModelError:
        return None
    with np.errstate(invalid="ignore"):
        stable: Bools = np.abs(multipliers[:, 0]) <= 1 + MARGIN
    return stable


def _period(model: Model, theta: Real, drive: Drive, row: int, times: int) -> Integrator:
    """The integrator of one dwell over a period; the spline of its inputs goes on beyond both ends."""
    there, _, _ = period_basis(drive.orders, times)
    inputs = np.concatenate([drive.U[row], drive.f[row]], axis=-1)
    period = there @ real_of(inputs.T).T
    lead = times // 4
    longer = np.concatenate([period[-lead:], period, period[: lead + 1]])
    step = 2 * np.pi / (drive.omega[row] * times)
    whole = forcing(step, longer)
    return Integrator(model, theta, type(whole)(step, whole.coefficients[lead : lead + times]), 1)


def _states(model: Model, drive: Drive, at: Periodic, row: int, times: int) -> Real:
    """Coordinates, their rates and the states of laws at the instants of the period, (times, states)."""
    there, rate, _ = period_basis(drive.orders, times)
    q = real_of(at.X[row].T).T
    parts = [there @ q, drive.omega[row] * (rate @ q)]
    for state in at.forces.states:
        if state.shape[1]:
            instants = np.arange(times) * state.shape[1] / times
            parts.append(
                np.interp(instants, np.arange(state.shape[1]), state[row], period=state.shape[1])[:, None]
            )
    return np.concatenate(parts, axis=1)


def _integrated(model: Model, theta: Real, drive: Drive, at: Periodic, times: int) -> Real:
    """Monodromy matrices by integration from the states of the harmonic balance, (N, states, states)."""
    rows = []
    for row in range(len(drive.omega)):
        machine = _period(model, theta, drive, row, times)
        rows.append(_monodromy(machine, _states(model, drive, at, row, times), times))
    return np.array(rows)


def _monodromy(machine: Integrator, states: Real, times: int) -> Real:
    """Product of the tangents of the segments, (states, states)."""
    length = times // SEGMENTS
    first = np.arange(0, times, length)
    state = states[first]
    slope = np.zeros((len(first), machine.states, machine.states))
    slope[:] = np.eye(machine.states)
    with np.errstate(all="ignore"):
        for step in range(length):
            stepped = machine.advance(state, slope, first + step, False)
            state, slope = stepped.state, stepped.slope
        return _product(slope)
