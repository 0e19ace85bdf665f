"""Options that several commands share."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from dashpot.data.conditioning.settings import Conditioning
    from dashpot.data.readers import Reading
    from dashpot.data.spectrum import Spectrum
    from dashpot.notices import Notice

NOT_CONVERGED = 3  # exit code

Function = TypeVar("Function", bound=Callable[..., Any])


class WholeNumbers(click.ParamType[Any]):
    """Whole numbers, such as 1,3,5; "none" where that is allowed, "auto" likewise."""

    name = "n,n,…"

    def __init__(self, words: Sequence[str] = ()) -> None:
        self.words = words

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...] | str:
        """The numbers, or the word."""
        text = str(value).strip()
        if text in self.words:
            return text
        try:
            found = tuple(int(part) for part in text.split(","))
        except ValueError:
            found = ()
        if not found or min(found) < 1 or max(found) > 1000:
            allowed = "".join(f" or {word}" for word in self.words)
            self.fail(f"{text!r} is no list of multiples; write them as 1,3,5{allowed}", param, ctx)
        return found


class Positive(click.ParamType[float]):
    """A finite number above 0 (and below `most`)."""

    name = "number"

    def __init__(self, most: float = 1e300) -> None:
        self.most = most

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number."""
        try:
            number = float(str(value))
        except ValueError:
            self.fail(f"{value!r} is no number; write one such as 12.5", param, ctx)
        if not 0 < number < self.most:
            top = "" if self.most > 1e200 else f" and below {self.most:g}"
            self.fail(f"{value} is out of range; give a number above 0{top}", param, ctx)
        return number


class Setting(click.ParamType[tuple[str, float]]):
    """NAME=NUMBER."""

    name = "name=value"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, float]:
        """Name and number."""
        name, number = named_number(str(value))
        if not name or not abs(number) < 1e300:
            self.fail(f"{str(value)!r} sets nothing; write NAME=NUMBER, such as m1=3.0", param, ctx)
        return name, number


def named_number(text: str) -> tuple[str, float]:
    """Name and number of NAME=NUMBER; NaN where there is no number."""
    name, _, number = text.partition("=")
    try:
        return name.strip(), float(number)
    except ValueError:
        return name.strip(), float("nan")


def conditioning_options(function: Function) -> Function:
    """The options that `conditioning_from` takes, and --frequency."""
    options = [
        click.option(
            "--frequency", type=Positive(1e12), metavar="HZ", help="Drive frequency of records that do not say it."
        ),
        click.option(
            "--orders", type=WholeNumbers(), default="1", show_default=True, metavar="1,3,…",
            help="Multiples of the drive frequency whose amplitudes are used.",
        ),
        click.option(
            "--harmonics", type=WholeNumbers(("auto", "none")), default="auto", show_default=True, metavar="2,3,…",
            help="Multiples solved for beside them, so that they do not count as noise; auto, none.",
        ),
        click.option(
            "--drift", type=click.Choice(["none", "0", "1", "2", "3"]), default="1", show_default=True,
            help="Degree of the polynomial taken out with them; 0 is an offset alone.",
        ),
        click.option(
            "--noise", type=click.Choice(["auto", "white", "blocks"]), default="auto", show_default=True,
            help="How the noise of the amplitudes is found from the residual.",
        ),
        click.option("--refine", is_flag=True, help="Find the true frequency near the stated one."),
        click.option("--settle", is_flag=True, help="Drop the transient at the start of each dwell."),
    ]  # fmt: skip
    for option in reversed(options):
        function = option(function)
    return function


def conditioning_from(options: Mapping[str, Any]) -> Conditioning:
    """The value of the options of `conditioning_options`, by their names."""
    from dashpot.data.conditioning.settings import Conditioning

    drift = options["drift"]
    return Conditioning(**{**options, "drift": int(drift) if drift.isdecimal() else drift})


def amplitudes(reading: Reading, conditioning: Conditioning, quiet: bool, moments: bool = False) -> Spectrum:
    """The spectrum of what was read; what was noticed on the way is told."""
    spectrum = reading.spectrum(conditioning.changed(moments=moments))
    tell_notes(spectrum.notes, quiet)
    return spectrum


def tell_notes(notes: Sequence[Notice], quiet: bool) -> None:
    """What was noticed on the way, on stderr: the first of those that differ in numbers alone, and how many follow."""
    if quiet:
        return
    groups: dict[str, list[str]] = {}
    for note in dict.fromkeys(str(notice) for notice in notes):
        groups.setdefault(re.sub(r"\d[\d.]*(e[-+]?\d+)?", "#", note), []).append(note)
    for first, *others in groups.values():
        more = f" (and {len(others)} more like this)" if others else ""
        click.echo(f"note: {first}{more}", err=True)
