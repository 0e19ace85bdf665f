"""What would make a rig have the modes that were measured: the engine on modes, and what modes alone may have wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dashpot.check.explain import channels, dwells, rigs
from dashpot.check.explain.channels import in_data
from dashpot.check.explain.effect import Baseline, Effect, Phrase, plainly
from dashpot.check.explain.engine import KINDS, LARGEST, allowing_for_causes, begun_at, explain_in_steps
from dashpot.check.explain.problem import ModalProblem
from dashpot.check.verdict import doubts_about, rejected, unphysical, unstable, worst_of
from dashpot.data.modal_data import ModalData
from dashpot.estimate.assessment import Assessment, Finding, Judgement, Misfit
from dashpot.estimate.modal import like_parts, mode_residuals, random_rigs
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

DAMPINGS = {2.0: "loss factors", 100.0: "per cent"}  # what may stand in the place of damping ratios
DRAWS = 4  # rigs drawn at random from which each fit starts as well, where the points do not show all


def diagnose_modes(
    model: Model, data: ModalData, estimate: Estimate, *, seed: int = 0
) -> tuple[tuple[Finding, ...], Estimate]:
    """What may be the matter where a rig has not the modes that were measured (no batch axes), the likeliest first; and
    the estimate with intervals that allow for it."""
    if model.n > LARGEST or not np.all(np.isfinite(estimate.values)):
        return (), estimate
    seen = set(data.points) == set(model.coordinates) and bool(np.all(np.isfinite(data.shapes)))
    drawn = random_rigs(model, data, 0 if seen else DRAWS, np.random.default_rng(seed))
    out = np.zeros((data.modes, len(data.points) + 2), dtype=bool)
    problem = ModalProblem(model, data, (estimate.values, like_parts(model, data), *drawn), out)
    found = explain_in_steps(begun_at(problem), OF_MODES)
    # The points of shapes have no line of their own in a rig file.
    of_points = ("sign", "unit", "gain", "swap")
    findings = tuple(
        replace(
            each, change=in_data(each, "the shapes") if each.kind in of_points else each.change, channels=()
        )
        for each in found.findings()
    )
    return findings, allowing_for_causes(model, estimate, found)


def damping(baseline: Baseline) -> Iterator[Effect]:
    """Loss factors or per cent in the place of damping ratios."""
    if np.any(baseline.problem.kept[:, -1]):
        yield Effect(
            "damping", (), lambda at, size: at.at_rate(1.0, 1 / size), _damped_words, tuple(DAMPINGS)
        )


def _damped_words(number: float) -> Phrase:
    text = f"the damping ratios are {number:g} × what the model gives: {DAMPINGS[number]}?"
    return Phrase(text, f"divide them by {number:g}")


def mode(baseline: Baseline) -> Iterator[Effect]:
    """Each mode left out, or its frequency or its damping alone."""
    kept = baseline.problem.kept
    for k, frequency in enumerate(baseline.problem.frequency_hz):
        label = f"{frequency:.4g} Hz"
        text = f"the mode at {label} disagrees with all others"
        words = Phrase(text, f"leave out the mode at {label}, or measure it again")
        for columns in (slice(None), slice(-2, -1), slice(-1, None)):
            out = np.zeros_like(kept)
            out[k, columns] = True
            if np.any(out & kept):
                yield Effect("mode", (label,), plainly("without", out), words, share=1 / len(kept))


LIKE_LINES = (
    channels.sign, channels.unit, channels.gain, channels.conjugate, channels.swap, channels.left_out, dwells.clock,
    rigs.element, rigs.value, rigs.hysteretic,
)  # fmt: skip
OF_MODES = (*((prior, kind) for prior, kind in KINDS if kind in LIKE_LINES), (0.1, damping), (0.1, mode))


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
