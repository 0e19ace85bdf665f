"""Reading long text files, beside pyarrow: `python3 dev.py bench reading`, or `--rows 1000000 --columns 6 --repeats 5`.

Both turn the same CSV into columns of doubles; dashpot also checks them, finds what each is and makes records in SI
units of it.  pyarrow runs once with one thread, as dashpot does, and once with all.

`--memory MIB` reads a file of that size in each format instead, `--packed` by gzip, each in a process of its own, and
tells what it needs beyond the samples that it gives.
"""

from __future__ import annotations

import argparse
import gzip
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.readers import read

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the writers of the tests
from tests.unit.data.readers.column_files import TABLES, famos, mdf, tdms, uff
from tests.unit.data.readers.written import mat73


def seconds(tasks: dict[str, Callable[[], object]], repeats: int) -> dict[str, tuple[float, float]]:
    """The medians of the times that tasks take when run in turn: by the clock, and of all processors."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in tasks}
    for _ in range(repeats):
        for name, task in tasks.items():
            start = time.perf_counter(), time.process_time()
            task()
            times[name].append((time.perf_counter() - start[0], time.process_time() - start[1]))
    return {
        name: (statistics.median(wall for wall, _ in each), statistics.median(cpu for _, cpu in each))
        for name, each in times.items()
    }


NAMES = ("x1", "x2", "u")
RATE = 1000.0
COLUMNS = 'columns = { x1 = "channel_1", x2 = "channel_2", u = "channel_3" }'
PEAK = f"""
import sys, threading, time
from pathlib import Path
from dashpot.channel import Channel
from dashpot.data.readers import read

def memory():  # without the pages of a file that is mapped, which the system takes back as it likes
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("RssAnon"))

def watch():
    while True:
        peak[0] = max(peak[0], memory())
        time.sleep(0.005)

channels = tuple(Channel(name, {{name: 1}}) for name in {NAMES})
read(sys.argv[1], channels)
before = memory()
peak = [before]
threading.Thread(target=watch, daemon=True).start()
records = read(sys.argv[2], channels).records
result = sum(record.values.nbytes + record.time.nbytes for record in records) / 2**20
print(result, peak[0] - before - result)
"""


def write_wav(path: Path, table: dict[str, Real]) -> None:
    from scipy.io import wavfile

    wavfile.write(path, int(RATE), np.column_stack([table[name] for name in NAMES]).astype(np.float32))


def write_text(path: Path, table: dict[str, Real], head: str, mark: str) -> None:
    """Numbers with every digit behind a head, apart by the mark."""
    options = pa.csv.WriteOptions(include_header=False, delimiter=mark)
    with path.open("wb") as file:
        file.write(head.encode())
        pa.csv.write_csv(pa.table(table), file, options)


LVM_HEAD = f"""LabVIEW Measurement\t
Separator\tTab
***End_of_Header***\t
\t
Channels\t{len(NAMES)}
Delta_X\t{"	".join([str(1 / RATE)] * len(NAMES))}
***End_of_Header***{"	" * len(NAMES)}
X_Value\t{"	".join(NAMES)}\tComment
"""


def _packed(path: Path) -> Path:
    """The file packed by gzip in its place, in pieces."""
    target = path.with_name(f"{path.name}.gz")
    with path.open("rb") as source, gzip.open(target, "wb", compresslevel=1) as packing:
        shutil.copyfileobj(source, packing, 1 << 24)
    path.unlink()
    return target


def channels_of(table: dict[str, Real]) -> dict[str, Real]:
    """Without the time, for formats that sample by themselves."""
    return {name: table[name] for name in NAMES}


WRITERS: dict[str, Callable[[Path, dict[str, Real]], object]] = {
    **{suffix.removeprefix("."): write for suffix, write in TABLES.items() if suffix != ".xlsx"},
    "7.3.mat": mat73,
    "csv": lambda path, table: pa.csv.write_csv(pa.table(table), path),
    "tdms": lambda path, table: tdms(path, channels_of(table), wf_increment=1 / RATE),
    "mf4": lambda path, table: mdf(path, channels_of(table), table["time_s"]),
    "uff": lambda path, table: uff(path, channels_of(table), table["time_s"]),
    "wav": write_wav,
    "lvm": lambda path, table: write_text(path, table, LVM_HEAD, "\t"),
    "txt": lambda path, table: write_text(path, table, " ".join(table) + "\n", " "),
    "raw": lambda path, table: famos(path, channels_of(table), 1 / RATE),
}


def show_memory(mebibytes: float, formats: list[str], packed: bool) -> None:
    """What reading a file of each format needs beyond the samples that it gives."""
    rows = int(mebibytes * 2**20 / (8 * (len(NAMES) + 1)))
    rng = np.random.default_rng(1)
    print(f"{rows} rows of {len(NAMES)} channels; MiB: file, samples, memory beyond them")
    for suffix in formats:
        with tempfile.TemporaryDirectory() as folder:
            paths = []
            for stem, count in (("small", 1000), ("large", rows)):
                path = Path(folder) / f"{stem}.{suffix}"
                columns = {name: rng.normal(size=count) for name in NAMES}
                WRITERS[suffix](path, {"time_s": np.arange(count) / RATE, **columns})
                if packed:
                    path = _packed(path)
                size = path.stat().st_size / 2**20
                if suffix == "wav":
                    path = path.with_name(f"{stem}.toml")
                    path.write_text(f'[[files]]\nname = "{stem}.wav*"\n{COLUMNS}\n')
                paths.append(str(path))
            done = subprocess.run(
                [sys.executable, "-c", PEAK, *paths], capture_output=True, text=True, check=False
            )
        said = done.stdout.split() or done.stderr.splitlines()[-1:]
        print(
            f"{suffix:8} {size:8.0f}",
            *(f"{float(word):8.0f}" for word in said) if done.stdout else said,
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--columns", type=int, default=6)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--memory", type=float, metavar="MIB")
    parser.add_argument("--formats", nargs="+", choices=tuple(WRITERS), default=list(WRITERS))
    parser.add_argument("--packed", action="store_true", help="with --memory: files that gzip has packed")
    chosen = parser.parse_args()
    if chosen.memory is not None:
        show_memory(chosen.memory, chosen.formats, chosen.packed)
        return
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
        times = seconds(tasks, chosen.repeats)
    print(f"{chosen.rows} rows of {chosen.columns + 1} columns, {size:.0f} MiB, median of {chosen.repeats}")
    alone_wall, alone_cpu = times["pyarrow, one thread"]
    for name, (wall, cpu) in times.items():
        print(
            f"{name:22} {wall:6.2f} s {wall / alone_wall:5.2f} x {size / wall:5.0f} MiB/s, "
            f"of processors {cpu:5.2f} s {cpu / alone_cpu:5.2f} x"
        )


if __name__ == "__main__":
    main()
