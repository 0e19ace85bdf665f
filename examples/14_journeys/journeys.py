"""Twelve journeys from a raw file to an answer, each held to the values that the file was made with.

python journeys.py                    makes the raw files, goes all ways, prints the table of README.md
python journeys.py "Free decay"       one of them
python journeys.py --figure all.png   draws how far each value lies from the reference, in standard deviations

The raw files are computed here, by the matrix exponential, the laws' formulas or known transforms: dashpot has no
part in them.  The commands are those of README.md.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import runpy
import shlex
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from scipy.linalg import expm
from scipy.signal import butter, lfilter, sosfilt
from scipy.stats import chi2

import dashpot
from dashpot.app.cli import run

HERE = Path(__file__).resolve().parent
G = 9.80665
Array = np.ndarray
Matrices = tuple[Array, Array, Array]


@dataclass(frozen=True)
class Journey:
    """Its name, what writes its raw files, and the values that these were made with, SI units."""

    name: str
    make: Callable[[np.random.Generator], None]
    reference: dict[str, float]
    check: Callable[[], None] = lambda: None  # of what else the commands wrote


@dataclass(frozen=True)
class Result:
    """What a journey came to: seconds of processor time, values less reference and their covariance, sd over bound."""

    journey: Journey
    seconds: float
    estimate: dashpot.Estimate

    @property
    def deviations(self) -> Array:
        """(value − reference) / sd of every value that has a reference."""
        at = [self.estimate[name] for name in self.journey.reference]
        return np.array([(v.value - self.journey.reference[v.name]) / v.sd for v in at])

    @property
    def p(self) -> float:
        """Probability that all values together lie further from the reference than they do."""
        names = list(self.journey.reference)
        at = [self.estimate.names.index(name) for name in names]
        off = self.estimate.values[at] - np.array([self.journey.reference[name] for name in names])
        covariance = self.estimate.covariance[np.ix_(at, at)]
        size = np.sqrt(np.diag(covariance))
        squared = (off / size) @ np.linalg.solve(covariance / np.outer(size, size), off / size)
        return float(chi2.sf(squared, len(at)))

    @property
    def over_bound(self) -> float:
        """Largest standard deviation over that at the Cramér-Rao bound."""
        return max(self.estimate[name].sd / self.estimate[name].bound_sd for name in self.journey.reference)


# ---------------------------------------------------------------- motion


def chain(masses: Sequence[float], springs: Sequence[float], dampers: Sequence[float]) -> Matrices:
    """M, C and K of masses in a row, the last spring and damper to the ground or the base."""
    joined = np.eye(len(masses)) - np.eye(len(masses), k=1)
    return np.diag(masses), joined.T @ np.diag(dampers) @ joined, joined.T @ np.diag(springs) @ joined


def motion(rig: Matrices, force: Array, step: float, start: Array | None = None) -> Array:
    """States x, v at each instant (samples, 2n), exact for forces (samples, n) that are linear in between."""
    M, C, K = rig
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    B = np.vstack([np.zeros((n, n)), np.linalg.inv(M)])
    held = np.zeros((4 * n, 4 * n))
    held[: 2 * n, : 2 * n], held[: 2 * n, 2 * n : 3 * n], held[2 * n : 3 * n, 3 * n :] = (
        A,
        B,
        np.eye(n) / step,
    )
    Phi, now, change = np.split(expm(held * step)[: 2 * n], [2 * n, 3 * n], axis=1)
    rates, shapes = np.linalg.eig(Phi)
    driven = np.zeros((len(force), 2 * n))
    driven[0] = 0 if start is None else start
    driven[1:] = force[:-1] @ now.T + np.diff(force, axis=0) @ change.T
    modal = np.linalg.solve(shapes, driven.T)
    return np.real(shapes @ [lfilter([1], [1, -rate], g) for rate, g in zip(rates, modal, strict=True)]).T


def accelerations(rig: Matrices, force: Array, states: Array) -> Array:
    """Of all masses, (samples, n)."""
    M, C, K = rig
    x, v = np.split(states, 2, axis=1)
    return np.linalg.solve(M, (force - v @ C.T - x @ K.T).T).T


def noisy(clean: Array, share: float, rng: np.random.Generator) -> Array:
    """Each column with white noise that is a share of its rms."""
    return clean + share * clean.std(axis=0) * rng.standard_normal(clean.shape)


def table(name: str, header: str, *columns: Array, digits: int = 9) -> None:
    np.savetxt(name, np.column_stack(columns), delimiter=",", fmt=f"%.{digits}g", header=header, comments="")


# ---------------------------------------------------------------- the raw files

ONE = {"k1": 2000.0, "c1": 3.0}  # of a mass of 2 kg
TWO = {"m2": 1.5, "k1": 8000.0, "k2": 5000.0, "c1": 6.0, "c2": 4.0}  # behind a mass of 2 kg


def two() -> Matrices:
    return chain([2.0, TWO["m2"]], [TWO["k1"], TWO["k2"]], [TWO["c1"], TWO["c2"]])


def free_decay(rng: np.random.Generator) -> None:
    """A logger that counts microseconds and a laser, from the release on."""
    t = np.arange(0, 6, 0.002)
    x = (
        8
        * motion(chain([2.0], [ONE["k1"]], [ONE["c1"]]), np.zeros((t.size, 1)), 0.002, np.array([1.0, 0]))[
            :, 0
        ]
    )
    table("log.csv", "micros,laser [mm]", 1e6 * t, x + 0.02 * rng.standard_normal(t.size))


DAMPER = {"k": 50e3, "c": 300.0, "fc": 40.0, "fc.v0": 0.005}


def damper(rng: np.random.Generator) -> None:
    """A second at each of three amplitudes and three frequencies, with pauses; 2 % noise in the force."""
    blocks = [(f, size) for size in (0.5e-3, 1e-3, 2e-3) for f in (2.0, 5.0, 10.0)]
    f, size = (np.repeat(each, 2000) for each in zip(*blocks, strict=True))
    t = np.arange(f.size) / 2000
    pauses = 0.5 * (np.arange(f.size) // 2000)
    d, v = size * np.sin(2 * np.pi * f * t), size * 2 * np.pi * f * np.cos(2 * np.pi * f * t)
    F = DAMPER["k"] * d + DAMPER["c"] * v + DAMPER["fc"] * np.tanh(v / DAMPER["fc.v0"])
    table("stand.csv", "frequency_hz,time_s,u,F", f, t + pauses, 1e3 * d, noisy(F, 0.02, rng))


def analyser(rng: np.random.Generator) -> None:
    """A text file for each response, of each of four taps: accelerance in dB and phase."""
    M, C, K = two()
    hz = np.arange(2, 20.5, 0.25)
    w = 2 * np.pi * hz[:, None, None]
    H = (-(w**2) * np.linalg.inv(K - w**2 * M + 1j * w * C))[:, 0]
    for tap in range(4):
        for j in range(2):
            seen = H[:, j] * (1 + 0.02 * (rng.standard_normal(hz.size) + 1j * rng.standard_normal(hz.size)))
            rows = zip(hz, 20 * np.log10(abs(seen)), np.degrees(np.angle(seen)), strict=True)
            text = "\n".join(f"{f:g}\t{size:.5f}\t{phase:.4f}" for f, size, phase in rows)
            Path(f"tap{tap}_a{j + 1}_f.txt").write_text(f"Frequency\tMagnitude [dB]\tPhase\n{text}\n")


def random_force(samples: int, rng: np.random.Generator) -> Array:
    """Up to 40 Hz, of so many samples at 500 Hz, in steps of a fiftieth of one."""
    return 130 * sosfilt(butter(4, 40, fs=25_000, output="sos"), rng.standard_normal(50 * samples))


def forced(
    force: Array, rate: float, share: float, rng: np.random.Generator, rig: Matrices | None = None
) -> tuple[Array, Array, Array]:
    """Time, force at the first mass and accelerations in g at `rate`, of a force in steps of a fiftieth of a sample."""
    rig = two() if rig is None else rig
    acting = np.column_stack([force, np.zeros(force.size)])
    a = accelerations(rig, acting, motion(rig, acting, 1 / (50 * rate)))[::50] / G
    return np.arange(len(a)) / rate, force[::50], noisy(a, share, rng)


def swept(rng: np.random.Generator) -> None:
    """The base is swept from 1 to 30 Hz in 20 s; its motion by a laser, both masses by accelerometers."""
    step = 1 / 20_000
    t = np.arange(0, 20, step)
    phase = 2 * np.pi * (t + 29 / 40 * t**2)
    u, du = 1e-3 * np.sin(phase), 1e-3 * 2 * np.pi * (1 + 29 / 20 * t) * np.cos(phase)
    force = np.column_stack([0 * t, TWO["k2"] * u + TWO["c2"] * du])
    rig = two()
    a = accelerations(rig, force, motion(rig, force, step))[::100] / G
    seen = 1e3 * noisy(u[::100], 0.001, rng), noisy(a, 0.01, rng)
    table("sweep.csv", "time_s,table [mm],acc1 [g],acc2 [g]", t[::100], *seen)


def multisine(rng: np.random.Generator) -> None:
    """Six periods of 2 s: every half hertz from 2 to 30 Hz, random phases."""
    t = np.arange(0, 12, 1 / 25_000)
    lines = np.arange(2, 30.25, 0.5)
    phases = rng.uniform(0, 2 * np.pi, lines.size)
    force = sum(np.cos(2 * np.pi * f * t + phase) for f, phase in zip(lines, phases, strict=True))
    time_s, f, a = forced(force, 500, 0.02, rng)
    table("multisine.csv", "time_s,force [N],acc1 [g],acc2 [g]", time_s, f, a)


def frame(rng: np.random.Generator) -> None:
    """Random force in a Parquet file, as pandas writes it."""
    time_s, f, a = forced(random_force(6000, rng), 500, 0.02, rng)
    columns = {"time_s": time_s, "hammer [N]": f, "a1 [g]": a[:, 0], "a2 [g]": a[:, 1]}
    pd.DataFrame(columns).to_parquet("frame.parquet")


def camera(rng: np.random.Generator) -> None:
    """A video of 60 frames a second, whose tracker gives whole pixels: 4.2 in a millimetre."""
    t = np.arange(0, 12, 1 / 60)
    start = np.array([30.0, 0])
    x = motion(chain([2.0], [400.0], [0.8]), np.zeros((t.size, 1)), 1 / 60, start)[:, 0]
    table("video.csv", "time_s,x", t, np.round(4.2 * x + 0.4 * rng.standard_normal(t.size)))


def releases(rng: np.random.Generator) -> None:
    """Two masses, let go from the first and from the second."""
    t = np.arange(0, 5, 0.004)
    for k, held in enumerate([[6.0, 2.0, 0, 0], [2.0, -5.0, 0, 0]], 1):
        x = motion(two(), np.zeros((t.size, 2)), 0.004, np.array(held))[:, :2]
        table(f"release{k}.csv", "time_s,x1,x2", t, noisy(x, 0.005, rng))


def shaker(rng: np.random.Generator) -> None:
    """Stepped sine of a table that can 5 mm, 0.2 m/s and 1 g, as large as it can, 2 s at each frequency."""
    rig, dwells = two(), []
    for f in [3.0, 5, 7, 8, 9, 10, 12, 14, 16, 20]:
        w = 2 * np.pi * f
        size = min(5e-3, 0.2 / w, G / w**2)
        t = np.arange(0, 4, 1 / 16_000)
        u, du = size * np.sin(w * t), size * w * np.cos(w * t)
        force = np.column_stack([0 * t, TWO["k2"] * u + TWO["c2"] * du])
        a = accelerations(rig, force, motion(rig, force, 1 / 16_000))[::32]
        dwells.append(np.column_stack([np.full(2000, f), t[::32], 1e3 * u[::32], noisy(a / G, 0.02, rng)]))
    table("dwells.csv", "frequency_hz,time_s,u,a1,a2", np.vstack(dwells))


def what_if(rng: np.random.Generator) -> None:
    """A random force on two masses; and another force, whose motion with a second mass of 2.5 kg is to be predicted."""
    time_s, f, a = forced(random_force(6000, rng), 500, 0.02, rng)
    table("test.csv", "time_s,f,a1,a2", time_s, f, G * a)
    heavier = chain([2.0, 2.5], [TWO["k1"], TWO["k2"]], [TWO["c1"], TWO["c2"]])
    time_s, f, a = forced(random_force(1000, rng), 500, 0, rng, heavier)
    table("drive.csv", "time_s,f", time_s, f)
    table("truth.csv", "a1,a2", G * a)


def prediction_holds() -> None:
    """The prediction of the what-if is within 1 % of the motion, and no sample further off than its band allows."""
    names = ["a1", "a2"]
    predicted = np.genfromtxt("predicted.csv", delimiter=",", names=True)
    truth = np.genfromtxt("truth.csv", delimiter=",", names=True)
    for name in names:
        off = predicted[name] - truth[name]
        assert np.std(off) < 0.01 * np.std(truth[name]), f"{name} is predicted to {np.std(off)}"
        assert np.sqrt(np.mean(off**2) / np.mean(predicted[f"{name}_sd"] ** 2)) < 3


def plan_is_within_limits() -> None:
    """Every dwell that is planned is one that the shaker can."""
    for dwell in json.loads(Path("plan.json").read_text())["dwells"]:
        w, size = 2 * np.pi * dwell["frequency_hz"], dwell["amplitudes"]["u"]
        assert size <= 1.0001 * min(5e-3, 0.2 / w, G / w**2)


def hits(rng: np.random.Generator) -> None:
    """Those of the example of a hammer."""
    Path("make_hits.py").write_bytes((HERE.parent / "09_hammer" / "make_hits.py").read_bytes())
    Path("rig.toml").write_bytes((HERE.parent / "09_hammer" / "rig.toml").read_bytes())
    runpy.run_path("make_hits.py", run_name="__main__")


def amplitudes(rng: np.random.Generator) -> None:
    """The table of the example of methods."""
    for name in ("rig.toml", "amplitudes.csv"):
        Path(name).write_bytes((HERE.parent / "05_methods" / name).read_bytes())


STOREYS = {
    "m1": 2.0,
    "m2": 1.5,
    "m3": 1.0,
    "k1": 3e3,
    "k2": 2e3,
    "k3": 1.5e3,
    "c1": 6.0,
    "c2": 4.0,
    "c3": 3.0,
}
HAMMER = {"m1": 4.0, "m2": 1.5, "k1": 60e3, "k2": 25e3, "c1": 12.0, "c2": 6.0}

JOURNEYS = (
    Journey("Free decay", free_decay, ONE),
    Journey("Damper on a test stand", damper, DAMPER),
    Journey("Responses of an analyser", analyser, TWO),
    Journey("Taps of a hammer", hits, HAMMER),
    Journey("Sine sweep", swept, TWO),
    Journey("Table of stepped sine", amplitudes, STOREYS),
    Journey("Multisine", multisine, TWO),
    Journey("Data frame", frame, TWO),
    Journey("Decay by a camera", camera, {"k1": 400.0, "c1": 0.8}),
    Journey("Several releases", releases, TWO),
    Journey("Shaker with limits", shaker, TWO, plan_is_within_limits),
    Journey("What if", what_if, TWO, prediction_holds),
)


# ---------------------------------------------------------------- on the way


def commands_of(name: str) -> list[str]:
    """The commands below the heading of that name in README.md."""
    text = (HERE / "README.md").read_text(encoding="utf-8")
    block = re.search(rf"^## {re.escape(name)}\n.*?^```\w+\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert block, f"README.md has no commands of {name!r}"
    return block[1].replace("\\\n", " ").splitlines()


def go(journey: Journey) -> Result:
    """Make the raw files in a folder of their own, and run the commands there."""
    commands = commands_of(journey.name)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for path in HERE.glob("*.toml"):
            Path(path.name).write_bytes(path.read_bytes())
        journey.make(np.random.default_rng(sum(journey.name.encode())))
        values: dict[str, Any] = {"dashpot": dashpot}
        if Path("frame.parquet").exists():
            values["frame"] = pd.read_parquet("frame.parquet")
        began = time.process_time()
        for command in commands:
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
                if command.startswith(">>> "):
                    exec(command.removeprefix(">>> "), values)
                    code = 0
                else:
                    words = shlex.split(command)[1:]
                    code = run([*words, "--json", "estimate.json"] if words[0] == "identify" else words)
            assert code == 0, f"{command}: exit code {code}\n{printed.getvalue()}"
        seconds = time.process_time() - began
        estimate = values["estimate"] if "estimate" in values else dashpot.Estimate.load("estimate.json")
        journey.check()
    return Result(journey, seconds, estimate)


def row(result: Result) -> str:
    """Of the table in README.md."""
    name, away = result.journey.name, np.max(np.abs(result.deviations))
    link = f"[{name}](#{name.lower().replace(' ', '-')})"
    return (
        f"| {link} | {len(commands_of(name))} | {result.seconds:.1f} s | {len(result.deviations)} | "
        f"{away:.1f} | {result.p:.2g} | {result.over_bound:.2f} |"
    )


def draw(results: Sequence[Result], path: str) -> None:
    """How far each value lies from the reference, in standard deviations."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.axvspan(-1.96, 1.96, color="0.92", label="95 %")
    for k, result in enumerate(results):
        axes.plot(result.deviations, np.full(len(result.deviations), k), "o", color="C0", ms=4)
    axes.set_yticks(range(len(results)), [result.journey.name for result in results])
    axes.invert_yaxis()
    axes.set_xlim(-4, 4)
    axes.set_xlabel("(value − reference) / standard deviation")
    axes.legend()
    figure.savefig(path, dpi=120)


def main(words: list[str]) -> None:
    """Go the journeys that are named, or all, and print the table."""
    figure = words.pop(words.index("--figure") + 1) if "--figure" in words else None
    named = [word for word in words if not word.startswith("--")]
    results = []
    for journey in JOURNEYS:
        if not named or journey.name in named:
            results.append(go(journey))
            print(row(results[-1]), flush=True)
    if figure:
        draw(results, figure)


if __name__ == "__main__":
    main(sys.argv[1:])
