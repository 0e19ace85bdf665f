"""The Gram of a large rig of which everything is seen, on the pattern of elements that meet (THEORY (G), §7).

N = Σ_l Re Ψᴴ W Φ,   Φ = Bᵀ diag(a) T,   Ψ the same with the motion of the auxiliary model,   W = diag Cov(e)⁻¹

Two unknowns have an entry in N only where their elements meet at a coordinate, so that cost and memory grow with the
number of such pairs.  The weight is the diagonal of the optimal one: with all of Cov(e)⁻¹, which is full, every two
unknowns would have an entry.  Standard deviations are those of the sandwich, for the unknowns that are asked for: one
solution with Nᵀ each.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from dashpot.arrays import Complex, Ints, Real, freeze
from dashpot.errors import DataError, IdentifiabilityError, UsageError
from dashpot.io.json_document import to_json
from dashpot.io.words import did_you_mean
from dashpot.model.dynamics import sparse_amplitudes
from dashpot.model.network import Model, row_products

MOST_ITERATIONS = 50
STILL = 1e-6  # relative change of every unknown, at which the iteration ends
TOGETHER = 32  # standard deviations computed at once
QUANTILE = 1.959963984540054


@dataclass(frozen=True)
class SeenMotion:
    """Amplitudes of everything that moves and drives a rig, with the variances of their independent noise.

    omega (lines,) rad/s; X (lines, n) m, U (lines, r) m, f (lines, s) N; var_X, var_U, var_f: E|Δ|² of each, 0 where
    exact.  Raises DataError where shapes do not match or a number is not finite.
    """

    omega: Real
    X: Complex
    U: Complex
    f: Complex
    var_X: Real
    var_U: Real
    var_f: Real

    def __post_init__(self) -> None:
        freeze(self)
        for name in ("X", "U", "f"):
            values, variances = getattr(self, name), getattr(self, f"var_{name}")
            if np.shape(values) != np.shape(variances) or len(values) != len(self.omega):
                raise DataError(
                    f"{name} and its variances have the shapes {np.shape(values)}, {np.shape(variances)}"
                )
            if not (np.all(np.isfinite(values)) and np.all(np.isfinite(variances))):
                raise DataError(
                    f"{name} has a gap", cure="every coordinate and input must be measured at every line"
                )


@dataclass(frozen=True)
class LargeEstimate:
    """Values of very many unknowns, with standard deviations of those that were asked for (NaN elsewhere).

    residual  √ of the mean of |e|² over its variance: near √(1 − unknowns / equations) where model and noise are right
    """

    model: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    sd: Real
    converged: bool
    iterations: int
    residual: float
    equations: int

    def __post_init__(self) -> None:
        freeze(self)

    def to_json(self) -> str:
        """As the JSON of every estimate; `covariance` is null, and so is an sd that was not asked for."""
        parameters = {
            name: {
                "value": value,
                "sd": sd,
                "interval95": [value - QUANTILE * sd, value + QUANTILE * sd],
                "unit": unit,
                "known": False,
            }
            for name, unit, value, sd in zip(
                self.names, self.units, self.values.tolist(), self.sd.tolist(), strict=True
            )
        }
        content: dict[str, Any] = {
            "model": self.model, "method": "iv", "status": "converged" if self.converged else "not converged",
            "iterations": self.iterations, "parameters": parameters, "order": list(self.names), "covariance": None,
            "fit": {"residual": self.residual, "equations": self.equations},
        }  # fmt: skip
        return to_json(content)


def identify_seen(
    model: Model, motion: SeenMotion, selected: Iterable[str] = (), start: Real | None = None
) -> LargeEstimate:
    """Estimate all unknowns of a linear rig from its whole motion, by instrumental variables from least squares on.

    `selected` names the unknowns whose standard deviations are computed; `start` (unknowns,) takes the place of least
    squares, which noise biases.  Raises UsageError for a name that is not an unknown and for nonlinear rigs,
    IdentifiabilityError where the motion does not determine the unknowns.
    """
    if len(model.nonlinear):
        raise UsageError("this works for linear rigs only", cure="use identify")
    model.require_unknowns()
    index = {unknown.name: j for j, unknown in enumerate(model.unknowns)}
    names = list(selected)
    strangers = [name for name in names if name not in index]
    if strangers:
        raise UsageError(
            f"{strangers[0]} is not an unknown of this rig",
            cure=f"{did_you_mean(strangers[0], tuple(index)[:1000])}it has {len(index):,} unknowns",
        )
    places = np.array([index[name] for name in names], dtype=np.int64)
    pairs = MeetingPairs.of(model)
    a = _unit_forces(model, motion.omega, motion.X, motion.U)
    theta = _least_squares(model, motion, pairs, a) if start is None else np.asarray(start, dtype=np.float64)
    converged, count = False, 0
    while not converged and count < MOST_ITERATIONS:
        w = _instruments(model, motion, theta)
        weight = 1 / _variance(model, motion, theta)
        fresh = pairs.solved(model, motion, w, a, weight)
        change = np.max(np.abs(fresh - theta) / np.maximum(np.abs(fresh), 1e-300))
        theta, count = fresh, count + 1
        converged = bool(change < STILL)
    w, variance = _instruments(model, motion, theta), _variance(model, motion, theta)
    p = model.parameters(theta)
    e = np.stack(
        [model.sparse_B.T @ (p * a[line]) - model.S @ motion.f[line] for line in range(len(motion.omega))]
    )
    sd = np.full(len(theta), np.nan)
    if len(places):
        N = pairs.normal(model, w, a, 1 / variance)
        sd[places] = _deviations(model, motion, theta, N, w, 1 / variance, places)
    return LargeEstimate(
        model.name, model.unknown_names, model.unknown_units, theta, sd, converged,
        count, float(np.sqrt(np.mean(np.abs(e) ** 2 / variance))), 2 * e.size,
    )  # fmt: skip


# The Gram


@dataclass(frozen=True)
class MeetingPairs:
    """Pairs of elements with unknowns that meet at a coordinate: where N has its entries.

    first, second, at (pairs,): the two elements and the coordinate; factor: B_ic B_jc T_iα T_jβ; α, β: their unknowns.
    """

    first: Ints
    second: Ints
    at: Ints
    factor: Real
    alpha: Ints
    beta: Ints

    @staticmethod
    def of(model: Model) -> MeetingPairs:
        """Those of a rig."""
        T = model.sparse_T.tocoo()
        unknown, times = np.full(len(model.elements), -1, dtype=np.int64), np.zeros(len(model.elements))
        unknown[T.row], times[T.row] = T.col, T.data
        attached: Any = sparse.csr_array(model.sparse_B.T)
        flat = row_products(attached, attached)
        at = np.repeat(np.arange(model.n), np.diff(flat.indptr))
        first, second = np.divmod(flat.indices.astype(np.int64), len(model.elements))
        kept = (unknown[first] >= 0) & (unknown[second] >= 0)
        first, second = first[kept], second[kept]
        factor = flat.data[kept] * times[first] * times[second]
        return MeetingPairs(first, second, at[kept], factor, unknown[first], unknown[second])

    def normal(self, model: Model, w: Complex, a: Complex, weight: Real) -> Any:
        """N = Σ Re Ψᴴ W Φ, sparse (unknowns, unknowns); w, a (lines, elements), weight (lines, n)."""
        total = np.zeros(len(self.first))
        for line in range(len(a)):
            v, b = w[line], a[line]
            products = v.real[self.first] * b.real[self.second] + v.imag[self.first] * b.imag[self.second]
            total += weight[line][self.at] * products
        m = len(model.unknowns)
        N: Any = sparse.coo_array((total * self.factor, (self.alpha, self.beta)), shape=(m, m)).tocsc()
        return N + sparse.diags_array(model.prior_precision, format="csc")

    def solved(self, model: Model, motion: SeenMotion, w: Complex, a: Complex, weight: Real) -> Real:
        """θ (m,) of the normal equations, N θ = Σ Re Ψᴴ W h.  Raises IdentifiabilityError where N is singular."""
        right = model.prior_precision * model.prior_mean
        for line in range(len(a)):
            h = model.S @ motion.f[line] - model.sparse_B.T @ (a[line] * model.p0)
            right = right + model.sparse_T.T @ (np.conj(w[line]) * (model.sparse_B @ (weight[line] * h))).real
        factors, scale = _factorised(self.normal(model, w, a, weight))
        theta: Real = scale * factors.solve(scale * right)
        if not np.all(np.isfinite(theta)):
            raise _undetermined()
        return theta


def _factorised(N: Any) -> tuple[Any, Real]:
    """LU factors of N with rows and columns scaled to ones on the diagonal, and the scale."""
    diagonal = N.diagonal()
    if not np.all(np.isfinite(diagonal)) or np.any(diagonal == 0):
        raise _undetermined()
    scale = 1 / np.sqrt(np.abs(diagonal))
    scaled = sparse.diags_array(scale) @ N @ sparse.diags_array(scale)
    try:
        return splu(scaled.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}), scale
    except RuntimeError:
        raise _undetermined() from None


def _undetermined() -> IdentifiabilityError:
    return IdentifiabilityError(
        "the motion does not determine every unknown",
        cure="drive the rig at more points or frequencies, or fix some",
    )


# The equation of motion, line by line


def _unit_forces(model: Model, omega: Real, X: Complex, U: Complex) -> Complex:
    """a = φ (B X + D U), (lines, elements)."""
    factors = model.factors(omega)
    a = np.empty(factors.shape, dtype=np.complex128)
    for line in range(len(omega)):
        a[line] = factors[line] * (model.sparse_B @ X[line] + model.sparse_D @ U[line])
    return a


def _least_squares(model: Model, motion: SeenMotion, pairs: MeetingPairs, a: Complex) -> Real:
    """Where the iteration begins: w = a, each line weighed alike by its size."""
    power = np.maximum(np.mean(np.abs(a) ** 2, axis=1, keepdims=True), 1e-300)
    weight = np.broadcast_to(1 / power, motion.X.shape)
    return pairs.solved(model, motion, a, a, weight)


def _instruments(model: Model, motion: SeenMotion, theta: Real) -> Complex:
    """Unit forces of the auxiliary model under the measured inputs, (lines, elements)."""
    X = sparse_amplitudes(model, model.parameters(theta), motion.omega, motion.U, motion.f)
    if not np.all(np.isfinite(X)):
        raise _undetermined()
    return _unit_forces(model, motion.omega, X, motion.U)


def _stiffness(model: Model, weight: Complex) -> tuple[Any, Complex]:
    """D sparse (n, n) and −R (n, r) at one line; weight = p φ (elements,)."""
    B: Any = model.sparse_B
    weighted = sparse.csr_array(B * weight[:, None])
    return (B.T @ weighted).tocsr(), B.T @ (weight[:, None] * model.D)


def _variance(model: Model, motion: SeenMotion, theta: Real) -> Real:
    """Variance of the equation error at each coordinate, (lines, n), with a floor where everything is exact."""
    p, factors = model.parameters(theta), model.factors(motion.omega)
    variance = np.empty(motion.X.shape)
    for line in range(len(motion.omega)):
        D, R = _stiffness(model, p * factors[line])
        noise = abs(D).power(2) @ motion.var_X[line] + np.abs(R) ** 2 @ motion.var_U[line]
        size = abs(D).power(2) @ (np.abs(motion.X[line]) ** 2)
        variance[line] = noise + model.S**2 @ motion.var_f[line] + 1e-24 * size + 1e-300
    return variance


def _deviations(
    model: Model, motion: SeenMotion, theta: Real, N: Any, w: Complex, weight: Real, places: Ints
) -> Real:
    """Standard deviations of the unknowns at `places`: √(½ Σ gᴴ Cov(e) g) with g = W Ψ N⁻ᵀ e_j."""
    factors, scale = _factorised(N)
    p, phi = model.parameters(theta), model.factors(motion.omega)
    total = np.zeros(len(places))
    stiffness = [_stiffness(model, p * phi[line]) for line in range(len(motion.omega))]
    for first in range(0, len(places), TOGETHER):
        chosen = places[first : first + TOGETHER]
        unit = np.zeros((len(theta), len(chosen)))
        unit[chosen, np.arange(len(chosen))] = scale[chosen]
        back = model.sparse_T @ (scale[:, None] * factors.solve(unit, trans="T"))
        for line, (D, R) in enumerate(stiffness):
            g = weight[line][:, None] * (model.sparse_B.T @ (w[line][:, None] * back))
            total[first : first + len(chosen)] += (
                motion.var_X[line] @ np.abs(D.T @ g.conj()) ** 2
                + motion.var_U[line] @ np.abs(R.T @ g.conj()) ** 2
                + motion.var_f[line] @ np.abs(model.S.T @ g.conj()) ** 2
            )
    return np.sqrt(total / 2)
