"""What parts of the data of one rig, each identified and examined by itself, say together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import bdtrc

from dashpot.check.verdict import (
    PERHAPS_UNSTABLE,
    rejected,
    unphysical,
    unstable,
    unstable_by_chance,
    worst_of,
)
from dashpot.estimate.assessment import Assessment, Finding, Judgement
from dashpot.estimate.merging import DISAGREE, Merged, merge_estimates
from dashpot.estimate.result import Estimate
from dashpot.io.words import counted
from dashpot.model.network import Model
from dashpot.notices import Notice

ALARMS = 0.02  # of sound parts that are taken for misfits, at the most


def merged_parts(model: Model, names: Sequence[str], parts: Sequence[Estimate]) -> Estimate:
    """One estimate from those of parts that share no noise, assessed; `names` says which part each is of.

    Raises DataError where they cannot be merged.
    """
    together = merge_estimates(model, parts)
    assessed = [part.assessment for part in parts if part.assessment is not None]
    against = [
        *unphysical(model, together.estimate),
        *unstable(together.estimate),
        *rejected(together.estimate),
        *_disagreement(together, names),
        *_misfits(names, parts),
    ]
    doubts = [] if against else [*_common_doubts(assessed), *unstable_by_chance(together.estimate)]
    verdict: Judgement = "does not fit" if against else "cannot tell" if doubts else "fits"
    assessment = Assessment(
        verdict,
        (*against, *doubts),
        _over_parts([each.relative_residual for each in assessed]),
        worst_of(misfit for each in assessed for misfit in each.worst),
        _findings(assessed) if against else (),
        _over_parts([each.relative_noise for each in assessed]),
    )
    return replace(together.estimate, assessment=assessment, notes=(_how(together), *together.estimate.notes))


def _how(together: Merged) -> Notice:
    text = (
        f"{counted(len(together.away), 'part')} of the data, each identified by itself, and merged; their scatter "
        f"has χ² {together.chi2:.4g} with {together.dof} degrees of freedom (p = {together.p:.2g})"
    )
    return Notice("parts_merged", text)


def _disagreement(together: Merged, names: Sequence[str]) -> list[Notice]:
    """That the parts are not of one rig, if they are not."""
    if not together.disagree:
        return []
    part, unknown = divmod(int(np.argmax(np.abs(together.away))), len(together.estimate.names))
    name, away = together.estimate.names[unknown], together.away[part, unknown]
    text = (
        f"the parts disagree by more than their noise (p = {together.p:.1g}): {name} of {names[part]} lies "
        f"{abs(away):.3g} standard deviations {'above' if away > 0 else 'below'} the merged one"
    )
    return [Notice("parts_disagree", text, (name,))]


def _misfits(names: Sequence[str], parts: Sequence[Estimate]) -> list[Notice]:
    """That more parts do not fit than sound ones would, and why most of these do not."""
    wrong = [
        (name, part.assessment)
        for name, part in zip(names, parts, strict=True)
        if part.assessment is not None and part.assessment.verdict == "does not fit"
    ]
    if not wrong or bdtrc(len(wrong) - 1, len(parts), ALARMS) > DISAGREE:
        return []
    codes = Counter(reason.code for _, assessment in wrong for reason in assessment.reasons)
    most, _ = codes.most_common(1)[0]
    name, reason = next(
        (name, reason) for name, each in wrong for reason in each.reasons if reason.code == most
    )
    text = f"{len(wrong)} of {counted(len(parts), 'part')} do not fit by themselves: {reason.text} ({name})"
    return [Notice("parts_misfit", text, reason.of)]


def _common_doubts(assessed: Sequence[Assessment]) -> list[Notice]:
    """Why it cannot be told whether the rig fits, where most parts cannot tell; stability is for all to show."""
    doubts = [
        [reason for reason in each.reasons if reason.code != PERHAPS_UNSTABLE]
        for each in assessed
        if each.verdict == "cannot tell"
    ]
    unsure = [reasons for reasons in doubts if reasons]
    if 2 * len(unsure) <= len(assessed):
        return []
    codes = Counter(reason.code for reasons in unsure for reason in reasons)
    most, _ = codes.most_common(1)[0]
    return [next(reason for reasons in unsure for reason in reasons if reason.code == most)]


def _over_parts(shares: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The rms over the parts of a share of each channel's motion; of channels that all parts have."""
    names = [name for name in shares[0] if all(name in each for each in shares)] if shares else []
    return {name: float(np.sqrt(np.mean([each[name] ** 2 for each in shares]))) for name in names}


def _findings(assessed: Sequence[Assessment]) -> tuple[Finding, ...]:
    """Causes that parts name, those named by most first, and of these those that are named earlier."""
    count: Counter[tuple[str, tuple[str, ...]]] = Counter()
    best: dict[tuple[str, tuple[str, ...]], tuple[int, Finding]] = {}
    for each in assessed:
        for place, finding in enumerate(each.findings):
            key = finding.kind, finding.of
            count[key] += 1
            best[key] = min(best.get(key, (place, finding)), (place, finding), key=lambda entry: entry[0])
    ordered = sorted(best, key=lambda key: (-count[key], best[key][0]))
    return tuple(best[key][1] for key in ordered)
