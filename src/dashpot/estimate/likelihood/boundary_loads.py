"""Boundary loads of whole records: what the two ends of a record add to all of its lines (THEORY §8, W).

D X = R U + S f + a + jω b, with a, b ∈ Rⁿ free: an impulse and a doublet at every coordinate.  What the ends alias, and
what they add to velocities and accelerations, is known where no input is elsewhere at the end than at the beginning
(`sampled_loads`); else it is taken by the real columns 1, jω, (jω)² … of each output channel.  All of them enter
linearly; they are projected out of each record after the inputs have been out of each line, by a basis that leaves out
columns which depend on each other.

Samples that a channel has not measured are further unknowns: an error of what is put in for each is one column
e^{−jωt} in all lines of that channel, so that the fit is the one of the samples that are there.

The loads are force inputs of a larger rig, one at every coordinate, so that its transfer gives their response, and its
unit forces are those of the whole motion.  Slopes by the driven motion alone lead the iteration astray: slowly, and
with a spread of up to twice what it states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb
from typing import cast

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, frozen, zeros_for_nan
from dashpot.data.spectrum import Spectrum, WholeRecord
from dashpot.errors import DataError
from dashpot.model.dynamics import matrices
from dashpot.model.network import pushed_everywhere
from dashpot.model.observation import ObservationModel, observation_model, small
from dashpot.numerics.small_systems import (
    FREE,
    orthonormal,
    real_rows,
    scaled_inverse,
    whitening_steps,
    with_known_last,
)

# What sampling folds back of the motion that the ends of a record leave free (THEORY §8).
#
# The boundary loads of (W) are those of a finite Fourier integral; lines are sums over samples. By Euler
# and Maclaurin h Σ f(nh), of a motion that begins at 0, exceeds its integral by (h/2) f(0) − (h²/12) f'(0)
# + (h⁴/720) f'''(0) − …, with f(t) = y(t) e^{−st}: a polynomial in s = jω made of the first derivatives of
# the free motion. These the equation of motion gives: an impulse is answered by D⁻¹ = Σ Γ_q s^{−q},
# y^{(k)}(0) = Γ_{k+1}, with M Γ_2 = 1 and M Γ_q = −C Γ_{q−1} − K Γ_{q−2}. Known like this it costs nothing;
# polynomials fitted in its place cost a free decay several per cent of its precision.


# Power of h, derivative of f, factor.
SUM_BEYOND_INTEGRAL = (
    (1, 0, 1 / 2),
    (2, 1, -1 / 12),
    (4, 3, 1 / 720),
    (6, 5, -1 / 30240),
    (8, 7, 1 / 1209600),
)
POWERS = 8  # of s, from 1 to s⁷
LAST = 11  # of the Γ: a doublet's, in an acceleration, and its seventh derivative


@dataclass(frozen=True)
class SampledLoads:
    """What channels show beyond the response to an impulse (0) and a doublet (1) at each coordinate, of each record.

    Coefficients of powers of s = jω over the record's highest ω.
    terms (K, records, 2, powers, channels, n); slopes (K, records, 2, powers, channels, n, unknowns of the rig)
    """

    terms: Real
    slopes: Real

    def at(self, record: int, s: Complex) -> Complex:
        """At some lines of a record, under unit loads: (K, channels, 2 n, lines)."""
        K, loads, powers, channels, n = self.terms[:, record].shape
        terms = np.transpose(self.terms[:, record], (0, 3, 1, 4, 2)).reshape(K, channels, loads * n, powers)
        return terms @ _powers(s)

    def slopes_at(self, record: int, s: Complex, loads: Real) -> Complex:
        """By the unknowns of the rig under loads (K, 2 n): (K, channels, unknowns of the rig, lines)."""
        slopes = self.slopes[:, record]
        by_loads = np.moveaxis(slopes, 4, 2).reshape(len(slopes), loads.shape[-1], *slopes.shape[2:4], -1)
        terms = np.einsum("kjpcm,kj->kcmp", by_loads, loads)
        return terms @ _powers(s)


def shows_sampled_loads(view: ObservationModel) -> Bools:
    """Where they are known, (channels,): in motions on the record's own clock, of a rig with mass everywhere."""
    model = view.model
    ones = np.ones(len(model.elements))
    if not small(model) or np.linalg.matrix_rank(matrices(model, ones).M) < model.n:
        return np.zeros(len(view.channels), dtype=bool)
    on_time = np.array([channel.delay == 0 for channel in view.channels], dtype=bool)
    known = on_time & (view.gain < 0) & ~view.flips & ~np.any(view.force, axis=-1)
    return known & np.any(view.on_x, axis=-1)


