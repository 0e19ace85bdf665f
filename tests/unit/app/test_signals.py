"""Signals that come at an awkward moment."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

# Each has a work of its own in place of the command's, and is ended in it by the signals that it is given.
PROGRAM = """
import os, signal, sys, tempfile, time, weakref
from multiprocessing import util
from dashpot.app import cli
from dashpot.app.workers import mapping
from dashpot.io import atomic

numbers = [getattr(signal, name) for name in sys.argv[1:]]

def end(number=numbers[0]):
    os.kill(os.getpid(), number)

{work}

if __name__ == "__main__":
    cli.cli.main = work
    cli.main()
"""
WORKS = {
    # What is raised in the callback of a weak reference is lost, so the signal is raised again.
    "within a callback of the interpreter": """
class Node: ...

def work(*args, **options):
    node = Node()
    watched = weakref.ref(node, lambda _: (end(), time.sleep(0.1)))
    del node
    time.sleep(30)
""",
    # A library whose import was cut off by a signal fails when it is imported again.
    "caught by a library that fails then": """
def work(*args, **options):
    try:
        end()
        signal.pause()
    except BaseException:
        pass
    raise RuntimeError("half imported")
""",
    "swallowed by a library": """
def work(*args, **options):
    try:
        end()
        time.sleep(20)
    except BaseException:
        pass
    time.sleep(20)
""",
    # A worker cut off from what it needs to begin would complain of it.
    "while workers begin": """
begin = util.spawnv_passfds

def begun_and_ended(path, args, handles):
    process = begin(path, args, handles)
    end()
    return process

def work(*args, **options):
    util.spawnv_passfds = begun_and_ended
    with mapping(2) as mapper:
        list(mapper(abs, range(8)))
""",
    # What has just been made and not yet noted would stay: the lock of a folder, a folder of files in between.
    "while files are made and noted": """
same, make = os.path.samestat, tempfile.mkdtemp

def work(*args, **options):
    os.path.samestat = lambda *given: (end(), end(), same(*given))[2]
    tempfile.mkdtemp = lambda **given: (make(**given), end())[0]
    with atomic.locked("."), atomic.scratch():
        time.sleep(20)
""",
    # A thread that is begun for it, and cut off by the next signal, had left a traceback.
    "swallowed again and again": """
def work(*args, **options):
    for number in 30 * numbers:
        try:
            end(number)
            time.sleep(20)
        except BaseException:
            pass
    time.sleep(20)
""",
}


def ended(folder: Path, work: str, *names: str) -> subprocess.CompletedProcess[str]:
    (folder / "ended.py").write_text(PROGRAM.replace("{work}", WORKS[work]), encoding="utf-8")
    words = [sys.executable, "ended.py", *names]
    between = folder / "between"
    between.mkdir()
    done = subprocess.run(
        words,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "TMPDIR": str(between)},
    )
    assert done.stderr.startswith("dashpot: ")
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert "no file is left half-written" in done.stderr
    assert [*folder.glob(".*"), *between.iterdir()] == []
    return done


@pytest.mark.skipif(sys.platform == "win32", reason="signals come otherwise there")
@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
@pytest.mark.parametrize("work", WORKS)
def test_a_stop_at_an_awkward_moment_is_one_line(tmp_path: Path, work: str, name: str, code: int) -> None:
    assert ended(tmp_path, work, name).returncode == code


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no alarm wakes the process")
@pytest.mark.parametrize("names", [["SIGTERM", "SIGINT"], ["SIGINT", "SIGHUP", "SIGTERM"]])
def test_of_several_requests_one_is_answered(tmp_path: Path, names: list[str]) -> None:
    done = ended(tmp_path, "swallowed again and again", *names)
    assert done.returncode in {128 + getattr(signal, name) for name in names}


BEGUN = """
import signal, sys
from dashpot import __main__ as entry
from dashpot.app import cli
from dashpot.app.process import end_on_signals

def command():
    print(signal.getsignal(signal.SIGINT))
    end_on_signals()
    then = signal.getsignal(signal.SIGINT)
    print(getattr(then, "__name__", then))

cli.main = command
signal.signal(signal.SIGINT, eval(sys.argv[1]))
entry.run_command()
"""


@pytest.mark.parametrize(
    ("before", "first", "then"), [("signal.default_int_handler", "0", "_end"), ("signal.SIG_IGN", "1", "1")]
)
def test_ctrl_c_is_quiet_until_it_can_be_answered(before: str, first: str, then: str) -> None:
    done = subprocess.run([sys.executable, "-c", BEGUN, before], capture_output=True, text=True, timeout=300)
    told = done.stdout.replace("Handlers.SIG_DFL", "0").replace("Handlers.SIG_IGN", "1")
    assert told.split("\n")[:2] == [first, then]


ENDED_TWICE = """
import os, signal, time
from dashpot.app import cli
from dashpot.io.atomic import write_bytes

def parts():
    yield b"half"
    try:
        os.kill(os.getpid(), signal.SIGHUP)
        time.sleep(20)
    finally:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(20)

cli.cli.main = lambda *_, **__: write_bytes("out", parts())
cli.main()
"""


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="there is no SIGHUP")
def test_a_second_signal_ends_it_at_once_and_clears_away(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ENDED_TWICE], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert (done.returncode, done.stderr) == (128 + signal.SIGTERM, "")
    assert os.listdir(tmp_path) == []
