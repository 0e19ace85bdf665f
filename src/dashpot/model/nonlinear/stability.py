"""Stability of periodic motions: Floquet multipliers from the linearised motion over one period (THEORY §9).

The period is cut into segments whose tangents are integrated side by side from the states of the harmonic balance;
their product is the monodromy matrix.  States of laws are states of the motion, so friction and play need nothing else.
Source: Nayfeh and Balachandran (1995), Applied Nonlinear Dynamics, section 3.2.
"""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.errors import ModelError
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import period_basis
from dashpot.model.nonlinear.harmonic_balance import Periodic
from dashpot.model.nonlinear.harmonics import Drive, real_of
from dashpot.model.nonlinear.integration import Integrator
from dashpot.model.nonlinear.propagation import forcing

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
    rows = []
    for row in range(len(drive.omega)):
        machine = _period(model, theta, drive, row, times)
        if not at.converged[row]:
            rows.append(np.full(machine.states, np.nan + 0j))
            continue
        multipliers = np.linalg.eigvals(_monodromy(machine, _states(model, drive, at, row, times), times))
        rows.append(multipliers[np.argsort(-np.abs(multipliers))])
    return np.array(rows)


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
    whole = np.eye(machine.states)
    for segment in slope:
        whole = segment @ whole
    return np.nan_to_num(whole)
