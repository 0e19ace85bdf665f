"""What channels show of periodic motions of nonlinear rigs: harmonics, and their largest value over a period."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import period_basis
from dashpot.model.nonlinear.harmonic_balance import Periodic, harmonic_unit_forces
from dashpot.model.nonlinear.harmonics import Drive, real_of
from dashpot.model.observation import channel_amplitudes, observation_model

INSTANTS = 16  # of a period, for each harmonic


def channel_harmonics(
    model: Model, p: Real, channels: Sequence[Channel], drive: Drive, at: Periodic
) -> Complex:
    """Harmonics of the channels' quantities, (N, H + 1, channels), SI units; p (N, elements) or (elements,).

    Raises DataError where a channel measures what the rig has not.
    """
    N, orders = len(drive.omega), drive.orders
    omega = (drive.omega[:, None] * np.arange(orders + 1)).ravel()
    view = observation_model(model, channels, omega)
    inputs = np.concatenate([drive.U, drive.f], axis=-1).reshape(len(omega), -1)
    strength = np.broadcast_to(p, (N, len(model.elements)))[:, None]
    forces = (strength * harmonic_unit_forces(model, drive, at)).reshape(len(omega), -1)
    X = at.X.reshape(len(omega), model.n)
    shown: Complex = channel_amplitudes(view, X, inputs, forces).reshape(N, orders + 1, len(channels))
    return shown


def swing(harmonics: Complex) -> Real:
    """Half of what each channel moves from its lowest to its highest value, (N, channels), of (N, H + 1, channels)."""
    orders = harmonics.shape[1] - 1
    there, _, _ = period_basis(orders, INSTANTS * (orders + 1))
    period = np.einsum("tw,ncw->ntc", there, real_of(np.moveaxis(harmonics, 1, -1)))
    half: Real = (np.max(period, axis=1) - np.min(period, axis=1)) / 2
    return half
