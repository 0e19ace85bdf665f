"""dashpot serve: the page on the bench."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import click

from dashpot.app import options as opt
from dashpot.errors import UsageError

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
    """Serve a page on which rigs are described and identified in a browser, with files of FOLDER and others.

    The first line printed is the address with a token, without which nothing is served.  All comes from this machine.
    Ctrl-C ends it; the same command goes on where it was left.
    """
    if find_spec("nicegui") is None:
        raise UsageError("the page needs NiceGUI", cure='install it: pip install "dashpot[web]"')
    from dashpot.app.serve.server import serve

    serve(Path(folder).resolve(), host, port, not no_browser, rows_at)
