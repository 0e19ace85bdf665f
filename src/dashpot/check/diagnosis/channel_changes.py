"""A channel that is wrong in whole records, or from some time on, seen against what all other channels say of it.

In a fit to all channels the rig, its inputs and its ends give way to the one that is wrong, and its residual does not
show what it is.  Without that channel they do not, and what they predict of it shows its sign, its limits or when its
gain changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.check.diagnosis.contradictions import Contradiction
from dashpot.check.diagnosis.likeness import Likeness
from dashpot.check.diagnosis.ranking import Cause
from dashpot.check.diagnosis.record_changes import MOST_AMPLITUDES
from dashpot.check.diagnosis.record_contradictions import ComparedLines, contradiction_in_record
from dashpot.check.diagnosis.search import LONG, Workbench, descended
from dashpot.check.diagnosis.steady_lines import steady_lines
from dashpot.check.diagnosis.trials import untouched, without
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord
from dashpot.errors import DashpotError
from dashpot.estimate.inference.time_course import TimeChange, time_changes
from dashpot.estimate.likelihood.objective import measured, record_fit
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import channel_unit, measures_input

STEPS = ("gain", "clock")  # kinds of changes that one channel alone can have, and that last
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
    lasting = [change for change in found if change.kind in STEPS]
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
