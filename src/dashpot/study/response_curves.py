"""Amplitude-frequency curves and backbones of nonlinear rigs: what each channel swings, and where it is stable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, frozen
from dashpot.channel import Channel
from dashpot.errors import UsageError
from dashpot.model.network import Model
from dashpot.model.nonlinear.continuation import (
    ResponseBranch,
    amplitude_sweep,
    backbone,
    channel_harmonics,
    followed,
    frequency_sweep,
    swing,
)
from dashpot.model.nonlinear.harmonic_balance import MOST_HARMONICS, periodic_response, truncation
from dashpot.model.nonlinear.harmonics import Drive, complex_of

ORDERS = {True: 7, False: 21}  # harmonics to begin with, of laws that are smooth and that are not


@dataclass(frozen=True)
class MotionCurve:
    """Points of one curve in the order along it.

    label: what is the same at all of them; frequency_hz and share (P,): frequency and size of the drive over that of
    the test; swing (P, channels): half of what each channel moves from lowest to highest, SI units; fundamental (P,
    channels): amplitudes at the drive's frequency; stable (P,), None where nothing tells; folds (…,): points where the
    curve turns; stretch: largest fundamental of a nonlinear element's elongation, m; orders: harmonics of the motion;
    missing: largest truncation error of the elongations on the curve, over their size.
    """

    label: str
    channels: tuple[str, ...]
    frequency_hz: Real
    share: Real
    swing: Real
    fundamental: Complex
    stable: Bools | None
    folds: Ints
    stretch: float = 0.0
    orders: int = 0
    missing: float = 0.0


def drive_of(model: Model, amplitudes: Mapping[str, float], frequency_hz: float, orders: int) -> Drive:
    """All inputs at one frequency, amplitudes by name in SI units, 1 where not named."""
    U = np.zeros((1, orders + 1, len(model.displacement_inputs)), dtype=np.complex128)
    f = np.zeros((1, orders + 1, len(model.force_inputs)), dtype=np.complex128)
    U[0, 1] = [amplitudes.get(name, 1.0) for name in model.displacement_inputs]
    f[0, 1] = [amplitudes.get(name, 1.0) for name in model.force_inputs]
    return Drive(np.array([2 * np.pi * frequency_hz]), U, f)


def frequency_curve(
    model: Model,
    theta: Real,
    channels: Sequence[Channel],
    amplitudes: Mapping[str, float],
    band_hz: tuple[float, float],
    *,
    label: str = "",
) -> MotionCurve:
    """The motion at one size of the drive from the first frequency to the last, through folds.

    Raises ConvergenceError if the curve cannot be followed, UsageError if the rig is linear.
    theta (unknowns,), amplitudes in m or N.
    """
    require_nonlinear(model)
    orders = enough_orders(model, theta, amplitudes, band_hz)
    sweep = frequency_sweep(drive_of(model, amplitudes, band_hz[0], orders), 2 * np.pi * band_hz[1])
    return _curve(model, theta, channels, followed(model, theta, sweep), label)


def amplitude_curve(
    model: Model,
    theta: Real,
    channels: Sequence[Channel],
    amplitudes: Mapping[str, float],
    frequency_hz: float,
    *,
    label: str = "",
) -> MotionCurve:
    """The motion at one frequency while the drive grows from a hundredth of its amplitudes to all of them.

    theta (unknowns,), amplitudes in m or N.  Raises as `frequency_curve`.
    """
    require_nonlinear(model)
    orders = enough_orders(model, theta, amplitudes, (frequency_hz, frequency_hz))
    drive, first = drive_of(model, amplitudes, frequency_hz, orders), 0.01  # of its size
    path = followed(model, theta, amplitude_sweep(drive.scaled(first), 1 / first))
    return _curve(model, theta, channels, path, label, first + path.along * (1 - first))


def backbone_curve(
    model: Model, theta: Real, channels: Sequence[Channel], mode: int, largest: float, *, label: str = ""
) -> MotionCurve:
    """The free undamped motions that start from a mode (0 the lowest); see `backbone`."""
    path = backbone(model, theta, mode, largest)
    harmonics = channel_harmonics(path.rig, path.rig.p0, channels, path.drive, path.motion)
    names, frequency_hz = tuple(c.name for c in channels), path.drive.omega / (2 * np.pi)
    at = (frequency_hz, np.zeros(len(frequency_hz)), swing(harmonics), harmonics[:, 1])
    return MotionCurve(label, names, *at, stable=None, folds=frozen([], np.int64))


def enough_orders(
    model: Model, theta: Real, amplitudes: Mapping[str, float], band_hz: tuple[float, float]
) -> int:
    """Harmonics that bring the truncation error of the responses in the band below FINEST, at most MOST_HARMONICS.

    theta (unknowns,).
    """
    smooth = all(e.force_law is None or e.force_law.smooth for e in model.elements)
    orders = ORDERS[smooth]
    p, constants = model.parameters(theta)[None], model.inner_constants(theta)[None]
    coarse = np.geomspace(*band_hz, 5)
    while len(coarse) and orders < MOST_HARMONICS:
        errors = []
        for frequency in coarse.tolist():
            drive = drive_of(model, amplitudes, frequency, orders)
            at = periodic_response(model, p, constants, drive, grow=False)
            # Where no response is found at once, none is looked for again: folds leave such places.
            error = truncation(model, p, constants, drive, at)[0] if at.converged[0] else 0.0
            errors.append(float(error))
        coarse = coarse[np.array(errors) > 1e-4]  # truncation error of the elongations on a curve
        if len(coarse):
            orders = min(2 * orders + 1, MOST_HARMONICS)
    return orders


def require_nonlinear(model: Model) -> None:
    """Raises UsageError if the rig has no nonlinear element."""
    if not len(model.nonlinear):
        what = "the rig has no nonlinear element: its response curves do not depend on the amplitude"
        raise UsageError(what, cure="simulate its amplitudes at the frequencies instead")


def _curve(
    model: Model,
    theta: Real,
    channels: Sequence[Channel],
    branch: ResponseBranch,
    label: str,
    share: Real | None = None,
) -> MotionCurve:
    drive, count = branch.drive, len(branch.along)
    harmonics = channel_harmonics(model, model.parameters(theta), channels, drive, branch.motion)
    p, constants = (np.tile(of(theta), (count, 1)) for of in (model.parameters, model.inner_constants))
    return MotionCurve(
        label,
        tuple(c.name for c in channels),
        frequency_hz=drive.omega / (2 * np.pi),
        share=np.ones(count) if share is None else share,
        swing=swing(harmonics),
        fundamental=harmonics[:, 1],
        stable=branch.stable,
        folds=branch.folds,
        stretch=float(np.max(np.abs(complex_of(branch.motion.delta)[..., 1]))),
        orders=drive.orders,
        missing=float(np.max(truncation(model, p, constants, drive, branch.motion))),
    )


def largest_stretch(curves: Sequence[MotionCurve]) -> float:
    """How far backbones are worth following: the largest elongation of a nonlinear element on the curves, m."""
    return max(curve.stretch for curve in curves)
