"""FAMOS files made by hand as imc devices write them."""

from __future__ import annotations

import numpy as np

from dashpot.data.record import Record
from tests.unit.data.readers.written import NAMES, RATE


def key(tag, content, version=1):
    return f"|{tag},{version},{len(content):6d},".encode() + content + b";"


def channel(number, name, unit, raw, kind, width, step, start=0.0, factor=None, rotated=0):
    """One channel with its block of samples."""
    scaled = b"0, 1.0, 0.0" if factor is None else f"1, {factor!r}, 0.5".encode()
    return b"".join(
        [
            key("CG", b"1,1,1"),
            key("CD", f" {step!r},1,1,s,0,0,0, 0.0,1".encode(), 2),
            key("CC", b"1,1"),
            key("CP", f"{number},{width},{kind},{8 * width},0,0,1,0".encode()),
            key("CR", scaled + f",1,{len(unit)},{unit}".encode()),
            key("CN", f"0,0,0,{len(name)},{name},0,".encode()),
            key("Cb", f"1,0,{number},{number},0,{len(raw)},{rotated},{len(raw)},1, {start!r}, 0.0,".encode()),
            key("CS", f"{number},".encode() + raw),
            b"\r\n",
        ]
    )


HEAD = b"|CF,2,1,1;|CK,1,3,1,1;" + key("NO", b"1,6,by|;us,0,")


def dwell(record: Record) -> bytes:
    """A file of one dwell, a channel of doubles for each of NAMES, mm."""
    columns = [np.round(x * 1e3 * 1024) / 1024 for x in record.values.T]
    return HEAD + b"".join(
        channel(i + 1, name, "mm", x.astype("<f8").tobytes(), 8, 8, 1 / RATE)
        for i, (name, x) in enumerate(zip(NAMES, columns, strict=True))
    )
