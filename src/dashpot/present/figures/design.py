"""Figures of a planned test, from arrays alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import (
    FixedLocator,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
    StrMethodFormatter,
)
from matplotlib.transforms import Bbox

from dashpot.arrays import Complex, Real
from dashpot.design.advise import Answer
from dashpot.design.plan import Plan, plan_curves
from dashpot.design.plan_files import phase_deg
from dashpot.present.figures import design as draw
from dashpot.present.figures.style import COLOURS, INK, MODEL, MUTED, limit_axis, style
from dashpot.present.words import short

# Pictures of a planned test and of data as they came in: from answers to arrays to figures.


def planned_test_figure(answer: Answer) -> Figure:
    """Dwells on the directional derivative, information of each frequency about each parameter, intervals."""
    assert answer.plan is not None
    plan, setup = answer.plan, answer.setup
    curves = plan_curves(setup, answer.criterion, plan, answer.grid.low, answer.grid.high)
    names = drive_names([*setup.model.displacement_inputs, *setup.model.force_inputs], setup.drives)
    labelled = [(names[k], curve) for k, curve in zip(curves.patterns, curves.derivative, strict=True)]
    timed = plan.time_s is not None
    amounts = np.array([d.time_s if timed else d.samples for d in plan.dwells], dtype=float)
    title = f"The next test: {len(plan.dwells)} dwell{'s'[: len(plan.dwells) - 1]}, {plan.samples} samples"
    title += "" if plan.time_s is None else f", {short(plan.time_s, 3)} s"
    p = plan.predicted
    bars = [j for j in range(len(p.names)) if p.values[j] != 0]  # a delay of 0 has no relative error
    return draw.plan_figure(
        title, curves.frequency_hz, labelled, np.array([d.frequency_hz for d in plan.dwells]), amounts,
        "s" if timed else "samples", p.names, curves.gain, [p.names[j] for j in bars], _bars(answer, plan, bars),
    )  # fmt: skip


def _bars(answer: Answer, plan: Plan, bars: list[int]) -> list[draw.Bars]:
    """Relative standard deviations of the tests that are compared, of the parameters `bars`."""
    p = plan.predicted
    tests = [draw.Bars("this test", 100 * p.relative[bars])]
    if answer.estimate is not None:
        e = answer.estimate
        now = {n: float(s / abs(v)) if v else np.nan for n, s, v in zip(e.names, e.sd, e.values, strict=True)}
        tests.append(draw.Bars("known now", 100 * np.array([now.get(p.names[j], np.nan) for j in bars])))
    if answer.comparison is not None:
        tests.append(
            draw.Bars("other test, as many samples", 100 * answer.comparison.predicted.relative[bars])
        )
        iv = answer.comparison.iv
        if iv is not None and len(iv.names) == len(p.names):
            tests.append(draw.Bars("other test by the paper's iv", 100 * iv.relative[bars]))
    return tests


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


def sequential_figure(answer: Answer, targets: Mapping[str, float]) -> Figure | None:
    """Intervals against samples as data came; None where the data did not determine the unknowns before their end."""
    so_far, verdict = answer.so_far, answer.verdict
    if so_far is None:
        return None
    times = 4.0
    if verdict is not None and np.isfinite(verdict.more):
        times = max(1.3 * verdict.more / float(so_far.samples[-1]) + 1.3, 1.5)
    ahead, relative = so_far.extrapolated(times)
    aims = np.array([100 * targets.get(name, np.nan) for name in so_far.names])
    return draw.progress_figure(
        so_far.names, so_far.samples.astype(float), 100 * so_far.relative, ahead, 100 * relative, aims
    )


HEAT = LinearSegmentedColormap.from_list("heat", ["#ffffff", "#d5e6ee", "#7fb6cd", "#0b6e99", "#083d56"])
OTHER, EARLIER = "#b0531a", "#7b8794"
CLEAR = 4.0  # px around a dwell and between names
PLACES = (((6, 3), "left"), ((-6, 3), "right"), ((0, 7), "center"), ((6, -8), "left"), ((-6, -8), "right"))
FRAME: dict[str, Any] = {"frameon": True, "framealpha": 0.85, "edgecolor": "none"}  # over bars and curves


@dataclass(frozen=True)
class Bars:
    """One test's predicted relative standard deviations, per cent (parameters,), and what to call it."""

    label: str
    percent: Real


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
    with style():
        rows = max(1.3, 0.24 * len(names) + 0.5)
        deep = max(1.4, (0.12 + 0.11 * len(tests)) * len(bars) + 0.6)
        figure = Figure(figsize=(7.4, 2.6 + rows + deep))
        top, middle, bottom = figure.subplots(3, 1, gridspec_kw={"height_ratios": [2.3, rows, deep]})
        over = _dwells(top, frequency_hz, curves, dwells_hz, dwells, dwell_unit)
        top.set_title(title)
        _heat(middle, frequency_hz, names, shares, dwells_hz)
        _intervals(bottom, bars, tests)
        if len(dwells_hz) <= 8:  # dwells whose frequencies are written beside them
            figure.draw_without_rendering()  # the layout, by which places are known
            _name_dwells(over, dwells_hz, dwells)
    return figure


