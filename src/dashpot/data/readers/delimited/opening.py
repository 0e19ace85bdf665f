"""Where the columns of a text file begin: encoding, delimiter, header row, row of units."""

from __future__ import annotations

import csv
import itertools
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from dashpot.data.readers.columns import MOST_COLUMNS, is_unit
from dashpot.data.readers.datafile import SUBSTITUTED, DataFile, open_file, whole_lines
from dashpot.data.readers.delimited.encoding import Text, as_utf8, rewritten_as_utf8
from dashpot.data.readers.delimited.stray_rows import StrayRows
from dashpot.data.readers.delimited.table import Table
from dashpot.data.readers.delimited.timestamps import is_date, is_timestamp
from dashpot.data.readers.delimited.truncation import with_checked_end
from dashpot.errors import DataError
from dashpot.notices import Notice

HEAD = 1 << 20  # bytes in which the header row must end
MOST_LEADING = 400  # rows in front of the data that are looked through
_DELIMITERS = (",", ";", "\t", "|")
_BLANKS = " "  # as a delimiter: any number of blanks and tabs


@dataclass(frozen=True)
class _Row:
    """A row that is not blank: its number in the file, where the next one begins, its text."""

    number: int
    end: int
    text: str


def open_table(path: str | os.PathLike[str] | DataFile, first_column: str | None = None) -> Table:
    """Read a file, plain or .gz, and its header row: after blank rows, rows that begin with #, `sep=`, and others.

    The header row is the one in front of the numbers, or in front of a row of units.  With `first_column` it is the
    first row that begins with it.
    Raises DataError where the file cannot be read, is not text, is empty, or has a header and no rows.
    """
    file = path if isinstance(path, DataFile) else open_file(path)
    if isinstance(file.contents, bytes):
        return table_of(file.contents, file.name, first_column)
    file = rewritten_as_utf8(file, file.contents)
    header = _header(file.contents, file.name, first_column)
    stray = _stray_rows(file.contents, header, first_column)
    if stray is not None and stray.among(file.contents):
        file = stray.rewritten(file, file.contents)
    if header.delimiter == _BLANKS:
        above = (b"\n" * (header.row.number - 1), _tabbed_row(header.row))
        file = file.rewritten(itertools.chain(above, _tabbed(file.contents, header.row.end)))
    table = table_of(file.contents, file.name, first_column)
    left_out = () if stray is None else stray.note(file.name)
    return replace(table, file=file, notes=(*table.notes, *left_out))


@dataclass(frozen=True)
class _Header:
    """The header row of a table, and what parts its cells."""

    row: _Row
    delimiter: str


def _header(data: Text, source: str, first_column: str | None) -> _Header:
    rows, commented, delimiter = _leading_rows(data, source, first_column)
    header_at = len(rows) - 1
    if first_column is None:
        if commented is not None and _is_heading(commented, rows[0], delimiter):
            rows, header_at = [commented], 0
        else:
            rows, header_at = _with_header(data, rows, delimiter)
    row = rows[header_at]
    return _Header(row, _delimiter(row.text) if delimiter is None else delimiter)


def table_of(data: Text, source: str, first_column: str | None = None) -> Table:
    """The table in the bytes of a file; as `open_table`.  Raises DataError where there is no table."""
    data = as_utf8(data, source) if isinstance(data, bytes) else data
    header = _header(data, source, first_column)
    row, delimiter = header.row, header.delimiter
    place = f"{source}:{row.number}"
    stray = _stray_rows(data, header, first_column)
    if stray is not None and isinstance(data, bytes) and stray.among(data):
        data = stray.blanked(data)
    if delimiter == _BLANKS:
        data = b"".join((data[: row.end], *_tabbed(data, row.end)))
        row = _Row(row.number, row.end, _tabbed_row(row).decode().rstrip("\n"))
        delimiter = "\t"
    names = _names(row.text, delimiter, place)
    units: tuple[str | None, ...] = ()
    start, first_row = row.end, row.number + 1
    if first_column is None:
        start, first_row, units = _behind_units(data, row, delimiter, len(names))
    first_data = _next_row(data, start, first_row - 1)
    if first_data is None:
        raise DataError("the file has a header and no rows", place, "give a file with data")
    names, units = _of_width(names, units, _cells(first_data.text, delimiter))
    decimal, notes = _decimal(data[start : start + 4096].decode("utf-8", errors="replace"), delimiter, source)
    notes = notes if stray is None else (*notes, *stray.note(source))
    body = memoryview(data)[start:]
    return with_checked_end(Table(source, names, units, notes, body, first_row, delimiter, decimal))


