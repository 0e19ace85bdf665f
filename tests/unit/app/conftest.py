"""A rig, its data, and the command line, run in this process."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from dashpot.app.cli import run
from tests.two_masses import RIG, VALUES


@dataclass(frozen=True)
class Ran:
    """What a command left behind; `err` without blank lines (click starts a new one after ^C)."""

    code: int
    out: str
    err: list[str]


Command = Callable[..., Ran]
SET = "--set " + ",".join(f"{name}={value:g}" for name, value in VALUES.items())
SIMULATED: list[bytes] = []  # the file of `data`, once it was made


@pytest.fixture
def dashpot(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Command:
    """dashpot("identify rig.toml …") in an empty folder; words behind the first text may have spaces of their own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DASHPOT_TRACEBACK", raising=False)

    def call(line: str = "", *words: str) -> Ran:
        code = run([*line.split(), *words])
        told = capsys.readouterr()
        return Ran(code, told.out, [line for line in told.err.splitlines() if line])

    return call


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """rig.toml in the folder of the test."""
    path = tmp_path / "rig.toml"
    path.write_text(RIG, encoding="utf-8")
    return path


@pytest.fixture
def data(dashpot: Command, rig: Path) -> Path:
    """data.csv: a simulated test of the rig at VALUES, eight frequencies."""
    path = rig.parent / "data.csv"
    if not SIMULATED:
        sent = "--frequencies 1:15/8log --amplitude u=0.01"
        done = dashpot(f"simulate rig.toml --out data.csv {sent} {SET}")
        assert done.code == 0, done.err
        SIMULATED.append(path.read_bytes())
    path.write_bytes(SIMULATED[0])
    return path
