"""Time of identifications: one against scipy and lmfit, ten thousand in one batch, and how an iteration grows.

`python3 dev.py bench identify`.  All figures of one run come from the same machine in the same minutes; compare
ratios, not seconds.
"""

from __future__ import annotations

import itertools
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import lmfit
import numpy as np
from scipy.optimize import least_squares

import dashpot
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.instrumental_variables import OptimalIV
from dashpot.model.dynamics import response
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.numerics.blas_threads import THREADS, one_blas_thread
from dashpot.reproduce.yamane1989 import paper_model, paper_prints

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the record of the peers
from benchmarks.peers import CHANNELS as RECORDED
from benchmarks.peers import levels, stepped_sine

PAPER, TRUTH = paper_model(), dict(paper_prints().values)
CASE_3 = np.array(paper_prints().cases["CASE-3"])  # Hz
START = 1.5  # what the peers are told of the truth: they cannot start without


def chain(n: int, more: int = 0) -> tuple[Model, dict[str, float]]:
    """A chain of n masses on a moved base, masses and dampers unknown and `more` of the springs."""
    points = ["u", *(f"x{i}" for i in range(1, n + 1))]
    elements: list[Element] = [mass(f"m{i}", f"x{i}") for i in range(1, n + 1)]
    truth = {f"m{i}": 1.0 + 0.1 * i for i in range(1, n + 1)}
    for i in range(1, n + 1):
        elements.append(between(f"c{i}", Kind.DAMPER, points[i - 1], points[i]))
        truth[f"c{i}"] = 10.0 + i
        free = 1 < i <= 1 + more
        elements.append(
            between(f"k{i}", Kind.SPRING, points[i - 1], points[i], **({} if free else {"value": 4000.0}))
        )
        if free:
            truth[f"k{i}"] = 4000.0
    return Model(tuple(points[1:]), (Input("u"),), tuple(elements)), truth


def data(model: Model, truth: dict[str, float], hz: np.ndarray, draws: int, noise: float = 0.02) -> Spectrum:
    """Amplitudes of displacement and velocity of every coordinate, exact base, noise in proportion."""
    rng = np.random.default_rng(5)
    omega = 2 * np.pi * hz
    X = response(model, model.parameters(model.theta(truth)), omega, np.ones((len(hz), 1), dtype=complex))
    Y = np.concatenate([X, 1j * omega[:, None] * X, np.ones((len(hz), 1))], axis=-1)
    sd = noise * np.abs(Y)
    sd[:, -1] = 0
    wobble = rng.standard_normal((2, draws, *Y.shape))
    channels = [Channel(f"{x}", {x: 1.0}) for x in model.coordinates]
    channels += [Channel(f"d{x}", {x: 1.0}, Quantity.VELOCITY) for x in model.coordinates]
    lines = len(hz)
    return Spectrum(
        (*channels, Channel("u", {"u": 1.0})), hz, Y + (wobble[0] + 1j * wobble[1]) * sd,
        2 * (sd**2)[:, :, None] * np.eye(Y.shape[-1]), np.ones(lines, dtype=int), np.full(lines, np.inf),
        ("given",) * lines, np.zeros(lines, dtype=int),
    )  # fmt: skip


