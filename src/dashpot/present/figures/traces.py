"""Small pictures of channels as SVG for a page: samples over time, thinned by extremes, and amplitudes over frequency.

They take the colour of the text around them, so that they suit light and dark pages.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from dashpot.arrays import Bools, Complex, Real

WIDTH, HEIGHT, LEFT, BELOW = 640, 110, 64, 18  # of a picture, and what its labels take, in its units


def extremes_of(values: Real, columns: int) -> tuple[Real, Real]:
    """The least and the greatest of (samples,) in each of so many columns, (columns,): no peak is lost.

    NaN where a column holds no finite sample.
    """
    edges = np.linspace(0, len(values), columns + 1).astype(int)[:-1]
    low, high = np.where(np.isfinite(values), values, np.inf), np.where(np.isfinite(values), values, -np.inf)
    least, greatest = np.minimum.reduceat(low, edges), np.maximum.reduceat(high, edges)
    there = np.isfinite(least) & np.isfinite(greatest)
    return np.where(there, least, np.nan), np.where(there, greatest, np.nan)


def trace_svg(name: str, unit: str, stretches: Sequence[tuple[Real, Real, Bools | None]]) -> str:
    """A channel over time: stretches of times, values and marks of samples that do not count as measured, in a row."""
    time = np.concatenate([time - time[0] for time, _, _ in stretches])
    values = np.concatenate([values for _, values, _ in stretches])
    masked = np.concatenate(
        [np.zeros(len(values), bool) if marks is None else marks for _, values, marks in stretches]
    )
    columns = min(WIDTH - LEFT, len(values))
    low, high = extremes_of(values, columns)
    marks = np.maximum.reduceat(masked, np.linspace(0, len(masked), columns + 1).astype(int)[:-1])
    bottom, top = _span(low, high)
    x = LEFT + (np.arange(columns) + 0.5) * (WIDTH - LEFT) / columns

    def y(level: Real) -> Real:
        return (HEIGHT - BELOW) * (1 - (level - bottom) / (top - bottom))

    there = np.flatnonzero(np.isfinite(low))
    points = " ".join(f"{x[i]:.1f},{y(high)[i]:.1f} {x[i]:.1f},{y(low)[i]:.1f}" for i in there)
    shaded = "".join(
        f'<rect x="{x[i] - 0.5:.1f}" y="0" width="1.5" height="{HEIGHT - BELOW}" fill="#d1242f" opacity="0.5"/>'
        for i in np.flatnonzero(marks)
    )
    several = len(stretches) > 1
    seconds = sum(float(each[-1] - each[0]) for each, _, _ in stretches)
    end = f"{seconds:.4g} s" + (f" in {len(stretches)} pieces" if several else "")
    count = int(np.count_nonzero(masked))
    words = f"{name}, {len(time)} samples, {bottom:.4g} to {top:.4g} {unit}" + (
        f", {count} masked" if count else ""
    )
    body = f'{shaded}<polyline points="{points}" fill="none" stroke="currentColor" stroke-width="0.8"/>'
    return _framed(words, body, (f"{top:.3g}", f"{bottom:.3g}", unit), ("0", end))


def lines_svg(name: str, unit: str, frequency_hz: Real, amplitude: Complex) -> str:
    """Amplitudes of a channel over frequency, on a logarithmic scale."""
    size = np.abs(amplitude)
    there = np.isfinite(size) & (size > 0)
    if not np.any(there):
        return _framed(f"{name}: not measured", "", ("", "", unit), ("", ""))
    level, f = np.log10(size[there]), frequency_hz[there]
    bottom, top = _span(level, level)
    left, right = _span(f, f)
    x = LEFT + 4 + (f - left) / (right - left) * (WIDTH - LEFT - 8)
    y = 4 + (HEIGHT - BELOW - 8) * (1 - (level - bottom) / (top - bottom))
    dots = "".join(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2"/>' for a, b in zip(x, y, strict=True))
    words = f"Amplitude of {name}, {len(f)} lines from {left:.4g} to {right:.4g} Hz"
    ends = (f"{10**top:.2g}", f"{10**bottom:.2g}", unit)
    return _framed(words, f'<g fill="currentColor">{dots}</g>', ends, (f"{left:.4g}", f"{right:.4g} Hz"))


def bars_svg(name: str, samples: Sequence[float], low: Sequence[float], high: Sequence[float]) -> str:
    """The interval of a value as data come in: a bar for each number of samples."""
    finite = np.array([[a, b] for a, b in zip(low, high, strict=True)], dtype=float)
    bottom, top = _span(finite[:, 0], finite[:, 1])
    step = (WIDTH - LEFT) / max(len(samples), 1)
    y = (HEIGHT - BELOW) * (1 - (finite - bottom) / (top - bottom))
    bars = "".join(
        f'<rect x="{LEFT + (i + 0.35) * step:.1f}" y="{b:.1f}" width="{max(0.3 * step, 1):.1f}" '
        f'height="{max(a - b, 1):.1f}" fill="currentColor"/>'
        for i, (a, b) in enumerate(y)
        if np.isfinite(a) and np.isfinite(b)
    )
    words = f"95 % interval of {name}: {finite[-1, 0]:.4g} to {finite[-1, 1]:.4g}"
    return _framed(words, bars, (f"{top:.4g}", f"{bottom:.4g}", name), ("", f"{samples[-1]:.0f} samples"))


def _span(low: Real, high: Real) -> tuple[float, float]:
    """Ends of an axis that holds all finite values, apart even where they are alike."""
    ends = np.concatenate([low[np.isfinite(low)], high[np.isfinite(high)]])
    least, greatest = (float(ends.min()), float(ends.max())) if len(ends) else (0.0, 1.0)
    if greatest > least:
        return least, greatest
    room = abs(least) if least else 1.0
    return least - room / 2, least + room / 2


def _framed(words: str, body: str, levels: tuple[str, str, str], times: tuple[str, str]) -> str:
    top, bottom, unit = map(escape, levels)
    begin, end = map(escape, times)
    label, floor = escape(words), HEIGHT - BELOW
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{label}" '
        f'class="trace" font-size="11" fill="currentColor"><title>{label}</title>'
        f'<path d="M{LEFT},0 V{floor} H{WIDTH}" fill="none" stroke="currentColor" opacity="0.4"/>{body}'
        f'<text x="{LEFT - 4}" y="10" text-anchor="end">{top}</text>'
        f'<text x="{LEFT - 4}" y="{floor}" text-anchor="end">{bottom}</text>'
        f'<text x="{LEFT - 4}" y="{floor / 2 + 4}" text-anchor="end">{unit}</text>'
        f'<text x="{LEFT}" y="{HEIGHT - 5}">{begin}</text>'
        f'<text x="{WIDTH}" y="{HEIGHT - 5}" text-anchor="end">{end}</text></svg>'
    )
