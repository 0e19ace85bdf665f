"""Tracking: false alarms, the time and size of a 5 % fall, slow drift inside its intervals, bounded memory.

`python3 dev.py bench track [--series N] [--records N] [--samples N]`.  Series are windows of random information
matrices, as `tests/unit/numerics/test_random_walk.py` draws them (30 windows of 4 numbers); records are simulated
(`tests/unit/fleet/test_tracking.py`): one mass, 12 windows of 10 s, whose spring falls by 5 % in the middle.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
from scipy import signal

import dashpot
from dashpot.numerics.random_walk import trajectory
from tests.unit.fleet.test_tracking import RIG, segment
from tests.unit.numerics.test_random_walk import drawn

ALONE = """
import resource, sys, time
import dashpot
track = dashpot.track(dashpot.parse_rig(sys.argv[2]), sys.argv[1], 100.0)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(f"{len(track.start_s)} windows, {time.process_time():.0f} s of processor time, {peak:.0f} MiB in all")
"""


def alarms(series: int, level: float) -> None:
    """Series in which nothing changes."""
    rng, found = np.random.default_rng(1), 0
    for seed in range(series):
        found += bool(trajectory(drawn(rng, 30, 4)[0], false_alarms=level, seed=seed).changes)
    print(
        f"false alarms at {100 * level:g} %: {found} of {series} ({100 * found / series:.1f} %)", flush=True
    )


def drifts(series: int) -> None:
    """Series that walk by so much from window to window; a window alone knows 0.27."""
    for speed in (0.02, 0.05, 0.15, 0.3):
        rng, held, abrupt = np.random.default_rng(2), [], 0
        for seed in range(series):
            windows, true = drawn(rng, 30, 4, speed)
            found = trajectory(windows, seed=seed)
            held.append(np.mean(np.abs(found.values - true) < 1.96 * found.sd))
            abrupt += any(change.window for change in found.changes)
        spread = np.std(held) / series**0.5
        print(
            f"drift of {speed:g}: 95 % intervals hold {100 * np.mean(held):.1f} ± {100 * spread:.1f} %; "
            f"a step is announced in {abrupt} of {series}",
            flush=True,
        )


def falls(records: int) -> None:
    """Records whose spring falls by 5 % after 60 s."""
    rig, found, dated, others, z = dashpot.parse_rig(RIG), 0, 0, 0, []
    for seed in range(records):
        parts = [segment(k, 4.0, begin, 60.0, 2 * seed + half) for half, (k, begin) in
                 enumerate(((2000.0, 0.0), (1900.0, 60.0)))]  # fmt: skip
        track = dashpot.track(rig, parts, 10.0, seed=seed)
        its = [change for change in track.changes if change.name == "k" and change.kind == "abrupt"]
        others += len(track.changes) - len(its[:1])
        if its:
            found += 1
            dated += its[0].time95_s[0] <= 60.0 <= its[0].time95_s[1]
            z.append((its[0].size + 100.0) / its[0].sd)
    print(
        f"a fall of 5 %: found in {found} of {records}, its time in the interval in {dated}, error of its size "
        f"{np.mean(z):.2f} ± {np.std(z):.2f} sd, other changes {others}",
        flush=True,
    )


def memory(samples: int) -> None:
    """One long record in a Parquet file."""
    rate, rng = 200.0, np.random.default_rng(3)
    force = 10 * signal.sosfilt(signal.butter(6, 20, fs=rate, output="sos"), rng.standard_normal(samples))
    system = ([[0, 1], [-1000.0, -2.0]], [[0], [0.5]], [[-1000.0, -2.0]], [[0.5]])
    A, B, C, D, _ = signal.cont2discrete(tuple(map(np.array, system)), 1 / rate, method="foh")
    above, below = signal.ss2tf(A, B, C, D)
    moved = signal.lfilter(above[0], below, force) + 0.05 * rng.standard_normal(samples)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.parquet"
        parquet.write_table(pa.table({"time_s": np.arange(samples) / rate, "a": moved, "f": force}), path)
        done = subprocess.run(
            [sys.executable, "-c", ALONE, path, RIG], capture_output=True, text=True, check=True
        )
    print(f"{samples} samples: {done.stdout.strip()}", flush=True)


def main() -> None:
    """Print all of it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--series", type=int, default=500)
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--samples", type=int, default=0)
    options = parser.parse_args()
    if options.samples:
        memory(options.samples)
    if options.series:
        alarms(options.series, 0.05)
        drifts(max(options.series // 10, 1))
    if options.records:
        falls(options.records)


if __name__ == "__main__":
    sys.exit(main())
