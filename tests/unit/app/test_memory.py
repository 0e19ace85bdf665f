"""Limited memory: an answer or one line in good time, whatever the limit, and no file that is blamed."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dashpot.app import process as memory
from dashpot.app.cli import run
from dashpot.errors import DataError
from tests.fuzz import corpus

resource = pytest.importorskip("resource")
ROOT = Path(__file__).parents[3]
RIG = ROOT / "examples" / "01_first_fit" / "rig.toml"
COMMAND = "import sys; from dashpot.__main__ import run_command; run_command()"
LONGEST = 10  # s of processor time for one file: 5 on an idle machine, where MDF takes 2
WAIT = 60  # s: an answer takes 2 on an idle machine


def within(megabytes: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command in so much address space, with more threads of BLAS than that holds."""
    limit = megabytes * 1000 * 1024  # as `ulimit -v` counts
    return subprocess.run(
        [sys.executable, "-c", COMMAND, *arguments],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
        env=os.environ | {"OPENBLAS_NUM_THREADS": "8"},
        timeout=WAIT,
        capture_output=True,
        text=True,
    )


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = str(tmp_path_factory.mktemp("memory") / "data.csv")
    assert run(["simulate", str(RIG), "--frequencies", "2:14:1", "--seed", "1", "--out", path, "-q"]) == 0
    return path


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the system does not limit address space")
@pytest.mark.parametrize("megabytes", [100, 450, 620])
def test_little_memory_is_enough_or_named_in_one_line(megabytes: int, data: str) -> None:
    done = within(megabytes, "identify", str(RIG), data)
    if megabytes >= 620:
        assert done.returncode == 0, done.stderr
    else:
        assert done.returncode == memory.EXIT_CODE, done.stderr
        assert done.stderr.count("\n") == 1
        assert "not enough memory" in done.stderr


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the system does not limit address space")
@pytest.mark.parametrize("megabytes", [512, 1024])
def test_every_reader_answers_or_says_why_in_one_line(megabytes: int, tmp_path: Path) -> None:
    for name, content in (corpus.files() | corpus.attacks()).items():
        path = tmp_path / name
        path.write_bytes(content)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = within(megabytes, "inspect", str(path))
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        told = done.stderr.splitlines()
        assert done.returncode in (0, 2, memory.EXIT_CODE), (name, told)
        assert done.returncode == 0 or len(told) == 1, (name, told)
        assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < LONGEST, name


def test_lack_is_seen_behind_what_it_was_taken_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def behind(cause: Exception) -> Exception:
        try:
            try:
                raise cause
            except Exception:
                raise DataError("damaged", "x.csv") from None
        except DataError as error:
            return error

    monkeypatch.setattr(memory, "memory_is_limited", lambda: True)
    assert memory.lacked(behind(MemoryError()))
    assert memory.lacked(behind(ImportError("libarrow.so: failed to map segment from shared object")))
    assert memory.lacked(behind(OSError(errno.ENOMEM, "x")))
    assert not memory.lacked(behind(ImportError("no module named x")))
    assert not memory.lacked(DataError("bad_alloc.csv is no table"))
