"""Pictures of a Monte Carlo study: from its summaries to arrays to figures."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from dashpot.arrays import Real
from dashpot.present.figures import study as draw
from dashpot.present.figures.style import method_colour, png
from dashpot.present.text.study import COUNTED_FACTORS, factor_text, varied_factors
from dashpot.study.runner import StudyOutcome, SummaryRow
from dashpot.study.summary import LEVELS, Summary

FEWEST = 3  # points that make a curve
MOST_PANELS = 6  # parameters drawn in one figure
MOST_BARS = 8

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
                sets.setdefault((rest, _names(row)), []).append(row)
        for (rest, names), rows in sets.items():
            group = _group(factor, rest, names, rows)
            if len(group.values) >= least:
                made.append(group)
    return made


def _names(row: SummaryRow) -> tuple[str, ...]:
    return row.scenario.model.unknown_names


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
    """PNG files by name: for each numeric factor errors and accuracy over it, for each other factor bars."""
    made: dict[str, bytes] = {}
    for group in groups(outcome):
        drawn = _curves(group) if group.factor in COUNTED_FACTORS else _bars(group, _title(group, outcome))
        for kind, figure in drawn:
            stem = "_".join(filter(None, [group.factor, kind, _slug(group, outcome)]))
            name, k = stem, 1
            while name in made:
                k += 1
                name = f"{stem}_{k}"
            made[name] = png(figure)
    return made


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
    shown = range(min(len(group.parameters), MOST_PANELS))
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
