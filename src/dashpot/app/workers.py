"""Work shared out to processes of this machine: a `map` for the layers below, which know of none."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any

from dashpot.app.signals import ENDING, end_at_once, held_back
from dashpot.errors import UsageError

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor

PATIENCE = 3.0  # s, for a process that was told to end
AHEAD = 3  # tasks that wait for each process
MOST_KILLED = 3  # times in a row that processes may be killed before anything is finished
_NOTHING = object()
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
    themselves when this process dies, however it does.  A process that is killed costs what it was computing, which
    others compute again.  Results come as they are finished; work is taken up only a little ahead of the processes.
    """
    if processes <= 1:
        yield map
        return
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))  # spawned processes inherit it
    pool = _Pool(processes)
    try:
        yield pool.map
        pool.executor.shutdown(cancel_futures=True)
    except BaseException:
        pool.end()
        raise
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class _Pool:
    """Processes that share out work, and are replaced when one of them is killed."""

    def __init__(self, processes: int) -> None:
        self.processes = processes
        self.executor = self._begun()

    def _begun(self) -> ProcessPoolExecutor:
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        with held_back():  # its locks begin the process that clears them away
            return ProcessPoolExecutor(
                self.processes, mp_context=get_context("spawn"), initializer=_begin_worker
            )

    def map(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Any]:
        """What the function makes of each task, in the order in which that is finished.

        Raises UsageError where processes are killed again and again before anything is finished.
        """
        from concurrent.futures.process import BrokenProcessPool

        waiting = iter(tasks)
        pending: dict[Future[Any], Any] = {}
        lost: list[Any] = []
        killed = 0
        # The pool's own thread fills it.  To wait on the futures themselves takes their locks, and a signal between
        # taking one and noting that it is taken would let that thread wait for it for ever.
        finished: SimpleQueue[Future[Any]] = SimpleQueue()
        while True:
            while lost or len(pending) < AHEAD * self.processes:
                task = lost.pop() if lost else next(waiting, _NOTHING)
                if task is _NOTHING:
                    break
                try:
                    with held_back():  # the pool begins its processes as they are needed
                        future = self.executor.submit(function, task)
                        pending[future] = task
                        future.add_done_callback(finished.put)
                except BrokenProcessPool:  # killed since the last result
                    lost.append(task)
                    break
            if not pending and not lost:
                return
            if pending:
                future = finished.get()
                task = pending.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    lost.append(task)
                else:
                    killed = 0
                    yield result
                    continue
            killed += 1
            self._begin_again(killed)
            lost += pending.values()  # they broke with the rest
            pending.clear()
            finished = SimpleQueue()

    def _begin_again(self, killed: int) -> None:
        """Other processes in place of these, of which some were killed; raises UsageError after MOST_KILLED times."""
        if killed > MOST_KILLED:
            raise UsageError(
                f"worker processes were killed {killed} times in a row, before they had finished anything",
                cure="the memory may be too small: give fewer processes",
            )
        self.end()
        self.executor = self._begun()

    def end(self) -> None:
        """End the processes at once, then the thread that looks after them; a signal meanwhile waits until then.

        Were that thread left to the interpreter's end, which waits for it, this would at times wake it through a pipe
        it has just closed, and print a traceback (also in Python 3.13).  It reads results to their end: of one that a
        process was ended in the middle of, nothing more comes, which it learns once nobody can write.
        """
        with held_back():
            _hush_cancelled_futures()
            keeper: Thread | None = self.executor._executor_manager_thread  # type: ignore[assignment]  # stubs err
            results: Any = self.executor._result_queue
            workers = list(
                (self.executor._processes or {}).values()
            )  # Python 3.14 has a public name for this
            for process in workers:
                process.terminate()
            deadline = time.monotonic() + PATIENCE
            for process in workers:
                process.join(max(deadline - time.monotonic(), 0.0))
                process.kill()
            if results is not None:
                results._writer.close()
            self.executor.shutdown(wait=False, cancel_futures=True)
            if keeper is not None:
                keeper.join(PATIENCE)


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
    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, end_at_once)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait until the parent is no more, then end: by the signal, and where that is not answered, at once."""
    from multiprocessing import connection, parent_process

    parent = parent_process()
    if parent is None:
        return
    connection.wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(PATIENCE)
    end_at_once(signal.SIGTERM, None)
