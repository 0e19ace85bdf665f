"""A Monte Carlo study to look at: one line for each scenario and method, and pictures of what was varied."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap

import numpy as np
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dashpot.arrays import Real
from dashpot.errors import DataError
from dashpot.io.atomic import write_bytes
from dashpot.present.figures import study as draw
from dashpot.study.runner import Outcome, SummaryRow
from dashpot.study.summary import LEVELS, Summary

NUMERIC = {"noise": "noise level", "samples": "samples a frequency", "in_all": "samples in all"}
NOTHING = "–"
MOST_COLUMNS = 3  # of factors; more are put into one
LABEL = 21  # characters of that one on a line: 80 columns hold the rest beside it
FEWEST = 3  # points that make a curve
MOST_PANELS = 6  # parameters drawn in one figure
MOST_BARS = 8


def show(found: Outcome, console: Console) -> None:
    """What varies, and how each method did: rms over the parameters, worst coverage, failures."""
    rows = found.rows
    varied = _varied(rows)
    fixed = [f"{key} {_text(value)}" for key, value in rows[0].scenario.factors.items() if key not in varied]
    console.print(f"{found.name}, seed {found.seed}", style="bold", markup=False)
    if fixed:
        console.print("In all: " + ", ".join(fixed), markup=False, style="dim")
    apart = len(varied) <= MOST_COLUMNS
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for name in varied if apart else [", ".join(varied)]:
        table.add_column(
            escape(name.replace("_", " ")), justify="right" if apart and name in NUMERIC else "left"
        )
    for name in ("method", "bias", "spread", "bound", "ratio", "coverage", "failed"):
        table.add_column(name, justify="left" if name == "method" else "right", no_wrap=True)
    before, wrapped = None, [""]
    for row in rows:
        s = row.summary
        first = before is not row.scenario
        if first and before is not None:
            table.add_section()
        before = row.scenario
        cells = [_text(row.scenario.factors.get(name)) if first else "" for name in varied]
        if not apart:
            if first:
                wrapped = wrap(", ".join(cell for cell in cells if cell != NOTHING), LABEL)
            # A long label goes on beside the next methods; what is left at the last one takes lines of its own.
            last = row.method == row.scenario.methods[-1]
            cells = ["\n".join(wrapped) if last else wrapped[0] if wrapped else ""]
            wrapped = wrapped[1:]
        table.add_row(
            *map(escape, cells), row.method, f"{_rms(s.mean):.2f}", f"{s.rms_spread:.2f}", f"{s.rms_bound:.2f}",
            f"{s.rms_spread / s.rms_bound:.2f}" if s.rms_bound > 0 else NOTHING,
            f"{np.min(s.coverage):.1f}–{np.max(s.coverage):.1f}", f"{s.failed}/{s.draws}" if s.failed else NOTHING,
        )  # fmt: skip
    console.print(table)
    console.print(
        "bias, spread, bound: rms over the parameters, % of their true values. bound: Cramér-Rao at the truth. ratio: "
        "spread / bound. coverage: least and greatest share of 95 % intervals that hold the truth, %.",
        markup=False,
        style="dim",
    )


def _rms(values: Real) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _text(value: object) -> str:
    return NOTHING if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _varied(rows: Iterable[SummaryRow]) -> list[str]:
    """Factors that are not the same in all scenarios."""
    all_rows = list(rows)
    names = dict.fromkeys(key for row in all_rows for key in row.scenario.factors)
    return [name for name in names if len({row.scenario.factors.get(name) for row in all_rows}) > 1]


# Pictures


Rest = tuple[tuple[str, str | float | int], ...]


@dataclass(frozen=True)
class Group:
    """Scenarios that differ in one factor alone: its values, and the summaries by method (a list over the values)."""

    factor: str
    rest: Rest
    values: tuple[object, ...]
    parameters: tuple[str, ...]
    summaries: dict[str, list[Summary]]


def groups(found: Outcome) -> list[Group]:
    """All sets of scenarios that differ in one factor alone and are worth a picture."""
    made = []
    for factor in _varied(found.rows):
        least = FEWEST if factor in NUMERIC else 2
        sets: dict[tuple[Rest, tuple[str, ...]], list[SummaryRow]] = {}
        for row in found.rows:
            factors = row.scenario.factors
            if factor in factors:
                rest = tuple((key, value) for key, value in factors.items() if key != factor)
                sets.setdefault((rest, _names(row)), []).append(row)
        for (rest, names), rows in sets.items():
            own = _group(factor, rest, names, rows)
            if len(own.values) >= least:
                made.append(own)
    return made


def _names(row: SummaryRow) -> tuple[str, ...]:
    return tuple(unknown.name for unknown in row.scenario.model.unknowns)


def _group(factor: str, rest: Rest, names: tuple[str, ...], rows: Sequence[SummaryRow]) -> Group:
    by_method: dict[str, dict[object, Summary]] = {}
    for row in rows:
        by_method.setdefault(row.method, {})[row.scenario.factors[factor]] = row.summary
    values = list(dict.fromkeys(row.scenario.factors[factor] for row in rows))
    if factor in NUMERIC:
        values.sort(key=float)
    complete = {
        name: [own[value] for value in values] for name, own in by_method.items() if len(own) == len(values)
    }
    return Group(factor, rest, tuple(values) if complete else (), names, complete)


def pictures(found: Outcome) -> dict[str, bytes]:
    """PNG files by name: for each numeric factor errors and accuracy over it, for each other factor bars."""
    made: dict[str, bytes] = {}
    for own in groups(found):
        drawn = _curves(own) if own.factor in NUMERIC else _bars(own, _title(own, found))
        for kind, figure in drawn:
            stem = "_".join(filter(None, [own.factor, kind, _slug(own, found)]))
            name, k = stem, 1
            while name in made:
                k += 1
                name = f"{stem}_{k}"
            made[name] = draw.png(figure)
    return made


def _slug(own: Group, found: Outcome) -> str:
    """What distinguishes a group from others of its factor, as part of a file name."""
    parts = [_text(value) for key, value in own.rest if key in _varied(found.rows)]
    return re.sub(r"[^A-Za-z0-9._]+", "-", "_".join(parts)).strip("-")[:80]


def _title(own: Group, found: Outcome) -> str:
    """The same in words."""
    varied = _varied(found.rows)
    parts = [f"{key.replace('_', ' ')} {_text(value)}" for key, value in own.rest if key in varied]
    return ", ".join(parts) if parts else found.name


def _curves(own: Group) -> Iterable[tuple[str, Figure]]:
    x = np.array(own.values, dtype=float)
    if own.factor == "noise" and ("kind", "relative") in own.rest:
        x, label = 100 * x, "noise level ρ, %"
    else:
        label = NUMERIC[own.factor]
    logarithmic = own.factor != "noise" and float(np.max(x)) > 4 * float(np.min(x))
    shown = range(min(len(own.parameters), MOST_PANELS))
    bands = [_bands(own, j) for j in shown]
    limits = [_limits(panel) for panel in bands]
    yield (
        "errors",
        draw.band_panels(
            [own.parameters[j] for j in shown],
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
                    draw.colour(method, k),
                    _over(own, method, lambda s: s.rms_spread),
                    _over(own, method, lambda s: _rms(s.mean)),
                    _over(own, method, lambda s: float(np.mean(s.coverage))),
                    _over(own, method, lambda s: float(np.min(s.coverage))),
                    _over(own, method, lambda s: float(np.max(s.coverage))),
                )
                for k, method in enumerate(own.summaries)
            ],
            np.array([summary.rms_bound for summary in next(iter(own.summaries.values()))]),
            label,
            logarithmic=logarithmic or own.factor == "noise",
        ),
    )


def _bands(own: Group, parameter: int) -> list[draw.Band]:
    """Mean and middle 95 % of the errors of one parameter, for each method."""

    def quantile(level: float) -> Callable[[Summary], float]:
        return lambda s: float(s.quantiles[LEVELS.index(level), parameter])

    return [
        draw.Band(
            method,
            draw.colour(method, k),
            _over(own, method, lambda s: float(s.mean[parameter])),
            _over(own, method, quantile(0.025)),
            _over(own, method, quantile(0.975)),
            k == len(own.summaries) - 1 > 0,
        )
        for k, method in enumerate(own.summaries)
    ]


def _over(own: Group, method: str, read: Callable[[Summary], float]) -> Real:
    return np.array([read(summary) for summary in own.summaries[method]], dtype=float)


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


def _bars(own: Group, title: str) -> Iterable[tuple[str, Figure]]:
    places = [_text(value) for value in own.values[:MOST_BARS]]
    methods = list(own.summaries)
    bound = np.array([summary.rms_bound for summary in own.summaries[methods[0]][:MOST_BARS]])

    def series(read: Callable[[Summary], float], error: Callable[[Summary], float]) -> list[draw.Series]:
        return [
            draw.Series(
                method,
                draw.colour(method, k),
                _over(own, method, read)[:MOST_BARS],
                _over(own, method, error)[:MOST_BARS],
            )
            for k, method in enumerate(methods)
        ]

    spread = series(lambda s: s.rms_spread, lambda s: s.rms_spread / np.sqrt(2 * max(s.draws - s.failed, 1)))
    yield "", draw.bar_panels([title], places, [spread], [bound], "rms relative spread, %")


# Files


def write(found: Outcome, folder: str | Path) -> list[str]:
    """Write the pictures into the folder, made if missing; what was written.  Raises DataError where it cannot be."""
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(
            f"the folder cannot be made ({error.strerror or error})", str(target), "name another one"
        ) from None
    written = []
    for name, content in pictures(found).items():
        write_bytes(target / f"{name}.png", content)
        written.append(str(target / f"{name}.png"))
    return written
