"""Single lines of whole records that stand out of a noise which is itself read from the residuals."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Bools, Ints, Real
from dashpot.check.residuals import Residuals
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.likelihood.record_noise import RESIDUAL
from dashpot.io.words import joined
from dashpot.notices import Notice

IMPROBABLE = 1e-4  # chance of the largest residual of a right rig
FELT = 0.005  # of a channel's largest amplitude: what stands out less is of no account
MAINS_HZ = (50.0, 60.0)
UNDRIVEN = 0.3  # of an amplitude: what the rig can explain of a tone that nothing drives


def standing_out(left: Residuals, spectrum: Spectrum, outputs: Bools, hum: Bools) -> list[Notice]:
    """Outputs with a line that noise of the size of all the others would not show; `hum` (lines, channels) apart.

    Where the mean of n squares scales them, the largest of N exceeds s² with a chance of about N (1 − s²/n)ⁿ⁻¹
    (Fisher 1929).
    """
    of_residuals = np.array([kind == RESIDUAL for kind in spectrum.noise])
    if not np.any(of_residuals):
        return []
    square = np.where(of_residuals[:, None] & outputs, np.nan_to_num(np.abs(left.normalised)) ** 2 / 2, 0.0)
    square[hum] = 0.0
    square[_slight(left)] = 0.0
    n = np.maximum(spectrum.dof / 2, 2.0)[:, None]
    with np.errstate(divide="ignore"):
        chance = np.sum(of_residuals) * np.exp((n - 1) * np.log1p(-np.minimum(square / n, 1.0)))
    worst: Ints = np.argmin(chance, axis=0)
    notices = []
    for c in np.flatnonzero(np.min(chance, axis=0) < IMPROBABLE):
        name, line = left.channels[c], worst[c]
        off = f"{np.sqrt(square[line, c]):.2g} sd off"
        text = f"{name} at {left.frequency_hz[line]:.4g} Hz is {off}, more than noise explains"
        notices.append(Notice("standing_out", text, (name,)))
    return notices


def hum_notices(left: Residuals, outputs: Bools, hum: Bools) -> list[Notice]:
    """Outputs (channels,) that carry the tone of the mains, `hum` (lines, channels)."""
    hums = hum & outputs & (np.abs(np.nan_to_num(left.normalised)) ** 2 / 2 > 16)
    names = tuple(name for name, there in zip(left.channels, np.any(hums, axis=0), strict=True) if there)
    if not names:
        return []
    at = np.unique(_multiple(left.frequency_hz[np.any(hums, axis=1)]))
    where = joined(f"{f:g}" for f in at)
    carry = "carries" if len(names) == 1 else "carry"
    text = f"{joined(names)} {carry} a tone at {where} Hz that nothing drives: mains hum?"
    return [Notice("mains_hum", text, names)]


def mains_hum(left: Residuals, spectrum: Spectrum) -> Bools:
    """Amplitudes of whole records beside a multiple of the mains' frequency that the rig does not explain.

    (lines, channels).
    """
    duration_s = np.array([getattr(stretch, "duration_s", 0.0) for stretch in spectrum.stretches])
    near = np.abs(left.frequency_hz - _multiple(left.frequency_hz)) * duration_s[spectrum.stretch]
    whole = np.isin(spectrum.stretch, spectrum.records)
    with np.errstate(invalid="ignore"):
        undriven = np.abs(left.predicted) < UNDRIVEN * np.abs(left.measured)
    hum: Bools = (whole & (near <= 2.0))[:, None] & undriven
    return hum


def _multiple(frequency_hz: Real) -> Real:
    """The multiples of a mains frequency that are nearest, (lines,)."""
    mains = np.array(MAINS_HZ)
    around = mains * np.maximum(np.round(frequency_hz[:, None] / mains), 1)
    nearest = np.argmin(np.abs(around - frequency_hz[:, None]), axis=1)
    multiple: Real = around[np.arange(len(around)), nearest]
    return multiple


def _slight(left: Residuals) -> Bools:
    away = np.abs(np.nan_to_num(left.measured - left.predicted))
    slight: Bools = away < FELT * np.nanmax(np.abs(np.nan_to_num(left.measured)), axis=0)
    return slight
