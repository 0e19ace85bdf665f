"""Rows that a recorder sends: through a socket, by whom, into which file, and what is refused."""

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from dashpot.app.serve.feed import Feed, LiveFile, listening
from dashpot.app.serve.session import Sessions
from dashpot.errors import UsageError
from tests.unit.app.serve.test_guard import NoEngine


@pytest.fixture
def feed(tmp_path: Path) -> Iterator[Feed]:
    found = Feed("127.0.0.1", 0, Sessions(tmp_path, NoEngine()))  # type: ignore[arg-type]
    threading.Thread(target=found.serve_forever, args=(0.01,), daemon=True).start()
    yield found
    found.shutdown()
    found.server_close()


def sent(feed: Feed, *parts: bytes) -> str:
    """What is answered once all has been sent."""
    with socket.create_connection(feed.server_address[:2]) as recorder:
        for part in parts:
            recorder.sendall(part)
        recorder.shutdown(socket.SHUT_WR)
        return recorder.recv(1000).decode()


def live(feed: Feed, name: str) -> bytes:
    session = feed.session(None)
    assert session is not None
    return session.live_place(name).read_bytes()


def test_rows_go_into_a_file_and_a_recorder_that_comes_again_goes_on(feed: Feed) -> None:
    assert sent(feed, b"time_s,x\n0,1\n", b"1,2\n2,") == ""
    assert sent(feed, b"time_s,x\n", b"3,4\n") == ""
    assert live(feed, "socket.csv") == b"time_s,x\n0,1\n1,2\n3,4\n"  # no second head, no half row


def test_a_token_names_session_and_file(feed: Feed) -> None:
    token = feed.sessions.first()
    assert sent(feed, f"{token} run.csv\n".encode(), b"time_s,x\n0,1\n") == ""
    assert live(feed, "run.csv") == b"time_s,x\n0,1\n"
    assert sent(feed, f"{token} ../../evil.csv\n".encode(), b"time_s,x\n0,1\n") == ""
    assert live(feed, "evil.csv") == b"time_s,x\n0,1\n"
    assert "token is wrong" in sent(feed, b"x" * 32 + b" run.csv\n")


def test_what_is_no_row_is_refused_in_one_line(feed: Feed) -> None:
    assert "HTTP" in sent(feed, b"POST / HTTP/1.1\r\n")
    session = feed.session(None)
    assert session is not None
    with LiveFile(session.live_place("socket.csv")):
        assert "another recorder" in sent(feed, b"time_s,x\n")
    with pytest.raises(UsageError, match="--socket"):
        listening("127.0.0.1", int(feed.server_address[1]), feed.sessions)
