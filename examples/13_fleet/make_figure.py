"""stiffness.png from fleet.parquet, which dashpot fleet writes:  python make_figure.py"""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from dashpot.present.figures.style import BAD, MODEL, style, write_figure


def main() -> None:
    """Stiffness of both mounts, machine by machine, in the order of their making."""
    columns = pq.read_table("fleet.parquet").to_pydict()
    unlike, place = np.array(columns["outlier"]), np.arange(1, len(columns["name"]) + 1)
    with style():
        figure = Figure(figsize=(7.6, 4.2))
        panels = figure.subplots(2, 1, sharex=True)
        for axes, name in zip(panels, ("k_mount", "k_motor"), strict=True):
            value, sd = np.array(columns[name]) / 1e3, np.array(columns[f"{name}_sd"]) / 1e3
            for chosen, colour, label in ((~unlike, MODEL, "estimate, ±2 sd"), (unlike, BAD, "outlier")):
                axes.errorbar(
                    place[chosen], value[chosen], 2 * sd[chosen], fmt="o", ms=4, color=colour, label=label
                )
            axes.set(title=name, ylabel="kN/m")
        for k in np.flatnonzero(unlike):
            panels[0].annotate(
                columns["name"][k],
                (place[k], columns["k_mount"][k] / 1e3),
                xytext=(8, -3),
                textcoords="offset points",
            )
        panels[0].legend(loc="lower right")
        panels[1].set_xlabel("machine")
    write_figure("stiffness.png", figure)


if __name__ == "__main__":
    main()
