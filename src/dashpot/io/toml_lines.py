"""Where in a TOML text each key stands.

tomllib gives values without places, and a message about springs.k1 must name its line.  The text is scanned a second
time, only for keys; what the scan does not understand ends it, and what it has found until then is kept.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Sequence

Path = tuple[str | int, ...]

_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_STRING = re.compile(
    r'''"""(?:[^"\\]|\\.|"(?!""))*"{3,5} | \'\'\'(?:[^\']|\'(?!\'\'))*\'{3,5}
      | "(?:[^"\\\n]|\\.)*" | \'[^\'\n]*\' ''',
    re.VERBOSE | re.DOTALL,
)
_SCALAR = re.compile(r"[^,\]}#\n]*")


class Lines:
    """Lines (from 1) at which the keys of a TOML text are defined, by their paths; items of lists have numbers."""

    def __init__(self, text: str) -> None:
        self._starts = [0, *(match.end() for match in re.finditer("\n", text))]
        scan = _Scan(text)
        scan.run()
        self._where = {path: [self.line_at(at) for at in places] for path, places in scan.defined.items()}
        for path, at in scan.mentioned.items():
            self._where.setdefault(path, [self.line_at(at)])

    def line_at(self, position: int) -> int:
        """The line of a character position."""
        return bisect_right(self._starts, position)

    def of(self, path: Sequence[str | int]) -> int | None:
        """Line of the last definition of `path`, or of the nearest table around it; None where there is none."""
        for length in range(len(path), 0, -1):
            lines = self._where.get(tuple(path[:length]))
            if lines is not None:
                return lines[-1]
        return None

    def twice(self) -> tuple[Path, int, int] | None:
        """The first key that is defined again, with the lines of its first and second definition."""
        again = [(lines[1], path, lines[0]) for path, lines in self._where.items() if len(lines) > 1]
        if not again:
            return None
        second, path, first = min(again, key=lambda entry: entry[0])
        return path, first, second


class _LostError(Exception):
    """The scan has met something that is not TOML."""


class _Scan:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.defined: dict[Path, list[int]] = {}
        self.mentioned: dict[Path, int] = {}
        self._counts: dict[Path, int] = {}  # of the tables in arrays of tables

    def run(self) -> None:
        try:
            prefix: Path = ()
            while True:
                self._skip(_BLANK)
                if self.at >= len(self.text):
                    return
                if self.text[self.at] == "[":
                    prefix = self._header()
                else:
                    self._pair(prefix)
                self._skip(_SPACE)
                if self.at < len(self.text) and self.text[self.at] not in "#\r\n":
                    return
        except (_LostError, RecursionError):
            return

    def _header(self) -> Path:
        start = self.at
        double = self.text.startswith("[[", start)
        self.at += 2 if double else 1
        key = self._key()
        self._expect("]]" if double else "]")
        path: Path = ()
        for part in key[:-1]:
            path = (*path, part)
            self.mentioned.setdefault(path, start)
            if path in self._counts:
                path = (*path, self._counts[path])
        path = (*path, key[-1])
        if not double:
            self._define(path, start)
            return path
        self._counts[path] = self._counts.get(path, -1) + 1
        self.mentioned.setdefault(path, start)
        path = (*path, self._counts[path])
        self._define(path, start)
        return path

    def _pair(self, prefix: Path) -> None:
        self._skip(_SPACE)
        start = self.at
        key = self._key()
        self._expect("=")
        for length in range(1, len(key)):
            self.mentioned.setdefault((*prefix, *key[:length]), start)
        path = (*prefix, *key)
        self._define(path, start)
        self._value(path)

    def _key(self) -> tuple[str, ...]:
        parts: list[str] = []
        while True:
            self._skip(_SPACE)
            bare = _BARE_KEY.match(self.text, self.at)
            if bare is not None:
                self.at = bare.end()
                parts.append(bare[0])
            else:
                parts.append(self._quoted())
            self._skip(_SPACE)
            if not self.text.startswith(".", self.at):
                return tuple(parts)
            self.at += 1

    def _quoted(self) -> str:
        match = _STRING.match(self.text, self.at)
        if match is None:
            raise _LostError
        self.at = match.end()
        if match[0].startswith("'"):
            return match[0][1:-1]
        return re.sub(
            r"\\(?:u([0-9a-fA-F]{4})|U([0-9a-fA-F]{8})|(.))", self._unescaped, match[0][1:-1], flags=re.DOTALL
        )

    @staticmethod
    def _unescaped(match: re.Match[str]) -> str:
        if match[3] is not None:
            return {"b": "\b", "t": "\t", "n": "\n", "f": "\f", "r": "\r", "e": "\x1b"}.get(
                match[3], match[3]
            )
        code = int(match[1] or match[2], 16)
        return chr(code) if code <= 0x10FFFF else "?"

    def _value(self, path: Path) -> None:
        self._skip(_SPACE)
        first = self.text[self.at : self.at + 1]
        if first == "[":
            self._list(path)
        elif first == "{":
            self._inline_table(path)
        elif first in ('"', "'"):
            match = _STRING.match(self.text, self.at)
            if match is None:
                raise _LostError
            self.at = match.end()
        else:
            self._skip(_SCALAR)

    def _list(self, path: Path) -> None:
        self.at += 1
        item = 0
        while True:
            self._skip(_BLANK)
            if self.text.startswith("]", self.at):
                self.at += 1
                return
            if self.at >= len(self.text):
                raise _LostError
            self._define((*path, item), self.at)
            self._value((*path, item))
            item += 1
            self._skip(_BLANK)
            if self.text.startswith(",", self.at):
                self.at += 1
            elif not self.text.startswith("]", self.at):
                raise _LostError

    def _inline_table(self, path: Path) -> None:
        self.at += 1
        while True:
            self._skip(_BLANK)  # later versions of TOML allow line breaks here
            if self.text.startswith("}", self.at):
                self.at += 1
                return
            self._pair(path)
            self._skip(_BLANK)
            if self.text.startswith(",", self.at):
                self.at += 1
            elif not self.text.startswith("}", self.at):
                raise _LostError

    def _define(self, path: Path, at: int) -> None:
        self.defined.setdefault(path, []).append(at)

    def _skip(self, pattern: re.Pattern[str]) -> None:
        match = pattern.match(self.text, self.at)
        if match is not None:
            self.at = match.end()

    def _expect(self, what: str) -> None:
        self._skip(_SPACE)
        if not self.text.startswith(what, self.at):
            raise _LostError
        self.at += len(what)
