"""What a test is to be good for, as convex functions of its information (THEORY §6).

With C_s = M_s⁻¹ the covariance of relative errors in scenario s, a criterion is

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

from dashpot.arrays import Ints, Real, freeze
from dashpot.design.schedule import Schedule
from dashpot.design.test_setup import TestSetup
from dashpot.errors import IdentifiabilityError, UsageError
from dashpot.model.network import Model
from dashpot.model.observation import calibration_names

SINGULAR = 10 * np.finfo(float).eps  # pivot of a correlation matrix, for each row: rounding

Robustness = Literal["average", "worst"]
Reading = Literal["each", "rms", "volume"]


@dataclass(frozen=True)
class Terms:
    """A criterion over the scenarios of a setup.

    weights  (K, scenarios, q): a_ksj; for a determinant (K, scenarios, 1): a_ks
    block    indices I of a determinant; None for sums of variances
    """

    weights: Real
    block: Ints | None = None

    def __post_init__(self) -> None:
        freeze(self)


class Criterion(ABC):
    """What to make small.  Subclasses are frozen dataclasses.

    `reading` is what must be as small as its target: every standard deviation, their rms, or the mean radius of the
    confidence region; `in_targets` whether the figure counts in targets, not in values.
    """

    name: ClassVar[str]
    reading: ClassVar[Reading]
    in_targets: ClassVar[bool] = False

    @abstractmethod
    def terms(self, setup: TestSetup, robustness: Robustness) -> Terms:
        """The criterion over all scenarios: their average, or the worst of them.  UsageError for unknown names."""

    @abstractmethod
    def targets_for(self, model: Model, figure: float) -> dict[str, float]:
        """Relative standard deviations by name that the figure asks of the unknowns."""

    def figure(self, value: float) -> float:
        """What people read for a value of F: a relative standard deviation."""
        return float(np.sqrt(value))


def chosen(model: Model, names: Sequence[str]) -> Ints:
    """Indices of the named unknowns; without names those that no sd makes known already (all if there are none).

    Raises UsageError for names that are no unknowns.
    """
    unknowns = [u.name for u in model.unknowns]
    for name in names:
        if name not in unknowns:
            raise UsageError(
                f"'{name}' is not an unknown of this rig", cure=f"its unknowns are {', '.join(unknowns)}"
            )
    if names:
        return np.array(sorted({unknowns.index(name) for name in names}))
    free = [i for i, u in enumerate(model.unknowns) if u.sd is None]
    return np.array(free if free else range(len(unknowns)))


def _each(model: Model, names: Sequence[str], figure: float) -> dict[str, float]:
    return {model.unknowns[int(j)].name: figure for j in chosen(model, names)}


def _spread(setup: TestSetup, rows: Real, robustness: Robustness) -> Real:
    """(k, q) weights of one scenario over all scenarios: k averages, or k for each scenario."""
    if robustness == "average":
        return rows[:, None, :] * setup.probability[:, None]
    each = np.eye(setup.scenarios)
    return np.einsum("kq,ts->tksq", rows, each).reshape(-1, setup.scenarios, rows.shape[1])


@dataclass(frozen=True)
class AOptimal(Criterion):
    """Mean relative variance of the unknowns (A-optimal; of one unknown, c-optimal); read as the rms relative sd."""

    names: tuple[str, ...] = ()
    name: ClassVar[str] = "mean relative error (A)"
    reading: ClassVar[Reading] = "rms"

    def terms(self, setup: TestSetup, robustness: Robustness) -> Terms:
        """Φ = Σ_j C_jj / count."""
        i = chosen(setup.model, self.names)
        row = np.zeros((1, len(setup.names)))
        row[0, i] = 1 / len(i)
        return Terms(_spread(setup, row, robustness))

    def targets_for(self, model: Model, figure: float) -> dict[str, float]:
        """The figure for every one of them."""
        return _each(model, self.names, figure)


@dataclass(frozen=True)
class Minimax(Criterion):
    """Largest relative variance of the unknowns (minimax)."""

    names: tuple[str, ...] = ()
    name: ClassVar[str] = "worst relative error (minimax)"
    reading: ClassVar[Reading] = "each"

    def terms(self, setup: TestSetup, robustness: Robustness) -> Terms:
        """Φ_j = C_jj."""
        i = chosen(setup.model, self.names)
        rows = np.zeros((len(i), len(setup.names)))
        rows[range(len(i)), i] = 1.0
        return Terms(_spread(setup, rows, robustness))

    def targets_for(self, model: Model, figure: float) -> dict[str, float]:
        """The figure for every one of them."""
        return _each(model, self.names, figure)


@dataclass(frozen=True)
class MinimaxTargets(Criterion):
    """Largest variance in parts of what is wanted: `targets` are relative standard deviations by name."""

    targets: Mapping[str, float]
    name: ClassVar[str] = "worst error in parts of the targets (minimax)"
    reading: ClassVar[Reading] = "each"
    in_targets: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "targets", MappingProxyType(dict(self.targets)))
        for name, target in self.targets.items():
            if not (np.isfinite(target) and target > 0):
                raise UsageError(
                    f"a target of {target:g} for {name}", cure="give a positive relative sd, such as 2%"
                )

    def terms(self, setup: TestSetup, robustness: Robustness) -> Terms:
        """Φ_j = C_jj / target_j²."""
        i = chosen(setup.model, tuple(self.targets))
        names = [setup.model.unknowns[int(j)].name for j in i]
        rows = np.zeros((len(i), len(setup.names)))
        rows[range(len(i)), i] = [self.targets[name] ** -2 for name in names]
        return Terms(_spread(setup, rows, robustness))

    def targets_for(self, model: Model, figure: float) -> dict[str, float]:
        """The targets, times the figure."""
        return {name: figure * target for name, target in self.targets.items()}


@dataclass(frozen=True)
class DOptimal(Criterion):
    """Volume of the confidence region (D-optimal); read as its mean radius, in parts of the values."""

    names: tuple[str, ...] = ()
    name: ClassVar[str] = "volume of the confidence region (D)"
    reading: ClassVar[Reading] = "volume"

    def terms(self, setup: TestSetup, robustness: Robustness) -> Terms:
        """Φ = ln det C_II / |I|."""
        i = chosen(setup.model, self.names)
        return Terms(_spread(setup, np.ones((1, 1)), robustness), i)

    def targets_for(self, model: Model, figure: float) -> dict[str, float]:
        """The figure for every one of them."""
        return _each(model, self.names, figure)

    def figure(self, value: float) -> float:
        """Geometric mean of the semi-axes: exp(Φ/2)."""
        return float(np.exp(value / 2))


@dataclass(frozen=True)
class CriterionValue:
    """F at one M, its parts Φ_k (K,), the covariances C (scenarios, q, q) and, for determinants, those of the rest."""

    F: float
    parts: Real
    C: Real
    rest: Real


def criterion_value(terms: Terms, M: Real) -> CriterionValue:
    """F of the information M (scenarios, q, q); infinite where M does not determine the unknowns."""
    q = M.shape[-1]
    scale = np.sqrt(np.maximum(np.diagonal(M, axis1=-2, axis2=-1), 1e-300))
    outer = scale[:, :, None] * scale[:, None, :]
    open_ = CriterionValue(
        np.inf, np.full(len(terms.weights), np.inf), np.full_like(M, np.nan), np.zeros_like(M)
    )
    try:
        L = np.linalg.cholesky(M / outer)
    except np.linalg.LinAlgError:
        return open_
    if np.min(np.diagonal(L, axis1=-2, axis2=-1)) ** 2 < SINGULAR * q:
        return open_  # whether Cholesky notices is up to the rounding of the machine
    root = np.linalg.solve(L, np.broadcast_to(np.eye(q), M.shape))
    C = np.swapaxes(root, -1, -2) @ root / outer
    rest = np.zeros_like(M)
    if terms.block is None:
        parts = np.einsum("ksj,sjj->k", terms.weights, C)
    else:
        other = np.setdiff1d(np.arange(q), terms.block)
        logdet = -np.linalg.slogdet(M)[1]
        if len(other):
            square = np.ix_(np.arange(len(M)), other, other)
            logdet = logdet + np.linalg.slogdet(M[square])[1]
            rest[square] = np.linalg.inv(M[square])
        parts = terms.weights[..., 0] @ logdet / len(terms.block)
    return CriterionValue(float(np.max(parts)), parts, C, rest)


def criterion_slopes(terms: Terms, at: CriterionValue, Mi: Real) -> Real:
    """−∂Φ_k/∂w_i (for N = 1), (K, lines), ≥ 0."""
    if terms.block is None:
        K, S, q = terms.weights.shape
        if K == 1:  # Σ a_j (C M C)_jj is the inner product of M with C diag(a) C
            return np.einsum("sab,slab->l", (at.C * terms.weights[0][:, None]) @ at.C, Mi)[None]
        # (C M C)_jj, row by row
        gain = np.sum((at.C[:, None] @ Mi) * np.swapaxes(at.C, -1, -2)[:, None], axis=-1)
        return terms.weights.reshape(K, S * q) @ np.swapaxes(gain, 1, 2).reshape(S * q, -1)
    trace = np.sum(at.C[:, None] * Mi, axis=(-1, -2)) - np.sum(at.rest[:, None] * Mi, axis=(-1, -2))
    return terms.weights[..., 0] @ trace / len(terms.block)


def criterion_curvature(terms: Terms, at: CriterionValue, Mi: Real, y: Real) -> Real:
    """Hessian of Σ y_k Φ_k over w (for N = 1), (lines, lines)."""
    lines = Mi.shape[1]
    flat = Mi.reshape(len(Mi), lines, -1)
    H = np.zeros((lines, lines))
    if terms.block is None:
        a = np.einsum("k,ksj->sj", y, terms.weights)
        for s in range(len(Mi)):
            if not np.any(a[s]):
                continue
            C = at.C[s]
            left = (C * a[s]) @ C @ Mi[s] @ C
            G = left.reshape(lines, -1) @ flat[s].T
            H += G + G.T
        return H
    weight = y @ terms.weights[..., 0] / len(terms.block)
    for s in range(len(Mi)):
        for inverse, sign in ((at.C[s], 1.0), (at.rest[s], -1.0)):
            if weight[s] and np.any(inverse):
                H += sign * weight[s] * ((inverse @ Mi[s] @ inverse).reshape(lines, -1) @ flat[s].T)
    return (H + H.T) / 2


# What a test will tell: standard deviations of the unknowns, and what each frequency adds to them.


@dataclass(frozen=True)
class ExpectedPrecision:
    """What a test will tell, at the nominal values.

    sd, relative  (q,)    standard deviations of ψ in SI units, and in parts of the values
    covariance    (q, q)  SI units
    figure        the criterion, as a relative standard deviation
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    sd: Real
    covariance: Real
    figure: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def relative(self) -> Real:
        """sd in parts of |value| (of 1 where the value is 0)."""
        return self.sd / np.where(self.values == 0, 1.0, np.abs(self.values))

    def rms(self, names: Sequence[str] = ()) -> float:
        """Root mean square of the relative standard deviations of all (or some) of the parameters."""
        chosen = [self.names.index(name) for name in names] if names else list(range(len(self.names)))
        return float(np.sqrt(np.mean(self.relative[chosen] ** 2)))


