"""A channel that changes in the course of whole records, seen against what all other channels say of it.

In a fit to all channels the rig, its inputs and its ends give way to the one that is wrong, and its residual shows no
step.  Without that channel they do not, and what they predict of it shows when its gain or its clock changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.check.diagnosis.record_changes import MOST_AMPLITUDES
from dashpot.check.diagnosis.search import LONG, Workbench, descended
from dashpot.check.diagnosis.steady_lines import steady_lines
from dashpot.check.diagnosis.trials import untouched, without
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.inference.time_course import TimeChange, time_changes
from dashpot.estimate.likelihood.objective import measured, record_fit
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import measures_input

STEPS = ("gain", "clock")  # kinds of changes that one channel alone can have
MOST_CHANNELS = 8  # tried
MUCH = 10.0  # χ² per degree of freedom of a fit that another start may better


@dataclass(frozen=True)
class ChannelChange:
    """A change of one channel, and χ² per degree of freedom of the fit without that channel."""

    change: TimeChange
    left: float


def channel_changes(model: Model, spectrum: Spectrum, estimate: Estimate, most: float) -> list[ChannelChange]:
    """Channels of motions without which the rig fits, and whose gain or clock steps against that fit; the best first.

    spectrum: with the noise that trials use; most: χ² per degree of freedom that a fit without the channel leaves.
    """
    motions = [c for c, channel in enumerate(spectrum.channels) if not measures_input(model, channel)]
    if not 1 < len(motions) <= MOST_CHANNELS or spectrum.amplitudes.size > MOST_AMPLITUDES:
        return []
    tried = [_without(model, spectrum, estimate, c, most) for c in motions]
    return sorted((each for each in tried if each is not None), key=lambda each: each.left)


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
    residual = spectrum.amplitudes[:, c] - predicted
    if not np.all(np.isfinite(residual)):
        return None

    def unweighted(lines: Ints, channel: int) -> tuple[Complex, Complex]:
        return residual[lines], predicted[lines]

    steps = _steps(time_changes(unweighted, spectrum, np.array([c])))
    return ChannelChange(steps[0], left) if steps else None


def _begun_without(model: Model, spectrum: Spectrum, estimate: Estimate, c: int) -> Real:
    """ψ (M,) that lines without transients give without channel c, of a search from afar."""
    data = prepare(model, steady_lines(model, spectrum), states=False)
    base = untouched(data)
    dropped = np.zeros(base.kept.shape, dtype=bool)
    dropped[:, c] = True
    bench = Workbench(data, estimate.values, spectrum.signs(estimate.signs)[0])
    return bench.searched([without(base, "channel", (spectrum.channels[c].name,), dropped)])[0].psi


def _steps(changes: Sequence[TimeChange]) -> list[TimeChange]:
    return [change for change in changes if change.kind in STEPS]
