"""Delimited text of any shape."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.delimited.encoding import is_text
from dashpot.data.readers.delimited.opening import open_table
from dashpot.data.readers.delimited.table import Table
from dashpot.errors import DataError

_JSON = re.compile(rb'\s*\{\s*["}]')


@dataclass(frozen=True)
class TextReader:
    """A header row and columns of numbers, by comma, semicolon, tab, bar or blanks."""

    format: str = "text"
    extra: str | None = None

    def sniff(self, file: DataFile) -> bool:
        """No byte is zero but at the end, or the text is in UTF-16."""
        return is_text(file.head)

    def parts(self, file: DataFile) -> Iterator[Table]:
        """The table.  Raises DataError where the text is none, but JSON."""
        if _JSON.match(file.head):
            cure = "name a data file; an estimate is what validate and export take first"
            raise DataError("this is JSON, and no recording", file.name, cure)
        yield open_table(file)
