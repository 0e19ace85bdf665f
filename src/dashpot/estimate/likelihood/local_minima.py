"""Where searches of the likelihood ended: told apart, in order, and those that compete."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real

MOST = 128  # ends of searches: dozens lie along a flat valley, and the right one must not be lost beside them
COMPETING = (
    60.0  # χ² by which a minimum may lie above the lowest one of one repeat and be the lowest of another
)


@dataclass(frozen=True)
class LocalMinima:
    """Where searches ended, the lowest first: psi (V, M), signs of the channels (V, channels), cost (V,)."""

    psi: Real
    sign: Real
    cost: Real

    @staticmethod
    def none(unknowns: int, channels: int) -> LocalMinima:
        """No minima yet."""
        return LocalMinima(np.empty((0, unknowns)), np.empty((0, channels)), np.empty(0))

    def with_ends(self, psi: Real, sign: Real, cost: Real) -> LocalMinima:
        """With more ends, (k, M), (k, channels) and (k,).

        Those within 2 % of a lower one in every unknown are left out.
        """
        psi, sign = np.concatenate([self.psi, psi]), np.concatenate([self.sign, sign])
        cost = np.concatenate([self.cost, cost])
        kept: list[int] = []
        for k in np.argsort(cost):
            size = np.maximum(np.abs(psi[k]), np.abs(psi[kept]))
            near = np.abs(psi[k] - psi[kept]) <= 0.02 * size
            if np.isfinite(cost[k]) and not np.any(
                np.all(near, axis=-1) & np.all(sign[k] == sign[kept], axis=-1)
            ):
                kept.append(int(k))
            if len(kept) == MOST:
                break
        return self if not kept else LocalMinima(psi[kept], sign[kept], cost[kept])

    def led_by(self, psi: Real, sign: Real) -> LocalMinima:
        """With ψ (1, M) and signs (1, channels) in the place of the first."""
        return LocalMinima(
            np.concatenate([psi, self.psi[1:]]), np.concatenate([sign, self.sign[1:]]), self.cost
        )

    def competing(self, rows: int) -> LocalMinima:
        """Those that may be as likely as the lowest one, if noise is what that leaves of so many `rows`."""
        return self.within(float(np.min(self.cost, initial=np.inf)) * COMPETING / max(rows, 1))

    def within(self, margin: float) -> LocalMinima:
        """Those that lie no more than `margin` above the lowest one."""
        near = self.cost <= self.cost[:1] + margin
        return LocalMinima(self.psi[near], self.sign[near], self.cost[near])
