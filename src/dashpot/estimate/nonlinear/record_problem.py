"""Misfit of whole records of a nonlinear rig: measured against the motion that follows by integration (THEORY §9).

Unknown are θ, gains, a constant offset of every force input and, of each record, the state at its start and what the
accelerations of bases lack; where inputs were measured with noise, their true values as well, which each evaluation
finds and leaves out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct

from dashpot.arrays import Bools, Ints, Real
from dashpot.data.noise import smoothed
from dashpot.errors import ConvergenceError
from dashpot.estimate.nonlinear.objective import must_be_positive
from dashpot.estimate.nonlinear.records import (
    RecordData,
    largest_states,
    laws_with_state,
    recorded_motion,
    shown_outputs,
    start_of,
)
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import operated_states
from dashpot.model.nonlinear.integration import Integrator, Motion, does_nothing, forcing, moving_rig
from dashpot.model.nonlinear.shooting import (
    ChainSolver,
    Tangent,
    integrate,
    segment_length,
    segments_of,
    tangent,
)
from dashpot.numerics.levenberg_marquardt import OptimizeResult, QuadraticModel, minimise
from dashpot.unknowns import bounds_of, prior_mean, prior_precision

# Which constants of whole records can be found: states at their starts, and constants that sensors of inputs add.
#
# Where nothing joins the rig to the ground and no channel shows where it is, a base may be anywhere and move at any
# steady velocity: only motion relative to it counts. Such constants are no unknowns.

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
    bases, n = len(data.bases.names), model.n
    rig, forces = n - bases, model.S.shape[1] - bases
    active = [row for row, element in enumerate(model.elements) if not does_nothing(element)]
    law_of = [element.force_law for element in model.elements]
    springs = [row for row in active if model.kinds[row] is Kind.SPRING and law_of[row] is None]
    positional = [row for row in active if (law := law_of[row]) is not None and "d" in law.expression.names]
    channels = list(enumerate(zip(data.derivative, data.drift, strict=True)))
    zeroed = [c for c, (order, drift) in channels if order == 0 and not drift]
    no_position = _hidden(np.concatenate([model.B[[*springs, *positional]], data.on_x[zeroed]]), bases)
    moved = [row for row in active if model.elements[row].law.power < 2]
    shown = [c for c, (order, drift) in channels if order == 0 or (order == 1 and not drift)]
    no_velocity = _hidden(np.concatenate([model.B[moved], data.on_x[shown]]), bases)
    states = sum(law.states for law in law_of if law is not None)
    starts = np.delete(np.arange(2 * n + states), [*no_position, *(n + i for i in no_velocity)])
    # A constant of a force, or of a base's acceleration that pulls at masses of size 1, leaves no trace beyond that
    # of another start in a rig whose laws depend on motion alone and whose springs can carry none of it.
    masses = model.B[list(model.by_matrix["M"])]
    pushes = np.concatenate([model.S[:rig, :forces], masses[:, :rig].T @ masses[:, rig:]], axis=1)
    K = model.B[springs, :rig].T @ model.B[springs, :rig]
    missing = np.max(np.abs(K @ np.linalg.lstsq(K, pushes, rcond=None)[0] - pushes), axis=0, initial=0.0)
    shows = bool(zeroed or positional) | (missing > NONE * np.max(np.abs(pushes), axis=0, initial=0.0))
    biases = [
        forces + j
        for j, order in enumerate(data.bases.orders)
        if order == 2 and (rig + j not in no_velocity or shows[forces + j])
    ]
    return RecordConstants(starts, np.flatnonzero(shows[:forces]), np.array(biases, dtype=np.int64))


def _hidden(rows: Real, bases: int) -> list[int]:
    """Coordinates that may as well stand still, those of bases first: the others move alike without a trace.

    rows (…, n): what a constant of each coordinate stretches or shows.
    """
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    n = rows.shape[1]
    _, values, directions = np.linalg.svd(rows / np.where(size > 0, size, 1.0))
    free = directions[int(np.sum(values > NONE)) :]  # (free, n)
    hidden: list[int] = []
    for i in [*range(n - bases, n), *range(n - bases)] if len(free) else []:
        if np.linalg.matrix_rank(free[:, [*hidden, i]], NONE) > len(hidden):
            hidden.append(i)
    return hidden


# Inputs that were measured with noise: what is known of them, and what their noise does to the outputs (THEORY §9).
#
# The true inputs are unknowns like others, as many as there are samples. Minimised away, to first order around the
# motion that they give, they leave the residuals of the outputs with the covariance V = I + A Aᵀ: A carries noise of
# the inputs to the channels, by the motion's own slopes. V is never formed: conjugate gradients solve with it.

HALF_WINDOW = 60  # lines of a cosine transform over which an input's own spectrum is smoothed


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
    # Less the parabola whose slopes are those of the 8 samples at either end, a cosine transform has no steps.
    N = len(measured)
    count = min(8, N)
    basis = np.linalg.pinv(np.vander(np.arange(count) + 0.5, 3, increasing=True))
    first, last = basis[1] @ measured[:count], -basis[1] @ measured[::-1][:count]
    t = np.arange(N)[:, None]
    smooth = first * t + (last - first) * t**2 / (2 * max(N - 1, 1))
    lines: Real = dct(measured - smooth, axis=0, norm="ortho")
    moving = np.maximum(smoothed(lines**2, HALF_WINDOW) - sd**2, 0.0)
    total = moving + sd**2
    share = np.where(total > 0, moving / np.where(total > 0, total, 1.0), 1.0)
    return KnownInputs(smooth + idct(share * lines, axis=0, norm="ortho"), np.sqrt(share) * sd, sd)


class NotSolvedError(Exception):
    """The conjugate gradients do not come to an end: a motion that hangs too much on its inputs."""


@dataclass(frozen=True, eq=False)
class OutputCovariance:
    """V = I + A Aᵀ of one record's residuals, in standard deviations: weight (channels,) are gains over these."""

    tangent: Tangent
    weight: Real
    known: KnownInputs
    counts: Bools | None = None

    def _seen(self, columns: Real) -> Real:
        return columns if self.counts is None else np.where(self.counts[..., None], columns, 0.0)

    def reach(self, white: Real) -> Real:
        """A w: errors of the inputs (samples, q, K) in standard deviations, as the channels show them."""
        moved = idct(self.known.spread[..., None] * white, axis=0, norm="ortho")
        return self._seen(self.weight[:, None] * self.tangent.times(moved))

    def back(self, residual: Real) -> Real:
        """Aᵀ r, (samples, q, K), of residuals (samples, channels, K)."""
        back = self.tangent.transposed(self._seen(self.weight[:, None] * residual))
        return self.known.spread[..., None] * dct(back, axis=0, norm="ortho")

    def solve(self, columns: Real) -> Real:
        """V⁻¹ of columns (samples, channels, K), to 1e-8 of each.  Raises NotSolvedError."""
        z = np.zeros_like(columns)
        size = np.linalg.norm(columns, axis=(0, 1))
        active = np.flatnonzero(size > 0)
        left = columns[..., active]
        near = self._white.solve(left)
        way, gain = near, np.sum(left * near, axis=(0, 1))
        for _ in range(200):
            if not len(active):
                return z
            pushed = way + self.reach(self.back(way))
            step = gain / np.sum(way * pushed, axis=(0, 1))
            z[..., active] += step * way
            left = left - step * pushed
            open_ = np.linalg.norm(left, axis=(0, 1)) > 1e-8 * size[active]
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
        # Noise below a billionth of an input's size is none.
        sd = np.maximum(self.known.sd, 1e-9 * np.where(size > 0, size, 1.0))
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