def sampled_loads(view: ObservationModel, known: Bools, p: Real, step: Real, highest: Real) -> SampledLoads:
    """Those of a rig with parameters p (K, elements) in records of sampling step (records,) s and highest ω, rad/s.

    0 in channels in which they are not `known`, (records, channels).  Not finite where the masses are singular.
    """
    # Γ_0 … Γ_LAST (LAST + 1, K, n, n), and their slopes by the unknowns (LAST + 1, K, unknowns, n, n)
    model = view.model
    at, by = matrices(model, p), matrices(model, np.ascontiguousarray(model.T.T))
    with np.errstate(all="ignore"):
        inverse = scaled_inverse(at.M)
    shape = (LAST + 1, len(p), model.n, model.n)
    gamma = np.zeros(shape)
    by_unknown = np.zeros((*shape[:2], len(by.M), *shape[2:]))
    gamma[2] = inverse
    for q in range(2, LAST + 1):
        if q > 2:
            gamma[q] = -inverse @ (at.C @ gamma[q - 1] + at.K @ gamma[q - 2])
        right = by.M @ gamma[q][:, None] + by.C @ gamma[q - 1][:, None] + by.K @ gamma[q - 2][:, None]
        right += at.C[:, None] @ by_unknown[q - 1] + at.K[:, None] @ by_unknown[q - 2]
        by_unknown[q] = -inverse[:, None] @ right
    on_x = view.on_x * known[:, :, None]
    # What sums over samples exceed integrals by, as factors of the Γ, (records, derivatives, 2, powers, Γ), of channels
    # that show the motion and its first two derivatives; without their impulses, which no sample shows
    beyond = np.zeros((len(step), 3, 2, POWERS, LAST + 1))
    for derivative in range(3):
        for load in range(2):
            order = derivative + load
            for power in range(order - 1):
                beyond[:, derivative, load, power, order - power] -= 1
            for height, k, factor in SUM_BEYOND_INTEGRAL:
                for power in range(k + 1):
                    of_jump = factor * comb(k, power) * (-1) ** power * step**height
                    beyond[:, derivative, load, power, order + 1 + k - power] += of_jump
    # From powers of jω to those of s, and from a doublet jω to the column s
    scale = highest[:, None, None] ** (np.arange(POWERS) - np.arange(2)[:, None])
    # (records, channels, 2, powers, Γ)
    weight = (beyond * scale[:, None, :, :, None])[:, view.derivative]
    terms = np.einsum("rclpq,rci,qkij->krlpcj", weight, on_x, gamma, optimize=True)
    slopes = np.einsum("rclpq,rci,qkmij->krlpcjm", weight, on_x, by_unknown, optimize=True)
    return SampledLoads(terms, slopes)


def _powers(s: Complex) -> Complex:
    """1, s, s² and so on, (powers, lines)."""
    return s ** np.arange(POWERS)[:, None]


@dataclass(frozen=True)
class UnmeasuredColumns:
    """Those of one record: channel (k,), columns (lines of the record, k), and what is known beforehand, (k, k)."""

    channel: Ints
    columns: Complex
    precision: Real

    @staticmethod
    def of(value: WholeRecord, spectrum: Spectrum, lines: Ints) -> UnmeasuredColumns:
        """With the noise of lines counted as |Δ|², so that half of the precision is added to products of columns."""
        each = value.unmeasured
        counts = [len(part.samples) for part in each]
        precision, first = np.zeros((sum(counts), sum(counts))), 0
        for part, count in zip(each, counts, strict=True):
            own = slice(first, first + count)
            precision[own, own], first = part.precision / 2, own.stop
        columns = [np.zeros((len(lines), 0)), *(part.columns(spectrum.omega[lines], value) for part in each)]
        channel = [spectrum.index(part.channel.name) for part in each]
        return UnmeasuredColumns(
            np.repeat(np.array(channel, dtype=np.int64), counts), np.concatenate(columns, axis=1), precision
        )

    def in_channels(self, channels: int) -> Complex:
        """(lines of the record, channels, k)."""
        out = np.zeros((len(self.columns), channels, len(self.channel)), dtype=np.complex128)
        out[:, self.channel, np.arange(len(self.channel))] = self.columns
        return out


