"""Work shared out to processes of this machine or of a cluster: a `map` for the layers below, which know of none."""

from __future__ import annotations

import os
import platform
import signal
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from functools import partial
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from dashpot.app.process import ENDING, end_at_once, held_back, one_thread, secure_room
from dashpot.errors import UsageError
from dashpot.io.json_document import optional_library
from dashpot.numerics.blas_threads import THREADS

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

LOCAL = "local"  # in place of a scheduler's address: one is begun on this machine
PATIENCE = 20.0  # s, for a scheduler to answer
PATIENCE_WORKERS = 3.0  # s, for a process that was told to end
AHEAD = 3  # tasks that wait for each process
_NOTHING = object()
Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


def cores() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def shared_out(dask: str | None, processes: int | None, small: bool) -> Iterator[Map]:
    """A `map` over a cluster where one is named, else over processes of this machine.

    Where their number is not given, it is that of the cores, and one for work so `small` that more cost more.  Results
    come as they are finished; work is taken up only a little ahead of the processes.  A process that is killed costs
    what it was computing, which others compute again.
    """
    if processes is None:
        processes = 1 if small and dask is None else cores()
    with mapping(processes) if dask is None else cluster_mapping(dask, processes) as mapper:
        yield mapper


class Workers(ABC):
    """Whatever has tasks computed by other processes."""

    ahead: int  # tasks that are handed over before the first is finished

    @abstractmethod
    def submit(self, f: Callable[[Any], Any], task: Any, done: Callable[[Any], object]) -> Any:
        """A future of f(task), as those of concurrent.futures; `done` is called with it once it is finished."""

    @abstractmethod
    def renew(self, killed: int) -> None:
        """Begin other processes in place of those that were killed, for so many times in a row."""

    def map(self, f: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Any]:
        """What `f` makes of each task, in the order in which that is finished."""
        waiting = iter(tasks)
        pending: dict[Any, Any] = {}
        lost: list[Any] = []
        killed = 0
        # The executor's own thread fills it.  To wait on the futures themselves takes their locks, and a signal between
        # taking one and noting that it is taken would let that thread wait for it for ever.
        finished: SimpleQueue[Any] = SimpleQueue()
        while True:
            while lost or len(pending) < self.ahead:
                task = lost.pop() if lost else next(waiting, _NOTHING)
                if task is _NOTHING:
                    break
                try:
                    pending[self.submit(f, task, finished.put)] = task
                except BrokenExecutor:  # killed since the last result
                    lost.append(task)
                    break
            if not pending and not lost:
                return
            if pending:
                future = finished.get()
                task = pending.pop(future)
                try:
                    result = future.result()
                except BrokenExecutor:
                    lost.append(task)
                else:
                    killed = 0
                    yield result
                    continue
            killed += 1
            self.renew(killed)
            lost += pending.values()  # they broke with the rest
            pending.clear()
            finished = SimpleQueue()


@contextmanager
def mapping(processes: int) -> Iterator[Map]:
    """A `map` over that many processes; with one, the built-in `map`.

    Processes are spawned, not forked, for forking a process with threads of BLAS in it may hang; each computes on one
    thread.  After an interruption or an error the processes are ended at once: what they compute is there whole or not
    at all, and waiting for them would leave a second Ctrl-C to hang in the interpreter's last breath.  They end by
    themselves when this process dies, however it does.  The map raises UsageError if processes are killed again and
    again before anything is finished.
    """
    if processes <= 1:
        yield map
        return
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))  # spawned processes inherit it
    workers = Processes(processes)
    try:
        yield workers.map
        workers.executor.shutdown(cancel_futures=True)
    except BaseException:
        workers.end()
        raise
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


class Processes(Workers):
    """Processes of this machine."""

    def __init__(self, count: int) -> None:
        self.count, self.ahead = count, AHEAD * count
        self.executor = self._begun()

    def _begun(self) -> ProcessPoolExecutor:
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        with held_back():  # its locks begin the process that clears them away
            return ProcessPoolExecutor(self.count, get_context("spawn"), initializer=_begin_worker)

    def submit(self, f: Callable[[Any], Any], task: Any, done: Callable[[Any], object]) -> Any:
        """As Workers says; a signal meanwhile waits, for processes are begun as they are needed."""
        with held_back():
            future = self.executor.submit(f, task)
            future.add_done_callback(done)
            return future

    def renew(self, killed: int) -> None:
        """As Workers says.  Raises UsageError after MOST_KILLED times."""
        if killed > 3:  # times in a row that processes may be killed before anything is finished
            what = f"worker processes were killed {killed} times in a row, before they had finished anything"
            raise UsageError(what, cure="the memory may be too small: give fewer processes")
        self.end()
        self.executor = self._begun()

    def end(self) -> None:
        """End the processes at once, then the thread that looks after them; a signal meanwhile waits until then.

        Were that thread left to the interpreter's end, which waits for it, this would at times wake it through a pipe
        it has just closed, and print a traceback (also in Python 3.13).  It reads results to their end: of one that a
        process was ended in the middle of, nothing more comes, which it learns once nobody can write.
        """
        with held_back():
            # Keep the executor's own thread from printing a traceback where it meets futures that were
            # cancelled under it.
            from concurrent.futures import InvalidStateError

            usual = threading.excepthook

            def hook(failure: threading.ExceptHookArgs) -> None:
                if not issubclass(failure.exc_type, InvalidStateError):
                    usual(failure)

            threading.excepthook = hook
            keeper: threading.Thread | None = self.executor._executor_manager_thread  # type: ignore[assignment]  # stubs err
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


