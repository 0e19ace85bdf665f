"""What one evaluation of the likelihood costs on long chains, and an identification from rough guesses.

`python3 dev.py bench large`: a chain of unit masses on a shaken base, springs alike but one, dampers alike, three
unknowns, seen at both ends and by the force at the base.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.objective import local, measured
from dashpot.estimate.preparation.prepared import prepare
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.observation import observation_model
from dashpot.study.simulate import dwells, simulate_spectrum

SIZES = (10, 30, 100, 300, 1000)
LINES = (12, 96)


def chain(n: int) -> tuple[Model, np.ndarray]:
    """A rod of two halves, ever more finely divided: the rig and its true unknowns (k1, the other half's k, c1)."""
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


def channels(n: int) -> tuple[Channel, ...]:
    """Accelerometers at both ends, the exact base, the force at the base."""
    A, F = Quantity.ACCELERATION, Quantity.FORCE
    noise = {"relative_noise": 0.01}
    return (
        Channel("first", {"x1": 1.0}, A, **noise), Channel("last", {f"x{n}": 1.0}, A, **noise),
        Channel("base", {"u": 1.0}), Channel("force", {"u": 1.0}, F, **noise),
    )  # fmt: skip


def data(n: int, lines: int) -> tuple[Model, np.ndarray, Spectrum]:
    """Rig, true unknowns and noisy amplitudes of a base moved by 10 mm."""
    model, theta = chain(n)
    test = dwells(model, np.geomspace(0.5, 10, lines), amplitudes={"u": 0.01})
    return (
        model,
        theta,
        simulate_spectrum(model, model.parameters(theta), channels(n), test, np.random.default_rng(1)),
    )


def evaluation(model: Model, theta: np.ndarray, spectrum: Spectrum) -> float:
    """Seconds of one evaluation of cost, slope and curvature: the least of five."""
    flat = replace(spectrum, amplitudes=spectrum.amplitudes[None], covariance=spectrum.covariance[None])
    view = observation_model(model, flat.channels, flat.omega)
    given = measured(prepare(model, flat), view)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        local(view, given, theta[None], np.ones((1, len(flat.channels))))
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    first = None
    for n in SIZES:
        few, many = (evaluation(*data(n, lines)) for lines in LINES)
        first = first or few
        print(
            f"{n:5d} coordinates: an evaluation {few / first:6.1f} of the first ({few * 1e3:.1f} ms); "
            f"{LINES[1] // LINES[0]} times the lines cost {many / few:.1f} times as much",
            flush=True,
        )
        model, theta, spectrum = data(n, LINES[0])
        start = time.perf_counter()
        found = identify(model, spectrum, MaximumLikelihood())
        worst = np.max(np.abs(found.values - theta) / found.sd)
        print(
            f"      identified in {time.perf_counter() - start:.1f} s, {worst:.1f} sd off at most", flush=True
        )


if __name__ == "__main__":
    main()