def best_of(call: Callable[[], object], repeats: int = 7) -> float:
    """The shortest of some processor times, s."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return min(times)


def one_against_peers(repeats: int = 200) -> None:
    """The paper's rig, amplitudes and their noise given: time, error and coverage, over the same noisy data."""
    names, truth = list(TRUTH), np.array(list(TRUTH.values()))
    spectrum = data(PAPER, TRUTH, CASE_3, repeats, noise=0.1 / np.sqrt(56 / 2))
    omega = spectrum.omega
    sd = spectrum.sd()[:, :-1]
    jomega = 1j * omega

    def residual(theta: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """The response of the paper's rig written out, k1 and k2 known."""
        m1, m2, c1, c2, c3, c4 = theta
        near = 4600.0 - omega**2 * m1 + jomega * (c1 + c3)
        far = 9200.0 - omega**2 * m2 + jomega * (c1 + c2 + c4)
        joint = 4600.0 + jomega * c1
        scale = (4600.0 + jomega * c2) / (near * far - joint * joint)
        x1, x2 = joint * scale, near * scale
        r = (np.stack([x1, x2, jomega * x1, jomega * x2], axis=-1) - Y) / sd
        return np.concatenate([r.real.ravel(), r.imag.ravel()])

    def by_scipy(Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = least_squares(residual, START * truth, args=(Y,), x_scale=truth)
        return found.x, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))

    def by_lmfit(Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parameters = lmfit.Parameters()
        for name, value in zip(names, START * truth, strict=True):
            parameters.add(name, value=value)

        def call(p: lmfit.Parameters) -> np.ndarray:
            return residual(np.array([p[name].value for name in names]), Y)

        found = lmfit.minimize(call, parameters, scale_covar=False)
        return np.array([found.params[n].value for n in names]), np.array(
            [found.params[n].stderr for n in names]
        )

    def draw(k: int) -> Spectrum:
        return replace(spectrum, amplitudes=spectrum.amplitudes[k])

    def by_verb(k: int, model: Model = PAPER) -> tuple[np.ndarray, np.ndarray]:
        estimate = dashpot.identify(model, draw(k))
        return estimate.values, estimate.sd

    def by_method(k: int) -> tuple[np.ndarray, np.ndarray]:
        estimate = identify(PAPER, draw(k), OptimalIV())
        return estimate.values, estimate.sd

    fresh = itertools.count(1)

    def by_new_rig(k: int) -> tuple[np.ndarray, np.ndarray]:
        """By a rig that nobody has seen: one spring is known a little otherwise."""
        elements = [
            replace(e, value=e.value * (1 + 1e-12 * next(fresh))) if e.name == "k1" and e.value else e
            for e in PAPER.elements
        ]
        return by_verb(k, replace(PAPER, elements=tuple(elements)))

    print("One identification of the paper's rig (CASE-3, 25 lines, 6 unknowns, amplitudes given)\n")
    print(
        "| tool | start | time over scipy's | rms relative error, % | 95 % intervals that hold the truth, % |"
    )
    print("|---|---|---|---|---|")
    given = f"{START:g} × truth"
    rows: list[tuple[str, str, Callable[[int], tuple[np.ndarray, np.ndarray]]]] = [
        ("scipy least_squares", given, lambda k: by_scipy(spectrum.amplitudes[k, :, :-1])),
        ("lmfit", given, lambda k: by_lmfit(spectrum.amplitudes[k, :, :-1])),
        ("dashpot.identify, first call with a rig", "none needed", by_new_rig),
        ("dashpot.identify, next calls", "none needed", by_verb),
        ("oiv without the checks of dashpot.identify", "none needed", by_method),
    ]
    # In turn, so that other work on the machine slows all alike.
    times = [[best_of(lambda solve=solve: solve(0), 20) for *_, solve in rows] for _ in range(15)]
    taken = np.median(times, axis=0)
    for (name, start, solve), seconds in zip(rows, taken, strict=True):
        found = [solve(k) for k in range(repeats)]
        away = np.array([theta for theta, _ in found]) - truth
        inside = np.abs(away) <= 1.96 * np.array([s for _, s in found])
        error = 100 * np.sqrt(np.mean((away / truth) ** 2))
        print(f"| {name} | {start} | {seconds / taken[0]:.2f} | {error:.2f} | {100 * np.mean(inside):.1f} |")
    print(f"\nscipy: {1e3 * taken[0]:.1f} ms each; errors and coverage over {repeats} repeats.\n")


def threads_of_blas(draws: int = 15) -> None:
    """Processor time of a whole record, judged: BLAS on as many threads as it takes by itself, on one, by the verb."""
    test = stepped_sine()
    clean = np.column_stack([test.values, test.base])
    level = next(iter(levels(test).values()))
    record = Record(
        RECORDED, test.time, clean + level * np.random.default_rng(1).standard_normal(clean.shape)
    )
    alone = vars(dashpot.identify)["__wrapped__"]
    asked = {name: os.environ.pop(name) for name in THREADS if name in os.environ}

    def on_one() -> None:
        with one_blas_thread():
            alone(paper_model(), record, diagnose=True)

    calls = {
        "BLAS on one thread": on_one,
        "dashpot.identify": lambda: dashpot.identify(paper_model(), record, diagnose=True),
        "BLAS on its default threads": lambda: alone(paper_model(), record, diagnose=True),
    }
    times = np.median([[best_of(call, 1) for call in calls.values()] for _ in range(draws)], axis=0)
    os.environ.update(asked)
    print(f"One whole record of {len(clean)} samples, four channels and the base, with its verdict\n")
    print(f"| | processor time over that of one thread ({1e3 * times[0]:.0f} ms) |")
    print("|---|---|")
    for name, taken in zip(calls, times, strict=True):
        print(f"| {name} | {taken / times[0]:.2f} |")
    print()


def commands(repeats: int = 9) -> None:
    """Processor time of `dashpot identify` on the first two examples over that of importing NumPy and SciPy."""
    examples = Path(__file__).parents[1] / "examples"
    dashpot_, first = [sys.executable, "-m", "dashpot"], examples / "01_first_fit"
    surroundings = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}

    with tempfile.TemporaryDirectory() as folder:
        surroundings["PYTHONPYCACHEPREFIX"] = f"{folder}/bytecode"  # as of installed packages

        def taken(arguments: list[str], where: Path) -> float:
            begin = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run(arguments, cwd=where, check=True, env=surroundings, capture_output=True)
            end = resource.getrusage(resource.RUSAGE_CHILDREN)
            return end.ru_utime + end.ru_stime - begin.ru_utime - begin.ru_stime

        data = f"{folder}/data.csv"
        simulate = ["simulate", "rig.toml", "--frequencies", "2:14:1", "--seed", "1", "--out", data]
        taken([*dashpot_, *simulate], first)
        rows = {
            "import numpy, scipy.linalg, scipy.optimize": (
                [sys.executable, "-c", "import numpy, scipy.linalg, scipy.optimize"],
                first,
            ),
            "dashpot identify, 13 dwells (example 01)": ([*dashpot_, "identify", "rig.toml", data], first),
            "dashpot identify, a misfit and its causes (example 02)": (
                [*dashpot_, "identify", "rig.toml", "amplitudes.csv"],
                examples / "02_shake_table",
            ),
        }
        for row in rows.values():  # bytecode, and files in memory
            taken(*row)
        times = np.median([[taken(*row) for row in rows.values()] for _ in range(repeats)], axis=0)
    print(f"Whole commands (import: {times[0]:.2f} s)\n")
    print("| | processor time over that of the import |")
    print("|---|---|")
    for name, seconds in zip(rows, times, strict=True):
        print(f"| {name} | {seconds / times[0]:.1f} |")
    print()


