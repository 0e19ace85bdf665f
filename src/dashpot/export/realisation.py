"""The equation of motion as a state space whose matrices are proper, whatever the base is given as.

M ẍ + C ẋ + K x = F u̇ + G u + J ü + S f.  A damper to the base needs u̇ and a mass that hangs on it ü, so that a channel
may depend on derivatives of what is given.  The input is therefore u, u̇ or ü, w = u^(d); lower derivatives are states,
and higher ones are taken out of the states by shifts:

    x = ξ + β₀ w          ẋ = η + β₁ w + β₀ ẇ          z = (ξ, η, lower derivatives of u)

With d = 0, β₀ = M⁻¹J, β₁ = M⁻¹F − M⁻¹C β₀; with d = 1, β₀ = 0, β₁ = M⁻¹J; with d = 2 both vanish.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Ints, Real
from dashpot.errors import ModelError
from dashpot.model.dynamics import matrices
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel

SINGULAR = 1e13  # condition of the scaled mass matrix
ROUNDING = 1e-12  # relative: below it a coefficient is one of rounding
DERIVATIVES = {"K": 0, "C": 1, "M": 2}

Matrix = np.ndarray[Any, Any]  # real, or complex where a slope is taken by a complex step


@dataclass(frozen=True)
class Signals:
    """Signals as Z z + Σ_k W_k w^(k): Z (..., signals, states), W (..., 3, signals, inputs)."""

    Z: Matrix
    W: Matrix

    def times(self, factors: Matrix) -> Signals:
        """Combinations of the signals, `factors` (..., combinations, signals)."""
        return Signals(factors @ self.Z, factors[..., None, :, :] @ self.W)

    def __add__(self, other: Signals) -> Signals:
        return Signals(self.Z + other.Z, self.W + other.W)

    @property
    def improper(self) -> Bools:
        """Which inputs have derivatives in which signals, (signals, inputs)."""
        size = np.max(np.abs(self.W), axis=(-3, -2), keepdims=True)
        depends: Bools = np.any((np.abs(self.W) > ROUNDING * size)[..., 1:, :, :], axis=-3)
        return depends

    @property
    def direct(self) -> Matrix:
        """W₀, (..., signals, inputs)."""
        return self.W[..., 0, :, :]


@dataclass(frozen=True)
class Realisation:
    """ż = A z + B w and the motion: x, ẋ, ẍ of coordinates, u, u̇, ü of moved points, f.

    A (..., states, states), B (..., states, inputs); `orders` (r,) of the derivatives that are given;
    `shifts` (β₀, β₁), each (..., n, r).
    """

    A: Matrix
    B: Matrix
    orders: Ints
    coordinates: tuple[Signals, Signals, Signals]
    moved: tuple[Signals, Signals, Signals]
    shifts: tuple[Matrix, Matrix]


def realisation(model: Model, p: Matrix, orders: Ints) -> Realisation:
    """A state space of the rig with parameters p (..., elements) that is driven by u^(d), d of `orders` (r,), and f.

    Raises ModelError where a coordinate has no mass.  p may be complex: slopes are taken by complex steps.
    """
    n, r, s = model.n, len(orders), model.S.shape[1]
    lead = p.shape[:-1]
    rig = matrices(model, p)
    _require_mass(rig.M)
    S = np.broadcast_to(model.S, (*lead, n, s))
    everything = np.linalg.solve(rig.M, np.concatenate([rig.K, rig.C, rig.G, rig.F, rig.J, S], axis=-1))
    stiffness, damping, by_u, by_rate, by_acceleration, by_force = np.split(
        everything, np.cumsum([n, n, r, r, r]), axis=-1
    )
    by_derivative = (by_u, by_rate, by_acceleration)
    beta0 = by_acceleration * (orders == 0)
    beta1 = (by_rate - damping @ by_acceleration) * (orders == 0) + by_acceleration * (orders == 1)
    states, inputs = 2 * n + int(np.sum(orders)), r + s
    moved = _moved_points(orders, n, states, inputs)
    A = np.zeros((*lead, states, states), dtype=everything.dtype)
    B = np.zeros((*lead, states, inputs), dtype=everything.dtype)
    A[..., :n, n : 2 * n] = np.eye(n)
    A[..., n : 2 * n, : 2 * n] = -np.concatenate([stiffness, damping], axis=-1)
    given = sum(by_derivative[d] * (orders == d) for d in range(3))
    B[..., :n, :r] = beta1
    B[..., n : 2 * n, :] = np.concatenate([given - stiffness @ beta0 - damping @ beta1, by_force], axis=-1)
    for d in range(2):  # where u^(d) is a state, it acts on the masses, and its own derivative is u^(d + 1)
        A[..., n : 2 * n, :] += by_derivative[d] @ moved[d].Z
        A += moved[d].Z.T @ moved[d + 1].Z
        B += moved[d].Z.T @ moved[d + 1].direct
    rows = np.eye(2 * n, states)
    nothing = np.zeros((*lead, n, inputs), dtype=everything.dtype)
    of_inputs = [np.concatenate([beta, np.zeros((*lead, n, s))], axis=-1) for beta in (beta0, beta1)]
    coordinates = (
        Signals(rows[:n], np.stack([of_inputs[0], nothing, nothing], axis=-3)),
        Signals(rows[n:], np.stack([of_inputs[1], of_inputs[0], nothing], axis=-3)),
        Signals(A[..., n : 2 * n, :], np.stack([B[..., n : 2 * n, :], of_inputs[1], of_inputs[0]], axis=-3)),
    )
    return Realisation(A, B, orders, coordinates, moved, (beta0, beta1))


def _require_mass(M: Matrix) -> None:
    size = np.sqrt(np.abs(np.diagonal(M, axis1=-2, axis2=-1)))
    if np.any(size == 0) or np.any(np.linalg.cond(M / (size[..., :, None] * size[..., None, :])) > SINGULAR):
        raise ModelError(
            "the rig has a coordinate without mass: its motion in time is not determined by its state",
            cure="give every coordinate a mass",
        )


def _moved_points(orders: Ints, n: int, states: int, inputs: int) -> tuple[Signals, Signals, Signals]:
    """u, u̇ and ü: states as far as they are below the derivative that is given, else inputs and their derivatives."""
    r = len(orders)
    first = 2 * n + np.concatenate([[0], np.cumsum(orders)]).astype(int)
    signals = []
    for k in range(3):
        Z, W = np.zeros((r, states)), np.zeros((3, r, inputs))
        for j, order in enumerate(orders.tolist()):
            if k < order:
                Z[j, first[j] + k] = 1.0
            else:
                W[k - order, j, j] = 1.0
        signals.append(Signals(Z, W))
    return signals[0], signals[1], signals[2]


def channel_signals(view: ObservationModel, p: Matrix, rig: Realisation) -> Signals:
    """What the channels show, calibrations left out: one signal each."""
    model = view.model
    r = len(rig.orders)
    states, inputs = rig.A.shape[-1], rig.B.shape[-1]
    applied = np.zeros((len(view.channels), inputs))
    applied[:, r:] = view.on_q[:, r:]
    nothing = np.zeros_like(applied)
    total = Signals(np.zeros((len(view.channels), states)), np.stack([applied, nothing, nothing]))
    for d in range(3):
        at = (view.derivative == d)[:, None]
        total = total + rig.coordinates[d].times(view.on_x * at) + rig.moved[d].times(view.on_q[:, :r] * at)
    for letter, derivative in DERIVATIVES.items():
        index = model.by_matrix[letter]
        if len(index) and view.has_forces:
            elongation = rig.coordinates[derivative].times(model.B[index]) + rig.moved[derivative].times(
                model.D[index]
            )
            total = total + elongation.times(view.force[:, index] * p[..., None, index])
    return total


def proper_orders(view: ObservationModel, p: Real, least: Sequence[int]) -> Ints:
    """The least derivatives of the moved points, `least` (r,) at least, by which every channel is proper."""
    orders = np.array(least, dtype=np.int64)
    while True:
        improper = np.any(channel_signals(view, p, realisation(view.model, p, orders)).improper, axis=0)[
            : len(orders)
        ]
        raised = np.minimum(orders + improper, 2)
        if np.array_equal(raised, orders):
            return orders
        orders = raised
