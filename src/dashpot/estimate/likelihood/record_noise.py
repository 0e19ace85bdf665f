"""The noise of whole records from what the model leaves unexplained, iterated with the parameters (THEORY §8, c).

A record brings a first idea of each channel's noise, white, from where nothing moves.  After a fit the residual shows
more: its power smoothed over neighbouring lines, with what the fitted inputs have taken out of it put back (a step of
expectation and maximisation).  Where the lines do not differ by more than chance the noise is white, and all lines
tell its size.
"""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from dashpot.arrays import Bools, Complex, Ints, Real, diagonal_matrices, hermitian
from dashpot.data.conditioning.whole_record import FLOOR
from dashpot.data.noise import HALF_WINDOW, equal_variances, most_noise, smoothed
from dashpot.data.spectrum import Spectrum, WholeRecord, flattened, in_chunks, taken_as_measured
from dashpot.errors import DataError
from dashpot.estimate.likelihood.descent import Likelihood, thinned
from dashpot.estimate.likelihood.global_search import LocalMinima, decay_minima, seen_directly
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.measured import Measured
from dashpot.estimate.likelihood.objective import bounds, estimated_inputs, inputs_by_channel, predict
from dashpot.estimate.likelihood.record_sums import record_residuals
from dashpot.estimate.method import Method
from dashpot.estimate.preparation import Prepared, states_if_seen
from dashpot.free.response import RecordLines, shares_left
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.model.observation import (
    ObservationModel,
    calibrated_transfer,
    measures_input,
    observation_model,
    small,
)
from dashpot.notices import Notice

# The noise of channels that measure inputs of whole records, where their own spectra do not show it.
#
# An error Δ of a measured input moves all outputs as the rig would move them, t Δ; no other error does.  Where Σ is the
# covariance of a line's equations and e the residuals, the likelihood of a variance s of Δ has the slope
# |tᴴ Σ⁻¹ e|² − tᴴ Σ⁻¹ t and the information (tᴴ Σ⁻¹ t)²: a step of Fisher's scoring finds s.  It is taken as white, of
# one size per sample in all records, and is never more than the quietest part of the channel's own spectrum.  What such
# errors put into the outputs is no noise of theirs: it is taken out of their residuals when it is found, or these would
# be counted as noisy where the rig moves most, and explain what the inputs' noise does.

INPUT_NOISE = "input_noise"  # code of a notice
SHOWS = 4.0  # standard deviations of a variance, from which on it is one; few lines may tell it
STAYS = 3.0  # and up to which it is given up again
ROOM = 1 + STAYS / (2 * HALF_WINDOW + 1) ** 0.5  # the least of many means, over the mean


