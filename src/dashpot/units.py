"""Units as laboratories write them, and their factors to SI.

A symbol may mean different things for different quantities: `g` is standard gravity in an acceleration and a gram in
a mass, `lb` is a force in `lb/in` and a mass in a mass.  So every look-up says which quantity is meant.
"""

from __future__ import annotations

import difflib
import math
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from dashpot.errors import UsageError

# What the symbols of units mean: factors to SI and dimensions, by the quantity in which they are used.


STANDARD_GRAVITY = 9.80665
_INCH = 0.0254
_POUND = 0.45359237
_POUND_FORCE = _POUND * STANDARD_GRAVITY

# Powers of metre, kilogram, second, radian, volt, count
Dimension = tuple[int, int, int, int, int, int]
NONE: Dimension = (0, 0, 0, 0, 0, 0)
LENGTH: Dimension = (1, 0, 0, 0, 0, 0)
MASS: Dimension = (0, 1, 0, 0, 0, 0)
TIME: Dimension = (0, 0, 1, 0, 0, 0)
ANGLE: Dimension = (0, 0, 0, 1, 0, 0)
FORCE: Dimension = (1, 1, -2, 0, 0, 0)
ACCELERATION: Dimension = (1, 0, -2, 0, 0, 0)
TURNING: Dimension = (0, 0, -1, 1, 0, 0)
VOLTAGE: Dimension = (0, 0, 0, 0, 1, 0)
COUNT: Dimension = (0, 0, 0, 0, 0, 1)
PIXELS = ("px", "pixel", "pixels")
SHARE = "FS"  # of the full scale: a number without unit, as counts are


@dataclass(frozen=True)
class Symbol:
    factor: float
    dimension: Dimension
    prefixes: str = ""
    only: frozenset[str] | None = None  # the quantities in which the symbol has this meaning; None: all


PREFIXES = {
    "p": 1e-12,
    "n": 1e-9,
    "µ": 1e-6,
    "m": 1e-3,
    "c": 1e-2,
    "d": 1e-1,
    "h": 1e2,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
}
PREFIX_WORDS = {"pico": "p", "nano": "n", "micro": "µ", "milli": "m", "centi": "c", "kilo": "k", "mega": "M"}

_GRAVITY_IN = frozenset({"acceleration"})
_POUND_FORCE_IN = frozenset({"force", "damping", "stiffness"})
_POUND_IN = frozenset({"mass"})

