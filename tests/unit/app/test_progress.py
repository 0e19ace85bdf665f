"""Long work shows that it is going on, on a terminal, and ends at once when interrupted."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pty = pytest.importorskip("pty", reason="a terminal is made by pty, which this system lacks")

PATIENCE = 300.0  # seconds until the bar must have come


def chain(n: int) -> str:
    """A chain shaken at its end of which everything but the masses is unknown."""
    before = ["u", *(f"x{i}" for i in range(1, n))]
    names = ", ".join(repr(name) for name in [*before[1:], f"x{n}"])
    lines = [f"coordinates = [{names}]", "[inputs]", "u = {}"]
    lines += ["[masses]", *(f'm{i} = {{ at = "x{i}", value = 1.0 }}' for i in range(1, n + 1))]
    for section, letter in (("springs", "k"), ("dampers", "c")):
        lines += [f"[{section}]"]
        lines += [f'{letter}{i} = {{ between = ["{before[i - 1]}", "x{i}"] }}' for i in range(1, n + 1)]
    lines += [
        "[channels]",
        *(f'{name} = {{ of = "{name}" }}' for name in dict.fromkeys(("u", "x1", f"x{n}"))),
    ]
    return "\n".join(lines)


def interrupted_at(shown: bytes, arguments: list[str], folder: Path) -> tuple[int, bytes]:
    """Exit code and terminal output of a command that is interrupted as soon as `shown` stands on the terminal."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "dashpot", *arguments]
    process = subprocess.Popen(command, cwd=folder, stderr=theirs, stdout=subprocess.DEVNULL)
    os.close(theirs)
    output, since, sent = b"", time.monotonic(), False
    while time.monotonic() - since < PATIENCE:
        try:
            piece = os.read(ours, 65536)
        except OSError:  # the other end is closed
            break
        if not piece:
            break
        output += piece
        if shown in output and not sent:
            process.send_signal(signal.SIGINT)
            sent = True
    os.close(ours)
    return process.wait(timeout=PATIENCE), output


@pytest.mark.slow
def test_a_check_of_many_coordinates(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(chain(200))  # which takes several times as long as is waited for
    code, output = interrupted_at(b"0:00:01", ["check", "rig.toml"], tmp_path)
    assert code == 130
    assert b"check" in output
    assert output.rstrip().endswith(b"dashpot: interrupted; no file is left half-written")


@pytest.mark.slow
def test_reading_that_takes_long(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(chain(1))
    (tmp_path / "data.csv").write_text("frequency_hz,time_s,u,x1\n" + "1.0,0.001,0.5,0.25\n" * 1_500_000)
    code, output = interrupted_at(b"reading data.csv", ["identify", "rig.toml", "data.csv"], tmp_path)
    assert code == 130, output[-300:]
