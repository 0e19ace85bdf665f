"""dashpot serve: the page on the bench."""

from __future__ import annotations

import socket
import sys
import threading
from contextvars import Context
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import click

from dashpot.app import options as opt
from dashpot.app.serve.feed import listening
from dashpot.app.serve.guard import Guard
from dashpot.app.serve.jobs import Engine
from dashpot.app.serve.session import Sessions
from dashpot.errors import UsageError
from dashpot.io.atomic import locked

PAGE = "The page"


@opt.dashpot_command("dashpot serve measurements", "dashpot serve measurements --port 8000 --no-browser")
def command(
    folder: Annotated[
        str,
        opt.Option("", click.Path(exists=True, file_okay=False), required=False, default="."),
        "Folder of the measurements; sessions are kept in it, in .dashpot.",
    ],
    port: Annotated[
        int | None,
        opt.Option("--port N", opt.Count(0, 65535), PAGE),
        "Port of the page.  [default: 8420, or a free one where that is taken]",
    ],
    no_browser: Annotated[bool, opt.Option("--no-browser", None, PAGE), "Do not open a browser."],
    host: Annotated[
        str,
        opt.Option("--host ADDRESS", None, PAGE, default="127.0.0.1"),
        "Address to serve at; 0.0.0.0 lets other machines in, who need the token.",
    ],
    rows_at: Annotated[
        int | None,
        opt.Option("--socket PORT", opt.Count(0, 65535), PAGE),
        "TCP port for rows of a running test: text with the names of the channels in its first line.",
    ],
) -> None:
    """Serve a page in the browser on which rigs are described and identified, with files of FOLDER or dropped ones.

    The first line printed is the address, with the token that access needs.  Nothing is loaded from other machines.
    Ctrl-C ends it; the same command resumes the session.
    """
    if find_spec("nicegui") is None:
        raise UsageError(
            "the page needs NiceGUI", cure='install it: pip install ".[web]" in the folder of dashpot'
        )

    serve(Path(folder).resolve(), host, port, not no_browser, rows_at)


USUAL_PORT = 8420


def serve(folder: Path, host: str, port: int | None, browser: bool, rows_at: int | None = None) -> None:
    """Serve the page for a folder until it is interrupted; `rows_at` is the port for rows of a running test.

    Raises UsageError if a port is taken, or another server works in the folder.
    """
    engine = Engine()
    sessions = Sessions(folder, engine)
    with locked(sessions.root), _listening(host, port) as listener:
        number = listener.getsockname()[1]
        shown = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
        shown = f"[{shown}]" if ":" in shown else shown
        address = f"http://{shown}:{number}/?token={sessions.first()}"
        print(address, flush=True)
        if rows_at is not None:
            feed = listening(host, rows_at, sessions)
            print(f"rows of a running test: {shown}:{feed.server_address[1]}", flush=True)
        if browser:
            threading.Timer(0.5, click.launch, (address,)).start()
        try:
            # Without the ledger of this run: a server writes its files more than once.
            Context().run(_run, listener, sessions, engine, host, number)
        finally:
            engine.close()


def _listening(host: str, port: int | None) -> socket.socket:
    """A socket that listens there; at a free port where none is asked for and the usual one is taken."""
    last: OSError | None = None
    for number in (USUAL_PORT, 0) if port is None else (port,):
        try:
            family = socket.getaddrinfo(host, number, type=socket.SOCK_STREAM)[0][0]
            listener = socket.socket(family, socket.SOCK_STREAM)
            if sys.platform != "win32":  # there it would let two servers have one port
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind((host, number))
                listener.listen(128)
            except OSError:
                listener.close()
                raise
            return listener
        except OSError as error:
            last = error
    assert last is not None
    what = f"the page cannot be served at {host}:{port or USUAL_PORT} ({last.strerror or last})"
    raise UsageError(what, cure="give another --port or --host") from None


def _run(listener: socket.socket, sessions: Sessions, engine: Engine, host: str, port: int) -> None:
    import uvicorn

    from dashpot.app.serve.page import application

    app = Guard(application(), sessions, (host,), port)
    threading.Timer(0.2, engine.prepare).start()  # once the page is on its way
    config = uvicorn.Config(app, log_level="critical", lifespan="on", timeout_graceful_shutdown=1)
    uvicorn.Server(config).run(sockets=[listener])
