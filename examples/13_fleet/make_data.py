"""Makes machines.csv: what 30 machines that differ by some per cent would show; one has a cracked mount.

The mounts get stiffer from machine to machine, as the mould that they come from wears.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from dashpot import read_rig
from dashpot.model.observation import with_relative_noise
from dashpot.study.simulate import dwells, simulate_spectrum

HERE = Path(__file__).parent
TYPICAL = {"m_frame": 40, "m_motor": 12, "k_mount": 6e5, "k_motor": 2e5, "c_mount": 300, "c_motor": 60}
SPREAD = {
    "m_frame": 0.005,
    "m_motor": 0.005,
    "k_mount": 0.03,
    "k_motor": 0.03,
    "c_mount": 0.1,
    "c_motor": 0.1,
}


def main() -> None:
    """Write the table beside this file."""
    rig, rng = read_rig(HERE / "rig.toml"), np.random.default_rng(11)
    model = rig.model
    channels = with_relative_noise(model, rig.channels, 0.03)
    test = dwells(model, np.linspace(8, 40, 9), 60, amplitudes={"push": 100.0})
    with open(HERE / "machines.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        parts = [f"{channel.name}_{part}" for channel in channels for part in ("re", "im", "sd")]
        writer.writerow(["serial", "frequency_hz", *parts])
        for k in range(30):
            truth = {
                name: value * (1 + SPREAD[name] * rng.standard_normal()) for name, value in TYPICAL.items()
            }
            truth["k_mount"] *= 1 + 0.1 * k / 29
            truth["k_mount"] *= 0.6 if k == 16 else 1.0
            spectrum = simulate_spectrum(model, model.parameters(model.theta(truth)), channels, test, rng)
            sd = spectrum.sd()
            for line, f in enumerate(spectrum.frequency_hz):
                amplitudes = zip(spectrum.amplitudes[line], sd[line], strict=True)
                cells = [f"{x:.6g}" for z, s in amplitudes for x in (z.real, z.imag, s)]
                writer.writerow([f"M{k + 1:03d}", f"{f:g}", *cells])


if __name__ == "__main__":
    main()
