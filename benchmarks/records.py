"""Whole records against the bound of all samples: eight rigs and excitations, `python3 dev.py bench records`.

`--draws 2000` would settle 1 %; `--case 3` runs one of them, `--seed` other draws.  Nothing is told to dashpot but the
rig: noise, starting state and band are found.  The bound is that of all samples in time, white noise and the starting
state unknown.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the rigs of the tests
from tests.record_draws import CASES, draws


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=20, help="of each case")
    options.add_argument("--case", type=int, action="append", help="number of a case, from 0")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    held = []
    for number in given.case or range(len(CASES)):
        start = time.perf_counter()
        done = draws(CASES[number], given.draws, 1000 * given.seed + number)
        each = (time.perf_counter() - start) / given.draws
        held.append(done.held)
        share = 100 * np.mean(done.held, axis=0)
        range_of = f"{np.min(share):.1f} to {np.max(share):.1f} % of each parameter"
        to_bound = "" if CASES[number].coloured else f"rms / bound {done.rms_over_bound:.3f}, "
        print(
            f"{CASES[number].name}: {to_bound}rms / stated {done.rms_over_stated:.3f}, intervals hold "
            f"{np.mean(share):.1f} % ({range_of}), {each:.2f} s each",
            flush=True,
        )
    print(f"pooled: {100 * np.mean(np.concatenate([each.ravel() for each in held])):.1f} %")


if __name__ == "__main__":
    main()
