"""Sentences about what the channels and the data can determine: structure, collinearity, profiles."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dashpot.check.data_findings import Collinearity, Combination
from dashpot.check.identifiability import Structure
from dashpot.check.profile import Profile
from dashpot.data.spectrum import Spectrum
from dashpot.io.words import joined, listed
from dashpot.present.text.numbers import alike, short


def structure_in_words(structure: Structure, channels: Sequence[str], lines: int | None = None) -> list[str]:
    """What a structure without deficiencies means, one paragraph each."""
    count = len(structure.names)
    unknowns = f"the {count} unknowns" if count > 1 else "the unknown"
    at = "" if lines is None else f" at these {lines} frequencies"
    paragraphs = [
        f"Identifiable: {unknowns} ({listed(structure.names)}) can be found from {listed(channels)}{at}."
    ]
    if structure.prior_dependent:
        paragraphs.append(f"Identifiable only through the prior on {listed(structure.prior_dependent)}.")
    for first, other in structure.permutation_ambiguities:
        paragraphs.append(
            f"{first} and {other} are unmeasured and interchangeable: the data cannot say which is which. "
            "Give an element of one of them a min or max."
        )
    return paragraphs


def combination_in_words(combination: Combination, units: dict[str, str]) -> str:
    """A combination of unknowns that the data hardly determine, its effect and its cure."""
    wide = short(max(combination.widening.tolist()), 2)
    if len(combination.names) == 1:
        name = combination.names[0]
        return f"{name} can hardly be separated from the other unknowns: that makes its interval {wide} times wider."
    moves = ", ".join(
        f"{name} {x:+.2g}" + (" s" if units.get(name) == "s" else "")
        for name, x in zip(combination.names, combination.direction.tolist(), strict=True)
    )
    return (
        f"{joined(combination.names)} can hardly be separated: changed together in proportion ({moves}) they are "
        f"uncertain by {short(100 * combination.spread, 2)} % (1 sd), and their intervals are up to {wide} times "
        f"wider for it. If {combination.best} were known, the intervals of the others would shrink to "
        f"{short(100 * combination.narrowing, 2)} %."
    )


def collinearity_in_words(collinearity: Collinearity, spectrum: Spectrum, units: dict[str, str]) -> list[str]:
    """Strong collinearities and frequencies without information, one paragraph each."""
    paragraphs = [combination_in_words(combination, units) for combination in collinearity.combinations]
    if not paragraphs:
        paragraphs.append("No strong collinearity: no interval is inflated tenfold.")
    if collinearity.idle:
        idle = [float(spectrum.frequency_hz[line]) for line in collinearity.idle]
        paragraphs.append(_idle_in_words(idle, spectrum.frequency_hz.tolist()))
    return paragraphs


def _idle_in_words(idle: Sequence[float], all_hz: Sequence[float]) -> str:
    """Frequencies without information one by one; of many, how many, and between which the others lie."""
    if len(idle) <= 20:  # frequencies that are listed one by one
        return f"Frequencies that add almost no information on any unknown: {joined(f'{f:.4g}' for f in idle)} Hz."
    telling = sorted(set(all_hz) - set(idle))
    where = f"; the most informative lie from {telling[0]:.4g} to {telling[-1]:.4g} Hz" if telling else ""
    return f"{len(idle)} of the {len(all_hz)} frequencies add almost no information on any unknown{where}."


def profile_in_words(profile: Profile) -> str:
    """Both intervals of one unknown, and which to trust (no batch axes)."""
    ends = [
        float(profile.lower),
        float(profile.upper),
        float(profile.normal_lower),
        float(profile.normal_upper),
    ]
    size = (ends[3] - ends[2]) / 4
    value, low, high, left, right = alike([float(profile.value), *ends], size)
    low, high = (("none" if math.isinf(x) else text) for x, text in ((ends[0], low), (ends[1], high)))
    unit = "" if profile.unit == "1" else f" {profile.unit}"
    text = (
        f"{profile.name} = {value}{unit}: {100 * profile.level:g} % interval from the profile {low} … {high}, "
        f"normal {left} … {right}"
    )
    if bool(profile.improved):
        return f"{text}. On the way there is a better fit than the estimate: give guesses, or more starting values."
    if math.isinf(ends[0]) or math.isinf(ends[1]):
        return f"{text}. The normal interval misleads: the data set no limit on one side."
    if bool(profile.misleads):
        off = f"{100 * float(profile.difference):.0f} %"
        return f"{text}. The normal interval misleads (an end is off by {off} of its length)."
    return f"{text}. They agree."
