"""Misfit of whole records of a nonlinear rig: measured against the motion that follows by integration (THEORY §9).

Unknown are θ, gains, a constant offset of every force input and, of each record, the state at its start and what the
accelerations of bases lack; where inputs were measured with noise, their true values as well, which each evaluation
finds and leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct

from dashpot.arrays import Ints, Real
from dashpot.errors import ConvergenceError
from dashpot.estimate.nonlinear.records import (
    RecordData,
    RecordedMotion,
    largest_states,
    laws_with_state,
    recorded_motion,
    shown_outputs,
    start_of,
)
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import operated_states
from dashpot.model.nonlinear.integration import Integrator, Motion, forcing
from dashpot.model.nonlinear.moving_base import does_nothing, moving_rig
from dashpot.model.nonlinear.shooting import ChainSolver, integrate, segment_length, segments_of
from dashpot.model.nonlinear.tangent import Tangent, tangent
from dashpot.numerics.levenberg_marquardt import QuadraticModel

# Which constants of whole records can be found: states at their starts, and constants that sensors of
# inputs add.
#
# Where nothing joins the rig to the ground and no channel shows where it is, a base may be anywhere and
# move at any steady velocity: only motion beside it counts. Such constants are no unknowns.


NONE = 1e-9  # of numbers around 1: what is none but for rounding


@dataclass(frozen=True)
class RecordConstants:
    """Indices of the constants that can be found, in the state of the model that moves and among its force inputs.

    starts (k,): of the state at the start of a record; offsets (o,): of forces, shared by all records; biases (b,): of
    accelerations of bases, each record's own.
    """

    starts: Ints
    offsets: Ints
    biases: Ints

    @property
    def of_record(self) -> int:
        """Unknowns of each record."""
        return len(self.starts) + len(self.biases)


def record_constants(model: Model, data: RecordData) -> RecordConstants:
    """Of the rig as it moves, bases behind its coordinates, and a record of it."""
    bases = len(data.bases.names)
    n, forces = model.n, model.S.shape[1] - bases
    # What a constant displacement of each coordinate stretches or shows, (rows, n)
    held = _linear_springs(model) + _laws_of_position(model)
    shown = [
        c
        for c, (d, drift) in enumerate(zip(data.derivative, data.drift, strict=True))
        if d == 0 and not drift
    ]
    no_position = _hidden(np.concatenate([model.B[held], data.on_x[shown]]), bases)
    no_velocity = _hidden(_rows_of_velocity(model, data), bases)
    states = sum(e.force_law is not None and e.force_law.has_state for e in model.elements)
    starts = np.delete(np.arange(2 * n + states), [*no_position, *(n + i for i in no_velocity)])
    shows = [_shows(model, data, column) for column in range(forces)]
    biases = [
        forces + j
        for j, order in enumerate(data.bases.orders)
        if order == 2 and (n - bases + j not in no_velocity or _shows(model, data, forces + j))
    ]
    return RecordConstants(starts, np.flatnonzero(shows), np.array(biases, dtype=np.int64))


def _rows_of_velocity(model: Model, data: RecordData) -> Real:
    """What a constant velocity of each coordinate stretches or shows, (rows, n)."""
    held = [
        row
        for row, e in enumerate(model.elements)
        if e.law.power < 2 and not does_nothing(model.elements[row])
    ]
    shown = [
        c for c, (d, drift) in enumerate(zip(data.derivative, data.drift, strict=True)) if d == 0 or not drift
    ]
    shown = [c for c in shown if data.derivative[c] < 2]
    return np.concatenate([model.B[held], data.on_x[shown]])


def _linear_springs(model: Model) -> list[int]:
    """Springs without a law of their own that may push."""
    return [
        row
        for row, (kind, element) in enumerate(zip(model.kinds, model.elements, strict=True))
        if kind is Kind.SPRING and element.force_law is None and not does_nothing(element)
    ]


def _laws_of_position(model: Model) -> list[int]:
    """Nonlinear elements whose force depends on where they are, not only on how they move."""
    laws = [(int(row), model.elements[int(row)].force_law) for row in model.nonlinear]
    return [
        r
        for r, law in laws
        if law is not None and "d" in law.expression.names and not does_nothing(model.elements[r])
    ]


def _hidden(rows: Real, bases: int) -> list[int]:
    """Coordinates that may as well stand still, those of bases first: the others move alike without a trace."""
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    n = rows.shape[1]
    _, values, directions = np.linalg.svd(rows / np.where(size > 0, size, 1.0))
    free = directions[int(np.sum(values > NONE)) :]  # (free, n)
    hidden: list[int] = []
    for i in [*range(n - bases, n), *range(n - bases)] if len(free) else []:
        if np.linalg.matrix_rank(free[:, [*hidden, i]], NONE) > len(hidden):
            hidden.append(i)
    return hidden


def _shows(model: Model, data: RecordData, column: int) -> bool:
    """Whether a constant of a force input leaves a trace beyond that of another start.

    It does not in a rig whose laws depend on motion alone, and whose channels have no zeros.
    """
    shown = any(d == 0 and not drift for d, drift in zip(data.derivative, data.drift, strict=True))
    if shown or _laws_of_position(model):
        return True
    n = model.n - len(data.bases.names)
    B = model.B[_linear_springs(model), :n]
    push = (
        model.S[:n, column]
        if column < model.S.shape[1] - len(data.bases.names)
        else _carried(model, data, column)
    )
    rest = np.linalg.lstsq(B.T @ B, push, rcond=None)[0]
    return bool(np.max(np.abs(B.T @ B @ rest - push), initial=0.0) > NONE * np.max(np.abs(push), initial=0.0))


def _carried(model: Model, data: RecordData, column: int) -> Real:
    """Inertia forces on the rig when a base accelerates, of masses of size 1, (n,)."""
    n = model.n - len(data.bases.names)
    base = n + column - (model.S.shape[1] - len(data.bases.names))
    masses = model.B[list(model.by_matrix["M"])]
    return masses[:, :n].T @ masses[:, base]


# Inputs that were measured with noise: what is known of them, and what their noise does to the outputs
# (THEORY §9).
#
# The true inputs are unknowns like others, as many as there are samples. Minimised away, to first order
# around the motion that they give, they leave the residuals of the outputs with the covariance V = I + A
# Aᵀ: A carries noise of the inputs to the channels, by the motion's own slopes. V is never formed:
# conjugate gradients solve with it.


HALF_WINDOW = 60  # lines of a cosine transform over which an input's own spectrum is smoothed
ENDS = 8  # samples by which the slopes at the ends of an input are told
SOLVED = 1e-8  # of a column: what the conjugate gradients leave
MOST = 200  # of their steps
EXACT = 1e-9  # of an input's size: noise below it is none


@dataclass(frozen=True)
class KnownInputs:
    """What the measurement says of the inputs of a record, before the outputs: mean (samples, q) and independent errors
    of its lines, `spread` (samples, q), the standard deviations of the coefficients of an orthonormal cosine transform;
    sd (q,) those of the white noise of the samples.
    """

    mean: Real
    spread: Real
    sd: Real

    def moved(self, white: Real) -> Real:
        """The inputs with errors (samples, q) in standard deviations, (samples, q)."""
        return self.mean + idct(self.spread * white, axis=0, norm="ortho")


def known_inputs(measured: Real, sd: Real) -> KnownInputs:
    """From measured inputs (samples, q) with white noise of standard deviations sd (q,).

    Where a part of the band holds no more than noise the input is at rest there: each line is weighed by how far the
    spectrum around it stands out (Wiener 1949).
    """
    lines, smooth = cosine_lines(measured)
    moving = np.maximum(around(lines**2, HALF_WINDOW) - sd**2, 0.0)
    total = moving + sd**2
    share = np.where(total > 0, moving / np.where(total > 0, total, 1.0), 1.0)
    return KnownInputs(smooth + idct(share * lines, axis=0, norm="ortho"), np.sqrt(share) * sd, sd)


def cosine_lines(measured: Real) -> tuple[Real, Real]:
    """Cosine transform of inputs less a smooth course, and that course, both (samples, q)."""
    # The parabola whose slopes at the ends are those of the signal: less it, a cosine transform has no steps
    N = len(measured)
    count = min(ENDS, N)
    basis = np.linalg.pinv(np.vander(np.arange(count) + 0.5, 3, increasing=True))
    first, last = basis[1] @ measured[:count], -basis[1] @ measured[::-1][:count]
    t = np.arange(N)[:, None]
    smooth = first * t + (last - first) * t**2 / (2 * max(N - 1, 1))
    lines: Real = dct(measured - smooth, axis=0, norm="ortho")
    return lines, smooth


def around(power: Real, half_window: int) -> Real:
    """Mean over the nearest 2·half_window + 1 lines (axis 0), fewer at the ends."""
    N = len(power)
    total = np.concatenate([np.zeros((1, *power.shape[1:])), np.cumsum(power, axis=0)])
    first = np.maximum(np.arange(N) - half_window, 0)
    last = np.minimum(np.arange(N) + half_window + 1, N)
    return (total[last] - total[first]) / (last - first).reshape(-1, *[1] * (power.ndim - 1))


class NotSolvedError(Exception):
    """The conjugate gradients do not come to an end: a motion that hangs too much on its inputs."""


@dataclass(frozen=True, eq=False)
class OutputCovariance:
    """V = I + A Aᵀ of one record's residuals, in standard deviations: weight (channels,) are gains over these."""

    tangent: Tangent
    weight: Real
    known: KnownInputs

    def reach(self, white: Real) -> Real:
        """A w: errors of the inputs (samples, q, K) in standard deviations, as the channels show them."""
        moved = idct(self.known.spread[..., None] * white, axis=0, norm="ortho")
        return self.weight[:, None] * self.tangent.times(moved)

    def back(self, residual: Real) -> Real:
        """Aᵀ r, (samples, q, K), of residuals (samples, channels, K)."""
        back = self.tangent.transposed(self.weight[:, None] * residual)
        return self.known.spread[..., None] * dct(back, axis=0, norm="ortho")

    def solve(self, columns: Real) -> Real:
        """V⁻¹ of columns (samples, channels, K).  Raises NotSolvedError."""
        z = np.zeros_like(columns)
        size = np.sqrt(_squares(columns))
        active = np.flatnonzero(size > 0)
        left = columns[..., active]
        near = self._white.solve(left)
        way, gain = near, np.sum(left * near, axis=(0, 1))
        for _ in range(MOST):
            if not len(active):
                return z
            pushed = way + self.reach(self.back(way))
            step = gain / np.sum(way * pushed, axis=(0, 1))
            z[..., active] += step * way
            left = left - step * pushed
            open_ = np.sqrt(_squares(left)) > SOLVED * size[active]
            active, left, way, gain = active[open_], left[..., open_], way[..., open_], gain[open_]
            near = self._white.solve(left)
            after = np.sum(left * near, axis=(0, 1))
            way, gain = near + after / gain * way, after
            if not np.all(np.isfinite(gain)):
                break
        raise NotSolvedError

    @cached_property
    def _white(self) -> ChainSolver:
        """V⁻¹ were the errors of the inputs white in the whole band, which is near enough to begin with."""
        size = np.sqrt(np.mean(self.known.mean**2, axis=0))
        sd = np.maximum(self.known.sd, EXACT * np.where(size > 0, size, 1.0))
        return ChainSolver(self.tangent, self.weight, sd)