def with_means_of_unmeasured(spectrum: Spectrum) -> Complex:
    """Amplitudes, 0 where there are none, with the means of what samples that are not measured are off by."""
    y = np.array(zeros_for_nan(spectrum.amplitudes))
    for number, value in enumerate(spectrum.stretches):
        if isinstance(value, WholeRecord) and value.unmeasured:
            lines = np.flatnonzero(spectrum.stretch == number)
            for of in value.unmeasured:
                y[..., lines, spectrum.index(of.channel.name)] += (
                    of.columns(spectrum.omega[lines], value) @ of.mean
                )
    return y


RAMP = -1  # the power of jω that a linear drift has


@dataclass(frozen=True)
class RecordEnds:
    """The columns that the ends of each record bring; constants of one search.

    rig      the channels of the rig itself
    view     the rig with a force input at every coordinate, behind its own inputs
    lines    of each record
    s        (lines,) jω over the highest ω of the record
    loads    (records,) whether boundary loads are among the columns
    terms    (records, polynomials) which polynomial columns are
    channel, power (polynomials,): a column is s^power in one channel
    by_input (lines, r + s, polynomials): how inputs that are taken as exact follow from a channel's polynomial; 0
             where the channel is one of the data
    sampled  (records, channels): where all that sampling folds back is known from the free motion (`sampled_loads`)
    step, highest (records,) sampling step, s, and highest ω, rad/s
    unmeasured of each record
    """

    rig: ObservationModel
    view: ObservationModel
    inputs: int
    lines: tuple[Ints, ...]
    s: Complex
    loads: Bools
    terms: Bools
    channel: Ints
    power: Ints
    by_input: Complex
    sampled: Bools
    step: Real
    highest: Real
    unmeasured: tuple[UnmeasuredColumns, ...]

    @property
    def n(self) -> int:
        """Coordinates."""
        return self.view.model.n

    @property
    def count(self) -> int:
        """Columns: two loads for each coordinate, and the polynomials."""
        return 2 * self.n + len(self.channel)

    @property
    def missing(self) -> int:
        """Unknowns of the record that has most samples which are not measured."""
        return max(len(of.channel) for of in self.unmeasured)

    def sampled_loads(self, psi: Real) -> SampledLoads | None:
        """What sampling adds to the loads of a rig with unknowns ψ (K, M); None if it is known of no channel."""
        if not np.any(self.sampled):
            return None
        p = self.rig.model.parameters(psi[:, : self.rig.m])
        found: SampledLoads | None = None
        for model, records in self.rig.model.by_experiment(self.experiment):
            part = sampled_loads(replace(self.rig, model=model), self.sampled, p, self.step, self.highest)
            found = part if found is None else found
            found.terms[:, records], found.slopes[:, records] = (
                part.terms[:, records],
                part.slopes[:, records],
            )
        return found

    @property
    def experiment(self) -> Ints | None:
        """In which experiment each record was measured, (records,), of a rig that differs by experiment."""
        of_lines = self.rig.experiment
        return None if of_lines is None else np.array([of_lines[lines[0]] for lines in self.lines])

    def polynomials(self) -> Complex:
        """Columns of the polynomials in the channels that are data, (lines, channels, polynomials)."""
        columns = np.zeros((len(self.s), len(self.view.channels), len(self.channel)), dtype=np.complex128)
        inside = (self.s != 0)[:, None]
        powers = np.where(inside, np.where(inside, self.s[:, None], 1.0) ** self.power, 0.0)
        columns[:, self.channel, np.arange(len(self.channel))] = powers
        return columns

    def used(self, record: int) -> Bools:
        """Which of the columns one record has, (columns,)."""
        loads = np.full(2 * self.n, self.loads[record])
        return np.concatenate([loads, self.terms[record]])