def batches() -> None:
    """Ten thousand repeats in one call, for rigs of different size."""
    print("10,000 identifications in one call (25 lines, displacement and velocity of every coordinate)\n")
    print("| coordinates | unknowns | s for 10,000 | µs each | one by one, over that |")
    print("|---|---|---|---|---|")
    for n in (1, 2, 4, 8):
        model, truth = chain(n)
        hz = np.linspace(1, 20, 25)
        spectrum = data(model, truth, hz, 10_000)
        single = data(model, truth, hz, 1)
        begin = time.perf_counter()
        identify(model, spectrum, OptimalIV())
        taken = time.perf_counter() - begin
        alone = best_of(lambda single=single, model=model: identify(model, single, OptimalIV()))
        each = taken / 10_000
        print(f"| {n} | {len(truth)} | {taken:.1f} | {1e6 * each:.0f} | {alone / each:.0f} × |")
    print()


def per_iteration(model: Model, truth: dict[str, float], lines: int) -> float:
    """Seconds for an iteration of 10 repeats at once: all of identify, over its iterations."""
    spectrum = data(model, truth, np.linspace(1, 20, lines), 10)
    iterations = float(np.mean(identify(model, spectrum, OptimalIV()).iterations))
    return best_of(lambda: identify(model, spectrum, OptimalIV()), 3) / iterations


def growth() -> None:
    """Time of an iteration against lines, coordinates and parameters."""
    print("Time of an iteration, over that of the first row\n")
    print("| varied | value | ratio |")
    print("|---|---|---|")
    for label, cases in (
        ("lines (4 coordinates, 8 unknowns)", [(25, 4, 0), (50, 4, 0), (100, 4, 0), (200, 4, 0)]),
        ("coordinates (50 lines, 2 unknowns each)", [(50, 2, 0), (50, 4, 0), (50, 8, 0)]),
        ("unknowns (50 lines, 8 coordinates)", [(50, 8, 0), (50, 8, 3), (50, 8, 7)]),
    ):
        first = None
        for lines, n, more in cases:
            model, truth = chain(n, more)
            taken = per_iteration(model, truth, lines)
            first = taken if first is None else first
            shown = {"lines": lines, "coordinates": n, "unknowns": len(truth)}[label.split(" ")[0]]
            print(f"| {label} | {shown} | {taken / first:.2f} |")
    print()


if __name__ == "__main__":
    one_against_peers()
    threads_of_blas()
    commands()
    batches()
    growth()
