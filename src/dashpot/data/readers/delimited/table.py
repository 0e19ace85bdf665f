"""A delimited text file as named columns of numbers, with the place of everything that is wrong in it."""

from __future__ import annotations

import csv
import difflib
import gzip
import os
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from dashpot import units
from dashpot.arrays import Bools, Real
from dashpot.channel import Channel, Quantity
from dashpot.errors import DashpotError, DataError
from dashpot.io.atomic import write_bytes
from dashpot.io.ledger import noted
from dashpot.io.words import listed, shown
from dashpot.notices import Notice

HEAD = 1 << 20  # bytes in which the header row must end
MOST_COLUMNS = 10_000
LARGEST = 1e100  # beyond this squares overflow, and no measurement is meant
_DELIMITERS = (",", ";", "\t", "|")
_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]$")


@dataclass(frozen=True)
class Table:
    """The text of a file behind its header row.

    source     the path, for messages
    header     names of the columns, as written
    body       bytes after the header row
    first_row  file row on which the body begins, counted from 1
    """

    source: str
    header: tuple[str, ...]
    body: memoryview
    first_row: int
    delimiter: str
    decimal: str
    notes: tuple[Notice, ...]

    def find(self, name: str) -> int | None:
        """Position of a column, by its name or by its name in front of a unit in brackets.

        Raises DataError where there are two.
        """
        for places in self._places:
            at = places.get(name, [])
            if len(at) > 1:
                raise DataError(
                    f"column {shown(name)}: named twice, in columns {at[0] + 1} and {at[1] + 1}",
                    f"{self.source}:{self.first_row - 1}",
                    "rename one of them",
                )
            if at:
                return at[0]
        return None

    @cached_property
    def _places(self) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
        """Where each name stands: as written, and in front of a unit in brackets."""
        written: dict[str, list[int]] = {}
        in_front: dict[str, list[int]] = {}
        for i, column in enumerate(self.header):
            written.setdefault(column, []).append(i)
            in_front.setdefault(bare(column)[0], []).append(i)
        return written, in_front

    def need(self, name: str, why: str = "") -> int:
        """Position of a column.  Raises DataError that names the nearest column where there is none."""
        at = self.find(name)
        if at is not None:
            return at
        lower = {column.lower(): column for column in self.header}
        near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.6)
        known = f"did you mean {shown(lower[near[0]])}?" if near else f"there are {listed(self.header)}"
        raise DataError(f"column {shown(name)}: missing{why}", f"{self.source}:{self.first_row - 1}", known)

    def check_unit(self, column: int, channel: Channel) -> None:
        """Raises DataError where the unit in the header is not the one the rig file gives the channel."""
        unit = bare(self.header[column])[1]
        if unit is None or unit in ("", channel.unit):
            return
        own = _factors(unit, channel.quantity.value)
        place = f"{self.source}:{self.first_row - 1}"
        if any(np.isclose(factor, channel.scale, rtol=1e-9, atol=0) for factor in own):
            return
        if own:
            raise DataError(
                f"column {shown(channel.name)}: in {shown(unit)}, the rig file says {channel.unit or 'SI units'}",
                place,
                f'set unit = "{shown(unit)}" for this channel in the rig file',
            )
        if any(_factors(unit, quantity.value) for quantity in Quantity):
            raise DataError(
                f"column {shown(channel.name)}: {shown(unit)} is no unit of {channel.quantity.value}",
                place,
                "correct the unit in the header, or the quantity in the rig file",
            )

    def numbers(
        self, columns: Sequence[int], optional: Sequence[int] = (), infinite: Sequence[int] = ()
    ) -> dict[int, Real]:
        """The columns as float64.  Empty cells of `optional` ones give NaN; those of `infinite` may be inf.

        Raises DataError at the first row with too few or too many cells, a gap, text, NaN or infinity.
        """
        read = self._parse(columns, pa.float64())
        if read is None:
            raise self._diagnosis(columns, optional, infinite)
        values = {}
        for column, array in zip(columns, read.columns, strict=True):
            numbers = np.array(array.to_numpy(), dtype=float)
            empty: Bools = np.asarray(array.is_null().to_numpy(), dtype=bool)
            wrong = ~np.isfinite(numbers) | (np.abs(np.where(np.isfinite(numbers), numbers, 0)) > LARGEST)
            wrong &= ~empty
            if column in infinite:
                wrong &= numbers != np.inf
            if column not in optional:
                wrong |= empty
            if np.any(wrong):
                raise self._diagnosis(columns, optional, infinite)
            values[column] = numbers
        return values

    def texts(self, column: int) -> list[str]:
        """A column as text."""
        read = self._parse([column], pa.string())
        if read is None:
            raise self._diagnosis([], [], [])
        return [text or "" for text in read.columns[0].to_pylist()]

    def row(self, index: int) -> int:
        """File row of a data row, both for messages: blank rows are skipped when data rows are counted."""
        for i, (row, _) in enumerate(self._rows()):
            if i == index:
                return row
        return self.first_row + index

    def error(self, index: int, column: int, cause: str, cure: str) -> DataError:
        """The DataError at a data row and a column."""
        name = shown(bare(self.header[column])[0])
        return DataError(f"column {name}: {cause}", f"{self.source}:{self.row(index)}", cure)

    def _parse(self, columns: Sequence[int], kind: pa.DataType) -> pa.Table | None:
        """The columns by pyarrow; None where it finds something wrong (it does not say where in a way to rely on)."""
        names = [f"c{i}" for i in range(len(self.header))]
        wanted = [names[i] for i in columns]
        try:
            return pacsv.read_csv(
                pa.BufferReader(pa.py_buffer(self.body)),
                read_options=pacsv.ReadOptions(column_names=names, block_size=8 << 20),
                parse_options=pacsv.ParseOptions(delimiter=self.delimiter),
                convert_options=pacsv.ConvertOptions(
                    column_types=dict.fromkeys(wanted, kind),
                    include_columns=wanted,
                    null_values=[""],
                    strings_can_be_null=True,
                    quoted_strings_can_be_null=True,
                    decimal_point=self.decimal,
                ),
            )
        except (pa.ArrowException, UnicodeDecodeError):
            return None

    def _rows(self) -> Iterator[tuple[int, str]]:
        """(file row, text) of the rows that are not blank."""
        start, row = 0, self.first_row
        body = self.body.obj if isinstance(self.body.obj, bytes) else bytes(self.body)
        start = len(body) - len(self.body)
        while start < len(body):
            end = body.find(b"\n", start)
            end = len(body) if end < 0 else end
            text = body[start:end].decode("utf-8", errors="replace").rstrip("\r")
            if text:
                yield row, text
            start, row = end + 1, row + 1

    def _diagnosis(
        self, columns: Sequence[int], optional: Sequence[int], infinite: Sequence[int]
    ) -> DataError:
        """What is wrong first, found row by row."""
        row = self.first_row
        for row, text in self._rows():
            place = f"{self.source}:{row}"
            try:
                cells = next(csv.reader([text], delimiter=self.delimiter))
            except (csv.Error, StopIteration):
                return DataError("the row cannot be taken apart", place, "look for a stray quote")
            if len(cells) != len(self.header):
                cure = "fill the row or take it out; a short last row means that the file was cut off"
                if self.delimiter == "," and len(cells) > len(self.header):
                    cure = "numbers with decimal commas need a semicolon between columns"
                return DataError(
                    f"the row has {len(cells)} cells, the header {len(self.header)}", place, cure
                )
            for column in columns:
                cause = self._wrong(cells[column].strip(), column in optional, column in infinite)
                if cause is not None:
                    name = shown(bare(self.header[column])[0])
                    return DataError(f"column {name}: {cause[0]}", place, cause[1])
        return DataError(
            "the file cannot be read as a table of numbers", self.source, "save it as plain CSV in UTF-8"
        )

    def _wrong(self, cell: str, optional: bool, infinite: bool) -> tuple[str, str] | None:
        """Cause and cure of a cell that is no number."""
        if not cell:
            return None if optional else ("the cell is empty", "fill the gap, or cut the rows out")
        try:
            value = float(cell.replace(",", ".") if self.decimal == "," else cell)
        except ValueError:
            return f'"{shown(cell)}" is not a number', "correct it, or cut the rows out"
        if "_" in cell:
            return f'"{shown(cell)}" is not a number', "correct it, or cut the rows out"
        if np.isnan(value) or (np.isinf(value) and not (infinite and value > 0)):
            return f'"{shown(cell)}" is not a finite number', "fill the gap, or cut the rows out"
        if np.isfinite(value) and abs(value) > LARGEST:
            return f'"{shown(cell)}" is too large', "correct it, or cut the rows out"
        return None


