"""Whole records against the bound of all samples: eight rigs and excitations, `python3 dev.py bench records`.

`--draws 2000` would settle 1 %; `--case 3` runs one of them, `--seed` other draws.  Nothing is told to dashpot but the
rig: noise, starting state and band are found.  The bound is that of all samples in time, white noise and the starting
state unknown.  `--peers` runs the record of the benchmark of that name instead, whose bound knows that it starts from
rest.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the rigs of the tests
from dashpot.data.record import Record
from tests.record_draws import CASES, Draws, draws, draws_of
from tests.whole_rigs import WholeTest


def of_peers(count: int, seed: int) -> Draws:
    """The record of `bench peers`: the paper's rig stepped through CASE-3 from rest, 10 % noise, the base exact."""
    from benchmarks.peers import CHANNELS, NOISE, RIG, TRUE, stepped_sine

    made = stepped_sine()
    record = Record(CHANNELS, made.time, np.column_stack([made.values, made.base]))
    return draws_of(WholeTest(RIG, TRUE, record), NOISE, count, seed, from_rest=True)


def show(name: str, done: Draws, seconds: float, *, white: bool) -> None:
    """One line of figures."""
    share = 100 * np.mean(done.held, axis=0)
    range_of = f"{np.min(share):.1f} to {np.max(share):.1f} % of each parameter"
    to_bound = (
        f"rms / bound {done.rms_over_bound:.3f}, stated / bound {done.stated_over_bound:.3f}, "
        if white
        else ""
    )
    print(
        f"{name}: {len(done.error)} draws, {to_bound}rms / stated {done.rms_over_stated:.3f}, intervals hold "
        f"{np.mean(share):.1f} % ({range_of}), {seconds / len(done.error):.2f} s each",
        flush=True,
    )


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=20, help="of each case")
    options.add_argument("--case", type=int, action="append", help="number of a case, from 0")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--peers", action="store_true", help="the record of `bench peers`")
    given = options.parse_args()
    if given.peers:
        start = time.process_time()
        done = of_peers(given.draws, 1000 * given.seed)
        show("the peers' record", done, time.process_time() - start, white=True)
        return
    held = []
    for number in range(len(CASES)) if given.case is None else given.case:
        start = time.process_time()
        done = draws(CASES[number], given.draws, 1000 * given.seed + number)
        held.append(done.held)
        show(CASES[number].name, done, time.process_time() - start, white=not CASES[number].coloured)
    print(f"pooled: {100 * np.mean(np.concatenate([each.ravel() for each in held])):.1f} %")


if __name__ == "__main__":
    main()
