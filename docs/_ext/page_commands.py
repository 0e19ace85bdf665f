"""Commands of a page, run in this process as a shell would run them: for the gallery, and for tests of pages."""

from __future__ import annotations

import contextlib
import io
import os
import runpy
import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path


def lines(block: str) -> Iterator[str]:
    """The commands of a block, without comments that stand alone; continued lines are one."""
    for line in block.replace("\\\n", " ").splitlines():
        if line.split("#")[0].strip():
            yield line


def run_line(line: str) -> tuple[int, str]:
    """Exit code of one command and what it prints; ValueError for what is none of cd, cp, dashpot and python."""
    words = shlex.split(line, comments=True)
    with captured() as stream:
        match words[0]:
            case "cd":
                os.chdir(words[1])
                code = 0
            case "cp":
                shutil.copy(*words[1:])
                code = 0
            case "dashpot":
                from dashpot.app.cli import run

                code = run(words[1:])
            case "python":
                _script(words[1:])
                code = 0
            case other:
                raise ValueError(f"{other} is none of the commands that are run; use ```console")
    return code, stream.getvalue()


def _script(words: list[str]) -> None:
    """A script of an example, as `python SCRIPT ARGS` runs it."""
    before, path = sys.argv, list(sys.path)
    sys.argv, sys.path[:] = words, [str(Path(words[0]).resolve().parent), *path]
    try:
        runpy.run_path(words[0], run_name="__main__")
    finally:
        sys.argv, sys.path[:] = before, path


@contextlib.contextmanager
def captured() -> Iterator[io.StringIO]:
    """Whatever is printed meanwhile, errors among it."""
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
        yield stream