@dataclass(frozen=True, eq=False)
class LinearisedRecord:
    """Residuals (samples, channels) of the motion that the inputs give as they are known, to first order around the
    motion with their errors; slopes (samples, channels, P) of what is shown along the unknowns `chosen` (P,).

    drifting: channels whose mean says nothing; inputs: what their noise does to the outputs, None where they are exact:
    then V is 1, and residuals and slopes have no means in drifting channels.
    """

    inputs: OutputCovariance | None
    residual: Real
    slopes: Real
    chosen: Ints
    drifting: Ints

    @property
    def covariance(self) -> OutputCovariance:
        """What noise of inputs does that are uncertain."""
        assert self.inputs is not None
        return self.inputs

    def weighed(self, columns: Real) -> Real:
        """V⁻¹ of columns (samples, channels, K) less what constants of the drifting channels explain of them."""
        if self.inputs is None:
            return columns
        solved = self.inputs.solve(columns)
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

    @property
    def gradient(self) -> Real:
        """Minus half the slope of the cost, (P,), the errors of the inputs being eliminated."""
        return np.einsum("ncp,nc->p", self.slopes, self.score)

    @cached_property
    def matrix(self) -> Real:
        """Half the curvature of the cost, (P, P), likewise."""
        matrix = np.tensordot(self.slopes, self.weighed_slopes, axes=([0, 1], [0, 1]))
        return (matrix + matrix.T) / 2

    def errors(self) -> Real:
        """The likeliest errors of the inputs, (samples, q)."""
        return self.covariance.back(self.score[..., None])[..., 0]

    def errors_along(self) -> Real:
        """Their slopes along the unknowns, (samples, q, P)."""
        return -self.covariance.back(self.weighed_slopes)


