"""What options and arguments take: one type for each kind of value, the same in every command.

Quantities, shares and lists of frequencies are read by `dashpot.quantities`; what it refuses becomes a usage error
that names the option.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from dashpot import quantities
from dashpot.app.files import InputFile, InputFileOr, OutputFolder
from dashpot.errors import UsageError
from dashpot.quantities import Amount

MOST_ORDERS = 1000
_THOUSANDS = re.compile(r"\d{1,3}(,\d{3})+")

Value = TypeVar("Value")


class TextType(click.ParamType[Any]):
    """A value read from text by `parse`; a UsageError of it is one of the command line."""

    def __init__(self, name: str, parse: Callable[[str], Any], words: Sequence[str] = ()) -> None:
        self.name = name
        self._parse = parse
        self.words = tuple(words)

    def or_words(self, *words: str) -> TextType:
        """The same type that also takes some words."""
        return TextType(self.name, self._parse, words)

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The value, or one of `words` as it is; values that are not text were converted before."""
        if not isinstance(value, str):
            return value
        if value.strip() in self.words:
            return value.strip()
        try:
            return self._parse(value)
        except UsageError as error:
            problem = error.problems[0]
            cure = problem.cure or ""
            if self.words:
                cure = f"{cure}, or {' or '.join(self.words)}"
            self.fail(f"{problem.what}; {cure}", param, ctx)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The words that the type takes beside values."""
        return [CompletionItem(word) for word in self.words if word.startswith(incomplete)]


def _positive(kind: str) -> Callable[[str], float]:
    return lambda text: quantities.positive(quantities.quantity(text, kind), text)


def _not_negative(kind: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        value = quantities.quantity(text, kind)
        if value < 0:
            raise UsageError(f"{text.strip()!r} is negative", cure="give 0 or more")
        return value

    return parse


def _positive_amount(text: str) -> Amount:
    given = quantities.amount(text)
    quantities.positive(given.number, text)
    return given


def _positive_share(text: str) -> float:
    return quantities.positive(quantities.share(text), text)


def _share_of_zero_or_more(text: str) -> float:
    value = quantities.share(text)
    if value < 0:
        raise UsageError(f"{text.strip()!r} is negative", cure="give 0% or more")
    return value


def _part(text: str) -> float:
    value = _positive_share(text)
    if value >= 1:
        raise UsageError(f"{text.strip()!r} is out of range", cure="give less than 100%")
    return value


def _number(text: str) -> float:
    given = quantities.amount(text)
    if given.unit is not None:
        raise UsageError(f"{text.strip()!r} is not a plain number", cure="write it without a unit")
    return quantities.positive(given.number, text)


def _level(text: str) -> float:
    """95, 95% and 0.95 are all 0.95: an interval of less than 1 % is nobody's wish."""
    value = quantities.share(text)
    value = value / 100 if not text.strip().endswith("%") and value >= 1 else value
    if not 0 < value < 1:
        raise UsageError(f"{text.strip()!r} is out of range", cure="write a level such as 95% or 0.95")
    return value


def _whole_numbers(text: str) -> tuple[int, ...]:
    """1,3,5 or a range 1:9:2."""
    try:
        found: list[int] = []
        for part in text.split(","):
            ends = [int(piece) for piece in part.split(":")]
            found += ends if len(ends) == 1 else range(ends[0], ends[1] + 1, *ends[2:])
    except (ValueError, TypeError, IndexError):
        found = []
    if not found or min(found) < 1 or max(found) > MOST_ORDERS or len(found) > MOST_ORDERS:
        raise UsageError(f"{text.strip()!r} is not a list of multiples", cure="write them as 1,3,5 or 1:9:2")
    return tuple(dict.fromkeys(found))


def pairs(text: str, parse: Callable[[str], Value]) -> dict[str, Value]:
    """NAME=VALUE,NAME=VALUE,… with each VALUE read by `parse`.  Raises UsageError."""
    found: dict[str, Value] = {}
    for part in text.split(","):
        name, equals, written = part.partition("=")
        name = name.strip()
        if not name or not equals:
            raise UsageError(f"{part.strip()!r} is not NAME=VALUE", cure="write it as m1=3,c1=30")
        if name in found:
            raise UsageError(f"{name} is given twice", cure="give it once")
        found[name] = parse(written)
    return found


def _amounts(text: str) -> dict[str, Amount]:
    return pairs(text, quantities.amount)


def _amplitude(text: str) -> Amount | dict[str, Amount]:
    return _amounts(text) if "=" in text else _positive_amount(text)


def _target(text: str) -> float | dict[str, float]:
    return pairs(text, _positive_share) if "=" in text else _positive_share(text)


def _sensors(text: str) -> tuple[int, tuple[str, ...]]:
    """ "pick 3 of a,b,c": how many, and of which (none: of all)."""
    match = re.fullmatch(r"\s*(?:pick\s+)?(\d{1,6})(?:\s+of\s+(.+))?\s*", text)
    if match is None:
        raise UsageError(f"{text!r} is not a choice of sensors", cure='write it as "pick 3 of a,b,c,d"')
    return int(match[1]), names(match[2] or "")


def _three_shares(text: str) -> tuple[float, float, float]:
    shares = [_positive_share(part) for part in text.split(",")]
    if len(shares) != 3:
        raise UsageError(f"{text!r} is not three shares", cure="write them as 1%,20%,5%")
    return shares[0], shares[1], shares[2]


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


FREQUENCIES = TextType("frequencies", quantities.frequencies)
FREQUENCY = TextType("frequency", quantities.frequency)
BAND = TextType("lower:upper", quantities.band)
TIME = TextType("time", _positive("time"))
MASS = TextType("mass", _positive("mass"))
SETTLING = TextType("time", _not_negative("time"), words=("auto", "none"))
AMOUNT = TextType("quantity", _positive_amount)  # in SI only where the rig is known: an angle or a length
AMOUNTS = TextType("name=value", _amounts)
AMPLITUDE = TextType("quantity", _amplitude)
SHARE = TextType("share", _positive_share)
SHARE_OR_ZERO = TextType("share", _share_of_zero_or_more)
PART = TextType("share", _part)
NUMBER = TextType("number", _number)
LEVEL = TextType("level", _level)
ORDERS = TextType("orders", _whole_numbers, words=("auto",))
HARMONICS = TextType("orders", _whole_numbers, words=("auto", "none"))
TARGET = TextType("share", _target)
MODAL_SD = TextType("shares", _three_shares)
SENSORS = TextType("choice", _sensors)
INPUT_FILE = InputFile()
INPUT_FILE_OR = InputFileOr()
FOLDER = OutputFolder()


class Count(click.ParamType[int]):
    """A whole number from `least` to `most`; 1e6 and 1,000,000 are read too."""

    name = "number"

    def __init__(self, least: int, most: int = 1_000_000_000) -> None:
        self.least, self.most = least, most

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number."""
        if isinstance(value, int):
            return value
        text = str(value).strip()
        try:
            number = float(text.replace(",", "") if _THOUSANDS.fullmatch(text) else text)
        except ValueError:
            number = float("nan")
        if not self.least <= number <= self.most or number != int(number):
            bounds = f"from {self.least:,} to {self.most:,}"
            self.fail(f"{text!r} is not a whole number {bounds}", param, ctx)
        return int(number)
