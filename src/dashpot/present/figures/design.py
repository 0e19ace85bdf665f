"""Figures of a planned test: where to dwell, what each frequency tells, the intervals that may be expected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator
from matplotlib.transforms import Bbox

from dashpot.arrays import Complex, Real
from dashpot.design.advise import Answer, phase_deg
from dashpot.design.plan import plan_curves
from dashpot.io.words import counted
from dashpot.present.figures.style import (
    COLOURS,
    HEAT,
    INK,
    MODEL,
    MUTED,
    heat_bar,
    limit_axis,
    plain_log,
    row_names,
    style,
)
from dashpot.present.words import short

OTHER = "#b0531a"
CLEAR = 4.0  # px around a dwell and between names
PLACES = (((6, 3), "left"), ((-6, 3), "right"), ((0, 7), "center"), ((6, -8), "left"), ((-6, -8), "right"))
FRAME: dict[str, Any] = {"frameon": True, "framealpha": 0.85, "edgecolor": "none"}  # over bars and curves


def planned_test_figure(answer: Answer) -> Figure:
    """Dwells on the directional derivative, information of each frequency about each parameter, intervals."""
    assert answer.plan is not None
    plan, setup = answer.plan, answer.setup
    curves = plan_curves(setup, answer.criterion, plan, answer.grid.low, answer.grid.high)
    names = drive_names([*setup.model.displacement_inputs, *setup.model.force_inputs], setup.drives)
    labelled = [(names[k], curve) for k, curve in zip(curves.patterns, curves.derivative, strict=True)]
    timed = plan.time_s is not None
    title = f"The next test: {counted(len(plan.dwells), 'dwell')}, {plan.samples} samples"
    title += "" if plan.time_s is None else f", {short(plan.time_s, 3)} s"
    p = plan.predicted
    bars = [j for j in range(len(p.names)) if p.values[j] != 0]  # a delay of 0 has no relative error
    tests = [Bars("this test", 100 * p.relative[bars])]
    if answer.estimate is not None:
        e = answer.estimate
        now = {n: float(s / abs(v)) if v else np.nan for n, s, v in zip(e.names, e.sd, e.values, strict=True)}
        tests.append(Bars("known now", 100 * np.array([now.get(p.names[j], np.nan) for j in bars])))
    if answer.comparison is not None:
        other, iv = answer.comparison.predicted, answer.comparison.iv
        tests.append(Bars("other test, as many samples", 100 * other.relative[bars]))
        if iv is not None and len(iv.names) == len(p.names):
            tests.append(Bars("other test by the paper's iv", 100 * iv.relative[bars]))
    return plan_figure(
        title,
        curves.frequency_hz,
        labelled,
        np.array([d.frequency_hz for d in plan.dwells]),
        np.array([d.time_s if timed else d.samples for d in plan.dwells], dtype=float),
        "s" if timed else "samples",
        p.names,
        curves.gain,
        [p.names[j] for j in bars],
        tests,
    )


def drive_names(inputs: Sequence[str], drives: Complex) -> list[str]:
    """Patterns of a drive in words: "u", "u + v", "u − v".  drives (patterns, inputs)."""
    words = []
    for row in drives:
        text = ""
        for name, z in zip(inputs, row, strict=True):
            if z == 0:
                continue
            sign = "−" if abs(z.imag) < 1e-12 and z.real < 0 else "+"
            turn = "" if abs(z.imag) < 1e-12 else f"∠{phase_deg(complex(z)):.0f}°"
            text += f"{f' {sign} ' if text else ('−' if sign == '−' else '')}{name}{turn}"
        words.append(text)
    return words


@dataclass(frozen=True)
class Bars:
    """One test's predicted relative standard deviations, per cent (parameters,), and what to call it."""

    label: str
    percent: Real


