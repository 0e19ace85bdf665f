"""One case in this process, with limits; what is wrong with how it ended."""

import contextlib
import gc
import io
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import FrameType
from unittest import mock

from dashpot import quantities
from dashpot.app import cli
from dashpot.channel import Channel
from dashpot.data.readers import guarded, read
from dashpot.data.readers.modes import read_modes
from dashpot.errors import DashpotError
from dashpot.estimate.result import Estimate
from dashpot.io.atomic import PART
from dashpot.model.rigfile import default_channels, parse_rig, read_rig
from dashpot.study.scenario import scenarios
from dashpot.study.studyfile import read_study
from tests.fuzz import corpus
from tests.fuzz.cases import Case

SECONDS = 5.0  # of processor time, after which Ctrl-C is sent; a case that only reads then hangs
OBEYS = 2.0  # seconds of processor time in which Ctrl-C ends a run
FACTORS = {  # how many times as long a run may take that shows a terminal how it goes on
    "identify": 6,  # a search without guesses on a rig that does not fit
    "compare": 6,
    "check": 6,  # with data it identifies first
    "response": 6,  # through all folds, of a rig that is driven as hard as it may be
}
QUIET = ("--quiet", "-q")  # options that forbid to show how it goes on
MEMORY = 1 << 30  # bytes beside those that this process had at its start
CODES = {0, 2, 3, 4}
MOST_LINES = 40  # on stderr
PLACE = "/dev/shm" if os.path.isdir("/dev/shm") else None  # folders of cases; one of a disk costs 2 ms
_PASSING_TIME = re.compile(r"\d:\d\d:\d\d")  # beside the bar, whenever it is drawn: seconds gone by
DRAWN = 20  # times, ten a second, that bars are drawn in a run of more than SECONDS
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


class Hang(BaseException):
    """The time is up."""


@dataclass(frozen=True)
class Outcome:
    """How a case ended.

    what  what is wrong with that: a signature that is the same for the same fault; None where all is well
    slow  whether it took over SECONDS: stopped then by Ctrl-C, and run once more to its end
    """

    what: str | None
    slow: bool = False


@dataclass(frozen=True)
class _Run:
    """What a run gave: its exit code, or what it raised; the text of both streams; whether Ctrl-C was sent."""

    code: int | None
    fault: str | None
    out: str
    err: str
    strangers: tuple[str, ...]
    interrupted: bool


class _Terminal(io.StringIO):
    """A stream that is watched."""

    def isatty(self) -> bool:
        return True


