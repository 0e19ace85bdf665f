"""Work shared out to the processes of a cluster by Dask: a `map` for the layers below, which know of none.

Dask is an extra, and imported only when it is asked for.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from dashpot.app.workers import AHEAD, Map, cores, mapping, one_thread
from dashpot.errors import UsageError
from dashpot.io.optional import optional_library

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
            n_workers=processes or cores(), threads_per_worker=1, processes=True, dashboard_address=None,
            silence_logs=50,
        )  # fmt: skip
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
            f"the Dask scheduler does not answer ({cause})", address,
            "start one: dask scheduler, and workers: dask worker ADDRESS --nworkers auto --nthreads 1",
        ) from None  # fmt: skip


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
                    f"the worker {worker} has {name} {has.get(name)}, here it is {value}", address,
                    "install the same versions on all machines",
                )  # fmt: skip


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
