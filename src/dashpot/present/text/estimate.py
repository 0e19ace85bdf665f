"""Sentences about an estimate: whether it converged, whether the model fits, what its intervals mean, warnings."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from dashpot.estimate.likelihood.input_noise import INPUT_NOISE
from dashpot.estimate.result import MISFIT, RESIDUALS, Estimate, Fit
from dashpot.io.words import joined
from dashpot.present.notices import OPTIONS, with_remedy
from dashpot.present.text.numbers import probability, short

SAID_BY_THE_FIT = ("model_misfit", "unknown_noise")  # codes


def fit_in_words(fit: Fit) -> str:
    """What χ² says, in one sentence."""
    if fit.dof <= 0:
        return "There are as many unknowns as measurements: the fit cannot be tested."
    numbers = f"χ² = {short(float(fit.chi2))}, {fit.dof} degrees of freedom"
    if not fit.known_noise:
        return (
            f"The noise is not known and is estimated from the residuals ({fit.dof} degrees of freedom), "
            "so the fit cannot be tested."
        )
    if not math.isfinite(float(fit.p)):
        return f"The fit cannot be tested: {numbers}."
    p = probability(float(fit.p))
    p = f"p {p}" if p.startswith("<") else f"p = {p}"
    ratio = float(fit.misfit)
    if bool(fit.rejected):
        return f"The model does not fit: residuals are {short(ratio, 2)} × the noise ({numbers}, {p})."
    if float(fit.p) > 0.999:
        return (
            f"Residuals are only {short(ratio, 2)} × the stated noise ({numbers}): "
            "the noise is stated too large, and so are the intervals."
        )
    return f"The model fits: residuals are {short(ratio, 2)} × the noise ({numbers}, {p})."


def basis_in_words(estimate: Estimate) -> str:
    """What ± is, and what it includes."""
    if estimate.basis == MISFIT:
        return (
            "± is one standard deviation. It is widened for the misfit of the model; "
            "'noise only' assumes a perfect model and is too small here."
        )
    if estimate.basis == RESIDUALS:
        return "± is one standard deviation, estimated from the scatter of the residuals."
    return "± is one standard deviation from the noise of the data."


def profiles_in_words(estimate: Estimate) -> str:
    """Which intervals are not symmetric, for they follow χ²; empty where all are normal."""
    names = list(estimate.profiles)
    if not names:
        return ""
    verb = "Profile interval" if len(names) == 1 else "Profile intervals"
    open_ended = [name for name in names if not all(map(math.isfinite, estimate.profiles[name][0]))]
    limit = f" The data set no limit on {joined(open_ended)} on one side." if open_ended else ""
    return f"{verb}: {joined(names)} (χ² is not parabolic there, so ± misleads).{limit}"


def inputs_in_words(estimate: Estimate) -> str:
    """How much noise is counted for the measured inputs of whole records, and which count as exact."""
    notes = [note.text for note in estimate.notes if note.code == INPUT_NOISE]
    return " ".join(sentence(text[0].upper() + text[1:]) for text in notes)


def bound_in_words(estimate: Estimate) -> str:
    """What the bound is; empty where there is none."""
    if not np.any(np.isfinite(estimate.bound_sd)):
        return ""
    return "The bound is the smallest ± that any unbiased method can reach (Cramér-Rao)."


def convergence_in_words(estimate: Estimate) -> str:
    """Whether the iteration converged."""
    count = int(estimate.iterations)
    if not bool(estimate.converged):
        return f"{estimate.method}: NOT CONVERGED after {count} iterations; these are the values of the last one."
    how = "in closed form" if count == 0 else f"converged in {count} iteration{'' if count == 1 else 's'}"
    return f"{estimate.method}: {how}."


def warnings_in_words(estimate: Estimate, *, untried: Collection[str] = tuple(OPTIONS)) -> tuple[str, ...]:
    """Warnings beside what fit and verdict say anyway, each with what to do about it.

    `untried`: treatments of time records that were not chosen; amplitudes are as they are.
    """
    said = dict.fromkeys(SAID_BY_THE_FIT, frozenset[str]())
    if estimate.assessment is not None:
        # A reason speaks for the warning of the same code, unless that concerns others than it names.
        said |= {notice.code: frozenset(notice.of) for notice in estimate.assessment.reasons}
        said |= {"reversed_phase": frozenset[str]()} if estimate.assessment.findings else {}
    return tuple(
        sentence(with_remedy(notice, untried=untried))
        for notice in estimate.warnings
        if notice.code not in said or (said[notice.code] and not said[notice.code].issuperset(notice.of))
    )


def sentence(text: str) -> str:
    """A text that ends with a full stop."""
    return text if text.endswith((".", "!", "?")) else f"{text}."


def aperiodic_in_words(rate: float) -> str:
    """What a mode without oscillation does, by its real eigenvalue in 1/s."""
    if rate == 0:
        return "moves freely, no restoring force"
    kind = "decays" if rate < 0 else "grows"
    return f"does not oscillate: {kind} in {short(1 / abs(rate))} s"
