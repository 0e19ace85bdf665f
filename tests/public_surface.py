"""What the reference of the API shows, function by function, and what its docstrings leave unsaid."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from types import FunctionType
from typing import Any

from tests.documents import ROOT
from tests.raised_errors import raised

ARRAY = re.compile(r"\b(Real|Complex|Ints|Bools|NDArray|ndarray)\b")
NUMBER = re.compile(r"\b(float|complex|Real|Complex)\b")
_BRACKET = re.compile(r"\(([^()]*(?:\([^()]*\)[^()]*)?)\)")
ENTRY = r"|\.\.\.|(?:\d+ )?\w+(?: (?:or|\+|·) \w+)*"  # of a shape
REACH = 160  # characters behind a name within which its shape stands
GREEK = {"theta": "θ", "omega": "ω", "psi": "ψ"}
WITH_UNIT = re.compile(r"_(hz|s|sd)$")  # names that say their unit, or are in that of what they belong to
UNIT = re.compile(
    r"\b(SI|Hz|rad/s|1/s|kg|N|m|s|samples|periods|standard deviations?|sd|units? of|%|per cent)\b|±|χ²|\bp-value"
)
# Numbers without a unit: shares, counts, probabilities, signs.
PURE = {
    "level", "tolerance", "chi2", "p", "dof", "damping_ratio", "probability", "signs", "rejected", "max_iterations",
    "factor", "scaled", "measured", "resonances", "rms", "T", "products", "information", "periods",
}  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """A function or method, or a class with its fields: the types that it declares, and its docstring."""

    name: str
    value: Any
    declared: dict[str, str]
    text: str

    def without_shape(self) -> list[str]:
        """Arrays, taken, held or given, of which no shape is stated."""
        return [
            name for name, words in self.declared.items() if ARRAY.search(words) and not self._shaped(name)
        ]

    def _shaped(self, name: str) -> bool:
        """Whether a shape stands behind the name (the second bracket at the latest), or anywhere for what is given."""
        if name == "return":
            return any(_is_shape(bracket[1]) for bracket in _BRACKET.finditer(self.text))
        for place in re.finditer(rf"\b({name}|{name.capitalize()})\b|{GREEK.get(name, name)}", self.text):
            brackets = list(_BRACKET.finditer(self.text, place.end()))[:2]
            if any(_is_shape(bracket[1]) and bracket.start() < place.end() + REACH for bracket in brackets):
                return True
        return False

    def without_unit(self) -> list[str]:
        """Numbers and arrays of numbers of which no unit is stated."""
        plain = _BRACKET.sub(lambda bracket: "" if _is_shape(bracket[1]) else bracket[0], self.text)
        if UNIT.search(plain):
            return []
        numbers = [name for name, words in self.declared.items() if NUMBER.search(words)]
        known = {self.name.rpartition(".")[2] if name == "return" else name: name for name in numbers}
        return [name for said, name in known.items() if not WITH_UNIT.search(said) and said not in PURE]

    def unlisted_errors(self) -> dict[str, str]:
        """Errors that it may raise and does not name, with the way to each."""
        if inspect.isclass(self.value):
            return {}
        said = self.text + "".join(_referred(self.value, self.text))
        return {error: way for error, way in raised(self.value).items() if error not in said}


def _is_shape(inside: str) -> bool:
    """Whether the inside of a bracket is a shape: "lines,", "..., m", "K or 1, lines, 2 n"; not a sentence."""
    entries = inside.split(",")
    return len(entries) > 1 and all(re.fullmatch(ENTRY, entry.strip()) for entry in entries)


def _referred(function: Callable[..., Any], text: str) -> Iterator[str]:
    """Docstrings that a docstring refers to by "as `identify`"."""
    for name in re.findall(r"as (?:of )?`(\w+)`", text):
        owner = function.__globals__.get(function.__qualname__.split(".")[0])  # type: ignore[attr-defined]
        other = function.__globals__.get(name, getattr(owner, name, None))  # type: ignore[attr-defined]
        yield inspect.getdoc(other) or ""


def listed() -> list[str]:
    """Every name that a page of the reference documents."""
    pages = "".join(page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs" / "api").glob("*.md")))
    return re.findall(r"auto(?:class|function):: (dashpot\.[\w.]+)$", pages, re.MULTILINE)


def entry(name: str, value: Any, raw: Any = None) -> Entry:
    """Of a function, or of a class with its fields; `raw` is what holds the docstring of a property."""
    if inspect.isclass(value):
        fields = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
        declared = {field.name: str(field.type) for field in fields}
    else:
        declared = {argument: str(words) for argument, words in value.__annotations__.items()}
    return Entry(name, value, declared, inspect.getdoc(value if raw is None else raw) or "")


def entries() -> Iterator[Entry]:
    """Functions and classes of the reference, and the methods and properties that dashpot defines for them."""
    for name in listed():
        module, _, attribute = name.rpartition(".")
        value = getattr(import_module(module), attribute)
        yield entry(name, value)
        for kind in value.__mro__ if inspect.isclass(value) else ():
            for member, raw in vars(kind).items() if kind.__module__.startswith("dashpot") else ():
                function = getattr(raw, "__func__", getattr(raw, "fget", getattr(raw, "func", raw)))
                if isinstance(function, FunctionType) and not member.startswith("_"):
                    yield entry(f"{name}.{member}", function, raw)
