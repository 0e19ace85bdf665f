"""The nonlinear laws of a rig file's springs and dampers: `law = "d**3"`, and its inner constants beside it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from dashpot.errors import ModelError, UsageError
from dashpot.io.toml_document import Place
from dashpot.io.words import quoted
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, force_law, unit_of
from dashpot.model.rigfile.schema import NUMBERS, ConstantEntry, ElementEntry, RigReading
from dashpot.units import factor_between


def split_constants(raw: object) -> tuple[object, dict[str, Any]]:
    """An element's table without the inner constants of its law, and these; without a law, all of it and nothing."""
    if not isinstance(raw, dict) or "law" not in raw:
        return raw, {}
    constants = {key: value for key, value in raw.items() if key not in ElementEntry.model_fields}
    return {key: value for key, value in raw.items() if key not in constants}, constants


def read_law(
    reading: RigReading, place: Place, entry: ElementEntry, constants: Mapping[str, Any]
) -> ForceLaw | None:
    """The law that an entry gives; None where it gives none, or none that can be read."""
    if entry.law is None:
        return None
    if place[0] not in ("springs", "dampers"):
        cure = "leave it out, or write the element into [springs] or [dampers]"
        reading.report.add((*place, "law"), "laws belong to springs and dampers", cure)
        return None
    if entry.unit is not None:
        cure = "leave it out; numbers are in SI units"
        reading.report.add((*place, "unit"), "the unit follows from the law", cure)
        return None
    entries = {
        name: reading.constant_entry(
            (*place, name), raw, f"{name} is neither a key of elements nor a constant of the law"
        )
        for name, raw in constants.items()
    }
    damper, before = place[0] == "dampers", reading.problems
    try:
        law = force_law(entry.law, [Constant(name) for name in entries], damper=damper)
        inner = [
            _constant(reading, (*place, name), given, law)
            for name, given in entries.items()
            if given is not None
        ]
        whole = len(inner) == len(entries) and reading.problems == before
        return force_law(entry.law, inner, damper=damper) if whole else None
    except ModelError as error:
        reading.include((*place, "law"), error)
        return None


def _constant(reading: RigReading, place: Place, entry: ConstantEntry, law: ForceLaw) -> Constant:
    """A constant in SI units; told where its numbers make no sense."""
    name, before = str(place[-1]), reading.problems
    exponents = law.exponents[1].get(name, (0.0, 0.0))
    constant = Constant(name, **reading.stated(place, entry, partial(_scale, exponents=exponents)))
    stated = [number for number in (constant.value, constant.guess, constant.upper) if number is not None]
    if reading.problems == before and name in law.positive and any(number <= 0 for number in stated):
        reading.report.add(place, f"{name} of the law {law.text!r} must be positive", "change it")
    return constant


def _scale(unit: str, exponents: tuple[float, float]) -> float:
    """The factor of a constant's unit; between angles what counts in metres elsewhere counts in radians."""
    try:
        return factor_between(unit, unit_of(exponents))
    except UsageError:
        try:
            return factor_between(unit, unit_of(exponents, angle=True))
        except UsageError:
            pass
        raise


def law_fields(law: ForceLaw) -> dict[str, str]:
    """The keys that say a law in a rig file."""
    fields = {"law": quoted(law.text)}
    for constant in law.constants:
        numbers = {key: getattr(constant, field) for key, field in NUMBERS.items()}
        given = {key: repr(float(number)) for key, number in numbers.items() if number is not None}
        if set(given) == {"value"}:
            fields[constant.name] = given["value"]
        else:
            inside = ", ".join(f"{key} = {text}" for key, text in given.items())
            fields[constant.name] = f"{{ {inside} }}" if given else quoted("unknown")
    return fields
