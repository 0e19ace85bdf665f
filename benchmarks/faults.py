"""How often the true fault is named: random rigs, each with one random mistake in data or rig file, diagnosed blindly.

`python3 dev.py bench faults`, or with `--rigs 200` the number that is claimed.  The rigs have two to four coordinates,
all seen, as displacement or acceleration, at 1 % noise; the mistakes are those of tests/mistakes.py.  Printed is the
confusion table: for each mistake how often the truth was named first, among the first three, or not; what else was
named first; how often the fit passed; and false alarms of as many clean tests.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from dashpot.channel import Quantity
from dashpot.check.explain.examine import examined
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.automatic import identify_with_noise

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the rigs and mistakes of the tests
from tests import rigs
from tests.mistakes import MISTAKES

FITTED = "fits"
REFUSED = "refused"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--rigs", type=int, default=20)
    options.add_argument("--clean", type=int, default=20, help="clean tests, for false alarms")
    options.add_argument("--largest", type=int, default=4, help="coordinates of the rigs, from two to this")
    options.add_argument("--minutes", type=float, default=60.0, help="after which no other fault is begun")
    options.add_argument("--seed", type=int, default=0)
    settings = options.parse_args()
    table: dict[str, Counter[str]] = {name: Counter() for name in MISTAKES}
    alarms = sum(alarm(10_000 + settings.seed + k, settings.largest) for k in range(settings.clean))
    print(f"false alarms: {alarms} of {settings.clean} clean tests (p < 0.01 is called a misfit)", flush=True)
    start = time.perf_counter()
    done = 0
    while done < settings.rigs and time.perf_counter() - start < 60 * settings.minutes:
        name, outcome = blind(settings.seed + done, settings.largest)
        table[name][outcome] += 1
        done += 1
    show(table)
    print(f"{done} rigs, {(time.perf_counter() - start) / max(done, 1):.2f} s a rig")


def thrown(seed: int, largest: int) -> tuple[rigs.Rig, Spectrum, np.random.Generator]:
    """A random rig and its clean test."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, largest + 1))
    rig = rigs.plain_rig(rng, n)
    quantity = (Quantity.DISPLACEMENT, Quantity.ACCELERATION)[int(rng.integers(2))]
    channels = rigs.channels(rig, (quantity,))
    return rig, rigs.noisy(rig, channels, rigs.covariance(rig, channels, 0.01, inputs=0.01), rng), rng


def blind(seed: int, largest: int) -> tuple[str, str]:
    """A mistake and what was said: "first", "first three", the kind that was named instead, or that it fits."""
    rig, spectrum, rng = thrown(seed, largest)
    names = list(MISTAKES)
    while True:
        name = names[int(rng.integers(len(names)))]
        try:
            case = MISTAKES[name](rig.model, spectrum, rng)
            break
        except (ValueError, IndexError):
            continue  # this rig has no such part to get wrong
    try:
        estimate = identify_with_noise(case.model, case.spectrum)[0]
        assessment = examined(case.model, case.spectrum, estimate).assessment
    except DashpotError:
        return name, REFUSED
    if assessment is None or assessment.verdict != "does not fit":
        return name, FITTED
    for place, finding in enumerate(assessment.findings[:3]):
        if finding.kind in case.kinds and frozenset(finding.of) == case.of:
            return name, "first" if place == 0 else "first three"
    return name, assessment.findings[0].kind if assessment.findings else "nothing"


def alarm(seed: int, largest: int) -> bool:
    """Whether a clean test is said not to fit."""
    rig, spectrum, _ = thrown(seed, largest)
    assessment = examined(rig.model, spectrum, identify_with_noise(rig.model, spectrum)[0]).assessment
    return assessment is not None and assessment.verdict == "does not fit"


def show(table: dict[str, Counter[str]]) -> None:
    """The confusion table."""
    print(f"{'mistake':28}{'cases':>6}{'first':>7}{'in 3':>6}{'fits':>6}  named first instead")
    total: Counter[str] = Counter()
    for name, counts in table.items():
        if not counts:
            continue
        total += counts
        others = {k: v for k, v in counts.items() if k not in ("first", "first three", FITTED)}
        print(row(name, counts), ", ".join(f"{k} {v}" for k, v in others.items()))
    print(row("all", total))


def row(name: str, counts: Counter[str]) -> str:
    """Cases, named first, among the first three, passed."""
    three = counts["first"] + counts["first three"]
    return f"{name:28}{counts.total():6}{counts['first']:7}{three:6}{counts[FITTED]:6} "


if __name__ == "__main__":
    main()