@style()
def plan_figure(
    title: str,
    frequency_hz: Real,
    curves: Sequence[tuple[str, Real]],
    dwells_hz: Real,
    dwells: Real,
    dwell_unit: str,
    names: Sequence[str],
    shares: Real,
    bars: Sequence[str],
    tests: Sequence[Bars],
) -> Figure:
    """Where to dwell and for how long, what each frequency tells of each parameter, and the expected intervals.

    frequency_hz (f,); curves: directional derivatives over it, one for each pattern of the drive, (f,); dwells_hz,
    dwells (d,); shares (f, parameters): 1 is what the average sample of the test adds.
    """
    rows = max(1.3, 0.24 * len(names) + 0.5)
    deep = max(1.4, (0.12 + 0.11 * len(tests)) * len(bars) + 0.6)
    figure = Figure(figsize=(7.4, 2.6 + rows + deep))
    top, middle, bottom = figure.subplots(3, 1, gridspec_kw={"height_ratios": [2.3, rows, deep]})
    # The curves, and over them, in axes of their own, which are given back, the dwells
    for i, (label, curve) in enumerate(curves):
        top.plot(frequency_hz, curve, color=COLOURS[i % len(COLOURS)], lw=1.4, label=label, zorder=3)
    top.axhline(1, color=MUTED, lw=0.8, ls=(0, (3, 2)), zorder=2)
    _axis(top, frequency_hz)
    top.set_ylim(0, 1.08)
    top.set_ylabel("information of a sample")
    if len(curves) > 1:
        top.legend(loc="best", **FRAME)
    over = top.twinx()
    over.grid(False)
    over.spines["right"].set_visible(True)
    most = float(np.max(dwells, initial=0.0))
    over.vlines(dwells_hz, 0, dwells, color=OTHER, lw=2.2, zorder=4)
    over.plot(dwells_hz, dwells, "o", color=OTHER, ms=5, zorder=5, clip_on=False)
    limit_axis(over.set_ylim, 0, 1.3 * most if most > 0 else 1)
    over.set_ylabel(f"dwell, {dwell_unit}", color=OTHER)
    over.yaxis.set_major_locator(MaxNLocator(5, integer=dwell_unit == "samples"))
    over.tick_params(axis="y", colors=OTHER)
    top.set_title(title)
    edges = (
        np.concatenate([[frequency_hz[0]], np.sqrt(frequency_hz[1:] * frequency_hz[:-1]), [frequency_hz[-1]]])
        if len(frequency_hz) > 1
        else np.array([frequency_hz[0] / 1.1, frequency_hz[0] * 1.1])
    )
    look: dict[str, Any] = {"cmap": HEAT, "vmin": 0, "vmax": 3, "rasterized": True}
    mesh = middle.pcolormesh(edges, np.arange(len(names) + 1), np.clip(shares.T, 0, 3), **look)
    middle.vlines(dwells_hz, 0, len(names), color=OTHER, lw=1.0, ls=(0, (2, 2)))
    middle.set_ylim(len(names), 0)
    row_names(middle, [i + 0.5 for i in range(len(names))], names)
    middle.grid(False)
    middle.set_title("Information of a sample at each frequency on each parameter")
    _axis(middle, frequency_hz)
    middle.set_xlabel("frequency, Hz")
    bar = heat_bar(mesh, middle, "× mean", [0, 1, 2, 3])
    bar.ax.set_yticklabels(["0", "1", "2", "≥ 3"])
    _intervals(bottom, bars, tests)
    if len(dwells_hz) <= 8:  # of more dwells the names have no room
        figure.draw_without_rendering()  # the layout, by which places are known
        _name_dwells(over, dwells_hz, dwells)
    return figure


def _axis(axes: Axes, f: Real) -> None:
    low, high = float(np.min(f)), float(np.max(f))
    limit_axis(axes.set_xlim, low / 1.02, high * 1.02)
    if high > 2 * low:
        axes.set_xscale("log")
        plain_log(axes.xaxis, (1.0, 2.0, 5.0) if high > 8 * low else range(1, 10))
        axes.xaxis.set_minor_locator(NullLocator())


