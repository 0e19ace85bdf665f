"""Damaged inputs of every kind through the command, for as long as wanted: python3 dev.py fuzz --help."""

import argparse
import contextlib
import io
import json
import os
import selectors
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

from tests.fuzz.cases import Case, made
from tests.fuzz.runner import finding, limit_memory, outcome

FINDINGS = Path(__file__).parent / "findings"
STUCK = 60.0  # s of processor time without a word from a worker, which is then in code that no signal ends
TOO_LONG = ("hang", "deaf", "no progress", "the process", "memory")  # findings that are kept as they are
ASLEEP = 300.0  # s without a word from a worker and without work, which then waits for something


def main() -> int:
    parser = argparse.ArgumentParser(prog="dev.py fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=50_000, help="how many; 50,000 unless given")
    parser.add_argument("--minutes", type=float, help="stop then, whatever the number")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--processes", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--keep", type=Path, default=FINDINGS, help="folder of the findings")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.worker:
        return _work(chosen.seed, chosen.first, chosen.inputs, chosen.processes)
    return Campaign(
        chosen.seed, chosen.first, chosen.inputs, chosen.processes, chosen.minutes, chosen.keep
    ).run()


def _work(seed: int, first: int, end: int, step: int) -> int:
    """Every `step`-th case from `first` on; a line of JSON before each, and one for each finding."""
    warnings.simplefilter("ignore")
    tell = os.fdopen(os.dup(1), "w", encoding="ascii")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # a case may write to /dev/stdout
    for index in range(first, end, step):
        case = made(seed, index)
        if index == first:
            limit_memory()  # once what is needed is loaded
        print(json.dumps({"begins": index}), file=tell, flush=True)
        ended = outcome(case)
        if ended.slow or ended.what is not None:
            said = {"index": index, "what": ended.what, "slow": ended.slow}
            print(json.dumps(said), file=tell, flush=True)
    print(json.dumps({"begins": -1}), file=tell, flush=True)
    return 0


class Word:
    """What a worker said last: the case that it begins, and when."""

    def __init__(self, process: int, index: int, running: bool) -> None:
        self.process, self.index, self.running = process, index, running
        self.moment, self.spent = time.monotonic(), self._processor_time()
        self.busy = 0.0

    def overdue(self) -> bool:
        """Whether the next word should have come: by the processor's time, for others may keep it busy."""
        busy = self._processor_time() - self.spent
        if busy > self.busy:
            self.moment, self.busy = time.monotonic(), busy
        return time.monotonic() - self.moment > ASLEEP or busy > STUCK

    def _processor_time(self) -> float:
        """Seconds of the worker on the processor; 0 where it has ended."""
        try:
            fields = Path(f"/proc/{self.process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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
        self.selector = selectors.DefaultSelector()
        self.heard: dict[subprocess.Popen[str], Word] = {}
        for k in range(processes):
            self._start(first + k)

    def _start(self, first: int) -> None:
        if first >= self.end:
            return
        words = [
            "--worker",
            "--seed",
            self.seed,
            "--first",
            first,
            "--inputs",
            self.end,
            "--processes",
            self.step,
        ]
        command = [sys.executable, "-m", "tests.fuzz", *map(str, words)]
        worker = subprocess.Popen(
            command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True
        )
        assert worker.stdout is not None
        self.selector.register(worker.stdout, selectors.EVENT_READ, worker)
        self.heard[worker] = Word(worker.pid, first, False)

    def run(self) -> int:
        """Exit code 1 where something was found."""
        began = shown = time.monotonic()
        while self.heard and time.monotonic() < self.until:
            for key, _ in self.selector.select(timeout=1.0):
                self._hear(key.data)
            for worker, word in list(self.heard.items()):
                if word.overdue():
                    worker.kill()
                    self._ended(worker, word.index, "hang that no signal ends")
            now = time.monotonic()
            if now - shown > 30:
                shown = now
                print(
                    f"{self.done} inputs, {len(self.found)} kinds of findings, {now - began:.0f} s",
                    flush=True,
                )
        for worker in self.heard:
            worker.kill()
        print(f"{self.done} inputs in {time.monotonic() - began:.0f} s, {len(self.found)} kinds of findings")
        if self.slow:
            print(f"{len(self.slow)} slow, with progress and obedient to Ctrl-C: {str(self.slow)[1:-1]}")
        for what, indices in sorted(self.found.items(), key=lambda item: -len(item[1])):
            print(
                f"{len(indices):6} {what}: {_keep(made(self.seed, indices[0]), what, self.keep)}", flush=True
            )
        return 1 if self.found else 0

    def _hear(self, worker: subprocess.Popen[str]) -> None:
        line = worker.stdout.readline()
        word = self.heard[worker]
        if not line:
            self._ended(worker, word.index, f"the process ended with {worker.wait()}")
            return
        said = json.loads(line)
        if "what" in said:
            if said["slow"]:
                self.slow.append(said["index"])
            if said["what"] is not None:
                self._found(said["what"], said["index"])
            return
        self.done += word.running
        self.heard[worker] = Word(worker.pid, said["begins"], True)
        if said["begins"] == -1:
            self.selector.unregister(worker.stdout)
            del self.heard[worker]

    def _ended(self, worker: subprocess.Popen[str], index: int, what: str) -> None:
        assert worker.stdout is not None
        self.selector.unregister(worker.stdout)
        del self.heard[worker]
        self._found(what, index)
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
