"""Fewer lines for a search from many starts: the loudest of each part of the band.

A whole record has thousands of lines, and a valley of the likelihood is as wide in a few hundred of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.observation import observation_model

MANY = 200  # lines from which a search takes fewer
PARTS = 30  # of the band, equal in the logarithm of frequency
EACH = 3  # lines of a part


def thinned(data: Prepared, each: int = EACH) -> Prepared:
    """The same data with `each` lines of every part of the band where there are many; itself where there are few or all
    are settled."""
    spectrum = data.spectrum
    if spectrum.lines <= MANY * each / EACH or not spectrum.records:
        return data
    lines = loudest(spectrum.frequency_hz, _loudness(data), each)
    fewer = replace(
        spectrum.select(lines),
        amplitudes=spectrum.amplitudes[:, lines],
        covariance=spectrum.covariance[:, lines],
    )
    states = None if data.states is None else data.states.lines(lines)
    view = observation_model(data.model, fewer.channels, fewer.omega)
    return replace(data, view=view, spectrum=fewer, covariance=data.covariance[:, lines], states=states)


def loudest(frequency_hz: Real, loudness: Real, each: int = EACH) -> Ints:
    """Indices of the loudest lines in each part of the band, ascending.  Both (lines,)."""
    position = np.log(frequency_hz / np.min(frequency_hz))
    part = np.minimum((PARTS * position / max(float(np.max(position)), 1e-12)).astype(int), PARTS - 1)
    order = np.lexsort((-loudness, part))
    before = np.searchsorted(part[order], np.arange(PARTS))
    rank = np.arange(len(order)) - before[part[order]]
    chosen: Ints = np.sort(order[rank < each])
    return chosen


def _loudness(data: Prepared) -> Real:
    """Power of all channels over their noise, mean over repeats; (lines,)."""
    power = np.abs(np.nan_to_num(data.spectrum.amplitudes)) ** 2
    noise = np.diagonal(data.covariance, axis1=-2, axis2=-1).real
    least = 1e-6 * np.mean(power, axis=-2, keepdims=True)
    ratio: Real = np.mean(np.sum(power / np.maximum(np.maximum(noise, least), 1e-300), axis=-1), axis=0)
    return ratio
