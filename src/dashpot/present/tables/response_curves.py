"""Curves of settled motions in words: their points, folds and what is unstable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console

from dashpot.study.response_curves import MotionCurve

COARSE = 1e-3  # share of the motion in harmonics left out from which it is said


def show_curves(console: Console, curves: Sequence[MotionCurve], by_amplitude: bool) -> None:
    """A paragraph for each curve: where it turns, and between which points motions are unstable."""
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
        if curve.missing > COARSE:
            parts.append(
                f"{curve.orders} harmonics leave out up to {100 * curve.missing:.2g} % of the motion"
            )
        console.print("; ".join(part for part in parts if part), markup=False, highlight=False)


def _runs(x: np.ndarray, stable: np.ndarray) -> str:
    """Where the unstable runs begin and end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~stable, [False]]).astype(int)))
    return ", ".join(
        f"{min(x[a], x[b - 1]):.4g} to {max(x[a], x[b - 1]):.4g}"
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    )
