"""Names and tags of files for other programs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from xml.sax.saxutils import quoteattr


def distinct(names: Iterable[str], between: str = "_", taken: Iterable[str] = ()) -> list[str]:
    """The names, made different from each other and from those `taken` by a number behind what is `between`."""
    given, out = set(taken), []
    for name in names:
        unique, count = name, 1
        while unique in given:
            count += 1
            unique = f"{name}{between}{count}"
        given.add(unique)
        out.append(unique)
    return out


def xml_tag(name: str, attributes: Mapping[str, object], inside: str | None = None) -> str:
    """<name attribute="…"/>, or around what is inside; attributes that are None are left out."""
    given = [f"{key}={quoteattr(str(value))}" for key, value in attributes.items() if value is not None]
    head = " ".join([name, *given])
    return f"<{head}/>" if inside is None else f"<{head}>{inside}</{name}>"
