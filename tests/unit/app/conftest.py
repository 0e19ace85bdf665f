"""A rig, its data, and the command line, run in this process."""

from __future__ import annotations

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


@pytest.fixture
def dashpot(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Command:
    """dashpot("identify", "rig.toml", …) in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DASHPOT_TRACEBACK", raising=False)

    def call(*args: str) -> Ran:
        code = run(args)
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
    settings = [text for name, value in VALUES.items() for text in ("--set", f"{name}={value}")]
    done = dashpot(
        "simulate",
        "rig.toml",
        "--out",
        "data.csv",
        "--frequencies",
        "1:15/8log",
        "--amplitude",
        "u=0.01",
        *settings,
    )
    assert done.code == 0, done.err
    return rig.parent / "data.csv"
