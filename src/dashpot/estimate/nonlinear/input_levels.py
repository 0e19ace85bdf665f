"""How much noise the measured inputs of whole records have, and the search with their true values unknown (THEORY §9).

As of linear rigs: a record at rest tells it; else parts of a record in which an input rests; else the top of its own
spectrum, where that is flat and far below the rest; else what the residuals of all outputs have in common, as the rig
would carry it to them, where that is beyond chance.  It is white, of one size per sample in all records, and never more
than the quietest part of the input's own spectrum.  Where the outputs show less than the top of the spectrum, that was
motion, and they are believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Real
from dashpot.data.noise import (
    ALIKE,
    QUIETEST,
    TOP,
    most_noise,
    variance_at_rest,
    white_floor,
    without_leakage,
)
from dashpot.estimate.likelihood.record_noise import SHOWS, STAYS
from dashpot.estimate.nonlinear.record_problem import (
    LinearisedRecord,
    NotSolvedError,
    RecordProblem,
    begun_problem,
)
from dashpot.estimate.nonlinear.records import NoiseAtRest, RecordData, base_travel, in_pieces
from dashpot.model.network import Model
from dashpot.model.nonlinear.shooting import FEWEST
from dashpot.numerics.levenberg_marquardt import OptimizeResult
from dashpot.numerics.small_systems import scaled_inverse, solve_scaled

# The sizes of the noise of outputs and inputs, from what the motion of whole records leaves unexplained (THEORY §8, c).
#
# Restricted likelihood: the residuals less what the unknowns can explain have a covariance in which each size has a
# part of its own. The sums of squares that measure a size are compared with those of noise that is drawn to the present
# sizes and goes the same way, so nothing has to be known of the colours that the rig gives it; average information
# gives the step. Source: Gilmour, Thompson and Cullis (1995), Biometrics 51, 1440.

DRAWS = 16  # of noise: sizes vary by 1/√DRAWS of their own standard deviation with the draws
LAST = 60  # steps of the last search
SHORTEST_PIECE = 64  # samples


@dataclass(frozen=True)
class DrawnNoise:
    """What P = V⁻¹ less the unknowns makes of the residuals and of draws of noise, for each record.

    data (samples, channels), draws (samples, channels, K); errors, drawn_errors the same carried back to the inputs.
    """

    data: tuple[Real, ...]
    draws: tuple[Real, ...]
    errors: tuple[Real, ...]
    drawn_errors: tuple[Real, ...]


def unknowns_matrix(linear: Sequence[LinearisedRecord], prior: Real) -> Real:
    """Information on all unknowns, (M, M), from the records and the prior's precision (M,)."""
    matrix: Real = np.diag(prior)
    for record in linear:
        matrix[np.ix_(record.chosen, record.chosen)] += record.matrix
    return matrix


def drawn_noise(linear: Sequence[LinearisedRecord], prior: Real, draws: int = DRAWS) -> DrawnNoise:
    """Of records at the end of a search; prior (M,) the unknowns' stated precision."""
    rng = np.random.default_rng(0)
    noises = []
    for record in linear:
        N, c = record.residual.shape
        white = rng.standard_normal((N, c, draws))
        moved = rng.standard_normal((N, record.covariance.known.spread.shape[1], draws))
        noises.append(white + record.covariance.reach(moved))
    draws_cleared = cleared(linear, prior, noises)
    back = [record.covariance.back(z) for record, z in zip(linear, draws_cleared, strict=True)]
    data, errors = tuple(record.score for record in linear), tuple(record.errors() for record in linear)
    return DrawnNoise(data, tuple(draws_cleared), errors, tuple(back))


def sizes_of_noise(linear: Sequence[LinearisedRecord], prior: Real, noise: DrawnNoise) -> tuple[Real, Real]:
    """Slopes of the restricted ln L along the logarithms of the variances, and information on these.

    Channels first, then inputs; all variances as they are now.
    """
    squares, of_draws = (
        np.concatenate([sum(np.sum(part**2, axis=0) for part in parts) for parts in both])
        for both in ((noise.data, noise.errors), (noise.draws, noise.drawn_errors))
    )
    expected = of_draws.mean(axis=-1)
    # Columns each with one channel, or one input, alone
    working = [
        np.concatenate(
            [z[:, :, None] * np.eye(z.shape[1]), record.covariance.reach(w[:, :, None] * np.eye(w.shape[1]))],
            axis=-1,
        )
        for record, z, w in zip(linear, noise.data, noise.errors, strict=True)
    ]
    solved = cleared(linear, prior, working)
    parts = [np.tensordot(a, b, axes=([0, 1], [0, 1])) for a, b in zip(working, solved, strict=True)]
    information: Real = np.sum(parts, axis=0) / 2
    return (squares - expected) / 2, (information + information.T) / 2


