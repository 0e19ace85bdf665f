"""The noise of amplitudes for which none is given, from how they scatter about smooth curves over frequency.

Amplitudes of densely spaced lines are smooth: about each line a complex polynomial goes through its neighbours, and
what scatters about it is noise (Schoukens et al., Mechanical Systems and Signal Processing 20, 2006).  The scatter of
all lines is drawn together as var = a² + b²|y|² for each channel (THEORY §11).  Where a polynomial of higher degree
leaves much less, the lines are too far apart for the motion between them, and show no noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.data.spectrum import Spectrum
from dashpot.notices import Notice

SMOOTH = "smooth"  # kind of noise
WINDOW = 9  # lines that a polynomial goes through
DEGREES = (3, 5)  # of the polynomial, and of the one that must leave as much


def with_local_noise(spectrum: Spectrum) -> Spectrum:
    """The same lines with the noise that they show; as they are where noise is known, or the lines are too far apart.

    A channel that is the same at all lines, as the input of a response function, is exact.
    """
    if spectrum.batch or spectrum.noise != ("unknown",) * spectrum.lines or spectrum.records:
        return spectrum
    covariance = np.zeros(spectrum.covariance.shape, dtype=np.complex128)
    dof = np.full(spectrum.lines, np.inf)
    for experiment in np.unique(spectrum.experiment):
        lines = np.flatnonzero(spectrum.experiment == experiment)
        lines = lines[np.argsort(spectrum.frequency_hz[lines], kind="stable")]
        f, y = spectrum.frequency_hz[lines], spectrum.amplitudes[lines]
        if len(lines) < 24 or np.any(np.diff(f) <= 0) or np.any(np.isnan(y)):  # lines of an experiment
            return spectrum
        behind = np.inf
        for c in range(y.shape[1]):
            if np.ptp(y[:, c].real) == 0 and np.ptp(y[:, c].imag) == 0:
                continue
            noise = _noise_of(f, y[:, c])
            if noise is None:
                return spectrum
            covariance[lines, c, c] = noise[0]
            behind = min(behind, noise[1])
        dof[lines] = behind
    if not np.any(covariance):
        return spectrum
    text = (
        "no noise is given: it is taken from the scatter of the amplitudes about smooth curves over frequency"
    )
    notes = (*spectrum.notes, Notice("noise_from_neighbours", text))
    return replace(spectrum, covariance=covariance, dof=dof, noise=(SMOOTH,) * spectrum.lines, notes=notes)


def _noise_of(f: Real, y: Complex) -> tuple[Real, float] | None:
    """Variance E|Δ|² of each line of a channel and the degrees of freedom behind it; None where none is to be seen."""
    low, high = (_scatter(f, y, degree) for degree in DEGREES)
    # 1.5: ratio of the variances that the two leave, above which the lower one is bent
    straight: Bools = _drawn_together(low) <= 1.5 * _drawn_together(high)
    # 0.5: share of the lines at which it must not be
    # 1e-18 of the mean square of the motion
    if np.mean(straight) < 0.5 or np.median(low[straight]) < 1e-18 * float(np.mean(np.abs(y) ** 2)):
        return None
    size = np.abs(y[straight]) ** 2
    variance = _of_constant_and_share(low[straight], size, np.abs(y) ** 2)
    # 0.3 of the motion: what scatters more is no noise about a curve
    if np.median(variance / np.maximum(np.abs(y) ** 2, 1e-300)) > 0.3**2:
        return None
    # Neighbouring windows share their lines: as many degrees of freedom as one window in WINDOW lines would give.
    free = 2.0 * (WINDOW - DEGREES[0] - 1) * np.sum(straight) / WINDOW
    return variance, float(free)


def _drawn_together(scatter: Real) -> Real:
    """The mean over neighbouring windows."""
    return np.convolve(np.pad(scatter, WINDOW // 2, mode="edge"), np.ones(WINDOW) / WINDOW, mode="valid")


def _scatter(f: Real, y: Complex, degree: int) -> Real:
    """(lines,): variance E|Δ|² about a polynomial through the WINDOW lines nearest to each."""
    count = len(f)
    first = np.clip(np.arange(count) - WINDOW // 2, 0, count - WINDOW)
    at = first[:, None] + np.arange(WINDOW)
    t = f[at] - f[at].mean(axis=1, keepdims=True)
    t = t / np.max(np.abs(t), axis=1, keepdims=True)
    Q = np.linalg.qr(t[..., None] ** np.arange(degree + 1))[0]
    z = y[at]
    left = z - np.einsum("lwd,ld->lw", Q, np.einsum("lwd,lw->ld", Q, z))
    return np.sum(np.abs(left) ** 2, axis=1) / (WINDOW - degree - 1)


def _of_constant_and_share(scatter: Real, size: Real, at: Real) -> Real:
    """a² + b²|y|² at the sizes |y|² `at`: gamma regression of the scatter on 1 and |y|², neither negative."""
    from scipy.optimize import nnls

    unit = float(np.mean(size))
    A = np.stack([np.ones_like(size), size / unit], axis=1)
    mean = np.full(len(scatter), float(np.mean(scatter)))
    coefficients = np.zeros(2)
    for _ in range(20):
        coefficients, _ = nnls(A / mean[:, None], scatter / mean)
        mean = np.maximum(A @ coefficients, 1e-12 * float(np.mean(scatter)))
    variance: Real = coefficients[0] + coefficients[1] * at / unit
    return np.maximum(variance, 1e-12 * float(np.mean(scatter)))