# Each line: names, then what they mean.  A later meaning with `only` comes before an earlier one without.
_TABLE: tuple[tuple[str, Symbol], ...] = (
    ("m", Symbol(1.0, LENGTH, "pnµmcdk")),
    ("micron microns", Symbol(1e-6, LENGTH)),
    ("in inch inches", Symbol(_INCH, LENGTH, "µ")),
    ("mil mils thou", Symbol(1e-3 * _INCH, LENGTH)),
    ("ft foot feet", Symbol(12 * _INCH, LENGTH)),
    ("yd", Symbol(36 * _INCH, LENGTH)),
    ("g", Symbol(1e-3, MASS, "µmkM")),
    ("t tonne tonnes", Symbol(1e3, MASS)),
    ("lbm", Symbol(_POUND, MASS)),
    ("lb lbs", Symbol(_POUND, MASS, only=_POUND_IN)),
    ("oz", Symbol(_POUND / 16, MASS, only=_POUND_IN)),
    ("slug slugs", Symbol(_POUND_FORCE / (12 * _INCH), MASS)),
    ("slinch slinches blob", Symbol(_POUND_FORCE / _INCH, MASS)),
    ("s sec secs", Symbol(1.0, TIME, "pnµm")),
    ("min minute minutes", Symbol(60.0, TIME)),
    ("h hr hour hours", Symbol(3600.0, TIME)),
    ("rad rads", Symbol(1.0, ANGLE, "nµmk")),
    ("deg degs °", Symbol(math.pi / 180, ANGLE, "m")),
    ("arcmin", Symbol(math.pi / 180 / 60, ANGLE)),
    ("arcsec", Symbol(math.pi / 180 / 3600, ANGLE)),
    ("rev revs turn turns", Symbol(2 * math.pi, ANGLE)),
    ("rpm RPM", Symbol(2 * math.pi / 60, TURNING, "k")),
    ("Hz", Symbol(2 * math.pi, TURNING, "µmkMG", frozenset({"frequency"}))),
    ("cpm", Symbol(2 * math.pi / 60, TURNING, "k", frozenset({"frequency"}))),
    ("N", Symbol(1.0, FORCE, "nµmcdkMG")),
    # Written without a sign of multiplication, though SI asks for one
    ("Nm", Symbol(1.0, (2, 1, -2, 0, 0, 0), "nµmckM")),
    ("Nmm", Symbol(1e-3, (2, 1, -2, 0, 0, 0))),
    ("Ns", Symbol(1.0, (1, 1, -1, 0, 0, 0), "µmk")),
    ("Nms", Symbol(1.0, (2, 1, -1, 0, 0, 0), "µmk")),
    ("dyn dyne dynes", Symbol(1e-5, FORCE)),
    ("kgf kp", Symbol(STANDARD_GRAVITY, FORCE)),
    ("gf", Symbol(1e-3 * STANDARD_GRAVITY, FORCE, "m")),
    ("tf", Symbol(1e3 * STANDARD_GRAVITY, FORCE)),
    ("lbf", Symbol(_POUND_FORCE, FORCE)),
    ("lb lbs", Symbol(_POUND_FORCE, FORCE, only=_POUND_FORCE_IN)),
    ("ozf", Symbol(_POUND_FORCE / 16, FORCE)),
    ("kip kips", Symbol(1e3 * _POUND_FORCE, FORCE)),
    ("gn g0 g_n gee gees", Symbol(STANDARD_GRAVITY, ACCELERATION, "µm")),
    ("g", Symbol(STANDARD_GRAVITY, ACCELERATION, "nµm", _GRAVITY_IN)),
    ("G gs", Symbol(STANDARD_GRAVITY, ACCELERATION, only=_GRAVITY_IN)),
    ("Gal", Symbol(1e-2, ACCELERATION, "µm")),
    ("ips", Symbol(_INCH, (1, 0, -1, 0, 0, 0))),
    ("V", Symbol(1.0, VOLTAGE, "nµmk")),
    ("count counts Counts ct cts lsb LSB", Symbol(1.0, COUNT)),
    (" ".join(PIXELS), Symbol(1.0, COUNT)),  # of a camera
    (SHARE, Symbol(1.0, COUNT)),
)
WORDS = {
    "metre": "m",
    "meter": "m",
    "gram": "g",
    "second": "s",
    "radian": "rad",
    "degree": "deg",
    "hertz": "Hz",
    "newton": "N",
    "volt": "V",
    "pound": "lb",
}

SYMBOLS: dict[str, list[Symbol]] = {}
for _names, _meaning in _TABLE:
    for _name in _names.split():
        SYMBOLS.setdefault(_name, []).insert(
            0 if _meaning.only is not None else len(SYMBOLS.get(_name, [])), _meaning
        )


@dataclass(frozen=True)
class _Quantity:
    dimension: Dimension
    si: str
    accepted: str


_QUANTITIES: dict[tuple[str, bool], _Quantity] = {
    ("displacement", False): _Quantity(LENGTH, "m", "m, cm, mm, µm, in, ft, mil"),
    ("velocity", False): _Quantity((1, 0, -1, 0, 0, 0), "m/s", "m/s, mm/s, in/s, ft/s"),
    ("acceleration", False): _Quantity(ACCELERATION, "m/s²", "m/s², mm/s², g, gn, mg, in/s², ft/s², Gal"),
    ("force", False): _Quantity(FORCE, "N", "N, mN, kN, lbf, kgf"),
    ("mass", False): _Quantity(MASS, "kg", "kg, g, t, lb, slug, N·s²/m"),
    ("damping", False): _Quantity((0, 1, -1, 0, 0, 0), "N·s/m", "N·s/m, kg/s, N·s/mm, lbf·s/in"),
    ("stiffness", False): _Quantity((0, 1, -2, 0, 0, 0), "N/m", "N/m, N/mm, kN/m, lbf/in"),
    ("displacement", True): _Quantity(ANGLE, "rad", "rad, mrad, deg, rev"),
    ("velocity", True): _Quantity(TURNING, "rad/s", "rad/s, deg/s, rpm"),
    ("acceleration", True): _Quantity((0, 0, -2, 1, 0, 0), "rad/s²", "rad/s², deg/s²"),
    ("force", True): _Quantity((2, 1, -2, 0, 0, 0), "N·m", "N·m, N·mm, lbf·in, lbf·ft"),
    ("mass", True): _Quantity((2, 1, 0, 0, 0, 0), "kg·m²", "kg·m², kg·cm², g·mm², lb·in², N·m·s²/rad"),
    ("damping", True): _Quantity((2, 1, -1, -1, 0, 0), "N·m·s/rad", "N·m·s/rad, N·m·s/deg, lbf·in·s/rad"),
    ("stiffness", True): _Quantity((2, 1, -2, -1, 0, 0), "N·m/rad", "N·m/rad, N·m/deg, lbf·in/rad"),
    ("frequency", False): _Quantity(TURNING, "Hz", "Hz, kHz, rad/s, rpm"),
    ("time", False): _Quantity(TIME, "s", "s, ms, µs, min, h"),
}
_PER_TURN = {"frequency": 1 / (2 * math.pi)}
# The radian is not a unit in strict SI, and what is divided by it is often written without: N·m for N·m/rad.
# An angle itself must be named: bare 1/s for a rotation speed could be revolutions as well.
_RADIAN_MAY_LACK = {"force", "mass", "damping", "stiffness", "frequency"}
QUANTITIES = tuple(dict.fromkeys(quantity for quantity, _ in _QUANTITIES))
SI_DIMENSIONS = {each.si: each.dimension for each in _QUANTITIES.values() if each.si != "Hz"}  # of factor 1


