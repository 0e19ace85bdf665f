"""Universal files written: functions at nodes (58, 58b) and modes (55)."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence

import numpy as np

from dashpot.data.readers.uff import (
    EXACT,
    FRF,
    LINES,
    OF_FREQUENCY,
    OF_TIME,
    TIME_RESPONSE,
    NodalFunction,
    NodalMode,
    NodePoint,
)
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.io.atomic import write_bytes

END = b"    -1\n"


def write_universal_file(
    path: str | os.PathLike[str],
    functions: Sequence[NodalFunction] = (),
    modes: Sequence[NodalMode] = (),
    *,
    binary: bool = True,
    double: bool = True,
    little: bool = True,
) -> None:
    """Write functions as datasets 58b (or 58), then modes as datasets 55, complex eigenvalues of the second order.

    Start and step of even abscissae keep all their digits in ID line 5.  Ordinates in binary double precision read back
    to the last bit.  Raises DataError if the file cannot be written.
    """
    write_bytes(path, itertools.chain(_functions(functions, binary, double, little), _modes(modes)))


def write_uff_records(
    records: Sequence[Record],
    path: str | os.PathLike[str],
    *,
    binary: bool = True,
    double: bool = True,
    little: bool = True,
) -> None:
    """Write records as time responses in the channels' own units, the drive frequency on the third axis.

    Raises DataError for repeats (leading axes), and where the file cannot be written.
    """
    functions = []
    for record in records:
        if record.values.ndim != 2:
            raise DataError("a file holds records, not repeats of them", record.source, "write one file each")
        for i, channel in enumerate(record.channels):
            functions.append(
                NodalFunction(
                    TIME_RESPONSE,
                    NodePoint(channel.name[:10], i + 1),
                    NodePoint(),
                    record.time,
                    record.values[:, i] / channel.scale,
                    channel.unit,
                    ids=(channel.name,),
                    even=_is_even(record.time),
                    z_kind=OF_FREQUENCY if record.frequency_hz is not None else 0,
                    z_value=record.frequency_hz or 0.0,
                )
            )
    write_universal_file(path, functions, binary=binary, double=double, little=little)


def _is_even(abscissa: np.ndarray) -> bool:
    """Whether start and step give the abscissa, to rounding."""
    if len(abscissa) < 2:
        return False
    step = (abscissa[-1] - abscissa[0]) / (len(abscissa) - 1)
    away = np.abs(abscissa[0] + step * np.arange(len(abscissa)) - abscissa)
    return bool(np.max(away) <= 1e-9 * step)


def _functions(
    functions: Sequence[NodalFunction], binary: bool, double: bool, little: bool
) -> Iterator[bytes]:
    for function in functions:
        even = function.even and _is_even(function.abscissa)
        # All lines in front of the numbers
        data_type = (6 if double else 5) if np.iscomplexobj(function.ordinate) else (4 if double else 2)
        count = len(function.ordinate)
        start = float(function.abscissa[0]) if even else 0.0
        step = float(function.abscissa[-1] - start) / (count - 1) if even else 0.0
        points = ""
        for point in (function.response, function.reference):
            points += f" {(point.entity or 'NONE')[:10]:<10}{point.node:10d}{point.direction:4d}"
        ids = [*function.ids, *[""] * 5][:4]
        ids.append(f"{EXACT} {start!r} {step!r}" if even else "")
        lines = [
            "    -1",
            "    58",
            *(f"{(text or 'NONE')[:80]:<80}" for text in ids),
            f"{function.kind:5d}{0:10d}{0:5d}{0:10d}{points}",
            f"{data_type:10d}{count:10d}{int(even):10d}{_short(start)}{_short(step)}{_short(function.z_value)}",
            _axis(OF_TIME if function.kind == TIME_RESPONSE else OF_FREQUENCY, ""),
            _axis(1, function.unit),
            _axis(1 if function.kind == FRF else 0, function.reference_unit),
            _axis(function.z_kind, ""),
        ]
        end = END
        if binary:
            numbers = (
                _columns(function, even).astype(f"{'<' if little else '>'}f{8 if double else 4}").tobytes()
            )
            end = b"\n" + END
            # Order of bytes, IEEE numbers, how many lines and bytes follow.
            lines[1] += (
                f"b{1 if little else 2:6d}{2:6d}{LINES:12d}{len(numbers):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
            )
        else:
            table = _columns(function, even)
            width = "{:20.12e}" if double else "{:13.5e}"
            formats = [width] * table.shape[1]
            if not even:
                formats[0] = "{:13.5e}"
            # Values of a line: as many numbers as the format has in one.
            per_line = (
                6 // table.shape[1]
                if not double
                else (4 // table.shape[1] if even else 2 if table.shape[1] == 2 else 1)
            )
            out = []
            for first in range(0, len(table), per_line):
                rows = table[first : first + per_line].tolist()
                out.append("".join(f.format(x) for row in rows for f, x in zip(formats, row, strict=True)))
            numbers = ("\n".join(out) + "\n").encode() if out else b""
        yield ("\n".join(lines) + "\n").encode("utf-8", errors="replace")
        yield numbers
        yield end


def _axis(kind: int, unit: str) -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {(unit or 'NONE')[:20]:<20}"


def _short(value: float) -> str:
    """A number in 13 columns, with as many digits as fit."""
    for digits in range(17, 4, -1):
        text = f"{value:.{digits}g}"
        if len(text) <= 12:
            return f"{text:>13}"
    return f"{value:13.5e}"


def _columns(function: NodalFunction, even: bool) -> np.ndarray:
    """Numbers of a value in a row: abscissa (where uneven), real part, imaginary part."""
    y = function.ordinate
    parts = [y.real, y.imag] if np.iscomplexobj(y) else [y]
    return np.stack([*([] if even else [function.abscissa]), *parts], axis=-1)


def _modes(modes: Sequence[NodalMode]) -> Iterator[bytes]:
    for number, mode in enumerate(modes, start=1):
        ids = [*mode.ids, *[""] * 5][:5]
        width = mode.shapes.shape[-1]
        eigenvalue = f"{mode.eigenvalue.real:13.5e}{mode.eigenvalue.imag:13.5e}"
        lines = [
            "    -1",
            "    55",
            *(f"{(text or 'NONE')[:80]:<80}" for text in ids),
            f"{1:10d}{7:10d}{2 if width == 3 else 3:10d}{8:10d}{5:10d}{width:10d}",
            f"{2:10d}{6:10d}{0:10d}{number:10d}",
            eigenvalue + f"{0.0:13.5e}" * 4,
        ]
        for node, shape in zip(mode.nodes, mode.shapes, strict=True):
            lines.append(f"{node:10d}")
            cells = [f"{x.real:13.5e}{x.imag:13.5e}" for x in shape]
            lines += ["".join(cells[k : k + 3]) for k in range(0, width, 3)]
        yield ("\n".join(lines) + "\n").encode("utf-8", errors="replace") + END