@dataclass(frozen=True)
class Trail:
    """What the last evaluations of a problem have found, next to which the next ones begin: motions of the records, and
    the most probable errors of their inputs."""

    motions: dict[int, Motion] = field(default_factory=dict)
    errors: dict[int, InputErrors] = field(default_factory=dict)


@dataclass(frozen=True)
class RecordProblem:
    """The misfit of whole records at any ψ = (θ, gains, offsets, unknowns of each record).

    rig: as it is declared; model: as it moves, with bases that are known by a rate as coordinates behind its own.
    begun: states at the starts of the records, whose constants stay as they are where they cannot be found.
    held (laws with a state,): how large the states of laws may be, m; sd (channels,): of their noise; substeps: steps
    between samples of each record; inputs: None where those measured are exact; pieces: into which each record was cut.
    The trail is no part of what the problem is: it only tells where evaluations begin.
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
    pieces: int = 1
    inputs: tuple[KnownInputs, ...] | None = None
    trail: Trail = field(default_factory=Trail, compare=False)

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

    def columns(self, k: int) -> Ints:
        """Places in ψ of all unknowns that a record depends on."""
        own = self.of_record(k)
        return np.concatenate([np.arange(self.inner), np.arange(own.start, own.stop)])

    def sizes(self) -> Real:
        """Root mean square of each channel over all records, (channels,)."""
        return np.sqrt(np.mean(np.concatenate([data.outputs for data in self.records]) ** 2, axis=0))

    @property
    def steps(self) -> int:
        """Steps of all records together."""
        return sum(data.samples * count for data, count in zip(self.records, self.substeps, strict=True))

    # The same problem otherwise

    def afresh(self) -> RecordProblem:
        """The same without a trail."""
        return replace(self, trail=Trail())

    def motions(self) -> dict[int, Motion]:
        """The last motions as starts for other rigs of the same states."""
        return {k: replace(motion, along=None, forces={}) for k, motion in self.trail.motions.items()}

    def finer(self) -> RecordProblem:
        """The same with half the steps."""
        motions = {k: replace(motion, forces={}) for k, motion in self.trail.motions.items()}
        trail = replace(self.trail, motions=motions)
        return replace(self, substeps=tuple(2 * count for count in self.substeps), trail=trail)

    def with_noise(self, sd: Real, variance: Real) -> RecordProblem:
        """The same with noise of channels, sd (channels,), and of inputs, variance (q,)."""
        inputs = tuple(known_inputs(data.inputs, np.sqrt(variance)) for data in self.records)
        return replace(self, sd=sd, inputs=inputs, trail=Trail(dict(self.trail.motions)))

    def only(self, k: int, psi: Real) -> tuple[RecordProblem, Real]:
        """One record alone with the inputs that are taken for the true ones at ψ (M,), and its ψ; sd are 1."""
        motions = self.motions()
        one = replace(
            self,
            records=(self.data_at(k, psi),),
            begun=(self.begun[k],),
            substeps=(self.substeps[k],),
            inputs=None,
            sd=np.ones(len(self.sd)),
            trail=Trail({0: motions[k]} if k in motions else {}),
        )
        return one, psi[self.columns(k)]

    def with_elements(
        self, psi: Real, elements: Sequence[Element]
    ) -> tuple[RecordProblem, Real, tuple[int, ...]]:
        """The problem with elements that do nothing yet, its ψ (M + count,), and where in it theirs are.

        Laws with a state of their own begin with nothing.
        """
        m, free = len(self.model.unknowns), self.constants
        more = tuple(replace(e, guess=0.0) for e in elements)
        beside = (self.records[0].bases.beside(e) for e in more)
        model = replace(self.model, elements=(*self.model.elements, *beside))
        rig = replace(self.rig, elements=(*self.rig.elements, *more))
        larger = replace(
            self,
            rig=rig,
            model=model,
            records=tuple(data.with_forces_of(rig, len(more)) for data in self.records),
            trail=Trail(self.motions()),
        )
        own = psi[self.inner :].reshape(len(self.records), self.states)
        laws = sum(e.force_law.states for e in more if e.force_law is not None)
        if laws:
            first = len(self.begun[0])
            larger = replace(
                larger,
                constants=replace(free, starts=np.append(free.starts, range(first, first + laws))),
                begun=tuple(np.append(start, np.zeros(laws)) for start in self.begun),
                held=np.append(self.held, np.ones(laws)),
                trail=Trail(self._motions_of(model)),
            )
            own = np.insert(own, [len(free.starts)] * laws, 0.0, axis=1)
        before = dict(zip(self.model.unknown_names, psi[:m].tolist(), strict=True))
        names = list(model.unknown_names)
        at = np.concatenate([[before.get(name, 0.0) for name in names], psi[m : self.inner], own.ravel()])
        for k in range(0 if self.inputs is None else len(self.records)):
            white = self.errors_at(k, psi)
            larger.trail.errors[k] = InputErrors(at, white, np.zeros((*white.shape, len(at))))
        return larger, at, tuple(names.index(e.name) for e in elements)

    def _motions_of(self, larger: Model) -> dict[int, Motion]:
        """The last motions for a model with further elements of stop or play, whose states follow the motion."""
        moved = {}
        new = [(row, law) for row, law in laws_with_state(larger) if row >= len(self.model.elements)]
        for k, motion in self.motions().items():
            intervals = len(motion.state) - 1
            first = segments_of(intervals, segment_length(intervals))
            x, u = motion.state[:, : larger.n], self.records[k].inputs[:, : larger.D.shape[1]]
            states, starts = [motion.state], [motion.starts]
            for row, law in new:
                width = next(c.value for c in law.constants if c.value is not None)
                z = operated_states(law, x @ larger.B[row] + u @ larger.D[row], np.array([width]))
                states.append(z[:, None])
                starts.append(z[first, None])
            moved[k] = replace(motion, state=np.hstack(states), starts=np.hstack(starts))
        return moved

    # Evaluation

    def residuals(self, psi: Real, slopes: bool = True) -> list[tuple[Real, Real | None]]:
        """`residual` of each record."""
        return [self.residual(k, psi, slopes) for k in range(len(self.records))]

    def sure_residuals(self, psi: Real) -> list[tuple[Real, Real | None]]:
        """The same, followed from sample to sample where the last motions are too far off to lead to these."""
        reached = self.residuals(psi)
        if self.trail.motions and any(slopes is None for _, slopes in reached):
            self.trail.motions.clear()
            reached = self.residuals(psi)
        return reached

    def residual(self, k: int, psi: Real, slopes: bool = True) -> tuple[Real, Real | None]:
        """Measured less shown of a record, in standard deviations, and slopes of what is shown along its `columns`.

        (samples, channels) and (samples, channels, columns); inf and None where no motion follows.
        """
        return self.with_covariance(k, psi, slopes=slopes, covariance=False)[:2]

    def with_covariance(
        self, k: int, psi: Real, *, slopes: bool = True, covariance: bool = True
    ) -> tuple[Real, Real | None, OutputCovariance | None]:
        """The same, and what noise of the inputs does to the outputs, where that is wanted and there is any."""
        m = len(self.model.unknowns)
        gain = psi[m : m + self.gains]
        data = self.data_at(k, psi)
        machine, start = self.machine(k, psi, data)
        motion = integrate(machine, start, self.trail.motions.get(k), slopes=slopes)
        if not motion.closed:
            return np.full_like(data.outputs, np.inf), None, None
        y, J = shown_outputs(machine, data, motion)
        factor = np.array([1.0 if g < 0 else gain[g] for g in data.gain])
        residual = data.judged(data.outputs - factor * y) / self.sd
        if J is None:
            return residual, None, None
        free, by_theta = self.constants, machine.states
        total = np.zeros((*J.shape[:2], self.inner + self.states))
        total[..., :m] = J[..., by_theta : by_theta + m]
        total[..., m + self.gains : self.inner] = J[..., by_theta + m + free.offsets]
        total[..., self.inner :] = J[..., [*free.starts, *(by_theta + m + free.biases)]]
        total *= factor[:, None]
        for c, g in enumerate(data.gain):
            if g >= 0:
                total[:, c, m + g] = y[:, c]
        total = data.judged(total) / self.sd[:, None]
        self.trail.motions[k] = replace(motion, slope=None)
        if not covariance or self.inputs is None:
            return residual, total, None
        along = tangent(machine, motion, data.on_x, data.on_q, data.derivative, data.force)
        return residual, total, OutputCovariance(along, factor / self.sd, self.inputs[k], data.counts)

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
        unknowns = (*self.model.unknowns, *self.records[0].gains)
        precision[: len(unknowns)], mean[: len(unknowns)] = prior_precision(unknowns), prior_mean(unknowns)
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
        known = self.trail.errors.get(k)
        return np.zeros_like(self.inputs[k].spread) if known is None else known.at(psi)

    def stacked(self, psi: Real) -> Real:
        """Residuals of all records, one after another, (samples, channels)."""
        return np.concatenate([residual for residual, _ in self.residuals(psi, slopes=False)])

    def noise_left(self, psi: Real) -> Real:
        """Root mean square of what is left of each channel, in standard deviations, (channels,)."""
        every = [np.ones(d.outputs.shape, dtype=bool) if d.counts is None else d.counts for d in self.records]
        left: Real = np.sqrt(np.sum(self.stacked(psi) ** 2, axis=0) / np.sum(np.concatenate(every), axis=0))
        return left

    def misfit(self, psi: Real) -> float:
        """Sum of squared residuals at ψ (M,), inf where no motion follows."""
        total = float(np.sum(self.stacked(psi) ** 2))
        if self.inputs is not None:
            total += sum(float(np.sum(self.errors_at(k, psi) ** 2)) for k in range(len(self.records)))
        return total

    def quadratic(self, psi: Real) -> QuadraticModel:
        """Cost with priors, slope and curvature at ψ (1, M)."""
        M = psi.shape[-1]
        cost, gradient, matrix = 0.0, np.zeros(M), np.zeros((M, M))
        for k in range(len(self.records)):
            part = self.linearised(k, psi[0]) if np.all(np.isfinite(psi)) else None
            if part is None:
                nothing = np.full((1, M, M), np.nan)
                return QuadraticModel(np.array([np.inf]), nothing[..., 0], nothing, nothing)
            cost += part.cost
            gradient[part.chosen] += part.gradient
            matrix[np.ix_(part.chosen, part.chosen)] += part.matrix
        prior, mean = self.priors()
        away = np.where(np.isnan(mean), 0.0, psi[0] - mean)
        matrix += np.diag(prior)
        total = cost + float(np.sum(prior * away**2))
        return QuadraticModel(np.array([total]), (gradient - prior * away)[None], matrix[None], matrix[None])

    def bounds(self, psi: Real) -> tuple[Real, Real]:
        """The rig's for ψ (M,), near it."""
        lower, upper = np.full(len(psi), -np.inf), np.full(len(psi), np.inf)
        m, unknowns = len(self.model.unknowns), (*self.model.unknowns, *self.records[0].gains)
        lower[: len(unknowns)], upper[: len(unknowns)] = bounds_of(unknowns)
        lower[:m], upper[:m] = bounds_near(self.model, psi[:m])
        return lower, upper

    def descend(
        self, psi: Real, limits: tuple[Real, Real] | None = None, limit: int = 60, tolerance: float = 1e-4
    ) -> OptimizeResult:
        """The least misfit from ψ (M,) on, within the `limits` or the `bounds` there, (M,) each."""
        limits = self.bounds(psi) if limits is None else limits
        return least_cost(self.model, self.quadratic, psi, limits, limit, tolerance)

    def linearised(self, k: int, psi: Real) -> LinearisedRecord | None:
        """A record around ψ (M,), its inputs at their likeliest values there; None if no motion follows.

        Raises NotSolvedError if noise of the inputs does more than can be reckoned with.
        """
        chosen = self.columns(k)
        drifting = np.flatnonzero(self.records[k].drift)
        if self.inputs is None:
            residual, J = self.residual(k, psi)
            return None if J is None else LinearisedRecord(None, residual, J, chosen, drifting)
        near = False
        for left in reversed(range(6)):  # steps of Gauss and Newton for the errors of the inputs, at most
            white = self.errors_at(k, psi)
            residual, J, V = self.with_covariance(k, psi)
            if J is None or V is None:
                return None
            free = residual + V.reach(white[..., None])[..., 0]
            linear = LinearisedRecord(V, free, J, chosen, drifting)
            likeliest = linear.errors()
            gained = float(np.sum(residual**2) + np.sum(white**2)) - linear.cost
            near = gained < 1e-3 or not left  # of χ², that another step would lower
            along = np.zeros((*white.shape, len(psi)))
            if near:
                along[..., chosen] = linear.errors_along()
            self.trail.errors[k] = InputErrors(psi, likeliest, along)
            if near:
                break
        return linear


