"""Modes that the free motion of a record does not show: values that rest on one of them rest on chance.

Without inputs the boundary loads of a record make all of its motion (THEORY §8).  Of a symmetric pencil the part of
mode λ, φ in the response D(s)⁻¹ (a + s b) is in proportion to φᵀ (a + λ b), whose covariance follows from that of the
loads.  Where no record shows it the likelihood takes the highest noise in the band for the mode, and states a deviation
as if that were one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincc

from dashpot.arrays import Real
from dashpot.estimate.likelihood.free_decay import moves_freely
from dashpot.estimate.likelihood.objective import measured, prior_precision
from dashpot.estimate.likelihood.record_passes import EndsFitted
from dashpot.estimate.likelihood.record_pieces import RecordPieces
from dashpot.estimate.likelihood.record_sums import ends_fitted, information_under
from dashpot.estimate.method import Solution
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.io.words import joined
from dashpot.model.modes import modes
from dashpot.notices import Notice
from dashpot.numerics.small_systems import scaled_inverse, standard_deviations

MODES_UNSEEN = "modes_unseen"
CHANCE = 1e-3  # p-value of a mode above which it may be the highest noise of the band
RESTS = 1.05  # times its standard deviation without the mode, from which on a value rests on it


@dataclass(frozen=True)
class _FreeMode:
    """A mode in the free motion: its frequency, Hz, its part q (records, 2), and how that follows from the loads,
    (records, 2, columns), and varies, (records, 2, 2)."""

    frequency_hz: float
    part: Real
    by_columns: Real
    covariance: Real

    def p_chance(self, lines: int, outputs: int) -> float:
        """p-value of the highest that noise shows anywhere in so many lines, in whatever shape suits it best."""
        square = np.einsum(
            "ri,rij,rj->", self.part, np.linalg.pinv(self.covariance, hermitian=True), self.part
        )
        return min(1.0, lines * float(gammaincc(outputs * len(self.part), square / 2)))


def modes_unseen(data: Prepared, solution: Solution) -> tuple[Notice, ...]:
    """That modes found in free motion (one repeat of a linear rig) may be noise, and which unknowns rest on them."""
    spectrum, view = data.spectrum, data.view
    model = view.model
    if not (moves_freely(model, spectrum) and len(solution.theta) == 1):
        return ()
    pieces, sign = measured(data).record_pieces, spectrum.signs(solution.signs)
    fit = ends_fitted(pieces, solution.theta, sign)
    low, high = np.min(spectrum.frequency_hz), np.max(spectrum.frequency_hz)
    unseen = [
        mode
        for mode in _free_modes(pieces, fit, solution.theta[0])
        if low <= mode.frequency_hz <= high and mode.p_chance(spectrum.lines, len(view.channels)) > CHANCE
    ]
    if not unseen:
        return ()
    sd, sd_without = (
        standard_deviations(
            scaled_inverse(
                information_under(pieces, solution.theta, sign, ends) + np.diag(prior_precision(view))
            )
        )[0]
        for ends in (fit, _without(fit, unseen))
    )
    rests = ~(sd_without < RESTS * sd)
    names = tuple(name for name, resting in zip(model.unknown_names, rests, strict=False) if resting)
    if not names:
        return ()
    text = (
        f"the free motion does not show the mode{'s' if len(unseen) > 1 else ''} found at "
        f"{joined(f'{mode.frequency_hz:.4g}' for mode in unseen)} Hz above the noise, and {joined(names)} "
        f"{'rest' if len(names) > 1 else 'rests'} on {'them' if len(unseen) > 1 else 'it'}: intervals do not hold"
    )
    return (Notice(MODES_UNSEEN, text, names),)


def _free_modes(pieces: RecordPieces, fit: EndsFitted, theta: Real) -> list[_FreeMode]:
    """All modes of a rig with the values θ but those that only drift."""
    model, n = pieces.ends.rig.model, pieces.ends.n
    of_rig = modes(model, model.parameters(theta[: len(model.unknowns)]))
    by_columns = np.zeros((*fit.z.shape[1:2], 2, fit.z.shape[-1]))
    free_modes = []
    for eigenvalue, shape, hz in zip(of_rig.eigenvalues, of_rig.shapes, of_rig.frequency_hz, strict=True):
        if hz == 0:
            continue
        by_impulse = np.broadcast_to(shape, (len(by_columns), n))
        by_doublet = eigenvalue / pieces.ends.highest[:, None] * shape
        by_loads = np.concatenate([by_impulse, by_doublet], axis=1)
        by = by_columns.copy()
        by[:, :, : 2 * n] = np.stack([by_loads.real, by_loads.imag], axis=1)
        part = np.einsum("rij,rj->ri", by, fit.z[0])
        free_modes.append(_FreeMode(float(hz), part, by, by @ fit.covariance[0] @ np.swapaxes(by, -1, -2)))
    return free_modes


def _without(fit: EndsFitted, unseen: list[_FreeMode]) -> EndsFitted:
    """The likeliest loads under which these modes are still."""
    by = np.concatenate([mode.by_columns for mode in unseen], axis=1)
    part = np.concatenate([mode.part for mode in unseen], axis=1)
    across = fit.covariance[0] @ np.swapaxes(by, -1, -2)
    z = fit.z[0] - (across @ np.linalg.pinv(by @ across, hermitian=True) @ part[..., None])[..., 0]
    return replace(fit, z=z[None])