def with_loads(view: ObservationModel) -> ObservationModel:
    """The same channels of the rig with a force input at every coordinate, behind its own inputs."""
    model = view.model
    when = None if view.experiment is None else view.experiment.tobytes()
    key = (with_loads, *map(id, view.channels), view.omega.tobytes(), when)
    if key not in model.views:
        driven = pushed_everywhere(model)
        model.views[key] = observation_model(driven, view.channels, view.omega, view.experiment)
    return cast(ObservationModel, model.views[key])


def record_ends(
    view: ObservationModel, spectrum: Spectrum, exact: Complex | None = None
) -> RecordEnds | None:
    """The columns of a spectrum's whole records; None if it has none with loads or polynomials.

    `exact` (lines, r + s, channels) gives the inputs from channels that are taken as exact.
    """
    records = [
        (value, np.flatnonzero(spectrum.stretch == number))
        for number, value in enumerate(spectrum.stretches)
        if isinstance(value, WholeRecord)
        and (value.loads or value.polynomial or value.ramp or value.unmeasured)
    ]
    if not records:
        return None
    outputs = ~view.inputs_alone
    # Channel and power of jω of every polynomial column that some record may have. A moved base measured as velocity
    # or acceleration has end terms of its own; other inputs have none.
    powers = [*range(max(value.polynomial for value, _ in records))]
    powers += [RAMP] if any(value.ramp for value, _ in records) else []
    own = [powers if output else [*range(int(view.derivative[c]))] for c, output in enumerate(outputs)]
    of = np.repeat(np.arange(len(own)), [len(each) for each in own])
    height = np.array([power for each in own for power in each], dtype=np.int64)
    s = np.zeros(spectrum.lines, dtype=np.complex128)
    highest = np.array([np.max(spectrum.omega[lines]) for _, lines in records])
    sampled = np.zeros((len(records), len(outputs)), dtype=bool)
    terms_used = np.zeros((len(records), len(of)), dtype=bool)
    measured = np.any(np.isfinite(spectrum.amplitudes.reshape(-1, *spectrum.amplitudes.shape[-2:])), axis=0)
    for number, (value, lines) in enumerate(records):
        s[lines] = 1j * spectrum.omega[lines] / highest[number]
        there = np.any(measured[lines], axis=0)
        wanted = np.where(height == RAMP, value.ramp, height < value.polynomial)
        if value.loads and not _inputs_jump(view, spectrum, lines):
            sampled[number] = shows_sampled_loads(view)
        wanted &= (height == RAMP) | ~sampled[number, of]
        terms_used[number] = (wanted | ~outputs[of]) & there[of]
    _require_lines(records, view, loads=2 * view.model.n, terms=terms_used)
    # How inputs follow from the polynomials of channels that give them
    shape = (len(s), view.on_q.shape[1], len(of))
    given = np.flatnonzero(np.any(exact != 0, axis=(0, 1))[of]) if exact is not None else of[:0]
    by_input = np.broadcast_to(np.complex128(0), shape)  # takes no memory; there may be many lines
    if exact is not None and len(given):
        by_input = np.zeros(shape, dtype=np.complex128)
        by_input[:, :, given] = -exact[:, :, of[given]] * (s[:, None] ** height[given])[:, None, :]
    return RecordEnds(
        view,
        with_loads(view),
        view.on_q.shape[1],
        tuple(lines for _, lines in records),
        s,
        np.array([value.loads for value, _ in records]),
        terms_used,
        of,
        height,
        by_input,
        sampled,
        np.array([value.step_s for value, _ in records]),
        highest,
        tuple(UnmeasuredColumns.of(value, spectrum, lines) for value, lines in records),
    )


def _inputs_jump(view: ObservationModel, spectrum: Spectrum, lines: Ints) -> bool:
    """Whether inputs may be elsewhere at the end of a record than at its beginning, so that sampling folds them back.

    Base motions are taken to; forces are where they move about the ends as far as the band shows them.
    """
    if view.model.D.shape[1]:
        return True
    if not view.model.S.shape[1]:
        return False
    inputs = spectrum.amplitudes[..., lines, :][..., view.inputs_alone]
    if not np.any(view.inputs_alone) or not np.all(np.isfinite(inputs)):
        return True
    phase = spectrum.omega[lines] / np.max(spectrum.omega[lines]) * np.pi
    # Within eight half periods of the band's highest line about the ends, two samples each
    turned, half = np.exp(-8j * phase), np.exp(0.5j * phase)
    ends = np.zeros((*inputs.shape[:-2], 33, inputs.shape[-1]))
    for sample in range(ends.shape[-2]):
        ends[..., sample, :] = (turned @ inputs).real
        turned = turned * half
    size = np.sqrt(np.sum(np.abs(inputs) ** 2, axis=-2, keepdims=True) / 2)
    return bool(np.any(np.ptp(ends, axis=-2, keepdims=True) > 0.02 * size))


