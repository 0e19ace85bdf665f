"""Responses as documents: curves of settled motions of a rig, and what data show without one, with modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dashpot.arrays import Bools, Ints, Real
from dashpot.free.modes import MeasuredModes
from dashpot.free.response import MeasuredResponse
from dashpot.io.words import counted
from dashpot.present.document import Document, columns_of, section
from dashpot.present.figures.style import BAD, COLOURS, MUTED, limit_axis, style
from dashpot.present.words import percent, short, value_and_sd
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
            edges = np.flatnonzero(np.diff(np.concatenate([[False], ~curve.stable, [False]]).astype(int)))
            unstable = ", ".join(
                f"{min(x[a], x[b - 1]):.4g} to {max(x[a], x[b - 1]):.4g}"
                for a, b in zip(edges[::2], edges[1::2], strict=True)
            )
            parts.append(f"unstable {unstable} {unit}")
        if curve.missing > 1e-3:  # less is not worth saying
            parts.append(
                f"{curve.orders} harmonics leave out up to {100 * curve.missing:.2g} % of the motion"
            )
        texts.append("; ".join(part for part in parts if part))
    return Document("", (section("", *texts),))


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


# What data show without a rig.


METHODS = {
    "dwells": "steady sines and tables of amplitudes, with the known noise of inputs and outputs",
    "periods": "periodic excitation: means of the periods, noise from their scatter",
    "local": "records of any excitation: local rational models with transients; inputs are treated as exact",
}


def response_document(found: MeasuredResponse, where: str = "") -> Document:
    """A row for each pair: where the response is largest, how well it is known, coherence, distortion."""
    f = found.frequency_hz
    title = f"{len(f)} frequencies from {short(float(f[0]))} to {short(float(f[-1]))} Hz"
    rows = []
    for i, out in enumerate(found.outputs):
        for j, into in enumerate(found.inputs):
            size, sd = np.abs(found.values[:, i, j]), found.sd[:, i, j]
            peak = int(np.argmax(size))
            typical = float(np.median(size))
            rows.append(
                (
                    f"{out.name}/{into.name}",
                    short(float(size[peak])),
                    short(float(f[peak])),
                    f"{percent(float(np.median(sd)), typical)}" if np.all(np.isfinite(sd)) else "–",
                    f"{np.median(found.coherence[:, i]):.3g}" if np.isfinite(found.coherence[0, i]) else "–",
                    found.unit(out, into),
                )
            )
    heads = ["response", "largest>", "at Hz>", "sd, %>", "coherence>", "unit"]
    said = [f"From {METHODS[found.method]}."]
    if where:
        kept = len(found.independent().frequency_hz)
        some = "" if kept == len(f) else f"; {kept} lines, no two of which share data"
        said.append(f"Written to {where}{some}.")
    distorted = []
    for name, parts in found.distortion.items():
        seen = [f"{100 * part:.2g} %" if part else "none seen" for part in parts]
        of_all = ["all driven" if np.isnan(part) else text for part, text in zip(parts, seen, strict=True)]
        distorted.append((name, *of_all))
    heard = columns_of(["output", "even multiples>", "odd multiples>"], distorted)
    return Document(
        title,
        (
            section("", columns_of(heads, rows)),
            section("", " ".join(said)),
            *([section("", "Distortion beyond noise, of the motion (rms):", heard)] if distorted else []),
        ),
    )


def modes_document(found: MeasuredModes, where: str = "") -> Document:
    """Frequencies, damping and shapes as size and phase, with how the fit is."""
    count = len(found.eigenvalues)
    f = found.frequency
    title = f"{counted(count, 'mode')} from {short(float(f[0]))} to {short(float(f[-1]))} Hz"
    values = [
        (
            str(k + 1),
            *value_and_sd(float(found.frequency_hz[k]), float(found.frequency_sd[k])),
            *value_and_sd(100 * float(found.damping_ratio[k]), 100 * float(found.damping_sd[k])),
        )
        for k in range(count)
    ]
    heads = ["mode", "frequency, Hz>", "±>", "damping, %>", "±>"]
    shapes = []
    for k in range(count):
        sizes = [
            value_and_sd(abs(x), float(sd)) for x, sd in zip(found.shapes[k], found.shape_sd[k], strict=True)
        ]
        angles = [f"{round(float(np.degrees(np.angle(x)))):d}°" for x in found.shapes[k]]
        shapes.append(
            (str(k + 1), *(f"{size} ∠ {angle}" for (size, _), angle in zip(sizes, angles, strict=True)))
        )
    said = "" if found.inputs else "No input is named: fitted as a free decay.  "
    if np.isfinite(found.chi2):
        ratio = (found.chi2 / found.dof) ** 0.5
        said += f"The fit leaves {ratio:.3g} × the noise."
        if ratio > 1.2:
            said += (
                " The standard deviations include the excess over noise; the rig is probably nonlinear or "
                "changing."
            )
    if where:
        said += f" Written to {where}."
    table = columns_of(["mode", *(f"{name}^" for name in found.points)], shapes)
    return Document(
        title,
        (
            section("", columns_of(heads, values)),
            section("", "Shapes of displacement, largest value 1:", table),
            *([section("", said.strip())] if said else []),
        ),
    )