def bounds_near(model: Model, theta: Real) -> tuple[Real, Real]:
    """Of θ (unknowns,); lengths and speeds inside laws stay above 0, where laws would divide by them."""
    lower, upper = bounds_of(model.unknowns)
    return np.where(_lengths(model), np.maximum(lower, 1e-6 * np.abs(theta)), lower), upper


def _lengths(model: Model) -> Bools:
    """Which θ are lengths and speeds inside laws, (unknowns,)."""
    return np.any(model.constants_map[0][must_be_positive(model)] > 0, axis=0)


def least_cost(
    model: Model,
    evaluate: Callable[[Real], QuadraticModel],
    psi: Real,
    limits: tuple[Real, Real],
    limit: int,
    tolerance: float,
) -> OptimizeResult:
    """The least cost from ψ (M,) on, which begins with θ, within limits (M,) each, in `limit` iterations.

    Lengths and speeds inside laws come down tenfold at a time: a step straight to 0 ends where the cost no longer
    depends on them.
    """
    lower, upper = limits
    lengths, iterations = np.zeros(len(psi), dtype=bool), 0
    lengths[: len(model.unknowns)] = _lengths(model)
    while True:
        low = np.where(lengths, np.maximum(lower, 0.1 * psi), lower)
        end = minimise(
            lambda x, _: evaluate(x),
            psi[None],
            limit=limit - iterations,
            tolerance=tolerance,
            lower=low,
            upper=upper,
            patience=limit,
        )
        psi, iterations = end.x[0], iterations + int(end.iterations[0])
        if iterations >= limit or not np.any((psi <= low) & (low > lower)):
            return replace(end, iterations=np.array([iterations]))