def expected_precision(
    setup: TestSetup, criterion: Criterion, information: Real, robustness: Robustness = "worst"
) -> ExpectedPrecision:
    """What information (scenarios, q, q) in parts of the parameters' sizes, prior included, will give.

    Raises IdentifiabilityError where it leaves some parameter open.
    """
    at = criterion_value(criterion.terms(setup, robustness), information)
    if not np.isfinite(at.F):
        raise IdentifiabilityError(
            "this test does not determine the unknowns", cure="give it more frequencies, or another sensor"
        )
    size = setup.sizes[0]
    C = at.C[0] * size[:, None] * size
    units = tuple(u.unit for u in setup.model.unknowns) + tuple(
        "s" if name.endswith(".delay") else "1" for name in calibration_names(setup.channels)
    )
    # Calibrations are errors of ln gain and of delay; their value is 1 and 0.
    extra = [0.0 if name.endswith(".delay") else 1.0 for name in calibration_names(setup.channels)]
    values = np.concatenate([setup.theta[0], extra])
    return ExpectedPrecision(setup.names, units, values, np.sqrt(np.diagonal(C)), C, criterion.figure(at.F))


def information_gain(
    setup: TestSetup, criterion: Criterion, schedule: Schedule, prior: Real, frequency_hz: Real, pattern: Ints
) -> Real:
    """How much a sample at each frequency adds to what is known of each parameter, (frequencies, q).

    (C M(f) C)_jj / C_jj at the nominal values, times the test's samples: 1 is what its average sample adds.
    """
    C = criterion_value(criterion.terms(setup, "worst"), prior + schedule.information(setup)).C[0]
    each = setup.information(frequency_hz, pattern)[0]
    gain = np.einsum("ja,iab,bj->ij", C, each, C)
    return float(np.sum(schedule.samples)) * gain / np.diagonal(C)
