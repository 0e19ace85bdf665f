"""Bouc-Wen's hysteresis from whole records: intervals that hold, and records that were not used.

`python3 dev.py bench bouc_wen`.  One mass on a spring, a damper and Bouc-Wen's element (THEORY §9: m 2, c 10, k 5e4,
α 5e4, β 1e3, γ 0.8, δ −1.1, ν 1) is driven by a random-phase multisine of 5-150 Hz and 50 N rms at 750 Hz and simulated
by a Runge-Kutta method of its own.  Each draw has phases and noise (8e-6 m) of its own; every start is 10-20 % off.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from scipy.interpolate import CubicSpline

from dashpot.data.record import Record
from dashpot.estimate.nonlinear.whole_record import fit_records, followed_record
from dashpot.model.rigfile import parse_rig

RATE, NOISE, FINE = 750.0, 8e-6, 20  # samples a second; m; steps of the simulation between samples
TRUTH = {
    "m": 2.0,
    "k": 5e4,
    "alpha": 5e4,
    "c": 10.0,
    "alpha.gamma": 800.0,
    "alpha.delta": -1100.0,
    "alpha.nu": 1.0,
}
RIG = """
coordinates = ["y"]
[inputs]
f = { at = "y", kind = "force" }
[masses]
m = { at = "y", guess = 1.8 }
[springs]
k = { between = ["y", "ground"], guess = 4.5e4 }
alpha = { between = ["y", "ground"], law = "bouc-wen", guess = 5.5e4, gamma = { guess = 700 }, delta = { guess = -900 },
    nu = { guess = 1.1, min = 0.3, max = 3 } }
[dampers]
c = { between = ["y", "ground"], guess = 12 }
[channels]
f = { of = "f", quantity = "force" }
y = { of = "y" }
""".replace(",\n    nu", ", nu")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=20)
    options.add_argument("--samples", type=int, default=1024, help="of each draw")
    options.add_argument(
        "--predict", action="store_true", help="a fresh multisine and a sweep, by the last draw"
    )
    given = options.parse_args()
    rig = parse_rig(RIG)
    away, seconds = [], []
    for draw in range(given.draws):
        begun = time.process_time()
        estimate = fit_records(
            rig.model, [record(rig, multisine(given.samples, draw), NOISE, draw)]
        ).estimate()
        seconds.append(time.process_time() - begun)
        truth = np.array([TRUTH.get(name, 0.0) for name in estimate.names])
        away.append((estimate.values - truth) / estimate.sd)
        words = [
            f"{n} {v:.5g} ± {s:.2g}"
            for n, v, s in zip(estimate.names, estimate.values, estimate.sd, strict=True)
        ]
        print(f"{seconds[-1]:.1f} s: {', '.join(words)}", flush=True)
    spread = np.sqrt(np.mean(np.square(away), axis=0))
    print(
        "rms error over stated sd:",
        ", ".join(f"{n} {s:.2f}" for n, s in zip(estimate.names, spread, strict=True)),
    )
    print(
        f"within 1.96 sd: {100 * np.mean(np.abs(away) < 1.96):.1f} %; {np.median(seconds):.1f} s of processor time"
    )
    if given.predict:
        for name, force in (("multisine", multisine(8192, 1000)), ("sweep 20-50 Hz, 40 N", sweep(60.0))):
            error = followed_record(rig.model, estimate, record(rig, force, 0.0, 0)).compared().rms[0]
            print(f"{name}: {error:.3g} m rms ({20 * np.log10(error):.1f} dB)", flush=True)


def multisine(samples: int, seed: int) -> np.ndarray:
    """Random phases at all lines from 5 to 150 Hz, 50 N rms."""
    lines = np.arange(samples // 2 + 1) * RATE / samples
    phases = np.exp(2j * np.pi * np.random.default_rng(seed).random(len(lines)))
    force = np.fft.irfft(np.where((lines >= 5) & (lines <= 150), phases, 0), samples)
    return 50 * force / np.std(force)


def sweep(seconds: float) -> np.ndarray:
    """A sine of 40 N from 20 to 50 Hz."""
    t = np.arange(round(seconds * RATE)) / RATE
    return 40 * np.sin(2 * np.pi * (20 * t + 15 * t**2 / seconds))


def record(rig, force: np.ndarray, noise: float, seed: int) -> Record:
    """From rest, by the classical Runge-Kutta method; the force is a cubic spline between samples."""
    count = (len(force) - 1) * FINE
    h = 1 / RATE / FINE
    drive = CubicSpline(np.arange(len(force)) / RATE, force)(np.arange(2 * count + 1) * h / 2).tolist()
    state, y = (0.0, 0.0, 0.0), [0.0]
    for i in range(count):
        one = rates(state, drive[2 * i])
        two = rates(moved(state, one, h / 2), drive[2 * i + 1])
        three = rates(moved(state, two, h / 2), drive[2 * i + 1])
        four = rates(moved(state, three, h), drive[2 * i + 2])
        state = tuple(
            s + h / 6 * (a + 2 * b + 2 * c + d)
            for s, a, b, c, d in zip(state, one, two, three, four, strict=True)
        )
        if (i + 1) % FINE == 0:
            y.append(state[0])
    noisy = np.array(y) + noise * np.random.default_rng([seed, 1]).standard_normal(len(y))
    return Record(rig.channels, np.arange(len(force)) / RATE, np.column_stack([force, noisy]))


def rates(state: tuple[float, ...], force: float) -> tuple[float, ...]:
    """m ÿ + c ẏ + k y + z = f, ż = α ẏ − β (γ |ẏ| z + δ ẏ |z|)."""
    y, v, z = state
    return v, (force - 10 * v - 5e4 * y - z) / 2, 5e4 * v - 1e3 * (0.8 * abs(v) * z - 1.1 * v * abs(z))


def moved(state: tuple[float, ...], rate: tuple[float, ...], h: float) -> tuple[float, ...]:
    """The state a step of h further along its rates."""
    return tuple(s + h * r for s, r in zip(state, rate, strict=True))


if __name__ == "__main__":
    main()
