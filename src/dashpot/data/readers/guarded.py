"""Libraries that only some formats need, each in a process of its own, and what damaged files do to them."""

from __future__ import annotations

import faulthandler
import gc
import io
import logging
import math
import os
import re
import signal
import sys
import time
import warnings
import weakref
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import replace
from functools import partial
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from dashpot.data.readers.arrays import ArrayColumns, Streamed, pieces_of
from dashpot.data.readers.datafile import DataFile, most_unpacked
from dashpot.errors import DashpotError, DataError
from dashpot.io.words import shown

# Work of foreign native code in a process of its own, so that an abort, a hang or its memory costs one answer.
#
# The process is forked where it is needed, which takes some milliseconds where a new interpreter takes a second;
# what it runs has been imported before, and touches no threads.  Other systems than Linux cannot fork safely: there
# `GUARDED` is False, and the work is done here.


if sys.platform == "linux":
    import resource
    from multiprocessing.connection import Connection, Pipe

    GUARDED = True
else:
    GUARDED = False

SECONDS = 4.0  # of processor time for one answer, and one more for each MiB of the file
ASLEEP = 4.0  # s that it may sleep on end, waiting neither for a processor nor for a disk


# Pipes to processes that live: a later one inherits them, and must not hold them open when they are to end.
_pipes: weakref.WeakSet[Connection] = weakref.WeakSet()


class Answers(Protocol):
    """What a process does for another one: it answers requests, and puts away at the end what it has opened."""

    def __call__(self, request: Any, /) -> Any: ...

    def close(self) -> None: ...


class Child:
    """A process that answers requests by a function, one after another, until it is let go.

    source  the file that it reads, for messages
    memory  bytes that it may ask for beyond what this process has
    size    bytes of the file
    """

    def __init__(self, answer: Answers, source: str, memory: int, size: int) -> None:
        self.source, self.seconds = source, SECONDS + size / 2**20
        self.pipe, theirs = Pipe()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", DeprecationWarning
                )  # of threads, which the answers do not touch
                self.process = os.fork()
        except OSError as error:
            what = f"no process could be started to read it ({error.strerror})"
            raise DataError(what, source, "free memory, or end other programs") from None
        if self.process == 0:
            for pipe in (self.pipe, *_pipes):
                pipe.close()
            _serve(answer, theirs, memory, self.seconds)
        theirs.close()
        _pipes.add(self.pipe)
        self.end = weakref.finalize(self, _end, self.process, self.pipe, os.getpid())

    def ask(self, request: object) -> Any:
        """The answer to a request.

        Raises what the function raised, and DataError where the process died, asked for too much or took too long.
        """
        try:
            self.pipe.send(request)
            awake, spent = time.monotonic(), ""
            while not self.pipe.poll(ASLEEP / 20):
                state, now = self._state()
                if state != "S" or now != spent:
                    awake, spent = time.monotonic(), now
                elif time.monotonic() - awake > ASLEEP:
                    self.end()
                    raise DataError("the library that reads it hangs", self.source, "it may be damaged")
            fine, answer = self.pipe.recv()
        except (EOFError, OSError):
            cause = self._cause()
            if cause == signal.SIGXCPU.name:
                what, cure = f"reading it took over {self.seconds:.0f} s", "it may be damaged"
            else:
                what = f"the library that reads it broke off ({cause})"
                cure = "it is damaged or asks for far more memory than its data need; save it again"
            raise DataError(what, self.source, cure) from None
        except MemoryError:
            fine, answer = False, MemoryError()
        if fine:
            return answer
        if isinstance(answer, MemoryError):
            what = "the file needs more memory than is available"
            raise DataError(what, self.source, "it may be damaged") from None
        raise answer

    def _state(self) -> tuple[str, str]:
        """The state of the process, S where it waits for neither a processor nor a disk, and the time it has spent."""
        text = Path(f"/proc/{self.process}/stat").read_text(encoding="ascii", errors="replace")
        fields = text.rpartition(")")[2].split()  # of proc(5), from the third on
        return fields[0], " ".join(fields[11:13])

    def _cause(self) -> str:
        """What ended the process."""
        status = self.end()
        if status is None or not os.WIFSIGNALED(status):
            return "without a reason"
        return signal.Signals(os.WTERMSIG(status)).name


def _end(process: int, pipe: Connection, owner: int) -> int | None:
    """Let a process end, by force where it is late; its status, as of waitpid."""
    if os.getpid() != owner:
        return None
    pipe.close()
    with suppress(ProcessLookupError, ChildProcessError):
        late = time.monotonic() + 1.0  # in which it puts away what it has opened
        while time.monotonic() < late:
            ended, status = os.waitpid(process, os.WNOHANG)
            if ended:
                return status
            time.sleep(1e-3)
        os.kill(process, signal.SIGKILL)
        return os.waitpid(process, 0)[1]
    return None


