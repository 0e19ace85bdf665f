"""However a study ends, its workers end with it, nothing temporary is left, and it goes on where it was."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dashpot.io.lock import LOCK
from tests.unit.app.commands.test_study import STUDY
from tests.unit.app.conftest import RIG

pytestmark = pytest.mark.skipif(not os.path.exists("/proc/self/task"), reason="needs /proc to find processes")


def _descendants(pid: int) -> set[int]:
    """Processes that come from one, in any generation."""
    found: set[int] = set()
    rest = [pid]
    while rest:
        try:
            text = Path(f"/proc/{rest[-1]}/task/{rest[-1]}/children").read_text()
        except OSError:
            text = ""
        rest.pop()
        children = {int(word) for word in text.split()} - found
        found |= children
        rest.extend(children)
    return found


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _wait(condition: object, seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGKILL", "SIGINT"])
def test_workers_end_with_their_study(tmp_path: Path, name: str) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    (tmp_path / "noise.toml").write_text(STUDY.replace("draws = 30", "draws = 1000000"), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "dashpot", "study", "noise.toml", "--processes", "2"],
        cwd=tmp_path, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, start_new_session=True,
    )  # fmt: skip
    folder = tmp_path / "noise"
    assert _wait(lambda: len(list(folder.glob("draws/*/*.parquet"))) >= 3, 90), process.communicate()
    workers = _descendants(process.pid)
    assert len(workers) >= 2
    process.send_signal(getattr(signal, name))
    process.wait(20)
    assert _wait(lambda: not any(_alive(pid) for pid in workers), 10), name
    assert process.stderr is not None
    told = process.stderr.read()
    process.stderr.close()
    assert "semaphore" not in told  # which are cleared away, whoever was in time for it
    left = {path.name for path in folder.rglob(".*")}
    if name == "SIGKILL":
        assert left <= {LOCK}  # whose lock the system has freed
    else:
        assert left == set()
        assert "finished draws are kept in noise" in told
        assert process.returncode == 128 + getattr(signal, name)
