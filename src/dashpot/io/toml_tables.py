"""Tables of TOML as checked entries: values that say what is wrong with them, and how to write them.

class Spring(Entry):
    value: GivenAmount | None = None
entry = validated(Spring, raw, ("springs", "k1"), report)     None, and its problems reported, where it is none
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError
from pydantic_core import PydanticCustomError

from dashpot.errors import UsageError
from dashpot.io.toml_document import Place, Report
from dashpot.io.words import did_you_mean, listed, quoted, shown, written
from dashpot.quantities import Amount, amount, within_range


class Entry(BaseModel):
    """One table.

    also_called  what people write for a key: the keys that may be meant
    examples     how a key is written that must not be missing
    wanted       what a key takes, where its validators do not say what is wrong
    """

    # Validators of a table are built when a file has one.
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, defer_build=True)
    also_called: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    examples: ClassVar[Mapping[str, str]] = {}
    wanted: ClassVar[Mapping[str, str]] = {}


AnyEntry = TypeVar("AnyEntry", bound=Entry)


def validated(entry: type[AnyEntry], raw: dict[str, Any], place: Place, report: Report) -> AnyEntry | None:
    """The table `raw` as an entry; None, and its problems reported, where it is none."""
    try:
        return entry.model_validate(raw)
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            where = detail["loc"]
            key, what, cure = str(where[-1]) if where else "", shown(str(detail["msg"]), 200), None
            if detail["type"] == "dashpot":
                what, cure = detail["ctx"]["what"], detail["ctx"]["cure"]
            elif detail["type"] == "extra_forbidden":
                known = tuple(entry.model_fields)
                meant = [name for name in entry.also_called.get(key.lower(), ()) if name in known]
                guess = did_you_mean(meant[0] if meant else key, known)
                what, cure = "unknown key", f"{guess}there are {listed(known)}"
            elif detail["type"] == "missing":
                what, cure = "missing", f"add {entry.examples.get(key, key)}"
            elif where[0] in entry.wanted:
                where = where[:1]
                what, cure = (
                    f"{_shown(raw[str(where[0])])} cannot be used",
                    f"write {entry.wanted[str(where[0])]}",
                )
            report.add((*place, *where), what, cure)
        return None


def _shown(value: object) -> str:
    """A value as the file wrote it; a list with what is in it."""
    return shown(f"[{', '.join(map(written, value))}]") if isinstance(value, list) else written(value)


def wrong(what: str, cure: str | None = None) -> PydanticCustomError:
    """What a validator raises."""
    return PydanticCustomError("dashpot", "{what}", {"what": what, "cure": cure})


def _wrong_as(error: UsageError) -> PydanticCustomError:
    return wrong(error.problems[0].what, error.problems[0].cure)


# Numbers, with a unit or without, shares and texts.

DIGITS = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def number(value: object) -> float:
    """A finite number of a usable magnitude."""
    if isinstance(value, str):
        text = value.strip()
        bare = re.fullmatch(rf"({DIGITS})\s*(\D.*)?", text)
        if re.fullmatch(r"-?\d+,\d+", text):
            cure = f"write {_plain(text.replace(',', '.'))}, with a point and without quotes"
        elif bare is not None:
            cure = f"write {_plain(bare[1])} without quotes" + (
                ": this number has no unit" if bare[2] is not None else ""
            )
        elif text.lower() in ("unknown", "?", ""):
            cure = "leave the key out where the value is unknown"
        else:
            cure = "write a number"
        raise wrong(f"{written(value)} is text", cure)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise wrong(f"{written(value)} is not a number", "write a number")
    try:
        given = float(value)
    except OverflowError:
        raise wrong("the number is too large", "write a finite number") from None
    if not math.isfinite(given):
        raise wrong(f"{written(value)} is not finite", "write a finite number")
    try:
        return within_range(given, written(value))
    except UsageError as error:
        raise _wrong_as(error) from None


def _plain(digits: str) -> str:
    """A number as TOML takes it: .5 and 5. are not."""
    digits = re.sub(r"^(-?)\.", r"\g<1>0.", digits.removeprefix("+"))
    digits = re.sub(r"^(-?)0+(?=\d)", r"\1", digits)
    return re.sub(r"\.(?!\d)", ".0", digits)


def given_amount(value: object) -> float | Amount:
    """A number, or a text of a number and its unit."""
    if isinstance(value, str) and re.fullmatch(rf"\s*{DIGITS}\s*[^\s\d.,:].*", value):
        try:
            return amount(value)
        except UsageError as error:
            raise _wrong_as(error) from None
    return number(value)


def share(value: object) -> float:
    """A number, or a text in per cent."""
    given = given_amount(value)
    if not isinstance(given, Amount):
        return given
    if given.unit != "%":
        raise wrong(f"{written(value)} is not a share", "write a number or per cent, such as 0.05 or 5 %")
    return given.number / 100


def or_unknown(read: Callable[[object], Any]) -> BeforeValidator:
    """None for "unknown", else what `read` gives."""
    return BeforeValidator(
        lambda value: None if isinstance(value, str) and value.strip().lower() == "unknown" else read(value)
    )


def text(value: object) -> str:
    """A text."""
    if isinstance(value, str):
        return value
    cure = "write it in quotes" if isinstance(value, dict | list) else f'write "{written(value)}" in quotes'
    raise wrong(f"{written(value)} is not text", cure)


def texts(value: object) -> list[str]:
    """A list, of texts."""
    if isinstance(value, str):
        raise wrong(f"{written(value)} is text, not a list", f"write [{quoted(value[:40])}]")
    if not isinstance(value, list):
        raise wrong(f"{written(value)} is not a list", 'write a list of names, such as ["x1", "x2"]')
    return value


def one_of(*choices: str) -> BeforeValidator:
    """One of some words."""

    def chosen(value: object) -> str:
        if text(value) in choices:
            return str(value)
        guess = did_you_mean(str(value), choices)
        raise wrong(
            f"{written(value)} is not one of the choices", f"{guess}use {' or '.join(map(quoted, choices))}"
        )

    return BeforeValidator(chosen)


Number = Annotated[float, BeforeValidator(number)]
GivenAmount = Annotated[float | Amount, BeforeValidator(given_amount)]
Share = Annotated[float, BeforeValidator(share)]
Text = Annotated[str, BeforeValidator(text)]
Names = Annotated[list[Text], BeforeValidator(texts)]