def cleared(linear: Sequence[LinearisedRecord], prior: Real, columns: Sequence[Real]) -> list[Real]:
    """P of columns (samples, channels, K) that run through all records: V⁻¹ of them less what unknowns explain."""
    solved = [record.weighed(each) for record, each in zip(linear, columns, strict=True)]
    right = np.zeros((len(prior), columns[0].shape[2]))
    for record, each in zip(linear, solved, strict=True):
        right[record.chosen] += np.tensordot(record.slopes, each, axes=([0, 1], [0, 1]))
    matrix = unknowns_matrix(linear, prior)
    values = solve_scaled(matrix, right.T).T
    return [
        each - record.weighed_slopes @ values[record.chosen]
        for record, each in zip(linear, solved, strict=True)
    ]


@dataclass(frozen=True)
class OwnNoise:
    """What the spectra of the inputs say of their noise, by themselves; each (q,).

    shown: variance in parts at rest, else at the top of the spectrum, 0 where neither tells it; freedom: degrees of
    freedom behind it; most: the quietest part of the spectrum, which white noise does not exceed.
    """

    shown: Real
    freedom: Real
    most: Real


def own_noise(records: Sequence[RecordData]) -> OwnNoise:
    """Of inputs as they were measured."""
    q = records[0].inputs.shape[1]
    total, freedom, most = np.zeros(q), np.zeros(q), np.full(q, np.inf)
    for record in records:
        N = record.samples
        lines = np.fft.rfft(record.inputs - np.mean(record.inputs, axis=0), axis=0) * (2 / N)
        power = without_leakage(lines) * N / 4
        most = np.minimum(most, most_noise(lines) * N / 4)
        at_rest = np.array([variance_at_rest(column) for column in record.inputs.T])
        at_top = np.array([white_floor(column) for column in power.T])
        level = np.where(at_rest > 0, at_rest, at_top)
        count = np.where(at_rest > 0, QUIETEST * N, (at_top > 0) * (TOP[1] - TOP[0]) * N / ALIKE**2)
        total += count * level
        freedom += count
    return OwnNoise(total / np.maximum(freedom, 1.0), freedom, most)


@dataclass(frozen=True)
class InputSizes:
    """The variances of the noise of the inputs (q,), 0 where it is none; from_spectrum (q,): where it shows there.

    spread (channels + q, channels + q): covariance of the logarithms of the variances of channels and inputs; at_rest:
    whether a record at rest showed all of them.
    """

    variance: Real
    from_spectrum: Bools
    spread: Real
    at_rest: bool = False


def with_uncertain_inputs(
    problem: RecordProblem,
    psi: Real,
    measured: Sequence[RecordData],
    limits: tuple[Real, Real],
    at_rest: NoiseAtRest | None,
) -> tuple[RecordProblem, OptimizeResult, InputSizes] | None:
    """The search from ψ (M,), the end of one with exact inputs, which also finds the noise of inputs and outputs.

    measured: the records before any was cut; limits: bounds of ψ; at_rest: the sizes, where a record at rest tells
    them.  None where the inputs show no noise that matters.  Raises NotSolvedError if the motion hangs too much on
    its inputs for that.
    """
    if at_rest is not None:
        if np.any(at_rest.inputs > 0):
            problem = problem.with_noise(at_rest.outputs, at_rest.inputs)
        else:
            problem = replace(problem, sd=at_rest.outputs)
        q, sizes = len(at_rest.inputs), len(problem.sd) + len(at_rest.inputs)
        nothing = np.zeros(q, dtype=bool), np.zeros((sizes, sizes))
        return problem, problem.descend(psi, limits, LAST), InputSizes(at_rest.inputs, *nothing, at_rest=True)
    if not problem.records[0].inputs.shape[1] or min(data.samples for data in problem.records) < FEWEST:
        return None
    own = own_noise(measured)
    variance, by_spectrum = _first_variances(problem, psi, own)
    while np.any(variance > 0):
        found, end, noise, denied = _sized(problem, psi, own, by_spectrum, variance, limits)
        if not np.any(denied):
            return found, end, noise
        variance = np.where(denied & ~by_spectrum, 0.0, noise.variance)
        by_spectrum = by_spectrum & ~denied
    return None