@dataclass(frozen=True, eq=False)
class InputNoise:
    """The noise of channels that measure inputs alone, as far as it is known; all (channels,).

    sought: whether it is looked for; level: variance times samples; least, most: what it can be by the record itself
    """

    sought: Bools
    level: Real
    least: Real
    most: Real

    @staticmethod
    def of(view: ObservationModel, spectrum: Spectrum, lines: Bools, V: Complex) -> InputNoise:
        """Before the first fit: sought where the spectrum, or a time of rest, does not leave little to find.

        lines (lines,): of the records whose noise is to be found; V (1, lines, channels, channels) as they show it.
        """
        variance = np.diagonal(V[0, lines], axis1=-2, axis2=-1).real * spectrum.samples[lines, None]
        least, most = np.min(variance, axis=0), np.full(len(spectrum.channels), np.inf)
        for number in spectrum.records:  # the quietest lines show what white noise can be at most
            its = np.flatnonzero((spectrum.stretch == number) & lines)
            if len(its):
                at_most = most_noise(np.nan_to_num(spectrum.amplitudes[0, its]))
                most = np.minimum(most, at_most * spectrum.samples[its[0]])
        sought = view.inputs_alone & (most > ROOM**2 * least)
        return InputNoise(sought, least, least, most)

    def refined(
        self,
        view: ObservationModel,
        spectrum: Spectrum,
        lines: Bools,
        data: Measured,
        residual: Complex,
        G: Complex,
    ) -> InputNoise:
        """After another fit, by a step of Fisher's scoring.  What a next step does not bear out is given up for good.

        lines (lines,): of the records whose noise is to be found; residual (lines, channels); G (lines, channels,
        inputs) calibrated.
        """
        # |tᴴ Σ⁻¹ e|² and tᴴ Σ⁻¹ t of an error in each channel, both (lines, channels); some lines at a time
        score, scale = np.zeros(residual.shape), np.zeros(residual.shape)
        alone = view.inputs_alone & view.is_direct
        for first in range(0, len(residual), PIECE):
            some = slice(first, first + PIECE)
            W, G_some = data.W[0, some], G[some]
            weighted = (W @ residual[some, :, None])[..., 0]
            if data.q is None:
                _, half = estimated_inputs(G_some, W, residual[some])
                taken = np.einsum("lcq,lqc->lc", half, hermitian(G_some) @ W)
                score[some] = np.abs(weighted) ** 2
                scale[some] = (np.diagonal(W, axis1=-2, axis2=-1) - taken).real
                continue
            by_channel = inputs_by_channel(view.at(some), alone)
            if by_channel is not None:
                t = G_some @ by_channel[..., alone]
                score[some, alone] = np.abs((hermitian(t) @ weighted[..., None])[..., 0]) ** 2
                scale[some, alone] = np.sum(np.conj(t) * (W @ t), axis=-2).real
        each = (lines / spectrum.samples)[:, None]
        information = np.sum((each * scale) ** 2, axis=0)
        usable = self.sought & view.is_direct & (information > 0)
        information = np.where(usable, information, 1.0)
        # The few lines that tell are those at resonances, from which the fit has its unknowns and boundary loads too.
        telling = information / np.maximum(np.max((each * scale) ** 2, axis=0), 1e-300)
        fitted = len(view.names) + 2 * view.model.n * len(spectrum.records)
        begun = self.level > self.least
        left = np.where(begun, np.maximum(1 - fitted / (2 * telling), 0.5), 1.0)
        step = np.sum(each * (score / left - scale), axis=0) / information
        level = np.clip(self.level + step, self.least, self.most)
        more = np.where(begun, STAYS, SHOWS) / np.sqrt(information)
        level = np.where(usable & (level > self.least + more), level, self.least)
        return replace(self, sought=self.sought & (~begun | (level > self.least)), level=level)

    def moves(self, view: ObservationModel, spectrum: Spectrum, G: Complex) -> Real:
        """Mean power that such errors put into all channels where they count as the inputs, (lines, channels)."""
        alone = view.inputs_alone & view.is_direct
        by_channel = inputs_by_channel(view, alone)
        if by_channel is None:
            return np.zeros(G.shape[:2])
        return np.abs(G @ by_channel) ** 2 @ (self.level * alone) / spectrum.samples[:, None]


def noise_counted(model: Model, spectrum: Spectrum, covariance: Complex) -> tuple[Notice, ...]:
    """How much noise is counted for the measured inputs of records whose noise was not known, and which have none.

    spectrum: before that noise was found, without batch axes; covariance (lines, channels, channels): with it.
    """
    lines = np.array([kind == FLOOR for kind in spectrum.noise])
    variance = np.diagonal(covariance[lines], axis1=-2, axis2=-1).real
    power = np.nan_to_num(np.abs(spectrum.amplitudes[lines])) ** 2
    counted, exact = [], []
    for c, channel in enumerate(spectrum.channels):
        size = float(np.sum(power[:, c]))
        if not measures_input(model, channel) or size == 0:
            continue
        share = float(np.sum(variance[:, c]) / size) ** 0.5
        if share < 1e-3:  # noise that is no more counts for nothing compared with that of outputs
            exact.append(channel.name)
        else:
            counted.append((channel.name, f"{channel.name} {100 * share:.2g} %"))
    notices = []
    if counted:
        sizes = joined(text for _, text in counted)
        text = (
            f"input noise assumed in the fit (share of each input's rms): {sizes}; it was inferred from "
            "the driven records: record the rig at rest to measure it"
        )
        notices.append(Notice(INPUT_NOISE, text, tuple(name for name, _ in counted)))
    return (*notices, *counted_as_exact(exact))