def _require_lines(
    records: list[tuple[WholeRecord, Ints]], view: ObservationModel, loads: int, terms: Bools
) -> None:
    """Raises DataError if the records have no more equations than loads and polynomials."""
    outputs = int(np.sum(~view.inputs_alone))
    equations = [2 * len(lines) * outputs for _, lines in records]
    columns = [
        loads * value.loads + int(np.sum(used)) for (value, _), used in zip(records, terms, strict=True)
    ]
    if any(e > c for e, c in zip(equations, columns, strict=True)):
        return
    worst = int(np.argmax(equations))
    value, lines = records[worst]
    raise DataError(
        f"a record of {value.duration_s:.4g} s has only {len(lines)} lines in the band: "
        f"{equations[worst]} real equations for {columns[worst]} start and end transient terms",
        cure="widen the band, or record for longer",
    )


@dataclass(frozen=True)
class Projector:
    """Least squares on the columns of each record, real coefficients.

    lines: of each record; bases: (Q, B, step) of each as `orthonormal` and `with_prior` give them, the columns having
    unit noise and the inputs taken out; rank (K,) of all records together
    """

    lines: tuple[Ints, ...]
    bases: tuple[tuple[Real, Real, Real], ...]
    rank: Ints

    def coefficients(self, sides: Complex, *, white: bool = False) -> Real:
        """Of each line's record, (K, lines, columns, sides), 0 at lines of no record; `sides` with unit noise.

        white: those by which what is left is white, where samples that are not measured are known in part.
        """
        columns = self.bases[0][1].shape[-2]
        out = np.zeros((*sides.shape[:2], columns, sides.shape[-1]))
        for lines, (Q, B, step) in zip(self.lines, self.bases, strict=True):
            by_direction = np.swapaxes(Q, -1, -2) @ real_rows(sides[:, lines])
            solved = B @ (by_direction * step[..., None] if white else by_direction)
            out[:, lines] = solved[:, None]
        return out


def projector(ends: RecordEnds, whitened: Complex) -> Projector:
    """The projection on columns (K, lines, rows, columns) that have unit noise, the inputs taken out.

    Columns behind those of the ends are of samples that are not measured.
    """
    bases, rank = [], np.zeros(len(whitened), dtype=np.int64)
    more = whitened.shape[-1] - ends.count
    for record, lines in enumerate(ends.lines):
        of = ends.unmeasured[record]
        used = np.concatenate([ends.used(record), np.arange(more) < len(of.channel)])
        rows = real_rows(whitened[:, lines] * used)
        if not more:
            Q, B, kept = orthonormal(rows)
            step = np.ones(B.shape[::2])
        else:
            precision = np.zeros((len(used), len(used)))
            its = slice(ends.count, ends.count + len(of.channel))
            precision[its, its] = of.precision
            squares = np.sum(rows**2, axis=-2)
            B, kept = with_known_last(np.swapaxes(rows, -1, -2) @ rows, squares, precision, more)
            B, step = whitening_steps(B, precision)
            kept = kept + len(of.channel) - np.sum(step <= FREE, axis=-1)
            Q = rows @ B
        bases.append((Q, B, step))
        rank += kept
    return Projector(ends.lines, tuple(bases), rank)


def whitener(W: Complex) -> Complex:
    """R with Rᴴ R = W, for stacks of weights (..., channels, channels) whose absent channels have zero rows."""
    absent = np.diagonal(W, axis1=-2, axis2=-1).real == 0
    filled = W + absent[..., None] * np.eye(W.shape[-1])
    size = np.sqrt(np.diagonal(filled, axis1=-2, axis2=-1).real)
    scaled = filled / (size[..., :, None] * size[..., None, :])
    L = np.linalg.cholesky(scaled)
    R: Complex = np.conj(np.swapaxes(L, -1, -2)) * np.where(absent, 0.0, size)[..., None, :]
    return frozen(R, np.complex128)
