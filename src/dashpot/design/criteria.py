"""What a test is to be good for, as convex functions of its information (THEORY §6).

With C_s = M_s⁻¹ the covariance of relative errors in scenario s, a goal is

    F = max_k Φ_k,      Φ_k = Σ_s,j a_ksj (C_s)_jj      or      Σ_s a_ks ln det (C_s)_II / |I|,

convex in the information, hence in the time at each frequency.  Silvey, Optimal Design (1980), ch. 2-3; Pukelsheim,
Optimal Design of Experiments (2006), ch. 5.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Literal

import numpy as np

from dashpot.arrays import Ints, Real, frozen
from dashpot.design.test_setup import Bench
from dashpot.errors import UsageError

Doubt = Literal["average", "worst"]


@dataclass(frozen=True)
class Terms:
    """A goal over the scenarios of a bench.

    weights  (K, scenarios, q): a_ksj; for a determinant (K, scenarios, 1): a_ks
    block    indices I of a determinant; None for sums of variances
    """

    weights: Real
    block: Ints | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", frozen(self.weights, np.float64))
        if self.block is not None:
            object.__setattr__(self, "block", frozen(self.block, np.int64))


class Goal(ABC):
    """What to make small.  Subclasses are frozen dataclasses."""

    name: ClassVar[str]

    @abstractmethod
    def terms(self, bench: Bench, doubt: Doubt) -> Terms:
        """The goal over all scenarios: their average, or the worst of them.  Raises UsageError for unknown names."""

    def figure(self, value: float) -> float:
        """What people read for a value of F: a relative standard deviation."""
        return float(np.sqrt(value))


def chosen(bench: Bench, names: Sequence[str]) -> Ints:
    """Indices of the named unknowns; without names those that no sd makes known already (all if there are none)."""
    own = [u.name for u in bench.model.unknowns]
    for name in names:
        if name not in own:
            raise UsageError(f"{name} is no unknown of this rig", cure=f"its unknowns are {', '.join(own)}")
    if names:
        return np.array(sorted({own.index(name) for name in names}))
    free = [i for i, u in enumerate(bench.model.unknowns) if u.sd is None]
    return np.array(free if free else range(len(own)))


def _spread(bench: Bench, rows: Real, doubt: Doubt) -> Real:
    """(k, q) weights of one scenario over all scenarios: k averages, or k for each scenario."""
    if doubt == "average":
        return rows[:, None, :] * bench.probability[:, None]
    each = np.eye(bench.scenarios)
    spread: Real = np.einsum("kq,ts->tksq", rows, each).reshape(-1, bench.scenarios, rows.shape[1])
    return spread


@dataclass(frozen=True)
class MeanError(Goal):
    """Mean relative variance of the unknowns (A-optimal; of one unknown, c-optimal); read as the rms relative sd."""

    names: tuple[str, ...] = ()
    name: ClassVar[str] = "mean relative error (A)"

    def terms(self, bench: Bench, doubt: Doubt) -> Terms:
        """Φ = Σ_j C_jj / count."""
        i = chosen(bench, self.names)
        row = np.zeros((1, len(bench.names)))
        row[0, i] = 1 / len(i)
        return Terms(_spread(bench, row, doubt))


@dataclass(frozen=True)
class WorstError(Goal):
    """Largest relative variance of the unknowns (minimax)."""

    names: tuple[str, ...] = ()
    name: ClassVar[str] = "worst relative error (minimax)"

    def terms(self, bench: Bench, doubt: Doubt) -> Terms:
        """Φ_j = C_jj."""
        i = chosen(bench, self.names)
        rows = np.zeros((len(i), len(bench.names)))
        rows[range(len(i)), i] = 1.0
        return Terms(_spread(bench, rows, doubt))


@dataclass(frozen=True)
class Targets(Goal):
    """Largest variance in parts of what is wanted: `targets` are relative standard deviations by name."""

    targets: Mapping[str, float]
    name: ClassVar[str] = "worst error in parts of the targets (minimax)"

    def __post_init__(self) -> None:
        object.__setattr__(self, "targets", MappingProxyType(dict(self.targets)))
        for name, target in self.targets.items():
            if not (np.isfinite(target) and target > 0):
                raise UsageError(
                    f"a target of {target:g} for {name}", cure="give a positive relative sd, such as 2%"
                )

    def terms(self, bench: Bench, doubt: Doubt) -> Terms:
        """Φ_j = C_jj / target_j²."""
        i = chosen(bench, tuple(self.targets))
        own = [bench.model.unknowns[int(j)].name for j in i]
        rows = np.zeros((len(i), len(bench.names)))
        rows[range(len(i)), i] = [self.targets[name] ** -2 for name in own]
        return Terms(_spread(bench, rows, doubt))


@dataclass(frozen=True)
class Volume(Goal):
    """Volume of the confidence region (D-optimal); read as its mean radius, in parts of the values."""

    names: tuple[str, ...] = ()
    name: ClassVar[str] = "volume of the confidence region (D)"

    def terms(self, bench: Bench, doubt: Doubt) -> Terms:
        """Φ = ln det C_II / |I|."""
        i = chosen(bench, self.names)
        return Terms(_spread(bench, np.ones((1, 1)), doubt), i)

    def figure(self, value: float) -> float:
        """Geometric mean of the semi-axes: exp(Φ/2)."""
        return float(np.exp(value / 2))
