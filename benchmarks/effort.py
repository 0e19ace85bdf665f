"""Processor time of what a user waits for: a clean test, the causes of a misfit, a tower from its modes, large rigs.

`python3 dev.py bench effort`, or `--only clean|diagnosis|tower|large`.  Clean tests are identified by the command,
start of the interpreter included; with `--old SRC`, the source folder of another version, by both in turn, and the
last column is the ratio of their least times.  The other parts run in this process: twenty mistakes on rigs of four
coordinates, all seen, identified and diagnosed; stiffnesses of 18 storeys from modes at seven of them, without
guesses; rigs of 8 to 24 coordinates.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from dashpot.channel import Channel, Quantity
from dashpot.check.deficiencies import require_identifiable
from dashpot.check.explain.examine import examined
from dashpot.errors import DashpotError, IdentifiabilityError
from dashpot.estimate.automatic import identify_with_noise
from dashpot.estimate.modal import identify_modal
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.study.simulate import dwells, simulate_spectrum

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests import rigs
from tests.mistakes import MISTAKES
from tests.unit.estimate.modal.test_identify_modal import tower

ROOT = Path(__file__).parents[1]
MOST_S = 2.0  # that a diagnosis may take
COMMAND = "import sys; from dashpot.app.cli import main; sys.exit(main())"
FIRST = ROOT / "examples" / "01_first_fit" / "rig.toml"
CLEAN = {
    "13 dwells of 200 samples": (FIRST, ("--frequencies", "2:14:1")),
    "13 dwells of 2,000 samples": (FIRST, ("--frequencies", "2:14:1", "--samples", "2000")),
    "table of 49 lines": (FIRST, ("--frequencies", "2:14:0.25", "--table")),
    "four masses, two seen, table": (None, ("--frequencies", "2:30:0.5", "--table")),
}
PARTLY_SEEN = """
coordinates = ["x1", "x2", "x3", "x4"]
[inputs]
u = {{ kind = "displacement" }}
[masses]
{masses}
[springs]
{springs}
[dampers]
{dampers}
[channels]
a1 = {{ of = "x1", quantity = "acceleration", relative_noise = 0.02 }}
a4 = {{ of = "x4", quantity = "acceleration", relative_noise = 0.02 }}
u = {{ of = "u" }}
"""


def partly_seen(folder: Path) -> Path:
    """A chain of four masses on a shaken base with accelerometers at its ends, masses known."""
    points = ("u", "x1", "x2", "x3", "x4")
    pairs = list(pairwise(points))

    def entries(letter: str, value: float) -> str:
        return "\n".join(
            f'{letter}{i} = {{ between = ["{a}", "{b}"], guess = {value * (1 + 0.2 * i):g} }}'
            for i, (a, b) in enumerate(pairs, 1)
        )

    masses = "\n".join(f'm{i} = {{ at = "x{i}", value = {1 + 0.1 * i:g} }}' for i in range(1, 5))
    rig = folder / "partly_seen.toml"
    rig.write_text(
        PARTLY_SEEN.format(masses=masses, springs=entries("k", 4000), dampers=entries("c", 3)),
        encoding="utf-8",
    )
    return rig


def processor_s(arguments: list[str], source: Path) -> float:
    """Processor time of one command with the package of a source folder."""
    environment = {**os.environ, "PYTHONPATH": str(source), "OPENBLAS_NUM_THREADS": "1"}
    before = os.times()
    subprocess.run(
        [sys.executable, "-c", COMMAND, *arguments],
        env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def clean(old: Path | None, repeats: int = 7) -> None:
    """Clean tests, by this version and another in turn."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for title, (rig, arguments) in CLEAN.items():
            rig, data = rig or partly_seen(folder), folder / "data.csv"
            processor_s(
                ["simulate", str(rig), *arguments, "--seed", "1", "-q", "-o", str(data)], ROOT / "src"
            )
            sources = [ROOT / "src", *([] if old is None else [old])]
            times = [
                [processor_s(["identify", str(rig), str(data)], source) for source in sources]
                for _ in range(repeats)
            ]
            least = np.min(times, axis=0)
            ratio = "" if old is None else f"{least[1]:7.2f} s before{least[0] / least[1]:7.2f} ×"
            print(f"{title:32}{least[0]:7.2f} s{ratio}", flush=True)


def diagnoses(seeds: range) -> Iterator[tuple[str, float]]:
    """Each mistake on random rigs of four coordinates, and the processor time of estimate and diagnosis."""
    for seed in seeds:
        rig = rigs.plain_rig(np.random.default_rng(seed), 4)
        channels = rigs.channels(rig, (Quantity.DISPLACEMENT,))
        spectrum = rigs.noisy(
            rig, channels, rigs.covariance(rig, channels, 0.01), np.random.default_rng(seed)
        )
        for name, mistake in MISTAKES.items():
            try:
                case = mistake(rig.model, spectrum, np.random.default_rng(seed))
            except (ValueError, IndexError):
                continue  # this rig has no such part to get wrong
            start = time.process_time()
            try:
                examined(case.model, case.spectrum, identify_with_noise(case.model, case.spectrum)[0])
            except DashpotError:
                continue
            yield name, time.process_time() - start