def steadied(model: Model, measured: Sequence[RecordData]) -> tuple[RecordData, ...]:
    """The records of a rig with the length over which noise of the bases' rates hardly moves them (`steady`)."""
    count = len(measured[0].bases.names)
    sd = np.sqrt(own_noise(measured).shown)
    noisy = sd[len(sd) - count :] > 0
    if not np.any(noisy):
        return tuple(measured)
    return tuple(
        replace(data, steady=_steady_samples(model, data, sd[len(sd) - count :])) for data in measured
    )


def _steady_samples(model: Model, data: RecordData, sd: Real) -> int:
    """sd (bases,): of their rates' white noise; 0 for all samples.  A random walk, less the parabola nearest to it."""
    size = base_travel(model, replace(data, steady=SHORTEST_PIECE)).beside
    steady = np.inf
    for c, order in enumerate(data.derivative):
        for noise, rate, reach in zip(sd, data.bases.orders, np.abs(data.on_x[c, model.n :]), strict=True):
            times = rate - order  # integrations
            if times < 1 or reach * noise == 0:
                continue
            moves = size if order == 0 else float(np.std(data.outputs[:, c]))
            power = times - 0.5
            # What a parabola leaves of a random walk, a thirtieth, is to be a tenth of the motion.
            walk = 1 / 30 * reach * noise * np.sqrt(data.step_s / (2 * times - 1))
            steady = min(steady, (0.1 * moves / walk) ** (1 / power))
    length = max(steady / data.step_s, SHORTEST_PIECE)
    return int(length) if length < data.samples else 0


def despite_wander(problem: RecordProblem, psi: Real, measured: Sequence[RecordData]) -> Real | None:
    """ψ (M,) of the search with the noise that the inputs' own spectra show; None if they may be taken for exact.

    Noise of a base's acceleration, integrated, carries what shows where the rig is far from where it was: no motion of
    exact inputs is near the measured one.  In pieces short enough for that to matter little, exact ones give a start.
    """
    if not any(data.steady for data in measured):
        return None
    own = own_noise(measured)
    cut = [in_pieces(data) for data in measured]
    pieces = [piece for parts in cut for piece in parts]
    first = np.cumsum([0, *(len(parts) for parts in cut[:-1])]).tolist()
    theta = psi[: len(problem.model.unknowns)]
    short, starts = begun_problem(problem.rig, tuple(pieces), theta, problem.sd, problem.constants)
    try:
        end = short.descend(np.concatenate([psi[: problem.inner], starts]), limit=LAST).x[0]
        psi = np.concatenate([end[: problem.inner], *(end[short.of_record(k)] for k in first)])
        end = problem.with_noise(problem.sd, own.shown).descend(psi, limit=LAST)
    except NotSolvedError:
        return None
    return end.x[0] if np.isfinite(end.cost[0]) else None


def _first_variances(problem: RecordProblem, psi: Real, own: OwnNoise) -> tuple[Real, Bools]:
    """Variances of the inputs' noise to begin with, (q,), and which are from their own spectra."""
    c = len(problem.sd)
    size = np.sqrt(np.mean(np.concatenate([data.inputs for data in problem.records]) ** 2, axis=0))
    unit = (1e-6 * np.where(size > 0, size, 1.0)) ** 2  # noise that is looked for first
    tried = problem.with_noise(problem.sd, unit)
    linear = all_linearised(tried, psi)
    if not linear:
        return np.zeros(len(unit)), np.zeros(len(unit), dtype=bool)
    prior = problem.priors()[0]
    noise = drawn_noise(linear, prior)
    slope = sizes_of_noise(linear, prior, noise)[0][c:]
    # Information on the logarithm of each input's variance alone, (q,), as noise of the present sizes has
    # it
    total = []
    for j in range(noise.errors[0].shape[1]):
        only = np.arange(noise.errors[0].shape[1]) == j
        columns = [
            record.covariance.reach(w * only[:, None])
            for record, w in zip(linear, noise.drawn_errors, strict=True)
        ]
        solved = cleared(linear, prior, columns)
        squares = [np.sum(a * b) for a, b in zip(columns, solved, strict=True)]
        total.append(float(np.sum(squares)) / (2 * columns[0].shape[2]))
    information = np.array(total)
    usable = information > 0
    times = slope / np.where(usable, information, 1.0)  # the unit, by Fisher's scoring from about 0
    shows = usable & (times * np.sqrt(information) > SHOWS)
    # With less than a thousandth of a size's information it moves nothing by 0.06 standard deviations.
    by_spectrum = (own.shown > 0) & (information * (own.shown / unit) ** 2 > 1e-3)
    in_common = np.where(shows & (own.shown == 0), np.minimum(times * unit, own.most), 0.0)
    # What is held down by the quietest part of the spectrum and tells nothing of its size there is gone in the end.
    faint = (times * unit >= own.most) & (information * (own.most / unit) ** 2 < 0.3)
    in_common = np.where(faint, 0.0, in_common)
    return np.where(by_spectrum, own.shown, in_common), by_spectrum


