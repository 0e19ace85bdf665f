"""Processes that answer calls to the engine: begun ahead, so that they are ready, and ended at once where asked."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

SPARE = 2  # processes that wait for a call: for one job, and for what the page asks meanwhile
LOST = "the process that computed this has ended unexpectedly; try again, with fewer data if memory is short"


@dataclass(frozen=True)
class Failure:
    """Why a call gave no answer: {"text", "line"} of each problem, and the exit code that the command would have."""

    problems: tuple[dict[str, Any], ...]
    code: int = 2


class Worker:
    """A process of the engine, which answers one call after the other."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "dashpot.app.serve.engine"]
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            encoding="utf-8",
            start_new_session=True,  # so that Ctrl-C ends it with the server, and a Cancel with all that it began
        )

    def answer(self, call: Mapping[str, Any], hears: Callable[[Mapping[str, Any]], None]) -> Failure | None:
        """Have a call answered; `hears` is called with its progress and results.  Why it failed, or None."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write(json.dumps(call) + "\n")
            self.process.stdin.flush()
            for line in self.process.stdout:
                event = json.loads(line)
                if "failed" in event:
                    return Failure(tuple(event["failed"]["problems"]), event["failed"]["code"])
                if "done" in event:
                    return None
                hears(event)
        except OSError:
            pass
        return Failure(({"text": LOST, "line": None},), 1)

    @property
    def alive(self) -> bool:
        """Whether it can take a call."""
        return self.process.poll() is None

    def end(self) -> None:
        """End it at once, with all that it has begun."""
        if hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
        else:
            self.process.kill()
        self.process.wait()


@dataclass
class Job:
    """A call under way: what it does, how far it is, and the worker that can be ended."""

    call: str
    what: str = ""
    done: int = 0
    total: int = 0
    began: float = field(default_factory=time.monotonic)
    stage: float = field(default_factory=time.monotonic)
    worker: Worker | None = None
    cancelled: bool = False

    def moved(self, what: str, done: int, total: int) -> None:
        """Note how far it is."""
        if what != self.what:
            self.stage = time.monotonic()
        self.what, self.done, self.total = what, done, total

    @property
    def share(self) -> float | None:
        """How much of the present stage is done; None if nobody knows."""
        return self.done / self.total if self.total else None

    @property
    def words(self) -> str:
        """What it does, since when, and how long it will take yet where that is known."""
        passed = time.monotonic() - self.began
        text = f"{self.what or self.call}: {passed:.0f} s"
        if self.share and self.share < 1:
            left = (time.monotonic() - self.stage) * (1 / self.share - 1)
            text += f", {100 * self.share:.0f} %, about {left:.0f} s left"
        return text

    def cancel(self) -> None:
        """End it; its call fails."""
        self.cancelled = True
        if self.worker is not None:
            self.worker.end()


class Engine:
    """Workers that wait, and those at work."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._idle: list[Worker] = []
        self._busy: set[Worker] = set()
        self._closed = False

    def prepare(self) -> None:
        """Begin workers ahead."""
        with self._lock:
            self._idle = [worker for worker in self._idle if worker.alive]
            while not self._closed and len(self._idle) < SPARE:
                self._idle.append(Worker())

    def run(
        self, call: Mapping[str, Any], hears: Callable[[Mapping[str, Any]], None], job: Job | None = None
    ) -> Failure | None:
        """Answer a call, in the thread of the caller; `job` can cancel it meanwhile."""
        with self._lock:
            self._idle = [each for each in self._idle if each.alive]
            worker = self._idle.pop() if self._idle else Worker()
            self._busy.add(worker)
        if job is not None:
            job.worker = worker
            if job.cancelled:
                worker.end()
        failure = worker.answer(call, hears)
        with self._lock:
            self._busy.discard(worker)
            kept = worker.alive and len(self._idle) < SPARE and not self._closed
            if kept:
                self._idle.append(worker)
        if not kept:
            worker.end()
        self.prepare()
        return failure

    def ask(self, call: Mapping[str, Any]) -> tuple[dict[str, Any], Failure | None]:
        """The last result of a call, and why it failed."""
        results: list[dict[str, Any]] = [{}]
        failure = self.run(call, lambda event: results.append(event["result"]) if "result" in event else None)
        return results[-1], failure

    def close(self) -> None:
        """End all workers."""
        with self._lock:
            self._closed = True
            workers = [*self._idle, *self._busy]
            self._idle.clear()
        for worker in workers:
            worker.end()
