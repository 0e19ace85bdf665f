"""What uncalibrated channels show of settled dwells at given parameters and inputs, with slopes (THEORY §9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.estimate.nonlinear.dwells import DwellLines
from dashpot.model.network import Model
from dashpot.model.nonlinear.balance import SETTLED
from dashpot.model.nonlinear.compiled import compiled_channels, compiled_rig
from dashpot.model.nonlinear.harmonic_balance import (
    harmonic_unit_forces,
    periodic_response,
    samples_of,
    slopes,
)
from dashpot.model.observation import ObservationModel, channel_amplitudes


@dataclass(frozen=True)
class ShownLines:
    """Channels at the lines of K repeats, (K, lines, channels, …), and the elongations behind them.

    Y and its slopes dY along θ and, where inputs are noisy, along the inputs' lines of the dwell, (…, m + Q); delta
    (K dwells, e, W), its slopes d_delta (…, m) along θ, and which dwells have a response, converged (K dwells,).
    """

    Y: Complex
    dY: Complex
    delta: Real
    d_delta: Real
    converged: Bools


def shown_lines(
    view: ObservationModel, dwells: DwellLines, p: Real, constants: Real, q: Complex, start: Real | None,
    *, noisy: bool, grow: bool,
) -> ShownLines:  # fmt: skip
    """The channels of a view at parameters p (K, elements) and inner constants (K, G).

    q (K, lines, r + s): the inputs, along which slopes are wanted as well if `noisy`; start as `Periodic.delta` or
    None; grow: whether the drive of dwells that Newton's method loses is raised step by step.
    """
    compiled = _compiled(view, dwells, p, constants, q, start, noisy)
    if compiled is not None and (not grow or np.all(compiled.converged)):
        return compiled
    return _by_harmonics(view, dwells, p, constants, q, start, noisy, grow)


def _directions(
    view: ObservationModel, dwells: DwellLines, inputs: int, noisy: bool
) -> tuple[Real, Real, Complex | None]:
    """Directions of the parameters (elements, m + Q), the constants (G, m + Q) and the inputs.

    Those of the inputs (dwells, H + 1, inputs, m + Q) are None unless they are `noisy`.
    """
    model = view.model
    along_p, along_g = model.T, model.constants_map[0]
    if not noisy:
        return along_p, along_g, None
    directions = dwells.input_directions(inputs)
    along = np.concatenate([np.zeros((*directions.shape[:-1], view.m)), directions], axis=-1)
    widen = [(0, 0), (0, directions.shape[-1])]
    return np.pad(along_p, widen), np.pad(along_g, widen), along


def _compiled(
    view: ObservationModel, dwells: DwellLines, p: Real, constants: Real, q: Complex, start: Real | None, noisy: bool
) -> ShownLines | None:  # fmt: skip
    """By the kernel; None where NumPy is to do the work or must."""
    times = samples_of(view.model, dwells.orders)
    rig = compiled_rig(view.model, times)
    if rig is None:
        return None
    directions = _directions(view, dwells, q.shape[-1], noisy)
    Y, dY, delta, d_delta, error = compiled_channels(
        rig, view.model, (p, constants, q, start), (dwells.omega, dwells.dwell, dwells.order, dwells.orders), times,
        directions, (view.rates, view.on_x, view.on_q, view.force),
    )  # fmt: skip
    if noisy:
        dY[..., view.m :] += _straight_through(view, dwells, q.shape[-1])
    return ShownLines(Y, dY, delta, d_delta[..., : view.m], error <= SETTLED)


def _straight_through(view: ObservationModel, dwells: DwellLines, inputs: int) -> Complex:
    """What channels show of the inputs' lines themselves, (lines, channels, Q)."""
    along = dwells.input_directions(inputs)[dwells.dwell, dwells.order]
    shown: Complex = view.rates[..., None] * (view.on_q @ along)
    return shown


def _by_harmonics(
    view: ObservationModel, dwells: DwellLines, p: Real, constants: Real, q: Complex, start: Real | None, noisy: bool,
    grow: bool,
) -> ShownLines:  # fmt: skip
    """By NumPy."""
    model: Model = view.model
    K, R, r, m = len(p), len(dwells.omega), model.D.shape[1], view.m
    by_dwell = np.repeat(p, R, axis=0)
    drive = dwells.drive(q, r)
    at = periodic_response(model, by_dwell, np.repeat(constants, R, axis=0), drive, start, grow=grow)
    a = harmonic_unit_forces(model, drive, at)
    X, forces = dwells.lines(at.X, K), dwells.lines(a, K)
    Y = channel_amplitudes(view, X, q, p[:, None, :] * forces)
    along_p, along_g, along = _directions(view, dwells, q.shape[-1], noisy)
    every = None if along is None else np.tile(along, (K, 1, 1, 1))
    along_U, along_f = (None, None) if every is None else (every[:, :, :r], every[:, :, r:])
    slope = slopes(model, by_dwell, drive, at, a, along_p, along_g, along_U, along_f)
    d_forces = p[:, None, :, None] * dwells.lines(slope.unit_forces, K)
    d_forces[..., :m] += forces[..., None] * model.T
    dY = view.rates[..., None] * (view.on_x @ dwells.lines(slope.X, K)) + view.force @ d_forces
    if noisy:
        dY[..., m:] += _straight_through(view, dwells, q.shape[-1])
    return ShownLines(Y, dY, at.delta, slope.delta[..., :m], at.converged)
