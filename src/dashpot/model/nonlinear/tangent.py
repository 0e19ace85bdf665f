"""How a motion and what channels show of it change with the samples of the inputs, to first order (THEORY §9).

The linearised motion is a chain of small matrices, one from each sample to the next; the cubics between the samples of
the inputs are linear in these.  Both are carried forwards and, transposed, backwards, at the cost of a banded solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded
from scipy.linalg.blas import dtbsv

from dashpot.arrays import Real
from dashpot.model.nonlinear.integration import Integrator, Motion, PointForces

FEWEST = 4  # samples of a record whose inputs may move


@dataclass(frozen=True)
class Tangent:
    """The linearised motion: step (samples − 1, x, x) from each sample to the next, driven (samples − 1, x, 4 q) by the
    cubics of the interval's q inputs; shown (samples, channels, x) and direct (samples, channels, 4 q): what channels
    show of the state, and of the cubics of the interval that a sample begins (the last one: ends).
    """

    step: Real
    driven: Real
    shown: Real
    direct: Real

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.shown)

    def times(self, change: Real) -> Real:
        """What the channels show of changed inputs (samples, q, K), from the same start; (samples, channels, K)."""
        N, q, K = change.shape
        c = spline_coefficients(change.reshape(N, -1)).reshape(N - 1, 4 * q, K)
        states = np.zeros((N, self.step.shape[1], K))
        states[1:] = self.driven @ c
        states = self._carried(states, transposed=False)
        outputs: Real = self.shown @ states
        outputs[:-1] += self.direct[:-1] @ c
        outputs[-1] += self.direct[-1] @ c[-1]
        return outputs

    def transposed(self, outputs: Real) -> Real:
        """The transpose of `times`: (samples, channels, K) to (samples, q, K)."""
        N, _, K = outputs.shape
        states = self._carried(np.swapaxes(self.shown, 1, 2) @ outputs, transposed=True)
        c = np.swapaxes(self.driven, 1, 2) @ states[1:]
        c += np.swapaxes(self.direct[:-1], 1, 2) @ outputs[:-1]
        c[-1] += self.direct[-1].T @ outputs[-1]
        change = spline_transposed(c.reshape(N - 1, 4, -1))
        return change.reshape(N, -1, K)

    def _carried(self, loads: Real, *, transposed: bool) -> Real:
        """States (samples, x, K) that follow from loads at the samples along the chain, or against it, transposed."""
        N, x, K = loads.shape
        ab = np.zeros((2 * x, N * x), order="F")
        for row in range(x):
            for column in range(x):
                ab[x + row - column, column : (N - 1) * x : x] = -self.step[:, row, column]
        flat = np.asfortranarray(loads.reshape(N * x, K))
        for k in range(K):
            flat[:, k] = dtbsv(2 * x - 1, ab, flat[:, k], lower=1, trans=int(transposed), diag=1)
        return flat.reshape(N, x, K)


def tangent(
    machine: Integrator, motion: Motion, on_x: Real, on_q: Real, derivative: tuple[int, ...]
) -> Tangent:
    """Of a motion of a rig, as channels show it: on_x (channels, n), on_q (channels, r + s), derivative (channels,).

    Raises numpy's LinAlgError where the forces of a step have no one answer.
    """
    N, n, h = machine.drive.intervals + 1, machine.model.n, machine.drive.step_s
    q = machine.drive.coefficients.shape[-1]
    state = motion.state[:-1]
    slope = np.zeros((N - 1, machine.states, machine.states + 4 * q))
    slope[:, range(machine.states), range(machine.states)] = 1.0
    known = _forces_of_intervals(machine, motion)
    for sub, moved in enumerate(machine.input_loads()):
        index = np.arange(N - 1) * machine.substeps + sub
        guess = None if known is None else (known[0][:, sub], known[1][:, sub])
        stepped = machine.advance(state, slope, index, False, guess, moved)
        state, slope = stepped.state, stepped.slope
    shown, direct = np.zeros((N, len(derivative), machine.states)), np.zeros((N, len(derivative), 4 * q))
    by_state, by_input = _accelerations(machine, motion) if 2 in derivative else (None, None)
    r = machine.model.D.shape[1]
    for c, power in enumerate(derivative):
        if power < 2:
            shown[:, c, power * n : (power + 1) * n] = on_x[c]
        elif by_state is not None and by_input is not None:
            shown[:, c] = on_x[c] @ by_state
            direct[:, c] = on_x[c] @ by_input
        direct[:, c] += _input_itself(N, h, power, np.where(np.arange(q) < r, on_q[c], 0.0))
    return Tangent(slope[..., : machine.states], slope[..., machine.states :], shown, direct)


def _input_itself(N: int, h: float, power: int, on_q: Real) -> Real:
    """What a channel shows of the inputs themselves, or their rates, along the cubics; (samples, 4 q)."""
    at = np.zeros((N, 4))
    at[:-1, power] = (1.0, 1.0, 2.0)[power]
    at[-1] = ((1, 1, 1, 1), (0, 1, 2, 3), (0, 0, 2, 6))[power]
    return (at[:, :, None] / h**power * on_q).reshape(N, -1)


def _accelerations(machine: Integrator, motion: Motion) -> tuple[Real, Real]:
    """Slopes of the accelerations along the state, (samples, n, x), and along the cubics, (samples, n, 4 q)."""
    x = machine.states
    slope = np.zeros((len(motion.state), x, x + machine.directions))
    slope[:, range(x), range(x)] = 1.0
    by_all = machine.acceleration(
        Motion(motion.state, slope, motion.starts, True, None, motion.at, motion.forces)
    )[1]
    assert by_all is not None
    return by_all[..., :x], machine.acceleration_by_inputs(motion)


def _forces_of_intervals(machine: Integrator, motion: Motion) -> PointForces | None:
    """The forces that a motion was found with, (samples − 1, substeps, …); None where it does not tell."""
    steps = len(motion.forces)
    if not steps or steps % machine.substeps:
        return None
    S = len(motion.starts)
    parts = []
    for part in range(2):
        each = np.stack([motion.forces[k][part] for k in range(steps)], axis=1)
        parts.append(each.reshape(S * steps // machine.substeps, machine.substeps, *each.shape[2:]))
    return parts[0][: machine.drive.intervals], parts[1][: machine.drive.intervals]


def spline_coefficients(values: Real) -> Real:
    """Cubics of the spline through values (samples, K), (samples − 1, 4, K): powers of the share of the interval.

    That of `propagation.forcing`: the third derivative is continuous at the second and the last sample but one.
    """
    steps = np.diff(values, axis=0)
    right = np.empty_like(values)
    right[1:-1] = 3 * (steps[1:] + steps[:-1])
    right[0], right[-1] = (5 * steps[0] + steps[1]) / 2, (5 * steps[-1] + steps[-2]) / 2
    rate = solve_banded((1, 1), spline_matrix(len(values), transposed=False), right)
    bend, twist = 3 * steps - 2 * rate[:-1] - rate[1:], rate[:-1] + rate[1:] - 2 * steps
    return np.stack([values[:-1], rate[:-1], bend, twist], axis=1)


def spline_transposed(c: Real) -> Real:
    """The transpose of `spline_coefficients`: (samples − 1, 4, K) to (samples, K)."""
    N = len(c) + 1
    values, rate = np.zeros((N, c.shape[2])), np.zeros((N, c.shape[2]))
    values[:-1] = c[:, 0]
    rate[:-1] = c[:, 1] - 2 * c[:, 2] + c[:, 3]
    rate[1:] += c[:, 3] - c[:, 2]
    steps = 3 * c[:, 2] - 2 * c[:, 3]
    right = solve_banded((1, 1), spline_matrix(N, transposed=True), rate)
    steps[1:] += 3 * right[1:-1]
    steps[:-1] += 3 * right[1:-1]
    steps[0] += 2.5 * right[0]
    steps[1] += 0.5 * right[0]
    steps[-1] += 2.5 * right[-1]
    steps[-2] += 0.5 * right[-1]
    values[1:] += steps
    values[:-1] -= steps
    return values


def spline_matrix(N: int, *, transposed: bool) -> Real:
    """Bands (3, samples) of the equations for the rates of a cubic spline at its samples."""
    above, below = np.ones(N - 1), np.ones(N - 1)
    above[0] = below[-1] = 2.0
    bands = np.zeros((3, N))
    bands[0, 1:], bands[2, :-1] = (below, above) if transposed else (above, below)
    bands[1] = 4.0
    bands[1, 0] = bands[1, -1] = 1.0
    return bands