@dataclass(frozen=True)
class InputErrors:
    """Errors of a record's inputs that were likeliest at psi (M,), in standard deviations.

    white (samples, q), and their slopes along ψ (samples, q, M).
    """

    psi: Real
    white: Real
    along: Real

    def at(self, psi: Real) -> Real:
        """At a ψ nearby, (samples, q)."""
        return self.white + self.along @ (psi - self.psi)


@dataclass(frozen=True)
class NormalEquations:
    """Of the unknowns `chosen` (P,): squared residuals, minus half their slope (P,), half their curvature (P, P)."""

    chosen: Ints
    cost: float
    gradient: Real
    matrix: Real


@dataclass(frozen=True, eq=False)
class LinearisedRecord:
    """Residuals (samples, channels) of the motion that the inputs give as they are known, to first order around the
    motion with their errors; slopes (samples, channels, P) of what is shown along the unknowns `chosen` (P,).

    drifting: channels whose mean says nothing.
    """

    covariance: OutputCovariance
    residual: Real
    slopes: Real
    chosen: Ints
    drifting: Ints

    def weighed(self, columns: Real) -> Real:
        """V⁻¹ of columns (samples, channels, K) less what constants of the drifting channels explain of them."""
        return self._without_means(self.covariance.solve(columns))

    def _without_means(self, solved: Real) -> Real:
        if not len(self.drifting):
            return solved
        matrix = np.sum(self._means, axis=0)[self.drifting]
        return solved - self._means @ np.linalg.solve(matrix, np.sum(solved, axis=0)[self.drifting])

    @cached_property
    def _means(self) -> Real:
        """V⁻¹ of a constant in each drifting channel, (samples, channels, drifting)."""
        constants = np.zeros((*self.residual.shape, len(self.drifting)))
        constants[:, self.drifting, range(len(self.drifting))] = 1.0
        return self.covariance.solve(constants)

    @cached_property
    def score(self) -> Real:
        """V⁻¹ of the residuals, (samples, channels)."""
        return self.weighed(self.residual[..., None])[..., 0]

    @cached_property
    def weighed_slopes(self) -> Real:
        """V⁻¹ of the slopes, (samples, channels, P)."""
        return self.weighed(self.slopes)

    @property
    def cost(self) -> float:
        """The least of squared residuals and squared errors of the inputs."""
        return float(np.sum(self.residual * self.score))

    def errors(self) -> Real:
        """The likeliest errors of the inputs, (samples, q)."""
        return self.covariance.back(self.score[..., None])[..., 0]

    def errors_along(self) -> Real:
        """Their slopes along the unknowns, (samples, q, P)."""
        return -self.covariance.back(self.weighed_slopes)

    def normal_equations(self) -> NormalEquations:
        """Those of the unknowns, the errors of the inputs being eliminated."""
        gradient = np.einsum("ncp,nc->p", self.slopes, self.score)
        matrix = np.tensordot(self.slopes, self.weighed_slopes, axes=([0, 1], [0, 1]))
        return NormalEquations(self.chosen, self.cost, gradient, (matrix + matrix.T) / 2)