def begun_problem(
    rig: Model, records: tuple[RecordData, ...], theta: Real, sd: Real, free: RecordConstants | None = None
) -> tuple[RecordProblem, Real]:
    """The problem of a rig at θ (unknowns,), and the unknowns of the records to begin with, one after another.

    sd (channels,) of the noise; free: which constants of the records are unknown, those that can be found if None.
    Raises ConvergenceError if steps would be too many.
    """
    measured = [recorded_motion(rig, data) for data in records]
    pairs = list(zip(records, measured, strict=True))
    substeps = tuple(
        enough_substeps(rig, theta, data.step_s, None if at is None else (at.x, at.u)) for data, at in pairs
    )
    moving = moving_rig(rig, records[0].bases)
    if free is None:
        free = record_constants(moving, records[0])
    begun = [start_of(rig, data, at) for data, at in pairs]
    gains = len(records[0].gains)
    states = tuple(state for state, _ in begun)
    held = np.max([largest_states(rig, theta, data, at) for data, at in pairs], axis=0)
    problem = RecordProblem(rig, moving, records, free, states, held, gains, sd, substeps)
    own = [part for state, forces in begun for part in (state[free.starts], forces[free.biases])]
    return problem, np.concatenate(own)


def enough_substeps(model: Model, theta: Real, step_s: float, motion: tuple[Real, Real] | None = None) -> int:
    """Steps between samples: enough for the fastest mode of the linear part, twice as many for kinks of the laws.

    theta (unknowns,); with a `motion`, coordinates (samples, n) and displacement inputs (samples, r), springs count as
    stiff as they are anywhere in it.  Raises ConvergenceError if steps are more than 1000.
    """
    parts = matrices(model, model.parameters(theta))
    n, K, chosen = model.n, parts.K, model.nonlinear
    if motion is not None:
        # The largest slope of each nonlinear element's force along its elongation, (e,); 0 of softening ones
        x, u = motion
        d = x @ model.B[chosen].T + u @ model.D[chosen].T
        v, nothing = np.gradient(d, step_s, axis=0), np.zeros(len(d))
        p, constants = model.parameters(theta)[chosen], model.inner_constants(theta)
        stiffest = np.zeros(len(chosen))
        for row, (law, inner) in enumerate(zip(model.laws, model.constant_slices, strict=True)):
            along = law(d[:, row], v[:, row], nothing, constants[inner]).slopes.get("d", 0.0)
            slopes = p[row] * np.broadcast_to(along, len(d))
            stiffest[row] = np.max(slopes, initial=0.0, where=np.isfinite(slopes))
        K = K + (model.B[chosen].T * stiffest) @ model.B[chosen]
    try:
        inverse = np.linalg.inv(parts.M)
    except np.linalg.LinAlgError:
        return 1
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ parts.C]])
    fastest = float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0)) if np.all(np.isfinite(A)) else np.inf
    steps = fastest * step_s / 0.8  # of a step times the fastest rate
    if not steps <= 1000:
        raise ConvergenceError(
            f"the rig would move at {fastest:.3g} rad/s, far too fast for {1 / step_s:.3g} samples per "
            "second",
            cure="check its values, and give initial guesses of the unknowns",
        )
    rough = any(e.force_law is not None and not e.force_law.smooth for e in model.elements)
    return max(1, int(np.ceil(steps))) * (2 if rough else 1)