def _axis(axes: Axes, f: Real) -> None:
    limit_axis(axes.set_xlim, float(np.min(f)) / 1.02, float(np.max(f)) * 1.02)
    if float(np.max(f)) > 2 * float(np.min(f)):
        axes.set_xscale("log")
        wide = float(np.max(f)) > 8 * float(np.min(f))
        axes.xaxis.set_major_locator(
            LogLocator(subs=(1.0, 2.0, 5.0) if wide else tuple(range(1, 10)), numticks=14)
        )
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_minor_locator(NullLocator())


def _dwells(
    axes: Axes, f: Real, curves: Sequence[tuple[str, Real]], dwells_hz: Real, dwells: Real, unit: str
) -> Axes:
    """The curves, and over them, in axes of their own, which are given back, the dwells."""
    for i, (label, curve) in enumerate(curves):
        axes.plot(f, curve, color=COLOURS[i % len(COLOURS)], lw=1.4, label=label, zorder=3)
    axes.axhline(1, color=MUTED, lw=0.8, ls=(0, (3, 2)), zorder=2)
    _axis(axes, f)
    axes.set_ylim(0, 1.08)
    axes.set_ylabel("worth of a sample")
    if len(curves) > 1:
        axes.legend(loc="best", **FRAME)
    twin = axes.twinx()
    twin.grid(False)
    twin.spines["right"].set_visible(True)
    most = float(np.max(dwells, initial=0.0))
    twin.vlines(dwells_hz, 0, dwells, color=OTHER, lw=2.2, zorder=4)
    twin.plot(dwells_hz, dwells, "o", color=OTHER, ms=5, zorder=5, clip_on=False)
    limit_axis(twin.set_ylim, 0, 1.3 * most if most > 0 else 1)
    twin.set_ylabel(f"dwell, {unit}", color=OTHER)
    twin.yaxis.set_major_locator(MaxNLocator(5, integer=unit == "samples"))
    twin.tick_params(axis="y", colors=OTHER)
    return twin


def _name_dwells(axes: Axes, dwells_hz: Real, dwells: Real) -> None:
    """The frequency of each dwell beside its dot, the longest first, where it touches no other name or dwell."""
    dots = axes.transData.transform(np.stack([dwells_hz, dwells], axis=1))
    bottom = axes.get_window_extent().y0
    stems = [Bbox([[x - CLEAR, bottom], [x + CLEAR, y + CLEAR]]) for x, y in dots]
    names: list[Bbox] = []
    for k in np.argsort(-dwells):
        x, y = float(dwells_hz[k]), float(dwells[k])
        taken = [*names, *(stem for i, stem in enumerate(stems) if i != k)]
        for offset, sideways in PLACES:
            text = axes.annotate(
                f"{x:.4g} Hz", (x, y), textcoords="offset points", xytext=offset, fontsize=8, color=OTHER, ha=sideways,
                zorder=6, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.8},
            )  # fmt: skip
            box = text.get_window_extent()
            inside = axes.get_window_extent().contains(box.x0, box.y0) and axes.get_window_extent().contains(
                box.x1, box.y1
            )
            if inside and not any(box.overlaps(other) for other in taken):
                names.append(box.padded(CLEAR))
                break
            text.remove()


