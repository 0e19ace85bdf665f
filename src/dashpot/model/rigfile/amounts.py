"""Amounts in a rig file: numbers in the unit of their entry, or texts with a unit of their own: "4.6 kN/m", "1 %"."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from dashpot.errors import UsageError
from dashpot.io.toml_document import Place
from dashpot.model.rigfile.reading import RigReading
from dashpot.model.rigfile.schema import ConstantEntry, ElementEntry
from dashpot.quantities import Amount
from dashpot.units import scale

PER_CENT = "%"


def in_si(
    reading: RigReading, place: Place, given: float | Amount, plain: float, scale_of: Callable[[str], float]
) -> float | None:
    """An amount in SI units: a number times `plain`, else by its own unit; None, and told, where that is no such unit.

    `scale_of` gives the factor of a unit to SI and raises UsageError for a unit of something else.
    """
    if not isinstance(given, Amount):
        return given * plain
    try:
        return given.number * (plain if given.unit is None else scale_of(given.unit))
    except UsageError as error:
        for problem in error.problems:
            reading.report.add(place, problem.what, problem.cure)
        return None


def number_of(given: float | Amount) -> float:
    """The number of an amount, whatever its unit."""
    return given.number if isinstance(given, Amount) else given


def is_share(given: float | Amount | None) -> bool:
    """Whether an amount is written in per cent."""
    return isinstance(given, Amount) and given.unit == PER_CENT


def factors(
    reading: RigReading, place: Place, given: Mapping[str, float | Amount], angles: Collection[str]
) -> dict[str, float] | None:
    """Factors of points: numbers, shares in per cent, and lengths for the arms of angles; None, and told, if faulty."""

    def scale_of(point: str, unit: str) -> float:
        if unit == PER_CENT:
            return 0.01
        if point not in angles:
            raise UsageError(
                f"{point} is not an angle, so its factor has no unit",
                cure="write a number or a share, such as 60 %",
            )
        return scale(unit, "displacement")

    numbers = {
        point: in_si(reading, (*place, point), factor, 1.0, lambda unit, point=point: scale_of(point, unit))  # type: ignore[misc]
        for point, factor in given.items()
    }
    whole = {point: number for point, number in numbers.items() if number is not None}
    return whole if len(whole) == len(numbers) else None


def read_numbers(
    reading: RigReading,
    place: Place,
    entry: ElementEntry | ConstantEntry,
    plain: float,
    scale_of: Callable[[str], float],
) -> dict[str, Any] | None:
    """Value, sd, guess, lower and upper of an entry, where given, in SI units; None, and told, where one is faulty."""
    numbers: dict[str, float] = {}
    faulty = False
    for key, field in (
        ("value", "value"),
        ("sd", "sd"),
        ("guess", "guess"),
        ("min", "lower"),
        ("max", "upper"),
    ):
        given = getattr(entry, key)
        if given is None:
            continue
        if isinstance(given, Amount) and given.unit == PER_CENT:
            number = _share_of_value(reading, (*place, key), given, numbers.get("value"))
        else:
            number = in_si(reading, (*place, key), given, plain, scale_of)
        if number is None:
            faulty = True
        else:
            numbers[field] = number
    return None if faulty else numbers


def _share_of_value(reading: RigReading, place: Place, share: Amount, value: float | None) -> float | None:
    """An sd in per cent of the value; None, and told, for another key or where there is no value."""
    if place[-1] != "sd":
        reading.report.add(place, f"{share} is a share", "only an sd may be one, of the value; write a unit")
        return None
    if value is None:
        reading.report.add(place, f"an sd of {share} without a value", "give the value that it is a share of")
        return None
    return abs(value) * share.number / 100
