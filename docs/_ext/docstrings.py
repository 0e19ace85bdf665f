"""Docstrings as the code writes them, plain text with aligned columns, turned into reStructuredText."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

# "data    a Spectrum, …": a name or several, two blanks or more, what it is.
_ROW = re.compile(r"^([\w.…*]+(?:, [\w.…*]+)*)  +(\S.*)$")
_RAISES = re.compile(r"\b(Raises(?: as)?) (`?[A-Za-z_]+`?)")


def _escaped(text: str) -> str:
    """A line of prose: code in double backticks, no other mark-up."""
    parts = re.split(r"(`[^`]+`)", text)
    return "".join(
        f"`{part}`" if k % 2 else re.sub(r"([\\*|:])", r"\\\1", re.sub(r"(\w)_(?!\w)", r"\1\\_", part))
        for k, part in enumerate(parts)
    )


def _paragraph(lines: list[str]) -> list[str]:
    """One paragraph: a table of names, an indented block, or prose."""
    if all(line.startswith("    ") for line in lines):
        return ["::", "", *(f"  {line}" for line in lines), ""]
    row = _ROW.match(lines[0])
    if row is not None:
        rows: list[tuple[str, list[str]]] = []
        for line in lines:
            row = _ROW.match(line)
            if row is not None and not line.startswith(" "):
                rows.append((row[1], [row[2]]))
            else:
                rows[-1][1].append(line.strip())
        return [*(f"- ``{name}``: {_escaped(' '.join(text))}" for name, text in rows), ""]
    text = " ".join(line.strip() for line in lines)
    return [_RAISES.sub(r"**\1** \2", _escaped(text)), ""]


def _convert(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    paragraphs: list[list[str]] = [[]]
    for line in lines:
        if line.strip():
            # An indented block may follow its sentence without a blank line.
            inside = bool(paragraphs[-1]) and paragraphs[-1][-1].startswith("    ")
            if paragraphs[-1] and line.startswith("    ") != inside and not _ROW.match(paragraphs[-1][0]):
                paragraphs.append([])
            paragraphs[-1].append(line.rstrip())
        elif paragraphs[-1]:
            paragraphs.append([])
    lines[:] = [line for paragraph in paragraphs if paragraph for line in _paragraph(paragraph)]


def _plain_defaults(
    app: Sphinx, what: str, name: str, obj: object, options: Any, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Defaults that are no expressions, such as <factory>, keep Sphinx from reading the signature: they become "…"."""
    return None if signature is None else re.sub(r"<[^<>]*>", "...", signature), returns


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _convert)
    app.connect("autodoc-process-signature", _plain_defaults)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
