"""Fisher information of dwells of rigs with nonlinear elements: harmonics of the settled motion at a given drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Complex, Real, frozen
from dashpot.channel import Channel
from dashpot.errors import UsageError
from dashpot.estimate.nonlinear.dwells import FEWEST, DwellLines, WarmStart
from dashpot.estimate.nonlinear.objective import Evaluated, NonlinearPart, evaluate
from dashpot.model.channel_noise import noise_sd
from dashpot.model.network import Model
from dashpot.model.observation import measures_input, observation_model

ORDERS = 5  # harmonics that are measured
EXACT = 1e-9  # of the largest amplitude: noise of inputs without noise beside noisy ones


def dwell_information(
    model: Model, theta: Real, channels: Sequence[Channel], omega: Real, drive: Complex
) -> Real:
    """What one sample of each dwell tells about ψ, (scenarios, dwells, parameters, parameters), SI units of ψ.

    theta (scenarios, unknowns), omega (dwells,), drive (dwells, r + s).  N samples give the amplitude of each harmonic
    a covariance 4 R / N.  A dwell without a settled motion, or on a fold, tells nothing.  Raises UsageError for a
    channel of motion without noise.
    """
    moving = np.array([not measures_input(model, channel) for channel in channels])
    exact = [
        c.name for c, moves in zip(channels, moving, strict=True) if moves and not c.noise + c.relative_noise
    ]
    if exact:
        raise UsageError(
            f"channel {exact[0]} has no noise, which makes its information infinite",
            cure="state its noise (or relative_noise) in the rig file, or leave the channel out",
        )
    noisy = any(
        c.noise + c.relative_noise > 0 for c, moves in zip(channels, moving, strict=True) if not moves
    )
    at = _evaluated(model, theta, channels, omega, drive, noisy)
    K, R = len(theta), len(omega)
    Y = at.predicted.reshape(K, R, ORDERS, -1)
    sd = noise_sd(channels, Y[:, :, 0])[:, :, None]
    sd = np.maximum(sd, EXACT * np.max(np.abs(Y), axis=(1, 2), keepdims=True))
    A = _rows(at.J.reshape(*Y.shape, -1), sd)
    B = _rows(at.G.reshape(*Y.shape, -1), sd) if noisy else A[..., :0]
    finite = np.all(np.isfinite(A), axis=(2, 3)) & np.all(np.isfinite(B), axis=(2, 3))  # not so on a fold
    settled = (finite & at.converged.reshape(K, R))[..., None, None]
    if noisy:
        A, B = np.where(settled, A, 0.0), np.where(settled, B, 0.0)
        A = A - B @ (np.linalg.pinv(B) @ A)
    information: Real = np.where(settled, np.swapaxes(A, -1, -2) @ A, 0.0)
    return information


def _evaluated(
    model: Model, theta: Real, channels: Sequence[Channel], omega: Real, drive: Complex, noisy: bool
) -> Evaluated:
    """Channels at the harmonics of all dwells, (scenarios, dwells · ORDERS, channels), and their slopes."""
    dwells, orders = len(omega), np.arange(1, ORDERS + 1)
    smooth = all(e.force_law is None or e.force_law.smooth for e in model.elements)
    lines = DwellLines(
        frozen(omega, np.float64), np.repeat(np.arange(dwells), ORDERS), np.tile(orders, dwells),
        np.tile(orders - 1, dwells), ORDERS, max(FEWEST[smooth], 2 * ORDERS + 1),
    )  # fmt: skip
    view = observation_model(model, channels, np.outer(omega, orders).ravel())
    q = np.zeros((len(theta), dwells * ORDERS, drive.shape[-1]), dtype=np.complex128)
    q[:, ::ORDERS] = drive
    part = NonlinearPart(lines, None, q, np.arange(len(theta)), WarmStart())
    calibrations = np.concatenate([np.ones(view.gains), np.zeros(view.delays)])
    psi = np.concatenate([theta, np.tile(calibrations, (len(theta), 1))], axis=1)
    return evaluate(view, part, psi, np.ones((len(theta), len(channels))), q, None, noisy)


def _rows(slopes: Complex, sd: Real) -> Real:
    """Slopes of real and imaginary parts in standard deviations of one sample, (…, dwells, rows, columns)."""
    scaled = slopes / (np.sqrt(2.0) * sd[..., None])
    both = np.stack([scaled.real, scaled.imag], axis=2)
    return both.reshape(*both.shape[:2], -1, both.shape[-1])
