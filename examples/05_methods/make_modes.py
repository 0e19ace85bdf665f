"""modes.csv: what a modal test of the frame might give, from its true parameters and a seed.

python make_modes.py rig.toml modes.csv
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from dashpot.model.modes import modes
from dashpot.model.rigfile import read_rig

TRUTH = {
    "m1": 2.0,
    "m2": 1.5,
    "m3": 1.0,
    "k1": 3000.0,
    "k2": 2000.0,
    "k3": 1500.0,
    "c1": 6.0,
    "c2": 4.0,
    "c3": 3.0,
}
FREQUENCY, DAMPING, SHAPE = (
    0.002,
    0.05,
    0.02,
)  # standard deviations over the value; shapes over their largest entry


def main(rig_file: str, target: str) -> None:
    """Write the modes with their noise."""
    model = read_rig(rig_file).model
    found = modes(model, np.array([TRUTH[element.name] for element in model.elements]))
    rng = np.random.default_rng(1)
    points = [f"{x}_{part}" for x in model.coordinates for part in ("re", "im", "sd")]
    rows = [",".join(["frequency_hz", "frequency_sd", "damping_ratio", "damping_sd", *points])]
    for f, zeta, shape in zip(found.frequency_hz, found.damping_ratio, found.shapes, strict=True):
        size = SHAPE * np.max(np.abs(shape))
        noise = rng.standard_normal(2 + 2 * len(shape))
        cells = [
            f * (1 + FREQUENCY * noise[0]),
            f * FREQUENCY,
            zeta * (1 + DAMPING * noise[1]),
            zeta * DAMPING,
        ]
        for i, value in enumerate(shape):
            cells += [value.real + size * noise[2 + 2 * i], value.imag + size * noise[3 + 2 * i], size]
        rows.append(",".join(f"{cell:.5g}" for cell in cells))
    Path(target).write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:3])