def _factors(unit: str, quantity: str) -> list[float]:
    """What the unit may mean in SI for the quantity, straight or angular; nothing where it is no such unit."""
    factors = []
    for angular in (False, True):
        try:
            factors.append(units.scale(unit, quantity, angular))
        except DashpotError:
            continue
    return factors


def bare(column: str) -> tuple[str, str | None]:
    """A column's name without the unit in brackets, and the unit."""
    match = _UNIT.match(column)
    return (match["name"], match["unit"].strip()) if match else (column, None)


def open_table(path: str | os.PathLike[str], first_column: str | None = None) -> Table:
    """Read a file, plain or .gz, and its header row: after blank rows, rows that begin with #, and `sep=`.

    Files of instruments say other things first: with `first_column` the header row is the first that begins with it.
    Raises DataError where the file cannot be read, is not text in UTF-8, is empty, or has a header and no rows.
    """
    source = shown(os.fspath(path), 200)
    data = _bytes(path, source)
    if not data.strip():
        raise DataError("the file is empty", source, "give a file with a header row and data")
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise DataError("the file is in UTF-16", source, "save it as UTF-8")
    if b"\0" in data[:HEAD]:
        raise DataError("the file is not text", source, "give a CSV file")
    if b"\n" not in data and b"\r" in data:
        data = data.replace(b"\r", b"\n")
    start, row, delimiter = 3 if data.startswith(b"\xef\xbb\xbf") else 0, 0, None
    while True:
        row += 1
        end = data.find(b"\n", start, start + HEAD)
        if end < 0 and len(data) - start > HEAD:
            raise DataError(
                "the header row is over 1 MB long",
                f"{source}:{row}",
                "give a CSV file with one row per sample",
            )
        end = len(data) if end < 0 else end
        try:
            text = data[start:end].decode("utf-8").strip("\r\n ")
        except UnicodeDecodeError as error:
            raise DataError(
                f"byte {error.start + 1} of the row is not UTF-8", f"{source}:{row}", "save the file as UTF-8"
            ) from None
        start = end + 1
        if text.lower().startswith("sep=") and len(text) == 5:
            delimiter = text[4]
        elif first_column is not None:
            if text.startswith(first_column):
                break
        elif text and not text.startswith("#"):
            break
        if start >= len(data):
            cure = (
                "a header row and data"
                if first_column is None
                else f"a header row that begins with {first_column}"
            )
            raise DataError("the file has no header row", source, f"give a file with {cure}")
    if delimiter is None:
        delimiter = max(_DELIMITERS, key=text.count)
    header = _header(text, delimiter, f"{source}:{row}")
    body = memoryview(data)[start:]
    if not data[start:].strip():
        raise DataError("the file has a header and no rows", f"{source}:{row}", "give a file with data")
    sample = data[start : start + 4096].decode("utf-8", errors="replace")
    decimal = "," if delimiter != "," and "," in sample and "." not in sample else "."
    table = Table(source, header, body, row + 1, delimiter, decimal, ())
    return _check_end(table)


