"""The server: a socket first, then the address on stdout, then the page."""

from __future__ import annotations

import socket
import sys
import threading
from contextvars import Context
from pathlib import Path

import click

from dashpot.app.serve.feed import listening
from dashpot.app.serve.guard import Guard
from dashpot.app.serve.jobs import Engine
from dashpot.app.serve.session import Sessions
from dashpot.errors import UsageError
from dashpot.io.atomic import locked

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
