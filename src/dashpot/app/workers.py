"""Work shared out to processes of this machine: a `map` for the layers below, which know of none."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from threading import Thread
from types import FrameType
from typing import Any

from dashpot.io.atomic import clear_away

PATIENCE = 3.0  # s, for a process that was told to end
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


def cores() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def one_thread() -> None:
    """Let BLAS compute on one thread, unless the user says otherwise; to be called before NumPy is imported.

    Matrices here are small and many: on cores that have other work, waking threads takes most of the time.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")


@contextmanager
def mapping(processes: int) -> Iterator[Map]:
    """A `map` over that many processes; with one, the built-in `map`.

    Processes are spawned, not forked, for forking a process with threads of BLAS in it may hang; each computes on one
    thread.  After an interruption or an error the processes are ended at once: what they compute is there whole or not
    at all, and waiting for them would leave a second Ctrl-C to hang in the interpreter's last breath.  They end by
    themselves when this process dies, however it does.
    """
    if processes <= 1:
        yield map
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))  # spawned processes inherit it
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin_worker)
    try:
        yield pool.map
    except BaseException:
        _hush_cancelled_futures()
        workers = list((pool._processes or {}).values())  # Python 3.14 has a public name for this
        for process in workers:
            process.terminate()
        for process in workers:
            process.join(PATIENCE)
            process.kill()
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _hush_cancelled_futures() -> None:
    """Keep the pool's own thread from printing a traceback where it meets futures that were cancelled under it."""
    import threading
    from concurrent.futures import InvalidStateError

    usual = threading.excepthook

    def hook(failure: threading.ExceptHookArgs) -> None:
        if not issubclass(failure.exc_type, InvalidStateError):
            usual(failure)

    threading.excepthook = hook


def _begin_worker() -> None:
    """What a worker does first: it ends when it is told to or its parent dies, and clears its files away.

    Ctrl-C reaches the whole group; the parent alone answers it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end_worker)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_worker(number: int, _: FrameType | None) -> None:
    clear_away()
    os._exit(128 + number)


def _end_with_parent() -> None:
    """Wait until the parent is no more, then end: by the signal, and where that is not answered, at once."""
    from multiprocessing import connection, parent_process

    parent = parent_process()
    if parent is None:
        return
    connection.wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(PATIENCE)
    clear_away()
    os._exit(1)
