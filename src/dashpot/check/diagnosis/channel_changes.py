"""A channel that is wrong in whole records, or from some time on, seen against what all other channels say of it.

In a fit to all channels the rig, its inputs and its ends give way to the one that is wrong, and its residual does not
show what it is.  Without that channel they do not, and what they predict of it shows its sign, its limits or when its
gain changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.check.diagnosis.contradictions import Contradiction, filtered
from dashpot.check.diagnosis.ranking import HELPS, Cause, points_of
from dashpot.check.diagnosis.search import LONG, Workbench, changes, descended
from dashpot.check.diagnosis.steady_lines import steady_lines, working_noise
from dashpot.check.diagnosis.trials import ALIKE, Likeness, known_ratio, likeness, untouched, without
from dashpot.check.verdict import clipped_at
from dashpot.data.spectrum import Spectrum, WholeRecord, history_of_lines
from dashpot.errors import DashpotError
from dashpot.estimate.inference.time_course import TimeChange, time_changes
from dashpot.estimate.likelihood.objective import measured, record_fit
from dashpot.estimate.likelihood.record_noise import RESIDUAL
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import channel_unit, measures_input

# Another linear rig as the cause of a misfit of whole records: fitted to all of their lines, with loads of
# the ends.
#
# Lines without transients (`steady_lines`) are good to a few per cent, which hides a value that is wrong by
# as little and leaves of a larger one more than it should. Few candidates need a fit: their scores tell
# which.


MOST_AMPLITUDES = 30_000  # complex numbers of all channels: more take seconds
NAMED = 3
QUIETEST = 1.3  # χ² per degree of freedom that noise leaves if it is taken to be as low as where it is lowest


@dataclass(frozen=True)
class RigChanges:
    """Rigs with one linear part otherwise, the best first, and χ² per degree of freedom of the rig as it is.

    noise: χ² per degree of freedom that noise alone leaves.
    """

    as_is: float = np.inf
    causes: tuple[Cause, ...] = ()
    noise: float = 1.0

    @property
    def left(self) -> float:
        """The part of what noise does not explain that the best of them leaves, 1 where there is none."""
        if not self.causes or self.as_is <= self.noise:
            return 1.0
        return max(self.causes[0].remaining - self.noise, 0.0) / (self.as_is - self.noise)


def with_quiet_noise(spectrum: Spectrum) -> tuple[Spectrum, float]:
    """The spectrum of whole records for trials, and χ² per degree of freedom that noise alone leaves there.

    Noise that was read from the residuals of this very rig is taken to be as low as where it is lowest.
    """
    if RESIDUAL not in spectrum.noise:
        return spectrum, 1.0
    variance = working_noise(spectrum)[:, :, None] * np.eye(len(spectrum.channels))
    return replace(spectrum, covariance=variance.astype(np.complex128)), QUIETEST


def record_changes(model: Model, spectrum: Spectrum, estimate: Estimate | None) -> RigChanges:
    """What a missing linear element, or a stated value that is wrong, explains of whole records."""
    if (
        estimate is None
        or not np.all(np.isfinite(estimate.values))
        or spectrum.amplitudes.size > MOST_AMPLITUDES
    ):
        return RigChanges()
    quiet, noise = with_quiet_noise(spectrum)
    try:
        data = prepare(model, quiet, states=False)
    except DashpotError:
        return RigChanges()
    sign, exact = quiet.signs(estimate.signs), measured(data)
    row = np.zeros(1, dtype=np.int64)
    ends, chi2 = descended(data.view, exact, estimate.values[None], sign, row, LONG)
    as_is = float(chi2[0]) / max(exact.rows - len(ends[0]), 1)
    if not np.isfinite(as_is):
        return RigChanges()
    tried = [
        Cause(each.kind, points_of(each.element, model), each.reduced, each.number, element=each.element)
        for each in changes(Workbench(data, ends[0], sign[0]), ends[0], NAMED)
        if each.reduced - noise < HELPS * (as_is - noise)
    ]
    return RigChanges(as_is, tuple(sorted(tried, key=lambda cause: cause.remaining)[:NAMED]), noise)


# What a channel shows in a whole record in the place of what all others say of it: in frequency and in
# time.
#
# The fit without the channel predicts it. Beside that stand the forms that one sensor alone can give a
# motion: another sign, unit or delay, an end of its range, a zero that wanders, a filter, spikes.


EXPLAINED = 0.6  # share of what is wrong that a form must explain
LOUD = 0.95  # share of a channel's power in the lines by which it is compared
PIECES = 48  # of a record, whose means say how the zero wanders
STEPS, SUDDEN = 4, 0.7  # pieces that must make up this share of all that the zero moves, to be steps
SURELY = 5.0  # standard deviations of a gain that differs from 1
RIGHT = 0.02  # of a gain: what is nearer to 1 is right


@dataclass(frozen=True)
class ComparedLines:
    """A channel of one record beside what it should show, (lines,): amplitudes, Hz, multiples of 1/T; T in s."""

    y: Complex
    expected: Complex
    frequency_hz: Real
    order: Ints
    duration_s: float


def contradiction_in_record(of: ComparedLines, unit: str) -> Likeness | Contradiction | None:
    """How a channel differs from what it should show, in its `unit`; None where no one form says it."""
    samples = 2 * (int(np.max(of.order)) + 1)
    shown, should = (history_of_lines(values, of.order, samples) for values in (of.y, of.expected))
    limit = clipped_at(shown, should, 2 * len(of.order))
    if limit is not None:
        text = f"reads too little where it moves much, as if it ended at {limit:.3g} {unit}: clipped, or saturated?"
        return Contradiction(text)
    gain = float(shown @ should / (should @ should)) if np.any(should) else 0.0
    left = float(np.sum((shown - gain * should) ** 2) / max(np.sum(shown**2), np.finfo(float).tiny))
    times = Likeness(gain, 0, 0.0, False, left)
    # The loudest lines (lines,), of most of the power
    power = np.abs(of.expected) ** 2
    order = np.argsort(-power)
    kept = order[: int(np.searchsorted(np.cumsum(power[order]), LOUD * np.sum(power))) + 1]
    loud = np.isin(np.arange(len(power)), kept)
    form = times if left < ALIKE else likeness(of.y, of.expected, 2 * np.pi * of.frequency_hz, loud)
    if form is not None and form.kind in ("sign", "unit", "quantity", "delay"):
        ratio = known_ratio(form.number) if form.kind == "unit" else None
        return form if ratio is None else replace(form, number=float(np.copysign(ratio, form.number)))
    wander = _wander(shown - gain * should, of.duration_s, unit)
    through = filtered(of.frequency_hz[loud], of.expected[loud], of.y[loud]) if wander is None else wander
    if through is not None or form is None or form.kind != "gain":
        return through
    uncertain = float(np.sqrt(left * np.sum(shown**2) / np.sum(should**2) / (2 * len(of.order))))
    return times if abs(gain - 1) > max(RIGHT, SURELY * uncertain) else None


def _wander(away: Real, duration_s: float, unit: str) -> Contradiction | None:
    """That the zero of a channel drifts or steps, where that is most of what is wrong with it."""
    edges = np.linspace(0, len(away), PIECES + 1).astype(np.int64)
    means = np.add.reduceat(away, edges[:-1]) / np.diff(edges)
    if float(np.mean(means**2)) < EXPLAINED * float(np.mean(away**2)):
        return None
    size, steps = float(np.ptp(means)), np.abs(np.diff(means))
    k = int(np.argmax(steps))
    if np.sum(np.sort(steps)[-STEPS:]) > SUDDEN * np.sum(steps):
        at = duration_s * (k + 1) / PIECES
        text = f"has a zero that steps by {steps[k]:.3g} {unit} near {at:.3g} s: another range, or a cable that moved?"
        return Contradiction(text)
    return Contradiction(f"has a zero that drifts by {size:.3g} {unit}: its amplifier, or the temperature?")


STEPS_CHANNEL_CHANGES = ("gain", "clock")  # kinds of changes that one channel alone can have, and that last
MOST_CHANNELS = 8  # tried
MUCH = 10.0  # χ² per degree of freedom of a fit that another start may better


@dataclass(frozen=True)
class ChannelChange:
    """What is wrong with one channel, and χ² per degree of freedom of the fit without it.

    Either a cause, all the time, or a change in the course of a record.
    """

    left: float
    change: TimeChange | None = None
    cause: Cause | None = None


def channel_changes(
    model: Model, spectrum: Spectrum, estimate: Estimate, most: float, of_forms: float
) -> list[ChannelChange]:
    """Channels of motions without which the rig fits, and which that fit says to be wrong in one way; the best first.

    spectrum: with the noise that trials use; most, of_forms: χ² per degree of freedom that a fit without the
    channel leaves, where that changes in time, and where it is wrong throughout in a way that has a name.
    """
    motions = [c for c, channel in enumerate(spectrum.channels) if not measures_input(model, channel)]
    if not 1 < len(motions) <= MOST_CHANNELS or spectrum.amplitudes.size > MOST_AMPLITUDES:
        return []
    tried = [_without(model, spectrum, estimate, c, of_forms) for c in motions]
    named = [each for each in tried if each is not None and (each.cause is not None or each.left < most)]
    return sorted(named, key=lambda each: each.left)


def _without(
    model: Model, spectrum: Spectrum, estimate: Estimate, c: int, most: float
) -> ChannelChange | None:
    """The change of channel c against the fit without it; None where that does not fit or shows none."""
    amplitudes = np.array(spectrum.amplitudes)
    amplitudes[:, c] = np.nan
    try:
        data = prepare(model, replace(spectrum, amplitudes=amplitudes), states=False)
    except DashpotError:
        return None
    exact, sign = measured(data), spectrum.signs(estimate.signs)
    if exact.ends is None:
        return None
    row, dof = np.zeros(1, dtype=np.int64), max(exact.rows - len(estimate.values), 1)
    ends, chi2 = descended(data.view, exact, estimate.values[None], sign, row, LONG)
    if chi2[0] > MUCH * dof:  # the fit to all channels may have ended where nothing leads to the rig
        begun = _begun_without(model, spectrum, estimate, c)
        others = descended(data.view, exact, begun[None], sign, row, LONG)
        ends, chi2 = others if others[1][0] < chi2[0] else (ends, chi2)
    left = float(chi2[0]) / dof
    if not left < most:
        return None
    with np.errstate(all="ignore"):
        fit = record_fit(data.view, exact, ends, sign)
        predicted: Complex = np.einsum("lq,lq->l", fit.rig.G[0, :, c], fit.motion[0])
    if not np.all(np.isfinite(spectrum.amplitudes[:, c] - predicted)):
        return None
    return _told(model, spectrum, c, predicted + _of_its_ends(spectrum, c, predicted), left)


def _of_its_ends(spectrum: Spectrum, c: int, predicted: Complex) -> Complex:
    """What the ends of each record add to a channel of velocity or acceleration beyond the motion, (lines,).

    A polynomial of s for each derivative (THEORY §8), which the channels of the fit do not tell: it stands at the ends.
    """
    added: Complex = np.zeros_like(predicted)
    for number in spectrum.records if spectrum.channels[c].quantity.derivative else ():
        its = np.flatnonzero(spectrum.stretch == number)
        s = 1j * spectrum.omega[its] / np.max(spectrum.omega[its])
        powers = s[:, None] ** np.arange(spectrum.channels[c].quantity.derivative)
        left = spectrum.amplitudes[its, c] - predicted[its]
        columns, both = (np.concatenate([part.real, part.imag]) for part in (powers, left))
        added[its] = powers @ np.linalg.lstsq(columns, both, rcond=None)[0]
    return added


def _told(model: Model, spectrum: Spectrum, c: int, predicted: Complex, left: float) -> ChannelChange | None:
    """How channel c differs from what the fit without it predicts, (lines,); None where no form says it."""
    channel, y = spectrum.channels[c], spectrum.amplitudes[:, c]
    forms = list[Likeness | Contradiction | None]()
    for number in spectrum.records:
        its = np.flatnonzero(spectrum.stretch == number)
        stretch = spectrum.stretches[number]
        assert isinstance(stretch, WholeRecord)
        f = spectrum.frequency_hz[its]
        lines = ComparedLines(y[its], predicted[its], f, stretch.orders(f), stretch.duration_s)
        forms.append(contradiction_in_record(lines, channel_unit(model, channel)))
    causes = [_cause(channel.name, form, left) for form in forms if form is not None]
    surely = [cause for cause in causes if cause.kind != "gain"]
    if surely:
        return ChannelChange(left, cause=surely[0])

    def unweighted(lines: Ints, _: int) -> tuple[Complex, Complex]:
        return (y - predicted)[lines], predicted[lines]

    found = time_changes(unweighted, spectrum, np.array([c]))
    lasting = [change for change in found if change.kind in STEPS_CHANNEL_CHANGES]
    named = lasting or [change for change in found if change.kind == "jump"]
    if lasting or not causes:  # a gain that steps is on the whole another gain
        return ChannelChange(left, change=named[0]) if named else None
    return ChannelChange(left, cause=causes[0])


def _cause(name: str, form: Likeness | Contradiction, left: float) -> Cause:
    """What a form of the channel of that name says, as a cause; left: χ² per degree of freedom without the channel."""
    if isinstance(form, Likeness):
        return Cause(form.kind, (name,), left, form.found, form)
    return Cause("channel", (name,), left, contradiction=form)


def _begun_without(model: Model, spectrum: Spectrum, estimate: Estimate, c: int) -> Real:
    """ψ (M,) that lines without transients give without channel c, of a search from afar."""
    data = prepare(model, steady_lines(model, spectrum), states=False)
    base = untouched(data)
    dropped = np.zeros(base.kept.shape, dtype=bool)
    dropped[:, c] = True
    bench = Workbench(data, estimate.values, spectrum.signs(estimate.signs)[0])
    return bench.searched([without(base, "channel", (spectrum.channels[c].name,), dropped)])[0].psi