def _stray_rows(data: Text, header: _Header, first_column: str | None) -> StrayRows | None:
    """What may stand between the rows, where nothing fixed says how the file looks."""
    if first_column is not None:
        return None
    row = header.row
    start, _, _ = _behind_units(data, row, header.delimiter, len(_cells(row.text, header.delimiter)))
    return StrayRows(data[:start])


def _of_width(
    names: tuple[str, ...], units: tuple[str | None, ...], cells: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str | None, ...]]:
    """Names and units where a delimiter ends the header alone, or the rows alone."""
    if len(cells) == len(names) - 1 and not names[-1]:
        return names[:-1], units[: len(cells)]
    if len(cells) == len(names) + 1 and not cells[-1]:
        return (*names, ""), (*units, None) if units else ()
    return names, units


def _is_heading(commented: _Row, below: _Row, delimiter: str | None) -> bool:
    """Whether a row that begins with # names the columns of the row of numbers below it."""
    mark = _delimiter(below.text) if delimiter is None else delimiter
    names, cells = _cells(commented.text, mark), _cells(below.text, mark)
    return (
        len(names) == len(cells) and _is_data(cells) and all(name and not _is_number(name) for name in names)
    )


def _behind_units(
    data: Text, header: _Row, delimiter: str, columns: int
) -> tuple[int, int, tuple[str | None, ...]]:
    """Where the rows begin behind the header, and behind a row of units where there is one; the units."""
    following = _next_row(data, header.end, header.number)
    if following is not None:
        cells = _cells(following.text, delimiter)
        if len(cells) == columns and _is_unit_row(cells):
            return following.end, following.number + 1, tuple(_unit(cell) for cell in cells)
    return header.end, header.number + 1, ()


def _decimal(sample: str, delimiter: str, source: str) -> tuple[str, tuple[Notice, ...]]:
    """The decimal mark, and a note where a comma may be meant to part thousands."""
    if delimiter == "," or "," not in sample:
        return ".", ()
    cells = [cell for line in sample.splitlines() for cell in _cells(line, delimiter)]
    numbers = [cell for cell in cells if _is_number(cell)]
    if any("." in cell for cell in numbers) or not any("," in cell for cell in numbers):
        return ".", ()
    return ",", (_thousands_note(source),) if _may_be_thousands(sample, delimiter) else ()


def _may_be_thousands(sample: str, delimiter: str) -> bool:
    """Whether each comma could part thousands: three digits behind it, one to three and no zero alone before it."""
    cells = [cell.strip().strip('"') for line in sample.splitlines() for cell in line.split(delimiter)]
    return all(re.fullmatch(r"[-+]?[1-9]\d{0,2}(,\d{3})+", cell) for cell in cells if "," in cell)


def _thousands_note(source: str) -> Notice:
    text = f"{source}: commas are read as decimal points, 1,000 as 1.000; write numbers without thousands separators"
    return Notice("decimal_comma", text, (source,))


def _leading_rows(
    data: Text, source: str, first_column: str | None
) -> tuple[list[_Row], _Row | None, str | None]:
    """The first row that may be the header, the row before it that begins with #, the delimiter of `sep=`."""
    position, number, delimiter = 0, 0, None
    commented: _Row | None = None
    while True:
        number += 1
        end = data.find(b"\n", position, position + HEAD)
        if end < 0 and len(data) - position > HEAD:
            cure = "give a CSV file with one row per sample"
            raise DataError("the header row is over 1 MB long", f"{source}:{number}", cure)
        end = len(data) if end < 0 else end
        try:
            text = data[position:end].decode("utf-8").removeprefix("\ufeff").strip("\r\n ")
        except UnicodeDecodeError as error:
            what = f"byte {error.start + 1} of the row is not UTF-8"
            raise DataError(what, f"{source}:{number}", "save the file as UTF-8") from None
        position = min(end + 1, len(data))
        if text.lower().startswith("sep=") and len(text) == 5:
            delimiter = text[4]
        elif text.startswith(first_column) if first_column else text and not text.startswith("#"):
            return [_Row(number, position, text)], commented, delimiter
        elif text.startswith("#"):
            commented = _Row(number, position, text.lstrip("# \t"))
        if position >= len(data):
            begins = "" if first_column is None else f" that begins with {first_column}"
            cure = f"give a file with a header row{begins} and data"
            raise DataError("the file has no header row", source, cure)


def _next_row(data: Text, position: int, number: int) -> _Row | None:
    """The next row that is not blank, behind row `number` that ends at `position`."""
    while position < len(data):
        end = data.find(b"\n", position, position + HEAD)
        end = min(len(data), position + HEAD) if end < 0 else end
        text = data[position:end].decode("utf-8", errors="replace").strip("\r\n ")
        position, number = min(end + 1, len(data)), number + 1
        if text:
            return _Row(number, position, text)
    return None


