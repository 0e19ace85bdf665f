"""quake.csv, aftershock.csv and still.csv, simulated in time by SciPy:  python make_record.py

Masses 1.2, 1.2 and 0.9 kg; springs 900, 800 and 700 N/m; dampers 0.8, 0.6 and 0.5 N·s/m.  The ground moves as a sum of
200 waves from 0.3 to 12 Hz under an envelope.  The sensors start while the frame is moving already and stop while it
still does: 30 s at 100 Hz, with white noise of 0.02 m/s².  The aftershock is another such sum, a third as strong.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.signal import StateSpace, lsim

M = np.diag([1.2, 1.2, 0.9])
K = np.array([[900.0 + 800.0, -800.0, 0.0], [-800.0, 800.0 + 700.0, -700.0], [0.0, -700.0, 700.0]])
C = np.array([[0.8 + 0.6, -0.6, 0.0], [-0.6, 0.6 + 0.5, -0.5], [0.0, -0.5, 0.5]])
RATE, FINER, NOISE = 100, 20, 0.02


def ground(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Acceleration of the ground, m/s²: waves under an envelope that rises in 4 s and dies away."""
    f = np.linspace(0.3, 12.0, 200)
    waves = np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 2 * np.pi, f.size)) / np.sqrt(f)
    envelope = (t / 4) ** 2 * np.exp(2 * (1 - t / 4)) + 0.02
    return 0.4 * envelope * waves.sum(axis=1)


def floors(a: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Absolute acceleration of the floors, (times, 3): relative motion driven by −M a, then a added."""
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    B = np.concatenate([np.zeros((n, 1)), -np.ones((n, 1))])
    system = StateSpace(A, B, A[n:], B[n:])
    return np.asarray(lsim(system, a, t)[1]) + a[:, None]


def write(path: str, t: np.ndarray, values: np.ndarray) -> None:
    """A table with a header: time and the four channels."""
    table = np.column_stack([t, values])
    np.savetxt(path, table, delimiter=",", fmt="%.6g", header="time_s,base,x1,x2,x3", comments="")


def shaken(strength: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Times and the four channels of one event, with noise."""
    fine = np.arange(40 * RATE * FINER) / (RATE * FINER)
    a = strength * ground(fine, rng)
    motion = np.column_stack([a, floors(a, fine)])[::FINER]
    t = fine[::FINER]
    kept = (t >= 2) & (t < 32)
    return t[kept], motion[kept] + NOISE * rng.standard_normal((int(kept.sum()), 4))


def main(folder: Path = Path(__file__).parent) -> None:
    """All files, in the folder of this script or another."""
    rng = np.random.default_rng(8)
    write(str(folder / "quake.csv"), *shaken(1.0, rng))
    still = np.arange(60 * RATE) / RATE
    write(str(folder / "still.csv"), still, NOISE * rng.standard_normal((len(still), 4)))
    write(str(folder / "aftershock.csv"), *shaken(1 / 3, rng))


if __name__ == "__main__":
    main()
