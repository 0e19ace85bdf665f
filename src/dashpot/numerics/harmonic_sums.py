"""One pass over even samples: sums against sines and cosines, and the Gram of those columns in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.numerics.kernel import kernel, threads

CHUNK = 1 << 15  # samples that the NumPy twin works on at a time


@dataclass(frozen=True)
class HarmonicSums:
    """Sums over samples y_k, (N, channels), u_k = k − (N − 1)/2 being their index from the middle.

    waves (frequencies, channels) Σ y e^{j 2π turn u}; plain (channels,) Σ y; moment (channels,) Σ u y; largest |y|
    """

    waves: Complex
    plain: Real
    moment: Real
    largest: Real


def harmonic_sums(values: Real, turns: Real) -> HarmonicSums:
    """One pass over `values` (N, channels); `turns` (frequencies,) are cycles from one sample to the next."""
    core, origin = kernel(), (len(values) - 1) / 2
    if core is not None and 0 < values.shape[1] <= 64 and len(turns):
        sums = core.harmonic_sums(
            np.ascontiguousarray(values), np.ascontiguousarray(turns), origin, threads()
        )
        return HarmonicSums(*sums)
    channels = values.shape[1]
    waves = np.zeros((len(turns), channels), dtype=np.complex128)
    plain, moment, largest = np.zeros(channels), np.zeros(channels), np.zeros(channels)
    for first in range(0, len(values), CHUNK):
        y = values[first : first + CHUNK]
        u = np.arange(first, first + len(y)) - origin
        cycles = u[:, None] * turns
        waves += np.exp(2j * np.pi * (cycles - np.floor(cycles))).T @ y
        plain += np.sum(y, axis=0)
        moment += u @ y
        largest = np.maximum(largest, np.max(np.abs(y), axis=0))
    return HarmonicSums(waves, plain, moment, largest)


def even_gram(samples: int, turn: float, phase: float, orders: Sequence[int], degree: int) -> Real | None:
    """Σ a aᵀ over even samples of the columns a = (1, s)[: degree + 1], then cos kφ and sin kφ of each order.

    φ = phase + 2π turn u with u as in HarmonicSums and s = 2 u / (N − 1).  A sum of waves is Dirichlet's kernel
    D(ψ) = sin(Nψ/2) / sin(ψ/2), one weighted with u its slope, Σ u e^{jψu} = −j D′(ψ).  None where a wave aliases to a
    constant, where these lose their digits; `degree` is at most 1.
    """
    N, reach = samples, (samples - 1) / 2
    plain, ramp = {0: complex(N)}, {0: 0j}
    for m in {a + b for a in orders for b in (0, *orders)} | {a - b for a in orders for b in orders if a > b}:
        half = np.pi * m * turn
        if abs(np.sin(half)) < 1e-6:  # |sin ψ/2| of a sum of waves below which its closed form loses digits
            return None
        turned = np.exp(1j * m * phase)
        kernel_of = np.sin(N * half) / np.sin(half)
        slope = (N * np.cos(N * half) - kernel_of * np.cos(half)) / (2 * np.sin(half))
        plain[m], ramp[m] = turned * kernel_of, -1j * turned * slope / reach
        plain[-m], ramp[-m] = np.conj(plain[m]), np.conj(ramp[m])
    terms = degree + 1 + 2 * len(orders)
    gram = np.zeros((terms, terms))
    trend = [(plain, N), (ramp, N * (N + 1) / (3 * (N - 1)))][: degree + 1]
    for i, (sums, square) in enumerate(trend):
        gram[i, i] = square
        for k, a in enumerate(orders):
            c = degree + 1 + 2 * k
            gram[i, c], gram[i, c + 1] = sums[a].real, sums[a].imag
    for k, a in enumerate(orders):
        for q, b in enumerate(orders):
            c, d = degree + 1 + 2 * k, degree + 1 + 2 * q
            less, more = plain[a - b], plain[a + b]
            gram[c, d], gram[c + 1, d + 1] = (less + more).real / 2, (less - more).real / 2
            gram[c, d + 1], gram[c + 1, d] = (more - less).imag / 2, (more + less).imag / 2
    lower = np.tril_indices(terms, -1)
    gram[lower] = gram.T[lower]
    return gram
