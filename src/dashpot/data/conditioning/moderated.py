"""Variances of short dwells, moderated by those of the others (Smyth 2004; THEORY §11).

Stat. Appl. Genet. Mol. Biol. 3, article 3.  A dwell of ten samples knows its noise to a factor of two.  All dwells of
a channel together show how the noise goes
with the amplitude, and the scatter of ln s² about that line how far a single dwell may be from it: as if d₀ further
samples had been seen.  V = (d₀ V₀ + ν V) / (d₀ + ν), with d₀ + ν degrees of freedom.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import digamma, polygamma

from dashpot.arrays import Bools, Complex, Real
from dashpot.data.spectrum import Spectrum
from dashpot.notices import Notice

FEW = 50  # degrees of freedom from which on a dwell knows its own noise well enough
FEWEST_LINES = 3
FOR_A_SLOPE = (
    6  # lines from which on it is asked how the noise goes with the amplitude; below it is proportional
)
LEAST = 4.0  # degrees of freedom beyond the channels: below, a weight has no mean


def moderated(spectrum: Spectrum) -> Spectrum:
    """The same lines with the noise of those that have few samples moderated, and a note.

    It is unchanged where all have many samples.  Lines of white noise estimated from samples are moderated; repeats
    share d₀.
    """
    chosen = np.array([kind == "white" for kind in spectrum.noise]) & np.isfinite(spectrum.dof)
    short = chosen & (spectrum.dof < FEW)
    if not np.any(short) or np.sum(chosen) < FEWEST_LINES or np.any(np.isnan(spectrum.amplitudes)):
        return spectrum
    lines = spectrum.select(np.flatnonzero(chosen).tolist())
    prior, d0 = _prior(lines)
    nu = lines.dof
    channels = len(spectrum.channels)
    total = nu + d0
    weight = (nu / total)[:, None, None]
    V = weight * lines.covariance + (1 - weight) * prior
    # Too few samples in all for a weight that has a mean: the line counts for little, but counts.
    enough = np.maximum(total, channels + LEAST)
    V = V * (enough / total)[:, None, None]
    covariance, dof = np.array(spectrum.covariance), np.array(spectrum.dof)
    covariance[..., chosen, :, :] = V
    dof[chosen] = enough
    few = int(np.sum(short))
    text = (
        f"the noise of {few} short dwell{'s' if few > 1 else ''} ({np.min(nu):.3g} degrees of freedom) is pooled with "
        f"that of all {len(nu)}, as if each had {d0:.3g} more"
    )
    note = Notice("noise_moderated", text)
    return replace(spectrum, covariance=covariance, dof=dof, notes=(*spectrum.notes, note))


def _prior(lines: Spectrum) -> tuple[Complex, float]:
    """V₀ (..., lines, channels, channels) and d₀."""
    V = lines.covariance.reshape(-1, *lines.covariance.shape[-3:])
    count = lines.samples[:, None]
    variance = np.diagonal(V, axis1=-2, axis2=-1).real
    level = variance * count / 4
    power = np.abs(lines.amplitudes).reshape(-1, *lines.amplitudes.shape[-2:]) ** 2
    usable = np.all((variance > 0) & (power > 0), axis=(0, 1))
    d0, fitted = _scatter(level, power, lines.dof, usable)
    if np.isfinite(d0):
        fitted = fitted + float(digamma(d0 / 2) - np.log(d0 / 2))
    d0 = min(d0, (len(lines.dof) - 2) * float(np.mean(lines.dof)))
    with np.errstate(divide="ignore", invalid="ignore"):
        s0 = np.where(usable, np.exp(fitted) * 4 / count, variance)
        correlation = V / np.sqrt(variance[..., :, None] * variance[..., None, :])
    share = lines.dof / np.sum(lines.dof)
    R = np.sum(np.nan_to_num(correlation) * share[:, None, None], axis=-3, keepdims=True)
    sd = np.sqrt(s0)
    prior: Complex = R * sd[..., :, None] * sd[..., None, :]
    return prior.reshape(lines.covariance.shape), d0


def _scatter(level: Real, power: Real, nu: Real, usable: Bools) -> tuple[float, Real]:
    """d₀, and E ln s² of each line and channel as all dwells show it, (repeats, lines, channels)."""
    y = np.log(np.where(usable, level, 1.0)) - (digamma(nu / 2) - np.log(nu / 2))[:, None]
    x = np.log(np.where(usable, power, 1.0))
    known = polygamma(1, nu / 2)
    w = (1 / (known + 0.05))[:, None]
    x_mean, y_mean = (np.sum(w * v, axis=-2, keepdims=True) / np.sum(w) for v in (x, y))
    dx, dy = x - x_mean, y - y_mean
    slope, used = np.ones_like(x_mean), 1
    if y.shape[-2] >= FOR_A_SLOPE:
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = np.sum(w * dx * dy, axis=-2, keepdims=True) / np.sum(w * dx**2, axis=-2, keepdims=True)
        slope, used = np.clip(np.nan_to_num(slope, nan=1.0), 0.0, 1.0), 2
    fitted = y_mean + slope * dx
    left = (y - fitted)[..., usable]
    lines = y.shape[-2]
    if not left.size:
        return np.inf, fitted
    # Σ w r² has the expectation Σ w (trigamma(ν/2) + trigamma(d₀/2)) (lines − used) / lines.
    mean = float(np.mean(np.sum(w * left**2, axis=-2))) * lines / (lines - used)
    beyond = (mean - float(np.sum(w[:, 0] * known))) / float(np.sum(w))
    return (2 * _trigamma_inverse(beyond) if beyond > 0 else np.inf), fitted


def _trigamma_inverse(value: float) -> float:
    """x with ψ′(x) = value, by Newton's method on 1/ψ′ (Smyth 2004, appendix)."""
    x = 0.5 + 1 / value
    for _ in range(50):
        at = float(polygamma(1, x))
        step = at * (1 - at / value) / float(polygamma(2, x))
        x += step
        if abs(step) < 1e-10 * x:
            break
    return x
