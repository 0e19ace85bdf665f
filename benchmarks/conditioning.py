"""Default conditioning against the best options known afterwards, on simulated tests with all that goes wrong.

`python3 dev.py bench conditioning`, or with `--tests 1000 --coverage` the number that is claimed. Each test is a
stepped sine of a rig of two coordinates at eight frequencies: one to fifty periods a dwell, 12 to 40 samples a
period, 0.3 to 5 % noise, and some of: a converter of 8 to 16 bits, an offset with a slope, stated frequencies off by
up to 2 %, jitter of the stamps, mains hum, transients from dwell to dwell. Printed are, for each of these, how many
95 % intervals hold the truth and the rms error over that of whichever of ten sets of options does best there, known
afterwards.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.record import Record
from dashpot.errors import DashpotError
from dashpot.estimate.automatic import identify_automatically
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.observation import observation_model

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.whole_rigs import chain, record_of

MODEL, THETA = chain(2, 0.08, seed=1)
CHANNELS: tuple[Channel, ...] = record_of(MODEL, THETA, "random", decay_times=0.1).record.channels
FREQUENCIES = (4.0, 5.2, 6.5, 8.0, 10.0, 12.5, 15.0, 18.0)
TROUBLES = ("quantised", "slope", "frequency", "jitter", "hum", "transients")
OPTIONS = {
    f"drift {drift}, refine {refine}, transients {transients}, noise {noise}": Conditioning(
        drift=drift, refine=refine, transients=transients, noise=noise
    )
    for drift in (0, 1)
    for refine, transients, noise in (
        ("none", "none", "white"),
        ("none", "none", "auto"),
        ("auto", "none", "auto"),
        ("always", "none", "auto"),
        ("none", "estimate", "auto"),
    )
}


WORST = 10.0  # times the median error: beyond it a treatment has failed


def dwells(rng: np.random.Generator, troubles: frozenset[str]) -> list[Record]:
    """One test."""
    p, view = MODEL.parameters(THETA), observation_model(MODEL, CHANNELS, np.ones(1))
    periods = float(np.exp(rng.uniform(0, np.log(50))))
    each, noise = int(rng.integers(12, 41)), float(np.exp(rng.uniform(np.log(0.003), np.log(0.05))))
    stated = 1 + rng.uniform(-0.02, 0.02) * ("frequency" in troubles)
    slope, bits = rng.uniform(0.02, 0.3) * ("slope" in troubles), int(rng.integers(8, 17))
    state: Real = np.zeros(2 * MODEL.n)
    records = []
    for f in FREQUENCIES:
        step = 1 / (each * f)
        wait = 0 if "transients" in troubles else int(4.0 / step)
        count = wait + max(int(each * periods), 16)
        fine = np.arange(8 * count + 1) * step / 8
        motion = integrator(MODEL, p, step / 8).motion(np.sin(2 * np.pi * f * fine)[:, None] * 1e-3, state)
        state = np.concatenate([motion.x[-1], motion.v[-1]])
        y = channel_samples(view, p, motion)[:-1:8][wait:]
        t, size = step * np.arange(len(y)), np.std(y, axis=0)
        if "jitter" in troubles:
            shifted = t + 0.02 * step * rng.normal(size=len(t))
            y = np.stack([np.interp(shifted, t, column) for column in y.T], axis=1)
        y = y + noise * size * rng.normal(size=y.shape)
        y = y + slope * size * np.linspace(-1, 1, len(t))[:, None] * rng.normal(size=y.shape[1])
        if "hum" in troubles:
            y = y + 0.02 * size * np.sin(2 * np.pi * 50 * t + rng.uniform(0, 6))[:, None]
        if "quantised" in troubles:
            code = 4 * size / 2**bits
            y = np.round(y / code) * code
        records.append(Record(CHANNELS, t, y, f * stated))
    return records


def error(records: list[Record], conditioning: Conditioning | None) -> tuple[Real, Real] | None:
    """(errors over the truth, whether each 95 % interval holds it); None where there is no answer."""
    try:
        estimate = identify_automatically(MODEL, spectrum(records, conditioning))
    except DashpotError:
        return None
    low, high = np.array([estimate[name].interval95 for name in estimate.names]).T
    return estimate.values / THETA - 1, (low <= THETA) & (high >= THETA)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--tests", type=int, default=60)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument(
        "--coverage", action="store_true", help="the defaults alone, ten times as many in a time"
    )
    settings = options.parse_args()
    others = {} if settings.coverage else OPTIONS
    held: dict[str, list[Real]] = defaultdict(list)
    errors: dict[str, list[Real]] = defaultdict(
        list
    )  # rms of the defaults and of each option, over their median
    refused = 0
    for k in range(settings.tests):
        rng = np.random.default_rng(settings.seed + k)
        chosen = frozenset(t for t in TROUBLES if rng.random() < 0.25)
        records = dwells(rng, chosen)
        usual = error(records, None)
        if usual is None:
            refused += 1
            continue
        tried = [error(records, conditioning) for conditioning in others.values()]
        sizes = np.array([np.inf if e is None else np.sqrt(np.mean(e[0] ** 2)) for e in (usual, *tried)])
        for trouble in (*(sorted(chosen) or ["nothing"]), "all"):
            held[trouble].append(usual[1])
            errors[trouble].append(sizes / np.median(sizes))
    print(f"{'':12}{'tests':>6}{'coverage':>10}{'over the best':>15}  best option")
    for trouble in ("nothing", *TROUBLES, "all"):
        if held[trouble]:
            cover = f"{trouble:12}{len(held[trouble]):6}{100 * np.mean(held[trouble]):9.1f}%"
            if settings.coverage:
                print(cover)
                continue
            rms = np.sqrt(np.mean(np.minimum(errors[trouble], WORST) ** 2, axis=0))
            best = int(np.argmin(rms[1:]))
            print(f"{cover}{rms[0] / rms[1 + best]:15.2f}  {list(OPTIONS)[best]}")
    print(f"{refused} without an answer")


if __name__ == "__main__":
    main()
