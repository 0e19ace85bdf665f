"""How many samples it takes to know every parameter of a three-mass rig to 1 %.

Two ways from the same poor first test (five low frequencies), both until the stopping rule says enough: a uniform
sweep, repeated with as many samples as the rule says are missing, and the shortest test for the target given what is
known, re-planned.  Neither adds more at once than there is.

`python3 dev.py bench sequential_design`, or with `--repeats 200` the number that is claimed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum, merge_repeats
from dashpot.design.allocation import Criterion
from dashpot.design.plan import Budget, shortest
from dashpot.design.stopping import after, enough, values_after
from dashpot.design.test_setup import band_grid, nominal_setup
from dashpot.errors import IdentifiabilityError, UsageError
from dashpot.estimate.identify import identify
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.study.simulate import dwells, simulate_spectrum

TRUTH = {"m1": 1.2, "m2": 0.9, "m3": 1.5, "c1": 6.0, "c2": 9.0, "c3": 5.0, "k1": 1500.0, "k2": 2200.0}
GUESS = {name: 2.0 * value for name, value in TRUTH.items()}  # all too large by a factor of two
BAND = (0.5, 20.0)
TARGET = 0.01
FIRST = (0.6, 0.8, 1.0, 1.2, 1.4), 40  # frequencies, samples each: all below the first resonance
SWEEP = np.linspace(*BAND, 25)


def rig() -> Model:
    """Three masses in a chain on a shaken base; the base spring is known."""
    return Model(
        ("x1", "x2", "x3"),
        (Input("u"),),
        (
            mass("m1", "x1"), mass("m2", "x2"), mass("m3", "x3"),
            between("c1", Kind.DAMPER, "x1", "u"), between("c2", Kind.DAMPER, "x2", "x1"),
            between("c3", Kind.DAMPER, "x3", "x2"), between("k0", Kind.SPRING, "x1", "u", value=3000.0),
            between("k1", Kind.SPRING, "x2", "x1"), between("k2", Kind.SPRING, "x3", "x2"),
        ),
        "three masses",
    )  # fmt: skip


def sensors() -> tuple[Channel, ...]:
    """Displacements with 10 % noise, the base exactly."""
    outputs = tuple(Channel(x, {x: 1.0}, relative_noise=0.1) for x in ("x1", "x2", "x3"))
    return (*outputs, Channel("u", {"u": 1.0}))


def measure(model: Model, f: Sequence[float], samples: Sequence[int], rng: np.random.Generator) -> Spectrum:
    """What the rig shows at these frequencies."""
    p = model.parameters(model.theta(TRUTH))
    return simulate_spectrum(model, p, sensors(), dwells(model, list(f), list(samples)), rng)  # noise known


def missing(model: Model, data: Spectrum) -> float:
    """The stopping rule: how many more samples of the same kind would do; 0 where there are enough."""
    try:
        estimate = identify(model, data)
    except IdentifiabilityError:
        return np.inf
    return enough(estimate, dict.fromkeys(TRUTH, TARGET), int(np.sum(data.samples))).more


def uniform(model: Model, data: Spectrum, rng: np.random.Generator) -> Spectrum:
    """Sweeps until enough, each of what is missing and at most as much as there is."""
    while (more := missing(model, data)) > 0:
        each = max(4, int(np.ceil(min(more, np.sum(data.samples)) / len(SWEEP))))
        data = merge_repeats(data + measure(model, SWEEP.tolist(), [each] * len(SWEEP), rng))
    return data


def sequential(model: Model, data: Spectrum, rng: np.random.Generator) -> Spectrum:
    """The shortest test to the target as far as is known, of which at most as much is run as there are samples."""
    while missing(model, data) > 0:
        own = nominal_setup(model, sensors(), GUESS)
        try:
            estimate = identify(model, data)
            own = after(nominal_setup(model, sensors(), values_after(model, estimate, GUESS)), estimate)
        except (IdentifiabilityError, UsageError):
            pass  # the data say nothing yet: design for the guesses
        total = int(np.sum(data.samples))
        test = shortest(
            own, Criterion("minimax"), 0.98 * TARGET, Budget(samples=total), band_grid(own, *BAND)
        )
        if test is None:
            test_f, share, wanted = [float(np.mean(BAND))], np.ones(1), 16.0
        else:
            test_f = test.schedule.frequency_hz.tolist()
            wanted = float(test.samples)
            share = test.schedule.samples / wanted
        run = np.maximum(np.ceil(share * min(wanted, total)), 8).astype(int)
        data = data + measure(model, test_f, run.tolist(), rng)
    return data


def compare_tests(repeats: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (repeats,) of the uniform and of the sequential way, and the true relative errors of the latter."""
    model = rig()
    counts = np.zeros((2, repeats))
    errors = np.zeros((repeats, len(TRUTH)))
    for k in range(repeats):
        rng = np.random.default_rng([seed, k])
        first = measure(model, FIRST[0], [FIRST[1]] * len(FIRST[0]), rng)
        counts[0, k] = np.sum(uniform(model, first, rng).samples)
        data = sequential(model, first, rng)
        counts[1, k] = np.sum(data.samples)
        errors[k] = identify(model, data).values / np.array([TRUTH[u.name] for u in model.unknowns]) - 1
    return counts[0], counts[1], errors


def main() -> None:
    """Both ways, and how many times the samples the sweep takes."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--repeats", type=int, default=20)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    start = time.perf_counter()
    swept, planned, errors = compare_tests(given.repeats, given.seed)
    for name, counts in (("uniform sweep", swept), ("next best dwells", planned)):
        low, middle, high = np.quantile(counts, [0.1, 0.5, 0.9])
        print(f"{name:18s} {middle:8.0f} samples ({low:.0f} … {high:.0f}, 80 % of repeats)")
    print(f"ratio {np.median(swept / planned):.2f} (median of {given.repeats} repeats)")
    print(f"true rms errors, %: {np.round(100 * np.sqrt(np.mean(errors**2, axis=0)), 2)}")
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
