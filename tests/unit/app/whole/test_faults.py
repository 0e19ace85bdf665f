"""A disk that fails, fills or lies at any operation under a command: the old file or the complete one, and one line."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dashpot.app.cli import run
from dashpot.io import atomic
from tests.unit.app.commands.test_study import STUDY
from tests.unit.app.conftest import RIG, Command
from tests.unit.io.test_atomic import FaultySystem

OLD = b"{}"  # what was there before: JSON, for nothing else is replaced
KINDS = ("fails", "full", "short", "lies")
IDENTIFY = ("identify", "rig.toml", "data.csv", "--json", "out", "-q")


# How the one writer fails, and that every command writes by it, is tested beside it.
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_old_or_complete(dashpot: Command, data: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    out = Path("out")
    ran = dashpot(*IDENTIFY)
    assert ran.code == 0, ran.err
    complete = out.read_bytes()
    before = set(os.listdir())
    failures = 0
    for k in range(1, 40):
        out.write_bytes(OLD)
        system = FaultySystem(k, kind)
        with monkeypatch.context() as patched:
            patched.setattr(atomic, "os", system)
            ran = dashpot(*IDENTIFY)
        assert set(os.listdir()) == before, k
        if ran.code == 0:
            assert out.read_bytes() == complete, k
        else:
            failures += 1
            assert ran.code == 2, k
            assert len(ran.err) == 1, ran.err
            assert f"{out}: cannot be written" in ran.err[0]
            assert out.read_bytes() in (OLD, complete), k
        if system.count < k:
            break
    else:
        pytest.fail("40 operations for one file")
    assert failures or kind == "short"


def _files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _study_with_faults(
    dashpot: Command, monkeypatch: pytest.MonkeyPatch, whole: dict[str, bytes], k: int, kind: str
) -> bool:
    """Whether the k-th operation is still one of the run's; what was begun goes on to the same bits."""
    folder = Path(f"s{k}{kind}")
    system = FaultySystem(k, kind)
    with monkeypatch.context() as patched:
        patched.setattr(atomic, "os", system)
        ran = dashpot("study", "noise.toml", "--out", str(folder), "--processes", "1", "-q")
    assert ran.code in (0, 2), (k, ran.err)
    left = _files(folder)
    left.pop(atomic.LOCK, None)  # its deletion may be what failed; the lock itself ended with its holder
    assert all(whole[name] == content for name, content in left.items()), k  # each is absent or complete
    again = dashpot("study", "noise.toml", "--out", str(folder), "--processes", "1", "-q")
    assert again.code == 0, (k, again.err)
    assert _files(folder) == whole, k
    return system.count >= k


@pytest.fixture
def whole_study(dashpot: Command, tmp_path: Path) -> dict[str, bytes]:
    """All files of the study noise.toml, which is small."""
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    small = STUDY.replace("draws = 30", "draws = 2").replace("[0.01, 0.05, 0.1]", "[0.01, 0.1]")
    (tmp_path / "noise.toml").write_text(small, encoding="utf-8")
    assert dashpot("study", "noise.toml", "--out", "whole", "--processes", "1", "-q").code == 0
    return _files(Path("whole"))


@pytest.mark.parametrize("kind", KINDS)
def test_a_study_goes_on_after_a_fault(
    dashpot: Command, monkeypatch: pytest.MonkeyPatch, whole_study: dict[str, bytes], kind: str
) -> None:
    for k in random.Random(kind).sample(range(1, 40), 3):
        _study_with_faults(dashpot, monkeypatch, whole_study, k, kind)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_study_goes_on_after_a_fault_at_any_operation(
    dashpot: Command, monkeypatch: pytest.MonkeyPatch, whole_study: dict[str, bytes], kind: str
) -> None:
    k = 1
    while _study_with_faults(dashpot, monkeypatch, whole_study, k, kind):
        k += 1
    assert k > 20


@pytest.mark.long
def test_a_study_killed_again_and_again_ends_the_same(tmp_path: Path) -> None:
    """At forty moments, from the first import to the last draws; it ends as one that was left in peace."""
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    text = STUDY.replace("draws = 30", "draws = 4000")
    (tmp_path / "noise.toml").write_text(text, encoding="utf-8")
    rng = random.Random(2)

    def started(folder: str) -> subprocess.Popen[bytes]:
        words = f"-m dashpot study noise.toml --processes 2 --out {folder} -q".split()
        return subprocess.Popen([sys.executable, *words], cwd=tmp_path, stderr=subprocess.PIPE)

    with contextlib.chdir(tmp_path):
        assert run(["study", "noise.toml", "--processes", "1", "--out", "peace", "-q"]) == 0
    for k in range(40):
        process = started("killed")
        time.sleep(0.2 + 3.8 * (k + rng.random()) / 40)
        kind = rng.choice((signal.SIGKILL, signal.SIGTERM, signal.SIGHUP))
        process.send_signal(kind)
        told = process.communicate(timeout=600)[1]
        # A worker whose parent was killed before it had said what to do can only complain of that.
        assert b"Traceback" not in told or (kind == signal.SIGKILL and b"EOFError: Ran out of input" in told)
        assert b"internal error" not in told
    last = started("killed")
    assert last.communicate(timeout=600)[1] == b""
    assert _files(tmp_path / "killed") == _files(tmp_path / "peace")