class _UnreadableError(Exception):
    """A unit text that is not a unit; carries the reason and, when there is one, a suggestion."""

    def __init__(self, reason: str, suggestion: str | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.suggestion = suggestion


def si_unit(quantity: str, angular: bool = False) -> str:
    """Name of the SI unit of a quantity; `angular` for angles, torques and what joins them."""
    return _quantity(quantity, angular).si


@lru_cache(maxsize=4096)
def scale(unit: str, quantity: str, angular: bool = False, uncalibrated: bool = False) -> float:
    """Factor from `unit` to SI: value in SI = value in `unit` · factor.

    `quantity` is one of QUANTITIES; `angular` chooses rad, rad/s, rad/s², N·m, kg·m², N·m·s/rad and N·m/rad.  With
    `uncalibrated`, V, mV … and counts are taken too, with their factors to V and to counts.

    Raises UsageError if the text is not a unit, or a unit of something else; the cure lists what is accepted.
    """
    wanted = _quantity(quantity, angular)
    factor, dimension = _understood(unit, quantity, f"use {wanted.accepted}")
    if uncalibrated and dimension in (VOLTAGE, COUNT):
        return factor
    if _fits(dimension, wanted.dimension, quantity):
        # A frequency in 1/s is in Hz: nothing has been turned into radians.
        per_turn = _PER_TURN.get(quantity, 1.0) if dimension[3] else 1.0
        return factor * per_turn
    if dimension[4] or dimension[5]:
        if dimension in (VOLTAGE, COUNT):
            cure = f'say gain = "unknown" to estimate it, or a sensitivity, or use {wanted.accepted}'
            if unit in PIXELS:
                cure = 'say gain = "4.2 px/mm", or gain = 1 in every channel where one camera shows them all'
        else:
            cure = f'a sensitivity belongs in gain, with unit = "V"; or use {wanted.accepted}'
    else:
        cure = f"use {wanted.accepted}"
    if not angular and _fits(dimension, _quantity(quantity, True).dimension, quantity):
        cure += "; if it turns, list its point in angles"
    raise UsageError(f"{_quoted(unit)} is not a unit of {_described(quantity, angular)}", cure=cure)


def factor_between(unit: str, wanted: str) -> float:
    """Factor from `unit` to `wanted`, two units of any one dimension: "N/mm^3" to "N/m³".  Raises UsageError."""
    cure = f"use {wanted}, or a unit of its dimension"
    factor, dimension = _understood(unit, "stiffness", cure)
    try:
        of_wanted, same = _parse(wanted, "stiffness")
    except _UnreadableError:
        raise UsageError(
            f"{_quoted(unit)} cannot be turned into {wanted}", cure="write a number in it"
        ) from None
    if dimension != same:
        raise UsageError(f"{_quoted(unit)} does not have the dimension of {wanted}", cure=cure)
    return factor / of_wanted


@lru_cache(maxsize=1024)
def sensitivity(text: str, unit: str, quantity: str, angular: bool = False) -> float:
    """Volts (or counts) per SI unit of `quantity`, of a sensor's sensitivity such as "100 mV/g".

    `unit` is what the channel is recorded in: V, mV … for a sensitivity in volts, counts for one in counts.
    Raises UsageError if the text is not a number with such a unit per unit of the quantity.
    """
    wanted = _quantity(quantity, angular)
    try:
        recorded = _parse(unit, quantity)[1]
    except _UnreadableError:
        recorded = NONE
    if recorded not in (VOLTAGE, COUNT):
        raise UsageError(
            f"a sensitivity of {_quoted(text)} for a channel in {unit}",
            cure='say unit = "V", or leave the gain out',
        )
    shown = "g" if (quantity, angular) == ("acceleration", False) else si_unit(quantity, angular)
    below = f"({shown})" if "/" in shown or "·" in shown else shown
    example = f'"100 {"mV" if recorded == VOLTAGE else "counts"}/{below}"'
    cure = f"write a number and a unit such as {example}"
    match = re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)\s*", text, re.DOTALL)
    if match is None:
        raise UsageError(f"{_quoted(text)} is not a sensitivity", cure=cure)
    factor, dimension = _understood(match[2], quantity, cure, f"{_quoted(text)} is not a sensitivity")
    if not _fits(_times(recorded, dimension, -1), wanted.dimension, quantity):
        what = f"{_quoted(text)} is not a sensitivity in {unit} to {_described(quantity, angular)}"
        raise UsageError(what, cure=cure)
    value = float(match[1]) * factor
    if not math.isfinite(value) or value == 0:
        raise UsageError(
            f"{_quoted(text)} is a sensitivity of {value:g}", cure="give a finite one other than 0"
        )
    return value


