"""The response to a record of the inputs that an estimate predicts, with what its uncertainty makes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.record import Record
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.study.driven import driven_record

STEP = 0.1  # standard deviations of an unknown, of the central differences


def response_band(
    model: Model, estimate: Estimate, channels: Sequence[Channel], drive: Record
) -> tuple[Record, Real]:
    """What the channels would show under the inputs of `drive`, from rest, without noise, and its standard deviation.

    The second is (samples, channels) in the units of the record's values: √(g Σ gᵀ) with the slopes g of each sample
    and the covariance Σ of the estimate.  Gains, delays and signs are those of the estimate where it has them.
    Raises DataError where the estimate is not of this rig, and as `driven_record`.
    """
    estimate.require_unknowns(model.unknown_names)
    m, names = len(model.unknowns), estimate.names
    nobody = np.random.default_rng(0)  # the channels have no noise to draw

    def shown(psi: Real) -> Record:
        calibrated = _Calibrated(dict(zip(names, psi.tolist(), strict=True)), estimate.signs)
        moved = replace(drive, channels=tuple(map(calibrated, drive.channels)))
        return driven_record(model, psi[:m], tuple(map(calibrated, channels)), moved, nobody)

    psi, covariance = np.array(estimate.values), np.array(estimate.covariance)
    predicted = shown(psi)
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    slopes = np.zeros((*predicted.values.shape, len(psi)))
    for j in np.flatnonzero(sd > 0):
        away = STEP * sd[j] * np.eye(len(psi))[j]
        slopes[..., j] = (shown(psi + away).values - shown(psi - away).values) / (2 * STEP * sd[j])
    band = np.sqrt(np.maximum(np.einsum("sci,ij,scj->sc", slopes, covariance, slopes, optimize=True), 0.0))
    return predicted, band


@dataclass(frozen=True)
class _Calibrated:
    """Channels without noise, with the gains, delays and signs that an estimate found."""

    values: Mapping[str, float]
    signs: Mapping[str, Real]

    def __call__(self, channel: Channel) -> Channel:
        owner = channel.name if channel.same_gain_as is None else channel.same_gain_as
        gain = self.values.get(f"{owner}.gain") if channel.gain is None else channel.gain
        delay = self.values.get(f"{channel.name}.delay") if channel.delay is None else channel.delay
        sign = channel.sign
        if sign is None and channel.name in self.signs:
            sign = float(self.signs[channel.name])
        return replace(channel, noise=0.0, relative_noise=0.0, gain=gain, delay=delay, sign=sign)
