"""The repeats of a test, the leading axes of a Spectrum, as one axis and in chunks."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod

import numpy as np

from dashpot.data.spectrum import Moments, Spectrum


def flattened(spectrum: Spectrum) -> Spectrum:
    """The same spectrum with exactly one leading axis of repeats on amplitudes, covariance (or 1) and moments."""
    if len(spectrum.batch) == 1 and spectrum.covariance.ndim == 4 and spectrum.moments is None:
        return spectrum
    repeats = prod(spectrum.batch)
    V = spectrum.covariance
    if V.ndim == 3:
        V = V[None]
    elif V.shape[:-3] != (1,):
        V = np.broadcast_to(V, (*spectrum.batch, *V.shape[-3:])).reshape(repeats, *V.shape[-3:])
    moments = None
    if spectrum.moments is not None:
        M = spectrum.moments.products
        moments = Moments(
            np.broadcast_to(M, (*spectrum.batch, *M.shape[-3:])).reshape(repeats, *M.shape[-3:])
        )
    amplitudes = spectrum.amplitudes.reshape(repeats, *spectrum.amplitudes.shape[-2:])
    return spectrum.derived(amplitudes=amplitudes, covariance=V, moments=moments)


def in_chunks(flat: Spectrum, size: int) -> Iterator[Spectrum]:
    """The repeats of a flat spectrum, `size` at a time."""
    if len(flat.amplitudes) <= size:
        yield flat
        return
    for first in range(0, len(flat.amplitudes), size):
        rows = slice(first, first + size)
        V = flat.covariance if len(flat.covariance) == 1 else flat.covariance[rows]
        moments = None if flat.moments is None else Moments(flat.moments.products[rows])
        yield flat.derived(amplitudes=flat.amplitudes[rows], covariance=V, moments=moments)