def limit_memory() -> None:
    """Let this process have MEMORY beside what it has."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, hard))


def finding(case: Case) -> str | None:
    """What is wrong with how a case ends; None where all is well."""
    return outcome(case).what


def outcome(case: Case, guard: bool = True) -> Outcome:
    """How a case ends.

    Without `guard` native code reads in this process, which no fork delays and which counts its time and memory.
    What is wrong then is the library's; what dashpot makes of it shows with the guard, and that is what counts.  A hang
    counts as it is.

    Over SECONDS of processor time it gets Ctrl-C, and has to end at once with nothing half-written.  Then it is run
    again before a terminal: it has to show how it goes on, and to end within what FACTORS grant its command.
    """
    guards = guarded.GUARDED
    with (
        mock.patch.dict(os.environ, {cli.TRACEBACK: "1"}),
        mock.patch.object(guarded, "GUARDED", guards and guard),
    ):
        ended = _outcome(case)
    if guard or ended.what is None or ended.what.startswith("hang"):
        return ended
    return outcome(case)


def _outcome(case: Case) -> Outcome:
    with _folder_of(case):
        run = _run(case, SECONDS, io.StringIO())
        what = _wrong(case, run)
    if not run.interrupted or what is not None:
        return Outcome(what, run.interrupted)
    factor = FACTORS.get(case.arguments[0], 1)
    watched = replace(case, arguments=tuple(word for word in case.arguments if word not in QUIET))
    with _folder_of(case):
        run = _run(watched, SECONDS * factor, _Terminal(), interrupted=False)
    if run.fault is None and len(_PASSING_TIME.findall(run.err)) < DRAWN:
        return Outcome(f"no progress in {case.arguments[0]}", slow=True)
    return Outcome(run.fault, slow=True)


@contextlib.contextmanager
def _folder_of(case: Case) -> Iterator[None]:
    """Inside a new folder with the files of a case."""
    folder = tempfile.mkdtemp(prefix="dashpot-fuzz-", dir=PLACE)
    try:
        with contextlib.chdir(folder):
            for name, content in case.files.items():
                Path(name).write_bytes(content)
            yield
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run(case: Case, seconds: float, err: io.StringIO, interrupted: bool = True) -> _Run:
    """Run a case in this folder; where it is to be `interrupted`, Ctrl-C comes after so many seconds, else Hang."""
    out, fault, code = io.StringIO(), None, None
    reads = case.arguments[0] in READERS
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), _strangers() as strangers:
        try:
            with _time_limit(seconds, interrupted and not reads) as sent:
                code = _read(case.arguments) if reads else cli.run(case.arguments)
        except Hang as error:
            fault = f"{'deaf to Ctrl-C' if sent else 'hang'} in {_place(error)}"
        except BaseException as error:
            fault = f"{type(error).__name__} in {_place(error)}"
        if not guarded.GUARDED:
            gc.collect()  # what libraries say when their objects go belongs to this case
            gc.freeze()  # what stays is not looked through again
    return _Run(code, fault, out.getvalue(), err.getvalue(), tuple(strangers), bool(sent))


def _wrong(case: Case, run: _Run) -> str | None:
    told = run.err.splitlines()
    if run.fault is not None:
        return run.fault
    if run.interrupted and run.code != cli.INTERRUPTED and run.code not in CODES:
        return f"exit code {run.code} after Ctrl-C"
    if not run.interrupted and run.code not in CODES:
        return f"exit code {run.code}"
    if any("not enough memory" in line for line in told):
        gc.collect()
        return "memory"
    if run.strangers:
        return f"a library writes to stderr: {run.strangers[0]}"
    if run.code == 2 and not told:
        return "refused without a word"
    if len(told) > MOST_LINES:
        return f"{len(told) // 100 * 100 or MOST_LINES} lines and more on stderr"
    if any("Traceback" in line or "internal error" in line for line in told):
        return "internal error"
    for kind, text in (("stdout", run.out), ("stderr", run.err)):
        if _CONTROL.search(text):
            return f"control character on {kind}"
    return _wrong_files(case, run.out)


def _read(arguments: Sequence[str]) -> int:
    """Only what reads the file: much faster than a command."""
    try:
        READERS[arguments[0]](*arguments[1:])
    except DashpotError as error:
        for problem in error.problems[:20]:
            print(f"dashpot: {problem}", file=sys.stderr)
        return 2
    return 0


@cache
def _channels() -> tuple[Channel, ...]:
    return parse_rig(corpus.BASE).channels


def _quantity(text: str) -> None:
    for parse in (quantities.fraction, quantities.frequency, quantities.band, quantities.frequencies):
        with contextlib.suppress(DashpotError):
            parse(text)
    for kind in ("displacement", "force", "mass"):
        with contextlib.suppress(DashpotError):
            quantities.quantity(text, kind)
    quantities.amount(text)


READERS: Mapping[str, Callable[..., object]] = {
    "@rig": lambda path: default_channels(read_rig(path).model),
    "@data": lambda path: read(path, _channels(), frequency_hz=2.0).spectrum(),
    "@modes": lambda path: read_modes(path, ("x1", "x2")),
    "@study": lambda path: scenarios(read_study(path)),
    "@estimate": lambda path: Estimate.load(path).to_json(),
    "@quantity": _quantity,
}


def _wrong_files(case: Case, out: str) -> str | None:
    for name, content in case.files.items():
        if Path(name).read_bytes() != content:
            return f"{name} was changed"
    left = [name for _, _, names in os.walk(".") for name in names if name.startswith(PART[0])]
    if left:
        return "a temporary file is left"
    texts = [path.read_bytes() for path in Path().glob("out*") if path.is_file()]
    for text in [*texts, out.encode("utf-8", "surrogateescape")]:
        if text.startswith((b"{\n", b"[\n")):
            try:
                json.loads(text, parse_constant=_refused)
            except ValueError as error:
                return f"JSON: {type(error).__name__}"
    return None


def _refused(constant: str) -> None:
    raise ValueError(constant)


@contextlib.contextmanager
def _strangers() -> Iterator[list[str]]:
    """What libraries write to the process's own stderr, past Python's: the first words of a line, once it is over."""
    words: list[str] = []
    with tempfile.TemporaryFile(dir=PLACE) as past:
        before = os.dup(2)
        os.dup2(past.fileno(), 2)
        try:
            yield words
        finally:
            sys.__stderr__ and sys.__stderr__.flush()
            os.dup2(before, 2)
            os.close(before)
            past.seek(0)
            lines = past.read(400).decode("utf-8", "replace").splitlines()
            words += [line[:40] for line in lines if line.strip()]


@contextlib.contextmanager
def _time_limit(seconds: float, interrupted: bool) -> Iterator[list[float]]:
    """Hang after so many seconds of processor time; or Ctrl-C then, once, and Hang where it is not obeyed.

    Gives a list that holds an entry once Ctrl-C has been sent.
    """
    sent: list[float] = []

    def end(_: int, __: FrameType | None) -> None:
        if interrupted and not sent:
            sent.append(time.process_time())
            signal.setitimer(signal.ITIMER_PROF, OBEYS)
            signal.raise_signal(signal.SIGINT)
            return
        signal.setitimer(signal.ITIMER_PROF, 1.0)  # again, where an `except` has caught it
        raise Hang

    # Under nohup, and in the background of a shell, Ctrl-C is ignored from the start.
    answers = (signal.SIGPROF, end), (signal.SIGINT, signal.default_int_handler)
    before = [signal.signal(number, answer) for number, answer in answers]
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield sent
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        for (number, _), answer in zip(answers, before, strict=True):
            signal.signal(number, answer)


def _place(error: BaseException) -> str:
    """The innermost line of dashpot that it passed, and what was called from there."""
    frames = [one for one in traceback.extract_tb(error.__traceback__) if one.filename != __file__]
    own = [frame for frame in frames if f"{os.sep}dashpot{os.sep}" in frame.filename]
    if not frames:
        return "no line of Python"
    last = own[-1] if own else frames[-1]
    return f"{Path(last.filename).name}:{last.name}"
