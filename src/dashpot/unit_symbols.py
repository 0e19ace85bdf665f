"""What the symbols of units mean: factors to SI and dimensions, by the quantity in which they are used."""

from __future__ import annotations

import math
from dataclasses import dataclass

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
SHARE = "FS"  # of the full scale: a number without unit, as counts are


@dataclass(frozen=True)
class Symbol:
    factor: float
    dimension: Dimension
    prefixes: str = ""
    only: frozenset[str] | None = None  # the quantities in which the symbol has this meaning; None: all


PREFIXES = {
    "p": 1e-12, "n": 1e-9, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "h": 1e2, "k": 1e3, "M": 1e6, "G": 1e9,
}  # fmt: skip
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
    (SHARE, Symbol(1.0, COUNT)),
)
WORDS = {
    "metre": "m", "meter": "m", "gram": "g", "second": "s", "radian": "rad", "degree": "deg", "hertz": "Hz",
    "newton": "N", "volt": "V", "pound": "lb",
}  # fmt: skip

SYMBOLS: dict[str, list[Symbol]] = {}
for _names, _meaning in _TABLE:
    for _name in _names.split():
        SYMBOLS.setdefault(_name, []).insert(
            0 if _meaning.only is not None else len(SYMBOLS.get(_name, [])), _meaning
        )