def counted_as_exact(names: Sequence[str]) -> tuple[Notice, ...]:
    """That inputs, if any, show no noise that matters."""
    if not names:
        return ()
    count = "so it is" if len(names) == 1 else "so they are"
    text = f"no noise detected in {joined(names)}, {count} treated as exact; record the rig at rest to check"
    return (Notice(INPUT_NOISE, text, tuple(names)),)


def without_moved(power: Real, moved: Real, smooth: Callable[[Real], Real]) -> Real:
    """Power of the outputs' own noise in residuals that hold what errors of the inputs move as well.

    power, moved (lines, channels); smooth: variances from powers.  Steps of expectation and maximisation.
    """
    noise = smooth(power)
    for _ in range(40):  # turns in which the outputs' noise is told from what errors of the inputs move
        share = noise / np.maximum(noise + moved, np.finfo(float).tiny)
        alone = share**2 * power + share * moved
        before, noise = noise, smooth(alone)
        if np.all(np.abs(noise - before) <= 0.01 * before):
            break
    return alone


RESIDUAL = "residual"
PIECE = 10_000  # lines at a time
STEPS = 30  # of each descent: the next round goes on from its end, and a search to the end follows them
FIRST = 1e-2  # of a channel's size: its noise before the first fit, where nothing else is known
UNEXPLAINED_MOST = 0.5  # of the power of the channels: of a motion without input this is no free decay


def noise_is_sought(spectrum: Spectrum) -> bool:
    """Whether whole records are among the data whose noise the residuals have to tell."""
    return FLOOR in spectrum.noise


def with_record_noise(model: Model, spectrum: Spectrum, method: Method) -> tuple[Spectrum, Method]:
    """The spectrum with the noise that the residuals of its whole records show, and a method that begins at their fit.

    Both as they are where that noise is known.
    """
    if not noise_is_sought(spectrum) or not isinstance(method, MaximumLikelihood):
        return spectrum, method
    each_repeat = [
        noise_from_residuals(model, repeat, method) for repeat in in_chunks(flattened(spectrum), 1)
    ]
    repeats = [each[0] for each in each_repeat]
    dof = np.min([repeat.dof for repeat in repeats], axis=0)
    covariance = repeats[0].covariance[0]
    if spectrum.batch:
        V = np.concatenate([repeat.covariance for repeat in repeats])
        covariance = V.reshape(*spectrum.batch, *V.shape[1:])
    notes = () if spectrum.batch else noise_counted(model, spectrum, covariance)
    known = replace(
        spectrum, covariance=covariance, noise=repeats[0].noise, dof=dof, notes=(*spectrum.notes, *notes)
    )
    if spectrum.batch:
        return known, method
    _, ends = each_repeat[0]
    (start, signs), *rivals = zip(map(tuple, ends.psi.tolist()), map(tuple, ends.sign.tolist()), strict=True)
    steps = min(method.max_iterations, 60)  # what has not settled after all rounds is no fit
    return known, replace(method, start=start, start_sign=signs, rivals=tuple(rivals), max_iterations=steps)


