"""Rows between those of numbers that are none: a header on each page, comments.  They are blanked, and told.

Rows keep their places, for blank ones are passed over.
"""

from __future__ import annotations

import re
from itertools import chain

from dashpot.data.readers.datafile import DataFile, whole_lines
from dashpot.data.readers.delimited.encoding import Text
from dashpot.io.words import counted, listed
from dashpot.notices import Notice

_MINUS, _HYPHEN = "\u2212".encode(), b"-"
_COMMENTS = b"#", b"%"
_LETTER = rb"[A-Za-z_\x80-\xff]"


def _telling(sign: bytes) -> bytes:
    """A byte of a text, if possible one that numbers do not have."""
    match = re.search(rb"[^\s\d.,;:|+\-eE]", sign)
    return match[0] if match else sign[:1]


class StrayRows:
    """What is to be left out of the text behind a header, and how much of it there was.

    heading  the text from its beginning to the row of units, or the header where there is none
    """

    def __init__(self, heading: bytes) -> None:
        self._start = len(heading)
        self._headings = [row for row in map(bytes.strip, heading.splitlines()) if re.search(_LETTER, row)]
        repeated = b"|".join(re.escape(row) for row in self._headings)
        self._stray = re.compile(rb"(?m)^[ \t\f]*(?:(" + repeated + rb")|[#%][^\r\n]*)[ \t\f]*(?=\r?$)")
        self.repeated = self.comments = 0

    def among(self, data: Text) -> bool:
        """Whether there may be such rows: a quick look."""
        signs = (*self._headings[-2:], b"\f", _MINUS, *_COMMENTS)
        # A byte is found ten times as fast as several, and one that numbers do not have is seldom there.
        present = {byte for byte in map(_telling, signs) if data.find(byte, self._start) >= 0}
        return any(_telling(sign) in present and data.find(sign, self._start) >= 0 for sign in signs)

    def blanked(self, data: bytes) -> bytes:
        """The text without them."""
        return data[: self._start] + self._blanked(data[self._start :])

    def _blanked(self, lines: bytes) -> bytes:
        """Whole lines without them, and with hyphens for signs that typesetting has put there."""

        def counting(match: re.Match[bytes]) -> bytes:
            self.repeated += match[1] is not None
            self.comments += match[1] is None
            return b""

        return self._stray.sub(counting, lines).replace(_MINUS, _HYPHEN).replace(b"\f", b"")

    def rewritten(self, file: DataFile, data: Text) -> DataFile:
        """A file that is too large to be held without them."""
        return file.rewritten(
            chain([data[: self._start]], map(self._blanked, whole_lines(data, self._start)))
        )

    def note(self, source: str) -> tuple[Notice, ...]:
        """What was left out, where anything was."""
        words = []
        if self.repeated:
            words.append(f"{counted(self.repeated, 'row')} repeating the header")
        if self.comments:
            words.append(counted(self.comments, "comment"))
        return (Notice("stray_rows", f"{source}: left out {listed(words)}", (source,)),) if words else ()
