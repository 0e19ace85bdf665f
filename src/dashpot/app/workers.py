"""Work shared out to processes of this machine: a `map` for the layers below, which know of none."""

from __future__ import annotations

import os
import platform
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any

from dashpot.app.memory import one_thread, secure_room
from dashpot.app.signals import ENDING, end_at_once, held_back
from dashpot.errors import UsageError
from dashpot.io.json_document import optional_library
from dashpot.numerics.blas_threads import THREADS

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor


PATIENCE_WORKERS = 3.0  # s, for a process that was told to end
AHEAD = 3  # tasks that wait for each process
MOST_KILLED = 3  # times in a row that processes may be killed before anything is finished
_NOTHING = object()
Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


def cores() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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
            deadline = time.monotonic() + PATIENCE_WORKERS
            for process in workers:
                process.join(max(deadline - time.monotonic(), 0.0))
                process.kill()
            if results is not None:
                results._writer.close()
            self.executor.shutdown(wait=False, cancel_futures=True)
            if keeper is not None:
                keeper.join(PATIENCE_WORKERS)


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
    secure_room()


def _end_with_parent() -> None:
    """Wait until the parent is no more, then end: by the signal, and where that is not answered, at once."""
    from multiprocessing import connection, parent_process

    parent = parent_process()
    if parent is None:
        return
    connection.wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(PATIENCE_WORKERS)
    end_at_once(signal.SIGTERM, None)


# Work shared out to the processes of a cluster by Dask: a `map` for the layers below, which know of none.
#
# Dask is an extra, and imported only when it is asked for.


LOCAL = "local"
PATIENCE = 20.0  # s, for a scheduler to answer


@contextmanager
def shared_out(dask: str | None, processes: int | None, small: bool) -> Iterator[Map]:
    """A `map` over a cluster where one is named, else over processes of this machine.

    Where their number is not given, it is that of the cores, and one for work so `small` that more cost more.
    """
    if processes is None:
        processes = 1 if small and dask is None else cores()
    if dask is None:
        with mapping(processes) as mapper:
            yield mapper
        return
    with cluster_mapping(dask, processes) as mapper:
        yield mapper


@contextmanager
def cluster_mapping(address: str, processes: int | None = None) -> Iterator[Map]:
    """A `map` over the workers of the scheduler at `address`, or over that many processes of this machine ("local").

    A worker that is lost costs the tasks it was at, which others compute again.  Raises UsageError where Dask is not
    installed, no scheduler answers, it has no workers, or they have another version of dashpot.
    """
    distributed = optional_library("distributed", "scale", "a Dask cluster")
    if address == LOCAL:
        one_thread()
        cluster = distributed.LocalCluster(
            n_workers=processes or cores(),
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=50,
        )
        with cluster, distributed.Client(cluster) as client:
            yield _mapper(distributed, client)
        return
    with _client(distributed, address) as client:
        _require_alike(client, address)
        yield _mapper(distributed, client)


def _client(distributed: Any, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=PATIENCE)
    except (OSError, ValueError, TypeError) as error:
        cause = " ".join(str(error).split())[:150]
        raise UsageError(
            f"the Dask scheduler does not answer ({cause})",
            address,
            "start one: dask scheduler, and workers: dask worker ADDRESS --nworkers auto --nthreads 1",
        ) from None


def state() -> dict[str, str]:
    """What the numbers that a process computes depend on beside its tasks."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        version_here = version("dashpot")
    except PackageNotFoundError:
        version_here = "none"
    return {
        "dashpot": version_here,
        "NumPy": version("numpy"),
        "SciPy": version("scipy"),
        "machine": platform.machine(),
    }


def _require_alike(client: Any, address: str) -> None:
    """Raises UsageError where there are no workers, or some would compute other numbers."""
    workers = client.run(state)
    if not workers:
        raise UsageError(
            "the scheduler has no workers", address, "start some: dask worker ADDRESS --nthreads 1"
        )
    wanted = state()
    for worker, has in workers.items():
        for name, value in wanted.items():
            if has.get(name) != value:
                raise UsageError(
                    f"the worker {worker} has {name} {has.get(name)}, here it is {value}",
                    address,
                    "install the same versions on all machines",
                )


def _mapper(distributed: Any, client: Any) -> Map:
    def mapped(function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Any]:
        waiting = iter(tasks)
        finished = distributed.as_completed(with_results=False)

        def submit() -> bool:
            for task in waiting:
                finished.add(client.submit(function, task, pure=False))
                return True
            return False

        ahead = AHEAD * max(sum(client.nthreads().values()), 1)
        while finished.count() < ahead and submit():
            pass
        for future in finished:
            try:
                result = future.result()
            except distributed.KilledWorker as error:
                raise UsageError(
                    f"workers were killed several times at the same task ({str(error)[:100]})",
                    cure="their memory may be too small: start fewer on each machine",
                ) from None
            future.release()
            submit()
            yield result

    return mapped