def noise_from_residuals(
    model: Model, spectrum: Spectrum, method: MaximumLikelihood
) -> tuple[Spectrum, LocalMinima]:
    """The spectrum of one repeat, (1, lines, channels), with the noise that its residuals show; the fit with it, and
    what competed with its first one.

    The channels that measure inputs alone keep the noise that their own spectra show; where these show none, they get
    what all outputs have in common.
    """
    view = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment)
    sought = np.array([kind == FLOOR for kind in spectrum.noise])
    outputs = ~view.inputs_alone
    V = _first(spectrum, sought, outputs)
    inputs = InputNoise.of(view, spectrum, sought, V)
    floor = np.diagonal(V[0], axis1=-2, axis2=-1).real.copy()  # which does not hold V
    changes = sought[:, None] & (outputs | inputs.sought)
    # Noise is part of what was measured: where residuals are larger, the fit is at fault, and is not to count less.
    measured = np.nan_to_num(np.abs(spectrum.amplitudes[0])) ** 2
    most = ROOM * _smoothed(spectrum, measured, sought, outputs)[0]
    begun: LocalMinima | None = None
    psi, sign = np.zeros((1, 0)), np.ones((1, len(spectrum.channels)))
    used, dof = 0.0, np.array(spectrum.dof)
    for turn in range(12):  # at most
        data = Prepared(view, spectrum, V, None, True, np.ones(1, dtype=bool))
        likelihood = Likelihood.of(data, method.effort)
        exact = likelihood.exact
        if begun is None:
            as_measured = replace(data, spectrum=taken_as_measured(spectrum))
            begun = _begun(Likelihood.of(as_measured, method.effort), method)
            psi, sign = begun.psi[:1], begun.sign[:1]
        else:
            psi = likelihood.descend_in(exact, psi, sign, STEPS, near=1e-3).x
        residual, columns = residuals_of_records(view, exact, psi, sign)
        share = float(np.median(_left(residual, exact)))
        if not model.inputs and share > UNEXPLAINED_MOST:
            raise DataError(
                f"this is no free decay: {100 * share:.0f} % of the power is unexplained, so something "
                "drives the rig that was not recorded",
                cure=(
                    "record what drives it (a force or the base motion) and declare it as an input; "
                    "the response alone gives modes, not masses, dampers and springs"
                ),
            )
        used = (columns + len(view.names)) / (2 * np.sum(sought) * max(np.sum(outputs), 1))
        power, inputs = _own_power(likelihood, sought, residual, inputs, psi, sign)
        left = max(1 - used, 0.1)
        variance, dof = _smoothed(spectrum, power / left, sought, outputs, left)
        of_inputs = np.maximum(inputs.level / spectrum.samples[:, None], floor)
        before = np.diagonal(V[0], axis1=-2, axis2=-1).real.copy()
        variance = np.where(changes, np.where(outputs, np.minimum(variance, most), of_inputs), before)
        V = diagonal_matrices(variance)[None]
        if np.all(np.abs(variance - before) <= 6e-3 * variance):  # 0.3 % of each standard deviation
            break
        # Three rounds for a fit that leaves most of the outputs' power over
        if turn == 2 and np.mean(_left(residual, exact)[outputs]) > UNEXPLAINED_MOST:
            break
        del data, likelihood, exact, residual, power  # before the next: of many lines they are large
    kinds = tuple(RESIDUAL if kind == FLOOR else kind for kind in spectrum.noise)
    weighted = replace(spectrum, covariance=V, noise=kinds, dof=dof * (1 - used))
    assert begun is not None
    return weighted, begun.led_by(psi, sign)


def _own_power(
    likelihood: Likelihood, sought: Bools, residual: Complex, inputs: InputNoise, psi: Real, sign: Real
) -> tuple[Real, InputNoise]:
    """Mean power of each channel's own noise, (lines, channels), by what a fit leaves, and what is known of inputs.

    With what the fitted inputs have taken out of the residual put back, and what errors of exact ones move taken out.
    """
    view, spectrum, data = likelihood.view, likelihood.data.spectrum, likelihood.exact
    power = np.abs(residual) ** 2
    if data.q is not None and not np.any(inputs.sought):
        return power, inputs
    G = np.empty((len(view.omega), *view.on_q.shape), dtype=np.complex128)
    for first in range(0, len(G), PIECE):
        some = slice(first, first + PIECE)
        part = view if len(G) <= PIECE else view.at(some)
        G[some] = calibrated_transfer(part, psi, sign).G[0]
    if data.q is None:
        # What fitting the inputs takes out of the residual's power: diagonal of G (Gᴴ W G)⁻¹ Gᴴ, (lines,
        # channels)
        normal = hermitian(G) @ data.W[0] @ G
        spread = np.linalg.pinv(normal, hermitian=True)
        power += np.einsum("lcq,lqp,lcp->lc", G, spread, np.conj(G)).real
    if np.any(inputs.sought):
        inputs = inputs.refined(view, spectrum, sought, data, residual, G)
    if data.q is not None and np.any(inputs.level[view.inputs_alone] > 0):
        moved = inputs.moves(view, spectrum, G)
        power = without_moved(
            power, moved, lambda each: _smoothed(spectrum, each, sought, ~view.inputs_alone)[0]
        )
    return power, inputs


