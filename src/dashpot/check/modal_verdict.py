"""The verdict on a fit of measured modes: by χ², by the signs of the rig's parts, and what is worst."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.check.explain.modal import diagnose_modes
from dashpot.check.verdict import doubts_about, rejected, unphysical, unstable, worst_of
from dashpot.data.modal_data import ModalData
from dashpot.estimate.assessment import Assessment, Judgement, Misfit
from dashpot.estimate.modal import mode_residuals
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

FREQUENCY, DAMPING = "frequency", "damping ratio"  # in the place of a channel's name


def examined_modes(model: Model, data: ModalData, estimate: Estimate, *, seed: int = 0) -> Estimate:
    """The estimate from `data` (no batch axes) with its assessment, and a diagnosis where the rig does not fit."""
    assessment = assess_modes(model, data, estimate)
    if assessment.verdict == "does not fit" or not bool(estimate.converged):
        findings, estimate = diagnose_modes(model, data, estimate, seed=seed)
        assessment = replace(assessment, findings=findings)
    return replace(estimate, assessment=assessment)


def assess_modes(model: Model, data: ModalData, estimate: Estimate) -> Assessment:
    """The verdict on one estimate from measured modes; residuals of a point are in parts of its motion."""
    left = mode_residuals(model, data, estimate.values)
    against = [*unphysical(model, estimate), *unstable(estimate), *rejected(estimate)]
    doubts = [] if against else doubts_about(estimate)
    verdict: Judgement = "does not fit" if against else "cannot tell" if doubts else "fits"
    # Rms of measured − predicted over rms of measured at each point, shapes taken at the same size each
    parts = {}
    with np.errstate(invalid="ignore"):
        size = np.sqrt(np.nansum(np.abs(left.measured) ** 2, axis=1))
    for name, away, shown in zip(data.points, left.shape.T, left.measured.T, strict=True):
        there = np.isfinite(away) & (size > 0)
        motion = np.sum(np.abs(shown[there] / size[there]) ** 2)
        if motion > 0:
            parts[name] = float(np.sqrt(np.sum(np.abs(away[there] / size[there]) ** 2) / motion))
    with np.errstate(invalid="ignore", divide="ignore"):
        shapes = np.where(left.sd > 0, np.abs(left.shape) / left.sd, np.nan)
    columns = {FREQUENCY: np.abs(left.frequency), DAMPING: np.abs(left.damping)}
    columns |= dict(zip(data.points, shapes.T, strict=True))
    misfits = [
        Misfit(name, float(hz), float(sd))
        for name, column in columns.items()
        for hz, sd in zip(data.frequency_hz, column, strict=True)
        if np.isfinite(sd) and sd > 0
    ]
    return Assessment(verdict, (*against, *doubts), parts, worst_of(misfits))
