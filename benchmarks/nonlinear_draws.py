"""Nonlinear rigs under noise: rms error over the bound, coverage of the intervals, and how often the branch is right.

`python3 dev.py bench nonlinear_draws --draws 200`.  Ten rigs: each kind of law, seen in part and whole, driven by the
base and by a force.  Spread of a coverage of 95 % over D draws: sqrt(0.95 · 0.05 / D); draws of one rig share nothing.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from dashpot.channel import Channel, Quantity
from dashpot.estimate.identify import identify
from dashpot.model.network import Input

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the rigs of the tests
from tests.nonlinear_rigs import motions, noisy, settled, two_masses
from tests.unit.estimate.nonlinear.test_equations import ALL, FREQUENCIES

PART = motions("x2", "u")
FORCED = (*motions("x1", "x2"), Channel("f", {"f": 1.0}, Quantity.FORCE))
NEWTON = 4.0  # amplitude of the force
RIGS = [  # law, channels, orders, noise of the rms amplitude
    ("cubic", ALL, (1, 3), 0.005),
    ("cubic", PART, (1, 3), 0.005),
    ("cubic", FORCED, (1, 3), 0.005),
    ("quintic", ALL, (1, 3), 0.005),
    ("quadratic", PART, (1, 3), 0.005),
    ("v*abs(v)", FORCED, (1, 3), 0.005),
    ("v**3", PART, (1, 3), 0.005),
    ("coulomb", ALL, (1, 3), 0.002),
    ("gap", ALL, (1, 3), 0.002),
    ("one-sided", FORCED, (1, 2, 3), 0.002),
]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=100)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--rigs", default="", help="numbers from 1, such as 1,3; all where nothing is given")
    given = options.parse_args()
    chosen = [int(number) - 1 for number in given.rigs.split(",") if number] or range(len(RIGS))
    held = total = 0
    for k in chosen:
        rig_held, rig_total = one_rig(k, given.draws, given.seed + k)
        held, total = held + rig_held, total + rig_total
    print(f"pooled coverage {100 * held / total:.2f} % of {total} intervals")


def one_rig(k: int, draws: int, seed: int) -> tuple[int, int]:
    """Prints one line; intervals that hold the truth, and all."""
    law, channels, orders, noise = RIGS[k]
    model, theta = two_masses(law)
    forced = channels is FORCED
    if forced:
        model = pushed(model)
    exact = settled(model, theta, channels, FREQUENCIES, orders=orders, amplitude=NEWTON if forced else 1e-3)
    begun = time.process_time()
    estimate = identify(model, noisy(exact, noise, draws, seed), "ml")
    seconds = time.process_time() - begun
    z = (estimate.values - theta) / estimate.sd
    right = estimate.converged & (np.max(np.abs(z), axis=1) < 6)
    error = np.sqrt(np.mean((estimate.values[right] - theta) ** 2, axis=0))
    ratio = error / np.median(estimate.bound_sd, axis=0)
    inside = np.abs(z) < 1.959964
    held = int(np.sum(inside))
    per = 100 * np.mean(inside, axis=0)
    seen = "force" if forced else "part" if channels is PART else "all"
    spread = f"rms/bound {np.min(ratio):.3f}-{np.max(ratio):.3f}"
    cover = f"coverage {100 * np.mean(inside):.1f} % ({np.min(per):.1f}-{np.max(per):.1f})"
    end = f"branch {100 * np.mean(right):.1f} %, {1e3 * seconds / draws:.0f} ms a draw"
    print(f"{law} ({seen}): {spread}, {cover}, {end}", flush=True)
    return held, inside.size


def pushed(model):
    """The same rig on fixed ground, driven by a force on x1."""
    elements = tuple(
        replace(e, along={point: b for point, b in e.along.items() if point != "u"}) for e in model.elements
    )
    return replace(model, inputs=(Input("f", "force", {"x1": 1.0}),), elements=elements)


if __name__ == "__main__":
    main()