def _begun(likelihood: Likelihood, method: MaximumLikelihood) -> LocalMinima:
    """A first fit: of free decays from their modes, else from some of the lines; where that leaves much over or has
    parts below zero, the best of what many of them give as well.  What competes with it stands behind it.

    Even weights are far from the noise of the equation where lines of motion are few among those that hold noise only,
    or where displacements come from accelerations.
    """
    data = likelihood.data
    decays = decay_minima(data, method.effort)
    best, cost = _further(likelihood, decays)
    if len(decays.cost) and _is_sound(likelihood, best, cost):
        return best
    # Lines of each part of the band that a first fit is made from, and where that may be a wrong valley
    few, many = thinned(data, 12), thinned(data, 80)
    first = _further(likelihood, method.rough(_with_states(few), many))
    best, cost = min((best, cost), first, key=lambda end: end[1])
    if _is_sound(likelihood, best, cost):
        return best
    many = _with_states(many)
    others = [] if few is data else [method.rough(many)]
    # Rigs of usual size whose noise is tried: each leads to the right one in half of the cases. What is seen in part
    # has been searched from many rigs by then.
    rigs = 8 if many.states is not None and seen_directly(many) else 0
    for number in range(-len(others), rigs):
        again = method.rough(many, typical=number) if number >= 0 else others[number]
        other = likelihood.model_at(again.psi[:1], again.sign[:1]).cost[0]
        if other < cost or not np.isfinite(cost):
            best, cost = again, other
        if number >= 0 and _is_sound(likelihood, best, cost):
            break
    return best


def _further(likelihood: Likelihood, minima: LocalMinima) -> tuple[LocalMinima, float]:
    """Minima of some lines, the lowest one followed in all, and its cost; inf where there are none."""
    if not len(minima.cost):
        return minima, np.inf
    end = likelihood.descend_in(likelihood.exact, minima.psi[:1], minima.sign[:1], STEPS, near=1e-3)
    return minima.led_by(end.x, minima.sign[:1]), float(end.cost[0])


def _is_sound(likelihood: Likelihood, minima: LocalMinima, cost: float) -> bool:
    """Whether a first fit is worth going on from: possible parts, and little left over."""
    view, exact, psi = likelihood.view, likelihood.exact, minima.psi[:1]
    if not np.all(psi[0] > bounds(view, positive=True)[0]):
        return False
    if cost <= 4.0 * exact.rows:
        return True
    residual, _ = residuals_of_records(view, exact, psi, minima.sign[:1])
    return bool(np.all(_left(residual, exact) <= 0.2))  # the noise is not known yet


def _with_states(data: Prepared) -> Prepared:
    return replace(data, states=states_if_seen(data.view, data.spectrum, data.covariance))


def _left(residual: Complex, data: Measured) -> Real:
    """What a fit leaves of each channel's power, (channels,); 0 of channels without any."""
    power = np.sum(np.abs(data.y[0]) ** 2, axis=0)
    left: Real = np.sum(np.abs(residual) ** 2, axis=0) / np.where(power > 0, power, 1.0)
    return np.where(power > 0, left, 0.0)


