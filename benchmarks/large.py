"""Large rigs: identified, in seconds and memory, against their size.

`python3 dev.py bench large`, or `--kind chain|plate|evaluation` for one of the groups.  A rod of two halves on a
shaken base, ever more finely divided: unit masses, three unknowns tied along it (stiffness of either half, damping),
guesses 25 % off, accelerometers at both ends and the force at the base, 20 lines, 1 % noise.  The plate is the same in
two directions.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.objective import local, measured
from dashpot.estimate.preparation import prepare
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.observation import observation_model
from dashpot.study.simulate import dwells, simulate_spectrum

SIZES = {"chain": (1000, 10_000, 100_000), "plate": (32, 100, 316)}
EVALUATIONS = (10, 30, 100, 300, 1000)
LINES = 20
A, F = Quantity.ACCELERATION, Quantity.FORCE
NOISE = {"relative_noise": 0.01}


def chain(n: int) -> tuple[Model, np.ndarray]:
    """The rig and its true unknowns (k1, the other half's k, c1)."""
    points = ["u", *(f"x{i}" for i in range(1, n + 1))]
    elements = [mass(f"m{i}", f"x{i}", value=1.0) for i in range(1, n + 1)]
    other = n // 2 + 1
    truth = {"k1": 400.0 * n**2, f"k{other}": 250.0 * n**2, "c1": 0.25 * n**2}
    for letter, kind in (("k", Kind.SPRING), ("c", Kind.DAMPER)):
        for i in range(1, n + 1):
            name = f"{letter}{i}"
            root = f"k{other}" if letter == "k" and i >= other else f"{letter}1"
            known = {"guess": 0.75 * truth[name]} if name in truth else {"same_as": root}
            elements.append(between(name, kind, points[i - 1], points[i], **known))
    model = Model(tuple(points[1:]), (Input("u"),), tuple(elements))
    return model, model.theta(truth)


def plate(n: int) -> tuple[Model, np.ndarray]:
    """n × n masses, springs and dampers to the neighbours in both directions; one edge on the base."""
    truth = {"k": 400.0 * n**2, "kb": 250.0 * n**2, "c": 0.25 * n**2}
    elements: list[Element] = []

    def join(name: str, kind: Kind, first: str, second: str, tag: str) -> None:
        taken = name in named
        known = {"same_as": name} if taken else {"guess": 0.75 * truth[name]}
        named.add(name)
        elements.append(between(f"{name}_{tag}" if taken else name, kind, first, second, **known))

    named: set[str] = set()
    for i in range(n):
        for j in range(n):
            here, half = f"x{i}_{j}", "k" if i < n // 2 else "kb"
            elements.append(mass(f"m{i}_{j}", here, value=1.0))
            for before, tag in (
                ("u" if i == 0 else f"x{i - 1}_{j}", "a"),
                (f"x{i}_{j - 1}" if j else "", "b"),
            ):
                if before:
                    join(half, Kind.SPRING, before, here, f"{tag}{i}_{j}")
                    join("c", Kind.DAMPER, before, here, f"{tag}{i}_{j}")
    model = Model(tuple(f"x{i}_{j}" for i in range(n) for j in range(n)), (Input("u"),), tuple(elements))
    return model, model.theta(truth)


def data(model: Model, theta: np.ndarray, lines: int = LINES) -> Spectrum:
    """Noisy amplitudes on a base moved by 10 mm: accelerometers at both ends, the exact base, the force at it."""
    first, last = model.coordinates[0], model.coordinates[-1]
    channels = (
        Channel("first", {first: 1.0}, A, **NOISE), Channel("last", {last: 1.0}, A, **NOISE),
        Channel("base", {"u": 1.0}), Channel("force", {"u": 1.0}, F, **NOISE),
    )  # fmt: skip
    test = dwells(model, np.geomspace(0.5, 10, lines), amplitudes={"u": 0.01})
    return simulate_spectrum(model, model.parameters(theta), channels, test, np.random.default_rng(1))


def evaluation(model: Model, theta: np.ndarray, spectrum: Spectrum) -> float:
    """Seconds of one evaluation of cost, slope and curvature of the full rig: the least of five."""
    flat = replace(spectrum, amplitudes=spectrum.amplitudes[None], covariance=spectrum.covariance[None])
    view = observation_model(model, flat.channels, flat.omega)
    given = measured(prepare(model, flat))
    times = []
    for _ in range(5):
        start = time.perf_counter()
        local(view, given, theta[None], np.ones((1, len(flat.channels))))
        times.append(time.perf_counter() - start)
    return min(times)


def identified(build: Callable[[int], tuple[Model, np.ndarray]], n: int) -> str:
    """One line: processor and wall seconds of `identify`, memory of everything, and how far it is off."""
    model, theta = build(n)
    spectrum = data(model, theta)
    start, cpu = time.perf_counter(), time.process_time()
    found = identify(model, spectrum, MaximumLikelihood())
    seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    worst = np.max(np.abs(found.values - theta) / found.sd)
    return f"{model.n} {cpu:.1f} {seconds:.1f} {_memory():.2f} {worst:.1f} {bool(found.converged)}"


def _memory() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2


ONE: dict[str, Callable[[int], str]] = {
    "chain": lambda n: identified(chain, n), "plate": lambda n: identified(plate, n),
}  # fmt: skip


def evaluations() -> None:
    """What an evaluation of the full rig costs, and 8 times the lines."""
    first = None
    for n in EVALUATIONS:
        model, theta = chain(n)
        few, many = (evaluation(model, theta, data(model, theta, lines)) for lines in (12, 96))
        first = first or few
        print(
            f"{n:5d} coordinates: {few / first:6.1f} of the first ({few * 1e3:.1f} ms); 8 × the lines {many / few:.1f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--kind", choices=[*SIZES, "evaluation"])
    parser.add_argument("--one", type=int, help="a single size, in this process")
    asked = parser.parse_args()
    if asked.one:
        print(ONE[asked.kind](asked.one))
        return
    if asked.kind in (None, "evaluation"):
        evaluations()
    for kind, sizes in SIZES.items():
        if asked.kind not in (None, kind):
            continue
        rows = []
        for size in sizes:  # each in a process of its own, whose memory it is
            command = [sys.executable, __file__, "--kind", kind, "--one", str(size)]
            words = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
            rows.append((float(words[0]), float(words[1])))
            print(
                f"{kind} of {words[0]} coordinates: {words[1]} s of a processor ({words[2]} s on the wall), "
                f"{words[3]} GiB; at most {words[4]} sd off, converged: {words[5]}",
                flush=True,
            )
        (small, quick), (large, slow) = rows[0], rows[-1]
        print(f"exponent of growth: {np.log(slow / quick) / np.log(large / small):.2f}", flush=True)


if __name__ == "__main__":
    main()
