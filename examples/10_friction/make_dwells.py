"""dwells.csv: six settled dwells of the mass with its rubbing joint, by integration in time.

python make_dwells.py dwells.csv

k 1900 N/m, c 3 N·s/m, friction 0.8 N above speeds of about 5 mm/s; 1 % noise on x.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from dashpot.model.nonlinear.integration import Integrator, forcing
from dashpot.model.nonlinear.shooting import integrate
from dashpot.model.rigfile import read_rig

HERE = Path(__file__).parent
TRUTH = {"k": 1900.0, "c": 3.0, "fc": 0.8, "fc.v0": 0.005}
FREQUENCIES = (4.0, 5.8, 7.2)  # Hz
AMPLITUDES = (0.5e-3, 1.5e-3)  # m, of the table
PERIOD, SETTLING, KEPT = 64, 30, 16  # samples of a period, periods thrown away, periods written
NOISE = 0.01  # of the rms of x in its dwell


def main(out: str) -> None:
    """Write the table."""
    model = read_rig(HERE / "rig.toml").model
    theta = np.array([TRUTH[unknown.name] for unknown in model.unknowns])
    rng = np.random.default_rng(1)
    rows = []
    for amplitude in AMPLITUDES:
        for frequency in FREQUENCIES:
            step = 1 / (frequency * PERIOD)
            time = step * np.arange((SETTLING + KEPT) * PERIOD)
            table = amplitude * np.cos(2 * np.pi * frequency * time)
            machine = Integrator(model, theta, forcing(step, table[:, None]), 4)
            x = integrate(machine, np.zeros(2)).state[:, 0]
            kept = slice(SETTLING * PERIOD, None)
            noisy = x[kept] + NOISE * np.std(x[kept]) * rng.standard_normal(KEPT * PERIOD)
            label = np.full(KEPT * PERIOD, frequency)
            rows.append(np.column_stack([label, time[: len(noisy)], 1e3 * noisy, 1e3 * table[kept]]))
    np.savetxt(out, np.concatenate(rows), "%.14g", ",", header="frequency_hz,time_s,x,u", comments="")


if __name__ == "__main__":
    main(*sys.argv[1:])
