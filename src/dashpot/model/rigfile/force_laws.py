"""The nonlinear laws of a rig file's springs and dampers: `law = "d**3"`, and its inner constants beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dashpot.errors import ModelError, UsageError
from dashpot.io.toml_document import Place
from dashpot.io.words import quoted
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law, unit_of
from dashpot.model.rigfile.schema import ConstantEntry, ElementEntry, RigReading, read_numbers
from dashpot.units import factor_between


def split_constants(raw: object) -> tuple[object, dict[str, Any]]:
    """An element's table without the inner constants of its law, and these; without a law, all of it and nothing."""
    if not isinstance(raw, dict) or "law" not in raw:
        return raw, {}
    constants = {key: value for key, value in raw.items() if key not in ElementEntry.model_fields}
    return {key: value for key, value in raw.items() if key not in constants}, constants


def read_law(
    reading: RigReading, place: Place, entry: ElementEntry, constants: Mapping[str, Any]
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
    entries = {name: _constant_entry(reading, (*place, name), name, raw) for name, raw in constants.items()}
    damper = place[0] == "dampers"
    try:
        law = force_law(entry.law, [Constant(name) for name in entries], damper=damper)
        inner = [
            None if given is None else _constant(reading, (*place, name), name, given, law)
            for name, given in entries.items()
        ]
        whole = [constant for constant in inner if constant is not None]
        if len(whole) < len(inner):
            return None, False
        return force_law(entry.law, whole, damper=damper), True
    except ModelError as error:
        for problem in error.problems:
            reading.report.add((*place, "law"), problem.what, problem.cure)
        return None, False


def _constant_entry(reading: RigReading, place: Place, name: str, raw: object) -> ConstantEntry | None:
    """What is said of a constant: an amount, "unknown", or a table; None, and told, where it cannot be read."""
    if raw == "unknown":
        return ConstantEntry()
    if isinstance(raw, str | int | float) and not isinstance(raw, bool):
        raw = {"value": raw}
    if not isinstance(raw, dict):
        cure = f'write a number, {name} = "unknown", or {name} = {{ guess = 0.1 }}'
        reading.report.add(place, f"{name} is neither a key of elements nor a constant of the law", cure)
        return None
    return reading.validated(ConstantEntry, raw, place)


def _constant(
    reading: RigReading, place: Place, name: str, entry: ConstantEntry, law: ForceLaw
) -> Constant | None:
    """A constant in SI units; None, and told, where its numbers make no sense."""
    exponents = law.exponents[1].get(name, (0.0, 0.0))

    def scale_of(unit: str) -> float:
        try:
            return factor_between(unit, unit_of(exponents))
        except UsageError:
            # Between angles what counts in metres elsewhere counts in radians.
            try:
                return factor_between(unit, unit_of(exponents, angle=True))
            except UsageError:
                pass
            raise

    numbers = read_numbers(reading, place, entry, 1.0, scale_of)
    if numbers is None:
        return None
    constant = Constant(name, **numbers)
    if constant.sd is not None and (constant.value is None or constant.sd <= 0):
        cure = "give the value that a positive sd belongs to"
        reading.report.add(place, "sd without a value, or not positive", cure)
        return None
    stated = [number for number in (constant.value, constant.guess, constant.upper) if number is not None]
    if name in law.positive and any(number <= 0 for number in stated):
        reading.report.add(place, f"{name} of the law {law.text!r} must be positive", "change it")
        return None
    if constant.lower is not None and constant.upper is not None and constant.lower >= constant.upper:
        what = f"min {constant.lower:g} is not below max {constant.upper:g}"
        reading.report.add(place, what, "exchange or change them")
        return None
    return constant


def law_fields(law: ForceLaw) -> dict[str, str]:
    """The keys that say a law in a rig file."""
    fields = {"law": quoted(law.text)}
    for constant in law.constants:
        numbers = {
            "value": constant.value,
            "sd": constant.sd,
            "guess": constant.guess,
            "min": constant.lower,
            "max": constant.upper,
        }
        given = {key: repr(float(number)) for key, number in numbers.items() if number is not None}
        if set(given) == {"value"}:
            fields[constant.name] = given["value"]
        else:
            inside = ", ".join(f"{key} = {text}" for key, text in given.items())
            fields[constant.name] = f"{{ {inside} }}" if given else quoted("unknown")
    return fields
