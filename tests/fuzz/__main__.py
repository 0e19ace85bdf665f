"""Damaged inputs of every kind through the command, for as long as wanted: python3 dev.py fuzz --help."""

import argparse
import contextlib
import faulthandler
import gc
import io
import os
import resource
import signal
import sys
import time
import warnings
from dataclasses import replace
from multiprocessing.connection import Connection, Pipe, wait
from pathlib import Path

from tests.fuzz import corpus
from tests.fuzz.cases import Case, made
from tests.fuzz.runner import finding, limit_memory, outcome

FINDINGS = Path(__file__).parent / "findings"
STUCK = 60.0  # s of processor time without a word from a worker, which is then in code that no signal ends
TOO_LONG = ("hang", "deaf", "no progress", "the process", "memory")  # findings that are kept as they are
ASLEEP = 300.0  # s without a word from a worker and without work, which then waits for something
GUARDED = (
    8  # of so many cases one is read behind the guard of native code at once, the others where they fail
)


def main() -> int:
    parser = argparse.ArgumentParser(prog="dev.py fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=50_000, help="how many; 50,000 unless given")
    parser.add_argument("--minutes", type=float, help="stop then, whatever the number")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--processes", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--keep", type=Path, default=FINDINGS, help="folder of the findings")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")
    return Campaign(
        chosen.seed, chosen.first, chosen.inputs, chosen.processes, chosen.minutes, chosen.keep
    ).run()


