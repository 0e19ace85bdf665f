"""Findings of the checks as plain content for JSON: numbers, texts, lists and tables; None for what is not finite."""

from __future__ import annotations

from typing import Any

from dashpot.check.collinearity import Weakness
from dashpot.check.identifiability import Structure
from dashpot.check.profile import Profile
from dashpot.check.sensitivity import KnownErrors
from dashpot.data.spectrum import Spectrum

FORMAT = "0.1"


def structure_content(model: str, found: Structure) -> dict[str, Any]:
    """Whether the rig is identifiable; directions are changes of unknowns, in their units, at `nominal`."""
    return {
        "dashpot": FORMAT,
        "model": model,
        "identifiable": found.identifiable,
        "unknowns": list(found.names),
        "rank": found.rank,
        "nominal": dict(zip(found.names, found.nominal.tolist(), strict=True)),
        "deficiencies": [
            {
                "sort": one.sort,
                "unknowns": list(one.names),
                "can_be_found": list(one.found),
                "what": one.what,
                "cure": one.cure,
                "directions": [
                    {name: x for name, x in zip(found.names, row, strict=True) if x != 0}
                    for row in one.directions.tolist()
                ],
            }
            for one in found.deficiencies
        ],
        "exchangeable": [list(pair) for pair in found.exchanges],
        "rests_on_sd_of": list(found.leaning),
    }


def weakness_content(found: Weakness, spectrum: Spectrum) -> dict[str, Any]:
    """Weak combinations and what each line contributes."""
    return {
        "weak_combinations": [
            {
                "unknowns": dict(zip(one.names, one.direction.tolist(), strict=True)),
                "relative_sd": one.spread,
                "widening": dict(zip(one.names, one.widening.tolist(), strict=True)),
                "best_to_know": one.best,
                "intervals_then": one.narrowing,
            }
            for one in found.combinations
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
