"""What the system asks of a process: signals that end it, and memory that it limits (`ulimit -v`, `ulimit -d`).

Signals are raised as exceptions, so that what is being written is cleared away.  None may be lost, and none may come
where nothing can answer it with one line.  Of memory there must be room for the libraries, and errors of too little.
"""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import re
import shutil
import signal
import sys
import textwrap
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Timer, current_thread, main_thread
from types import FrameType

import click

from dashpot.errors import DashpotError
from dashpot.io.atomic import clear_away, postponed
from dashpot.numerics.blas_threads import THREADS

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
ANSWERED = (*ENDING, signal.SIGINT)

_asked: set[int] = set()  # signals that were raised as exceptions and have had no answer yet
_latest: weakref.ref[Ended] | None = None


def tell(line: str, *, err: bool = True) -> None:
    """A line on stderr (or stdout), which a terminal shows broken between words, not within them."""
    if (sys.stderr if err else sys.stdout).isatty():
        width = shutil.get_terminal_size().columns
        line = textwrap.fill(line, width, break_long_words=False, break_on_hyphens=False)
    click.echo(line, err=err)


class Ended(BaseException):
    """A signal asks this process to end; raised so that what is being written is cleared away on the way out.

    Whoever catches it and goes on, as some libraries do while they are imported, lets it go without an answer: the
    signal then comes again.
    """

    number = 0  # of one that another signal has cut off while it was made

    def __init__(self, number: int) -> None:
        global _latest
        super().__init__(number)
        self.number = number
        _latest = weakref.ref(self)

    def __del__(self) -> None:
        global _latest
        _latest = None
        if self.number in _asked:
            _come_again()


def end_on_signals() -> None:
    """SIGTERM, SIGHUP and Ctrl-C end the run, unless the caller has them ignored (nohup) or answers them himself.

    Not Python's own answer to Ctrl-C: a KeyboardInterrupt that a library catches, as pandas does while it is imported,
    is lost without a trace.
    """
    for number in ANSWERED:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _end)
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, _again)
    sys.unraisablehook = _without_requests


def leave_signals() -> None:
    """All is done and told: a signal that comes while the interpreter is taken down has nothing left to unwind.

    A second Ctrl-C may have come before the first had cleared all away.
    """
    clear_away()
    _asked.clear()
    for number in ANSWERED:
        if signal.getsignal(number) in (_end, end_at_once):
            signal.signal(number, signal.SIG_DFL)
    if _has_alarm():
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, signal.SIG_IGN)  # the interpreter would leave it to end the process


@contextmanager
def held_back() -> Iterator[None]:
    """While processes are begun: what asks this one to end waits until they have all that they need to begin.

    One that is cut off before that complains of it.  Ctrl-C, which reaches the whole group, waits in the new ones until
    they ignore it, for a mask is inherited.
    """
    if current_thread() is not main_thread() or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    came: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        came.append(number)

    before = {number: signal.getsignal(number) for number in ANSWERED}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    try:
        for number, handler in before.items():
            if handler not in (signal.SIG_IGN, None):
                signal.signal(number, note)
        # Its process inherits the mask, and lifts it but for SIGHUP: a terminal that closes does not end it before us.
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        with _without_complaint():
            resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_SETMASK, {*mask, signal.SIGINT})
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number in came:
            signal.raise_signal(number)


@contextmanager
def _without_complaint() -> Iterator[None]:
    """The process that clears away semaphores begins without a word of those that a sudden end leaves to it."""
    usual = os.environ.get("PYTHONWARNINGS")
    quiet = "ignore:resource_tracker:UserWarning"
    os.environ["PYTHONWARNINGS"] = f"{usual},{quiet}" if usual else quiet
    try:
        yield
    finally:
        if usual is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = usual


def end_at_once(number: int, _: FrameType | None) -> None:
    """End without unwinding, but for temporary files: where a signal has begun that already, and in workers."""
    if postponed(number):
        return
    clear_away()
    os._exit(128 + number)


def _on_its_way() -> bool:
    """Whether a request to end is being raised, and nobody has let it go."""
    return _latest is not None and _latest() is not None


def _end(number: int, frame: FrameType | None) -> None:
    if postponed(number):
        return
    if _on_its_way():
        end_at_once(number, frame)
    _asked.add(number)
    raise Ended(number)


def request_lost() -> Ended | None:
    """The request to end that some library has caught, so that what fails behind it is no fault of the program."""
    return Ended(next(iter(_asked))) if _asked else None


def answered() -> None:
    """The run unwinds and says so; what asks it once more ends it at once."""
    _asked.clear()
    if _has_alarm():
        signal.setitimer(signal.ITIMER_REAL, 0)
    for number in ANSWERED:
        if signal.getsignal(number) == _end:
            signal.signal(number, end_at_once)


