"""Channels whose own numbers say that they measured nothing: still, stuck at one value, or below their noise."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import SettledDwell
from dashpot.estimate.inference.diagnostics import dead_channels
from dashpot.model.network import Model
from dashpot.model.observation import measures_input

HEARD = 3.0  # standard deviations that an amplitude must have to be more than noise
MOSTLY = 0.5  # share of a channel's lines
FEWEST = 4  # lines at which a channel that moves does not read alike
ALIKE = 1e-9  # of its size


def mostly_unheard(measured: Complex, sd: Real, lines: Bools) -> Bools:
    """Channels that are little else than noise at the given `lines` (lines,), (channels,).

    measured (lines, channels), NaN where nothing was; sd (lines, channels) of the real and of the imaginary part.
    """
    present = np.isfinite(measured) & lines[:, None]
    with np.errstate(invalid="ignore"):
        heard = present & (np.abs(measured) > HEARD * np.sqrt(2) * sd)
    share = np.sum(heard, axis=0) / np.maximum(np.sum(present, axis=0), 1)
    unheard: Bools = (share < MOSTLY) & np.any(sd > 0, axis=0)
    return unheard


def fundamental_lines(spectrum: Spectrum) -> Bools:
    """Lines at the frequency of the drive, (lines,): harmonics may well be noise."""
    orders = [
        shared.orders(np.array(f)) if isinstance(shared, SettledDwell) else 1
        for f, shared in zip(
            spectrum.frequency_hz, (spectrum.stretches[int(k)] for k in spectrum.stretch), strict=True
        )
    ]
    fundamental: Bools = np.array(orders) == 1
    return fundamental


def silent_channels(model: Model, spectrum: Spectrum) -> dict[str, str]:
    """What channels of moving points show that measured nothing; of one repeat, and of lines that are runs.

    The first repeat counts; below the noise is a channel only whose noise is known.
    """
    shows = dict.fromkeys(dead_channels(model, spectrum), "shows no motion at any line")
    first = (0,) * len(spectrum.batch)
    Y = spectrum.amplitudes[first]
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real[first]
    noisy = mostly_unheard(Y, np.sqrt(variance / 2), fundamental_lines(spectrum))
    for c, channel in enumerate(spectrum.channels):
        if measures_input(model, channel) or channel.name in shows:
            continue
        y = Y[np.isfinite(Y[:, c]), c]
        if len(y) >= FEWEST and np.all(np.abs(y - y[0]) <= ALIKE * np.abs(y[0])):
            shows[channel.name] = "reads the same at every line"
        elif noisy[c]:
            shows[channel.name] = "shows little but noise at most lines"
    return shows
