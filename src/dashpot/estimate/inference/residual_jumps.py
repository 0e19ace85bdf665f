"""Where the residuals of whole records jump: samples that were lost under even time stamps, or a blow no input shows.

Such a moment is a new start: its free decay is in no input and at neither end, so that the residual is loud for a short
time beside what it is before and after.  A model that does not fit is loud wherever the motion is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Complex, Real
from dashpot.data.stretch import WholeRecord, history_of_lines
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.likelihood.record_sums import record_residuals
from dashpot.estimate.method import Solution
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.observation import small
from dashpot.notices import Notice

BLOCKS = 48  # of a record
FEWEST = 10  # lines of a block: shorter records have fewer blocks, or none
LEVEL = 1e-6  # of the test in each block
LOUDER = 4.0  # times what the loudest motion elsewhere leaves over, relative to itself: then it is no misfit
DECAY = 4  # blocks that a jump decays in
ALONE = 2.0  # times as far above the usual as any block apart from these
MOST = 3  # records whose moments are named


def residual_jumps(data: Prepared, solution: Solution) -> list[Notice]:
    """A notice with the moment of each whole record at which its residuals jump (one repeat, linear rigs)."""
    spectrum, view = data.spectrum, data.view
    if len(solution.theta) != 1 or not spectrum.records or not small(view.model):
        return []
    exact = measured(data)
    if exact.ends is None:
        return []
    residual, _ = record_residuals(exact.record_pieces, solution.theta, spectrum.signs(solution.signs))
    size = np.sqrt(np.diagonal(exact.W[0], axis1=-2, axis2=-1).real)
    moments = []
    for number in spectrum.records:
        lines = np.flatnonzero(spectrum.stretch == number)
        value = spectrum.stretches[number]
        assert isinstance(value, WholeRecord)
        blocks = min(BLOCKS, len(lines) // FEWEST)
        if blocks > 4 * DECAY and not np.any(np.diff(lines) != 1):
            k = np.rint(spectrum.frequency_hz[lines] * value.duration_s).astype(np.int64)
            power, motion = (
                _powers(amplitudes, k, value.samples, blocks)
                for amplitudes in (residual[0, lines], (exact.y[0] * size)[lines])
            )
            channels = int(np.sum(np.any(residual[0, lines] != 0, axis=0)))
            j = _jump(_Powers(power, motion, 2 * len(lines) * channels / blocks))
            moments += [] if j is None else [f"{(j + 0.5) * value.duration_s / blocks:.4g} s"]
    if not moments:
        return []
    at = ", ".join(moments[:MOST]) + (", …" if len(moments) > MOST else "")
    text = (
        f"the residuals jump near {at} of the record and decay again: samples may be missing there although the time "
        "stamps are even, or something struck the rig that no input shows"
    )
    return [Notice("residual_jump", text)]


@dataclass(frozen=True)
class _Powers:
    """Mean power of residual and of motion in each block, (blocks,), and degrees of freedom of a block."""

    residual: Real
    motion: Real
    dof: float


def _powers(amplitudes: Complex, k: np.ndarray, samples: int, blocks: int) -> Real:
    """Mean power over all channels of lines k, (lines, channels), in blocks of a record, (blocks,)."""
    starts = np.linspace(0, samples, blocks, endpoint=False).astype(np.int64)
    power = np.zeros(blocks)
    for channel in amplitudes.T:
        if np.any(channel):
            power += np.add.reduceat(history_of_lines(channel, k, samples) ** 2, starts)
    return power / np.diff(np.append(starts, samples))


def _jump(powers: _Powers) -> int | None:
    """In which block a jump lies: loud at once, alone, and more than the motion explains; None where there is none."""
    E, blocks = powers.residual / np.median(powers.residual), len(powers.residual)
    loud = fdtrc(powers.dof, powers.dof * (blocks - 1), E) < LEVEL / blocks
    j = int(np.argmax(E))
    if not loud[j] or not 0 < j < blocks - 1:  # the terms of the ends have their own errors
        return None
    behind = np.arange(blocks) - j
    apart = (behind < -1) | (behind > DECAY)
    share = np.maximum(E - 1, 1 / np.sqrt(powers.dof)) / np.maximum(powers.motion, 1e-300)
    loudest = np.flatnonzero(apart)[np.argmax(powers.motion[apart])]
    alone = E[j] - 1 > ALONE * (np.max(E[apart]) - 1)
    return j if alone and share[j] > LOUDER * share[loudest] else None
