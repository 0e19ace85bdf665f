"""How often a fully seen rig ends in a wrong valley, and how often without a word.

`python3 dev.py bench valleys --draws 500`: so many random rigs of two to five coordinates at 20 % relative noise
each, and as many at 5 % of each channel's rms.  An end is wrong whose χ² lies above that of the minimum
beside the truth, where that minimum makes no part negative beyond doubt; it is silent if it is said to have converged
and nothing else is said to fit alike.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.automatic import identify_with_noise

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests import rigs
from tests.unit.estimate.test_automatic import beside_truth, chain, constant, told

ABOVE = 0.05  # of χ²: the same minimum


def outcome(rig: rigs.Rig, spectrum: Spectrum) -> str:
    """How one draw ended: "right", "wrong", "silent", "lower" than beside the truth, "unphysical" or "refused"."""
    try:
        best, estimate = beside_truth(rig, spectrum), identify_with_noise(rig.model, spectrum)[0]
    except DashpotError:
        return "refused"
    if not (bool(best.converged) and bool(np.all(best.values > -2 * best.noise_sd))):
        return "unphysical"
    above = float(estimate.fit.chi2 - best.fit.chi2)
    if above > ABOVE:
        return "wrong" if told(estimate) or not bool(estimate.converged) else "silent"
    return "lower" if above < -ABOVE else "right"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=20, help="of each kind and number of coordinates")
    options.add_argument("--first", type=int, default=1000, help="seed of the first")
    options.add_argument("--minutes", type=float, default=60.0, help="after which no other draw is begun")
    settings = options.parse_args()
    kinds: dict[str, Callable[[int, int], tuple[rigs.Rig, Spectrum]]] = {
        "20 % relative": chain, "5 % constant": constant,
    }  # fmt: skip
    counts = {(kind, n): dict.fromkeys(OUTCOMES, 0) for kind in kinds for n in (2, 3, 4, 5)}
    start, used = time.perf_counter(), time.process_time()
    for seed in range(settings.first, settings.first + settings.draws):
        if time.perf_counter() - start > 60 * settings.minutes:
            break
        for (kind, n), count in counts.items():
            count[outcome(*kinds[kind](seed, n))] += 1
    print(f"{'':22}" + "".join(f"{name:>12}" for name in OUTCOMES))
    for (kind, n), count in counts.items():
        print(f"{kind}, n = {n:4}      " + "".join(f"{count[name]:12}" for name in OUTCOMES))
    total = sum(sum(count.values()) for count in counts.values())
    wrong = sum(count["wrong"] + count["silent"] for count in counts.values())
    silent = sum(count["silent"] for count in counts.values())
    print(f"{total} draws, {wrong} wrong ({100 * wrong / max(total, 1):.2f} %), {silent} silent")
    print(f"{(time.process_time() - used) / max(total, 1):.2f} s of processor time a draw")


OUTCOMES = ("right", "wrong", "silent", "lower", "unphysical", "refused")

if __name__ == "__main__":
    main()
