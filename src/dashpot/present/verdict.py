"""The verdict on a fit and the diagnosis of a misfit, in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dashpot.estimate.assessment import Assessment, Finding
from dashpot.estimate.result import Estimate, Fit
from dashpot.io.words import joined
from dashpot.present.document import Paragraph, Verdict
from dashpot.present.words import capitalised, probability, sentence, short

# In words, for a page, and the style on a terminal.
VERDICTS: dict[str, tuple[str, Verdict, str]] = {
    "fits": ("The model fits", "good", "green"),
    "does not fit": ("The model does not fit", "bad", "bold red"),
    "cannot tell": ("Whether the model fits, the data cannot tell", "open", "yellow"),
}


def is_tested(fit: Fit) -> bool:
    """Whether χ² can test the fit at all."""
    return fit.known_noise and fit.dof > 0


def fit_in_words(fit: Fit) -> str:
    """What χ² says, in one sentence."""
    if fit.dof <= 0:
        return "There are as many unknowns as measurements: the fit cannot be tested."
    if not fit.known_noise:
        return (
            f"The noise is not known and is estimated from the residuals ({fit.dof} degrees of freedom), "
            "so the fit cannot be tested."
        )
    if not math.isfinite(float(fit.p)):
        return f"The fit cannot be tested: {_chi2(fit)}."
    ratio = short(float(fit.misfit), 2)
    if bool(fit.rejected):
        return f"The model does not fit: residuals are {ratio} × the noise ({_chi2(fit)})."
    if float(fit.p) > 0.999:
        return (
            f"Residuals are only {ratio} × the stated noise ({_chi2(fit, p=False)}): "
            "the noise is stated too large, and so are the intervals."
        )
    return f"The model fits: residuals are {ratio} × the noise ({_chi2(fit)})."


def _chi2(fit: Fit, *, p: bool = True) -> str:
    """χ², its degrees of freedom, and how likely a larger one is, where that is known."""
    numbers = f"χ² = {short(float(fit.chi2))}, {fit.dof} degrees of freedom"
    likely = probability(float(fit.p))
    if not p or not math.isfinite(float(fit.p)):
        return numbers
    return f"{numbers}, {f'p {likely}' if likely.startswith('<') else f'p = {likely}'}"


def verdict_in_words(fit: Fit, assessment: Assessment) -> str:
    """The verdict with its reasons, and χ²."""
    reasons = joined(notice.text for notice in assessment.reasons if notice.code != "chi2")
    residuals = f"residuals are {short(float(fit.misfit), 2)} × the noise" if is_tested(fit) else ""
    why = "; ".join(part for part in (reasons, residuals) if part)
    numbers = f" ({_chi2(fit)})" if is_tested(fit) else ""
    return f"{VERDICTS[assessment.verdict][0]}{why and ': '}{why}{numbers}."


def fit_paragraphs(estimate: Estimate) -> list[Paragraph]:
    """What is known of the fit: the verdict with its likely causes where it was assessed, else χ²."""
    fit, assessment = estimate.fit, estimate.assessment
    if assessment is None:
        style = ("red" if bool(fit.rejected) else "green") if is_tested(fit) else ""
        return [Paragraph(fit_in_words(fit), style)]
    said = Paragraph(verdict_in_words(fit, assessment), VERDICTS[assessment.verdict][2])
    # How far measured and predicted amplitudes differ, what of it is noise, and where most
    parts = [f"{short(100 * part, 2)} % at {name}" for name, part in assessment.relative_residual.items()]
    sentences = (
        [f"Measured and predicted motion differ by {joined(parts)}{_noise(assessment)}."] if parts else []
    )
    sentences += _described(assessment)
    if assessment.worst:
        worst = [
            f"{one.channel} at {short(one.frequency_hz, 4)} Hz ({short(one.sd, 2)} sd)"
            for one in assessment.worst
        ]
        sentences.append(f"Largest residuals: {joined(worst)}.")
    motion = Paragraph(" ".join(sentences))
    causes = [Paragraph(line, "cyan") for line in diagnosis_in_words(assessment.findings)]
    return [said, *([motion] if motion.text else []), *causes]


def headline(estimate: Estimate, unsure: Sequence[str]) -> str:
    """Whether to trust the answer, in one sentence."""
    if not bool(estimate.converged):
        return "No answer: the iteration did not converge. The values below are those of the last step."
    poor = [name for name in unsure if "." not in name]
    names = joined(poor[:4]) + (" and others" if len(poor) > 4 else "")
    rest = f" {names} {'is' if len(poor) == 1 else 'are'} poorly determined." if poor else ""
    assessment = estimate.assessment
    if assessment is None:
        return fit_in_words(estimate.fit) + rest
    if assessment.verdict == "does not fit":
        cause = assessment.findings[0].text if assessment.findings else ""
        why = f" Likely cause: {sentence(cause)}" if cause else ""
        return f"The model does not fit the data: do not sign these values as they are.{why}{rest}"
    return sentence(VERDICTS[assessment.verdict][0]) + rest


def page_verdict(estimate: Estimate) -> Verdict:
    """Whether an estimate is good, bad, or open."""
    if not bool(estimate.converged):
        return "bad"
    if estimate.assessment is not None:
        return VERDICTS[estimate.assessment.verdict][1]
    if not is_tested(estimate.fit):
        return "open"
    return "bad" if bool(estimate.fit.rejected) else "good"


def _described(assessment: Assessment) -> list[str]:
    """What of the motion the rig misses at the most beyond noise, where that is known of all and speaks for it."""
    shares = {name: share for name, share in assessment.discrepancy.items() if share is not None}
    if not shares or len(shares) < len(assessment.discrepancy) or assessment.verdict == "does not fit":
        return []
    name, share = max(shares.items(), key=lambda each: each[1].upper95)
    bound, value = (f"{short(100 * size, 2)} %" for size in (share.upper95, share.value))
    most = f"{value}, and at most {bound}" if share.lower95 > 0 else f"at most {bound}"
    where = f" at {name}" if len(shares) > 1 else ""
    return [f"Beyond noise, the model misses {most} (95 % bound) of the motion{where}."]


def _noise(assessment: Assessment) -> str:
    """What of the difference is noise: a figure for each channel, in their order, or a range where they are alike."""
    noise = assessment.relative_noise.values()
    if not noise:
        return ""
    low, high = (f"{short(100 * size, 2)} %" for size in (min(noise), max(noise)))
    parts = [f"{short(100 * size, 2)} %" for size in noise]
    alike = low if low == high else f"{low.removesuffix(' %')} to {high}"
    # figures within a quarter of each other are a range
    return f"; noise alone would leave {alike if max(noise) <= 1.25 * min(noise) else joined(parts)}"


def diagnosis_in_words(findings: tuple[Finding, ...]) -> list[str]:
    """A line for each of the likeliest causes, with its odds and what to do about it."""
    lines = []
    for rank, finding in enumerate(findings[:3]):  # the likeliest and two beside it
        group = findings[0].group is not None and finding.group == findings[0].group
        lead = "Likely cause" if rank == 0 else "Or, which these data cannot tell from it" if group else "Or"
        odds = "" if finding.odds is None else f" ({_percent(finding.odds)})"
        if finding.kind == "unexplained":
            lead, odds = "No cause found", ""
        stop = "" if finding.change.endswith("}") else "."  # a line of a rig file is to be copied as it is
        outlook = remaining_in_words(finding)
        parts = (
            f"{lead}{odds}: {sentence(finding.text)}",
            outlook and capitalised(sentence(outlook)),
            f"To change: {finding.change}{stop}",
        )
        lines.append(" ".join(part for part in parts if part))
    return lines


def _percent(odds: float) -> str:
    """Odds in per cent, never more certain than they can be kept."""
    return (
        "odds over 99 %" if odds >= 0.99 else "odds under 1 %" if odds <= 0.01 else f"odds {100 * odds:.0f} %"
    )


def remaining_in_words(finding: Finding) -> str:
    """What residuals the remedy would leave; nothing where it was not tried."""
    if finding.remaining is None:
        return ""
    return f"residuals would fall to {short(max(finding.remaining, 0.0) ** 0.5, 2)} × the noise"