def _understood(unit: str, quantity: str, cure: str, what: str | None = None) -> tuple[float, Dimension]:
    """Factor and dimension of a unit.  Raises UsageError that says `what` is wrong, and why."""
    try:
        return _parse(unit, quantity)
    except _UnreadableError as fault:
        hint = "" if fault.suggestion is None else f'did you mean "{fault.suggestion}"? '
        fault_of = f"{_quoted(unit)} is not a unit" if what is None else what
        raise UsageError(f"{fault_of}: {fault.reason}", cure=hint + cure) from None


def _quantity(quantity: str, angular: bool) -> _Quantity:
    known = _QUANTITIES.get((quantity, angular)) or _QUANTITIES.get((quantity, False))
    if known is None:
        raise UsageError(
            f"{_quoted(quantity)} is not a quantity", cure=f"choose from {', '.join(QUANTITIES)}"
        )
    return known


def _described(quantity: str, angular: bool) -> str:
    turned = {"displacement": "angle", "velocity": "angular velocity", "acceleration": "angular acceleration"}
    torsional = {"force": "torque", "mass": "moment of inertia"}
    torsional |= {"damping": "torsional damping", "stiffness": "torsional stiffness"}
    return {**turned, **torsional}.get(quantity, quantity) if angular else quantity


def _quoted(text: str) -> str:
    short = text if len(text) <= 40 else text[:39] + "…"
    return '"' + "".join(c if c.isprintable() else repr(c)[1:-1] for c in short) + '"'


def _fits(dimension: Dimension, wanted: Dimension, quantity: str) -> bool:
    plain = (*wanted[:3], 0, *wanted[4:])
    squared = (*wanted[:3], -2, *wanted[4:])  # N·m·s²/rad is kg·m²; kg·m²/rad² occurs too
    if dimension == wanted:
        return True
    if quantity == "mass" and wanted[0] == 2:
        return dimension in (plain, (*wanted[:3], -1, *wanted[4:]), squared)
    return quantity in _RADIAN_MAY_LACK and dimension == plain


# Reading of products, quotients and powers

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
_TOKEN = re.compile(
    r"""(?P<space>\s+)
      | (?P<power>(?:\^|\*\*)\s*(?:\(\s*(?P<inside>[-+−]?[0-9]{1,2})\s*\)|(?P<exponent>[-+−]?[0-9]{1,2}))
               | (?P<raised>[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]{1,2})
               | (?<=[A-Za-z°])(?P<bare>[-−]?[0-9]{1,2}) )
      | (?P<times>[*·⋅∙•×.] | [-‑](?=[A-Za-z°µμ]))
      | (?P<over>/ | ÷ | \bper\b)
      | (?P<open>\() | (?P<close>\))
      | (?P<one>1(?![0-9.]))
      | (?P<symbol>[nuµμm]?g_n|[nuµμm]?g0|[A-Za-zµμ°]+)""",
    re.VERBOSE,
)

_PER_SECOND = re.compile(r"(?<![^\W\d_])([nuµμmck]?m|m?rad|deg)ps(?![^\W\d_])")  # mps, mmps2


