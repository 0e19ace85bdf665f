"""The verdict on whole records of a nonlinear rig: by the signs of its parts, and how far its motion is from theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.check.verdict import WORST, powerless, unphysical
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.estimate.assessment import Assessment, Judgement, Misfit
from dashpot.estimate.nonlinear.record_inference import CUT_RECORD
from dashpot.estimate.nonlinear.record_prediction import PredictedMotion, predict_record
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model


def examined_records(model: Model, records: Sequence[Record], estimate: Estimate) -> Estimate:
    """The estimate from whole records of a nonlinear rig with its assessment."""
    return replace(estimate, assessment=assess_records(model, records, estimate))


def assess_records(model: Model, records: Sequence[Record], estimate: Estimate) -> Assessment:
    """The verdict on an estimate from whole records, whose noise is that of its residuals: it never says "fits".

    Residuals are those of the motion that follows from the inputs and the start of each record; where it depends too
    much on its start to be followed, none are told.
    """
    against = unphysical(model, estimate)
    verdict: Judgement = "does not fit" if against else "cannot tell"
    cut = any(notice.code == CUT_RECORD for notice in estimate.warnings)
    motions = [] if cut else _motions(model, records, estimate)
    return Assessment(verdict, (*against, *powerless(estimate)), _relative(motions), _worst(motions))


def _motions(model: Model, records: Sequence[Record], estimate: Estimate) -> list[PredictedMotion]:
    try:
        return [predict_record(model, estimate, record) for record in records]
    except DataError:  # no motion can be followed
        return []


def _relative(motions: Sequence[PredictedMotion]) -> dict[str, float]:
    """Rms of measured − predicted over rms of measured, less its mean, over all records."""
    if not motions:
        return {}
    away = np.sum([len(motion.time) * motion.rms**2 for motion in motions], axis=0)
    size = np.sum([len(motion.time) * np.var(motion.measured, axis=0) for motion in motions], axis=0)
    parts = np.sqrt(away / np.where(size > 0, size, np.inf))
    return dict(zip(motions[0].names, parts.tolist(), strict=True))


def _worst(motions: Sequence[PredictedMotion]) -> tuple[Misfit, ...]:
    """The lines of the residuals' spectra that stand out most, against the rms of all lines of their channel."""
    misfits = []
    for motion in motions:
        residual = motion.measured - motion.predicted
        lines = np.abs(np.fft.rfft(residual - np.mean(residual, axis=0), axis=0))[1:]
        duration = len(motion.time) * float(motion.time[1] - motion.time[0])
        size = lines / np.maximum(np.sqrt(np.mean(lines**2, axis=0)), 1e-300)
        for name, column in zip(motion.names, size.T, strict=True):
            line = int(np.argmax(column))
            misfits.append(Misfit(name, (line + 1) / duration, float(column[line])))
    return tuple(sorted(misfits, key=lambda misfit: -misfit.sd)[:WORST])
