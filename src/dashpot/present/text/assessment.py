"""The verdict on a fit and the diagnosis of a misfit, in sentences."""

from __future__ import annotations

import math

from dashpot.estimate.assessment import Assessment, Finding
from dashpot.estimate.result import Fit
from dashpot.io.words import joined
from dashpot.present.text.estimate import sentence
from dashpot.present.text.numbers import probability, short

ALTERNATIVES = 2  # causes named beside the first
ALIKE = 1.25  # greatest over least of figures that a range stands for
VERDICTS = {
    "fits": "The model fits",
    "does not fit": "The model does not fit",
    "cannot tell": "Whether the model fits, the data cannot tell",
}


def verdict_in_words(fit: Fit, assessment: Assessment) -> str:
    """The verdict with its reasons, and χ²."""
    reasons = joined(notice.text for notice in assessment.reasons if notice.code != "chi2")
    tested = fit.known_noise and fit.dof > 0
    residuals = f"residuals are {short(float(fit.misfit), 2)} × the noise" if tested else ""
    why = "; ".join(part for part in (reasons, residuals) if part)
    return f"{VERDICTS[assessment.verdict]}{why and ': '}{why}{_chi2(fit)}."


def _chi2(fit: Fit) -> str:
    if not fit.known_noise or fit.dof <= 0:
        return ""
    numbers = f"χ² = {short(float(fit.chi2))}, {fit.dof} degrees of freedom"
    if not math.isfinite(float(fit.p)):
        return f" ({numbers})"
    p = probability(float(fit.p))
    return f" ({numbers}, {f'p {p}' if p.startswith('<') else f'p = {p}'})"


def motion_in_words(assessment: Assessment) -> str:
    """How far measured and predicted amplitudes differ, in per cent of the motion, what of it is noise, where most."""
    parts = [f"{short(100 * part, 2)} % at {name}" for name, part in assessment.relative_residual.items()]
    sentence = (
        f"Measured and predicted motion differ by {joined(parts)}{_noise(assessment)}." if parts else ""
    )
    sentence += _described(assessment)
    if assessment.worst:
        worst = [
            f"{one.channel} at {short(one.frequency_hz, 4)} Hz ({short(one.sd, 2)} sd)"
            for one in assessment.worst
        ]
        sentence += f" Largest residuals: {joined(worst)}."
    return sentence.strip()


def _described(assessment: Assessment) -> str:
    """What of the motion the rig misses at the most beyond noise, where that is known of all and speaks for it."""
    shares = {name: share for name, share in assessment.discrepancy.items() if share is not None}
    if not shares or len(shares) < len(assessment.discrepancy) or assessment.verdict == "does not fit":
        return ""
    name, share = max(shares.items(), key=lambda each: each[1].upper95)
    bound, value = (f"{short(100 * size, 2)} %" for size in (share.upper95, share.value))
    most = (
        f"{value}, and at most {bound} (95 % bound)" if share.lower95 > 0 else f"at most {bound} (95 % bound)"
    )
    return f" Beyond noise, the model misses {most} of the motion{f' at {name}' if len(shares) > 1 else ''}."


def _noise(assessment: Assessment) -> str:
    """What of the difference is noise: a figure for each channel, in their order, or a range where they are alike."""
    noise = assessment.relative_noise.values()
    if not noise:
        return ""
    low, high = (f"{short(100 * size, 2)} %" for size in (min(noise), max(noise)))
    parts = [f"{short(100 * size, 2)} %" for size in noise]
    alike = low if low == high else f"{low.removesuffix(' %')} to {high}"
    return f"; noise alone would leave {alike if max(noise) <= ALIKE * min(noise) else joined(parts)}"


def diagnosis_in_words(findings: tuple[Finding, ...]) -> list[str]:
    """A line for each of the likeliest causes, with what to do about it."""
    lines = []
    for rank, finding in enumerate(findings[: 1 + ALTERNATIVES]):
        lead = "Likely cause" if rank == 0 else "Or"
        outlook = remaining_in_words(finding)
        cause = sentence(f"{lead}: {finding.text}{outlook and f' ({outlook})'}")
        stop = "" if finding.change.endswith("}") else "."  # a line of a rig file is to be copied as it is
        lines.append(f"{cause} To change: {finding.change}{stop}")
    return lines


def remaining_in_words(finding: Finding) -> str:
    """What residuals the remedy would leave; nothing where it was not tried."""
    if finding.remaining is None:
        return ""
    return f"residuals would fall to {short(max(finding.remaining, 0.0) ** 0.5, 2)} × the noise"
