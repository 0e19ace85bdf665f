"""However a study ends, its workers end with it, nothing temporary is left, and it goes on where it was."""

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dashpot.io.atomic import LOCK
from tests.two_masses import one_mass
from tests.unit.app.commands.test_study import STUDY
from tests.unit.app.conftest import RIG

PATIENCE = 300.0  # s, until a condition holds on a machine that is kept busy

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


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["SIGTERM", *(pytest.param(each, marks=pytest.mark.long) for each in ("SIGKILL", "SIGINT", "SIGHUP"))],
)
def test_workers_end_with_their_study(tmp_path: Path, name: str) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    (tmp_path / "noise.toml").write_text(STUDY.replace("draws = 30", "draws = 1000000"), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "dashpot", "study", "noise.toml", "--processes", "2"],
        cwd=tmp_path, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, start_new_session=True,
    )  # fmt: skip
    folder = tmp_path / "noise"
    try:
        enough = _wait(lambda: len(list(folder.glob("draws/*/*.parquet"))) >= 3, PATIENCE)
        workers = _descendants(process.pid)
        process.send_signal(getattr(signal, name))
        told = process.communicate(timeout=PATIENCE)[1]
    finally:
        process.kill()
        process.communicate()
    assert enough, told
    assert len(workers) >= 2
    assert _wait(lambda: not any(_alive(pid) for pid in workers), PATIENCE), name
    assert "semaphore" not in told  # which are cleared away, whoever was in time for it
    left = {path.name for path in folder.rglob(".*")}
    if name == "SIGKILL":
        assert left <= {LOCK}  # whose lock the system has freed
    else:
        assert left == set()
        assert "finished draws are kept in noise" in told
        assert process.returncode == 128 + getattr(signal, name)


NAMES = "TERM TERM", "INT INT", "HUP HUP", "TERM HUP", "TERM INT", "INT TERM"
PAIRS = [[f"SIG{name}" for name in pair.split()] for pair in NAMES]
FLEET = one_mass("f")


def _many_machines(path: Path) -> None:
    """Amplitudes of 40,000 machines at ten frequencies."""
    rng = np.random.default_rng(3)
    f = np.tile(np.linspace(1, 6, 10), 40_000)
    x = 1 / (400 - (2 * np.pi * f) ** 2 + 4j * np.pi * f) * (1 + 0.01 * rng.normal(size=f.size))
    columns = {"x_re": x.real, "x_im": x.imag, "f_re": np.ones(f.size), "f_im": np.zeros(f.size)}
    serial = np.repeat([f"M{k:05d}" for k in range(40_000)], 10)
    pq.write_table(pa.table({"serial": serial, "frequency_hz": f, **columns}), path)


def _of_a_run(mark: str) -> list[int]:
    """Processes that live with a mark in their environment, whoever is their parent by now."""
    living = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (place / "environ").read_bytes() and _alive(int(place.name)):
                living.append(int(place.name))
        except OSError:
            continue
    return living


@pytest.mark.long
@pytest.mark.parametrize("command", ["study", "fleet"])
def test_two_signals_within_milliseconds_leave_nothing_behind(tmp_path: Path, command: str) -> None:
    """At 24 moments of four seconds, to the process or its group: one of the two exit codes, no file, no process."""
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    (tmp_path / "noise.toml").write_text(STUDY.replace("draws = 30", "draws = 1000000"), encoding="utf-8")
    (tmp_path / "machine.toml").write_text(FLEET, encoding="utf-8")
    _many_machines(tmp_path / "machines.parquet")
    (tmp_path / "tmp").mkdir()
    arguments = {
        "study": ["noise.toml", "--processes", "2"],
        "fleet": ["machine.toml", "machines.parquet", "--rig-column", "serial", "--out", "f.parquet",
                  "--processes", "2"],
    }  # fmt: skip
    rng = random.Random(command)
    for k in range(24):
        mark = f"dashpot-{os.getpid()}-{k}"
        first, second = (getattr(signal, name) for name in rng.choice(PAIRS))
        process = subprocess.Popen(
            [sys.executable, "-m", "dashpot", command, *arguments[command]],
            cwd=tmp_path, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, start_new_session=True,
            env={**os.environ, "MARK": mark, "TMPDIR": str(tmp_path / "tmp")},
        )  # fmt: skip
        time.sleep(0.1 + 3.9 * (k + rng.random()) / 24)
        send = os.killpg if rng.random() < 0.3 else os.kill
        with suppress(ProcessLookupError):  # it may have ended by the first
            send(process.pid, first)
            time.sleep(10 ** rng.uniform(-5, -1))
            send(process.pid, second)
        told = process.communicate(timeout=600)[1]
        case = f"{k}: {first.name}, {second.name}, {send.__name__}: {told}"
        assert not any(word in told for word in ("Traceback", "internal error", "resource_tracker")), case
        assert process.returncode in {128 + first, 128 + second, -first, -second}, case
        assert _wait(lambda mark=mark: not _of_a_run(mark), PATIENCE), case
        assert [path.name for path in tmp_path.rglob(".*")] + os.listdir(tmp_path / "tmp") == [], case
