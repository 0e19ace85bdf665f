"""Dwells at which a nonlinear rig has more than one settled motion: the measured one has been taken."""

from __future__ import annotations

import numpy as np

from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.nonlinear.objective import nonlinear_part
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.model.nonlinear.harmonic_balance import periodic_response
from dashpot.notices import Notice

APART = 0.05  # relative difference of two motions
MOST = 6  # frequencies that are named


def several_motions(model: Model, spectrum: Spectrum, estimate: Estimate) -> list[Notice]:
    """A notice where the motion from the measured one differs from that which the linear response leads to.

    Folds lie around such dwells: a drive that is raised or swept otherwise would settle elsewhere.
    """
    try:
        part = nonlinear_part(prepare(model, spectrum), np.nan_to_num(spectrum.amplitudes)[None], None)
    except DashpotError:
        return []
    if part.start is None:
        return []
    theta = estimate.values[: len(model.unknowns)]
    rows = len(part.dwells.omega)
    p, constants = (
        np.tile(model.parameters(theta), (rows, 1)),
        np.tile(model.inner_constants(theta), (rows, 1)),
    )
    drive = part.dwells.drive(part.q[:1], model.D.shape[1])
    measured = periodic_response(model, p, constants, drive, part.start[0])
    other = periodic_response(model, p, constants, drive)
    size = np.max(np.abs(measured.delta), axis=(1, 2))
    away = np.max(np.abs(measured.delta - other.delta), axis=(1, 2))
    several = measured.converged & other.converged & (away > APART * size)
    if not np.any(several):
        return []
    frequencies = np.unique(np.round(part.dwells.omega[several] / (2 * np.pi), 9))
    named = [f"{f:.4g}" for f in frequencies[:MOST]]
    more = f" and {len(frequencies) - MOST} more" if len(frequencies) > MOST else ""
    where = f"{joined(named)} Hz{more}"
    text = f"folds lie around {where}: more than one motion is possible there; the measured one is used"
    return [Notice("several_motions", text)]
