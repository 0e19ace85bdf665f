"""Second moments of the samples of a dwell, for the methods that work on samples."""

from __future__ import annotations

import numpy as np

from dashpot.data.calibration import real_factor
from dashpot.data.conditioning.regression import basis, cholesky_solve, chunks, factor, tiles, window
from dashpot.data.conditioning.settings import USUAL_DRIFT, Conditioning, Drift
from dashpot.data.record import Record
from dashpot.data.spectrum import Moments
from dashpot.errors import DataError


def second_moments(record: Record, drift: Drift = USUAL_DRIFT) -> Moments:
    """Σ q qᵀ of q = (channels, cos ωt, sin ωt), trend projected out of all alike; one line.

    Raises DataError for a channel with a known delay: it turns amplitudes, not samples.
    """
    for channel in record.channels:
        if channel.delay is not None and channel.delay != 0:
            raise DataError(
                f"channel {channel.name} has a delay of {channel.delay:g} s, which cannot be removed from samples",
                record.source,
                "shift its samples beforehand, or choose a method that works on amplitudes",
            )
    if record.frequency_hz is None:
        raise DataError("the drive frequency is not known", record.source, "give the frequency of the record")
    degree = Conditioning(drift=drift).degree
    samples, channels = record.values.shape[-2:]
    Y = record.values.reshape(-1, samples, channels)
    factors = np.array([1 / real_factor(channel) for channel in record.channels])
    centre, half = window(record.time)
    gram = np.zeros((degree + 1, degree + 1))
    right = np.zeros((len(Y), degree + 1, channels + 2))
    for rows in chunks(samples):
        A = basis(record.time[rows], record.frequency_hz, (1,), degree, centre, half)
        gram += A[:, : degree + 1].T @ A[:, : degree + 1]
        for part in tiles(len(Y), len(A), channels):
            right[part, :, :channels] += A[:, : degree + 1].T @ (Y[part, rows] * factors)
            right[part, :, channels:] += A[:, : degree + 1].T @ A[:, degree + 1 :]
    trend = cholesky_solve(factor(gram, record, record.frequency_hz), right) if degree >= 0 else right
    products = np.zeros((len(Y), channels + 2, channels + 2))
    for rows in chunks(samples):
        A = basis(record.time[rows], record.frequency_hz, (1,), degree, centre, half)
        for part in tiles(len(Y), len(A), channels + 2):
            y = Y[part, rows] * factors
            q = np.concatenate([y, np.broadcast_to(A[:, degree + 1 :], (*y.shape[:-1], 2))], axis=-1)
            q = q - A[:, : degree + 1] @ trend[part]
            products[part] += np.swapaxes(q, 1, 2) @ q
    return Moments(products.reshape(*record.values.shape[:-2], 1, channels + 2, channels + 2))