def _begin_worker() -> None:
    """What a worker does first: it ends when it is told to or its parent dies, and clears its files away.

    Ctrl-C reaches the whole group; the parent alone answers it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, end_at_once)
    threading.Thread(target=_end_with_parent, daemon=True).start()
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


# A cluster of Dask, an extra that is imported only when it is asked for.


@contextmanager
def cluster_mapping(address: str, processes: int | None = None) -> Iterator[Map]:
    """A `map` over the workers of the scheduler at `address`, or over that many processes of this machine ("local").

    Raises UsageError if Dask is not installed, no scheduler answers, it has no workers, they have another version of
    dashpot, or are killed several times at one task.
    """
    distributed = optional_library("distributed", "scale", "a Dask cluster")
    with ExitStack() as stack:
        if address == LOCAL:
            one_thread()
            # Without a dashboard; its usual port may be that of another cluster.
            how: dict[str, Any] = {"threads_per_worker": 1, "processes": True, "silence_logs": 50}
            how |= {"dashboard_address": None, "scheduler_kwargs": {"dashboard_address": "127.0.0.1:0"}}
            cluster = distributed.LocalCluster(n_workers=processes or cores(), **how)
            client = stack.enter_context(distributed.Client(stack.enter_context(cluster)))
        else:
            try:
                client = stack.enter_context(distributed.Client(address, timeout=PATIENCE))
            except (OSError, ValueError, TypeError) as error:
                cause = " ".join(str(error).split())[:150]
                cure = (
                    "start one: dask scheduler, and workers: dask worker ADDRESS --nworkers auto --nthreads 1"
                )
                raise UsageError(f"the Dask scheduler does not answer ({cause})", address, cure) from None
            workers = client.run(numbers_rest_on)
            if not workers:
                cure = "start some: dask worker ADDRESS --nthreads 1"
                raise UsageError("the scheduler has no workers", address, cure)
            for worker, has in workers.items():
                for name, value in numbers_rest_on().items():
                    if has.get(name) != value:
                        what = f"the worker {worker} has {name} {has.get(name)}, here it is {value}"
                        raise UsageError(what, address, "install the same versions on all machines")
        try:
            yield Cluster(client).map
        except distributed.KilledWorker as error:
            what = f"workers were killed several times at the same task ({str(error)[:100]})"
            raise UsageError(
                what, cure="their memory may be too small: start fewer on each machine"
            ) from None


class Cluster(Workers):
    """The workers of a cluster, whose scheduler gives the tasks of a lost one to others."""

    def __init__(self, client: Any) -> None:
        self.client, self.ahead = client, AHEAD * max(sum(client.nthreads().values()), 1)

    def submit(self, f: Callable[[Any], Any], task: Any, done: Callable[[Any], object]) -> Any:
        """As Workers says."""
        future = self.client.submit(f, task, pure=False)
        future.add_done_callback(done)
        return future

    def renew(self, killed: int) -> None:
        """Nothing: its futures do not break."""


def numbers_rest_on() -> dict[str, str]:
    """What the numbers that a process computes depend on, apart from its tasks."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        own = version("dashpot")
    except PackageNotFoundError:
        own = "none"
    libraries = {"NumPy": version("numpy"), "SciPy": version("scipy")}
    return {"dashpot": own, **libraries, "machine": platform.machine()}


Report = Callable[[int, int], None]
heard: ContextVar[Callable[[str, int, int], None] | None] = ContextVar("heard", default=None)


@contextmanager
def progress(what: str, quiet: bool = False) -> Iterator[Report]:
    """A function (done, all) that moves a bar; until it is called the bar runs to and fro next to the time elapsed.

    Without a terminal nothing is shown; where somebody has set `heard`, that is called with `what` and both.
    """
    hears = heard.get()
    if hears is not None:
        hears(what, 0, 0)
        yield partial(hears, what)
        return
    if quiet or not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    counted = "{task.fields[count]}"
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn(counted), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None, count="")

        def move(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, count=f"{done}/{total}")

        yield move