def _heat(axes: Axes, f: Real, names: Sequence[str], shares: Real, dwells_hz: Real) -> None:
    edges = (
        np.concatenate([[f[0]], np.sqrt(f[1:] * f[:-1]), [f[-1]]])
        if len(f) > 1
        else np.array([f[0] / 1.1, f[0] * 1.1])
    )
    mesh = axes.pcolormesh(
        edges, np.arange(len(names) + 1), np.clip(shares.T, 0, 3), cmap=HEAT, vmin=0, vmax=3, rasterized=True
    )
    axes.vlines(dwells_hz, 0, len(names), color=OTHER, lw=1.0, ls=(0, (2, 2)))
    axes.set_ylim(len(names), 0)
    axes.yaxis.set_major_locator(FixedLocator([i + 0.5 for i in range(len(names))]))
    axes.set_yticklabels(list(names))
    axes.tick_params(axis="y", length=0)
    axes.grid(False)
    axes.set_title("What a sample at each frequency tells about each parameter")
    _axis(axes, f)
    axes.set_xlabel("frequency, Hz")
    bar = axes.figure.colorbar(mesh, ax=axes, pad=0.01, ticks=[0, 1, 2, 3])
    bar.ax.set_yticklabels(["0", "1", "2", "≥ 3"])
    bar.set_label("× mean")
    bar.outline.set_visible(False)


def _intervals(axes: Axes, names: Sequence[str], tests: Sequence[Bars]) -> None:
    colours = [MODEL, OTHER, EARLIER, COLOURS[2]]
    height = 0.78 / max(len(tests), 1)
    y = np.arange(len(names))
    largest = max(
        (float(np.max(test.percent[np.isfinite(test.percent)], initial=0.0)) for test in tests), default=1.0
    )
    smallest = min((float(np.min(test.percent)) for test in tests), default=largest)
    logarithmic = largest > 30 * smallest > 0
    for i, test in enumerate(tests):
        at = y + (i - (len(tests) - 1) / 2) * height
        axes.barh(
            at, test.percent, height * 0.86, color=colours[i % len(colours)], label=test.label, zorder=3
        )
        for value, place in zip(test.percent, at, strict=True):
            if np.isfinite(value) and height > 0.15:
                axes.annotate(
                    short(value, 2), (value, place), textcoords="offset points", xytext=(3, 0), va="center", fontsize=7,
                    color=INK,
                )  # fmt: skip
    axes.set_yticks(y)
    axes.set_yticklabels(list(names))
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.grid(False, axis="y")
    if logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        limit_axis(axes.set_xlim, smallest / 2, largest * 2)
    else:
        limit_axis(axes.set_xlim, 0, 1.14 * largest)
    axes.set_xlabel("expected standard deviation, per cent of the value")
    axes.set_title("Expected intervals")
    if len(tests) > 1:
        axes.legend(loc="best", **FRAME)


def progress_figure(
    names: Sequence[str], samples: Real, relative: Real, ahead: Real, extrapolated: Real, targets: Real
) -> Figure:
    """Relative standard deviations in per cent against samples: so far (steps, parameters), and as they would go on.

    ahead (points,), extrapolated (points, parameters); targets (parameters,), NaN where there is none.
    """
    with style():
        figure = Figure(figsize=(7.4, 3.6))
        axes = figure.subplots()
        for j, name in enumerate(names):
            colour = COLOURS[j % len(COLOURS)]
            axes.plot(samples, relative[:, j], "o-", color=colour, ms=3.5, lw=1.4, label=name)
            axes.plot(ahead, extrapolated[:, j], color=colour, lw=1.0, ls=(0, (3, 2)))
        for target in np.unique(targets[np.isfinite(targets)]):
            axes.axhline(float(target), color=INK, lw=0.9)
            axes.annotate(
                f"target: {target:.3g} %", (1, float(target)), xycoords=("axes fraction", "data"), fontsize=8,
                textcoords="offset points", xytext=(-2, 3), ha="right",
            )  # fmt: skip
        axes.set_yscale("log")
        axes.set_xscale("log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
        axes.set_xlabel("samples")
        axes.set_ylabel("standard deviation, per cent")
        axes.set_title("Intervals as data come in, and with more of the same (dashed)")
        axes.legend(ncols=2 if len(names) > 5 else 1, loc="upper right")
    return figure