def _squares(columns: Real) -> Real:
    return np.sum(columns**2, axis=(0, 1))


STEP = 0.8  # of a step times the fastest rate of the linear rig
ROUGH = 2  # more steps where laws are not smooth
MOST_RECORD_PROBLEM = 1000  # steps between samples
INNER = 6  # steps for the errors of the inputs at one ψ
NEAR = 1e-3  # of χ², that another of them would lower


@dataclass
class RecordProblem:
    """All that one evaluation needs; `last` holds the last motion of each record, from which the next is found.

    rig: as it is declared; model: as it moves, with bases that are known by a rate as coordinates behind its own.
    begun: states at the starts of the records, of which those constants that cannot be found stay as they are.
    held (laws with a state,): how large the states of laws may be, m.
    Where inputs are uncertain, `errors` holds their last errors, and `covariances` what their noise did to the outputs.
    """

    rig: Model
    model: Model
    records: tuple[RecordData, ...]
    constants: RecordConstants
    begun: tuple[Real, ...]
    held: Real
    gains: int
    sd: Real
    substeps: tuple[int, ...]
    last: dict[int, Motion] = field(default_factory=dict)
    pieces: int = 1  # into which each record was cut
    inputs: tuple[KnownInputs, ...] | None = None  # None: those measured are exact
    errors: dict[int, InputErrors] = field(default_factory=dict)
    covariances: dict[int, OutputCovariance] = field(default_factory=dict)

    @property
    def states(self) -> int:
        """Unknowns of each record: of coordinates, their rates and laws with a state at the start, and of its bases."""
        return self.constants.of_record

    @property
    def inner(self) -> int:
        """Unknowns before those of the records: θ, gains, offsets."""
        return len(self.model.unknowns) + self.gains + len(self.constants.offsets)

    def of_record(self, k: int) -> slice:
        """Where in ψ the unknowns of a record are."""
        first = self.inner + k * self.states
        return slice(first, first + self.states)

    def sizes(self) -> Real:
        """Root mean square of each channel over all records, (channels,)."""
        return np.sqrt(np.mean(np.concatenate([data.outputs for data in self.records]) ** 2, axis=0))

    def motions(self) -> dict[int, Motion]:
        """The last motions as starts for other rigs of the same states."""
        return {k: replace(motion, along=None, forces={}) for k, motion in self.last.items()}

    def motions_of(self, larger: Model) -> dict[int, Motion]:
        """The same for a model with further elements of stop or play behind its own, whose states follow the motion."""
        moved = {}
        new = [(row, law) for row, law in laws_with_state(larger) if row >= len(self.model.elements)]
        for k, motion in self.motions().items():
            intervals = len(motion.state) - 1
            first = segments_of(intervals, segment_length(intervals))
            x, u = motion.state[:, : larger.n], self.records[k].inputs[:, : larger.D.shape[1]]
            states, starts = [motion.state], [motion.starts]
            for row, law in new:
                width = next(c.value for c in law.constants if c.value is not None)
                z = operated_states(law, x @ larger.B[row] + u @ larger.D[row], width)
                states.append(z[:, None])
                starts.append(z[first, None])
            moved[k] = replace(motion, state=np.hstack(states), starts=np.hstack(starts))
        return moved

    @property
    def steps(self) -> int:
        """Steps of all records together."""
        return sum(data.samples * count for data, count in zip(self.records, self.substeps, strict=True))

    def finer(self) -> RecordProblem:
        """The same with half the steps."""
        last = {k: replace(motion, forces={}) for k, motion in self.last.items()}
        return replace(self, substeps=tuple(2 * count for count in self.substeps), last=last)

    def residuals(self, psi: Real, slopes: bool = True) -> list[tuple[Real, Real | None]]:
        """For each record: measured less shown, in standard deviations, and slopes of what is shown, (…, unknowns)."""
        return [self.residual(k, psi, slopes) for k in range(len(self.records))]

    def sure_residuals(self, psi: Real) -> list[tuple[Real, Real | None]]:
        """The same, followed from sample to sample where the last motions are too far off to lead to these."""
        reached = self.residuals(psi)
        if self.last and any(slopes is None for _, slopes in reached):
            self.last = {}
            reached = self.residuals(psi)
        return reached

    def residual(self, k: int, psi: Real, slopes: bool = True) -> tuple[Real, Real | None]:
        """Those of one record."""
        m = len(self.model.unknowns)
        gain = psi[m : m + self.gains]
        data = self.data_at(k, psi)
        machine, start = self.machine(k, psi, data)
        motion = integrate(machine, start, self.last.get(k), slopes=slopes)
        if not motion.closed:
            return np.full_like(data.outputs, np.inf), None
        y, J = shown_outputs(machine, data, motion)
        factor = np.array([1.0 if g < 0 else gain[g] for g in data.gain])
        residual = data.outputs - factor * y
        zero = np.array(data.drift)
        residual = residual - np.where(zero, np.mean(residual, axis=0), 0.0)
        if J is None:
            return residual / self.sd, None
        total = np.zeros((*J.shape[:2], len(psi)))
        free, by_theta = self.constants, machine.states
        total[..., :m] = J[..., by_theta : by_theta + m]
        total[..., m + self.gains : self.inner] = J[..., by_theta + m + free.offsets]
        total[..., self.of_record(k)] = J[..., [*free.starts, *(by_theta + m + free.biases)]]
        total *= factor[:, None]
        for c, g in enumerate(data.gain):
            if g >= 0:
                total[:, c, m + g] = y[:, c]
        total = total - np.where(zero[:, None], np.mean(total, axis=0), 0.0)
        self.last[k] = replace(motion, slope=None)
        if self.inputs is not None:
            along = tangent(machine, motion, data.on_x, data.on_q, data.derivative)
            self.covariances[k] = OutputCovariance(along, factor / self.sd, self.inputs[k])
        return residual / self.sd, total / self.sd[:, None]

    def machine(self, k: int, psi: Real, data: RecordData) -> tuple[Integrator, Real]:
        """What integrates a record at ψ (M,) with the inputs of `data`, and the state (states,) at its start."""
        m, free = len(self.model.unknowns), self.constants
        own = psi[self.of_record(k)]
        offset, start = np.zeros(self.model.S.shape[1]), self.begun[k].copy()
        offset[free.offsets] = psi[m + self.gains : self.inner]
        start[free.starts], offset[free.biases] = np.split(own, [len(free.starts)])
        drive = forcing(data.step_s, data.inputs, data.rated)
        return Integrator(self.model, psi[:m], drive, self.substeps[k], offset), start

    def priors(self) -> tuple[Real, Real]:
        """Precision and mean of ψ before the records say anything, (M,) each.

        What an acceleration lacks is unlikely to be larger than its largest value: else it could be anything while
        springs are taken for linear.  States of laws are no larger than elongations are, else those that leave no
        trace, such as where a play began that was carried along at once, could be anything; but nothing draws them
        anywhere: their mean is NaN.
        """
        M = self.inner + self.states * len(self.records)
        precision, mean = np.zeros(M), np.zeros(M)
        m = len(self.model.unknowns)
        precision[:m], mean[:m] = self.model.prior_precision, self.model.prior_mean
        first = self.model.S.shape[1]  # the force inputs are the last ones
        for k, data in enumerate(self.records):
            stop = self.of_record(k).stop
            largest = np.max(np.abs(data.inputs[:, -first:]), axis=0, initial=0.0) if first else np.zeros(0)
            size = largest[self.constants.biases]
            precision[stop - len(size) : stop] = 1 / np.where(size > 0, size, 1.0) ** 2
            laws = slice(stop - len(size) - len(self.held), stop - len(size))
            precision[laws] = 1 / self.held**2
            mean[laws] = np.nan
        return precision, mean

    def data_at(self, k: int, psi: Real) -> RecordData:
        """A record with the inputs that are taken for the true ones at ψ (M,): those measured where they are exact."""
        data = self.records[k]
        if self.inputs is None:
            return data
        return replace(data, inputs=self.inputs[k].moved(self.errors_at(k, psi)))

    def errors_at(self, k: int, psi: Real) -> Real:
        """The errors of a record's inputs that are likeliest at ψ, in standard deviations, (samples, q); 0 at first."""
        assert self.inputs is not None
        known = self.errors.get(k)
        return np.zeros_like(self.inputs[k].spread) if known is None else known.at(psi)

    def misfit(self, psi: Real) -> float:
        """Sum of squared residuals at ψ (M,), inf where no motion follows."""
        total = sum(float(np.sum(residual**2)) for residual, _ in self.residuals(psi, slopes=False))
        if self.inputs is not None:
            total += sum(float(np.sum(self.errors_at(k, psi) ** 2)) for k in range(len(self.records)))
        return total

    def quadratic(self, psi: Real) -> QuadraticModel:
        """Cost with priors, slope and curvature at ψ (1, M)."""
        M = psi.shape[-1]
        cost, gradient, matrix = 0.0, np.zeros(M), np.zeros((M, M))
        impossible = not np.all(np.isfinite(psi))
        for k in range(0 if impossible else len(self.records)):
            part = self.normal_equations(k, psi[0])
            if part is None:
                impossible = True
                break
            cost += part.cost
            gradient[part.chosen] += part.gradient
            matrix[np.ix_(part.chosen, part.chosen)] += part.matrix
        if impossible:
            nothing = np.full((1, M, M), np.nan)
            return QuadraticModel(np.array([np.inf]), nothing[..., 0], nothing, nothing)
        prior, mean = self.priors()
        away = np.where(np.isnan(mean), 0.0, psi[0] - mean)
        matrix += np.diag(prior)
        total = cost + float(np.sum(prior * away**2))
        return QuadraticModel(np.array([total]), (gradient - prior * away)[None], matrix[None], matrix[None])

    def normal_equations(self, k: int, psi: Real) -> NormalEquations | None:
        """Of one record at ψ (M,); None where no motion follows."""
        if self.inputs is not None:
            linear = self.linearised(k, psi)
            return None if linear is None else linear.normal_equations()
        residual, J = self.residual(k, psi)
        if J is None:
            return None
        flat = J.reshape(-1, len(psi))
        square = float(np.sum(residual**2))
        return NormalEquations(np.arange(len(psi)), square, flat.T @ residual.ravel(), flat.T @ flat)

    def linearised(self, k: int, psi: Real) -> LinearisedRecord | None:
        """A record with uncertain inputs around their likeliest values at ψ (M,); None where no motion follows.

        Raises NotSolvedError where noise of the inputs does more than can be reckoned with.
        """
        own = self.of_record(k)
        chosen = np.concatenate([np.arange(self.inner), np.arange(own.start, own.stop)])
        for turn in range(INNER):
            white = self.errors_at(k, psi)
            residual, J = self.residual(k, psi)
            if J is None:
                return None
            V = self.covariances[k]
            free = residual + V.reach(white[..., None])[..., 0]
            linear = LinearisedRecord(V, free, J[..., chosen], chosen, np.flatnonzero(self.records[k].drift))
            likeliest = linear.errors()
            gained = float(np.sum(residual**2) + np.sum(white**2)) - linear.cost
            near = gained < NEAR or turn == INNER - 1
            along = np.zeros((*white.shape, len(psi)))
            if near:
                along[..., chosen] = linear.errors_along()
            self.errors[k] = InputErrors(psi, likeliest, along)
            if near:
                break
        return linear


