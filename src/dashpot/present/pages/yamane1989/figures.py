"""The reproduction of Yamane (1989) as figures: PNG files with their captions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from dashpot.arrays import Real
from dashpot.present.figures import study as draw
from dashpot.present.figures.style import method_colour, png
from dashpot.present.pages.yamane1989.tables import KINDS
from dashpot.reproduce.yamane1989.figures import (
    FIGURE2_PARAMETERS,
    FIGURE3_PARAMETERS,
    ErrorCurve,
    FigureData,
)
from dashpot.reproduce.yamane1989.reproduction import Reproduction
from dashpot.reproduce.yamane1989.tables import PrintedColumn

ERROR = "relative error, %"
X_LABELS = {"noise": "noise level ρ, %", "samples": "samples in all"}


def images(reproduction: Reproduction) -> dict[str, tuple[str, bytes]]:
    """Captions and PNG files by name."""
    return {
        "figure2": (
            "Figure 2. Relative error against noise level (CASE-3, 1,400 samples): mean and middle 95 % of the draws.",
            png(_curves(reproduction.figure2, FIGURE2_PARAMETERS, logarithmic=False)),
        ),
        "figure3": (
            "Figure 3. Relative error against the number of samples (CASE-3, 10 %): mean and middle 95 % of the draws.",
            png(_curves(reproduction.figure3, FIGURE3_PARAMETERS, logarithmic=True)),
        ),
        "table2": (
            "Table 2 as a picture: where the paper's single draw falls among all draws.",
            png(_spreads(reproduction.table2, ("ls", "iv", "oiv"), prefix="noise level ")),
        ),
        "table4": (
            "Table 4 as a picture: where the paper's single draw falls among all draws.",
            png(_spreads(reproduction.table4, ("iv", "oiv"))),
        ),
        "ranking": (
            "The four cases under two kinds of noise; the error bars are 95 % intervals of the Monte Carlo.",
            png(_ranking(reproduction)),
        ),
    }


def _curves(data: FigureData, parameters: Sequence[str], *, logarithmic: bool) -> Figure:
    bands, marks, limits = [], [], []
    for parameter in parameters:
        curves = [curve for curve in data.curves if curve.parameter == parameter]
        bands.append([_band(curve) for curve in curves])
        printed = []
        for method in dict.fromkeys(curve.method for curve in curves):
            points = [p for p in data.points if p.parameter == parameter and p.method == method]
            if points:
                x, y = np.array([p.x for p in points]), np.array([p.error for p in points])
                printed.append(draw.Mark(f"{method}, printed", method_colour(method), x, y))
        marks.append(printed)
        limits.append(_limits(curves))
    return draw.band_panels(
        parameters,
        curves[0].x,
        bands,
        marks,
        X_LABELS[data.over],
        ERROR,
        logarithmic=logarithmic,
        limits=limits,
    )


def _band(curve: ErrorCurve) -> draw.Band:
    return draw.Band(
        curve.method, method_colour(curve.method), curve.mean, curve.low, curve.high, curve.method == "oiv"
    )


def _limits(curves: Sequence[ErrorCurve]) -> tuple[float, float]:
    low = min(float(np.nanmin(curve.low)) for curve in curves)
    high = max(float(np.nanmax(curve.high)) for curve in curves)
    room = 0.05 * (high - low)
    return low - room, high + room


def _spreads(columns: Sequence[PrintedColumn], methods: Sequence[str], prefix: str = "") -> Figure:
    titles = list(dict.fromkeys(column.title for column in columns))
    rows = [entry.parameter for entry in columns[0].entries]
    panels = [
        [
            _spread(column)
            for method in methods
            for column in columns
            if column.title == title and column.method == method
        ]
        for title in titles
    ]
    return draw.spread_panels([prefix + title for title in titles], rows, panels, ERROR)


def _spread(column: PrintedColumn) -> draw.Spread:
    def over(name: str) -> Real:
        values = [getattr(entry, name) for entry in column.entries]
        return np.array([np.nan if value is None else value for value in values], dtype=float)

    return draw.Spread(
        column.method, method_colour(column.method), over("mean"), over("low"), over("high"), over("printed")
    )


def _ranking(reproduction: Reproduction) -> Figure:
    cases = list(dict.fromkeys(rank.case for rank in reproduction.ranking))
    panels, bounds = [], []
    for kind in KINDS:
        ranks = [rank for rank in reproduction.ranking if rank.kind == kind]
        panels.append(
            [
                draw.Series(
                    name,
                    method_colour(name),
                    np.array([getattr(rank, name) for rank in ranks]),
                    np.array([getattr(rank, f"{name}_se") for rank in ranks]),
                )
                for name in ("iv", "oiv")
            ]
        )
        bounds.append(np.array([rank.bound for rank in ranks]))
    titles = [words[0].upper() + words[1:] for words in KINDS.values()]
    return draw.bar_panels(titles, cases, panels, bounds, "rms relative spread, %")
