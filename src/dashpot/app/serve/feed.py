"""Rows of a test that still runs, sent by its recorder: over HTTP or through a plain TCP socket, into a live file."""

from __future__ import annotations

import os
import re
import socket
import socketserver
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from dashpot.errors import UsageError, printable

if TYPE_CHECKING:
    from types import TracebackType

    from dashpot.app.serve.session import Session, Sessions

MOST_LIVE = 1 << 30  # bytes of one live file
LONGEST_LINE = 1 << 16  # bytes of the first line: names of some thousand channels
AT_ONCE = 16  # recorders that send at the same time
USUAL_NAME = "socket.csv"
TOKEN_LINE = re.compile(r"([\w-]{32})(?:[ \t]+(.*))?")


class LiveFile:
    """A live file that grows by what one recorder sends.

    One that connects again goes on where it was: its first line does not come twice, and a row that broke off goes.
    Raises UsageError if another recorder is writing the file, and where it becomes too long.
    """

    _open: set[Path] = set()  # noqa: RUF012  those that are being written by this process
    _lock = threading.Lock()

    def __init__(self, place: Path) -> None:
        with self._lock:
            if place in self._open:
                cure = "let that one end, or give another name"
                raise UsageError("another recorder is sending under this name", printable(place.name), cure)
            self._open.add(place)
        self.place, self._begin = place, b""
        place.touch(mode=0o600)
        self.file = place.open("r+b")
        before = self.file.readline(LONGEST_LINE)
        self._head = before if before.endswith(b"\n") else None
        tail = max(0, self.file.seek(0, os.SEEK_END) - LONGEST_LINE)
        self.file.seek(tail)
        self.file.truncate(tail + self.file.read().rfind(b"\n") + 1)
        self.file.seek(0, os.SEEK_END)

    def write(self, content: bytes) -> None:
        """Add what has come."""
        if self._head is not None:
            self._begin += content
            if b"\n" not in self._begin and len(self._begin) <= LONGEST_LINE:
                return
            head, mark, rest = self._begin.partition(b"\n")
            content = rest if head.strip() == self._head.strip() else head + mark + rest
            self._head = None
        if self.file.tell() + len(content) > MOST_LIVE:
            raise UsageError(
                f"a live file has at most {MOST_LIVE >> 30} GB", printable(self.place.name), "begin another"
            )
        self.file.write(content)
        self.file.flush()

    def __enter__(self) -> LiveFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it: another recorder may go on with it."""
        if self._head is not None:
            self.file.write(self._begin)
        self.file.close()
        with self._lock:
            self._open.discard(self.place)


class Feed(socketserver.ThreadingTCPServer):
    """A TCP socket that takes rows of text, in the first line the names of the channels.

    A line `TOKEN NAME` before them says into which session and under which name they go.  Without it they go to the
    session of the address that was printed, as socket.csv; only programs on this machine may leave it out.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, host: str, port: int, sessions: Sessions) -> None:
        self.sessions, self.at_once = sessions, threading.Semaphore(AT_ONCE)
        self.address_family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        super().__init__((host, port), _Rows)

    def session(self, token: str | None) -> Session | None:
        """The session of a token, or the first one where none is given."""
        return self.sessions.of(self.sessions.first() if token is None else token)


class _Rows(socketserver.StreamRequestHandler):
    server: Feed

    def handle(self) -> None:
        """Take rows until the recorder closes; what is refused is answered by one line."""
        if not self.server.at_once.acquire(blocking=False):
            self._say(f"at most {AT_ONCE} recorders send at once")
            return
        try:
            self._take(self.rfile.readline(LONGEST_LINE))
        except UsageError as error:
            self._say(str(error))
        except OSError:
            pass  # the recorder is gone; what came is kept
        finally:
            self.server.at_once.release()

    def _take(self, first: bytes) -> None:
        if b" HTTP/" in first:  # a browser, led here by somebody's page
            raise UsageError("this port takes rows, not HTTP", cure="send HTTP to /stream of the page")
        said = TOKEN_LINE.fullmatch(first.decode("utf-8", errors="replace").strip())
        here = self.client_address[0] in ("127.0.0.1", "::1")
        if said is None and not here:
            raise UsageError(
                "the first line lacks the token", cure="send TOKEN NAME, then the names of the channels"
            )
        session = self.server.session(None if said is None else said[1])
        if session is None:
            raise UsageError(
                "the token is wrong", cure="take it from the address that dashpot serve has printed"
            )
        name = (said[2] if said is not None else None) or USUAL_NAME
        with LiveFile(session.live_place(name.strip())) as live:
            if said is None:
                live.write(first)
            while content := self.rfile.read1(1 << 16):  # what has come by now
                live.write(content)

    def _say(self, line: str) -> None:
        with suppress(OSError):
            self.wfile.write(f"dashpot: {line}\n".encode())


def listening(host: str, port: int, sessions: Sessions) -> Feed:
    """Take rows at a port, in threads that end with the process.

    Raises UsageError if the port is taken.
    """
    try:
        feed = Feed(host, port, sessions)
    except OSError as error:
        what = f"rows cannot be taken at {host}:{port} ({error.strerror or error})"
        raise UsageError(what, cure="give another --socket") from None
    threading.Thread(target=feed.serve_forever, daemon=True).start()
    return feed
