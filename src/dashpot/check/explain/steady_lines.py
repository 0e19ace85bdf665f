"""Whole records as a few lines without transients, accurate to a few per cent, in which gross mistakes are sought.

A trial of a remedy is a fit, and with boundary loads hundreds of them take too long.  A Hann window does without the
loads: it is small where they act.  A record that moves at one frequency becomes one line of its second half, by when
most of the transient has died away; any other the loudest of its lines, seen through a window of its whole length.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.data.conditioning.whole_record import FLOOR
from dashpot.data.spectrum import SettledDwell, Spectrum, WholeRecord
from dashpot.estimate.likelihood.descent import loudest
from dashpot.estimate.likelihood.record_noise import RESIDUAL
from dashpot.model.network import Model
from dashpot.model.observation import measures_input

ACCURACY = {"tone": 0.01, "band": 0.05}  # of an amplitude: what the window lets through of transients
LEAST = 1e-3  # of a channel's size: noise that every line has
PART = {"tone": 0.5, "band": 1.0}  # of a record, from its end, that is looked through
TONAL = 0.8  # share of the inputs' power above which a record moves at one frequency
SEARCHED = np.linspace(-1.0, 1.0, 81)  # lines on either side of the loudest in which its frequency lies
LOUD = 0.1  # of the inputs' greatest amplitude: what a window lets through of neighbours drowns quieter lines
LINES = 90  # of all records that do not move at one frequency


def steady_lines(model: Model, spectrum: Spectrum) -> Spectrum:
    """The spectrum (no batch axes) with every whole record made of a few lines that carry no boundary loads."""
    driving = np.array([measures_input(model, channel) for channel in spectrum.channels])
    driving = driving if np.any(driving) else np.ones_like(driving)
    noise = working_noise(spectrum)
    records = spectrum.records
    share = max(1, LINES // (30 * max(len(records), 1)))
    frequency, amplitudes, variance, lines = [], [], [], []
    for number in records:
        its = np.flatnonzero(spectrum.stretch == number)
        record = spectrum.stretches[number]
        assert isinstance(record, WholeRecord)
        at, kind = _frequencies(spectrum, its, record.duration_s, driving, share)
        f, Y = spectrum.frequency_hz[its], np.nan_to_num(spectrum.amplitudes[its])
        window = PART[kind]
        A = _seen_through(at, f, Y, record.duration_s, window)
        nearest = its[np.argmin(np.abs(f[:, None] - at), axis=0)]
        frequency.append(at)
        amplitudes.append(np.where(np.isfinite(spectrum.amplitudes[nearest]), A, np.nan))
        variance.append(noise[nearest] * 1.5 / window + (ACCURACY[kind] * np.abs(A)) ** 2)
        lines.append(nearest)
    settled = np.flatnonzero(~np.isin(spectrum.stretch, records))
    chosen = np.concatenate([settled, *lines])
    taken = spectrum.select(chosen)
    V = np.array(np.broadcast_to(taken.covariance, (len(chosen), *taken.covariance.shape[1:])))
    V[len(settled) :] = np.concatenate(variance)[:, :, None] * np.eye(V.shape[-1])
    return replace(
        taken,
        frequency_hz=np.concatenate([spectrum.frequency_hz[settled], *frequency]),
        amplitudes=np.concatenate([spectrum.amplitudes[settled], *amplitudes]),
        covariance=V,
        dof=np.full(len(chosen), np.inf),
        noise=("white",) * len(chosen),
        moments=None,
        stretch=np.zeros(len(chosen), dtype=np.int64),
        stretches=(SettledDwell(),),
    )


def working_noise(spectrum: Spectrum) -> Real:
    """Variance of each line, (lines, channels): no more than the quietest record has of noise read from residuals.

    The quietest as it stands or in proportion to its motion, whichever is more: the residuals of a rig that does not
    fit are no noise.
    """
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real
    power = np.nan_to_num(np.abs(spectrum.amplitudes) ** 2)
    record = np.unique(spectrum.stretch, return_inverse=True)[1]
    size = np.stack([np.mean(power[record == k], axis=0) for k in range(np.max(record) + 1)])[record]
    known = np.where(np.isfinite(variance), variance, np.inf)
    with np.errstate(invalid="ignore", divide="ignore"):
        in_proportion = np.min(np.where(size > 0, known / size, np.inf), axis=0) * size
    quietest = np.fmax(np.min(known, axis=0), in_proportion)
    from_fit = np.array([kind in (RESIDUAL, FLOOR) for kind in spectrum.noise])
    working = np.where(from_fit[:, None], np.minimum(variance, quietest), variance)
    return np.nan_to_num(working) + LEAST**2 * np.mean(power, axis=0)


def _frequencies(
    spectrum: Spectrum, its: Ints, duration_s: float, driving: np.ndarray, share: int
) -> tuple[Real, str]:
    """Where a record is looked at, Hz, and whether it moves at one frequency ("tone") or in a "band"."""
    f = spectrum.frequency_hz[its]
    Y = np.nan_to_num(spectrum.amplitudes[its])[:, driving]
    size = np.sqrt(np.sum(np.abs(Y) ** 2, axis=0))
    Y = Y / np.where(size > 0, size, 1.0)
    power = np.sum(np.abs(Y) ** 2, axis=1)
    near = f[int(np.argmax(power))] + SEARCHED / duration_s
    there = np.sum(np.abs(_seen_through(near, f, Y, duration_s, PART["tone"])) ** 2, axis=1)
    if np.max(there) > TONAL * np.sum(power):
        return near[[int(np.argmax(there))]], "tone"
    seen = np.sum(np.abs(_seen_through_all(f, Y, duration_s)) ** 2, axis=1)
    loud = np.flatnonzero(seen > LOUD**2 * np.max(seen))
    return f[loud[loudest(f[loud], seen[loud], share)]], "band"


def _seen_through_all(f: Real, Y: Complex, duration_s: float) -> Complex:
    """As `_seen_through` the whole record at its own lines, three of which a Hann window joins; (lines, channels)."""
    line = np.rint(f * duration_s)
    follows = (np.diff(line) == 1)[:, None]
    seen = np.array(Y)
    seen[1:] -= 0.5 * np.where(follows, Y[:-1], 0.0)
    seen[:-1] -= 0.5 * np.where(follows, Y[1:], 0.0)
    return seen


def _seen_through(at: Real, f: Real, Y: Complex, duration_s: float, part: float) -> Complex:
    """Amplitudes at frequencies `at` through a Hann window over the last part of a record; (at, channels).

    Of lines Y (lines, channels) at f; phases count from the start of the record.
    """
    away = (f - at[:, None]) * duration_s  # in lines of the record
    x = away * part
    with np.errstate(divide="ignore", invalid="ignore"):
        window = np.where(np.abs(np.abs(x) - 1) < 1e-9, 0.5, np.sinc(x) / (1 - x**2))
    return (window * np.exp(2j * np.pi * away * (1 - part / 2))) @ Y
