"""Free matrices in a rig file: free = "MCK", or a table that says which entries may differ from 0."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

from dashpot.io.words import listed, shown, written
from dashpot.model.elements import Element
from dashpot.model.rigfile.reading import RigReading
from dashpot.model.rigfile.schema import FREE_EXAMPLE, Head
from dashpot.model.unstructured import LETTERS, Letter, Pairs, free_elements


def read_free(reading: RigReading, head: Head) -> tuple[Element, ...]:
    """Elements of the free matrices, none where there are none."""
    if "free" not in reading.table:
        return ()
    entries = _entries(reading.table["free"])
    if not entries:
        what = f"{written(reading.table['free'])} names no matrices"
        reading.report.add(("free",), what, f"write {FREE_EXAMPLE}")
        reading.faulty.add("free")
        return ()
    if 0 < sum(x in head.angles for x in head.coordinates) < len(head.coordinates):
        what = "free matrices of displacements and angles together have no units"
        reading.report.add(("free",), what, "describe this rig by its elements")
        reading.faulty.add("free")
        return ()
    pairs: dict[Letter, Pairs] = {}
    for name, raw in entries.items():
        letter = next((known for known in LETTERS if known == name), None)
        if letter is None:
            reading.report.add(("free", name), "no such matrix", "there are M, C and K")
            continue
        chosen = _pairs(reading, letter, raw, head.coordinates)
        if chosen is not None:
            pairs[letter] = chosen
    if set(pairs) != set(entries):
        reading.faulty.add("free")
    return free_elements(head.coordinates, pairs=pairs, letters="".join(pairs))


def _entries(raw: object) -> dict[str, Any] | None:
    """What is said of each matrix; None where it is no set of matrices."""
    if isinstance(raw, str) and raw and all(raw.count(c) == 1 and c in LETTERS for c in raw):
        return dict.fromkeys(raw, "full")
    return raw if isinstance(raw, dict) else None


def _pairs(reading: RigReading, letter: Letter, entries: object, coordinates: Sequence[str]) -> Pairs | None:
    """The off-diagonal entries of a free matrix; None where they are misnamed."""
    if entries == "full":
        return list(combinations(coordinates, 2))
    if entries == "diagonal":
        return []
    if not isinstance(entries, list):
        cure = 'write "full", "diagonal" or the pairs that are joined: [["x1", "x2"], ["x2", "x3"]]'
        reading.report.add(("free", letter), f"{written(entries)} does not describe its entries", cure)
        return None
    pairs = []
    for k, pair in enumerate(entries):
        known = isinstance(pair, list) and len(pair) == 2 and all(name in coordinates for name in pair)
        if not known or pair[0] == pair[1]:
            text = ", ".join(map(str, pair)) if isinstance(pair, list) else written(pair)
            cure = f"name two different coordinates: {listed(coordinates)}"
            reading.report.add(("free", letter, k), f"{shown(text, 60)}: not a pair of coordinates", cure)
            return None
        pairs.append((pair[0], pair[1]))
    return pairs
