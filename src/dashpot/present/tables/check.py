"""What `dashpot check` prints: what can be found, what the data tell badly, profiles, errors of known parameters."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from dashpot.check.collinearity import Collinearity, Combination
from dashpot.check.identifiability import Structure
from dashpot.check.profile import Profile
from dashpot.check.sensitivity import KnownErrors
from dashpot.data.spectrum import Spectrum
from dashpot.io.words import listed
from dashpot.present.text.numbers import alike, short

COLUMNS = 6  # unknowns side by side in the table of known errors


def structure_in_words(found: Structure, channels: Sequence[str], lines: int | None = None) -> list[str]:
    """What a sound structure means, one paragraph each."""
    count = len(found.names)
    unknowns = f"The {count} unknowns" if count > 1 else "The unknown"
    by = f"from {listed(channels)}" if lines is None else f"from {listed(channels)} at these {lines} lines"
    told = [f"Identifiable: {unknowns} ({listed(found.names)}) can be found {by}."]
    if found.prior_dependent:
        told.append(f"Identifiable only through the prior on {listed(found.prior_dependent)}.")
    for one, other in found.permutation_ambiguities:
        told.append(
            f"{one} and {other} are unmeasured and interchangeable. "
            "Give an element of one of them a min or max."
        )
    return told


def combination_in_words(one: Combination, units: dict[str, str]) -> str:
    """A combination that the data hardly see, its effect and its cure."""
    wide = max(one.widening.tolist())
    if len(one.names) == 1:
        return (
            f"{one.names[0]} is hardly seen apart from the others: "
            f"its interval is {short(wide, 2)} times wider for it."
        )
    moves = ", ".join(
        f"{name} {x:+.2g}" + (" s" if units.get(name) == "s" else "")
        for name, x in zip(one.names, one.direction.tolist(), strict=True)
    )
    return (
        f"{listed(one.names)} are hardly told apart: in proportion ({moves}) they may move by "
        f"{short(100 * one.spread, 2)} % (1 sd), and their intervals are up to {short(wide, 2)} times wider for it. "
        f"Were {one.best} known, those of the others would shrink to {short(100 * one.narrowing, 2)} %."
    )


def collinearity_in_words(found: Collinearity, spectrum: Spectrum, units: dict[str, str]) -> list[str]:
    """Weak combinations and idle lines, one paragraph each."""
    told = [combination_in_words(one, units) for one in found.combinations]
    if not told:
        told.append("No strong collinearity: no interval is inflated tenfold.")
    if found.idle:
        idle = listed(f"{spectrum.frequency_hz[line]:.4g}" for line in found.idle)
        told.append(f"Lines that carry next to nothing for any unknown: {idle} Hz.")
    return told


def profile_in_words(found: Profile) -> str:
    """Both intervals of one unknown, and which to believe (no batch axes)."""
    ends = [float(found.lower), float(found.upper), float(found.normal_lower), float(found.normal_upper)]
    size = (ends[3] - ends[2]) / 4
    value, low, high, left, right = alike([float(found.value), *ends], size)
    low, high = (("none" if math.isinf(x) else text) for x, text in ((ends[0], low), (ends[1], high)))
    unit = "" if found.unit == "1" else f" {found.unit}"
    text = (
        f"{found.name} = {value}{unit}: {100 * found.level:g} % interval from the profile {low} … {high}, "
        f"normal {left} … {right}"
    )
    if bool(found.improved):
        return f"{text}. χ² fell below the estimate's on the way: there is a better fit; give guesses, or more starts."
    if math.isinf(ends[0]) or math.isinf(ends[1]):
        return f"{text}. The normal interval misleads: χ² never rises enough on one side, the data set no limit there."
    if bool(found.misleads):
        off = f"{100 * float(found.difference):.0f} %"
        return f"{text}. The normal interval misleads (an end is off by {off} of its length)."
    return f"{text}. They agree."


def known_table(found: KnownErrors, first: int = 0) -> Table:
    """Per cent by which each unknown moves for 1 % of each known parameter; `first` of COLUMNS unknowns."""
    names = found.unknowns[first : first + COLUMNS]
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False, show_edge=False)
    table.add_column("1 % of")
    for name in names:
        table.add_column(name, justify="right", no_wrap=True)
    for known, row in zip(found.known, found.relative.tolist(), strict=True):
        table.add_row(
            known, *(f"{x:+.2f} %" if math.isfinite(x) else "–" for x in row[first : first + COLUMNS])
        )
    return table


def show_paragraphs(out: Console, paragraphs: Sequence[str], style: str = "") -> None:
    """Text, wrapped."""
    for paragraph in paragraphs:
        out.print(Text("\n".join(textwrap.wrap(paragraph, out.width)), style=style))


def show_known(out: Console, found: KnownErrors) -> None:
    """The table of known errors, as wide as the terminal allows."""
    out.print("An error of a known parameter moves the estimates:")
    for first in range(0, len(found.unknowns), COLUMNS):
        out.print(known_table(found, first))
