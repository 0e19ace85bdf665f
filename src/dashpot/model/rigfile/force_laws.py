"""The nonlinear laws of a rig file's springs and dampers: `law = "d**3"`, and its inner constants beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dashpot.errors import ModelError
from dashpot.io.toml_document import Place
from dashpot.io.words import quoted
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law
from dashpot.model.rigfile.reading import Reading
from dashpot.model.rigfile.schema import ConstantEntry, ElementEntry


def split_constants(raw: object) -> tuple[object, dict[str, Any]]:
    """An element's table without the inner constants of its law, and these; without a law, all of it and nothing."""
    if not isinstance(raw, dict) or "law" not in raw:
        return raw, {}
    constants = {key: value for key, value in raw.items() if key not in ElementEntry.model_fields}
    return {key: value for key, value in raw.items() if key not in constants}, constants


def read_law(
    reading: Reading, place: Place, entry: ElementEntry, constants: Mapping[str, Any]
) -> tuple[ForceLaw | None, bool]:
    """(the law that an entry gives, None where it gives none; whether it can be read)."""
    if entry.law is None:
        return None, True
    if place[0] not in ("springs", "dampers"):
        cure = "leave it out, or write the element into [springs] or [dampers]"
        reading.report.add((*place, "law"), "laws belong to springs and dampers", cure)
        return None, False
    if entry.unit is not None:
        reading.report.add(
            (*place, "unit"), "the unit follows from the law", "leave it out; numbers are in SI units"
        )
        return None, False
    inner = [_constant(reading, (*place, name), name, raw) for name, raw in constants.items()]
    if any(constant is None for constant in inner):
        return None, False
    try:
        return force_law(entry.law, [c for c in inner if c is not None], damper=place[0] == "dampers"), True
    except ModelError as error:
        for problem in error.problems:
            reading.report.add((*place, "law"), problem.what, problem.cure)
        return None, False


def _constant(reading: Reading, place: Place, name: str, raw: object) -> Constant | None:
    """A number, "unknown", or a table with value, sd, guess, min and max; None where it cannot be read."""
    if raw == "unknown":
        return Constant(name)
    if isinstance(raw, int | float) and not isinstance(raw, bool):
        raw = {"value": float(raw)}
    if not isinstance(raw, dict):
        cure = f'write a number, {name} = "unknown", or {name} = {{ guess = 0.1 }}'
        reading.report.add(place, f"{name} is neither a key of elements nor a constant of the law", cure)
        return None
    entry = reading.validated(ConstantEntry, raw, place)
    if entry is None:
        return None
    if entry.sd is not None and (entry.value is None or entry.sd <= 0):
        reading.report.add(
            place, "sd without a value, or not positive", "give the value that a positive sd belongs to"
        )
        return None
    if entry.min is not None and entry.max is not None and entry.min >= entry.max:
        reading.report.add(
            place, f"min {entry.min:g} is not below max {entry.max:g}", "exchange or change them"
        )
        return None
    return Constant(name, entry.value, entry.sd, entry.guess, entry.min, entry.max)


def law_fields(law: ForceLaw) -> dict[str, str]:
    """The keys that say a law in a rig file."""
    fields = {"law": quoted(law.text)}
    for constant in law.constants:
        numbers = {
            "value": constant.value, "sd": constant.sd, "guess": constant.guess, "min": constant.lower,
            "max": constant.upper,
        }  # fmt: skip
        given = {key: repr(float(number)) for key, number in numbers.items() if number is not None}
        if set(given) == {"value"}:
            fields[constant.name] = given["value"]
        else:
            inside = ", ".join(f"{key} = {text}" for key, text in given.items())
            fields[constant.name] = f"{{ {inside} }}" if given else quoted("unknown")
    return fields
