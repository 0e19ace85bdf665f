"""Unit forces of nonlinear laws at the Lobatto points of a step, with their slopes and the states that laws carry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Real
from dashpot.model.nonlinear.force_law import ForceLaw
from dashpot.model.nonlinear.propagation import WITHIN

NEWTON = 24


@dataclass(frozen=True)
class HeldStates:
    """States of a law at the nodes, (S, 4), and their slopes along d and v at all nodes (S, 4, 4), z0 and constants.

    step: the largest last change of z over its size.
    """

    z: Real
    step: float
    by_d: Real
    by_v: Real
    by_z0: Real
    by_g: Real


@dataclass(frozen=True)
class StepForces:
    """Unit forces at the nodes (S, 4, e) and their slopes: along d and v at the same node (S, 4 e), or, `full`, at all
    nodes (S, 4 e, 4 e); along the states z0 at the start and the constants; z (S, 4, laws with a state).
    """

    a: Real
    by_d: Real
    by_v: Real
    by_z0: Real
    by_g: tuple[Real, ...]
    z: Real
    held: tuple[HeldStates, ...]
    full: bool

    def times(self, d: Real, v: Real) -> Real:
        """What changes of d and v at the nodes, (S, 4, e, Q), do to the unit forces."""
        if not self.full:
            shape = (*d.shape[:3], 1)
            return self.by_d.reshape(shape) * d + self.by_v.reshape(shape) * v
        wide = (len(d), -1, d.shape[-1])
        change: Real = self.by_d @ d.reshape(wide) + self.by_v @ v.reshape(wide)
        return change.reshape(d.shape)

    def rows(self, chosen: slice) -> StepForces:
        """Those of some of the segments, without the states of laws."""
        by_g = tuple(by[chosen] for by in self.by_g)
        return replace(
            self, a=self.a[chosen], by_d=self.by_d[chosen], by_v=self.by_v[chosen], by_z0=self.by_z0[chosen], by_g=by_g,
            z=self.z[chosen], held=(),
        )  # fmt: skip


def held_states(law: ForceLaw, d: Real, v: Real, z: Real, z0: Real, g: Real, h: float) -> HeldStates:
    """The state of a law over one step, from z0: collocation of its rate, or the operator from node to node.

    One step of Newton's method from z (S, nodes) on the collocation, with the slopes there: the caller's steps for the
    forces bring both to their end.  d, v (S, nodes), z0 (S,) at the start, g the constants of the law, h in s.
    """
    if law.operator:
        return _operated_nodes(law, d, z0, g)
    assert law.rate is not None
    S, K = d.shape
    Q = h * WITHIN
    at = law.rate(law.values(d, v, z, g))
    nothing = np.zeros((S, K))
    along = {name: np.broadcast_to(slope, (S, K)) for name, slope in at.slopes.items()}
    inverse: Real = np.linalg.inv(np.eye(K) - Q * along.get("z", nothing)[:, None, :]).astype(np.float64)
    missing = z - z0[:, None] - np.broadcast_to(at.value, (S, K)) @ Q.T
    change = (inverse @ missing[..., None])[..., 0]
    z = z - change
    by_d, by_v = (inverse @ (Q * along.get(name, nothing)[:, None, :]) for name in ("d", "v"))
    columns = [along.get(name, nothing) @ Q.T for name in law.constant_names]
    by_g = inverse @ np.stack(columns, axis=-1) if columns else np.zeros((S, K, 0))
    step = float(np.max(np.abs(change)) / (np.max(np.abs(z)) + 1e-300))
    return HeldStates(z, step, by_d, by_v, inverse.sum(axis=-1), by_g)


def _operated_nodes(law: ForceLaw, d: Real, z0: Real, g: Real) -> HeldStates:
    """Stop and play from node to node; a z0 that they cannot have at the first elongation is moved to where they can.

    What a record is said to begin with may be out of reach: a play is carried along at once.
    """
    S, K = d.shape
    tangent, nothing = np.zeros((S, K + 2)), np.zeros((S, K + 2))  # along d at the nodes, z0 and the width
    tangent[:, K] = 1.0
    z, states, tangents = z0, [], []
    width = g[:, 0]
    for k in range(K):
        change = nothing.copy()
        change[:, k] = 1.0
        if law.operator == "play":
            z, tangent = clipped(z, tangent, d[:, k], change, width, K + 1)
        else:
            if k:
                change[:, k - 1] = -1.0
                z, tangent = z + d[:, k] - d[:, k - 1], tangent + change
            z, tangent = clipped(z, tangent, np.zeros(S), nothing, width, K + 1)
        states.append(z)
        tangents.append(tangent)
    total = np.stack(tangents, axis=1)
    return HeldStates(
        np.stack(states, axis=1), 0.0, total[..., :K], np.zeros((S, K, K)), total[..., K], total[..., K + 1 :]
    )


def clipped(
    free: Real, tangent: Real, centre: Real, tangent_centre: Real, width: Real, column: int
) -> tuple[Real, Real]:
    """`free` (...,) held within centre ± width, and its tangent (..., columns).

    The width is the unknown of `column`.
    """
    above, below = free > centre + width, free < centre - width
    z = np.where(above, centre + width, np.where(below, centre - width, free))
    edge = np.broadcast_to(tangent_centre, tangent.shape).copy()
    edge[:, column] += np.where(above, 1.0, -1.0)
    return z, np.where((above | below)[:, None], edge, tangent)