def residuals_of_records(
    view: ObservationModel, data: Measured, psi: Real, sign: Real
) -> tuple[Complex, int]:
    """Residuals of one repeat, (lines, channels), and how many columns the ends of its records, if any, take out."""
    if data.ends is None or not small(view.model):
        at = predict(view, data, psi, sign)
        return at.r[0], at.columns
    white, rank = record_residuals(data.record_pieces, psi, sign)
    weight = np.sqrt(np.diagonal(data.W[0], axis1=-2, axis2=-1).real)
    return white[0] / np.where(weight > 0, weight, 1.0), int(rank[0])


def _first(spectrum: Spectrum, sought: Bools, outputs: Bools) -> Complex:
    """Noise before the first fit, (1, lines, channels, channels): as the records show it where nothing moves."""
    variance = np.diagonal(spectrum.covariance[0], axis1=-2, axis2=-1).real
    size = np.nan_to_num(np.abs(spectrum.amplitudes[0])) ** 2
    unknown = sought[:, None] & outputs & ~(variance > 0)
    variance = np.where(unknown, FIRST**2 * np.mean(size, axis=0), variance)
    # A rig that is not quite this one must not hold the first fit to the loudest lines.
    for number, value in enumerate(spectrum.stretches):
        lines = np.flatnonzero((spectrum.stretch == number) & sought)
        if isinstance(value, WholeRecord) and len(lines):
            around = smoothed(size[lines])
            variance[lines] += np.where(outputs, FIRST**2 * around, 0.0)
    return diagonal_matrices(variance)[None]


def _smoothed(
    spectrum: Spectrum, power: Real, sought: Bools, outputs: Bools, left: float = 1.0
) -> tuple[Real, Real]:
    """Variances (lines, channels) from the power of residuals, and their degrees of freedom (lines,).

    All records together have noise of one size per sample, or in proportion to each channel's own size, with one course
    over frequency.  Whichever explains the scatter between the records better counts; where neither does, each record
    by itself, unless one is so short that it says next to nothing of its noise.  `left` is the share of their freedom
    that the fit has left to the residuals.
    """
    variance, dof = np.array(power), np.array(spectrum.dof)
    size = np.nan_to_num(np.abs(spectrum.amplitudes[0])) ** 2
    records = [
        np.flatnonzero((spectrum.stretch == number) & sought)
        for number, value in enumerate(spectrum.stretches)
        if isinstance(value, WholeRecord)
    ]
    records = [its for its in records if len(its)]
    if not records:
        return variance, dof
    lines = np.concatenate(records)
    record = np.repeat(np.arange(len(records)), [len(its) for its in records])
    order = np.argsort(spectrum.frequency_hz[lines], kind="stable")
    freedom = np.full((len(lines), power.shape[1]), np.inf)

    def means(values: Real) -> Real:
        return np.bincount(record, values, len(records)) / np.bincount(record)

    for c in range(power.shape[1]):
        shown, its_size = power[lines, c], means(size[lines, c])[record]
        there = (means(shown)[record] > 0) & (its_size > 0)  # in the others the channel is missing
        if not np.any(there):
            continue
        kept, count = order[there[order]], np.bincount(record[there], minlength=len(records))
        limit = float(chdtri(max(int(np.count_nonzero(count)) - 1, 1), 1e-3))
        fewest = int(np.min(count[count > 0]))  # lines: short records show their size and no course
        choices: list[tuple[bool, float, Real, Real]] = []
        # Of one record both are one size.
        scales = (1 / spectrum.samples[lines], its_size)[: len(records)]
        for scale in scales:
            expected, behind = np.ones(len(lines)), np.ones(len(lines))
            course, behind[kept] = _course(shown[kept] / scale[kept], fewest > HALF_WINDOW)
            expected[kept] = np.maximum(scale[kept] * course, np.finfo(float).tiny)
            own = np.where(count > 0, means(shown / expected), 1.0)
            level = np.sum(count * own) / np.sum(count)
            scatter = 2 * float(np.sum(count * np.log(level / own)))
            # A course over frequency takes up scatter between the records that is none: what needs none comes first.
            plain = scatter <= limit and bool(np.all(behind[kept] >= 2 * len(kept)))
            choices.append((not plain, scatter, expected, behind))
        _, scatter, common, behind = min(choices, key=lambda choice: choice[:2])
        # With less than 8 degrees of freedom a record tells no noise of its own.
        if len(records) > 1 and scatter > limit and 2 * left * fewest >= 8.0:
            for number in np.flatnonzero(count):
                its = record == number
                common[its], behind[its] = _course(shown[its])
        variance[lines[there], c] = common[there]
        freedom[:, c] = np.where(there, behind, np.inf)
    least = np.min(freedom[:, outputs], axis=1, initial=np.inf)
    dof[lines] = np.where(np.isfinite(least), least, 2.0 * np.bincount(record)[record])
    return np.maximum(variance, 1e-7**2 * np.mean(size, axis=0)), dof  # below, noise is rounding


