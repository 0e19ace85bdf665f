"""transmissibility.png from amplitudes.csv and the two rig files:  python make_figure.py [OUT.png]"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dashpot.data.readers import read
from dashpot.estimate.identify import identify
from dashpot.model.dynamics import response
from dashpot.model.rigfile import read_rig
from dashpot.present.figures.style import COLOURS, style

HERE = Path(__file__).parent
RIGS = {"rig.toml": "-", "rig_bending.toml": "--"}


def main(out: str = str(HERE / "transmissibility.png")) -> None:
    """Amplitude of each floor over the base's: measured as dots, the two models as lines."""
    f = np.geomspace(0.9, 22.0, 1500)
    with style():
        figure = Figure(figsize=(7.6, 4.2))
        axes = figure.subplots()
        for name, line in RIGS.items():
            rig = read_rig(HERE / name)
            spectrum = read(str(HERE / "amplitudes.csv"), rig.channels).spectrum()
            estimate = identify(rig.model, spectrum)
            found = estimate.parameters()
            p = np.array([found[element.name].value for element in rig.model.elements])
            X = response(rig.model, p, 2 * np.pi * f, np.ones((len(f), 1), dtype=complex))
            floors = spectrum.amplitudes[:, 1:] / spectrum.amplitudes[:, :1]
            for i, coordinate in enumerate(rig.model.coordinates):
                if line == "-":
                    axes.plot(
                        spectrum.frequency_hz,
                        np.abs(floors[:, i]),
                        "o",
                        ms=4,
                        color=COLOURS[i],
                        label=coordinate,
                    )
                label = name if i == 0 else None
                axes.plot(f, np.abs(X[:, i]), line, lw=1, color=COLOURS[i], label=label)
        axes.set(
            xscale="log", yscale="log", ylim=(0.03, 100), xlabel="frequency, Hz", ylabel="floor over base"
        )
        axes.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
        axes.legend(ncols=2)
        figure.savefig(out, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main(*sys.argv[1:])