def _name_dwells(axes: Axes, dwells_hz: Real, dwells: Real) -> None:
    """The frequency of each dwell beside its dot, the longest first, where it touches no other name or dwell."""
    dots = axes.transData.transform(np.stack([dwells_hz, dwells], axis=1))
    frame = axes.get_window_extent()
    stems = [Bbox([[x - CLEAR, frame.y0], [x + CLEAR, y + CLEAR]]) for x, y in dots]
    paper = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.8}
    look: dict[str, Any] = {"fontsize": 8, "color": OTHER, "zorder": 6, "bbox": paper}
    names: list[Bbox] = []
    for k in np.argsort(-dwells, kind="stable"):
        at = float(dwells_hz[k]), float(dwells[k])
        taken = [*names, *(stem for i, stem in enumerate(stems) if i != k)]
        for offset, side in PLACES:
            text = axes.annotate(f"{at[0]:.4g} Hz", at, offset, textcoords="offset points", ha=side, **look)
            box = text.get_window_extent()
            inside = frame.contains(box.x0, box.y0) and frame.contains(box.x1, box.y1)
            if inside and not any(box.overlaps(other) for other in taken):
                names.append(box.padded(CLEAR))
                break
            text.remove()


def _intervals(axes: Axes, names: Sequence[str], tests: Sequence[Bars]) -> None:
    colours = [MODEL, OTHER, MUTED, COLOURS[2]]
    height = 0.78 / max(len(tests), 1)
    every = np.concatenate([test.percent for test in tests])
    largest = float(np.max(every[np.isfinite(every)], initial=0.0))
    smallest = float(np.min(every, initial=largest))
    letters: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 7, "color": INK}
    for i, test in enumerate(tests):
        at = np.arange(len(names)) + (i - (len(tests) - 1) / 2) * height
        colour = colours[i % len(colours)]
        axes.barh(at, test.percent, height * 0.86, color=colour, label=test.label, zorder=3)
        for value, place in zip(test.percent, at, strict=True):
            if np.isfinite(value) and height > 0.15:
                axes.annotate(short(value, 2), (value, place), (3, 0), **letters)
    row_names(axes, range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(False, axis="y")
    if largest > 30 * smallest > 0:
        axes.set_xscale("log")
        plain_log(axes.xaxis, (1.0,))
        limit_axis(axes.set_xlim, smallest / 2, largest * 2)
    else:
        limit_axis(axes.set_xlim, 0, 1.14 * largest)
    axes.set_xlabel("expected standard deviation, per cent of the value")
    axes.set_title("Expected intervals")
    if len(tests) > 1:
        axes.legend(loc="best", **FRAME)


@style()
def sequential_figure(answer: Answer, targets: Mapping[str, float]) -> Figure | None:
    """Relative standard deviations in per cent against samples as data came, and (dashed) as they would go on.

    None where the data did not determine the unknowns before their end.
    """
    so_far, verdict = answer.so_far, answer.verdict
    if so_far is None:
        return None
    times = 4.0
    if verdict is not None and np.isfinite(verdict.more):
        times = max(1.3 * verdict.more / float(so_far.samples[-1]) + 1.3, 1.5)
    ahead, relative = so_far.extrapolated(times)
    figure = Figure(figsize=(7.4, 3.6))
    axes = figure.subplots()
    for j, name in enumerate(so_far.names):
        colour = COLOURS[j % len(COLOURS)]
        axes.plot(so_far.samples, 100 * so_far.relative[:, j], "o-", color=colour, ms=3.5, lw=1.4, label=name)
        axes.plot(ahead, 100 * relative[:, j], color=colour, lw=1.0, ls=(0, (3, 2)))
    place: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
    for target in sorted({100 * targets[name] for name in so_far.names if name in targets}):
        axes.axhline(target, color=INK, lw=0.9)
        axes.annotate(f"target: {target:.3g} %", (1, target), (-2, 3), ha="right", fontsize=8, **place)
    axes.set_yscale("log")
    axes.set_xscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        plain_log(axis)
    axes.set_xlabel("samples")
    axes.set_ylabel("standard deviation, per cent")
    axes.set_title("Intervals as data come in, and with more of the same (dashed)")
    axes.legend(ncols=2 if len(so_far.names) > 5 else 1, loc="upper right")
    return figure
