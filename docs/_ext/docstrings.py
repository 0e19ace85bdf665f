"""Docstrings as the code writes them, shown in the sections of numpydoc.

The code writes rows of names, shapes and what they are, "values (..., m)    estimates", and sentences that begin with
"Raises": rows become Parameters of functions and Attributes of classes, the sentences become Raises, with links.
"""

from __future__ import annotations

import builtins
import re
from typing import Any

from sphinx.application import Sphinx

# A name or several with one shape behind them; two blanks or more; what it is: "inputs, outputs  channels".
_NAME = r"[\w.…*]*[\w…*]"
_SHAPE = r"\((?:[^()]|\([^()]*\))*\)"
_ROW = re.compile(rf"^({_NAME}(?: {_SHAPE})?(?:, {_NAME}(?: {_SHAPE})?)*)  +(\S.*)$")
_SHAPED = re.compile(rf"^({_SHAPE})(?:[,:;]? +|$)(.*)$")
_RAISES = re.compile(r"\bRaises (?=[A-Z]\w*Error\b)")
_ERROR = re.compile(r"(?:, and |, | or |^)([A-Z]\w*Error)\b")
_FUNCTIONS = ("function", "method")


def _escaped(text: str) -> str:
    """A line of prose: code in double backticks, no other mark-up."""
    parts = re.split(r"(`[^`]+`)", text)
    return "".join(
        f"`{part}`" if k % 2 else re.sub(r"([\\*|:])", r"\\\1", re.sub(r"(\w)_(?!\w)", r"\1\\_", part))
        for k, part in enumerate(parts)
    )


def _rows(lines: list[str]) -> list[tuple[str, str]]:
    """Names and what they are, of a paragraph that begins with a row; lines further in go on."""
    rows: list[tuple[str, list[str]]] = []
    for line in lines:
        row = _ROW.match(line)
        if row is not None:
            rows.append((row[1], [row[2]]))
        else:
            rows[-1][1].append(line.strip())
    return [(names, " ".join(text)) for names, text in rows]


def _entry(names: str, text: str) -> list[str]:
    """A row as numpydoc has it: the shape, behind the names or before the text, stands where a type would."""
    behind = re.fullmatch(rf"({_NAME}(?:, {_NAME})*) ({_SHAPE})", names)
    before = _SHAPED.match(text)
    shape = ""
    if behind is not None:
        names, shape = behind[1], behind[2]
    elif before is not None:
        shape, text = before[1], before[2]
    head = f"**{names.replace('*', chr(92) + '*')}**"
    return [f"{head} : {_escaped(shape)}" if shape else head, f"    {_escaped(text)}" if text else "    |"]


def _errors(sentence: str) -> list[str]:
    """ "DataError or UsageError if a, and ModelError if b." as entries, each its errors and when they are raised."""
    starts = [match.start(1) for match in _ERROR.finditer(sentence)]
    lines: list[str] = []
    names: list[str] = []
    for start, end in zip(starts, [*starts[1:], len(sentence)], strict=True):
        name, _, when = sentence[start:end].partition(" ")
        name = name.strip(",.")
        names.append(f":py:exc:`{name}`" if hasattr(builtins, name) else f":py:exc:`dashpot.{name}`")
        when = re.sub(r"(?:(?:,? |^)(?:and|or)|,|\.)?\s*$", "", when)
        if when:
            lines += [", ".join(names), f"    {_escaped(when)}"]
            names = []
    return [*lines, *([", ".join(names), "    |"] if names else [])]


def converted(lines: list[str], what: str) -> list[str]:
    """A docstring in the sections of numpydoc; `what` it is of, as autodoc names it."""
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
    prose: list[str] = []
    rows: list[tuple[str, str]] = []
    raises: list[str] = []
    for paragraph in filter(None, paragraphs):
        if all(line.startswith("    ") for line in paragraph):
            prose += ["::", "", *(f"  {line}" for line in paragraph), ""]
        elif _ROW.match(paragraph[0]):
            rows += _rows(paragraph)
        else:
            text, *errors = _RAISES.split(" ".join(line.strip() for line in paragraph))
            for error in errors:
                # what follows the full stop of the last error is prose again
                said, stop, rest = error.partition(".  ")
                raises += _errors(said + stop.strip())
                text += rest
            prose += [_escaped(text.strip()), ""] if text.strip() else []
    section = "Parameters" if what in _FUNCTIONS else "Attributes"
    if rows:
        prose += [f":{section}:", *(f"    {line}" for row in rows for line in _entry(*row)), ""]
    if raises:
        prose += [":Raises:", *(f"    {line}" for line in raises), ""]
    return prose


def _convert(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    lines[:] = converted(lines, what)


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