def begun_problem(
    rig: Model, records: tuple[RecordData, ...], theta: Real, sd: Real, free: RecordConstants | None = None
) -> tuple[RecordProblem, Real]:
    """The problem of a rig at θ (unknowns,), and the unknowns of the records to begin with, one after another.

    sd (channels,) of the noise; free: which constants of the records are unknown, those that can be found if None.
    Raises ConvergenceError where steps would be too many.
    """
    measured = [recorded_motion(rig, data) for data in records]
    substeps = tuple(
        enough_for_record(rig, theta, data, at) for data, at in zip(records, measured, strict=True)
    )
    moving = moving_rig(rig, records[0].bases)
    if free is None:
        free = record_constants(moving, records[0])
    begun = [start_of(rig, data, at) for data, at in zip(records, measured, strict=True)]
    gains = max((g for data in records for g in data.gain), default=-1) + 1
    states = tuple(start.state for start in begun)
    pairs = zip(records, measured, strict=True)
    held = np.max([largest_states(rig, theta, data, at) for data, at in pairs], axis=0)
    problem = RecordProblem(rig, moving, records, free, states, held, gains, sd, substeps)
    own = [part for start in begun for part in (start.state[free.starts], start.forces[free.biases])]
    return problem, np.concatenate(own)


def enough_substeps(model: Model, theta: Real, step_s: float, motion: tuple[Real, Real] | None = None) -> int:
    """Steps between samples: enough for the fastest mode of the linear part, and for kinks of the laws.

    theta (unknowns,); with a `motion`, coordinates (samples, n) and displacement inputs (samples, r), springs count as
    stiff as they are anywhere in it.  Raises ConvergenceError where steps are more than MOST.
    """
    parts = matrices(model, model.parameters(theta))
    n = model.n
    K = parts.K
    if motion is not None:
        chosen = model.nonlinear
        K = K + (model.B[chosen].T * _stiffest(model, theta, step_s, *motion)) @ model.B[chosen]
    try:
        inverse = np.linalg.inv(parts.M)
    except np.linalg.LinAlgError:
        return 1
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ parts.C]])
    fastest = float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0)) if np.all(np.isfinite(A)) else np.inf
    if not fastest * step_s <= MOST_RECORD_PROBLEM * STEP:
        raise ConvergenceError(
            f"the rig would move at {fastest:.3g} rad/s, far too fast for {1 / step_s:.3g} samples a second",
            cure="check its values, and give guesses of the unknowns",
        )
    rough = any(e.force_law is not None and not e.force_law.smooth for e in model.elements)
    return max(1, int(np.ceil(fastest * step_s / STEP))) * (ROUGH if rough else 1)


def enough_for_record(model: Model, theta: Real, data: RecordData, at: RecordedMotion | None) -> int:
    """`enough_substeps` of a record of a rig, in its motion where that is measured."""
    return enough_substeps(model, theta, data.step_s, None if at is None else (at.x, at.u))


def _stiffest(model: Model, theta: Real, step_s: float, x: Real, u: Real) -> Real:
    """Largest slope of each nonlinear element's force along its elongation in a motion, (e,); 0 of softening ones."""
    chosen = model.nonlinear
    d = x @ model.B[chosen].T + u @ model.D[chosen].T
    v = np.gradient(d, step_s, axis=0)
    p, constants = model.parameters(theta)[chosen], model.inner_constants(theta)
    stiffest = np.zeros(len(chosen))
    for row, (index, inner) in enumerate(zip(chosen, model.constant_slices, strict=True)):
        law = model.elements[int(index)].force_law
        assert law is not None
        at = law(d[:, row], v[:, row], np.zeros(len(d)), constants[inner])
        slopes = p[row] * np.broadcast_to(at.slopes.get("d", 0.0), len(d))
        stiffest[row] = np.max(slopes, initial=0.0, where=np.isfinite(slopes))
    return stiffest
