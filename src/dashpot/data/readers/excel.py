"""Excel workbooks and OpenDocument spreadsheets: every sheet is read as the text it shows would be."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import Any
from zipfile import ZipFile

from dashpot.data.readers.columns import MOST_COLUMNS
from dashpot.data.readers.datafile import DataFile
from dashpot.data.readers.guarded import damaged, guarded
from dashpot.data.readers.text import TextTable, open_table
from dashpot.errors import DataError

ZIP = b"PK\x03\x04"
TRUTHS = ("true", "false")  # as text; as numbers 1 and 0


def is_excel(file: DataFile) -> bool:
    """A zip archive or compound file of that name, or with the parts of a workbook in front."""
    head = file.head
    if head.startswith(b"\xd0\xcf\x11\xe0"):
        return True
    names = (b"[Content_Types].xml", b"xl/", b"_rels/", b"docProps/", b"opendocument.spreadsheet")
    return head.startswith(ZIP) and (
        file.suffix in (".xlsx", ".xlsm", ".xlsb", ".ods") or any(name in head[:200] for name in names)
    )


def read_excel(file: DataFile, fastexcel: Any) -> Iterator[TextTable]:
    """The sheets with a header row; empty ones are left out.  Raises DataError if the file cannot be read."""
    if file.head.startswith(ZIP):
        with damaged(file.name, "Excel"), file.reading() as stream, ZipFile(stream) as archive:
            file.check_unpacked(sum(item.file_size for item in archive.infolist()))
    count = 0
    for place, text in guarded(file, "Excel", lambda: _sheets(file, fastexcel)):
        count += 1
        yield open_table(file.rewritten([text]), source=place)
    if not count:
        raise DataError("the workbook is empty", file.name, "give one with a header row and data")


def _sheets(file: DataFile, fastexcel: Any) -> Generator[tuple[str, bytes]]:
    """Place and text of the sheets that hold anything."""
    book = fastexcel.read_excel(bytes(file.contents))
    names = list(book.sheet_names)
    for name in names:
        # Tab-separated, numbers with all their digits: as text they come rounded to nine decimals
        table, numbers = (
            book.load_sheet(name, header_row=None, dtypes=kind).to_arrow() for kind in ("string", "float")
        )
        if table.num_rows == 0 or table.num_columns == 0 or table.num_columns > MOST_COLUMNS:
            text = b""
        else:
            columns = [
                [_cell(*cell) for cell in zip(texts.to_pylist(), values.to_pylist(), strict=True)]
                for texts, values in zip(table.columns, numbers.columns, strict=True)
            ]
            rows = (
                "\t".join(row).rstrip("\t") if i == 0 else "\t".join(row)
                for i, row in enumerate(zip(*columns, strict=True))
            )
            text = ("\n".join(rows) + "\n").encode()
        if text.count(b"\n") > 1 or (text and len(names) == 1):
            yield f"{file.name} ({name})" if len(names) > 1 else file.name, text


def _cell(text: str | None, number: float | None) -> str:
    if text is None:
        return ""
    if number is not None and text not in TRUTHS:
        return repr(number)
    return text.replace("\t", " ").replace("\n", " ")
