"""Nonlinear rigs: time of an identification by harmonic balance over a linear one's, and estimators under noise.

`python3 dev.py bench nonlinear`.  The rig: two masses on a shaken base, eleven dwells, all coordinates seen, harmonics
1 and 3.  The estimators are compared in Yasuda and Watanabe's kind of test: a cubic spring and quadratic damping.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from dashpot.estimate.identify import identify

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the rigs of the tests
from tests.nonlinear_rigs import motions, noisy, settled, two_masses
from tests.unit.estimate.nonlinear.test_equations import ALL, FREQUENCIES, rig

NOISE = 0.004  # of the rms amplitude
FEW = 4  # timed runs, of which the fastest counts


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=100, help="of the comparison of estimators")
    options.add_argument("--laws", default="cubic,quadratic,v*abs(v),coulomb,gap", help="whose time is taken")
    given = options.parse_args()
    times(given.laws.split(","))
    estimators(given.draws)


def times(laws: list[str]) -> None:
    """Processor time of one identification by each law, over that of the linear rig by the same method."""
    model, theta = two_masses("cubic")
    linear = type(model)(model.coordinates, model.inputs, model.elements[:-1])
    for name, channels in (("all seen", ALL), ("x2 and u seen", motions("x2", "u"))):
        weak = np.array([*theta[:-1], 0.0])
        rng = np.random.default_rng(3)
        data = settled(model, weak, channels, FREQUENCIES, orders=(1,), noise=0.005, rng=rng)
        base = fastest(lambda data=data: identify(linear, data, "ml"))
        print(f"{name}: linear {1e3 * base:.1f} ms", flush=True)
        for law in laws:
            bent, truth = two_masses(law)
            data = settled(bent, truth, channels, FREQUENCIES, noise=0.005, rng=np.random.default_rng(3))
            once = fastest(lambda bent=bent, data=data: identify(bent, data, "ml"))
            estimate = identify(bent, data, "ml")
            away = np.max(np.abs(estimate.values - truth) / estimate.sd)
            end = f"farthest {away:.1f} sd, χ² p {estimate.fit.p:.2g}"
            print(f"  {law}: {once / base:.0f} x, {once:.2f} s, {end}", flush=True)


def fastest(run) -> float:
    """Processor time of the fastest of a few runs, s."""
    seconds = []
    for _ in range(FEW):
        begun = time.process_time()
        run()
        seconds.append(time.process_time() - begun)
    return min(seconds)


def estimators(draws: int) -> None:
    """Bias, spread and stated spread of the estimators from the same draws, % of the truth."""
    model, theta = rig()
    spectrum = noisy(settled(model, theta, ALL, FREQUENCIES), NOISE, draws, 11)
    names = [unknown.name for unknown in model.unknowns]
    print(f"{100 * NOISE:g} % noise, {draws} draws: bias, rms error and stated sd, %")
    for method in ("ls", "wls", "iv", "oiv", "ml"):
        estimate = identify(model, spectrum, method)
        error = 100 * (estimate.values / theta - 1)
        bias, rms = np.mean(error, axis=0), np.sqrt(np.mean(error**2, axis=0))
        stated = 100 * np.sqrt(np.mean(estimate.sd**2, axis=0)) / theta
        cells = [f"{n} {b:+.2f} {r:.2f} {s:.2f}" for n, b, r, s in zip(names, bias, rms, stated, strict=True)]
        print(f"  {method}: " + ", ".join(cells), flush=True)


if __name__ == "__main__":
    main()
