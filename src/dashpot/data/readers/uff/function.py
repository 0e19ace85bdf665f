"""Dataset 58: a function at a node, such as samples over time or a frequency response."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, BinaryIO

import numpy as np

from dashpot.arrays import Complex, Real, freeze, frozen
from dashpot.data.readers.arrays import LONG, PIECE, Streamed, steps
from dashpot.data.readers.datafile import DataFile
from dashpot.errors import DataError

# Floating-point numbers of old machines: IBM System/370 and DEC VAX.


def from_ibm(whole: Any, width: int) -> Real:
    """Numbers ± fraction · 16^(exponent − 64) from unsigned integers of 4 or 8 bytes."""
    bits = 8 * width
    whole = whole.astype(np.uint64)
    sign = np.where(whole >> np.uint64(bits - 1), -1.0, 1.0)
    exponent = ((whole >> np.uint64(bits - 8)) & np.uint64(0x7F)).astype(np.int64) - 64
    fraction = (whole & np.uint64((1 << (bits - 8)) - 1)).astype(float) / 2.0 ** (bits - 8)
    return sign * np.ldexp(fraction, 4 * exponent)


def from_vax(words: Any, width: int) -> Real:
    """F_floating (4 bytes) and D_floating (8 bytes) from words of two bytes, each little-endian."""
    words = words.astype(np.uint64).reshape(-1, width // 2)
    whole = np.zeros(len(words), dtype=np.uint64)
    for k in range(width // 2):  # the word of sign and exponent comes first
        whole = (whole << np.uint64(16)) | words[:, k]
    bits = 8 * width
    sign = np.where(whole >> np.uint64(bits - 1), -1.0, 1.0)
    exponent = ((whole >> np.uint64(bits - 9)) & np.uint64(0xFF)).astype(np.int64)
    hidden = 1 << (bits - 9)
    fraction = ((whole & np.uint64(hidden - 1)) | np.uint64(hidden)).astype(float) / (2.0 * hidden)
    return np.where(exponent == 0, 0.0, sign * np.ldexp(fraction, exponent - 128))


# The datasets of a universal file, one after another, without holding the file.


MARK = b"-1"
LONGEST_LINE = 10_000  # bytes; lines have 80


class UffStream:
    """Lines and blocks of bytes of a universal file, with the number of the line for messages."""

    def __init__(self, stream: BinaryIO, file: DataFile, number: int = 0) -> None:
        self._stream = stream
        self.file = file
        self.number = number

    @property
    def place(self) -> str:
        """The file and the line."""
        return f"{self.file.name}:{self.number}"

    def line(self) -> bytes:
        """The next line without its end; empty lines count.  Raises DataError at the end of the file."""
        text = self._stream.readline(LONGEST_LINE)
        if not text:
            raise self.cut_off()
        self.number += 1
        return text.rstrip(b"\r\n")

    def line_or_end(self) -> bytes | None:
        """The next line, None at the end of the file."""
        text = self._stream.readline(LONGEST_LINE)
        self.number += bool(text)
        return text.rstrip(b"\r\n") if text else None

    def block(self, size: int) -> bytes:
        """So many bytes.  Raises DataError where there are fewer."""
        data = self._stream.read(size)
        if len(data) < size:
            raise self.cut_off()
        return data

    def ends_after(self, size: int) -> bool:
        """Whether the dataset ends behind so many bytes."""
        at = self.position
        self._stream.seek(at + size)
        mark = self._stream.read(6).strip(b"\r\n ")
        self._stream.seek(at)
        return mark.startswith(MARK)

    @property
    def position(self) -> int:
        """The byte of the file that comes next."""
        return self._stream.tell()

    def cut_off(self) -> DataError:
        """The file ends inside a dataset."""
        return DataError("the file ends within a dataset: it is cut off", self.place, "copy it again")

    def wrong(self, what: str) -> DataError:
        """What is wrong at the present line."""
        return DataError(what, self.place, "the file is damaged; export it again")


@dataclass(frozen=True)
class DatasetStart:
    """The first line of a dataset: its number, and what follows it (of 58b: how the bytes are written)."""

    number: int
    binary: bool
    rest: bytes


def dataset_starts(stream: UffStream) -> Iterator[DatasetStart]:
    """Starts of the datasets; who asks for the next one has read the present one to its end.

    Raises DataError where something else stands between datasets.
    """
    while (text := stream.line_or_end()) is not None:
        if not text.strip():
            continue
        if text.strip() != MARK:
            raise stream.wrong("a dataset should begin here, with -1")
        head = stream.line()
        number = head[:6].strip()
        if not number.isdigit():
            raise stream.wrong("the number of a dataset should stand here")
        yield DatasetStart(int(number), head[6:7].lower() == b"b", head[7:])


def skip_dataset(stream: UffStream) -> None:
    """Read on to the end of the dataset."""
    while stream.line().strip() != MARK:
        pass


def expect_end(stream: UffStream) -> None:
    """The end of the dataset.  Raises DataError where something else follows."""
    text = stream.line()
    if not text.strip():
        text = stream.line()
    if text.strip() != MARK:
        raise stream.wrong("the dataset should end here, with -1: it holds more than it says")


TIME_RESPONSE, FRF, TRANSMISSIBILITY, SPECTRUM = 1, 4, 5, 12
DIRECTIONS = {0: "", 1: "+X", 2: "+Y", 3: "+Z", 4: "+RX", 5: "+RY", 6: "+RZ"}
DIRECTIONS |= {-k: name.replace("+", "-") for k, name in DIRECTIONS.items() if k}
LINES = 11  # of text in front of the numbers
OF_TIME, OF_FREQUENCY = 17, 18  # specific data types
EXACT = "ABSCISSA"  # word of ID line 5 in front of start and step with all their digits
Block = tuple[Real | None, Real]  # abscissas, None where they are even; numbers, (values, 1 or 2)


@dataclass(frozen=True)
class NodePoint:
    """Where a function is measured: entity name, node and direction; units of its axis."""

    entity: str = ""
    node: int = 0
    direction: int = 0

    @property
    def name(self) -> str:
        """Node and direction, such as 3+Z."""
        return f"{self.node}{DIRECTIONS.get(self.direction, '')}"


@dataclass(frozen=True)
class LongSamples:
    """Samples over time that are not held, but read again when they are asked for.

    abscissa  tells those over the same times from others: start and step, or a digest of the times
    """

    time: Streamed
    values: Streamed
    abscissa: tuple[float, float] | bytes


@dataclass(frozen=True)
class NodalFunction:
    """One function: kind (1 time response, 4 FRF, 12 spectrum, …), points, abscissa and ordinate.

    abscissa  (values,)  s or Hz
    ordinate  (values,)  real or complex, in `unit` (over `reference_unit`)
    z_value   of the third axis; the drive frequency in Hz where `z_kind` is 18
    long      in place of abscissa and ordinate, which are empty then
    """

    kind: int
    response: NodePoint
    reference: NodePoint
    abscissa: Real
    ordinate: Real | Complex
    unit: str = ""
    reference_unit: str = ""
    ids: tuple[str, ...] = ()
    even: bool = True
    z_kind: int = 0
    z_value: float = 0.0
    long: LongSamples | None = None

    def __post_init__(self) -> None:
        freeze(self)
        kind = np.complex128 if np.iscomplexobj(self.ordinate) else np.float64
        object.__setattr__(self, "ordinate", frozen(self.ordinate, kind))

    def beside(self, other: NodalFunction) -> bool:
        """Whether both have the same abscissa."""
        if self.long is None or other.long is None:
            return self.long is other.long and bool(np.array_equal(self.abscissa, other.abscissa))
        first, second = self.long, other.long
        return (first.abscissa, len(first.values)) == (second.abscissa, len(second.values))


@dataclass(frozen=True)
class _Shape:
    """How the numbers are written: double precision, complex, evenly spaced; how many; start and step."""

    double: bool
    complex: bool
    even: bool
    count: int
    start: float
    step: float

    @property
    def of_value(self) -> int:
        """Numbers of a value, without the abscissa."""
        return 2 if self.complex else 1


Blocks = Callable[[UffStream, _Shape], Iterator[Block]]


def read_function(stream: UffStream, start: DatasetStart) -> NodalFunction:
    """The function of a dataset 58 or 58b.  Raises DataError, with file and line, for what is damaged or cut off."""
    lines = [stream.line() for _ in range(LINES)]
    ids = tuple(_words(line, 0, 80) for line in lines[:5])
    try:
        kind, response, reference = _points(lines[5])
        shape = _shape(lines[6], ids[4])
        kinds = [int(line[:10]) for line in lines[7:]]
        z_value = float(lines[6][56:69] or b"0")
    except (ValueError, IndexError):
        raise stream.wrong("the header of a function is damaged") from None
    if not 0 <= shape.count <= 1 << 40:
        raise stream.wrong(f"{shape.count} values cannot be")
    long: LongSamples | None = None
    abscissa: Real = np.zeros(0)
    ordinate: Real | Complex = np.zeros(0)
    blocks: Blocks = _text_blocks
    if start.binary:
        blocks = partial(_binary_blocks, layout=_layout(stream, start, shape))
    if kind == TIME_RESPONSE and not shape.complex and shape.count >= LONG:
        long = _long(stream, shape, blocks)
    else:
        read = list(blocks(stream, shape))
        numbers = np.concatenate([np.zeros((0, shape.of_value)), *(numbers for _, numbers in read)])
        ordinate = numbers[:, 0] + 1j * numbers[:, 1] if shape.complex else numbers[:, 0]
        if shape.even:
            abscissa = np.asarray(shape.start + shape.step * np.arange(shape.count), dtype=np.float64)
        else:
            abscissa = np.concatenate([np.zeros(0), *(x for x, _ in read if x is not None)])
        _require_finite(abscissa, stream.place)
    return NodalFunction(
        kind,
        response,
        reference,
        abscissa,
        ordinate,
        _label(lines[8]),
        _label(lines[9]),
        ids,
        shape.even,
        kinds[3],
        z_value,
        long,
    )


def _words(line: bytes, start: int, end: int) -> str:
    text = line[start:end].decode("utf-8", errors="replace").strip()
    return "" if text == "NONE" else text


def _label(line: bytes) -> str:
    """The units label of an axis."""
    return _words(line, 46, 67)


def _points(line: bytes) -> tuple[int, NodePoint, NodePoint]:
    """Kind of the function, response and reference."""
    kind = int(line[0:5])
    response = NodePoint(_words(line, 30, 41), int(line[41:51]), int(line[51:55]))
    reference = NodePoint(_words(line, 55, 66), int(line[66:76] or b"0"), int(line[76:80] or b"0"))
    return kind, response, reference


def _shape(line: bytes, exact: str) -> _Shape:
    data_type, count, spacing = int(line[0:10]), int(line[10:20]), int(line[20:30])
    if data_type not in (2, 4, 5, 6):
        raise ValueError
    start, step = float(line[30:43] or b"0"), float(line[43:56] or b"0")
    words = exact.split()
    if words[:1] == [EXACT] and len(words) == 3:
        start, step = float(words[1]), float(words[2])
    return _Shape(data_type in (4, 6), data_type in (5, 6), spacing == 1, count, start, step)


def _require_finite(abscissa: Real, place: str) -> None:
    """Raises DataError where the abscissa is not finite."""
    if not np.all(np.isfinite(abscissa)):
        raise DataError("the abscissa of a function is not finite", place, "export the file again")


def _text_blocks(stream: UffStream, shape: _Shape) -> Iterator[Block]:
    """Values of a dataset in text, some at a time, to its end."""
    widths = [20 if shape.double else 13] * shape.of_value
    if not shape.even:
        widths.insert(0, 13)
    ends = np.cumsum([0, *widths]).tolist()
    at_most = 4 * len(widths) if shape.double else 6
    needed = shape.count * len(widths)
    cells: list[bytes] = []
    read = 0
    while read < needed:
        fields = _fields(stream.line(), ends, at_most)
        if not fields or fields == [MARK]:
            raise stream.wrong(f"the dataset holds {read} of {needed} numbers")
        cells += fields
        read += len(fields)
        if read > needed:
            raise stream.wrong(f"the dataset holds more than {needed} numbers")
        if len(cells) > 1 << 16 or read == needed:
            whole = len(cells) // len(widths) * len(widths)
            try:  # numbers as Fortran writes them
                numbers = np.array([x.replace(b"D", b"E").replace(b"d", b"e") for x in cells[:whole]])
                table = numbers.astype(float).reshape(-1, len(widths))
            except ValueError:
                raise stream.wrong("something that is not a number stands among the values") from None
            yield (None, table) if shape.even else (table[:, 0], table[:, 1:])
            del cells[:whole]
    expect_end(stream)


def _fields(line: bytes, ends: list[int], at_most: int) -> list[bytes]:
    """Numbers of a line by the blanks between them, by columns where some touch each other."""
    fields = line.split()
    touching = not fields or len(fields) > at_most or any(field.count(b".") != 1 for field in fields)
    return _fixed(line, ends) if touching else fields


def _fixed(line: bytes, ends: list[int]) -> list[bytes]:
    """Numbers of a line by the columns of the format."""
    fields, start = [], 0
    while start < len(line.rstrip()):
        for a, b in itertools.pairwise(ends):
            field = line[start + a : start + b].strip()
            if field:
                fields.append(field)
        start += ends[-1]
    return fields


def _long(stream: UffStream, shape: _Shape, blocks: Blocks) -> LongSamples:
    """Many real numbers, which are passed over."""
    at, line = stream.position, stream.number

    def again() -> Iterator[Block]:
        with stream.file.reading() as raw:
            raw.seek(at)
            yield from blocks(UffStream(raw, stream.file, line), shape)

    values = Streamed(shape.count, lambda: (numbers[:, 0] for _, numbers in again()))
    digest = hashlib.blake2b()
    for times, _ in blocks(stream, shape):
        if times is not None:
            _require_finite(times, stream.place)
            digest.update(times.tobytes())
    if not shape.even:
        return LongSamples(Streamed(shape.count, lambda: (x for x, _ in again())), values, digest.digest())
    _require_finite(np.array([shape.start, shape.step]), stream.place)
    return LongSamples(steps(shape.start, shape.step, shape.count), values, (shape.start, shape.step))


@dataclass(frozen=True)
class _Layout:
    """How the bytes of a dataset 58b are written: order, kind of floats, bytes of a value and its abscissa."""

    little: bool
    floats: int
    row: int


def _layout(stream: UffStream, start: DatasetStart, shape: _Shape) -> _Layout:
    """The layout.  Where the number of bytes is wrong, as some programs write it, the end of the dataset decides."""
    try:
        order, floats = int(start.rest[:6]), int(start.rest[6:12])
        lines, size = int(start.rest[12:24]), int(start.rest[24:36])
    except ValueError:
        raise stream.wrong("the first line of a dataset 58b is damaged") from None
    if order not in (1, 2) or floats not in (1, 2, 3) or lines != LINES:
        raise stream.wrong("the first line of a dataset 58b says what cannot be")
    width = 8 if shape.double else 4
    # The abscissa is in single precision, which some write like the ordinate.
    rows = [shape.of_value * width + x for x in ((0,) if shape.even else (4, width))]
    fitting = [row for row in rows if row * shape.count == size]
    fitting += [row for row in rows if stream.ends_after(row * shape.count)]
    return _Layout(order == 1, floats, [*fitting, *rows][0])


def _binary_blocks(stream: UffStream, shape: _Shape, layout: _Layout) -> Iterator[Block]:
    """Values of a dataset 58b, some at a time, to its end."""
    width = 8 if shape.double else 4
    of_abscissa = layout.row - shape.of_value * width
    fields: list[Any] = [("x", f"V{of_abscissa}")] if of_abscissa else []
    fields.append(("y", f"V{width}", (shape.of_value,)))
    for first in range(0, shape.count, PIECE):
        data = stream.block(min(PIECE, shape.count - first) * layout.row)
        table = np.frombuffer(data, dtype=fields)
        y = _floats(table["y"], layout, width).reshape(len(table), shape.of_value)
        yield (_floats(table["x"], layout, of_abscissa) if of_abscissa else None), y
    expect_end(stream)


def _floats(raw: Any, layout: _Layout, width: int) -> Real:
    """Numbers of one width: IEEE, DEC VAX (1) or IBM (3)."""
    data, mark = raw.tobytes(), "<" if layout.little else ">"
    if layout.floats == 2:
        return np.frombuffer(data, dtype=f"{mark}f{width}").astype(float)
    if layout.floats == 3:
        return from_ibm(np.frombuffer(data, dtype=f"{mark}u{width}"), width)
    return from_vax(np.frombuffer(data, dtype="<u2"), width)
