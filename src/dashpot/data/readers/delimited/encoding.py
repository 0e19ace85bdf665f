"""Text of any encoding as UTF-8 with line feeds, without what editors and broken writes leave at its end."""

from __future__ import annotations

import codecs
import mmap
import re

from dashpot.data.readers.datafile import PIECE, DataFile
from dashpot.errors import DataError

Text = bytes | mmap.mmap
LOOKED_AT = 1 << 20  # bytes by which an encoding is told
_MARKS = (b"\xff\xfe", b"\xfe\xff")  # that begin a text in UTF-16
_END = b"\0\x1a"  # of a file that was laid out before it was written, or that DOS ended
_NO_WINDOWS_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f\x81\x8d\x8f\x90\x9d]")
_FEWEST = 8  # bytes of text in UTF-16 that need no mark


def is_text(head: bytes) -> bool:
    """Whether bytes that begin a file are text: none but the last is zero, or they are in UTF-16."""
    written = head.rstrip(_END)
    plain = b"\0" not in written and (len(written) == len(head) or b"\n" in written or b"\r" in written)
    return plain or _wide(head) is not None


def text_of(head: bytes) -> str:
    """The text of a header, in UTF-8 or Windows-1252."""
    try:
        return head.decode("utf-8")
    except UnicodeDecodeError:
        return head.decode("cp1252", errors="replace")


def as_utf8(data: bytes, source: str) -> bytes:
    """The text of a file as UTF-8 without a mark, with line feeds.  Raises DataError where it is not text."""
    encoding = _encoding(data, source)
    if encoding is not None:
        try:
            data = data.decode(encoding).encode()
        except UnicodeError:
            raise _damaged(source) from None
    data = data.removeprefix(codecs.BOM_UTF8).rstrip(_END)
    if not data.strip():
        raise DataError("the file is empty", source, "give a file with a header row and data")
    if b"\0" in data[:LOOKED_AT]:
        raise DataError("the file is not text", source, "give a CSV file")
    return data.replace(b"\r", b"\n") if b"\n" not in data and b"\r" in data else data


def rewritten_as_utf8(file: DataFile, data: Text) -> DataFile:
    """The same of a file that is too large to be held; itself where it is so already.

    Raises DataError where it is said to be UTF-16 and is not.
    """
    pieces = (data[at : at + PIECE] for at in range(0, len(data), PIECE))
    encoding = _encoding(data[:LOOKED_AT], file.name)
    if encoding is not None:
        try:
            return file.rewritten(text.encode() for text in codecs.iterdecode(pieces, encoding))
        except UnicodeError:
            raise _damaged(file.name) from None
    if b"\n" not in data[:LOOKED_AT] and b"\r" in data[:LOOKED_AT]:
        return file.rewritten(piece.replace(b"\r", b"\n") for piece in pieces)
    if data[-1] in _END:
        return file.rewritten(piece.translate(None, _END) for piece in pieces)
    return file


def _encoding(data: bytes, source: str) -> str | None:
    """What the text is written in, None where that is UTF-8; Windows-1252 is what a µ or ² alone in it may be."""
    wide = _wide(data)
    if wide is not None:
        return wide
    head = data[:LOOKED_AT]
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError as error:
        if not _NO_WINDOWS_TEXT.search(head.rstrip(_END)):
            return "cp1252"
        row = head.count(b"\n", 0, error.start) + 1
        within = error.start - head.rfind(b"\n", 0, error.start)
        what = f"byte {within} of the row is not UTF-8"
        raise DataError(what, f"{source}:{row}", "save the file as UTF-8") from None
    return None


def _wide(data: bytes) -> str | None:
    """UTF-16, with a mark or where every other byte of the beginning is zero."""
    if data[:2] in _MARKS:
        return "utf-16"
    begin = data[:64]
    if len(begin) >= _FEWEST and len(begin) % 2 == 0:
        for encoding, low, high in (
            ("utf-16-le", begin[::2], begin[1::2]),
            ("utf-16-be", begin[1::2], begin[::2]),
        ):
            if not any(high) and all(low):
                return encoding
    return None


def _damaged(source: str) -> DataError:
    return DataError("the file is damaged UTF-16", source, "save it as UTF-8")