def _bytes(path: str | os.PathLike[str], source: str) -> bytes:
    """Contents of a file, unpacked."""
    if os.path.isdir(path):
        raise DataError("is a directory", source, "give the files in it")
    try:
        data = Path(noted(path)).read_bytes()
        return gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
    except FileNotFoundError:
        raise DataError("there is no such file", source, "correct the path") from None
    except PermissionError:
        raise DataError("the file may not be read", source, "change its permissions") from None
    except (EOFError, gzip.BadGzipFile, zlib.error):
        raise DataError("the packed file is damaged or cut off", source, "pack or copy it again") from None
    except (OSError, ValueError) as error:
        raise DataError(
            f"the file cannot be read ({shown(str(error), 100)})", source, "check the path"
        ) from None


def _header(text: str, delimiter: str, place: str) -> tuple[str, ...]:
    """Names of the columns."""
    if text.count(delimiter) >= MOST_COLUMNS:
        raise DataError(
            f"the header has {text.count(delimiter) + 1} columns",
            place,
            "give a CSV file with one row per sample",
        )
    try:
        names = next(csv.reader([text], delimiter=delimiter))
    except (csv.Error, StopIteration, TypeError):
        raise DataError("the header row cannot be taken apart", place, "look for a stray quote") from None
    if all(_is_number(name) for name in names):
        raise DataError("the file has no header row", place, "name the columns in the first row")
    return tuple(name.strip() for name in names)


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _check_end(table: Table) -> Table:
    """A last row without line end may have been cut off within its last number: refused where that shows."""
    if bytes(table.body[-1:]) == b"\n":
        return table
    tail = bytes(table.body[-(1 << 16) :]).decode("utf-8", errors="replace").splitlines()
    rows = [line for line in tail if line.strip()]
    rows = rows[1:] if len(table.body) > 1 << 16 else rows
    if len(rows) < 2:
        return table
    *before, last = (line.rpartition(table.delimiter)[2].strip() for line in rows[-50:])
    if rows[-1].count(table.delimiter) == len(table.header) - 1 and _looks_cut(last, before):
        raise DataError(
            f'the last number, "{shown(last)}", is shorter than those above and has no line end: the file was cut off',
            f"{table.source}:{table.row(sum(1 for _ in table._rows()) - 1)}",
            "copy it again, or take the last row out",
        )
    text = f"{table.source}: the last row has no line end; if the file was cut off, its last number is wrong"
    return replace(table, notes=(*table.notes, Notice("no_line_end", text, (table.source,))))


