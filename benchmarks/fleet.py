"""A fleet of very many rigs: one worker and two, one of them killed in the middle, and what a cluster would need.

`python3 dev.py bench fleet`, or with `--rigs 100000` the size that is claimed (then each number of workers once).  One
table holds all data sets: two masses, 25 lines, four channels with 2 % noise and the base.
"""

from __future__ import annotations

import argparse
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

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
    from dashpot.model.channel_noise import with_relative_noise
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


def identify(data: Path, out: Path, workers: int, kill_at: int = 0) -> float:
    """Seconds of `dashpot fleet`; with `kill_at`, a worker is killed once so many blocks are there."""
    command = [sys.executable, "-m", "dashpot", "fleet", str(RIG), str(data), "--rig-column", "rig", "-q"]
    start = time.perf_counter()
    process = subprocess.Popen([*command, "--out", str(out), "--workers", str(workers)])
    blocks = Path(f"{out}.blocks")
    while kill_at and process.poll() is None:
        if len(list(blocks.glob("*.parquet"))) >= kill_at:
            victims = [
                pid
                for pid in children(process.pid)
                if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
            ]
            os.kill(victims[0], signal.SIGKILL)
            print(f"killed worker {victims[0]} of {len(victims)} after {kill_at} blocks", flush=True)
            break
        time.sleep(0.02)
    if process.wait() != 0:
        raise SystemExit("the run has failed")
    return time.perf_counter() - start


def per_task(data: Path) -> None:
    """What one task costs the worker, the wire and the one who shares the work out."""
    from dashpot import read_rig
    from dashpot.fleet.data_sets import of_tables
    from dashpot.fleet.identification import FleetTask, Treatment, identify_block

    rig, source = read_rig(RIG), of_tables([str(data)], "rig")
    stream = source.read()
    start = time.process_time()
    data_sets = [next(stream) for _ in range(2000)]
    reading = (time.process_time() - start) / 20  # of a task of 100
    task = FleetTask("key", rig, Treatment(), tuple(data_sets[:100]))
    identify_block(task)
    start = time.process_time()
    block = identify_block(task)
    working = time.process_time() - start
    there, back = len(pickle.dumps(task)), len(pickle.dumps(block))
    start = time.process_time()
    for _ in range(20):
        pickle.loads(pickle.dumps(task))
        pickle.loads(pickle.dumps(block))
    packing = (time.process_time() - start) / 20
    share = reading + packing / 2
    print(
        f"a task of 100 rigs: {working * 1e3:.0f} ms of a worker, {there / 1e3:.0f} kB there, "
        f"{back / 1e3:.0f} kB back, "
        f"{share * 1e3:.1f} ms of the process that shares out: enough for {working / share:.0f} workers"
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rigs", type=int, default=5000)
    rigs = parser.parse_args().rigs
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "fleet.parquet"
        write_fleet(data, rigs)
        print(f"{rigs} rigs, {data.stat().st_size / 1e6:.0f} MB", flush=True)
        per_task(data)
        outputs, times = [], {1: np.inf, 2: np.inf}
        for workers in (1, 2) * (2 if rigs <= TWICE_TO else 1):
            outputs.append(Path(folder) / f"out{len(outputs)}.parquet")
            seconds = identify(data, outputs[-1], workers)
            times[workers] = min(times[workers], seconds)
            print(f"{workers} workers: {seconds:.1f} s", flush=True)
        print(f"2 workers over 1: {times[1] / times[2]:.2f} times as fast")
        outputs.append(Path(folder) / "killed.parquet")
        seconds = identify(data, outputs[-1], 2, kill_at=max(rigs // (2 * block_size(rigs)), 2))
        print(
            f"2 workers, one killed in the middle: {seconds:.1f} s, {seconds / rigs * 1e3:.2f} ms a rig",
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
