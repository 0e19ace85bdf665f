"""Damage: numbers, names, structure and bytes of an input changed as slips, faults and malice change them."""

import json
import random
import re
from collections.abc import Callable
from typing import Any

NUMBERS = (
    "0", "-0.0", "-1", "1e-320", "1e-300", "1e-200", "1e16", "1e30", "1e100", "1e200", "1e308", "-1e308",
    "1e309", "nan",
    "-inf", "inf", "NaN", "9" * 400, "1" + "0" * 30, "0x10", "1_000", "1,000", "1.000,5", "1e", "--1", "+5", "٣",
    "½", "1 2",
    "2147483648", "18446744073709551616", "true", "null", "\"3\"", "[]", "{}", "", "1e-5", "3.0", "42",
)  # fmt: skip
SIZES = (
    "0", "-0.0", "-1", "1", "2", "1e-320", "1e-300", "1e-200", "1e-20", "1e-9", "1e9", "1e16", "1e30", "1e100",
    "1e200", "1e308",
    "-1e308", "3.0", "-4e3",
)  # fmt: skip
NAMES = (
    "n" * 300, "x" * 5000, "time_s", "frequency_hz", "experiment", "ground", "all", "worst", "none", "auto", "a b",
    "$x$", "$\\frac{", "x_{1", "\\", "[red]x[/]", "[/]", "x\ny", "x\ty", "\x1b[31mred", "\u202eevil", "é", "名",
    "😀", "-x", "--json", "x=1", "x,y", "x.y", "x'y", 'x"y', "<b>x</b>", "&amp;", "{x}", "{{ 7*7 }}", "%s", "x/u",
    "x_re",
    "x_sd", "u_im", ".", "..", "", " ", "\0", "__proto__", "None", "nan", "1", "1e5",
)  # fmt: skip
WORDS = (
    '"', "'", ",", ";", "\t", "|", "=", "[", "]", "{", "}", "#", "\\", "\0", "\ufeff", "\r", "\r\n", "\n\n", "\x1b[2J",
    "\x7f", "\x85", "\u2028", "\ud800", '"""', "//", "[[", "]]", ". ", "sep=;", "e", "-", "−", "+",
)  # fmt: skip

_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")


def _toml_name(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)


def number(text: str, rng: random.Random) -> str:
    """One number by another."""
    places = list(_NUMBER.finditer(text))
    if not places:
        return text
    place = rng.choice(places)
    value = rng.choice(SIZES if rng.random() < 0.6 else NUMBERS)
    if rng.random() < 0.3:
        value = str(float(place[0]) * rng.choice((-1, 0, 1e-9, 1e-3, 1e3, 1e9, 1e150)))
    return text[: place.start()] + value + text[place.end() :]


def every_number(text: str, rng: random.Random) -> str:
    """All numbers of a random kind by the same, or scaled alike."""
    factor = rng.choice((0.0, -1.0, 1e-12, 1e-6, 1e6, 1e12, 1e60, 1e200))
    share = rng.random()
    return _NUMBER.sub(
        lambda place: repr(float(place[0]) * factor) if rng.random() < share else place[0], text
    )


def name(text: str, rng: random.Random) -> str:
    """A name by another, in one place or wherever it stands."""
    names = sorted(set(_NAME.findall(text)))
    if not names:
        return text
    old, new = rng.choice(names), rng.choice((*NAMES, *names))
    if rng.random() < (0.5 if new.isidentifier() else 0.85):
        new = _toml_name(new)
    pattern = re.compile(rf"\b{re.escape(old)}\b")
    return pattern.sub(lambda _: new, text, count=rng.choice((0, 1)))


def line(text: str, rng: random.Random) -> str:
    """Lines deleted, doubled, swapped or repeated many times."""
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(6)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(other, lines[at])
    elif kind == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif kind == 3:
        lines[at : at + 1] = [lines[at]] * rng.choice((2, 30, 300))
    elif kind == 4:
        del lines[min(at, other) : max(at, other)]
    else:
        lines = lines[: at + 1]
    return "".join(lines)


def word(text: str, rng: random.Random) -> str:
    """A piece of text put in or taken out."""
    at = rng.randrange(len(text) + 1)
    if rng.random() < 0.5:
        return text[:at] + rng.choice(WORDS) * rng.choice((1, 1, 1, 2, 500)) + text[at:]
    return text[:at] + text[at + rng.choice((1, 1, 2, 5, 40)) :]


def cell(text: str, rng: random.Random) -> str:
    """A cell or a column of a table changed, as far as the text is one."""
    lines = text.splitlines()
    separator = max(",;\t", key=text.count)
    rows = [one.split(separator) for one in lines]
    if len(rows) < 2:
        return text
    at = rng.randrange(len(rows))
    column = rng.randrange(max(len(rows[at]), 1))
    kind = rng.randrange(5)
    if kind == 0:
        rows[at][column] = rng.choice((*NUMBERS, *NAMES[:12]))
    elif kind == 1:
        for row in rows[1:]:
            if column < len(row):
                row[column] = rows[1][min(column, len(rows[1]) - 1)]
    elif kind == 2:
        for row in rows:
            del row[column : column + 1]
    elif kind == 3:
        for row in rows:
            if column < len(row):
                row.insert(column, row[column])
    else:
        value = rng.choice(NUMBERS)
        for row in rows[1:]:
            if column < len(row):
                row[column] = value
    return "\n".join(separator.join(row) for row in rows) + "\n"