def _course(power: Real, told: bool = True) -> tuple[Real, Real]:
    """Variances (lines,) from the power of residuals in order of frequency, and their degrees of freedom.

    Over 2·HALF_WINDOW + 1 lines where a course can be `told`; over all of them where they are white, the mean powers of
    groups of lines differing by no more than chance.
    """
    width = 2 * HALF_WINDOW + 1
    groups = len(power) // width
    if told and groups > 1:
        of_groups = np.mean(power[: groups * width].reshape(groups, width), axis=1)
        if equal_variances(of_groups, 2.0 * width) < 0.01:
            return smoothed(power), np.full(len(power), 2.0 * width)
    return np.full(len(power), np.mean(power)), np.full(len(power), 2.0 * len(power))


def share_without_misfit(spectrum: Spectrum, inputs: Bools, residual: Complex) -> Real:
    """What share of the variances (lines, channels) is noise; less than 1 where residuals tell it and hold misfit.

    What a linear rig lacks is a smooth response to the inputs (channels,), from line to line; noise is not.
    """
    sought, all_noise = np.array([kind == RESIDUAL for kind in spectrum.noise]), np.ones(residual.shape)
    if not np.any(sought):
        return all_noise
    repeat = replace(spectrum, amplitudes=spectrum.amplitudes[None], covariance=spectrum.covariance[None])
    share, amplitudes = np.ones(residual.shape), np.nan_to_num(repeat.amplitudes[0])
    groups = defaultdict[tuple[int, bytes], list[tuple[Ints, RecordLines]]](list)
    for number in repeat.records:
        its = np.flatnonzero((repeat.stretch == number) & sought)
        if not len(its):
            continue
        its = its[np.argsort(repeat.frequency_hz[its], kind="stable")]
        record, size = repeat.stretches[number], int(repeat.samples[its[0]])
        assert isinstance(record, WholeRecord)
        there = ~inputs & np.any(residual[its] != 0, axis=0)
        shown, left = amplitudes[its][:, inputs], residual[its][:, there]
        lines = RecordLines(
            repeat.frequency_hz[its], shown * size**0.5, left * size**0.5, record.duration_s, size
        )
        groups[int(repeat.experiment[its[0]]), there.tobytes()].append((its, lines))
    for (_, there), some in groups.items():
        with contextlib.suppress(DataError):  # too short for local models
            # A local model leaves less of noise than is counted by chance, once in a thousand.
            shares = shares_left([lines for _, lines in some], 1e-3)
            for (its, _), part in zip(some, shares, strict=True):
                share[np.ix_(its, np.frombuffer(there, dtype=bool))] = part
    if np.all(share == 1):
        return all_noise
    power = np.abs(residual) ** 2
    alone, whole = (_smoothed(repeat, each, sought, ~inputs)[0] for each in (power * share, power))
    known = sought[:, None] & ~inputs & (whole > 0)
    return np.where(known, np.minimum(alone / np.where(whole > 0, whole, 1.0), 1.0), 1.0)
