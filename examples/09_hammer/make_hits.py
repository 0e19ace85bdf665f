"""hit1.csv, hit2.csv, hit3.csv and still.csv, simulated in time by SciPy:  python make_hits.py

Masses 4 and 1.5 kg; springs 60 and 25 kN/m; dampers 12 and 6 N·s/m.  Each hit is a pulse of 8 ms, as of a soft tip.
The force cell has noise of 0.5 N, the accelerometers 2 mg.  Hits follow each other before the rig has come to rest.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.signal import StateSpace, lsim

M = np.diag([4.0, 1.5])
K = np.array([[60e3 + 25e3, -25e3], [-25e3, 25e3]])
C = np.array([[12.0 + 6.0, -6.0], [-6.0, 6.0]])
RATE, FINER, LENGTH, GRAVITY = 1000, 20, 0.008, 9.80665


def pulse(t: np.ndarray, peak: float) -> np.ndarray:
    """A squared sine, N, that begins at 20 ms."""
    at = (t - 0.02) / LENGTH
    return np.where((at > 0) & (at < 1), peak * np.sin(np.pi * np.clip(at, 0, 1)) ** 2, 0.0)


def main() -> None:
    """All files, in the folder of this script."""
    rng = np.random.default_rng(9)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    B = np.concatenate([np.zeros((2, 1)), np.linalg.solve(M, [[1.0], [0.0]])])
    system = StateSpace(A, B, A[2:], B[2:])
    noise = np.array([0.5, 0.002, 0.002])
    t = np.arange(2 * RATE * FINER) / (RATE * FINER)
    state = np.zeros(4)
    here = Path(__file__).parent
    header = "time_s,hammer,acc1,acc2"
    for k, peak in enumerate([400.0, 250.0, 550.0], 1):
        force = pulse(t, peak)
        _, acceleration, states = lsim(system, force, t, state)
        state = states[-1]
        clean = np.column_stack([force, np.asarray(acceleration) / GRAVITY])[::FINER]
        seen = clean + noise * rng.standard_normal(clean.shape)
        table = np.column_stack([t[::FINER], seen])
        np.savetxt(here / f"hit{k}.csv", table, delimiter=",", fmt="%.6g", header=header, comments="")
    still = np.column_stack([np.arange(4 * RATE) / RATE, noise * rng.standard_normal((4 * RATE, 3))])
    np.savetxt(here / "still.csv", still, delimiter=",", fmt="%.6g", header=header, comments="")


if __name__ == "__main__":
    main()
