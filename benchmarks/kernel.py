"""The compiled kernel against its NumPy twins, one identification against lmfit, searches from nothing.

`python3 dev.py bench kernel`.  Ratios of one run, in processor time where both sides compute on one core; `--repeats N`
identifications in a batch.  Without the kernel it says so and ends.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import lmfit
import numpy as np

from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.linear.gram import compiled_equation, compiled_search
from dashpot.estimate.linear.instrumental_variables import FAR, OptimalIV
from dashpot.estimate.preparation import prepare
from dashpot.numerics.kernel import kernel, using

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the rigs of the tests and of the other benchmarks
from benchmarks.identify import CASE_3, PAPER, TRUTH, chain, data
from tests.partly_seen import BENCHES

START = 1.5  # what lmfit is told of the truth


def shortest(call: Callable[[], object], repeats: int) -> float:
    """The shortest processor time of some calls, s."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return min(times)


def batches(repeats: int) -> None:
    """A batch in the kernel and in its twin, everything that identify does included."""
    core = kernel()
    assert core is not None
    print(f"{repeats} identifications in one call, oiv, 25 lines; µs of one core each\n")
    print("| coordinates | unknowns | kernel | search alone | NumPy twin | ratio | estimates differ by |")
    print("|---|---|---|---|---|---|---|")
    for n in (2, 4, 8):
        model, truth = chain(n)
        spectrum = data(model, truth, np.linspace(1, 20, 25), repeats)
        states = prepare(model, spectrum).seen_states
        equation = compiled_equation(model, states)
        first, everyone = equation.starts()[0], np.arange(repeats)

        def descend(model=model, equation=equation, states=states, first=first, everyone=everyone) -> object:
            return compiled_search(equation, model, states, first, everyone, FAR, 200, 1e-9)

        alone = shortest(descend, 3)
        taken, values = {}, {}
        for choice in ("compiled", "numpy"):
            with using(choice):

                def call(model=model, spectrum=spectrum) -> object:
                    return identify(model, spectrum, OptimalIV())

                values[choice] = call().values
                taken[choice] = shortest(call, 3)
        apart = np.max(np.abs(values["compiled"] / values["numpy"] - 1))
        each = {name: 1e6 * t / repeats for name, t in taken.items()}
        print(
            f"| {n} | {len(truth)} | {each['compiled']:.1f} | {1e6 * alone / repeats:.1f} | {each['numpy']:.0f} "
            f"| {each['numpy'] / each['compiled']:.1f} | {apart:.0e} |"
        )
    print()


def single() -> None:
    """One identification of the paper's rig against lmfit, which is given a start and the response written out."""
    spectrum = data(PAPER, TRUTH, CASE_3, 1, noise=0.1 / np.sqrt(28))
    one = replace(spectrum, amplitudes=spectrum.amplitudes[0])
    omega, Y, sd = spectrum.omega, one.amplitudes[:, :-1], spectrum.sd()[:, :-1]
    truth, jomega = np.array(list(TRUTH.values())), 1j * spectrum.omega

    def residual(p: lmfit.Parameters) -> np.ndarray:
        m1, m2, c1, c2, c3, c4 = (p[name].value for name in TRUTH)
        k1, k2 = 4600.0, 4600.0
        a = k1 - omega**2 * m1 + jomega * (c1 + c3)
        d = k1 + k2 - omega**2 * m2 + jomega * (c1 + c2 + c4)
        b, drive = -(k1 + jomega * c1), k2 + jomega * c2
        scale = drive / (a * d - b * b)
        x1, x2 = -b * scale, a * scale
        r = (np.stack([x1, x2, jomega * x1, jomega * x2], axis=-1) - Y) / sd
        return np.concatenate([r.real.ravel(), r.imag.ravel()])

    parameters = lmfit.Parameters()
    for name, value in zip(TRUTH, START * truth, strict=True):
        parameters.add(name, value=value)
    found = lmfit.minimize(residual, parameters, scale_covar=False)
    estimate = identify(PAPER, one, OptimalIV())
    apart = max(abs(found.params[name].value / v - 1) for name, v in zip(TRUTH, estimate.values, strict=True))
    peer = shortest(lambda: lmfit.minimize(residual, parameters, scale_covar=False), 60)
    print("One identification of the paper's rig (25 lines, amplitudes and their noise given)\n")
    print("| | ms | over that of lmfit |")
    print("|---|---|---|")
    print(f"| lmfit, start and formula given (estimates agree to {apart:.0e}) | {1e3 * peer:.2f} | 1 |")
    for choice in ("compiled", "numpy"):
        with using(choice):
            own = shortest(lambda: identify(PAPER, one, OptimalIV()), 200)
            again = MaximumLikelihood(start=tuple(START * truth), start_sign=(1.0,) * 5)
            likely = shortest(lambda again=again: identify(PAPER, one, again), 60)
        print(
            f"| identify, {choice}: start, χ², bound, modes, intervals | {1e3 * own:.2f} | 1/{peer / own:.1f} |"
        )
        print(f"| identify, {choice}, ml from that start | {1e3 * likely:.2f} | 1/{peer / likely:.1f} |")
    print()


def searches(draws: int) -> None:
    """Rigs seen in part, without guesses, each draw alone."""
    print(f"Rigs seen in part, no guesses, {draws} draws each; s of one core\n")
    print("| rig | home | kernel, median | most |")
    print("|---|---|---|---|")
    for make in BENCHES:
        bench = make()
        spectrum, bound = bench.spectrum(np.random.default_rng(11), draws), bench.bound_sd()
        times, home = [], 0
        for k in range(draws):
            one = replace(spectrum, amplitudes=spectrum.amplitudes[k])
            begin = time.process_time()
            found = identify(bench.model, one, MaximumLikelihood())
            times.append(time.process_time() - begin)
            home += bool(found.converged) and bool(np.max(np.abs(found.values - bench.psi) / bound) < 8)
        name = make.__name__.replace("_", " ")
        print(f"| {name} | {home} of {draws} | {np.median(times):.2f} | {max(times):.2f} |", flush=True)
    print()


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--repeats", type=int, default=3000, help="identifications of a batch")
    options.add_argument("--draws", type=int, default=10, help="of each rig that is seen in part")
    given = options.parse_args()
    core = kernel()
    if core is None:
        print("the compiled kernel is not installed, or DASHPOT_KERNEL is numpy: nothing to compare")
        return
    sets = ", ".join(core.instruction_sets())
    print(f"dashpot-kernels {core.__version__}, {core.instruction_set()} (this processor has {sets})\n")
    batches(given.repeats)
    single()
    searches(given.draws)


if __name__ == "__main__":
    main()