def _serve(answer: Answers, pipe: Connection, memory: int, seconds: float) -> None:
    """Answer until nobody asks any more; this function does not return, for all else belongs to the other process."""
    try:
        gc.freeze()  # what is there already is not looked through, nor copied for it
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the other process says when to end
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
            signal.signal(number, signal.SIG_DFL)
        faulthandler.disable()
        silent = os.open(os.devnull, os.O_RDWR)
        for stream in (1, 2):
            os.dup2(silent, stream)
        _lower(resource.RLIMIT_CORE, 0)
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        _lower(resource.RLIMIT_AS, pages * resource.getpagesize() + memory)
        while True:
            try:
                request = pipe.recv()
            except EOFError:
                answer.close()
                return
            spent = resource.getrusage(resource.RUSAGE_SELF)
            _lower(resource.RLIMIT_CPU, math.ceil(spent.ru_utime + spent.ru_stime + seconds))
            try:
                reply = True, answer(request)
            except (DashpotError, MemoryError) as error:
                reply = False, error
            except BaseException as error:  # panics of Rust are no Exception
                reply = False, RuntimeError(f"{type(error).__name__}: {error}")
            try:
                pipe.send(reply)
            except MemoryError:
                pipe.send((False, MemoryError()))
    finally:
        os._exit(0)


def _lower(kind: int, most: int) -> None:
    """Set a limit of this process, never above its hard one, nor above one of memory that holds."""
    soft, hard = resource.getrlimit(kind)
    holds = (soft, hard) if kind == resource.RLIMIT_AS else (hard,)
    resource.setrlimit(
        kind, (min([most, *(limit for limit in holds if limit != resource.RLIM_INFINITY)]), hard)
    )


Part = TypeVar("Part")
SMALL = 1 << 16  # numbers of a part up to which its columns come with it


def library(module: str, extra: str, source: str, what: str) -> Any:
    """An optional module, which writes nothing to stderr: what is wrong with a file is raised, in one line.

    Raises DataError that names the extra where it is not installed.
    """
    package = module.partition(".")[0]
    try:
        return import_module(module)
    except ImportError:
        cure = f'install it: pip install ".[{extra}]" from the copy of dashpot'
        raise DataError(f"to read {what}, {package} is needed", source, cure) from None
    finally:
        for name, logger in logging.root.manager.loggerDict.items():
            if name.partition(".")[0] == package and isinstance(logger, logging.Logger):
                logger.setLevel(logging.CRITICAL + 1)


@contextmanager
def damaged(source: str, what: str) -> Iterator[None]:
    """Whatever a library raises, in one line: files are not to be trusted."""
    try:
        yield
    except DashpotError:
        raise
    except MemoryError:
        raise DataError(
            f"the {what} file needs more memory than is available", source, "it may be damaged"
        ) from None
    except BaseException as error:  # a panic of Rust is no Exception
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        reason = re.sub(r"\s+", " ", str(error)).strip() or type(error).__name__
        raise DataError(
            f"the {what} file is damaged or cut off ({shown(reason, 100)})", source, "copy it again"
        ) from None


def guarded(file: DataFile, what: str, parts: Callable[[], Iterator[Part]]) -> Iterator[Part]:
    """The parts of a file of the format `what`, which a process of its own reads, as it does their columns later.

    Raises DataError, one line, where the library raises anything, aborts, hangs, or asks for more memory than the file
    can need.
    """
    answers = _Parts(parts(), file.name, what)
    most = 4 * most_unpacked(file.size)  # arrays, and the copies and texts made of them
    child = Child(answers, file.name, most, file.size) if GUARDED else None
    ask = answers if child is None else child.ask
    streams = count()

    def pieces(number: int, column: int) -> Iterator[Any]:
        stream = next(streams)
        try:
            while (piece := ask((stream, number, column))) is not None:
                yield piece
        finally:
            if child is None or child.end.alive:
                ask(("close", stream))

    for number in count():
        part, held = ask("part")
        if part is None:
            return
        if isinstance(part, ArrayColumns):
            columns = range(len(part.header))
            streamed = (Streamed(part.rows, partial(pieces, number, i)) for i in columns)
            part = replace(part, columns=tuple(held.get(i, each) for i, each in enumerate(streamed)))
        yield part


class _Parts:
    """What answers in the other process: the part that was asked for last, and the first, may be asked for columns."""

    def __init__(self, parts: Iterator[Any], source: str, what: str) -> None:
        self.parts, self.source, self.what = parts, source, what
        self.numbers = count()
        self.held: dict[int, ArrayColumns] = {}
        self.streams: dict[int, Iterator[Any]] = {}

    def close(self) -> None:
        """Let go of the parts, and so of the file."""
        self.held.clear()
        self.streams.clear()
        if isinstance(self.parts, Generator):
            self.parts.close()
        gc.collect()  # objects of asammdf hold each other, and a scratch file

    def __call__(self, request: Any, /) -> Any:
        """The next part and, of a small one, its columns; the next piece of a column; None if there is none."""
        # asammdf prints where it is slow
        with damaged(self.source, self.what), redirect_stdout(io.StringIO()):
            match request:
                case "part":
                    part, number = next(self.parts, None), next(self.numbers)
                    if not isinstance(part, ArrayColumns):
                        return part, {}
                    self.held = {k: held for k, held in self.held.items() if k == 0} | {number: part}
                    # Columns of a small part come with it, but those that cannot be read: nobody may ask for them
                    columns: dict[int, Any] = {}
                    small = part.rows * len(part.columns) <= SMALL
                    for i, column in enumerate(part.columns if small else ()):
                        with suppress(Exception):
                            values = np.concatenate(list(pieces_of(column)))
                            if values.shape == (part.rows,):
                                columns[i] = values
                    return replace(part, columns=()), columns
                case "close", stream:
                    self.streams.pop(stream, None)
                case stream, number, column:
                    if stream not in self.streams:
                        self.streams[stream] = pieces_of(self.held[number].columns[column])
                    return next(self.streams[stream], None)
        return None