def diagnosis() -> None:
    """The times of all mistakes."""
    times = list(diagnoses(range(10)))
    seconds = np.array([each for _, each in times])
    slowest = max(times, key=lambda each: each[1])
    over = sum(each > MOST_S for each in seconds)
    print(
        f"{len(times)} misfits of four coordinates: median {np.median(seconds):.2f} s, 90 % below "
        f"{np.quantile(seconds, 0.9):.2f} s, slowest {slowest[1]:.2f} s ({slowest[0]}); "
        f"{over} over {MOST_S:g} s"
    )


def towers(count: int = 100) -> None:
    """Errors and times of so many towers."""
    errors, seconds = [], []
    for seed in range(count):
        model, data, k = tower(seed)
        start = time.process_time()
        estimate = identify_modal(model, data, seed=seed)
        seconds.append(time.process_time() - start)
        errors.append(np.max(np.abs(estimate.values / k - 1)) if bool(estimate.converged) else np.inf)
    within = int(np.sum(np.array(errors) < 0.01))
    print(
        f"18 storeys: {within} of {count} within 1 %, worst {100 * np.max(errors):.3f} %; "
        f"median {np.median(seconds):.2f} s, slowest {np.max(seconds):.2f} s"
    )


def chain(
    n: int, seen: tuple[int, ...], *, parallel: bool = False
) -> tuple[Model, dict[str, float], tuple[Channel, ...]]:
    """A chain on a shaken base, displacements of some points; `parallel` puts a second spring beside the third."""
    points = ["u", *(f"x{i}" for i in range(1, n + 1))]
    elements: list[Element] = [mass("m1", "x1", value=1.05)]
    elements += [mass(f"m{i}", points[i]) for i in range(2, n + 1)]
    truth = {f"m{i}": 1 + 0.05 * i for i in range(2, n + 1)}
    for i in range(1, n + 1):
        known = {} if len(seen) == n else {"value": 4000.0 + 100 * i}
        elements.append(between(f"k{i}", Kind.SPRING, points[i - 1], points[i], **known))
        elements.append(between(f"c{i}", Kind.DAMPER, points[i - 1], points[i]))
        truth |= {f"c{i}": 10.0 + i} | ({} if known else {f"k{i}": 4000.0 + 100 * i})
    if parallel:
        elements.append(between("k3b", Kind.SPRING, points[2], points[3]))
        truth["k3b"] = 500.0
    channels = tuple(Channel(f"y{i}", {f"x{i}": 1.0}, relative_noise=0.01) for i in seen)
    return (
        Model(tuple(points[1:]), (Input("u"),), tuple(elements)),
        truth,
        (*channels, Channel("u", {"u": 1.0})),
    )


def large() -> None:
    """Rigs of many coordinates: refused where two springs are side by side, else how many unknowns are at home."""
    cases: dict[str, Callable[[], tuple[Model, dict[str, float], tuple[Channel, ...]]]] = {
        "24 seen, two parallel springs": lambda: chain(24, tuple(range(1, 25)), parallel=True),
        "24 seen": lambda: chain(24, tuple(range(1, 25))),
        "8, five seen, springs known": lambda: chain(8, (1, 3, 5, 7, 8)),
    }
    for title, make in cases.items():
        model, truth, channels = make()
        theta = model.theta(truth)
        test = dwells(model, np.linspace(0.5, 25, 60), amplitudes={"u": 0.01})
        p = model.parameters(theta)
        spectrum = simulate_spectrum(model, p, channels, test, np.random.default_rng(1))
        start = time.process_time()
        try:
            require_identifiable(model, channels, None, spectrum)
            estimate = identify_with_noise(model, spectrum)[0]
            away = np.max(np.abs(estimate.values - theta) / estimate.sd)
            said = f"{len(theta)} unknowns, largest error {away:.1f} sd"
        except IdentifiabilityError as error:
            said = f"refused: {error}"
        print(f"{title:32}{time.process_time() - start:7.2f} s  {said}")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--only", choices=("clean", "diagnosis", "tower", "large"))
    options.add_argument("--old", type=Path, help="source folder of another version, for clean tests")
    settings = options.parse_args()
    parts = {
        "clean": lambda: clean(settings.old), "diagnosis": diagnosis, "tower": towers, "large": large,
    }  # fmt: skip
    for name, part in parts.items():
        if settings.only in (None, name):
            part()


if __name__ == "__main__":
    main()
