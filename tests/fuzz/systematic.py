"""Damage of every kind to a sound file of every format, one after another: `python -m tests.fuzz.systematic`."""

import gzip
import json
import re
import sys
import warnings
from collections.abc import Iterator

from tests.fuzz import corpus
from tests.fuzz.cases import Case
from tests.fuzz.mutation import BINARY
from tests.fuzz.runner import finding, limit_memory

STRUCTURE = re.compile(
    rb"PK\x01\x02|PK\x03\x04|PK\x05\x06|PAR1|ARROW1|TDSm|##[A-Z]{2}|TREE|SNOD|OHDR|HEAP|    -1|data|fmt "
)
READ_BY = {
    "study.toml": "@study",
    "estimate.json": "@estimate",
    "modes.csv": "@modes",
    "modes.json": "@modes",
}


def cases() -> Iterator[Case]:
    """All cases, in the order of the files' names."""
    for name, content in corpus.files().items():
        end = name.rpartition(".")[2]
        reader = READ_BY.get(name, "@rig" if end == "toml" else "@data")
        damages = [*_cut(content, end), *_general(content)]
        damages += [*_lies(content)] if end in BINARY else [*_of_text(content, end)]
        for what, damaged in damages:
            files = {name: damaged}
            if reader == "@study":
                files["rig.toml"] = corpus.files()["rig.toml"]
            yield Case((reader, name), files, what)


def _cut(content: bytes, end: str) -> Iterator[tuple[str, bytes]]:
    """Truncated at the places where the structure of the file changes, and around them."""
    if end in BINARY:
        marks = [match.start() for match in STRUCTURE.finditer(content)]
        places = {
            *marks[:6],
            *marks[-6:],
            1,
            8,
            64,
            128,
            512,
            len(content) // 2,
            len(content) - 8,
            len(content) - 1,
        }
    else:
        lines = [match.end() for match in re.finditer(rb"\n", content)]
        places = {1, *lines[:5], *(line + 3 for line in lines[:4]), *lines[-3:], len(content) - 1}
    for place in sorted(place for place in places if 0 <= place < len(content)):
        yield f"cut off at byte {place}", content[:place]


def _general(content: bytes) -> Iterator[tuple[str, bytes]]:
    for share in (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99):
        at = min(int(share * len(content)), len(content) - 1)
        yield f"byte {at} flipped", content[:at] + bytes([content[at] ^ 0xFF]) + content[at + 1 :]
    yield "twice", content * 2
    yield "with something behind it", content + b"\x00\xff" * 50
    yield "with something in front", b"\n\x00" + content
    yield "zeros", bytes(len(content))
    packed = gzip.compress(content, 1)
    yield "packed and cut off", packed[: len(packed) // 2]
    yield "packed twice", gzip.compress(packed, 1)
    yield "packed with a wrong sum", packed[:-8] + bytes(8)


def _lies(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Words near the ends that are far too large, or negative."""
    places = [*range(4, min(len(content), 200), 12), *range(max(len(content) - 64, 0), len(content) - 4, 12)]
    for at in places:
        for lie in (b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff"):
            yield f"{lie.hex()} at byte {at}", content[:at] + lie + content[at + 4 :]


def _of_text(content: bytes, end: str) -> Iterator[tuple[str, bytes]]:
    """Numbers that are none, columns twice, line ends of all kinds."""
    text = content.decode()
    number = re.compile(r"(?<![\w.])\d+\.?\d*")
    places = [match.span() for match in number.finditer(text)]
    for start, stop in places[:: max(1, len(places) // 5)]:
        for word in ("nan", "1e999", "", "two"):
            yield f"{word!r} at {start}", (text[:start] + word + text[stop:]).encode()
    lines = text.splitlines()
    yield (
        "mixed line ends",
        "".join(line + ("\r\n", "\n", "\r\r\n")[k % 3] for k, line in enumerate(lines)).encode(),
    )
    yield "old line ends", text.replace("\n", "\r").encode()
    yield "a blank line between all", text.replace("\n", "\n\n").encode()
    yield "UTF-16", text.encode("utf-16")
    if end in ("csv", "lvm"):
        separator = max(",;\t", key=text.count)
        yield (
            "a column twice",
            "\n".join(line + separator + line.split(separator)[0] for line in lines).encode(),
        )
        yield "all columns twice", "\n".join(line + separator + line for line in lines).encode()
        yield (
            "a row too short",
            "\n".join([*lines[:-2], lines[-2].rpartition(separator)[0], lines[-1]]).encode(),
        )


def main() -> int:
    """A line of JSON for each fault, then one with the number of cases; 1 where there is a fault."""
    warnings.simplefilter("ignore")
    corpus.files()
    limit_memory()
    count, faults = 0, 0
    for case in cases():
        count += 1
        what = finding(case)
        if what is not None:
            faults += 1
            print(json.dumps({"file": case.arguments[1], "damage": case.what, "finding": what}), flush=True)
    print(json.dumps({"cases": count, "formats": len(corpus.files())}))
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
