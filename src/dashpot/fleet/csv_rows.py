"""Rows of CSV tables of many rigs, read as they come, and the line of what is wrong with them."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from dashpot.errors import DataError
from dashpot.io.ledger import noted
from dashpot.io.words import counted, listed, shown

_DELIMITERS = ";", "\t", ","  # in the order in which a header that has several is taken apart


@dataclass(frozen=True)
class CsvLayout:
    """How a table is written: delimiter, decimal mark, and the columns that are to be read as texts.

    texts  beside the one that names rigs, which always is: 007 is a name
    """

    path: str
    column: str
    delimiter: str
    decimal: str
    header: tuple[str, ...]
    texts: frozenset[str] = field(default=frozenset())

    def batches(self) -> Iterator[Any]:
        """The rows, some at a time.  Raises DataError where they cannot be taken apart, with the line."""
        import pyarrow as pa
        import pyarrow.csv as text

        numbers = dict.fromkeys(set(self.header) - self.texts - {self.column}, pa.float64())
        kinds = {**numbers, **dict.fromkeys(self.texts | {self.column}, pa.string())}
        # Kinds are stated, for pyarrow would hold a column for whole numbers that begins with some.
        converted = text.ConvertOptions(column_types=kinds, decimal_point=self.decimal)
        parsed = text.ParseOptions(delimiter=self.delimiter)
        try:
            with text.open_csv(noted(self.path), convert_options=converted, parse_options=parsed) as reader:
                yield from reader
        except pa.ArrowInvalid as error:
            raise self._fault(str(error)) from None

    def _fault(self, said: str) -> Exception:
        """What is wrong first, found row by row; a column that holds more than numbers is told as such."""
        column = re.match(r"In CSV column #(\d+):.*CSV conversion error", said)
        if column is not None and self.header[int(column[1])] not in self.texts:
            return NotNumbersError(self.header[int(column[1])])
        line, cells = 1, len(self.header)
        try:
            with open(noted(self.path), encoding="utf-8", errors="replace", newline="") as file:
                reader = csv.reader(file, delimiter=self.delimiter)
                for row in reader:
                    if row and len(row) != cells:
                        what = f"the row has {counted(len(row), 'cell')}, the header {cells}"
                        cure = "fill the row or take it out"
                        if reader.line_num > line:
                            what, cure = "a quote is not closed on its line", "close it, or take it out"
                        return DataError(what, f"{self.path}:{line}", cure)
                    line = reader.line_num + 1
        except csv.Error:
            return DataError("the row cannot be taken apart", f"{self.path}:{line}", "look for a stray quote")
        return DataError(f"the table cannot be read ({shown(said, 150)})", self.path, "check the file")


class NotNumbersError(Exception):
    """A column holds more than numbers: its name."""


def csv_layout(path: str, column: str) -> CsvLayout:
    """How a table is written, from its header and the row below.  Raises DataError where there is none."""
    with open(noted(path), encoding="utf-8-sig", errors="replace", newline="") as file:
        header, below = file.readline(), file.readline()
    if not header.strip():
        raise DataError("the table begins with an empty line", path, "begin with the names of the columns")
    delimiter = next((mark for mark in _DELIMITERS if mark in header), ",")
    names = tuple(next(csv.reader([header], delimiter=delimiter)))
    require_columns(path, column, names)
    if not below.strip():
        raise DataError("the table has no rows", path, "give the data of at least one rig")
    cells = below.split(delimiter)
    comma = delimiter != "," and any(
        re.fullmatch(r"\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*", cell) for cell in cells
    )
    return CsvLayout(path, column, delimiter, "," if comma else ".", names)


def require_columns(path: str, column: str, names: tuple[str, ...]) -> None:
    """Raises DataError where the column that names rigs is missing, or one is named twice."""
    if column not in names:
        what = f"column {shown(column)}: missing (it is to name the rig)"
        raise DataError(what, path, f"there are {listed(names)}")
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        raise DataError(f"column {shown(twice)}: named twice", path, "rename one of them")
