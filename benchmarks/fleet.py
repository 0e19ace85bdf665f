"""A fleet of very many rigs: one worker and two, one of them killed in the middle, and what a cluster would need.

`python3 dev.py bench fleet`, or with `--rigs 100000` the size that is claimed (then each number of workers once).  One
table holds all data sets: two masses, 25 lines, four channels with 2 % noise and the base.  With `--files` each rig has
a Parquet file of its own.
"""

from __future__ import annotations

import argparse
import os
import pickle
import resource
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.fleet.runner import block_size

RIG = Path(__file__).parents[1] / "examples" / "07_studies" / "two_masses.toml"
TRUTH = {"m1": 3.0, "m2": 5.4, "c1": 30.0, "c2": 30.0, "c3": 60.0, "c4": 60.0}
TWICE_TO = 20_000  # rigs up to which one and two workers run twice


def write_fleet(path: Path, rigs: int) -> None:
    """Rigs whose parameters scatter by 3 %, as one Parquet table, in parts so that memory is bounded."""
    import pyarrow as pa
    import pyarrow.parquet as parquet

    from dashpot import read_rig
    from dashpot.model.observation import with_relative_noise
    from dashpot.study.simulate import dwells, simulate_spectrum

    rig, rng = read_rig(RIG), np.random.default_rng(0)
    model, channels = rig.model, with_relative_noise(rig.model, rig.channels, 0.02)
    test, writer = dwells(model, np.linspace(1, 25, 25), 56), None
    for first in range(0, rigs, 1000):
        parts = []
        for k in range(first, min(first + 1000, rigs)):
            theta = model.theta(TRUTH) * (1 + 0.03 * rng.standard_normal(len(TRUTH)))
            spectrum = simulate_spectrum(model, model.parameters(theta), channels, test, rng)
            columns = {"rig": np.full(spectrum.lines, f"r{k:06d}"), "frequency_hz": spectrum.frequency_hz}
            sd = spectrum.sd()
            for c, channel in enumerate(channels):
                z = spectrum.amplitudes[:, c]
                columns |= {
                    f"{channel.name}_re": z.real,
                    f"{channel.name}_im": z.imag,
                    f"{channel.name}_sd": sd[:, c],
                }
            parts.append(columns)
        table = pa.table({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
        writer = writer or parquet.ParquetWriter(path, table.schema)
        writer.write_table(table)
    assert writer is not None
    writer.close()


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@dataclass(frozen=True)
class Run:
    """What a run took, s: on the wall, of the processor for the process that shares work out and for its workers."""

    wall: float
    parent: float
    workers: float


def identify(data: Path, out: Path, workers: int, kill_at: int = 0) -> Run:
    """What `dashpot fleet` takes; with `kill_at`, a worker is killed once so many blocks are there."""
    command = [sys.executable, "-m", "dashpot", "fleet", str(RIG), "-q", "--out", str(out)]
    command += [str(data / "*.parquet")] if data.is_dir() else [str(data), "--rig-column", "rig"]
    before, start = processor_time(), time.perf_counter()
    process = subprocess.Popen([*command, "--workers", str(workers)])
    blocks = Path(f"{out}.blocks")
    own = 0.0
    while process.poll() is None:
        own = max(own, own_time(process.pid))
        if kill_at and len(list(blocks.glob("*.parquet"))) >= kill_at:
            victims = [
                pid
                for pid in children(process.pid)
                if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
            ]
            os.kill(victims[0], signal.SIGKILL)
            print(f"killed worker {victims[0]} of {len(victims)} after {kill_at} blocks", flush=True)
            kill_at = 0
        time.sleep(0.02)
    if process.wait() != 0:
        raise SystemExit("the run has failed")
    return Run(time.perf_counter() - start, own, processor_time() - before - own)


def processor_time() -> float:
    """Of all processes that this one has started and that have ended, s."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def own_time(pid: int) -> float:
    """Processor time of a process without its children, s; 0 once it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def per_task(data: Path) -> None:
    """What one task costs the worker, the wire and the one who shares the work out."""
    from dashpot import read_rig
    from dashpot.fleet.data_sets import Treatment, of_tables
    from dashpot.fleet.runner import FleetTask, identify_block

    rig = read_rig(RIG)
    next(of_tables([str(data)], "rig").blocks(1))  # loads what is needed
    start = time.process_time()
    source = of_tables([str(data)], "rig")
    names = (time.process_time() - start) / source.count
    start = time.process_time()
    blocks = list(source.blocks(1000))[:4]
    for block in blocks:
        for part in block:
            part.checksum()
    checksums = (time.process_time() - start) / source.count
    tasks = [FleetTask(k, rig, Treatment(), block) for k, block in enumerate(blocks)]
    identify_block(tasks[0])
    start = time.process_time()
    for task in tasks[1:]:
        result = identify_block(task)
    working = (time.process_time() - start) / sum(
        len(part.names) for task in tasks[1:] for part in task.parts
    )
    there, back = len(pickle.dumps(task)), len(pickle.dumps(result))
    start = time.process_time()
    for _ in range(20):
        pickle.loads(pickle.dumps(task))
        pickle.loads(pickle.dumps(result))
    packing = (time.process_time() - start) / 20 / len(result["name"])
    share = names + checksums + packing
    print(
        f"a task of 1,000 rigs: {working * 1e6:.0f} ms of a worker, {there / 1e3:.0f} kB there, "
        f"{back / 1e3:.0f} kB back, {share * 1e6:.1f} ms of the process that shares out (names {names * 1e6:.1f}, "
        f"checksums {checksums * 1e6:.1f}, messages {packing * 1e6:.1f}): enough for {working / share:.0f} workers"
    )


def written_apart(data: Path) -> Path:
    """The rigs of a table in a file each."""
    import pyarrow.parquet as parquet

    folder = data.with_suffix("")
    folder.mkdir()
    for number, batch in enumerate(parquet.ParquetFile(data).iter_batches(25)):
        parquet.write_table(pa_table(batch), folder / f"r{number:06d}.parquet")
    return folder


def pa_table(batch: Any) -> Any:
    """The rows of one rig without its name."""
    import pyarrow as pa

    return pa.Table.from_batches([batch]).drop_columns(["rig"])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rigs", type=int, default=5000)
    parser.add_argument("--files", action="store_true")
    given = parser.parse_args()
    rigs = given.rigs
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "fleet.parquet"
        write_fleet(data, rigs)
        print(f"{rigs} rigs, {data.stat().st_size / 1e6:.0f} MB", flush=True)
        per_task(data)
        if given.files:
            data = written_apart(data)
        outputs: list[Path] = []
        best: dict[int, Run] = {}
        for workers in (1, 2) * (2 if rigs <= TWICE_TO else 1):
            outputs.append(Path(folder) / f"out{len(outputs)}.parquet")
            run = identify(data, outputs[-1], workers)
            best[workers] = min(best.get(workers, run), run, key=lambda run: run.wall)
            print(
                f"{workers} workers: {run.wall:.1f} s; processor {run.parent:.2f} + {run.workers:.2f} s in workers",
                flush=True,
            )
        two = best[2]
        bound = best[1].parent / max((two.parent + two.workers) / 2, two.parent, two.workers / 2)
        print(
            f"2 workers over 1: {best[1].wall / two.wall:.2f} times as fast; by processor time {bound:.2f} at most"
        )
        outputs.append(Path(folder) / "killed.parquet")
        run = identify(data, outputs[-1], 2, kill_at=max(rigs // (2 * block_size(rigs)), 2))
        print(
            f"2 workers, one killed in the middle: {run.wall:.1f} s, {run.wall / rigs * 1e3:.2f} ms a rig",
            flush=True,
        )
        contents = {output.read_bytes() for output in outputs}
        print("all results are the same to the bit" if len(contents) == 1 else "THE RESULTS DIFFER")
        import pyarrow.parquet as parquet

        table = parquet.read_table(outputs[-1], columns=["name", "status"])
        print(
            f"{len(table)} rows, {len(set(table['name'].to_pylist()))} rigs, all converged: "
            f"{set(table['status'].to_pylist()) == {'converged'}}"
        )


if __name__ == "__main__":
    main()
