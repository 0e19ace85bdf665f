"""Time and memory of long whole records: the paper's rig on a base in random motion, four noisy channels.

`python3 dev.py bench long_records [--samples 1000000] [--band 1:20]`.  Processor time of one core; memory is the most
that the process held beyond what it held with the record alone.
"""

from __future__ import annotations

import argparse
import gc
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.estimate.identify import identify
from dashpot.model.observation import observation_model, transfer
from dashpot.reproduce.yamane1989 import paper_model, paper_prints, true_rig

RATE = 360.0  # samples a second, about 20 in a cycle of the faster mode
DRIVEN = 0.25  # of the rate: the base moves up to there
NOISE = 0.03  # of each channel's rms
BEGIN = 1000  # samples left out, so that the record begins and ends in motion
PIECE = 50_000  # lines at a time
PAGE = 4096


def long_record(samples: int, seed: int = 0) -> Record:
    """A piece of a motion that repeats only beyond its ends."""
    rng, channels = np.random.default_rng(seed), true_rig().channels
    theta = np.array(list(dict(paper_prints().values).values()))
    p = paper_model().parameters(theta)
    count = int(2 ** np.ceil(np.log2(1.05 * samples + BEGIN)))
    frequency_hz = np.fft.rfftfreq(count, 1 / RATE)
    driven = np.flatnonzero((frequency_hz > 0) & (frequency_hz < DRIVEN * RATE))
    shown = np.zeros((len(channels), len(frequency_hz)), dtype=np.complex128)
    for first in range(0, len(driven), PIECE):
        some = driven[first : first + PIECE]
        view = observation_model(paper_model(), channels, 2 * np.pi * frequency_hz[some])
        base = rng.normal(size=len(some)) + 1j * rng.normal(size=len(some))
        shown[:, some] = (transfer(view, p).G[..., 0] * base[:, None]).T
    values = np.empty((samples, len(channels)))
    for c, lines in enumerate(shown):
        values[:, c] = np.fft.irfft(lines, count)[BEGIN : BEGIN + samples]
        if c < len(channels) - 1:
            values[:, c] += NOISE * np.std(values[:, c]) * rng.normal(size=samples)
    return Record(channels, np.arange(samples) / RATE, values)


def held() -> float:
    """MiB that the process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 2**20


def most_held() -> float:
    """MiB that it has held at most since `forget`."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def forget() -> None:
    """Let `most_held` begin anew (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--band", help="Hz, low:high; without it what stands out of the noise")
    given = parser.parse_args()
    with ProcessPoolExecutor(1, get_context("spawn")) as other:  # which takes the memory of making it along
        record = other.submit(long_record, given.samples).result()
    gc.collect()
    before = held()
    forget()
    begin = time.process_time()
    if given.band is None:
        lines = spectrum([record])
    else:
        low, high = given.band.split(":")
        lines = spectrum([record], band_hz=(float(low), float(high)))
    made = time.process_time()
    found = identify(paper_model(), lines)
    end = time.process_time()
    print("| samples | lines | making lines, s | identify, s | record, MiB | beyond it at most, MiB |")
    print("|---|---|---|---|---|---|")
    size = (record.values.nbytes + record.time.nbytes) / 2**20
    print(
        f"| {given.samples:,} | {lines.lines:,} | {made - begin:.2f} | {end - made:.2f} | {size:.0f} | "
        f"{most_held() - before:.0f} |"
    )
    truth = np.array(list(dict(paper_prints().values).values()))
    print(f"\nFarthest from the truth: {np.max(np.abs(found.values - truth) / found.sd):.2f} sd")


if __name__ == "__main__":
    main()
