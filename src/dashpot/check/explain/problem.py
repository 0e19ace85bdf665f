"""What the engine fits: data and a rig, what may be supposed of them, and fits of many at once.

A supposition about the data is another problem of the same shape, so that a whole catalogue of them is one batch; one
about the rig is a problem with another rig.  Either way it can be fitted, scored and supposed upon again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, diagonal_matrices, zeros_for_nan
from dashpot.channel import Channel
from dashpot.check.residuals import blocks_of
from dashpot.data.conditioning.unmeasured import with_likely
from dashpot.data.modal_data import ModalData
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, Unmeasured, WholeRecord, history_of_lines
from dashpot.errors import DashpotError, DataError, ModelError
from dashpot.estimate.likelihood.descent import Stage
from dashpot.estimate.likelihood.global_search import SOFTNESS, candidates, through
from dashpot.estimate.likelihood.measured import Measured
from dashpot.estimate.likelihood.objective import directly_driven, local, measured, predict
from dashpot.estimate.linear.least_squares import compensated
from dashpot.estimate.modal import ModeProblem, check_suited, linear_start
from dashpot.estimate.nonlinear.record_problem import RecordProblem, Trail, begun_problem
from dashpot.estimate.nonlinear.record_regression import first_record_values
from dashpot.estimate.nonlinear.records import arranged
from dashpot.estimate.preparation import Prepared, states_if_seen
from dashpot.model.elements import Element
from dashpot.model.modes import eigenmodes
from dashpot.model.network import Model
from dashpot.model.nonlinear.shooting import Tangent, integrate, tangent
from dashpot.model.observation import (
    ObservationModel,
    calibration_factors,
    measures_input,
    observation_model,
    transfer,
)
from dashpot.numerics.levenberg_marquardt import QuadraticModel, minimise
from dashpot.numerics.small_systems import solve_scaled

# Rigs drawn at random as starts; fewer where all motion is seen and gives a start
DRAWS, FEWER_DRAWS = 1500, 200
FOLLOWED, FEWER_FOLLOWED = 12, 3  # of them that are followed
# Iterations: before the hopeless are left, before the best start is chosen, in all
GLANCE, SHORT, LONG = 3, 8, 30
KEPT = 24  # problems of a batch that are fitted to the end
ROUGHLY = 1e-2  # standard deviations at which a descent ends
LIMIT = 2.0  # nepers and radians beyond which a residual of logarithms counts no more
FAINTEST = 1e-6  # relative noise of channels that have none
NEAR_INPUTS = 1.0  # of an input's size: changes of it that are taken to first order at a first look
LATEST = 0.1  # of a record, within which a late channel is late by a part of it
FINER = 8  # times as many steps, with which a motion is not integrated to be looked at: it is far too fast
SLOWER = 3  # times as many iterations are done where a motion is integrated for each


@dataclass(frozen=True)
class LineProblem:
    """Amplitudes of one repeat of a test and a rig to be fitted to them.

    data    what every method gets: amplitudes NaN where nothing counts
    sign    (channels,) signs of the channels
    starts  ψ (M,) each, from which a fit begins, the best known first
    runs    whether each line was measured at a time of its own, not all of them in one record
    lost    amplitudes that a supposition leaves out, which may have an error of any size, (lines, channels), NaN where
            none was; None where all count
    given_up  log probability of what else a supposition leaves to chance
    """

    data: Prepared
    sign: Real
    starts: tuple[Real, ...]
    runs: bool = True
    lost: Complex | None = None
    given_up: float = 0.0

    @property
    def view(self) -> ObservationModel:
        """What the channels show."""
        return self.data.view

    @property
    def model(self) -> Model:
        """The rig."""
        return self.data.model

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels, in the order of the amplitudes."""
        return self.data.spectrum.channels

    @property
    def spectrum(self) -> Spectrum:
        """The amplitudes as data."""
        return self.data.spectrum

    @property
    def y(self) -> Complex:
        """Amplitudes, (lines, channels), 0 where nothing counts."""
        return zeros_for_nan(self.data.spectrum.amplitudes[0])

    @property
    def kept(self) -> Bools:
        """Which amplitudes count, (lines, channels)."""
        return np.isfinite(self.data.spectrum.amplitudes[0])

    @property
    def counted(self) -> Bools:
        """Which of them test the rig: channels without noise give the inputs."""
        return self.kept & (np.diagonal(self.arranged().W[0], axis1=-2, axis2=-1).real > 0)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns ψ."""
        return self.view.names

    @property
    def noise_known(self) -> bool:
        """Whether the noise is known from more than a fit."""
        return self.data.noise_known

    @property
    def rows(self) -> int:
        """Real numbers that test the rig: those that count, but for what gives the inputs."""
        return self.arranged().rows

    @property
    def dof(self) -> int:
        """Degrees of freedom of a fit."""
        return self.rows - len(self.names)

    @property
    def numbers(self) -> Ints:
        """How many real numbers each amplitude of a channel is, (channels,)."""
        return np.full(len(self.channels), 2)

    @property
    def V(self) -> Complex:
        """Their covariance, (lines, channels, channels)."""
        return self.data.covariance[0]

    @property
    def omega(self) -> Real:
        """Angular frequencies of the lines, (lines,)."""
        return self.view.omega

    @property
    def labels(self) -> list[str]:
        """Lines as dwells are named."""
        return [f"{frequency:g} Hz" for frequency in self.frequency_hz]

    @property
    def frequency_hz(self) -> Real:
        """Of the lines, (lines,)."""
        return self.data.spectrum.frequency_hz

    @cached_property
    def sd(self) -> Real:
        """Of the noise of each amplitude as a complex number, (lines, channels); never 0."""
        return _never_zero(self.variance, self.y)

    @property
    def variance(self) -> Real:
        """Of the noise of each amplitude as it is known, (lines, channels)."""
        return zeros_for_nan(np.diagonal(self.V, axis1=-2, axis2=-1).real)

    def with_amplitudes(self, y: Complex, V: Complex | None = None, kept: Bools | None = None) -> LineProblem:
        """With other amplitudes, their covariance, and which of them count."""
        V = self.V if V is None else V
        kept = self.kept if kept is None else kept
        spectrum = replace(
            self.data.spectrum,
            amplitudes=np.where(kept, y, np.nan)[None],
            covariance=zeros_for_nan(V)[None],
            moments=None,
        )
        return replace(self, data=replace(self.data, spectrum=spectrum, covariance=V[None], states=None))

    def scaled(self, channel: int, factor: Complex | complex) -> LineProblem:
        """With one channel times a factor, a number or (lines,)."""
        turn = np.ones(self.y.shape, dtype=np.complex128)
        turn[:, channel] = factor
        return self.with_amplitudes(self.y * turn, turn[:, :, None] * self.V * np.conj(turn)[:, None, :])

    def late(self, channel: int, late: float) -> LineProblem:
        """With one channel that much (s) earlier than measured.

        Of a whole record its ends have their own clock, and it has not measured the samples at one of them, which may
        be of any size.
        """
        each, given_up = self.channels[channel], self.given_up
        shifted = self.scaled(channel, np.exp(1j * self.omega * late).astype(np.complex128))
        if not self.spectrum.records or each.delay is None:
            return shifted
        size = np.sum(np.abs(self.y[:, channel]) ** 2) / np.sum(self.sd[:, channel] ** 2)
        stretches = list(self.spectrum.stretches)
        for number in () if measures_input(self.model, each) else self.spectrum.records:
            record = stretches[number]
            assert isinstance(record, WholeRecord)
            count = round(late / record.step_s) if abs(late) < LATEST * record.duration_s else 0
            if count:
                samples = (
                    np.arange(record.samples - count, record.samples) if count > 0 else np.arange(-count)
                )
                unknown = np.zeros(len(samples)), np.zeros((len(samples), len(samples)))
                lost = Unmeasured(replace(each, gain=1.0, delay=0.0), samples, *unknown)
                stretches[number] = replace(record, unmeasured=(*record.unmeasured, lost))
                given_up -= len(samples) * 0.5 * (1 + float(np.log(max(size, 1.0))))
        channels = list(self.channels)
        channels[channel] = replace(each, delay=each.delay + late)
        spectrum = replace(shifted.spectrum, stretches=tuple(stretches))
        data = replace(shifted.data, spectrum=spectrum)
        return replace(shifted, data=data, given_up=given_up).of_rig(self.model, tuple(channels))

    def exchanged(self, first: int, second: int, by_column: bool) -> LineProblem:
        """With two channels exchanged: their columns, each read in the unit of the other, or what they show."""
        order = exchanging(len(self.channels), first, second)
        read = read_as(self.channels, order) if by_column else np.ones(len(order))
        V = self.V[:, order][:, :, order] * np.outer(read, read)
        return self.with_amplitudes(self.y[:, order] * read, V, self.kept[:, order])

    def conjugated(self, chosen: Bools) -> LineProblem:
        """With the phases of chosen channels (channels,), or amplitudes (lines, channels), of opposite sign.

        Correlations with the others are lost.
        """
        y = np.where(chosen, np.conj(self.y), self.y)
        both, neither = (at[..., :, None] & at[..., None, :] for at in (chosen, ~chosen))
        return self.with_amplitudes(y, np.where(both, np.conj(self.V), np.where(neither, self.V, 0.0)))

    def without(self, dropped: Bools) -> LineProblem:
        """With some amplitudes (lines, channels) left out, which may have an error of any size."""
        dropped = dropped & self.kept
        before = np.full(dropped.shape, np.nan, dtype=np.complex128) if self.lost is None else self.lost
        lost = np.where(dropped, self.y, before)
        return replace(self.with_amplitudes(self.y, None, self.kept & ~dropped), lost=lost)

    def of_rig(self, model: Model, channels: tuple[Channel, ...] | None = None) -> LineProblem:
        """Of another rig with the same coordinates and inputs, or other channels; new unknowns begin at their guesses.

        An unknown that is new has the guess of its element, or 0.
        """
        spectrum = self.spectrum if channels is None else replace(self.spectrum, channels=channels)
        found = self._of(model, spectrum)
        usual = (*(unknown.guess or 0.0 for unknown in model.unknowns), *found.view.nominal_calibrations)
        return replace(found, starts=_lifted(self, found.names, usual))

    def _of(self, model: Model, spectrum: Spectrum) -> LineProblem:
        """Of another rig, or of the same amplitudes otherwise described."""
        view = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment)
        states = self.data.states
        # What the channels show of a motion does not depend on the elements.
        alike = (model.coordinates, model.inputs) == (self.model.coordinates, self.model.inputs)
        if states is not None and not (alike and spectrum is self.spectrum):
            states = states_if_seen(view, spectrum, self.data.covariance)
        return replace(self, data=replace(self.data, view=view, spectrum=spectrum, states=states))

    def shows(self, element: Element) -> bool:
        """Whether an element more may leave a trace: it moves, whatever it is."""
        return len(element.along) > 0

    def at_rate(self, rate: float) -> LineProblem:
        """With all frequencies times a factor."""
        spectrum = self.data.spectrum
        stretches = tuple(
            replace(each, duration_s=each.duration_s / rate)
            if isinstance(each, WholeRecord)
            else replace(each, fundamental_hz=each.fundamental_hz and rate * each.fundamental_hz)
            for each in spectrum.stretches
        )
        other = replace(spectrum, stretches=stretches, frequency_hz=rate * spectrum.frequency_hz)
        return self._of(self.model, other)

    def at_frequencies(self, frequency_hz: Real) -> LineProblem:
        """With other frequencies (lines,) of the same lines."""
        return self._of(self.model, replace(self.spectrum, frequency_hz=frequency_hz))

    def at_lines(self, lines: Ints) -> LineProblem:
        """Of some of the lines."""
        spectrum = self.data.spectrum.select(lines)
        view = observation_model(self.model, spectrum.channels, spectrum.omega, spectrum.experiment)
        V = self.data.covariance[:, lines]
        data = replace(self.data, view=view, spectrum=spectrum, covariance=V, states=None)
        return replace(self, data=data, lost=None if self.lost is None else self.lost[lines])

    def from_starts(self, starts: Sequence[Real]) -> LineProblem:
        """Begun elsewhere."""
        return replace(self, starts=tuple(starts))

    def arranged(self, softness: float = 0.0) -> Measured:
        """As the likelihood takes them."""
        return measured(self.data, softness)

    def balanced(self) -> LineProblem:
        """Where the motion of a nonlinear rig is sought from that of its linear part, not from the measured one."""
        return replace(self, data=replace(self.data, states=None))

    def begun_beside(self, other: LineProblem) -> LineProblem:
        """The same, where the motion of a nonlinear rig is sought from that which the other, of this rig, came to."""
        here, there = self.arranged().nonlinear, other.arranged().nonlinear
        if here is not None and there is not None:
            here.warm.delta.update(there.warm.delta)
            here.warm.inputs.update(there.warm.inputs)
        return self

    def slopes(self, psi: Real, softness: float = 0.0) -> tuple[Real, Real, float]:
        """Information (M, M), minus half the slope (M,) and χ² at ψ."""
        information, score, chi2 = self.slopes_at(psi[None], softness)
        return information[0], score[0], float(chi2[0])

    def slopes_at(self, psi: Real, softness: float = 0.0) -> tuple[Real, Real, Real]:
        """As `slopes` at several ψ (K, M): (K, M, M), (K, M) and (K,)."""
        sign = np.broadcast_to(self.sign, (len(psi), len(self.sign)))
        with np.errstate(all="ignore"):
            at = local(self.view, self.arranged(softness), psi, sign)
        return at.symmetric, at.gradient, at.cost

    def by_priors(self, psi: Real) -> float:
        """ln of the probability of ψ (M,) by what is stated of the unknowns, 0 at the stated values."""
        return -0.5 * float(np.sum(self.view.prior_precision * (psi - self.view.prior_mean) ** 2))

    def chi2_of_lines(self, psi: Real) -> Real:
        """χ² of each line at ψ (M,), (lines,)."""
        with np.errstate(all="ignore"):
            cost = predict(self.view, self.arranged(), psi[None], self.sign[None]).cost_per_line[0]
        return np.where(np.isfinite(cost), cost, np.inf)

    def left(self, psi: Real) -> Complex:
        """What a fit at ψ (M,) leaves of the amplitudes that count, (lines, channels), 0 elsewhere."""
        with np.errstate(all="ignore"):
            r = predict(self.view, self.arranged(), psi[None], self.sign[None]).r[0]
        return np.where(self.counted, np.nan_to_num(r), 0.0)

    def expected(self, psi: Real) -> Complex:
        """What all channels should show at ψ (M,), those left out as well, (lines, channels)."""
        arranged = self.arranged()
        with np.errstate(all="ignore"):
            q = predict(self.view, arranged, psi[None], self.sign[None]).q
            every = replace(arranged, y=self.y[None], q=q)
            return self.y - predict(self.view, every, psi[None], self.sign[None]).r[0]

    def blocks(self, psi: Real) -> Ints:
        """Lines that one discrepancy makes alike, (lines,)."""
        return _blocks(self.model, psi, self.frequency_hz, self.spectrum.experiment)


@dataclass(frozen=True)
class ModalProblem:
    """Measured modes and a rig to be fitted to them: numbers of each mode, those of the points before the other two.

    data    of one repeat, as it was measured or is supposed
    out     (modes, points + 2) whether a number of a mode is left out: of a point, its frequency, its damping ratio
    """

    model: Model
    data: ModalData
    starts: tuple[Real, ...]
    out: Bools
    given_up: float = 0.0
    noise_known: bool = True

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns ψ."""
        return self.model.unknown_names

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The points, as if a channel showed each."""
        return tuple(Channel(name, {name: 1.0}) for name in self.data.points)

    @property
    def frequency_hz(self) -> Real:
        """Of the modes, (modes,)."""
        return self.data.frequency_hz

    @property
    def _measured(self) -> Complex:
        data = self.data
        return np.column_stack([data.shapes, data.frequency_hz, data.damping_ratio]).astype(np.complex128)

    @property
    def kept(self) -> Bools:
        """Which numbers count, (modes, points + 2)."""
        return np.isfinite(self._measured) & ~self.out

    @property
    def y(self) -> Complex:
        """The numbers, (modes, points + 2), 0 where nothing counts."""
        return np.where(self.kept, np.nan_to_num(self._measured), 0.0)

    @property
    def lost(self) -> Complex | None:
        """Numbers that are left out, NaN elsewhere; of a shape left out whole all but the largest, its scale."""
        out = self.out & np.isfinite(self._measured)
        whole = np.flatnonzero(np.all(self.out, axis=1))
        if len(self.data.points):
            out[whole, np.argmax(np.abs(np.nan_to_num(self.data.shapes[whole])), axis=1)] = False
        return np.where(out, self._measured, np.nan) if np.any(out) else None

    @property
    def counted(self) -> Bools:
        """Which of them test the rig: one point alone is all scale."""
        kept = self.kept
        kept[:, :-2] &= np.sum(kept[:, :-2], axis=1, keepdims=True) > 1
        return kept

    @property
    def numbers(self) -> Ints:
        """How many real numbers each number is, (points + 2,)."""
        return np.append(np.full(len(self.data.points), 2), [1, 1])

    @property
    def variance(self) -> Real:
        """Of the noise of each number as a complex one, (modes, points + 2)."""
        of_shapes = np.diagonal(self.data.shape_covariance, axis1=-2, axis2=-1).real
        return np.column_stack([of_shapes, 2 * np.diagonal(self.data.covariance, axis1=-2, axis2=-1)])

    @property
    def sd(self) -> Real:
        """Its root, never 0, (modes, points + 2)."""
        return _never_zero(self.variance, self.y)

    @cached_property
    def arranged(self) -> ModeProblem:
        """As the search takes them.  Raises DataError where too little is left."""
        data, out = self.data, self.out
        some = ~np.all(out, axis=1)
        unknown = np.where(out[some, -2], data.frequency_hz[some] ** 2, 0.0)
        left = ModalData(
            data.points,
            data.frequency_hz[some],
            np.where(out[some, -1], np.nan, data.damping_ratio[some]),
            data.covariance[some] + unknown[:, None, None] * np.diag([1.0, 0.0]),
            np.where(out[some, :-2], np.nan, data.shapes[some]),
            data.shape_covariance[some],
        )
        return ModeProblem.of(self.model, left)

    @property
    def rows(self) -> int:
        """Numbers that test the rig: a frequency that is left out is in the data still, in noise of its size."""
        some = ~np.all(self.out, axis=1)
        return self.arranged.rows - int(np.count_nonzero(self.out[some, -2]))

    @property
    def dof(self) -> int:
        """Degrees of freedom of a fit."""
        return self.arranged.dof - self.arranged.rows + self.rows

    def from_starts(self, starts: Sequence[Real]) -> ModalProblem:
        """Begun elsewhere."""
        return replace(self, starts=tuple(starts))

    def scaled(self, channel: int, factor: complex) -> ModalProblem:
        """With one point times a factor in all shapes."""
        turn = np.where(np.arange(len(self.data.points)) == channel, factor, 1.0)
        V = turn[:, None] * self.data.shape_covariance * np.conj(turn)
        return replace(self, data=replace(self.data, shapes=self.data.shapes * turn, shape_covariance=V))

    def exchanged(self, first: int, second: int, _: bool) -> ModalProblem:
        """With two points exchanged."""
        order = exchanging(len(self.data.points), first, second)
        V = self.data.shape_covariance[:, order][:, :, order]
        return replace(self, data=replace(self.data, shapes=self.data.shapes[:, order], shape_covariance=V))

    def conjugated(self, chosen: Bools) -> ModalProblem:
        """With the phases of chosen points (points,) of opposite sign."""
        shapes = np.where(chosen, np.conj(self.data.shapes), self.data.shapes)
        return replace(self, data=replace(self.data, shapes=shapes))

    def without(self, dropped: Bools) -> ModalProblem:
        """With some numbers left out, or points (modes, points), which may have an error of any size."""
        wide = np.zeros(self.out.shape, dtype=bool)
        wide[:, : dropped.shape[1]] = dropped
        found = replace(self, out=self.out | wide)
        check_suited(found.model, found.arranged.data)
        return found

    def at_rate(self, rate: float, of_damping: float = 1.0) -> ModalProblem:
        """With all frequencies, and all damping ratios, times a factor."""
        data, factor = self.data, np.array([rate, of_damping])
        return replace(
            self,
            data=replace(
                data,
                frequency_hz=data.frequency_hz * rate,
                damping_ratio=data.damping_ratio * of_damping,
                covariance=data.covariance * np.outer(factor, factor),
            ),
        )

    def of_rig(self, model: Model) -> ModalProblem:
        """Of another rig with the same coordinates; new unknowns begin at their guesses, or at 0."""
        usual = [unknown.guess or 0.0 for unknown in model.unknowns]
        return replace(self, model=model, starts=_lifted(self, model.unknown_names, usual))

    def by_priors(self, psi: Real) -> float:
        """ln of the probability of ψ (M,) by what is stated of the unknowns, 0 at the stated values."""
        return -0.5 * float(np.sum(self.model.prior_precision * (psi - self.model.prior_mean) ** 2))

    def shows(self, element: Element) -> bool:
        """Whether an element more may leave a trace: inputs stand still, so that what leads to one leads to ground."""
        return not set(self.model.displacement_inputs) & set(element.along)

    @property
    def by_equation(self) -> list[Real]:
        """Where least squares on the equation of motion leads, where all is seen; else nothing."""
        found = linear_start(self.arranged)
        return [] if found is None else [found[0]]

    def descended(self, limit: int) -> tuple[Real, float]:
        """The best end, ψ (M,) and χ², of the starts after `limit` iterations at most."""
        starts, model = _finite(self.starts), self.model
        if not len(starts) or not (np.any(model.p0) or np.any(model.prior_precision)):
            return self.starts[0], np.inf  # where nothing is known all may be any times as large
        rows = np.zeros(len(starts), dtype=np.int64)
        if limit == 0:
            cost, x = self.arranged.evaluate(starts, rows).cost, starts
        else:
            ended = self.arranged.search(starts, rows, limit)
            cost, x = ended.cost, ended.x
        cost = np.where(np.isfinite(cost), cost, np.inf)
        best = int(np.argmin(cost))
        return x[best], float(cost[best])

    def slopes(self, psi: Real) -> tuple[Real, Real, float]:
        """Information (M, M), minus half the slope (M,) and χ² at ψ."""
        at = self.arranged.evaluate(psi[None], np.zeros(1, dtype=np.int64))
        return at.symmetric[0], at.gradient[0], float(at.cost[0])

    def left(self, psi: Real) -> Complex:
        """What a fit at ψ (M,) leaves of the numbers that count, (modes, points + 2), 0 elsewhere."""
        return np.where(self.counted, np.nan_to_num(self.y - self.expected(psi)), 0.0)

    def expected(self, psi: Real) -> Complex:
        """What a rig at ψ (M,) has in the place of each number, NaN where it has none, (modes, points + 2)."""
        found: Complex = np.full(self.out.shape, np.nan, dtype=np.complex128)
        found[~np.all(self.out, axis=1)] = np.column_stack(self.arranged.predicted(psi))
        return found

    def blocks(self, psi: Real) -> Ints:
        """Each mode has a discrepancy of its own, (modes,)."""
        return np.arange(len(self.out))


@dataclass(frozen=True)
class Integrated:
    """A motion that was integrated: what the channels show of it (samples, channels), and slopes along ψ, SI units.

    model, names, body, psi  what it is the motion of; slopes None where no motion follows
    """

    model: Model
    names: tuple[str, ...]
    body: RecordProblem
    psi: Real
    inputs: Real
    outputs: Real
    slopes: Real | None

    @staticmethod
    def of(
        model: Model, names: tuple[str, ...], body: RecordProblem, psi: Real, far: bool = True
    ) -> Integrated:
        """The motion at ψ (M,); far: from sample to sample where the last one does not lead to it."""
        data = body.records[0]
        residual, slopes = body.residual(0, psi)
        if slopes is None and far and body.trail.motions:
            body.trail.motions.clear()
            residual, slopes = body.residual(0, psi)
        slopes = None if slopes is None else slopes * body.sd[:, None]
        return Integrated(model, names, body, psi, data.inputs, data.outputs - residual * body.sd, slopes)

    def of_smaller(self, problem: TimeProblem, psi: Real) -> Integrated | None:
        """The same of a rig without elements that do nothing here, at ψ (M,); None where that is another motion."""
        if self.slopes is None or not set(problem.names) <= set(self.names):
            return None
        columns = [self.names.index(name) for name in problem.names]
        rigs = ((self.model, self.psi), (problem.model, psi))
        parts, laws = zip(*(_parts_at(model, x[: len(model.unknowns)]) for model, x in rigs), strict=True)
        if not np.array_equal(self.psi[columns], psi) or parts[0] != parts[1] or laws[0] != laws[1]:
            return None
        slopes = self.slopes[..., columns]
        return Integrated(problem.model, problem.names, problem.body, psi, self.inputs, self.outputs, slopes)

    def leads_to(self, inputs: Real) -> bool:
        """Whether this tells the motion by other inputs (samples, q) well enough for a first look."""
        change = np.sqrt(np.mean((inputs - self.inputs) ** 2))
        return self._times(inputs) is not None or bool(
            change < NEAR_INPUTS * np.sqrt(np.mean(self.inputs**2))
        )

    def _times(self, inputs: Real) -> float | None:
        """How many times as large all inputs are, None where they are others."""
        factor = float(np.sum(inputs * self.inputs) / max(np.sum(self.inputs**2), np.finfo(float).tiny))
        return factor if np.allclose(inputs, factor * self.inputs, rtol=1e-9, atol=0.0) else None

    def driven_by(self, inputs: Real) -> tuple[Real, Real]:
        """`outputs` and `slopes` by inputs (samples, q): as of a linear rig, or to first order in their change."""
        assert self.slopes is not None
        if np.array_equal(inputs, self.inputs):
            return self.outputs, self.slopes
        factor = self._times(inputs)
        if factor is not None:
            return factor * self.outputs, factor * self.slopes
        return self.outputs + self._along.times((inputs - self.inputs)[..., None])[..., 0], self.slopes

    @cached_property
    def _along(self) -> Tangent:
        """What changed inputs do to the channels, to first order."""
        data = self.body.records[0]
        machine, start = self.body.machine(0, self.psi, data)
        motion = integrate(machine, start, self.body.trail.motions.get(0))
        return tangent(machine, motion, data.on_x, data.on_q, data.derivative, data.force)


@dataclass(frozen=True)
class TimeProblem:
    """One record and a nonlinear rig whose motion is integrated (THEORY §9): its numbers are the lines of its samples.

    record  all channels, as measured or supposed
    noise   (channels,) standard deviations of the samples, 0 of inputs, which count as exact
    starts  ψ (M,) each: θ, gains, offsets of forces, and what is unknown of where the record starts
    out     channels that are left out
    seen    what was integrated already; began: the first of it, where the next begin
    """

    model: Model
    record: Record
    noise: Real
    starts: tuple[Real, ...]
    out: frozenset[int] = frozenset()
    given_up: float = 0.0
    noise_known: bool = True
    seen: dict[object, list[Integrated]] = field(default_factory=dict, compare=False, repr=False)
    began: list[RecordProblem] = field(default_factory=list, compare=False, repr=False)

    @staticmethod
    def of(model: Model, record: Record, values: Sequence[Real], noise: Real) -> TimeProblem:
        """A record begun at values of θ and the gains, (unknowns,) each.  Raises as `arranged` and `begun_problem`."""
        empty = TimeProblem(model, record, noise, (values[0],))
        begun = empty.begun
        return replace(empty, starts=tuple(np.concatenate([x, begun[len(x) :]]) for x in values))

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels, in the order of the record."""
        return self.record.channels

    @property
    def _shown(self) -> list[int]:
        """Channels of the motion that count, in the order in which they are integrated."""
        inputs = [measures_input(self.model, channel) for channel in self.channels]
        return [c for c, of_input in enumerate(inputs) if not of_input and c not in self.out]

    @cached_property
    def body(self) -> RecordProblem:
        """What integrates the record.  Raises DataError where it cannot be."""
        return self._begun[0]

    @property
    def begun(self) -> Real:
        """ψ (M,) as the record itself suggests it, the rig as in the first start."""
        return self._begun[1]

    @cached_property
    def _begun(self) -> tuple[RecordProblem, Real]:
        rest = [c for c in range(len(self.channels)) if c not in self.out]
        some = replace(
            self.record,
            channels=tuple(self.channels[c] for c in rest),
            values=self.record.values[:, rest],
            status=None if self.record.status is None else self.record.status[:, rest],
        )
        data = arranged(self.model, some)
        theta = self.starts[0][: len(self.model.unknowns)]
        problem, own = begun_problem(self.model, (data,), theta, self.noise[self._shown])
        gains = [1.0 if gain.nominal is None else gain.nominal for gain in data.gains]
        return problem, np.concatenate([theta, gains, np.zeros(len(problem.constants.offsets)), own])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns ψ."""
        problem = self.body
        free, forces = problem.constants, self.model.force_inputs
        return (
            *self.model.unknown_names,
            *(gain.name for gain in problem.records[0].gains),
            *(f"{forces[j]}.offset" for j in free.offsets),
            *(f"start {j}" for j in free.starts),
            *(f"bias {j}" for j in free.biases),
        )

    @property
    def rows(self) -> int:
        """Real numbers that test the rig."""
        return 2 * len(self._order) * len(self._shown)

    @property
    def dof(self) -> int:
        """Degrees of freedom of a fit."""
        return self.rows - len(self.names)

    @property
    def _order(self) -> Ints:
        """The lines, multiples of 1/T: neither the mean nor half the sampling rate."""
        return np.arange(1, (len(self.record.time) + 1) // 2)

    @property
    def step_s(self) -> float:
        """Sampling step, s."""
        return self.body.records[0].step_s

    @property
    def frequency_hz(self) -> Real:
        """Of the lines, (lines,)."""
        return self._order / (self.step_s * len(self.record.time))

    @property
    def omega(self) -> Real:
        """Angular frequencies of the lines, (lines,)."""
        return 2 * np.pi * self.frequency_hz

    def _lines_of(self, samples: Real) -> Complex:
        lines: Complex = np.fft.rfft(samples, axis=0)[self._order] * (2 / len(samples))
        return lines

    @cached_property
    def _measured(self) -> Complex:
        record = self.record if self.record.status is None else with_likely(self.record)[0]
        return self._lines_of(record.values)

    @property
    def kept(self) -> Bools:
        """Which numbers count, (lines, channels)."""
        there = np.isin(np.arange(len(self.channels)), sorted(self.out), invert=True)
        return np.broadcast_to(there, (len(self._order), len(self.channels)))

    @property
    def counted(self) -> Bools:
        """Which of them test the rig."""
        return self.kept & (self.noise > 0)

    @property
    def y(self) -> Complex:
        """The numbers, (lines, channels), 0 where nothing counts."""
        return np.where(self.kept, self._measured, 0.0)

    @property
    def lost(self) -> Complex | None:
        """Numbers that are left out, NaN elsewhere."""
        return np.where(self.kept, np.nan, self._measured) if self.out else None

    @property
    def numbers(self) -> Ints:
        """How many real numbers each is, (channels,)."""
        return np.full(len(self.channels), 2)

    @property
    def variance(self) -> Real:
        """Of the noise of each as a complex number, (lines, channels)."""
        return np.broadcast_to(4 * self.noise**2 / len(self.record.time), self.kept.shape)

    @property
    def sd(self) -> Real:
        """Its root, never 0, (lines, channels)."""
        return _never_zero(self.variance, self._measured)

    @property
    def spectrum(self) -> Spectrum:
        """The lines as those of a whole record."""
        lines, samples = len(self._order), len(self.record.time)
        V = diagonal_matrices(self.variance).astype(np.complex128)
        whole = WholeRecord(samples * self.step_s, samples)
        many = np.full(lines, samples)
        return Spectrum(
            self.channels,
            self.frequency_hz,
            self._measured,
            V,
            many,
            np.full(lines, np.inf),
            ("floor",) * lines,
            np.zeros(lines, dtype=np.int64),
            stretches=(whole,),
        )

    def from_starts(self, starts: Sequence[Real]) -> TimeProblem:
        """Begun elsewhere."""
        return replace(self, starts=tuple(starts))

    def _with_values(self, values: Real) -> TimeProblem:
        return replace(self, record=replace(self.record, values=values))

    def with_amplitudes(self, y: Complex) -> TimeProblem:
        """With other numbers."""
        added = history_of_lines(y - self._measured, self._order, len(self.record.time))
        return self._with_values(self.record.values + np.where(self.kept[0], added, 0.0))

    def scaled(self, channel: int, factor: Complex | complex) -> TimeProblem:
        """With one channel times a factor, a number or (lines,); its ends go on as they would by reflection."""
        values = np.array(self.record.values)
        if np.ndim(factor) == 0:
            size = float(np.real(np.asarray(factor)))
            values[:, channel] *= size
            noise = np.where(np.arange(len(self.noise)) == channel, abs(size) * self.noise, self.noise)
            return replace(self._with_values(values), noise=noise)
        x = values[:, channel]
        N = len(x)
        wide = np.concatenate([2 * x[0] - x[:0:-1], x, 2 * x[-1] - x[-2::-1]])
        lines, at = np.fft.rfft(wide), np.arange(len(wide) // 2 + 1) * (N / len(wide))
        size = np.interp(at, self._order, np.abs(np.asarray(factor)))
        phase = np.interp(at, np.append(0, self._order), np.append(0.0, np.unwrap(np.angle(factor))))
        values[:, channel] = np.fft.irfft(lines * size * np.exp(1j * phase), len(wide))[N - 1 : 2 * N - 1]
        return self._with_values(values)

    def late(self, channel: int, late: float) -> TimeProblem:
        """With one channel that much (s) earlier than measured."""
        return self.scaled(channel, np.exp(1j * self.omega * late).astype(np.complex128))

    def exchanged(self, first: int, second: int, by_column: bool) -> TimeProblem:
        """With two channels exchanged: their columns, each read in the unit of the other, or what they show."""
        order = exchanging(len(self.channels), first, second)
        read = read_as(self.channels, order) if by_column else np.ones(len(order))
        status = None if self.record.status is None else self.record.status[:, order]
        values = self.record.values[:, order] * read
        noise = self.noise[order] * np.abs(read)
        return replace(self, record=replace(self.record, values=values, status=status), noise=noise)

    def without(self, dropped: Bools) -> TimeProblem:
        """With channels left out, (lines, channels), which may have an error of any size."""
        less = replace(self, out=self.out | frozenset(np.flatnonzero(dropped[0]).tolist()))
        return replace(less, starts=_lifted(self, less.names, less.begun.tolist()))

    def of_rig(self, model: Model, channels: tuple[Channel, ...] | None = None) -> TimeProblem:
        """Of another rig with the same coordinates and inputs, or other channels.

        An unknown that is new has the guess of its element, or 0.
        """
        channels = self.channels if channels is None else channels
        other = replace(self, model=model, record=replace(self.record, channels=channels))
        known = dict(zip(self.names, self.starts[0].tolist(), strict=True))
        theta = [known.get(unknown.name, unknown.guess or 0.0) for unknown in model.unknowns]
        other = replace(other, starts=(np.array(theta),))
        return replace(other, starts=_lifted(self, other.names, other.begun.tolist()))

    def at_rate(self, rate: float) -> TimeProblem:
        """With all frequencies times a factor."""
        return replace(self, record=replace(self.record, time=self.record.time / rate))

    def shows(self, element: Element) -> bool:
        """Whether an element more may leave a trace: it moves against what is known by a rate only."""
        return element.law.power == 2 or not self.body.records[0].bases.hide(self.model, element)

    @property
    def _as_shown(self) -> object:
        """What the channels show, and the step: where these differ, so do the motions."""
        shown = (self.channels[c] for c in self._shown)
        return tuple((each.quantity, tuple(each.of.items())) for each in shown), self.step_s

    def there(self, psi: Real) -> list[Integrated]:
        """What was integrated of this rig at ψ (M,), by whatever inputs."""
        alike = self.seen.setdefault(self._as_shown, [])
        found = [each for each in alike if each.model is self.model and np.array_equal(each.psi, psi)]
        if not found:
            larger = (each.of_smaller(self, psi) for each in alike if len(each.names) > len(psi))
            found = [each for each in larger if each is not None]
            alike += found
        return found

    def moved(self, psi: Real, near: bool = False, far: bool = True) -> tuple[Real, Real] | None:
        """What a motion at ψ (M,) leaves of the samples, in standard deviations (samples, channels), with its slopes.

        (samples, channels, M); None where no motion follows.  near: to first order about one of other inputs, where
        there is one; far: integrated also where no motion that is known leads to it.
        """
        body = self.body
        data, there = body.records[0], self.there(psi)
        at = next((each for each in there if np.array_equal(each.inputs, data.inputs)), None)
        if at is None and near:
            at = next((each for each in there if each.leads_to(data.inputs)), None)
            if at is None and there:
                return None
        if at is None:
            if self.began and max(body.substeps) > FINER * max(self.began[0].substeps):
                return None
            self._led()
            at = Integrated.of(self.model, self.names, body, psi, far)
            if at.slopes is not None or far:
                self.seen[self._as_shown].append(at)
            if not self.began and at.slopes is not None:
                self.began.append(body)
        if at.slopes is None:
            return None
        shown, by = at.driven_by(data.inputs)
        return data.judged(data.outputs - shown) / body.sd, by / body.sd[:, None]

    def glanced(self, far: bool) -> tuple[Real, float]:
        """Where one step of Gauss and Newton leads from the best of the starts, ψ (M,), and χ² as it promises there.

        far: as of `moved`.
        """
        best, least = self.starts[0], np.inf
        for k, psi in enumerate(self.starts):
            at = self.moved(psi, True, far) if k == 0 or self.there(psi) else None
            if at is None:
                continue
            r, J = at[0].ravel(), at[1].reshape(-1, len(psi))
            to = np.clip(psi + solve_scaled(*self._normal(psi, r, J)), *self.body.bounds(psi))
            left = float(np.sum((r - J @ (to - psi)) ** 2))
            if left < least:
                best, least = to, left
        return best, least

    def _led(self) -> None:
        """Let the first motion be sought from the first that was found of all, where its states are the same."""
        body, began = self.body, self.began[0] if self.began else None
        if began is not None and not body.trail.motions and began.begun[0].shape == body.begun[0].shape:
            body.trail.motions.update(began.motions())

    def descended(self, limit: int) -> tuple[Real, float]:
        """Where the best of the starts leads, ψ (M,) and χ², in `limit` // SLOWER iterations at most."""
        best, least = min(((psi, self._chi2(psi, False)) for psi in self.starts), key=lambda each: each[1])
        if not np.isfinite(least):
            best, least = min(((psi, self._chi2(psi)) for psi in self.starts), key=lambda each: each[1])
        if limit and np.isfinite(least):
            body = replace(self.body, trail=Trail(self.body.motions()))
            end = body.descend(best, limit=limit // SLOWER, tolerance=ROUGHLY).x[0]
            self.body.trail.motions.update(body.trail.motions)
            if (cost := self._chi2(end)) < least:
                best, least = end, cost
        return best, least

    def _chi2(self, psi: Real, far: bool = True) -> float:
        at = self.moved(psi, far=far)
        return np.inf if at is None else float(np.sum(at[0] ** 2))

    @property
    def by_equation(self) -> list[Real]:
        """Guesses, or where the weak form of the equation leads, if it leads anywhere."""
        with suppress(DashpotError, np.linalg.LinAlgError):
            theta = first_record_values(self.model, self.body.records)
            if np.all(np.isfinite(theta)):
                return [np.concatenate([theta, self.begun[len(theta) :]])]
        return []

    def slopes(self, psi: Real) -> tuple[Real, Real, float]:
        """Information (M, M), minus half the slope (M,) and χ² at ψ."""
        at = self.moved(psi)
        if at is None:
            return np.full((len(psi), len(psi)), np.nan), np.full(len(psi), np.nan), np.inf
        r, J = at[0].ravel(), at[1].reshape(-1, len(psi))
        return *self._normal(psi, r, J), float(r @ r)

    def _normal(self, psi: Real, r: Real, J: Real) -> tuple[Real, Real]:
        """Information (M, M) and minus half the slope (M,) of residuals (k,) with slopes (k, M), priors included."""
        precision, away = self._priors(psi)
        return J.T @ J + np.diag(precision), J.T @ r - precision * away

    def _priors(self, psi: Real) -> tuple[Real, Real]:
        """Precision of what is stated of the unknowns, and how far ψ is from it, (M,) each."""
        precision, mean = self.body.priors()
        return precision, np.where(np.isnan(mean), 0.0, psi - mean)

    def by_priors(self, psi: Real) -> float:
        """ln of the probability of ψ (M,) by what is stated of the unknowns, 0 at the stated values."""
        precision, away = self._priors(psi)
        return -0.5 * float(np.sum(precision * away**2))

    def left(self, psi: Real) -> Complex:
        """What a motion at ψ (M,) leaves of the numbers that count, (lines, channels), 0 elsewhere."""
        found: Complex = np.zeros(self._measured.shape, dtype=np.complex128)
        at = self.moved(psi)
        found[:, self._shown] = np.nan if at is None else self._lines_of(at[0] * self.body.sd)
        return found

    def expected(self, psi: Real) -> Complex:
        """What all channels should show at ψ (M,), those left out as well, (lines, channels)."""
        if not self.out:
            return self._measured - self.left(psi)
        every = replace(self.from_starts((psi,)), out=frozenset())
        (whole,) = _lifted(self.from_starts((psi,)), every.names, every.begun.tolist())
        return every.expected(whole)

    def blocks(self, psi: Real) -> Ints:
        """Lines that one discrepancy makes alike, (lines,), by the modes of the linear part."""
        return _blocks(self.model, psi, self.frequency_hz, np.zeros(len(self._order), dtype=np.int64))


FitProblem = LineProblem | ModalProblem | TimeProblem  # what they have alike is what the engine asks


def _parts_at(model: Model, theta: Real) -> tuple[dict[str, tuple[float, object]], list[float]]:
    """Of a rig at θ (unknowns,): its elements that do something, by name, and the constants of its laws."""
    parts = dict[str, tuple[float, object]]()
    for each, value in zip(model.elements, model.parameters(theta).tolist(), strict=True):
        if value or each.force_law is not None:
            parts[each.name] = value, each.along
    constants: list[float] = model.inner_constants(theta).tolist()
    return parts, constants


def _blocks(model: Model, psi: Real, frequency_hz: Real, experiment: Ints) -> Ints:
    """`blocks_of` the modes of a rig at ψ (M,), (lines,); each line by itself where it has none."""
    with suppress(ModelError, ValueError, np.linalg.LinAlgError):
        poles = eigenmodes(model, model.parameters(psi[: len(model.unknowns)])).eigenvalues
        if len(poles):
            return blocks_of(frequency_hz, experiment, poles)
    return np.arange(len(frequency_hz))


def exchanging(count: int, first: int, second: int) -> Ints:
    """The order of `count` things, two of which are exchanged."""
    order = np.arange(count)
    order[[first, second]] = second, first
    return order


def read_as(channels: Sequence[Channel], order: Ints) -> Real:
    """What each quantity of another order is multiplied by, as its column is read in the unit and with the gain of the
    channel in whose place it comes, (channels,)."""
    read = np.array([channel.factor / channel.scale for channel in channels])
    return np.asarray(read[order] / read)


def _never_zero(variance: Real, y: Complex) -> Real:
    """Standard deviations of numbers y by their variance, (rows, columns): at the least FAINTEST of a column's size."""
    size = np.sqrt(np.mean(np.abs(y) ** 2, axis=0))
    return np.sqrt(np.maximum(variance, (FAINTEST * np.where(size > 0, size, 1.0)) ** 2))


def _lifted(problem: FitProblem, names: Sequence[str], usual: Sequence[float]) -> tuple[Real, ...]:
    """The starts of a problem as those of another with unknowns `names`, the new ones at their `usual` values."""
    known = [dict(zip(problem.names, psi.tolist(), strict=True)) for psi in problem.starts]
    return tuple(
        np.array([each.get(name, value) for name, value in zip(names, usual, strict=True)]) for each in known
    )


def sd_of_lost(problem: FitProblem) -> Real:
    """Of the noise that numbers which are left out have at the least, (rows, columns).

    A channel without noise is known no better than the quietest that has some.
    """
    lost = problem.lost
    y = problem.y if lost is None else np.where(np.isfinite(lost), lost, problem.y)
    size = np.maximum(np.sqrt(np.mean(np.abs(y) ** 2, axis=0)), np.finfo(float).tiny)
    relative = np.sqrt(np.maximum(problem.variance, 0.0)) / size
    smallest = np.min(relative, where=relative > 2 * FAINTEST, initial=1.0)
    return np.maximum(relative, smallest if smallest < 1 else FAINTEST) * size


def roughly_lost(problem: FitProblem) -> float:
    """Log probability of what is left out, each number being anything of its own size."""
    if problem.lost is None:
        return problem.given_up
    out = np.isfinite(problem.lost)
    lost = np.where(out, np.abs(problem.lost), 0.0)
    size = np.sqrt(np.sum(lost**2, axis=0) / np.maximum(np.sum(out, axis=0), 1))
    ratio = np.maximum(np.maximum(lost, size) / sd_of_lost(problem), 1.0)
    return problem.given_up - float(np.sum((problem.numbers * (0.5 + np.log(ratio)))[out]))


@dataclass(frozen=True)
class FittedProblem:
    """Where a problem's fit ended: ψ (M,), χ² and its degrees of freedom.

    parts  fits of parts of the lines, each with a rig of its own; () where one rig is fitted to all
    """

    problem: FitProblem
    psi: Real
    chi2: float
    dof: int
    parts: tuple[FittedProblem, ...] = ()

    @property
    def reduced(self) -> float:
        """χ² over its degrees of freedom; inf where nothing tests the fit."""
        return self.chi2 / self.dof if self.dof > 0 else np.inf

    @property
    def roughly(self) -> float:
        """The logarithm of the evidence by χ² alone, the noise as large as it must be."""
        if self.dof <= 0 or not np.isfinite(self.chi2):  # nothing tests it
            return -np.inf
        known = self.problem.noise_known
        excess = max(self.reduced, 1.0 if known else 1e-12)
        held = min(self.reduced, 1.0) if known else 1.0
        return roughly_lost(self.problem) - 0.5 * self.dof * (float(np.log(excess)) + held)

    @cached_property
    def slopes(self) -> tuple[Real, Real, float]:
        """Information (M, M), minus half the slope (M,) and χ² where it ended."""
        return self.problem.slopes(self.psi)

    @cached_property
    def residual(self) -> Complex:
        """What the fit leaves of the amplitudes that count, (lines, channels), 0 elsewhere."""
        if self.parts:
            return np.sum([part.residual for part in self.parts], axis=0)
        return self.problem.left(self.psi)

    @cached_property
    def expected(self) -> Complex:
        """What all channels should show, those left out as well, (lines, channels)."""
        return self.problem.expected(self.psi)


def judged(problems: Sequence[FitProblem]) -> list[FittedProblem]:
    """Each problem at its first start, as it is."""
    return _fits(problems, _ended([each.from_starts(each.starts[:1]) for each in problems], 0))


def glanced(problems: Sequence[FitProblem], far: bool = False) -> list[FittedProblem]:
    """Each record as one step of Gauss and Newton from the best of its starts promises; without end where none can.

    far: integrated also where no motion that is known leads to it.
    """
    fits = []
    for each in problems:
        assert isinstance(each, TimeProblem)
        psi, chi2, dof = each.starts[0], np.inf, 0
        with suppress(DashpotError, np.linalg.LinAlgError):
            psi, chi2 = each.glanced(far)
            dof = each.dof
        fits.append(FittedProblem(each, psi, chi2, dof))
    return fits


def fitted_from_starts(problems: Sequence[FitProblem]) -> list[FittedProblem]:
    """Each from the best of its starts to its end."""
    return _fits(problems, _ended(problems, LONG))


def fitted(problems: Sequence[FitProblem], kept: int = KEPT) -> list[FittedProblem]:
    """Each from the best of its starts or its own least squares; the hopeless after a few steps only."""
    if not problems:
        return []
    own = _own([each for each in problems if isinstance(each, LineProblem)])
    begun = [
        each.from_starts((*each.starts, *(own.pop(0) if isinstance(each, LineProblem) else each.by_equation)))
        for each in problems
    ]
    glance = _ended(begun, GLANCE)
    fits = _fits(problems, glance)
    hopeful = np.argsort([-fit.roughly for fit in fits], kind="stable")[:kept].tolist()
    long = _ended([problems[k].from_starts([glance[k][0]]) for k in hopeful], LONG)
    for k, end in zip(hopeful, long, strict=True):
        fits[k] = _fits([problems[k]], [end])[0]
    return fits


def fitted_each(problems: Sequence[FitProblem]) -> list[FittedProblem]:
    """As `fitted`, each to its end."""
    return fitted(problems, kept=len(problems))


def searched(problems: Sequence[LineProblem], seed: int = 0, draws: int = DRAWS) -> list[FittedProblem]:
    """Each from its starts, its own least squares and drawn rigs: thorough, for the few that need it.

    All have the same view.
    """
    if not problems:
        return []
    some = problems[0]
    arranged = [each.arranged() for each in problems]
    drawn, _ = candidates(some.data, draws, np.random.default_rng(seed))
    drawn = drawn[np.all(np.isfinite(drawn), axis=1)]
    with np.errstate(all="ignore"):
        G = transfer(some.view, some.model.parameters(drawn[:, : some.view.m])).G
        signs = np.broadcast_to(some.sign, (len(drawn), len(some.sign)))
        G = calibration_factors(some.view, drawn, signs)[..., None] * G
    own = _own(problems)
    far = [
        drawn[np.argsort(_distance(G, one, each), kind="stable")[: FEWER_FOLLOWED if led else FOLLOWED]]
        for each, one, led in zip(problems, arranged, own, strict=True)
    ]
    unled = [t for t, led in enumerate(own) if not led]
    if unled:
        begun_far = ([problems[t] for t in unled], [arranged[t] for t in unled], [far[t] for t in unled])
        for t, end in zip(unled, _from_afar(*begun_far), strict=True):
            far[t] = end
    begun = [
        each.from_starts((*each.starts, *led, *_finite(ends)))
        for each, led, ends in zip(problems, own, far, strict=True)
    ]
    short = _ended(begun, SHORT)
    long = _ended([each.from_starts([x]) for each, (x, _) in zip(begun, short, strict=True)], LONG)
    return _fits(problems, long)


def _fits(problems: Sequence[FitProblem], ends: Sequence[tuple[Real, float]]) -> list[FittedProblem]:
    return [FittedProblem(each, x, cost, each.dof) for each, (x, cost) in zip(problems, ends, strict=True)]


def _ended(every: Sequence[FitProblem], limit: int) -> list[tuple[Real, float]]:
    """The best end, ψ (M,) and χ², of each problem's starts, after `limit` iterations at most."""
    ends: list[tuple[Real, float]] = [
        (each.starts[0], np.inf) if isinstance(each, LineProblem) else each.descended(limit) for each in every
    ]
    problems = {t: each for t, each in enumerate(every) if isinstance(each, LineProblem)}
    for group in _alike(problems):
        stages = [Stage(problems[t].view, problems[t].arranged()) for t in group]
        starts = [_finite(problems[t].starts) for t in group]
        if not all(len(each) for each in starts):
            starts = [np.stack(problems[t].starts[:1]) for t in group]
        origin = np.repeat(np.arange(len(group)), [len(each) for each in starts])
        psi = np.concatenate(starts)
        sign = np.stack([problems[group[k]].sign for k in origin])
        # Of a nonlinear rig its motion at one start is where that at another is sought from.
        if stages[0].data.nonlinear is not None:
            (stage,) = stages = [replace(stages[0], data=without_raising(stages[0].data))]
            alone = zip(psi[:, None], sign[:, None], strict=True)
            costs = [float(stage.cost(*each, origin[:1])[0]) for each in alone]
            best = int(np.argmin(np.nan_to_num(costs, nan=np.inf)))
            psi, sign, origin = psi[best : best + 1], sign[:1], origin[:1]
        x, cost = _descended(stages, psi, sign, origin, limit)
        for k, t in enumerate(group):
            mine = np.flatnonzero(origin == k)
            best = mine[int(np.argmin(cost[mine]))]
            ends[t] = (x[best], float(cost[best]))
    return ends


def _descended(stages: Sequence[Stage], psi: Real, sign: Real, origin: Ints, limit: int) -> tuple[Real, Real]:
    """Ends ψ (k, M) and χ² (k,), inf where there is none, of starts in the stages `origin` (k,)."""
    if stages[0].data.ends is None:
        stage = Stage(stages[0].view, _stack([each.data for each in stages]))
        if limit == 0:
            return psi, stage.cost(psi, sign, origin)
        return descended(stage.view, stage.data, psi, sign, origin, limit)

    def evaluate(x: Real, active: Ints) -> QuadraticModel:
        of = origin[active]  # ascending, as `active` is
        parts = [(of == k, stages[k]) for k in np.unique(of).tolist()]
        return QuadraticModel.joined([stage.model_at(x[rows], sign[active[rows]]) for rows, stage in parts])

    ended = minimise(evaluate, psi, limit=limit, tolerance=ROUGHLY, patience=limit)
    return ended.x, np.where(np.isfinite(ended.cost), ended.cost, np.inf)


def without_raising(data: Measured) -> Measured:
    """The same data, in which a dwell that a candidate keeps from settling counts as lost: it is not what is wrong."""
    assert data.nonlinear is not None
    return replace(data, nonlinear=replace(data.nonlinear, patient=False, raised=False))


def descended(
    view: ObservationModel, data: Measured, start: Real, sign: Real, rows: Ints, limit: int
) -> tuple[Real, Real]:
    """Ends ψ (k, M) and χ² (k,), inf where there is none, of starts in the repeats `rows`, near enough to compare."""
    with np.errstate(all="ignore"):
        ended = Stage(view, data).descend(start, sign, rows, limit=limit, tolerance=ROUGHLY, patience=limit)
    return ended.x, np.where(np.isfinite(ended.cost), ended.cost, np.inf)


def _finite(rows: Sequence[Real] | Real) -> Real:
    stacked = np.stack(list(rows))
    return stacked[np.all(np.isfinite(stacked), axis=1)]


def _alike(problems: Mapping[int, LineProblem]) -> list[list[int]]:
    """Which problems go together: of one view, with inputs that are given exactly in all or in none; whole records with
    as many unknowns."""
    groups: dict[object, list[int]] = {}
    for t, each in problems.items():
        arranged = each.arranged()
        alike: object = (id(each.view), arranged.q is None)
        if arranged.ends is not None:
            alike = len(each.names)
        groups.setdefault(alike if arranged.nonlinear is None else (t,), []).append(t)
    return list(groups.values())


def _stack(arranged: Sequence[Measured]) -> Measured:
    """One batch with a repeat for each problem."""
    if len(arranged) == 1:
        return arranged[0]
    inputs = [one.q for one in arranged if one.q is not None]
    return Measured(
        np.concatenate([one.y for one in arranged]),
        np.concatenate([one.W[:1] for one in arranged]),
        np.concatenate(inputs) if inputs else None,
        arranged[0].rows,
    )


def _own(problems: Sequence[LineProblem]) -> list[list[Real]]:
    """Noise-compensated least squares of each problem's own lines, (M,), where all is seen there; else nothing."""
    by_equation: list[list[Real]] = [[] for _ in problems]
    groups: dict[tuple[int, bytes], list[int]] = {}
    for t, each in enumerate(problems):
        whole = _whole_lines(each.kept)
        groups.setdefault((id(each.view), whole.tobytes() + each.kept[whole].tobytes()), []).append(t)
    for rows in groups.values():
        some = problems[rows[0]]
        lines, calibrated = np.flatnonzero(_whole_lines(some.kept)), (some.view.gain, some.view.delay)
        if not len(lines) or not some.model.n or any(np.any(each >= 0) for each in calibrated):
            continue
        states = some.data.states
        if states is not None and len(rows) == 1:
            states = states.lines(lines)
        else:
            Y = np.stack([problems[t].data.spectrum.amplitudes[0][lines] for t in rows])
            V = np.stack([problems[t].V[lines] for t in rows])
            part = some.data.spectrum.select(lines)
            spectrum = replace(part, amplitudes=Y, covariance=np.nan_to_num(V), moments=None)
            view = observation_model(some.model, part.channels, part.omega, part.experiment)
            try:
                states = states_if_seen(view, spectrum, V)
            except DataError:  # by rounding where noises differ too much, perhaps in one of them only
                for t in rows if len(rows) > 1 else ():
                    (by_equation[t],) = _own([problems[t]])
                continue
        if states is None:
            continue
        with np.errstate(all="ignore"):
            theta = compensated(some.model, states)
        for t, values in zip(rows, theta, strict=True):
            by_equation[t] = [np.concatenate([values, problems[t].starts[0][len(values) :]])]
    return by_equation


def _whole_lines(kept: Bools) -> Bools:
    """Lines with something in them, (lines,); except one that is partly left out of the test."""
    count = np.sum(kept, axis=1)
    partial = count < np.max(count, initial=0)
    whole = count > 0
    return np.asarray(whole if np.count_nonzero(partial) > 1 else whole & ~partial, dtype=bool)


def _from_afar(
    problems: Sequence[LineProblem], arranged: Sequence[Measured], starts: Sequence[Real]
) -> list[Real]:
    """Where each problem's starts lead by logarithms of the channels, then with softened weights; and by these alone.

    Problems whose inputs no channel shows go through the second stage alone.
    """
    view, sign = problems[0].view, problems[0].sign
    ends = list(starts)
    driven = [directly_driven(view, one) for one in arranged]
    soft = [each.arranged(SOFTNESS) for each in problems]
    groups: dict[tuple[bool, bool], list[int]] = {}
    for t, (one, other) in enumerate(zip(driven, soft, strict=True)):
        groups.setdefault((one is None, other.q is None), []).append(t)
    for group in groups.values():
        stages = [Stage(view, _stack([soft[t] for t in group]))]
        shown = [one for t in group if (one := driven[t]) is not None]
        if shown:
            # What is left out is 0 in its amplitudes, which logarithms pass over.
            stages.insert(0, Stage(view, _stack(shown), np.ones(shown[0].y.shape[1:])))
        psi = np.concatenate([starts[t] for t in group])
        origin = np.repeat(np.arange(len(group)), [len(starts[t]) for t in group])
        signs = np.broadcast_to(sign, (len(psi), len(sign)))
        past, _, rows = through(stages, psi, signs, origin, past=len(psi) if shown else 0, limit=LONG)
        for k, t in enumerate(group):
            ends[t] = past[rows == k]
    return ends


def _distance(G: Complex, exact: Measured, problem: LineProblem) -> Real:
    """How far each drawn rig is from a problem's data, (draws,): bounded logarithms of the channels, even weights."""
    y0 = problem.y
    used = problem.kept & (y0 != 0)
    with np.errstate(all="ignore"):
        if exact.q is not None:
            shown = (G @ exact.q[0][..., None])[..., 0]
        else:
            size = np.where(used, 1 / np.maximum(np.abs(y0), 1e-300), 0.0)
            g, y = G * size[..., None], y0 * size
            gh = np.conj(np.swapaxes(g, -1, -2))
            normal = np.nan_to_num(gh @ g)
            small = 1e-9 * np.trace(normal, axis1=-2, axis2=-1).real + 1e-300
            v = np.linalg.solve(
                normal + small[..., None, None] * np.eye(G.shape[-1]), np.nan_to_num(gh @ y[..., None])
            )
            shown = (G @ v)[..., 0]
        away = np.abs(np.log(np.where(used, y0 / shown, 1.0))) ** 2
    away = np.where(np.isfinite(away), np.minimum(away, LIMIT**2), LIMIT**2)
    return np.sum(np.where(used, away, 0.0), axis=(-2, -1))


def replaced(model: Model, *elements: Element) -> Model:
    """The rig with elements in the place of those of their names, or new ones."""
    by_name = {each.name: each for each in (*model.elements, *elements)}
    return replace(model, elements=tuple(by_name.values()))
