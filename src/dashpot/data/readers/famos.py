"""FAMOS files of imc: keys |XX,version,length,content; in text, and blocks of samples between them."""

from __future__ import annotations

import mmap
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dashpot.data.readers.arrays import PIECE, ArrayColumns, Streamed, array_columns, steps
from dashpot.data.readers.columns import TIME
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.text import text_of
from dashpot.errors import DataError

_KEY = re.compile(rb"\|([A-Za-z]{2}),\s*(\d{1,3}),\s*(\d{1,15}),")
NUMBERS = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8", 13: "48 bits"}
DIGITAL = 11  # words of single bits
SAMPLES = b"CS"
Content = bytes | mmap.mmap


@dataclass
class _Component:
    """One row of samples: where they are and how they become numbers."""

    step: float = 0.0
    start: float = 0.0
    kind: int = 0
    width: int = 0
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    name: str = ""
    block: int = 0
    first: int = 0
    size: int = 0
    rotated: int = 0
    apart: bool = False  # other samples lie between these


@dataclass
class _Group:
    """A channel: one component, or two, the second being the abscissa."""

    step: float = 0.0
    start: float = 0.0
    components: list[_Component] = field(default_factory=list)


def read_famos(file: DataFile) -> Iterator[ArrayColumns]:
    """The channels: those of one length and sampling are a part, one with an abscissa of its own is a part alone.

    Digital channels, which hold switches, are passed over.  Raises DataError for what is damaged or cut off.
    """
    data = file.contents
    groups: list[_Group] = []
    blocks: dict[int, tuple[int, int]] = {}
    position = 0
    while position < len(data):
        match = _KEY.match(data, position)
        if match is None:
            raise DataError(
                f"no key begins at byte {position + 1}", file.name, "the file is damaged; copy it again"
            )
        begin = match.end()
        end = begin + int(match[3])
        if data[end : end + 1] != b";":
            what = "cut off" if end >= len(data) else "damaged"
            raise DataError(f"the file is {what} at byte {position + 1}", file.name, "copy it again")
        try:
            if match[1] == SAMPLES:
                mark = data.find(b",", begin, min(end, begin + 20))
                blocks[int(data[begin : max(mark, begin)])] = (mark + 1, end)
            else:
                _note(match[1], data[begin:end], groups)
        except (ValueError, IndexError):
            key = match[1].decode()
            raise DataError(
                f"key {key} at byte {position + 1} is damaged", file.name, "copy it again"
            ) from None
        following = data.find(b"|", end)
        position = len(data) if following < 0 else following
    together: dict[tuple[int, float, float], dict[str, Any]] = {}
    units: dict[str, str | None] = {}
    for number, group in enumerate(groups, start=1):
        component = group.components[0] if group.components else _Component()
        if not component.size or component.kind == DIGITAL:
            continue
        values = [_values(each, data, blocks, file.name) for each in group.components[:2]]
        name = component.name or f"channel_{number}"
        if len(values) == 2 and len(values[0]) == len(values[1]):
            yield array_columns(file.name, {TIME: values[1], name: values[0]}, {name: component.unit or None})
            continue
        key = len(values[0]), component.step or group.step, component.start or group.start
        together.setdefault(key, {})[name] = values[0]
        units[name] = component.unit or None
    for (rows, step, start), columns in together.items():
        time = {TIME: steps(start, step, rows)} if step > 0 else {}
        yield array_columns(file.name, {**time, **columns}, units)


def _note(key: bytes, content: bytes, groups: list[_Group]) -> None:
    """Take in what a key says of the channel, or of its newest component.  Raises ValueError or IndexError."""
    if key == b"CG":
        groups.append(_Group())
    if key not in (b"CD", b"CC", b"CP", b"CR", b"CN", b"Cb"):
        return
    fields, components = [part.strip() for part in content.split(b",")], groups[-1].components
    if key == b"CD":
        holder = components[-1] if components else groups[-1]
        holder.step = float(fields[0])
        holder.start = float(fields[7]) if len(fields) > 7 and fields[7] else 0.0
        return
    if key == b"CC" or not components:
        components.append(_Component())
    component = components[-1]
    if key == b"CP":
        component.width, component.kind = int(fields[1]), int(fields[2])
        mask, offset, _, gap = (int(text) for text in fields[4:8])
        component.kind = DIGITAL if mask else component.kind
        component.apart = bool(offset or gap)
    elif key == b"CR":
        if int(fields[0]) == 1:
            component.factor, component.offset = float(fields[1]), float(fields[2])
        component.unit = _text(content, 4)
    elif key == b"CN":
        component.name = _text(content, 3)
    elif key == b"Cb":
        component.block, component.first, component.size = int(fields[3]), int(fields[4]), int(fields[7])
        component.rotated = int(fields[6])
        component.start = float(fields[9]) if len(fields) > 9 and fields[9] else component.start


def _text(content: bytes, at: int) -> str:
    """A text that stands behind its length, which is field `at`; it may hold commas."""
    parts = content.split(b",", at + 1)
    return text_of(parts[at + 1][: int(parts[at])]).strip()


def _values(component: _Component, data: Content, blocks: dict[int, tuple[int, int]], source: str) -> Any:
    """The samples of a component as numbers.  Raises DataError if they are not there."""
    begin, end = blocks.get(component.block, (0, 0))
    first, last = begin + component.first, begin + component.first + component.size
    kind = NUMBERS.get(component.kind)
    width = 6 if component.kind == 13 else int(kind[1:]) if kind else 0
    if component.apart:
        what = f"the samples of {component.name or 'a channel'} lie between others"
        raise DataError(what, source, "save each channel separately")
    if kind is None or width != component.width or component.first < 0 or component.size < 0 or last > end:
        what = f"the samples of {component.name or 'a channel'} are not where the file says, or of an unknown kind"
        raise DataError(what, source, "the file is damaged; copy it again")
    rows = component.size // width
    split = component.rotated // width if 0 < component.rotated < rows * width else 0
    ranges = ((first + split * width, first + rows * width), (first, first + split * width))

    def pieces() -> Iterator[Any]:
        for start, stop in ranges:
            for at in range(start, stop, PIECE * width):
                raw = data[at : min(at + PIECE * width, stop)]
                if component.kind == 13:
                    words = np.frombuffer(raw, dtype="<u2").reshape(-1, 3).astype(float)
                    numbers = words[:, 0] + 65536.0 * words[:, 1] + 65536.0**2 * words[:, 2]
                else:
                    numbers = np.frombuffer(raw, dtype=f"<{NUMBERS[component.kind]}").astype(float)
                yield numbers * component.factor + component.offset

    return Streamed(rows, pieces)
