"""What each method is worth on this test: 2,000 draws of its noise, seed 7.  Half a minute.

python repeat.py
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from make_modes import TRUTH

from dashpot.data.readers import read
from dashpot.estimate.identify import identify
from dashpot.estimate.registry import method
from dashpot.model.dynamics import response
from dashpot.model.rigfile import read_rig

HERE = Path(__file__).parent


def main() -> None:
    """Print error and coverage of each method."""
    rig = read_rig(HERE / "rig.toml")
    model = rig.model
    spectrum = read([str(HERE / "amplitudes.csv")], rig.channels).spectrum()
    theta = np.array([TRUTH[unknown.name] for unknown in model.unknowns])
    lines = spectrum.lines
    force = np.full((lines, 1), 5.0 + 0j)
    X = response(model, model.parameters(theta), spectrum.omega, np.zeros((lines, 0), dtype=complex), force)
    clean = np.concatenate([X, force], axis=-1)
    sd = np.sqrt(np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real / 2)
    rng = np.random.default_rng(7)
    draws = clean + sd * (
        rng.standard_normal((2000, *sd.shape)) + 1j * rng.standard_normal((2000, *sd.shape))
    )
    free = [j for j, unknown in enumerate(model.unknowns) if unknown.sd is None]
    print("method  median error   intervals that hold the truth")
    for name in ("hls", "iv", "wls", "tls", "cls", "oiv", "ml"):
        found = identify(model, replace(spectrum, amplitudes=draws), method(name))
        error = np.abs(found.values / theta - 1)[:, free]
        low, high = found.interval()
        held = 100 * np.mean((low <= theta) & (theta <= high), axis=0)[free]
        print(f"{name:6}  {100 * np.median(error):12.1f}%  {held.min():.0f} to {held.max():.0f} %")


if __name__ == "__main__":
    main()
