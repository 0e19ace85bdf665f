"""What to do next with an estimate, in sentences; commands are named with the files they would take."""

from __future__ import annotations

from collections.abc import Sequence

from dashpot.check.data_findings import Collinearity
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.present.text.assessment import remaining_in_words
from dashpot.present.text.numbers import percent

MOST_NAMES = 4
NOISE = (
    "Give the noise of the sensors, so that the fit can be tested: columns NAME_sd, longer dwells or repeated tests, "
    "or a record at rest (--noise-record)."
)
LOOK = (
    "Look where the residuals are largest: an element or a motion is missing there or a value is wrong, and none of "
    "the usual mistakes explains it."
)
UNTIL = (
    "Until the model fits, use the values only within the frequencies of this test: they are the best for this model, "
    "and their intervals are widened for the misfit."
)


def next_steps(
    estimate: Estimate, doubtful: Sequence[str], weak: Collinearity | None, *, plannable: bool = True
) -> list[str]:
    """The most useful things to do, the first first; `plannable`: whether `dashpot design` knows the rig."""
    if not bool(estimate.converged):
        return [
            "Do not use these values.",
            'Check the signs and units of the channels: gain = "unknown" for all but one shows a wrong one.',
            "Give the unknowns guesses, or try another method (dashpot compare shows several).",
        ]
    steps = _on_fit(estimate)
    parameters = [name for name in doubtful if "." not in name]
    rig = estimate.rig or "rig.toml"
    if parameters:
        shown = joined(parameters[:MOST_NAMES]) + (" and others" if len(parameters) > MOST_NAMES else "")
        pronoun = "it" if len(parameters) == 1 else "them"
        hint = (
            f" Design the next test for {pronoun}: {_design(rig, parameters[:MOST_NAMES])}."
            if plannable
            else ""
        )
        steps.append(
            f"{shown} {'is' if len(parameters) == 1 else 'are'} poorly determined: the interval extends more than "
            f"half the value to either side.{hint}"
        )
    elif plannable and (least := _least_known(estimate)) is not None:
        steps.append(
            f"The least certain is {least[0]} (± {least[1]} %). To plan a test for it: {_design(rig, [least[0]])}."
        )
    if weak is not None and weak.combinations:
        worst = weak.combinations[0]
        steps.append(
            f"{joined(worst.names[:MOST_NAMES])} are strongly correlated: "
            f"if {worst.best} were known from elsewhere, their intervals would shrink to "
            f"{percent(worst.narrowing, 1.0)} %."
        )
    if estimate.assessment is not None and estimate.assessment.verdict == "fits":
        steps.append(
            "Before relying on the result, predict a test that was not used: dashpot validate estimate.json OTHER.csv."
        )
    return steps


def _design(rig: str, names: Sequence[str]) -> str:
    """The command that plans a test for some unknowns."""
    return f"dashpot design {rig} --after estimate.json --for {','.join(names)} --samples N"


def _on_fit(estimate: Estimate) -> list[str]:
    """What the verdict asks for."""
    assessment = estimate.assessment
    if assessment is None or assessment.verdict == "fits":
        return []
    if assessment.verdict == "cannot tell":
        if not estimate.fit.known_noise:
            return [NOISE]
        return ["Measure where the rig moves more, or longer: these data cannot confirm the model."]
    if assessment.findings:
        best = assessment.findings[0]
        outlook = remaining_in_words(best)
        step = f"Try the most likely cause: {best.change}."
        if outlook:
            step += f" {outlook.capitalize()}."
        if best.channels or best.elements:
            step += " dashpot identify --apply NEW.toml writes that rig file."
        return [step]
    return [LOOK, UNTIL]


def _least_known(estimate: Estimate) -> tuple[str, str] | None:
    """The parameter with the largest relative standard deviation, with it in per cent; None where there is none."""
    pairs = [
        (float(sd / abs(value)), name, float(sd), float(value))
        for name, sd, value in zip(estimate.names, estimate.sd, estimate.values, strict=True)
        if value != 0 and "." not in name
    ]
    if not pairs:
        return None
    _, name, sd, value = max(pairs)
    return name, percent(sd, value)
