"""Universal files: datasets 58 (functions at nodes) and 55 (modes), and their functions as parts of records."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, BinaryIO

import numpy as np

from dashpot.arrays import Complex, Frozen, Real, freeze, frozen
from dashpot.channel import Channel
from dashpot.data.modal_data import ModalData, independent_modes, named_points
from dashpot.data.readers.arrays import LONG, PIECE, ArrayColumns, Streamed, array_columns, steps
from dashpot.data.readers.columns import FREQUENCY, TIME
from dashpot.data.readers.datafile import DataFile
from dashpot.errors import DataError
from dashpot.io.words import listed, shown
from dashpot.notices import Notice

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
        text = self.line_or_end()
        if text is None:
            raise self.cut_off()
        return text

    def line_or_end(self) -> bytes | None:
        """The next line, None at the end of the file."""
        text = self._stream.readline(LONGEST_LINE)
        self.number += bool(text)
        return text.rstrip(b"\r\n") if text else None

    def block(self, size: int) -> bytes:
        """So many bytes.  Raises DataError if there are fewer."""
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

    Raises DataError if something else stands between datasets.
    """
    while (text := stream.line_or_end()) is not None:
        if not text.strip():
            continue
        if text.strip() != MARK:
            raise stream.wrong("a dataset should begin here, with -1")
        head = stream.line()
        number = head[:6].strip()
        if not number.isdigit():
            raise stream.wrong("the number of a dataset is expected here")
        yield DatasetStart(int(number), head[6:7].lower() == b"b", head[7:])


def skip_dataset(stream: UffStream) -> None:
    """Read on to the end of the dataset."""
    while stream.line().strip() != MARK:
        pass


def expect_end(stream: UffStream) -> None:
    """The end of the dataset.  Raises DataError if something else follows."""
    text = stream.line()
    if not text.strip():
        text = stream.line()
    if text.strip() != MARK:
        raise stream.wrong("the dataset should end here, with -1, but contains more than its header says")


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
        # Kind of the function, response and reference
        line = lines[5]
        kind = int(line[0:5])
        response = NodePoint(_words(line, 30, 41), int(line[41:51]), int(line[51:55]))
        reference = NodePoint(_words(line, 55, 66), int(line[66:76] or b"0"), int(line[76:80] or b"0"))
        line = lines[6]
        data_type, count, spacing = int(line[0:10]), int(line[10:20]), int(line[20:30])
        if data_type not in (2, 4, 5, 6):
            raise ValueError
        begin, step = float(line[30:43] or b"0"), float(line[43:56] or b"0")
        words = ids[4].split()
        if words[:1] == [EXACT] and len(words) == 3:
            begin, step = float(words[1]), float(words[2])
        shape = _Shape(data_type in (4, 6), data_type in (5, 6), spacing == 1, count, begin, step)
        kinds = [int(line[:10]) for line in lines[7:]]
        z_value = float(lines[6][56:69] or b"0")
    except (ValueError, IndexError):
        raise stream.wrong("the header of a function is damaged") from None
    if not 0 <= shape.count <= 1 << 40:
        raise stream.wrong(f"{shape.count} values are impossible")
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
        _text_of(lines[8]),
        _text_of(lines[9]),
        ids,
        shape.even,
        kinds[3],
        z_value,
        long,
    )


def _words(line: bytes, start: int, end: int) -> str:
    text = line[start:end].decode("utf-8", errors="replace").strip()
    return "" if text == "NONE" else text


def _text_of(line: bytes) -> str:
    """The units label of an axis."""
    return _words(line, 46, 67)


def _require_finite(abscissa: Real, place: str) -> None:
    """Raises DataError if the abscissa is not finite."""
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
        # Numbers of a line by the blanks between them, by columns where some touch each other
        line = stream.line()
        fields = line.split()
        touching = not fields or len(fields) > at_most or any(field.count(b".") != 1 for field in fields)
        if touching:
            starts = range(0, len(line.rstrip()), ends[-1])
            places = (
                line[start + a : start + b].strip() for start in starts for a, b in itertools.pairwise(ends)
            )
            fields = [place for place in places if place]
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
                raise stream.wrong("one of the values is not a number") from None
            yield (None, table) if shape.even else (table[:, 0], table[:, 1:])
            del cells[:whole]
    expect_end(stream)


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
        raise stream.wrong("invalid header in dataset 58b")
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


NORMAL, FIRST_ORDER, SECOND_ORDER = 2, 3, 7  # analysis types
REAL, COMPLEX = 2, 5  # data types