def _tokens(text: str) -> Iterator[tuple[str, str]]:
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise _UnreadableError(f"{_quoted(text[position])} is not understood")
        position = match.end()
        if match["power"] is not None:
            digits = (
                match["inside"]
                or match["exponent"]
                or match["bare"]
                or match["raised"].translate(_SUPERSCRIPTS)
            )
            yield "power", digits.replace("−", "-")
        elif match["space"] is None:
            yield str(match.lastgroup), match[0]


@lru_cache(maxsize=4096)
def _parse(text: str, quantity: str) -> tuple[float, Dimension]:
    """Factor and dimension of a unit text.  Products and quotients are taken from left to right."""
    tokens = deque(_tokens(_PER_SECOND.sub(r"\1/s", text)))
    if not tokens:
        raise _UnreadableError("it is empty")
    factor, dimension = _product(tokens, quantity, depth=0)
    if tokens:
        raise _UnreadableError("a bracket is closed that was not opened")
    if not (0 < factor < math.inf):
        raise _UnreadableError("its powers are out of range")
    return factor, dimension


def _product(tokens: deque[tuple[str, str]], quantity: str, depth: int) -> tuple[float, Dimension]:
    """Take a product off the tokens, up to the bracket that closes it or to the end."""
    factor, dimension = 1.0, NONE
    sign, operand_due = 1, True
    while tokens and tokens[0][0] != "close":
        kind, text = tokens.popleft()
        if kind in ("times", "over"):
            if operand_due:
                raise _UnreadableError(f"a unit is missing before {text}")
            sign, operand_due = (1 if kind == "times" else -1), True
            continue
        if kind == "power":
            raise _UnreadableError("a power stands without a unit")
        part: tuple[float, Dimension] | None = (1.0, NONE)
        if kind == "open":
            if depth > 8:
                raise _UnreadableError("it has too many brackets")
            part = _product(tokens, quantity, depth + 1)
            if not tokens:
                raise _UnreadableError("a bracket is not closed")
            tokens.popleft()
        elif kind == "symbol":
            text = text.replace("μ", "µ")
            part = _meaning_of(text, quantity)
        if part is None:
            raise _UnreadableError(f"{_quoted(text)} is not known", _similar(text, quantity))
        power = sign * (int(tokens.popleft()[1]) if tokens and tokens[0][0] == "power" else 1)
        try:
            factor *= part[0] ** power
        except OverflowError:
            raise _UnreadableError("its powers are out of range") from None
        dimension = _times(dimension, part[1], power)
        sign, operand_due = 1, False
    if operand_due:
        raise _UnreadableError("a unit is missing at its end")
    return factor, dimension


@lru_cache(maxsize=4096)
def _similar(text: str, quantity: str) -> str | None:
    """A symbol of the quantity that differs in case or in a letter; None if there is none."""
    known = [
        prefix + name
        for name, symbols in SYMBOLS.items()
        for symbol in symbols
        if symbol.only is None or quantity in symbol.only
        for prefix in ("", *symbol.prefixes)
    ]
    same = [name for name in known if name.lower() == text.lower()]
    long = [name for name in known if len(name) > 2]
    return next(iter(same or difflib.get_close_matches(text, long, n=1, cutoff=0.8)), None)


def _times(dimension: Dimension, other: Dimension, power: int) -> Dimension:
    a, b, c, d, e, f = (x + power * y for x, y in zip(dimension, other, strict=True))
    return a, b, c, d, e, f


def _meaning_of(text: str, quantity: str) -> tuple[float, Dimension] | None:
    """Factor and dimension of a symbol with its prefix, or of a word for one; None if it is neither."""
    for symbol in SYMBOLS.get(text, ()):
        if symbol.only is None or quantity in symbol.only:
            return symbol.factor, symbol.dimension
    for length in (1, 2):
        prefix = text[:length] if text[:length] != "u" else "µ"
        for symbol in SYMBOLS.get(text[length:], ()):
            if prefix in symbol.prefixes and prefix and (symbol.only is None or quantity in symbol.only):
                return PREFIXES[prefix] * symbol.factor, symbol.dimension
    for word, short in (("", ""), *PREFIX_WORDS.items()):
        if text.lower().startswith(word):
            stem = text.lower().removeprefix(word)
            meant = WORDS.get(stem) or WORDS.get(stem.removesuffix("s"))
            if meant is not None:
                return _meaning_of(short + meant, quantity)
    return None
