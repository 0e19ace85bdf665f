"""Figures of Monte Carlo studies, from arrays alone."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from dashpot.arrays import Real
from dashpot.present.figures import study as draw
from dashpot.present.figures.style import INK, MUTED, limit_axis, method_colour, png, style
from dashpot.present.text.study import COUNTED_FACTORS, factor_text, varied_factors
from dashpot.study.montecarlo import LEVELS, StudyOutcome, Summary, SummaryRow

# Pictures of a Monte Carlo study: from its summaries to arrays to figures.


FEWEST = 3  # points that make a curve
MOST_BARS = 8
MOST_ALIKE = (
    12  # groups of one factor that are drawn, evenly spread: bars at each of 200 noise levels are 200 figures
)

Rest = tuple[tuple[str, str | float | int], ...]


@dataclass(frozen=True)
class FactorGroup:
    """Scenarios that differ in one factor alone: its values, and the summaries by method (a list over the values)."""

    factor: str
    rest: Rest
    values: tuple[object, ...]
    parameters: tuple[str, ...]
    summaries: dict[str, list[Summary]]


def groups(outcome: StudyOutcome) -> list[FactorGroup]:
    """All sets of scenarios that differ in one factor alone and are worth a picture."""
    made = []
    for factor in varied_factors(outcome.rows):
        least = FEWEST if factor in COUNTED_FACTORS else 2
        sets: dict[tuple[Rest, tuple[str, ...]], list[SummaryRow]] = {}
        for row in outcome.rows:
            factors = row.scenario.factors
            if factor in factors:
                rest = tuple((key, value) for key, value in factors.items() if key != factor)
                sets.setdefault((rest, row.scenario.model.unknown_names), []).append(row)
        for (rest, names), rows in sets.items():
            group = _group(factor, rest, names, rows)
            if len(group.values) >= least:
                made.append(group)
    return made


def _group(factor: str, rest: Rest, names: tuple[str, ...], rows: Sequence[SummaryRow]) -> FactorGroup:
    by_method: dict[str, dict[object, Summary]] = {}
    for row in rows:
        by_method.setdefault(row.method, {})[row.scenario.factors[factor]] = row.summary
    values = list(dict.fromkeys(row.scenario.factors[factor] for row in rows))
    if factor in COUNTED_FACTORS:
        values.sort(key=float)
    complete = {
        name: [summaries[value] for value in values]
        for name, summaries in by_method.items()
        if len(summaries) == len(values)
    }
    return FactorGroup(factor, rest, tuple(values) if complete else (), names, complete)


def study_pictures(outcome: StudyOutcome) -> dict[str, bytes]:
    """PNG files by name: for each numeric factor errors and accuracy over it, for each other factor bars.

    Of many groups of one factor some are drawn.
    """
    made: dict[str, bytes] = {}
    for group in _drawn(groups(outcome)):
        drawn = _curves(group) if group.factor in COUNTED_FACTORS else _bars(group, _title(group, outcome))
        for kind, figure in drawn:
            stem = "_".join(filter(None, [group.factor, kind, _slug(group, outcome)]))
            name, k = stem, 1
            while name in made:
                k += 1
                name = f"{stem}_{k}"
            made[name] = png(figure)
    return made


def _drawn(every: Sequence[FactorGroup]) -> Iterable[FactorGroup]:
    """Groups of each factor, the first and the last among them, no more than MOST_ALIKE."""
    for _, alike in groupby(every, key=lambda group: group.factor):
        several = list(alike)
        places = np.linspace(0, len(several) - 1, min(len(several), MOST_ALIKE))
        yield from (several[int(place)] for place in places)


def _slug(group: FactorGroup, outcome: StudyOutcome) -> str:
    """What distinguishes a group from others of its factor, as part of a file name."""
    parts = [factor_text(value) for key, value in group.rest if key in varied_factors(outcome.rows)]
    return re.sub(r"[^A-Za-z0-9._]+", "-", "_".join(parts)).strip("-")[:80]


def _title(group: FactorGroup, outcome: StudyOutcome) -> str:
    """The same in words."""
    varied = varied_factors(outcome.rows)
    parts = [f"{key.replace('_', ' ')} {factor_text(value)}" for key, value in group.rest if key in varied]
    return ", ".join(parts) if parts else outcome.name


def _curves(group: FactorGroup) -> Iterable[tuple[str, Figure]]:
    x = np.array(group.values, dtype=float)
    if group.factor == "noise" and ("kind", "relative") in group.rest:
        x, label = 100 * x, "noise level ρ, %"
    else:
        label = COUNTED_FACTORS[group.factor]
    logarithmic = group.factor != "noise" and float(np.max(x)) > 4 * float(np.min(x))
    shown = range(min(len(group.parameters), 6))  # parameters drawn in one figure
    bands = [_bands(group, j) for j in shown]
    limits = [_limits(panel) for panel in bands]
    yield (
        "errors",
        draw.band_panels(
            [group.parameters[j] for j in shown],
            x,
            bands,
            [[] for _ in shown],
            label,
            "relative error, %",
            logarithmic=logarithmic,
            limits=limits,
        ),
    )
    yield (
        "accuracy",
        draw.accuracy_panels(
            x,
            [
                draw.Accuracy(
                    method,
                    method_colour(method, k),
                    _over(group, method, lambda s: s.rms_spread),
                    _over(group, method, lambda s: s.rms_bias),
                    _over(group, method, lambda s: float(np.mean(s.coverage))),
                    _over(group, method, lambda s: float(np.min(s.coverage))),
                    _over(group, method, lambda s: float(np.max(s.coverage))),
                )
                for k, method in enumerate(group.summaries)
            ],
            np.array([summary.rms_bound for summary in next(iter(group.summaries.values()))]),
            label,
            logarithmic=logarithmic or group.factor == "noise",
        ),
    )


def _bands(group: FactorGroup, parameter: int) -> list[draw.Band]:
    """Mean and middle 95 % of the errors of one parameter, for each method."""

    def quantile(level: float) -> Callable[[Summary], float]:
        return lambda s: float(s.quantiles[LEVELS.index(level), parameter])

    return [
        draw.Band(
            method,
            method_colour(method, k),
            _over(group, method, lambda s: float(s.mean[parameter])),
            _over(group, method, quantile(0.025)),
            _over(group, method, quantile(0.975)),
            k == len(group.summaries) - 1 > 0,
        )
        for k, method in enumerate(group.summaries)
    ]


def _over(group: FactorGroup, method: str, read: Callable[[Summary], float]) -> Real:
    return np.array([read(summary) for summary in group.summaries[method]], dtype=float)


def _limits(bands: Sequence[draw.Band]) -> tuple[float, float]:
    """Room for all bands; one that is far wider than the others is cut off at thrice the second widest."""
    edges = [(float(np.nanmin(band.low)), float(np.nanmax(band.high))) for band in bands]
    widths = sorted((high - low for low, high in edges), reverse=True)
    kept = [
        (low, high) for low, high in edges if len(widths) < 2 or high - low <= 3 * widths[1] or widths[1] == 0
    ] or edges
    low, high = min(pair[0] for pair in kept), max(pair[1] for pair in kept)
    room = 0.05 * (high - low) if high > low else 1.0
    return low - room, high + room


def _bars(group: FactorGroup, title: str) -> Iterable[tuple[str, Figure]]:
    places = [factor_text(value) for value in group.values[:MOST_BARS]]
    methods = list(group.summaries)
    bound = np.array([summary.rms_bound for summary in group.summaries[methods[0]][:MOST_BARS]])

    def series(read: Callable[[Summary], float], error: Callable[[Summary], float]) -> list[draw.Series]:
        return [
            draw.Series(
                method,
                method_colour(method, k),
                _over(group, method, read)[:MOST_BARS],
                _over(group, method, error)[:MOST_BARS],
            )
            for k, method in enumerate(methods)
        ]

    spread = series(lambda s: s.rms_spread, lambda s: s.rms_spread / np.sqrt(2 * max(s.draws - s.failed, 1)))
    yield "", draw.bar_panels([title], places, [spread], [bound], "rms relative spread, %")


@dataclass(frozen=True)
class Band:
    """A line with a band around it; `low` and `high` are its edges, all (points,)."""

    label: str
    colour: str
    middle: Real
    low: Real
    high: Real
    dashed: bool = False

    @property
    def stroke(self) -> dict[str, Any]:
        """Line properties."""
        return {"color": self.colour, "lw": 1.7, "ls": (0, (4, 2.2)) if self.dashed else "-"}


@dataclass(frozen=True)
class Mark:
    """Single points, (points,) each."""

    label: str
    colour: str
    x: Real
    y: Real


def band_panels(
    titles: Sequence[str],
    x: Real,
    bands: Sequence[Sequence[Band]],
    marks: Sequence[Sequence[Mark]],
    x_label: str,
    y_label: str,
    *,
    logarithmic: bool = False,
    limits: Sequence[tuple[float, float]] | None = None,
    band_label: str = "band: 95 % of the draws",
) -> Figure:
    """A panel for each title with lines, bands and points over x (points,); what lies outside `limits` is cut off."""
    columns = min(len(titles), 3)
    rows = -(-len(titles) // columns)
    with style():
        figure = Figure(figsize=(2.9 * columns + 1.0, 2.9 * rows + 0.6))
        table = figure.subplots(rows, columns, squeeze=False)
        grid = list(table.flat)
        for axes in grid[len(titles) :]:
            axes.set_visible(False)
        for axes, title, panel, points in zip(grid, titles, bands, marks, strict=False):
            axes.axhline(0.0, color=MUTED, lw=0.8, zorder=1)
            for band in panel:
                axes.fill_between(x, band.low, band.high, color=band.colour, alpha=0.16, lw=0, zorder=2)
                for edge in (band.low, band.high):
                    axes.plot(x, edge, color=band.colour, lw=0.5, alpha=0.6, zorder=2)
            for band in panel:
                axes.plot(x, band.middle, zorder=3, **band.stroke)
            for mark in points:
                axes.plot(
                    mark.x, mark.y, ls="", marker="D", ms=5, mfc=mark.colour, mec="white", mew=0.9, zorder=5,
                    clip_on=False,
                )  # fmt: skip
            axes.set_title(title)
            _abscissa(axes, x, logarithmic)
        for axes in grid[max(0, len(titles) - columns) : len(titles)]:
            axes.set_xlabel(x_label)
        for axes, pair in zip(grid, limits if limits is not None else [], strict=False):
            limit_axis(axes.set_ylim, *pair)
        for axes in table[:, 0]:
            axes.set_ylabel(y_label)
        distinct = list({band.label: band for panel in bands for band in panel}.values())
        handles = [Line2D([], [], label=band.label, **band.stroke) for band in distinct]
        handles.append(Line2D([], [], color=MUTED, alpha=0.25, lw=7, label=band_label))
        handles += [
            Line2D([], [], ls="", marker="D", ms=5, mfc=mark.colour, mec="white", label=mark.label)
            for mark in {mark.label: mark for panel in marks for mark in panel}.values()
        ]
        figure.legend(handles=handles, loc="outside upper left", ncols=len(handles), handlelength=1.6)
    return figure


def _abscissa(axes: Axes, x: Real, logarithmic: bool) -> None:
    if logarithmic:
        axes.set_xscale("log")
        low, high = float(np.min(x)), float(np.max(x))
        steps = [k * 10.0**n for n in range(-12, 13) for k in (1, 2, 5)]
        axes.xaxis.set_major_locator(FixedLocator([s for s in steps if low * 0.999 <= s <= high * 1.001]))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        limit_axis(axes.set_xlim, low / 1.06, high * 1.06)
    else:
        limit_axis(axes.set_xlim, float(min(0.0, np.min(x))), float(np.max(x)))


@dataclass(frozen=True)
class Spread:
    """Where draws lie, for each row: mean and the edges of the middle half and of 95 %, (rows,); `printed` or NaN."""

    label: str
    colour: str
    mean: Real
    low: Real
    high: Real
    printed: Real


def spread_panels(
    titles: Sequence[str], rows: Sequence[str], panels: Sequence[Sequence[Spread]], x_label: str
) -> Figure:
    """A panel for each title; in it, for each row, a bar of the middle 95 % of each kind and its printed value."""
    columns = min(2, len(titles))
    lines = -(-len(titles) // columns)
    with style():
        figure = Figure(figsize=(3.9 * columns + 0.4, (0.42 * len(rows) + 0.75) * lines + 0.5))
        grid = figure.subplots(lines, columns, squeeze=False)
        for place, axes in enumerate(grid.flat):
            if place >= len(titles):
                axes.set_visible(False)
                continue
            _spread_panel(axes, rows, panels[place])
            axes.set_title(titles[place])
        for axes in grid[-1]:
            axes.set_xlabel(x_label)
        colours = {spread.label: spread.colour for spreads in panels for spread in spreads}
        handles = [
            *(
                Patch(color=colour, alpha=0.28, lw=0, label=f"{label}, 95 % of draws")
                for label, colour in colours.items()
            ),
            Line2D([], [], ls="", marker="|", ms=7, mew=1.6, color=INK, label="mean of the draws"),
            Line2D([], [], ls="", marker="D", ms=4.6, mfc=INK, mec="white", label="printed in the paper"),
        ]
        figure.legend(handles=handles, loc="outside upper left", ncols=len(handles), handlelength=1.4)
    return figure


def _spread_panel(axes: Axes, rows: Sequence[str], spreads: Sequence[Spread]) -> None:
    """One row for each name; in it the spreads side by side."""
    axes.axvline(0.0, color=MUTED, lw=0.8, zorder=1)
    step = 0.62 / max(len(spreads), 1)
    for k, spread in enumerate(spreads):
        y = np.arange(len(rows)) + (k - (len(spreads) - 1) / 2) * step
        axes.barh(
            y, spread.high - spread.low, left=spread.low, height=0.78 * step, color=spread.colour,
            alpha=0.28, lw=0, zorder=2,
        )  # fmt: skip
        axes.plot(spread.mean, y, ls="", marker="|", ms=7, mew=1.6, color=spread.colour, zorder=3)
        axes.plot(
            spread.printed, y, ls="", marker="D", ms=4.6, mfc=spread.colour, mec="white", mew=0.8, zorder=4
        )
    axes.set_yticks(range(len(rows)), rows)
    axes.set_ylim(len(rows) - 0.45, -0.55)
    axes.use_sticky_edges = False
    axes.margins(x=0.04)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)


@dataclass(frozen=True)
class Series:
    """Values with standard errors over a few named places, (places,)."""

    label: str
    colour: str
    values: Real
    errors: Real


def bar_panels(
    titles: Sequence[str],
    places: Sequence[str],
    panels: Sequence[Sequence[Series]],
    bounds: Sequence[Real],
    y_label: str,
    bound_label: str = "Cramér-Rao bound",
) -> Figure:
    """A panel for each title with groups of bars, their values above them, and a short line at each bound.

    bounds: (places,) each.
    """
    with style():
        wide = max(3.9, min(0.6 + 0.28 * len(places) * len(panels[0]), 10.0)) if len(titles) == 1 else 3.9
        figure = Figure(figsize=(wide * len(titles) + 0.4, 3.4))
        grid = figure.subplots(1, len(titles), squeeze=False, sharey=True)[0]
        for axes, title, panel, bound in zip(grid, titles, panels, bounds, strict=True):
            width = 0.74 / len(panel)
            for k, series in enumerate(panel):
                x = np.arange(len(places)) + (k - (len(panel) - 1) / 2) * width
                axes.bar(
                    x, series.values, 0.92 * width, yerr=1.96 * series.errors, color=series.colour,
                    error_kw={"elinewidth": 0.9, "ecolor": INK},
                )  # fmt: skip
                for at, value, error in zip(x, series.values, series.errors, strict=True):
                    axes.annotate(
                        f"{value:.2f}", (at, value + 1.96 * error), (0, 2), textcoords="offset points",
                        ha="center", va="bottom", fontsize=7.5 if len(panel) < 3 else 6.5,
                    )  # fmt: skip
            for at, value in enumerate(bound):
                axes.plot([at - 0.42, at + 0.42], [value, value], color=INK, lw=1.1, ls=(0, (4, 2)), zorder=4)
            axes.set_xticks(range(len(places)), places)
            axes.grid(visible=False, axis="x")
            axes.tick_params(axis="x", length=0)
            axes.set_title("\n".join(wrap(title, int(11 * wide))))
            axes.margins(y=0.12)
        grid[0].set_ylabel(y_label)
        handles: list[Patch | Line2D] = [
            Patch(color=series.colour, label=series.label) for series in panels[0]
        ]
        handles.append(Line2D([], [], color=INK, lw=1.1, ls=(0, (4, 2)), label=bound_label))
        figure.legend(handles=handles, loc="outside upper left", ncols=len(handles), handlelength=1.8)
    return figure


@dataclass(frozen=True)
class Accuracy:
    """How one method does along an abscissa, (points,) each: rms spread and bias, coverage with its extremes, %."""

    label: str
    colour: str
    spread: Real
    bias: Real
    coverage: Real
    least: Real
    greatest: Real


def accuracy_panels(
    x: Real, methods: Sequence[Accuracy], bound: Real, x_label: str, *, logarithmic: bool
) -> Figure:
    """Spread with the bound, bias, and coverage of 95 % intervals, beside each other; points a little apart.

    x and bound (points,).
    """
    with style():
        figure = Figure(figsize=(9.7, 3.4))
        left, middle, right = figure.subplots(1, 3)
        for method in methods:
            look = {"color": method.colour, "lw": 1.5, "marker": "o", "ms": 3.4}
            left.plot(x, method.spread, zorder=3, **look)
            middle.plot(x, method.bias, zorder=3, **look)
            right.fill_between(x, method.least, method.greatest, color=method.colour, alpha=0.14, lw=0)
            right.plot(x, method.coverage, zorder=3, **look)
        left.plot(x, bound, color=INK, lw=1.1, ls=(0, (4, 2)), zorder=4)
        right.axhline(95, color=INK, lw=0.9, ls=(0, (1, 2)), zorder=2)
        for axes in (left, middle):
            _positive(axes)
        limit_axis(
            right.set_ylim, min(90.0, max(0.0, float(np.nanmin([m.least for m in methods])) - 2)), 100.5
        )
        titles = ("rms spread, %", "rms bias, %", "coverage of 95 % intervals, %")
        for axes, title in zip((left, middle, right), titles, strict=True):
            axes.set_title(title)
            axes.set_xlabel(x_label)
            _abscissa(axes, x, logarithmic)
        handles = [Line2D([], [], color=m.colour, lw=1.5, marker="o", ms=3.4, label=m.label) for m in methods]
        handles.append(Line2D([], [], color=INK, lw=1.1, ls=(0, (4, 2)), label="Cramér-Rao bound"))
        handles.append(
            Line2D([], [], color=MUTED, alpha=0.25, lw=7, label="least to greatest over the parameters")
        )
        figure.legend(handles=handles, loc="outside upper left", ncols=len(handles), handlelength=1.8)
    return figure


def _positive(axes: Axes) -> None:
    """A logarithmic ordinate with plain numbers, 1, 2, 5."""
    low, high = axes.dataLim.y0, axes.dataLim.y1
    if not (np.isfinite(low) and low > 0):
        return
    axes.set_yscale("log")
    room = (high / low) ** 0.06 if high > low else 1.5
    low, high = low / room, high * room
    wanted = (1, 2, 5) if high / low < 1e3 else (1,)
    steps = [k * 10.0**n for n in range(-12, 13) for k in wanted]
    limit_axis(axes.set_ylim, low, high)
    axes.yaxis.set_major_locator(FixedLocator([s for s in steps if low <= s <= high]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axes.yaxis.set_minor_locator(NullLocator())