def _sized(
    problem: RecordProblem,
    psi: Real,
    own: OwnNoise,
    by_spectrum: Bools,
    variance: Real,
    limits: tuple[Real, Real],
) -> tuple[RecordProblem, OptimizeResult, InputSizes, Bools]:
    """Rounds of a search for the unknowns and a step for the sizes of the noise, until these settle; the last search is
    to its end.

    Last: whether the outputs deny what was begun with, (q,): beyond doubt less noise than the top of an input's own
    spectrum, whose variance that measures, or of noise that they alone tell nothing that is left.
    """
    c, sd, sought = len(problem.sd), problem.sd, variance > 0
    moves = np.concatenate([np.ones(c, dtype=bool), sought])
    freedom = np.concatenate([np.zeros(c), np.where(by_spectrum, own.freedom / 2, 0.0)])
    least, prior = 1e-6 * problem.sizes(), problem.priors()[0]
    slope, information = np.zeros(len(moves)), np.zeros((len(moves), len(moves)))
    for _ in range(20):  # at most
        problem = problem.with_noise(sd, variance)
        psi = problem.descend(psi, limits, 8).x[0]
        linear = all_linearised(problem, psi)
        if not linear:
            break
        slope, information = sizes_of_noise(linear, prior, drawn_noise(linear, prior))
        ratio = own.shown / np.where(sought, variance, 1.0)
        pull = slope + freedom * np.concatenate([np.zeros(c), (ratio - 1) * sought])
        change = np.zeros(len(moves))
        change[moves] = solve_scaled((information + np.diag(freedom))[np.ix_(moves, moves)], pull[moves])
        change = np.clip(np.nan_to_num(change), -np.log(4.0), np.log(4.0))
        room = np.log(own.most / np.where(sought, variance, own.most))
        change[c:] = np.where(sought & (freedom[c:] == 0), np.minimum(change[c:], room), change[c:])
        sd = np.maximum(sd * np.exp(change[:c] / 2), least)
        variance = variance * np.exp(change[c:])
        if np.max(np.abs(change)) / 2 < 5e-3:  # of a standard deviation
            break
    problem = problem.with_noise(sd, variance)
    end = problem.descend(psi, limits, LAST)
    spread = np.zeros_like(information)
    spread[np.ix_(moves, moves)] = scaled_inverse((information + np.diag(freedom))[np.ix_(moves, moves)])
    told = np.maximum(np.diagonal(information)[c:], 1e-300)
    by_itself = np.where(freedom[c:] > 0, freedom[c:], np.inf)
    refuted = (freedom[c:] > 0) & (slope[c:] * np.sqrt(1 / told + 1 / by_itself) < -STAYS)
    gone = sought & (freedom[c:] == 0) & ~(np.sqrt(np.diagonal(spread)[c:]) < 1)
    return problem, end, InputSizes(variance, by_spectrum, spread), refuted | gone


def moves_with_sizes(problem: RecordProblem, psi: Real, noise: InputSizes) -> Real:
    """How the end of a search, ψ (M,), moves with the logarithms of the variances, (M, channels + q)."""
    c = len(problem.sd)
    moves = np.zeros((len(psi), len(noise.spread)))
    for number in np.flatnonzero(np.diagonal(noise.spread) > 0):
        ends = []
        for way in (-0.1, 0.1):
            change = np.where(np.arange(len(noise.spread)) == number, way, 0.0)
            sd, variance = problem.sd * np.exp(change[:c] / 2), noise.variance * np.exp(change[c:])
            around = problem.with_noise(sd, variance).quadratic(psi[None])
            ends.append(solve_scaled(around.symmetric, around.gradient)[0])
        moves[:, number] = (ends[1] - ends[0]) / 0.2
    return np.nan_to_num(moves)


def all_linearised(problem: RecordProblem, psi: Real) -> list[LinearisedRecord]:
    """All records around ψ; none where one has no motion."""
    linear = []
    for k in range(len(problem.records)):
        record = problem.linearised(k, psi)
        if record is None:
            return []
        linear.append(record)
    return linear
