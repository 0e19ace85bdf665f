"""Curves of settled motions: in words their points, folds and what is unstable, and drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dashpot.arrays import Bools, Ints, Real
from dashpot.present.document import Document, section
from dashpot.present.figures.style import BAD, COLOURS, MUTED, limit_axis, style
from dashpot.study.response_curves import MotionCurve


def curves_document(curves: Sequence[MotionCurve], by_amplitude: bool) -> Document:
    """A paragraph for each curve: where it turns, and between which points motions are unstable."""
    texts = []
    for curve in curves:
        x = 100 * curve.share if by_amplitude and np.any(curve.share) else curve.frequency_hz
        unit = "%" if x is not curve.frequency_hz else "Hz"
        parts = [f"{curve.label}: {x[0]:.4g} to {x[-1]:.4g} {unit}"]
        if len(curve.folds):
            parts.append(f"folds at {', '.join(f'{x[k]:.4g}' for k in curve.folds)} {unit}")
        if curve.stable is None:
            parts.append("" if not np.any(curve.share) else "stability not known")
        elif np.all(curve.stable):
            parts.append("stable throughout")
        else:
            parts.append(f"unstable {_runs(x, curve.stable)} {unit}")
        if curve.missing > 1e-3:  # less is not worth saying
            parts.append(
                f"{curve.orders} harmonics leave out up to {100 * curve.missing:.2g} % of the motion"
            )
        texts.append("; ".join(part for part in parts if part))
    return Document("", (section("", *texts),))


def _runs(x: Real, stable: Bools) -> str:
    """Where the unstable runs begin and end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~stable, [False]]).astype(int)))
    return ", ".join(
        f"{min(x[a], x[b - 1]):.4g} to {max(x[a], x[b - 1]):.4g}"
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    )


@dataclass(frozen=True)
class DrawnCurve:
    """One curve: x (P,), y (P, channels), stable (P,) or None, folds (…,); a `thin` one is a backbone."""

    label: str
    x: Real
    y: Real
    stable: Bools | None
    folds: Ints
    thin: bool = False


@style()
def response_curves(
    names: Sequence[str], units: Sequence[str], curves: Sequence[DrawnCurve], x_label: str
) -> Figure:
    """A panel for each channel: stable motions drawn through, unstable ones dashed, folds as rings."""
    figure = Figure(figsize=(7.6, 2.6 * len(names) + 0.5))
    rows = figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
    for channel, (axes, name, unit) in enumerate(zip(rows, names, units, strict=True)):
        for k, curve in enumerate(curves):
            _draw(axes, curve, channel, COLOURS[k % len(COLOURS)])
        axes.set_title(name)
        axes.set_ylabel(f"half peak-to-peak, {unit}")
        axes.set_ylim(bottom=0)
        values = [curve.x for curve in curves if not curve.thin]
        low, high = min(float(np.min(x)) for x in values), max(float(np.max(x)) for x in values)
        margin = 0.02 * (high - low)
        limit_axis(axes.set_xlim, *(low - margin, high + margin))
    rows[-1].set_xlabel(x_label)
    if any(curve.stable is not None and not np.all(curve.stable) for curve in curves):
        rows[0].plot([], [], color=MUTED, lw=1.2, ls=(0, (3, 2)), label="unstable")
    if any(len(curve.folds) for curve in curves):
        rows[0].plot([], [], "o", color=BAD, mfc="white", ms=4, label="fold")
    rows[0].legend(loc="best")
    return figure


def _draw(axes: Axes, curve: DrawnCurve, channel: int, colour: str) -> None:
    y = curve.y[:, channel]
    if curve.thin:
        axes.plot(curve.x, y, color=MUTED, lw=1.0, ls=(0, (6, 2, 1, 2)), label=curve.label, zorder=1)
        return
    stable = np.ones(len(y), dtype=bool) if curve.stable is None else curve.stable
    # A piece between two points is stable where both its ends are.
    through = stable & np.append(stable[1:], True)
    axes.plot(*_pieces(curve.x, y, through), color=colour, lw=1.5, label=curve.label, zorder=3)
    if not np.all(stable):
        axes.plot(*_pieces(curve.x, y, ~through), color=colour, lw=1.2, ls=(0, (3, 2)), zorder=2)
    axes.plot(curve.x[curve.folds], y[curve.folds], "o", color=BAD, mfc="white", ms=4, zorder=4)


def _pieces(x: Real, y: Real, chosen: Bools) -> tuple[Real, Real]:
    """The pieces from each chosen point to the next, with gaps between runs of them."""
    shown = chosen.copy()
    shown[1:] |= chosen[:-1]
    return np.where(shown, x, np.nan), np.where(shown, y, np.nan)