class Worker:
    """A process forked where all is loaded, which tries every `step`-th case from `first` on.

    It says ("begins", number) before each, ("found", what, slow) where something is wrong, and ("begins", None) at the
    end.  The first case is read behind the guard where it has ended another worker.
    """

    def __init__(self, seed: int, cases: range, guarded: bool) -> None:
        self.words, theirs = Pipe(duplex=False)
        self.index, self.begun, self.ended = cases[0], False, False
        self.guarded = cases[0] if guarded else None
        sys.stdout.flush()
        self.process = os.fork()
        if self.process == 0:
            code = 70  # of a worker that failed itself
            try:
                _work(theirs, seed, cases, guarded)
                code = 0
            finally:
                os._exit(code)
        theirs.close()
        self._listen()

    def heard(self, index: int | None) -> None:
        """It begins a case, or has come to the end."""
        self.index, self.begun, self.ended = self.index if index is None else index, True, index is None
        self._listen()

    def _listen(self) -> None:
        self.moment, self.spent, self.busy = time.monotonic(), self._processor_time(), 0.0

    def overdue(self) -> bool:
        """Whether the next word should have come: by the processor's time, for others may keep it busy."""
        busy = self._processor_time() - self.spent
        if busy > self.busy:
            self.moment, self.busy = time.monotonic(), busy
        return time.monotonic() - self.moment > ASLEEP or busy > STUCK

    def end(self) -> int:
        """End it, where it has not ended; its exit code, below zero that of a signal."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.process, signal.SIGKILL)
        self.words.close()
        return os.waitstatus_to_exitcode(os.waitpid(self.process, 0)[1])

    def _processor_time(self) -> float:
        """Seconds of the worker on the processor; 0 where it has ended."""
        try:
            fields = Path(f"/proc/{self.process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _work(tell: Connection, seed: int, cases: range, guarded: bool) -> None:
    silent = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):  # a case may write to /dev/stdout
        os.dup2(silent, stream)
    faulthandler.disable()
    gc.freeze()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limit_memory()
    for index in cases:
        tell.send(("begins", index))
        ended = outcome(made(seed, index), index % GUARDED == 0 or (guarded and index == cases[0]))
        if ended.slow or ended.what is not None:
            tell.send(("found", ended.what, ended.slow))
    tell.send(("begins", None))


class Campaign:
    """Workers over the cases of a seed; findings gathered, made small and kept."""

    def __init__(
        self, seed: int, first: int, inputs: int, processes: int, minutes: float | None, keep: Path
    ) -> None:
        self.seed, self.end, self.step, self.keep = seed, first + inputs, processes, keep
        self.until = float("inf") if minutes is None else time.monotonic() + 60 * minutes
        self.found: dict[str, list[int]] = {}
        self.slow: list[int] = []  # that took over the limit, were interrupted and then run to their end
        self.done = 0
        self.workers: dict[Connection, Worker] = {}
        corpus.files()  # which every worker finds made
        corpus.attacks()
        for k in range(processes):
            self._start(first + k)

    def _start(self, first: int, guarded: bool = False) -> None:
        if first < self.end:
            worker = Worker(self.seed, range(first, self.end, self.step), guarded)
            self.workers[worker.words] = worker

    def run(self) -> int:
        """Exit code 1 where something was found."""
        began = shown = time.monotonic()
        while self.workers and time.monotonic() < self.until:
            for words in wait([*self.workers], timeout=1.0):
                self._hear(self.workers[words])
            for worker in list(self.workers.values()):
                if worker.overdue():
                    self._ended(worker, "hang that no signal ends")
            now = time.monotonic()
            if now - shown > 30:
                shown = now
                print(
                    f"{self.done} inputs, {len(self.found)} kinds of findings, {now - began:.0f} s",
                    flush=True,
                )
        for worker in self.workers.values():
            worker.end()
        print(f"{self.done} inputs in {time.monotonic() - began:.0f} s, {len(self.found)} kinds of findings")
        if self.slow:
            print(f"{len(self.slow)} slow, with progress and obedient to Ctrl-C: {str(self.slow)[1:-1]}")
        for what, indices in sorted(self.found.items(), key=lambda item: -len(item[1])):
            print(
                f"{len(indices):6} {what}: {_keep(made(self.seed, indices[0]), what, self.keep)}", flush=True
            )
        return 1 if self.found else 0

    def _hear(self, worker: Worker) -> None:
        try:
            what, *said = worker.words.recv()
        except EOFError:
            self._ended(worker)
            return
        if what == "found":
            fault, slow = said
            if slow:
                self.slow.append(worker.index)
            if fault is not None:
                self._found(fault, worker.index)
            return
        self.done += worker.begun
        worker.heard(*said)
        if worker.ended:
            worker.end()
            del self.workers[worker.words]

    def _ended(self, worker: Worker, what: str | None = None) -> None:
        """A worker that goes no further; native code that has ended it alone is tried again behind its guard."""
        code, index = worker.end(), worker.index
        del self.workers[worker.words]
        if what is None and index % GUARDED and index != worker.guarded:
            self._start(index, guarded=True)
            return
        self.done += 1
        self._found(what or f"the process ended with {code}", index)
        self._start(index + self.step)

    def _found(self, what: str, index: int) -> None:
        """Note a finding; the first of its kind is said at once, for a campaign may take hours."""
        if what not in self.found:
            print(f"input {index}: {what}", flush=True)
        self.found.setdefault(what, []).append(index)


def _keep(case: Case, what: str, folder: Path) -> str:
    """Write the case, made small, into the folder; its name."""
    with contextlib.redirect_stdout(io.StringIO()):
        case = case if what.startswith(TOO_LONG) else _small(case, what)
    case = replace(case, what=what)
    folder.mkdir(exist_ok=True)
    (folder / f"{case.name}.json").write_text(case.to_json(), encoding="ascii")
    return case.name


def _small(case: Case, what: str) -> Case:
    """Without the options and lines that the finding does not need."""
    if finding(case) != what:
        return case
    for size in (2, 1):
        at = 1
        while at < len(case.arguments):
            fewer = replace(case, arguments=case.arguments[:at] + case.arguments[at + size :])
            if finding(fewer) == what:
                case = fewer
            else:
                at += 1
    for name in case.files:
        if (
            finding(without := replace(case, files={n: c for n, c in case.files.items() if n != name}))
            == what
        ):
            case = without
            continue
        lines = case.files[name].splitlines(keepends=True)
        size = max(len(lines) // 2, 1)
        while size:
            at = 0
            while at < len(lines):
                rest = lines[:at] + lines[at + size :]
                fewer = replace(case, files={**case.files, name: b"".join(rest)})
                if finding(fewer) == what:
                    lines, case = rest, fewer
                else:
                    at += size
            size //= 2
    return case


if __name__ == "__main__":
    sys.exit(main())
