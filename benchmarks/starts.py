"""How often maximum likelihood finds its own way: draws of six partly seen rigs, each searched from nothing.

`python3 dev.py bench starts`, or with `--draws 50` the number that is claimed.  A batch shares the valleys that its
first repeat finds; here every draw is identified alone, without guesses, and ends within 8 standard deviations of the
truth or elsewhere.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the rigs of the tests
from tests.partly_seen import BENCHES

FAR = 8.0


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=20, help="of each rig")
    draws = options.parse_args().draws
    total = 0
    for make in BENCHES:
        bench = make()
        spectrum = bench.spectrum(np.random.default_rng(11), draws)
        bound, home, start = bench.bound_sd(), 0, time.perf_counter()
        for k in range(draws):
            found = identify(
                bench.model, replace(spectrum, amplitudes=spectrum.amplitudes[k]), MaximumLikelihood()
            )
            away = np.max(np.abs(found.values - bench.psi) / bound)
            home += bool(found.converged) and bool(away < FAR)
        total += home
        each = (time.perf_counter() - start) / draws
        print(
            f"{make.__name__}: {home} of {draws} home, {len(bench.psi)} unknowns, {each:.2f} s each",
            flush=True,
        )
    print(f"in all {total} of {draws * len(BENCHES)}")


if __name__ == "__main__":
    main()
