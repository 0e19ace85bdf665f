"""Reading long text files, beside pyarrow: `python3 dev.py bench reading`, or `--rows 1000000 --columns 6 --repeats 5`.

Both turn the same CSV into columns of doubles; dashpot also checks them, finds what each is and makes records in SI
units of it.  pyarrow runs once with one thread, as dashpot does, and once with all.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from dashpot.channel import Channel
from dashpot.data.readers import read


def seconds(task: Callable[[], object], repeats: int) -> float:
    """The median of the times that a task takes."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        task()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--columns", type=int, default=6)
    parser.add_argument("--repeats", type=int, default=5)
    chosen = parser.parse_args()
    names = [f"x{i + 1}" for i in range(chosen.columns)]
    rng = np.random.default_rng(1)
    columns = [np.arange(chosen.rows) / 1000, *rng.normal(size=(chosen.columns, chosen.rows))]
    channels = tuple(Channel(name, {name: 1}) for name in names)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "data.csv"
        pa.csv.write_csv(pa.table(columns, names=["time_s", *names]), path)
        size = path.stat().st_size / 2**20
        with_threads = pa.csv.ReadOptions(use_threads=True)
        alone = pa.csv.ReadOptions(use_threads=False)
        tasks: dict[str, Callable[[], object]] = {
            "pyarrow, one thread": lambda: pa.csv.read_csv(path, read_options=alone),
            "pyarrow, all threads": lambda: pa.csv.read_csv(path, read_options=with_threads),
            "dashpot": lambda: read(path, channels),
        }
        times = {name: seconds(task, chosen.repeats) for name, task in tasks.items()}
    print(f"{chosen.rows} rows of {chosen.columns + 1} columns, {size:.0f} MiB, median of {chosen.repeats}")
    for name, value in times.items():
        print(
            f"{name:22} {value:6.2f} s {value / times['pyarrow, one thread']:5.2f} x {size / value:5.0f} MiB/s"
        )


if __name__ == "__main__":
    main()