def layout(text: str, rng: random.Random) -> str:
    """Line ends, separators and decimal signs as other programs write them."""
    old, new = rng.choice(
        (
            ("\n", "\r\n"),
            ("\n", "\r"),
            (",", ";"),
            (",", "\t"),
            (".", ","),
            ("\n", ""),
            (" ", "\u00a0"),
            ("=", ":"),
        )
    )
    return text.replace(old, new)


def tree(text: str, rng: random.Random) -> str:
    """A node of a JSON document changed, where the text is one."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        return number(text, rng)
    nodes: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        items = (
            value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        )
        for key, inner in list(items):
            nodes.append((value, key))
            walk(inner)

    walk(document)
    if not nodes:
        return text
    parent, key = rng.choice(nodes)
    values: tuple[Any, ...] = (
        None, True, 0, -1, -1.0, 1e308, 10**400, "", "nan", "x", [], {}, [None], [[]], {"a": 1}, [1, 2, 3], "x" * 300,
        float("nan"), float("inf"),
    )  # fmt: skip
    kind = rng.randrange(4)
    if kind == 0:
        del parent[key]
    elif kind == 1 and isinstance(parent, list):
        parent.insert(key, parent[key])
    elif kind == 2 and isinstance(parent, dict):
        parent[rng.choice(NAMES)] = parent.pop(key)
    else:
        parent[key] = rng.choice(values)
    try:
        return json.dumps(document)
    except ValueError:
        return text


def raw(content: bytes, rng: random.Random) -> bytes:
    """Bits flipped, bytes cut out or put in, an encoding that is not UTF-8."""
    if not content:
        return b"\xff"
    at = rng.randrange(len(content))
    kind = rng.randrange(6)
    if kind == 0:
        return content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]
    if kind == 1:
        return content[:at]
    if kind == 2:
        return content[:at] + rng.randbytes(rng.choice((1, 4, 64))) + content[at:]
    if kind == 3:
        return content[:at] + bytes(64) + content[at + 64 :]
    if kind == 4:
        return content.decode("utf-8", "replace").encode(
            rng.choice(("utf-16", "utf-8-sig", "utf-7", "cp500")), "replace"
        )
    return b"\x1f\x8b" + content if rng.random() < 0.5 else b""


TEXT: tuple[Callable[[str, random.Random], str], ...] = (
    number,
    number,
    number,
    name,
    name,
    line,
    line,
    word,
    cell,
    layout,
    tree,
)


BINARY = {"mat", "h5", "npz", "npy", "parquet", "feather", "xlsx", "tdms", "mf4", "uff", "wav", "raw"}
LIES = (0, 1, 2, 127, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1)


def binary(content: bytes, rng: random.Random) -> bytes:
    """Bits, counts and blocks of a binary file changed; half of the time near its ends, where headers are."""
    if len(content) < 2:
        return raw(content, rng)
    reach = min(len(content), 600)
    at = rng.randrange(len(content))
    if rng.random() < 0.5:
        at = rng.randrange(reach) if rng.random() < 0.7 else len(content) - 1 - rng.randrange(reach)
    kind = rng.randrange(8)
    if kind == 0:
        return content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]
    if kind == 1:
        return content[:at] + rng.randbytes(1) + content[at + 1 :]
    if kind == 2:  # a header lies about a count
        width = rng.choice((2, 4, 8))
        lie = (rng.choice(LIES) % 2 ** (8 * width)).to_bytes(width, rng.choice(("little", "big")))
        return content[:at] + lie + content[at + width :]
    if kind == 3:
        return content[:at]
    size = rng.choice((1, 4, 8, 64, 512))
    if kind == 4:
        return content[:at] + content[at + size :]
    if kind == 5:
        return content[:at] + content[at : at + size] * rng.choice((2, 3, 100)) + content[at + size :]
    if kind == 6:
        return content[:at] + rng.choice((b"\0", b"\xff")) * size + content[at + size :]
    other = rng.randrange(len(content))
    return content[:at] + content[other : other + size] + content[at + size :]


def damaged(content: bytes, rng: random.Random, kind: str) -> bytes:
    """A file changed once to thrice; `kind` is the end of its name."""
    if kind in BINARY and (kind != "uff" or rng.random() < 0.5):
        for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
            content = binary(content, rng)
        return content
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if rng.random() < 0.12:
            content = raw(content, rng)
            continue
        if rng.random() < 0.04:
            content = every_number(content.decode("utf-8", "surrogateescape"), rng).encode(
                "utf-8", "surrogatepass"
            )
            continue
        choices = (tree,) * 6 + TEXT if kind == "json" else TEXT
        text = rng.choice(choices)(content.decode("utf-8", "surrogateescape"), rng)
        content = text.encode("utf-8", "surrogatepass" if "\ud800" in text else "surrogateescape")
    return content
