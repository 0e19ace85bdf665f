"""Work shared out to processes of this machine: a `map` for the layers below, which know of none."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

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
    at all, and waiting for them would leave a second Ctrl-C to hang in the interpreter's last breath.
    """
    if processes <= 1:
        yield map
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))  # spawned processes inherit it
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_ignore_interrupts)
    try:
        yield pool.map
    except BaseException:
        for process in list((pool._processes or {}).values()):  # Python 3.14 has a public name for this
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _ignore_interrupts() -> None:
    """Ctrl-C reaches the whole group; the parent alone answers it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
