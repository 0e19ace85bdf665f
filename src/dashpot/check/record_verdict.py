"""The verdict on whole records of a nonlinear rig: by the signs of its parts, and by what an element more explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.channel import Channel
from dashpot.check.diagnosis.ranking import Cause, points_of
from dashpot.check.diagnosis.wording import finding, in_place_of_laws, laws_in_words, with_likely_causes
from dashpot.check.element_evidence import with_nothing
from dashpot.check.record_scores import CalledFor, element_called_for
from dashpot.check.uncertain_scores import element_of_uncertain
from dashpot.check.verdict import powerless, rejected, unphysical, worst_of
from dashpot.data.record import Record
from dashpot.errors import DashpotError, DataError, IdentifiabilityError
from dashpot.estimate.assessment import Assessment, Finding, Judgement, Misfit
from dashpot.estimate.nonlinear.record_inference import CUT_RECORD
from dashpot.estimate.nonlinear.record_prediction import (
    FollowedRecord,
    PredictedMotion,
    followed_record,
    followed_records,
)
from dashpot.estimate.nonlinear.starting_values import linear_rig
from dashpot.estimate.nonlinear.whole_record import FittedRecords, fit_records
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.notices import Notice


def examined_records(
    model: Model, records: Sequence[Record], estimate: Estimate, fitted: FittedRecords | None = None
) -> Estimate:
    """The estimate from whole records of a nonlinear rig with its assessment; `fitted` as of `assess_records`."""
    return replace(estimate, assessment=assess_records(model, records, estimate, fitted))


def assess_records(
    model: Model, records: Sequence[Record], estimate: Estimate, fitted: FittedRecords | None = None
) -> Assessment:
    """The verdict on an estimate from whole records; "fits" where χ² of a noise known from rest is no larger.

    It is "does not fit" where χ² rejects it, parts are negative, or an element more would explain what residuals are
    left (THEORY §9).
    Residuals are those of the motion that follows from the inputs and the start of each record; where it depends too
    much on its start to be followed, none are told.

    fitted: the fit that the estimate is of.  With noise of the inputs, residuals are beside the motion that their
    likeliest values give.  Without it the measured inputs count as exact.
    """
    against = [*unphysical(model, estimate), *rejected(estimate)]
    cut = any(notice.code == CUT_RECORD for notice in estimate.warnings)
    uncertain = fitted is not None and fitted.problem.inputs is not None and not cut
    called_for: CalledFor | None = None
    if uncertain and fitted is not None:
        trails = followed_records(fitted.problem, fitted.psi)
        called_for = element_of_uncertain(fitted.problem, fitted.psi) if bool(estimate.converged) else None
    else:
        trails = [] if cut else _followed(model, records, estimate)
        called_for = element_called_for(model, trails) if trails and bool(estimate.converged) else None
    findings: tuple[Finding, ...] = ()
    if called_for is not None:
        findings = (_finding(model, records[0].channels, called_for),)
        against = [*against, _reason(model, called_for)]
    elif not bool(estimate.converged):
        findings, reasons = _without_laws(model, records)
        against = [*against, *reasons]
    motions = [motion.compared() for motion in trails]
    doubts = [] if against else powerless(estimate)
    verdict: Judgement = "does not fit" if against else "cannot tell" if doubts else "fits"
    return Assessment(verdict, (*against, *doubts), _relative(motions), _worst(motions), findings)


def explained(error: IdentifiabilityError, model: Model, records: Sequence[Record]) -> IdentifiabilityError:
    """The error of a fit whose laws leave no trace, with the element that the records call for in their place."""
    findings, _ = _without_laws(model, records)
    return with_likely_causes(error, findings)


def _without_laws(model: Model, records: Sequence[Record]) -> tuple[tuple[Finding, ...], tuple[Notice, ...]]:
    """What the records call for where the rig's own nonlinear elements are left out, and that they do; () for none."""
    try:
        linear = with_nothing(linear_rig(model))
        fitted = fit_records(linear, records, exact_inputs=True)
        called_for = element_called_for(linear, followed_records(fitted.problem, fitted.psi))
    except DashpotError:
        return (), ()
    if called_for is None:
        return (), ()
    what = _finding(model, records[0].channels, called_for)
    reason = _reason(model, called_for)
    text = reason.text.replace(
        "of the residuals", f"of the residuals of the rig without {laws_in_words(model)}"
    )
    return (in_place_of_laws(model, what),), (replace(reason, text=text),)


def _finding(model: Model, channels: Sequence[Channel], called_for: CalledFor) -> Finding:
    """The element as what may be wrong, with its line of the rig file; it was not fitted."""
    element = called_for.element
    kind = "element" if element.force_law is None else "nonlinear"
    cause = Cause(kind, points_of(element, model), 1 - called_for.share, called_for.value, element=element)
    return replace(finding(model, tuple(channels), cause), remaining=None)


def _reason(model: Model, called_for: CalledFor) -> Notice:
    element, points = called_for.element, points_of(called_for.element, model)
    part = f"a missing {element.kind.value}" if element.force_law is None else "a nonlinear element"
    place = f"at {points[0]}" if element.kind is Kind.MASS else f"between {joined(points)}"
    text = f"{part} {place} explains {100 * called_for.share:.0f} % of the residuals (p < 1e-6)"
    return Notice("element_called_for", text, points)


def _followed(model: Model, records: Sequence[Record], estimate: Estimate) -> list[FollowedRecord]:
    try:
        return [followed_record(model, estimate, record) for record in records]
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
    return worst_of(misfits)