def _without_requests(failure: sys.UnraisableHookArgs) -> None:
    """No word of a request to end that came within a destructor or a callback of the interpreter: it comes again."""
    if not isinstance(failure.exc_value, Ended):
        sys.__unraisablehook__(failure)


def _come_again() -> None:
    """A moment later: raised at once, it would be lost in the same place.

    By an alarm, where there is one.  A thread cannot be begun safely here: a second signal may come meanwhile.
    """
    moment_s = 0.01
    if _has_alarm():
        signal.setitimer(signal.ITIMER_REAL, moment_s)
        return
    again = Timer(moment_s, _again)
    again.daemon = True
    with suppress(RuntimeError):  # no thread can be begun any more
        again.start()


def _has_alarm() -> bool:
    """Whether an alarm is ours to set: not where the system has none, nor in another program that uses this one."""
    return hasattr(signal, "setitimer") and signal.getsignal(signal.SIGALRM) == _again


def _again(*_: object) -> None:
    """Raise a signal that has had no answer, unless another one is being answered by now."""
    if _asked and not _on_its_way():
        signal.raise_signal(next(iter(_asked)))


# Bytes of address space for the libraries of one command on Linux x86-64: measured, 415 MB once they are imported with
# one thread; identify unguarded failed under a limit of 500 MB and worked under 520 MB
ROOM = 512 << 20
EXIT_CODE = 5
CURE = "raise the limit (ulimit -v), or give fewer frequencies, draws or samples at a time"
_LACK = re.compile(
    r"cannot allocate|unable to allocate|failed to map|bad_alloc|out of memory"
    r"|resource temporarily unavailable|can't start new thread",
    re.IGNORECASE,
)


class NotEnoughMemoryError(DashpotError):
    """The system gives this process less memory than the work takes."""

    exit_code = EXIT_CODE


def memory_is_limited() -> bool:
    """Whether the caller limits the address space or the data of this process; false where no such limit exists."""
    try:
        import resource
    except ImportError:  # Windows
        return False
    limits = (getattr(resource, name, None) for name in ("RLIMIT_AS", "RLIMIT_DATA"))
    return any(
        limit is not None and resource.getrlimit(limit)[0] != resource.RLIM_INFINITY for limit in limits
    )


def one_thread() -> None:
    """Let BLAS compute on one thread, unless the user says otherwise; to be called before NumPy is imported.

    Matrices here are small and many: on cores that have other work, waking threads takes most of the time.
    Where memory is limited nothing states otherwise, for each thread takes buffers of its own; Arrow, which ends the
    process where its own pool finds no room, takes the system's.
    """
    if memory_is_limited():
        os.environ.update(
            dict.fromkeys((*THREADS, "ARROW_IO_THREADS"), "1"), ARROW_DEFAULT_MEMORY_POOL="system"
        )
    for name in THREADS:
        os.environ.setdefault(name, "1")


def secure_room() -> None:
    """Where memory is limited: let BLAS take its buffers before anything else can take their place.

    OpenBLAS asks for ever for a buffer that it does not get, within C, where no signal is answered.  Raises
    NotEnoughMemoryError if the limit leaves too little for the libraries.
    """
    if not memory_is_limited():
        return
    try:
        mmap.mmap(-1, ROOM, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS).close()
    except OSError:
        what = f"not enough memory: the libraries need {ROOM >> 20} MB of address space, and the limit leaves less"
        raise NotEnoughMemoryError(what, cure="raise the limit (ulimit -v)") from None
    # Threads share the memory of the C library (glibc): each would reserve 64 to 128 MB of address space.
    with suppress(OSError, TypeError, AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(-8, 1)  # M_ARENA_MAX of its malloc.h
    import numpy as np
    from scipy.linalg import blas  # SciPy brings a BLAS of its own

    ones = np.ones((128, 128))  # which BLAS multiplies in its buffer; matrices of 64 rows do without
    ones @ ones
    blas.dgemm(1.0, ones, ones)


def lacked(error: BaseException) -> bool:
    """Whether an error, or one that it was raised from, is a lack of memory, however a library words it."""
    behind: BaseException | None = error
    while behind is not None:
        if (
            isinstance(behind, MemoryError | NotEnoughMemoryError)
            or getattr(behind, "errno", None) == errno.ENOMEM
        ):
            return True
        if not isinstance(behind, DashpotError) and memory_is_limited() and _LACK.search(str(behind)):
            return True
        before = behind
        behind = behind.__cause__ or behind.__context__
        if behind is before:  # raised from itself
            break
    return False
