"""Numbers and sentences as a reader wants them: as many digits as the uncertainty allows, and a full stop."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from dashpot.channel import Channel
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.notices import Notice


def value_and_sd(value: float, sd: float) -> tuple[str, str]:
    """Value and standard deviation, both to two digits of the latter: ("2.998", "0.021"), ("1.2346e8", "0.0021e8").

    Without a finite, positive sd the value has six digits and the sd is "–" (0: "0").
    """
    texts = alike([value, sd], sd)
    return texts[0], texts[1]


def alike(values: Sequence[float], sd: float) -> list[str]:
    """Several numbers to the last digit of one standard deviation, with one power of ten where they need it."""
    finite = [abs(v) for v in values if math.isfinite(v)]
    rounding = 1e-14 * max(finite, default=0.0)  # what is less is an error of its computation, no deviation
    if not (math.isfinite(sd) and sd > rounding):
        settled = [0.0 if abs(value) < rounding else value for value in values]
        return [plain(value) if math.isfinite(value) else "–" for value in settled]
    last = math.floor(math.log10(sd)) - 1  # two digits of a standard deviation are shown
    if round(sd / 10.0**last) >= 100:  # 0.0996 → 0.10
        last += 1
    largest = max(finite, default=0.0)
    top = max(math.floor(math.log10(largest)) if largest > 0 else last, last)
    if top >= 7 or (last <= -7 and top < 0):  # digits before the point, or zeros behind it
        power = top
        return [
            _fixed(v / 10.0**power, power - last) + f"e{power}" if math.isfinite(v) else "–" for v in values
        ]
    return [_fixed(round(v, -last), max(-last, 0)) if math.isfinite(v) else "–" for v in values]


def _fixed(value: float, decimals: int) -> str:
    text = f"{value:.{max(decimals, 0)}f}"
    bare = text.lstrip("-")
    return bare if not bare.strip("0.") else text


def plain(value: float) -> str:
    """A number as it was written, to six digits: "2.7", "2e-9"."""
    return f"{value:.6g}".replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")


def short(value: float, digits: int = 3) -> str:
    """A number to some significant digits, plain where that is short."""
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    size = int(f"{abs(value):.{digits - 1}e}".partition("e")[2])  # after rounding: 0.0999 is 0.1
    if -5 < size < 7:
        text = _fixed(round(value, digits - 1 - size), max(digits - 1 - size, 0))
    else:
        text = f"{value:.{digits - 1}e}".replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")
    return text


def percent(part: float, whole: float) -> str:
    """|part / whole| in per cent to two digits: "0.66", "12", ">999"; "–" where there is no whole."""
    if whole == 0 or not (math.isfinite(part) and math.isfinite(whole)):
        return "–"
    share = 100 * abs(part / whole)
    return ">999" if share >= 1000 else short(share, 2)


def probability(p: float) -> str:
    """A p-value: "0.31", "0.004", "< 1e-6"."""
    if not math.isfinite(p):
        return "–"
    return "< 1e-6" if p < 1e-6 else f"{p:.2g}"


def aligned(texts: Sequence[str]) -> list[str]:
    """Texts padded on the right so that their decimal points stand below each other when flush right."""

    def after(text: str) -> int:
        dot = text.find(".")
        return len(text) - dot if dot >= 0 else 0

    longest = max((after(text) for text in texts), default=0)
    return [text + " " * (longest - after(text)) for text in texts]


def flush(texts: Sequence[str]) -> list[str]:
    """Such texts padded on both sides, all as wide as the widest."""
    padded = aligned(texts)
    return [text.rjust(max(map(len, padded))) for text in padded]


def sentence(text: str) -> str:
    """A text that ends with a full stop."""
    return text if text.endswith((".", "!", "?")) else f"{text}."


def capitalised(text: str, names: Collection[str] = ()) -> str:
    """The text with a capital letter first, unless it begins with one of the names: x1 is not X1."""
    word = re.split(r"[^\w$]", text, maxsplit=1)[0]
    return text if word in names else text[:1].upper() + text[1:]


def names_of(model: Model, channels: Sequence[Channel]) -> frozenset[str]:
    """Every name of a rig that a sentence may begin with."""
    elements = (element.name for element in model.elements)
    inputs = (drive.name for drive in model.inputs)
    return frozenset((*model.coordinates, *inputs, *elements, *(channel.name for channel in channels)))


REMEDIED = "coloured_noise"
# Treatments of records that may help there, and how they are asked for.
OPTIONS = {"settle": "--settle auto", "refine": "--refine always"}


@dataclass(frozen=True)
class Explained:
    """What a reader sees, and the kind of thing it is; meaning and cure; all in Markdown."""

    kind: str
    sees: str
    meaning: str
    cure: str


@cache
def notice_guide() -> Mapping[str, Explained]:
    """Code → its explanation; a test holds it complete."""
    text = Path(__file__).with_name("notices.toml").read_text(encoding="utf-8")
    return {
        code: Explained(kind, **said)
        for kind, codes in tomllib.loads(text).items()
        for code, said in codes.items()
    }


def with_remedy(notice: Notice, *, untried: Collection[str] = tuple(OPTIONS)) -> str:
    """The notice, followed by the options that may help; `untried`: treatments of records that were not chosen."""
    options = [option for treatment, option in OPTIONS.items() if treatment in untried]
    if notice.code != REMEDIED or not options:
        return notice.text
    same = "a transient or a slightly wrong drive frequency looks the same"
    return f"{notice.text}; {same}: try {joined(options)}"
