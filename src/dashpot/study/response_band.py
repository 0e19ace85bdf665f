"""The response to a record of the inputs that an estimate predicts, with what its uncertainty makes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.record import Record
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.study.nonlinear_motion import driven_record

STEP = 0.1  # standard deviations of an unknown, of the central differences


def response_band(
    model: Model, estimate: Estimate, channels: Sequence[Channel], drive: Record
) -> tuple[Record, Real]:
    """What the channels would show under the inputs of `drive`, from rest, without noise, and its standard deviation.

    The second is (samples, channels) in the units of the record's values: √(g Σ gᵀ) with the slopes g of each sample
    and the covariance Σ of the estimate.  Gains are those of the estimate where it has them.
    Raises DataError where the estimate is not of this rig, and as `driven_record`.
    """
    m = len(model.unknowns)
    estimate.require_unknowns(model.unknown_names)
    quiet = tuple(_calibrated(channel, estimate) for channel in channels)
    nobody = np.random.default_rng(0)  # the channels have no noise to draw

    def shown(theta: Real) -> Record:
        return driven_record(model, theta, quiet, drive, nobody)

    theta, covariance = np.array(estimate.values[:m]), np.array(estimate.covariance[:m, :m])
    predicted = shown(theta)
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    slopes = np.zeros((*predicted.values.shape, m))
    for j in np.flatnonzero(sd > 0):
        away = STEP * sd[j] * np.eye(m)[j]
        slopes[..., j] = (shown(theta + away).values - shown(theta - away).values) / (2 * STEP * sd[j])
    band = np.sqrt(np.maximum(np.einsum("sci,ij,scj->sc", slopes, covariance, slopes, optimize=True), 0.0))
    return predicted, band


def _calibrated(channel: Channel, estimate: Estimate) -> Channel:
    """The channel without noise, with the gain that the estimate found."""
    name = f"{channel.name if channel.same_gain_as is None else channel.same_gain_as}.gain"
    gain = estimate[name].value if channel.gain is None and name in estimate.names else channel.gain
    return replace(channel, noise=0.0, relative_noise=0.0, gain=gain)