@dataclass(frozen=True)
class NodalMode(Frozen):
    """One mode: eigenvalue in rad/s, nodes, and shapes (nodes, 3) or (nodes, 6): X, Y, Z (and rotations)."""

    eigenvalue: complex
    nodes: tuple[int, ...]
    shapes: Complex
    ids: tuple[str, ...] = ()

    @property
    def frequency_hz(self) -> float:
        """Undamped natural frequency."""
        return abs(self.eigenvalue) / (2 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """Share of critical damping."""
        return -self.eigenvalue.real / abs(self.eigenvalue) if self.eigenvalue else 0.0


def modes_of(file: DataFile) -> Iterator[NodalMode]:
    """All modes of a universal file; other datasets are passed over.

    Raises DataError, with the line, for what is damaged or cut off.
    """
    with file.reading() as raw:
        stream = UffStream(raw, file)
        for start in dataset_starts(stream):
            mode = _mode(stream, start) if start.number == 55 else None
            if start.number != 55:
                skip_dataset(stream)
            if mode is not None:
                yield mode


def _mode(stream: UffStream, start: DatasetStart) -> NodalMode | None:
    """A mode; None if the dataset holds something else."""
    ids = tuple(stream.line().decode("utf-8", errors="replace").strip() for _ in range(5))
    try:
        _, analysis, _, _, data_type, per_node = (int(field) for field in _cut(stream.line(), 10)[:6])
    except ValueError:
        raise stream.wrong("the header of data at nodes is damaged") from None
    if analysis not in (NORMAL, FIRST_ORDER, SECOND_ORDER) or data_type not in (REAL, COMPLEX):
        skip_dataset(stream)
        return None
    stream.line()
    # The eigenvalue in rad/s; of a normal mode from its frequency in Hz and its damping ratio
    values = _numbers(stream, stream.line())
    if len(values) < 2:
        raise stream.wrong("the eigenvalue is missing")
    if analysis != NORMAL:
        eigenvalue = complex(values[0], values[1])
    else:
        damping = values[2] if len(values) > 2 else 0.0
        omega = 2 * np.pi * values[0]
        eigenvalue = complex(-damping * omega, omega * np.sqrt(max(0.0, 1 - damping**2)))
    # Nodes and the numbers at each, (nodes, size), to the end of the dataset
    size = per_node * (2 if data_type == COMPLEX else 1)
    nodes, rows = [], []
    while (line := stream.line()).strip() != MARK:
        try:
            nodes.append(int(line[:10]))
        except ValueError:
            raise stream.wrong("the number of a node is expected here") from None
        numbers: list[float] = []
        while len(numbers) < size:
            more = _numbers(stream, stream.line())
            if not more:
                raise stream.wrong(f"{size} numbers are expected here")
            numbers += more
        if len(numbers) != size:
            raise stream.wrong(f"{size} numbers are expected here, not {len(numbers)}")
        rows.append(numbers)
    table = np.array(rows, dtype=float).reshape(len(nodes), size)
    shape = table[:, 0::2] + 1j * table[:, 1::2] if data_type == COMPLEX else table.astype(complex)
    return NodalMode(eigenvalue, tuple(nodes), shape, tuple("" if i == "NONE" else i for i in ids))


def _cut(line: bytes, width: int) -> list[bytes]:
    return [line[i : i + width] for i in range(0, len(line.rstrip()), width)]


def _numbers(stream: UffStream, line: bytes) -> list[float]:
    """Numbers in 13 columns each."""
    try:
        return [float(field.replace(b"D", b"E")) for field in _cut(line, 13) if field.strip()]
    except ValueError:
        raise stream.wrong("one of the values is not a number") from None


# Modes of universal files (dataset 55) as modal data of a rig's coordinates.


USUAL_SD = 0.01, 0.2, 0.05  # relative: of frequencies, damping ratios, shapes against their largest entry
Place = tuple[int, int]  # node, direction from 1 (+X) on


def assumed_sd(
    relative_sd: tuple[float, float, float], missing: Sequence[bool] = (True, True, True)
) -> Notice:
    """The notice that a file states no standard deviations of frequencies, damping ratios, shapes: those `missing`."""
    of = ("frequencies", "damping ratios", "a shape's largest entry")
    shares = [
        f"{100 * sd:g} % of {what}" for what, sd, lacks in zip(of, relative_sd, missing, strict=True) if lacks
    ]
    return Notice("modes_without_sd", f"the file has no standard deviations: assumed are {', '.join(shares)}")


def read_uff_modes(
    file: DataFile,
    coordinates: Sequence[str],
    channels: Iterable[Channel],
    relative_sd: tuple[float, float, float],
) -> tuple[ModalData, list[Notice]]:
    """Modes with shapes at those coordinates that have a node, and what was assumed.

    A node and its direction belong to a coordinate by its name (3+Z, or 3), by that of a channel that shows this
    coordinate alone, or by the list that dashpot writes; where none fits and there are as many as coordinates, in
    their order.  The file has no standard deviations: `relative_sd` gives them.  Raises DataError.
    """
    measured = [mode for mode in modes_of(file) if mode.eigenvalue.imag > 0]
    if not measured:
        raise DataError("the file has no oscillating mode", file.name, "export datasets 55 of modes")
    notes = [assumed_sd(relative_sd)]
    # Nodes and directions that move in some mode, in order
    moved: set[Place] = set()
    for mode in measured:
        size = np.abs(mode.shapes)
        moving = size > 1e-9 * np.max(size, initial=0.0)  # else the direction was not measured
        moved.update((mode.nodes[row], column + 1) for row, column in np.argwhere(moving).tolist())
    places = sorted(moved)
    matched = _matched(measured, places, coordinates, channels)
    if not matched:
        if len(places) != len(coordinates):
            raise DataError(
                f"no node is a coordinate of the rig: the nodes are {listed(NodePoint('', *at).name for at in places)}",
                file.name,
                'list channels of these names in the rig file, such as "3+Z" = { of = "x1" }',
            )
        matched = {name: (place, 1.0) for name, place in zip(coordinates, places, strict=True)}
        pairs = ", ".join(f"{NodePoint('', *at).name} = {shown(name)}" for name, (at, _) in matched.items())
        text = f"nodes are taken for coordinates in their order: {pairs}"
        notes.append(Notice("modes_in_order", text, tuple(coordinates)))
    points = tuple(name for name in coordinates if name in matched)
    shapes: Complex = np.full((len(measured), len(points)), np.nan + 0j)
    for k, mode in enumerate(measured):
        for c, name in enumerate(points):
            (node, direction), factor = matched[name]
            if node in mode.nodes and direction <= mode.shapes.shape[1]:
                shapes[k, c] = mode.shapes[mode.nodes.index(node), direction - 1] / factor
    frequency = np.array([mode.frequency_hz for mode in measured])
    damping = np.array([mode.damping_ratio or np.nan for mode in measured])
    largest = np.max(np.abs(np.nan_to_num(shapes)), axis=1, initial=0.0)
    spread = relative_sd[2] * np.broadcast_to(largest[:, None], shapes.shape)
    of_frequency, of_damping = (frequency, relative_sd[0] * frequency), (damping, relative_sd[1] * damping)
    return independent_modes(points, of_frequency, of_damping, (shapes, spread)), notes


def _matched(
    modes: Sequence[NodalMode],
    places: Sequence[Place],
    coordinates: Sequence[str],
    channels: Iterable[Channel],
) -> dict[str, tuple[Place, float]]:
    """Place and factor of each coordinate that has one by its names.

    A coordinate goes by its own name and by those of channels that show it alone; a place by node and direction and,
    where the node moves in one direction, by the node alone and the name that the file lists for it.
    """
    names = named_points(coordinates, channels)
    pairs = (re.findall(r"(\d+) = ([^,]+)", text) for mode in modes for text in mode.ids[2:])
    listed_names = dict(pair for each in pairs for pair in each)
    nodes = [node for node, _ in places]
    matched: dict[str, tuple[Place, float]] = {}
    for place in places:
        node, texts = str(place[0]), [NodePoint("", *place).name]
        if nodes.count(place[0]) == 1:
            texts += [node, listed_names.get(node, "").strip()]
        for text in texts:
            if text in names:
                point, factor = names[text]
                matched.setdefault(point, (place, factor))
    return matched


KINDS = (TIME_RESPONSE, FRF, TRANSMISSIBILITY, SPECTRUM)


def is_universal(file: DataFile) -> bool:
    """The first lines are the mark of a dataset and its number."""
    lines = file.head[:1000].split(b"\n", 3)
    lines = [line for line in lines if line.strip()]
    if len(lines) < 2 or lines[0].strip() != MARK or not lines[0].startswith(b"  "):
        return False
    return lines[1][:6].strip().isdigit()


def read_universal(file: DataFile) -> Iterator[ArrayColumns]:
    """Samples over time, spectra and frequency responses.

    A column has the name of ID line 1 where that differs among the functions, else of the entity, else its node and
    direction, such as 3+Z; FRFs are OUT/IN.  The third axis, where it is a frequency, is the drive frequency.
    Raises DataError, with the line, for what is damaged or cut off.
    """
    count = 0
    held: list[NodalFunction] = []
    others: set[int] = set()
    for function in functions_of(file, others):
        if function.kind not in KINDS:
            continue
        if held and not _together(held, function):
            count += 1
            yield _part(file.name, count, held)
            held = []
        held.append(function)
    if held:
        yield _part(file.name, count + 1, held)
    elif not count:
        cure = "export samples over time, spectra or frequency responses (dataset 58)"
        what = "the file holds no samples, spectra or frequency responses"
        if 55 in others:
            what, cure = (
                f"{what}, but modes (dataset 55)",
                "identify a rig with these coordinates from them",
            )
        raise DataError(what, file.name, cure)


def functions_of(file: DataFile, others: set[int] | None = None) -> Iterator[NodalFunction]:
    """All functions of a universal file (datasets 58 and 58b); the numbers of other datasets go to `others`.

    Raises DataError if the file is damaged or cut off.
    """
    with file.reading() as raw:
        stream = UffStream(raw, file)
        before: NodalFunction | None = None
        for start in dataset_starts(stream):
            if start.number == 58:
                function = read_function(stream, start)
                if before is not None and function.beside(before):
                    function = replace(function, abscissa=before.abscissa)  # shared, not held twice
                before = function
                yield function
            else:
                skip_dataset(stream)
                if others is not None:
                    others.add(start.number)


def _together(held: Sequence[NodalFunction], function: NodalFunction) -> bool:
    """Whether a function belongs to those before it: the same kind and abscissa, and another measurement."""
    first = held[0]
    return (
        (first.kind == TIME_RESPONSE) == (function.kind == TIME_RESPONSE)
        and (first.z_kind, first.z_value) == (function.z_kind, function.z_value)
        and _measured(function) not in [_measured(other) for other in held]
        and function.beside(first)
    )


def _measured(function: NodalFunction) -> tuple[NodePoint, NodePoint, tuple[str, ...]]:
    return function.response, function.reference, function.ids[:1]


def _part(source: str, number: int, functions: Sequence[NodalFunction]) -> ArrayColumns:
    """Functions over one abscissa as columns."""
    place = source if number == 1 else f"{source} (part {number})"
    first = functions[0]
    columns: dict[str, Any] = {FREQUENCY: first.abscissa}
    units: dict[str, str | None] = {}
    if first.kind == TIME_RESPONSE:
        columns = {TIME: first.abscissa if first.long is None else first.long.time}
        if first.z_kind == OF_FREQUENCY and first.z_value > 0:
            columns[FREQUENCY] = steps(first.z_value, 0.0, len(columns[TIME]))
    # ID line 1 where it tells the functions apart, else the response; of FRFs OUT/IN
    responses = _names([f.response for f in functions])
    references = _names([f.reference for f in functions])
    titles = [f.ids[0] if f.ids else "" for f in functions]
    titled = len(set(titles)) == len(titles) and all(titles)
    names = []
    for each, response, reference, title in zip(functions, responses, references, titles, strict=True):
        label = title if titled else response
        if each.kind in (FRF, TRANSMISSIBILITY):
            label = title if titled and title.count("/") == 1 else f"{response}/{reference}"
        names.append(label)
    for function, name in zip(functions, names, strict=True):
        values: dict[str, Any] = {name: function.ordinate if function.long is None else function.long.values}
        if function.kind != TIME_RESPONSE:
            values = {f"{name}_re": function.ordinate.real, f"{name}_im": np.imag(function.ordinate)}
        for column, numbers in values.items():
            if column in columns:
                raise DataError(f"{column} appears twice", place, "give each function a point of its own")
            columns[column] = numbers
            units[column] = function.unit or None
            if function.unit and function.reference_unit and function.kind in (FRF, TRANSMISSIBILITY):
                units[column] = f"({function.unit})/{function.reference_unit}"
    return array_columns(place, columns, units)


def _names(points: Sequence[NodePoint]) -> list[str]:
    """Names of points: the entities where they tell the points apart, else nodes and directions."""
    entities = {point.entity for point in points}
    if "" not in entities and len(entities) == len(set(points)):
        return [point.entity for point in points]
    return [point.name for point in points]
