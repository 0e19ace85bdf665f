"""Findings of the checks as plain content for JSON: numbers, texts, lists and tables; None for what is not finite."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dashpot.channel import Channel
from dashpot.check.data_findings import Collinearity, DataFindings
from dashpot.check.identifiability import Structure
from dashpot.check.profile import Profile
from dashpot.check.sensitivity import KnownErrors
from dashpot.check.structure import Deficiency
from dashpot.data.spectrum import Spectrum
from dashpot.model.network import Model
from dashpot.present.text.identifiability import combinations_in_words, in_words

FORMAT = "0.1"


def structure_content(model: Model, channels: Sequence[Channel], found: Structure) -> dict[str, Any]:
    """Whether the rig is identifiable; directions are changes of unknowns, in their units, at `nominal`."""
    return {
        "dashpot": FORMAT,
        "model": model.name,
        "identifiable": found.identifiable,
        "unknowns": list(found.names),
        "rank": found.rank,
        "nominal": dict(zip(found.names, found.nominal.tolist(), strict=True)),
        "deficiencies": [_deficiency(entry, found, model, channels) for entry in found.deficiencies],
        "exchangeable": [list(pair) for pair in found.permutation_ambiguities],
        "rests_on_sd_of": list(found.prior_dependent),
    }


def _deficiency(
    one: Deficiency, found: Structure, model: Model, channels: Sequence[Channel]
) -> dict[str, Any]:
    what, cure = in_words(one, found, model, channels)
    return {
        "sort": one.sort,
        "unknowns": list(one.names),
        "can_be_found": list(combinations_in_words(one)),
        "what": what,
        "cure": cure,
        "directions": [
            {name: x for name, x in zip(found.names, row, strict=True) if x != 0}
            for row in one.directions.tolist()
        ],
    }


def findings_content(found: DataFindings, spectrum: Spectrum) -> dict[str, Any]:
    """What data say, each part that was asked for."""
    content: dict[str, Any] = {"data": collinearity_content(found.collinearity, spectrum)}
    if found.profiles:
        content["profiles"] = [profile_content(entry) for entry in found.profiles]
    if found.known_errors is not None:
        content["known_errors"] = known_content(found.known_errors)
    return content


def collinearity_content(found: Collinearity, spectrum: Spectrum) -> dict[str, Any]:
    """Weak combinations and what each line contributes."""
    return {
        "weak_combinations": [
            {
                "unknowns": dict(zip(entry.names, entry.direction.tolist(), strict=True)),
                "relative_sd": entry.spread,
                "widening": dict(zip(entry.names, entry.widening.tolist(), strict=True)),
                "best_to_know": entry.best,
                "intervals_then": entry.narrowing,
            }
            for entry in found.combinations
        ],
        "lines": [
            {"frequency_hz": float(f), "shares": dict(zip(found.names, row, strict=True)), "idle": line in found.idle}
            for line, (f, row) in enumerate(zip(spectrum.frequency_hz, found.shares.tolist(), strict=True))
        ],
    }  # fmt: skip


def profile_content(found: Profile) -> dict[str, Any]:
    """Both intervals of one unknown and the curve; an end that does not exist is null (no batch axes)."""
    return {
        "name": found.name,
        "unit": found.unit,
        "level": found.level,
        "value": float(found.value),
        "interval": [float(found.lower), float(found.upper)],
        "normal_interval": [float(found.normal_lower), float(found.normal_upper)],
        "normal_misleads": bool(found.misleads),
        "better_fit_met": bool(found.improved),
        "curve": [[x, y] for x, y in zip(found.points.tolist(), found.rise.tolist(), strict=True)],
    }


def known_content(found: KnownErrors) -> dict[str, Any]:
    """Per cent of each unknown for one per cent of each known parameter, and the slopes themselves."""
    return {
        "percent_per_percent": {
            name: dict(zip(found.unknowns, row, strict=True))
            for name, row in zip(found.known, found.relative.tolist(), strict=True)
        },
        "slopes": {
            name: dict(zip(found.unknowns, row, strict=True))
            for name, row in zip(found.known, found.slopes.tolist(), strict=True)
        },
    }