def _with_header(data: Text, rows: list[_Row], delimiter: str | None) -> tuple[list[_Row], int]:
    """Rows from the first candidate on, and which of them is the header row.

    The first candidate is, where numbers or units follow it.  Otherwise the last row of text in front of two rows of
    numbers of the same width, or in front of a row of units there; where there is none, the first candidate.
    """
    rows = list(rows)
    while len(rows) < MOST_LEADING:
        following = _next_row(data, rows[-1].end, rows[-1].number)
        if following is None:
            break
        rows.append(following)
        if len(rows) == 2 and _follow_at_once(rows, delimiter):
            break
        if len(rows) < 3:
            continue
        header = _header_in_front(rows, delimiter)
        if header is not None:
            return rows, header
    return rows, 0


def _follow_at_once(rows: Sequence[_Row], delimiter: str | None) -> bool:
    """Whether numbers follow the first candidate, one for each name."""
    mark = _delimiter(rows[0].text) if delimiter is None else delimiter
    names, cells = (_cells(row.text, mark) for row in rows)
    return (
        abs(len(names) - len(cells)) <= 1 and _is_data(cells) and not any(_is_number(name) for name in names)
    )


def _header_in_front(rows: Sequence[_Row], delimiter: str | None) -> int | None:
    """The header row, where the last two rows are the first ones of numbers; None where they are not."""
    mark = _delimiter(rows[-1].text) if delimiter is None else delimiter
    *_, first, second = (_cells(row.text, mark) for row in rows[-3:])
    if len(first) != len(second) or not (_is_data(first) and _is_data(second)):
        return None
    for at in (len(rows) - 3, len(rows) - 4):
        if at < 0:
            return None
        cells = _cells(rows[at].text, mark)
        if abs(len(cells) - len(first)) > 1 or any(_is_number(cell) for cell in cells):
            return None
        if not _is_unit_row(cells):
            return at
    return None


def _delimiter(text: str) -> str:
    """The delimiter of a row."""
    most = max(_DELIMITERS, key=text.count)
    if text.count(most) == 0 and len(text.split()) > 1:
        return _BLANKS
    if most == "," and text.count(";") > 0:  # decimal commas
        return ";"
    return most


def _cells(text: str, delimiter: str) -> list[str]:
    if delimiter == _BLANKS:
        return text.split()
    try:
        return [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter))]
    except (csv.Error, StopIteration, TypeError):
        return []


def _is_data(cells: Sequence[str]) -> bool:
    """Numbers, moments and gaps alone, and a number among them."""
    numbers = [_is_number(cell) for cell in cells]
    return any(numbers) and all(
        number or not cell or is_timestamp(cell) or is_date(cell)
        for cell, number in zip(cells, numbers, strict=True)
    )


def _is_unit_row(cells: Sequence[str]) -> bool:
    """Units and gaps alone, two units at least or one where there is one column."""
    named = [cell for cell in cells if cell not in ("", "-", "[-]", "[]")]
    return bool(named) and all(is_unit(_unit(cell) or "") for cell in named)


def _unit(cell: str) -> str | None:
    """The unit in a cell of a row of units."""
    text = re.sub(r"^[\[(](.*)[\])]$", r"\1", cell).strip()
    return None if text in ("", "-") else text


def _tabbed_row(row: _Row) -> bytes:
    return "\t".join(row.text.split()).encode() + b"\n"


def _tabbed(data: Text, start: int) -> Iterator[bytes]:
    """What follows, in pieces, with cells apart by one tab instead of blanks."""
    for lines in whole_lines(data, start, most=SUBSTITUTED):
        yield re.sub(rb"(?m)^\t|\t(?=\r?$)", b"", re.sub(rb"[ \t]+", b"\t", lines))


def _names(text: str, delimiter: str, place: str) -> tuple[str, ...]:
    """Names of the columns."""
    if text.count(delimiter) >= MOST_COLUMNS:
        what = f"the header has {text.count(delimiter) + 1} columns"
        raise DataError(what, place, "give a CSV file with one row per sample")
    try:
        names = next(csv.reader([text], delimiter=delimiter))
    except (csv.Error, StopIteration, TypeError):
        raise DataError("the header row cannot be taken apart", place, "look for a stray quote") from None
    if all(_is_number(name) for name in names):
        raise DataError("the file has no header row", place, "name the columns in the first row")
    names[0] = names[0].lstrip("%")
    return tuple(name.strip() for name in names)


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