def _looks_cut(last: str, before: list[str]) -> bool:
    """Shorter than numbers of one width, or by four digits than any; or without the exponent of the others."""
    shortest = min(len(cell) for cell in before)
    alike = len(before) >= 3 and all(len(cell) == shortest for cell in before)
    if len(last) < shortest - (0 if alike else 3):
        return True
    powers = [re.search(r"[eE][+-]?(\d*)$", cell) for cell in before]
    power = re.search(r"[eE][+-]?(\d*)$", last)
    digits = [len(match[1]) for match in powers if match]
    if digits and power and len(power[1]) < min(digits):
        return True
    if len(digits) == len(before) >= 3 and not power:
        return True
    return last.endswith((".", ",")) and not any(cell.endswith((".", ",")) for cell in before)


def write_rows(
    path: str | os.PathLike[str], header: Sequence[str], columns: Sequence[Sequence[object] | Real]
) -> None:
    """Write a comma-separated file, numbers with all their digits, packed where the name ends in .gz.

    The file appears whole or not at all.  Raises DataError where it cannot be written.
    """
    arrays = [
        pa.array(np.asarray(c)) if isinstance(c, np.ndarray) else pa.array(c, pa.string()) for c in columns
    ]
    names = [f"c{i}" for i in range(len(arrays))]
    sink = pa.BufferOutputStream()
    pacsv.write_csv(
        pa.table(arrays, names=names), sink, pacsv.WriteOptions(include_header=False, quoting_style="none")
    )
    head = (",".join(_quoted(name) for name in header) + "\n").encode()
    parts = (head, memoryview(sink.getvalue()))
    write_bytes(path, _packed(parts) if Path(path).suffix == ".gz" else parts)


def _packed(parts: Iterable[bytes | memoryview]) -> Iterator[bytes]:
    """Packed as gzip, without name and time, so that the same data give the same bytes."""
    packer = zlib.compressobj(9, wbits=31)
    for part in parts:
        yield packer.compress(part)
    yield packer.flush()


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(c in name for c in ',"\n\r') else name
