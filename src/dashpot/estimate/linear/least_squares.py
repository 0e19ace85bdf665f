"""Least squares on the equation of motion: the paper's on samples (eq. 17), on amplitudes, weighted, compensated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, hermitian
from dashpot.channel import Quantity
from dashpot.errors import DataError, UsageError
from dashpot.estimate.linear.gram import (
    compiled_equation,
    equation_covariance,
    gram,
    gram_force,
    known_side,
    regressors,
    weighted_normal,
)
from dashpot.estimate.method import Method, Solution, Traits, closed_form
from dashpot.estimate.nonlinear.regression import harmonic_equations, harmonic_least_squares
from dashpot.estimate.preparation import Prepared, States, reconstruction, unseen, without_priors
from dashpot.model.dynamics import unit_forces
from dashpot.model.network import Model
from dashpot.numerics.kernel import threads
from dashpot.numerics.small_systems import product, scaled_inverse, solve_scaled, solve_small

# The paper's methods work on samples: a_i(t) from the channel that measures the right derivative (eq.
# 7-15).
#
# A spring's unit force is read from displacements, a damper's from velocities, a mass's from accelerations
# or, as in the paper's J(ω), from −ω² x. All sums over samples are bilinear in q(t) = (channels, cos ωt,
# sin ωt), so the second moments Σ q qᵀ of the Spectrum hold them; without moments they are those of whole
# periods, N/2 Re(w̄ a).

CHUNK = 2_000_000  # complex numbers at once


@dataclass(frozen=True)
class Sampled:
    """Unit forces as the paper reads them, for K repeats.

    a       (K, lines, elements)            their amplitudes
    reading (K or 1, lines, elements, channels)   a = reading · y
    U, f    amplitudes of the inputs;       force (K or 1, lines, s, channels): f = force · y
    weight  (lines,)                        samples / 2
    coefficients (K, lines, elements, channels + 2)   a(t) = coefficients · q(t), None without moments
    moments (K, lines, channels + 2, channels + 2)
    """

    model: Model
    omega: Real
    V: Complex
    y: Complex
    a: Complex
    reading: Complex
    U: Complex
    f: Complex
    force: Complex
    weight: Real
    coefficients: Real | None
    moments: Real | None
    experiment: Ints | None = None

    def rows(self, rows: Ints) -> Sampled:
        """Some of the repeats, rows (k,)."""

        each = ("V", "y", "a", "reading", "U", "f", "force", "coefficients", "moments")
        parts = {name: getattr(self, name) for name in each}
        picked = {name: part[rows] for name, part in parts.items() if part is not None and len(part) > 1}
        return replace(self, **picked)


def sampled(data: Prepared) -> Sampled:
    """Read the unit forces from the channels.  Raises DataError if some coordinate is not seen."""
    view, spectrum, V = data.view, data.spectrum, data.covariance
    model = view.model
    _ = data.seen_states  # raises where some of them are not seen
    y = np.nan_to_num(spectrum.amplitudes)
    drive = view.inputs_alone & view.is_direct
    derivative = np.array(
        [-1 if c.quantity is Quantity.FORCE else c.quantity.derivative for c in spectrum.channels]
    )
    # For each derivative that elements need (and 0), the motion channels that it is read from
    P = {}
    for k in sorted({0, *(element.law.power for element in model.elements)}):
        tries = [derivative == k, derivative == 2 - k] if k != 1 else [derivative == 1]
        tries += [(derivative == 0) | (derivative == 2)] if spectrum.moments is not None and k != 1 else []
        seen = (chosen for chosen in tries if not unseen(view, spectrum, drive | chosen))
        P[k] = reconstruction(view, spectrum, V, drive | next(seen, derivative >= 0))
    n, r = model.n, len(model.displacement_inputs)
    span = np.concatenate([model.B, model.D], axis=1)
    phi = model.factors(spectrum.omega, spectrum.experiment)
    reading = np.empty(
        (len(V), spectrum.lines, len(model.elements), len(spectrum.channels)), dtype=np.complex128
    )
    for i, element in enumerate(model.elements):
        reading[..., i, :] = phi[:, i, None] * np.einsum(
            "q,...lqc->...lc", span[i], P[element.law.power][..., : n + r, :]
        )
    a = np.einsum("...lic,...lc->...li", reading, y)
    everything = P[0]
    U = np.einsum("...lqc,...lc->...lq", everything[..., n : n + r, :], y)
    force = everything[..., n + r :, :]
    f = np.einsum("...lqc,...lc->...lq", force, y)
    moments = None if spectrum.moments is None else spectrum.moments.products
    coefficients = None if moments is None else _time_coefficients(reading, y, drive)
    return Sampled(
        model,
        spectrum.omega,
        V,
        y,
        a,
        reading,
        U,
        f,
        force,
        spectrum.samples / 2,
        coefficients,
        moments,
        view.experiment,
    )


def _time_coefficients(reading: Complex, y: Complex, drive: np.ndarray) -> Real | None:
    """Coefficients over q(t); None if some unit force is no instantaneous function of the channels.

    Channels enter as samples, the inputs (known functions of time in the paper) by their amplitudes.
    """
    samples = np.where(drive, 0.0, reading)
    if np.any(np.abs(samples.imag) > 1e-9 * np.max(np.abs(samples), axis=-1, keepdims=True)):
        return None
    driven = np.einsum("...lic,...lc->...li", np.where(drive, reading, 0.0), y)
    real = np.broadcast_to(samples.real, (*driven.shape, reading.shape[-1]))
    return np.concatenate([real, driven.real[..., None], -driven.imag[..., None]], axis=-1)


def _harmonic(w: Complex) -> Real:
    """Coefficients of Re(w e^{jωt}) over (cos, sin)."""
    return np.stack([w.real, -w.imag], axis=-1)


def sums_with_harmonics(observed: Sampled, w: Complex) -> tuple[Real, Real]:
    """N and r of (G) over samples, with harmonic instruments of amplitudes w (..., lines, elements)."""
    model = observed.model
    if observed.moments is None or observed.coefficients is None:
        return gram(model, w, observed.a, observed.weight), gram_force(model, w, observed.f, observed.weight)
    return _sums(observed, _harmonic(w) @ observed.moments[..., -2:, :], observed.coefficients)


def sums_with_samples(observed: Sampled) -> tuple[Real, Real]:
    """N and r of (G) over samples with w = a: the paper's least squares (eq. 17, Q = I)."""
    if observed.moments is None:
        raise UsageError(
            "ls is least squares on samples, as in the paper; these data are amplitudes",
            cure="give the time records, or use hls (least squares on amplitudes)",
        )
    if observed.coefficients is None:
        raise DataError(
            "ls needs the velocity of every coordinate, and some velocity is not measured",
            cure="add the velocity channels, or use hls, which works on amplitudes",
        )
    moments, coefficients = observed.moments, observed.coefficients
    return _sums(observed, coefficients @ moments, coefficients)


def least_squares_sums(observed: Sampled) -> tuple[Real, Real]:
    """N (K, elements, elements) and r (K, elements) of least squares: over samples where there are moments."""
    if observed.moments is not None and observed.coefficients is not None:
        return sums_with_samples(observed)
    return sums_with_harmonics(observed, observed.a)


def _sums(observed: Sampled, left: Real, coefficients: Real) -> tuple[Real, Real]:
    """N, r from `left` = coefficients of the instruments times the moments, (..., lines, elements, channels + 2)."""
    model = observed.model
    products = np.sum(left @ np.swapaxes(coefficients, -1, -2), axis=-3)
    N = (model.B @ model.B.T) * products
    force = _harmonic(observed.f @ (model.B @ model.S).T)
    r = np.sum(left[..., -2:] * force, axis=(-1, -3))
    return N, r


@dataclass(frozen=True)
class LeastSquares(Method):
    """The paper's least squares on samples (eq. 17, Q = I).  Biased: the noise's power enters the normal matrix."""

    name: ClassVar[str] = "ls"
    traits: ClassVar[Traits] = Traits(moments=True, nonlinear=True)

    def solve(self, data: Prepared) -> Solution:
        """θ in closed form; the covariance is the estimator's own spread, not its distance from the truth.

        Of nonlinear rigs from the measured harmonics, as Yasuda and Watanabe (1989) do.  Raises UsageError or DataError
        where there are no samples, or no channels of the motions that they need.
        """
        if len(data.model.nonlinear):
            equations = harmonic_equations(data)
            theta = equations.least_squares()
            return closed_form(theta, equations.spread(theta, instruments=False))
        observed = sampled(data)
        N, r = sums_with_samples(observed)
        theta = solve_sums(observed, N, r)
        return closed_form(
            theta, sandwich(observed, N, observed.a, theta, noisy_instruments=True, bins=observed.weight)
        )


@dataclass(frozen=True)
class HarmonicLeastSquares(Method):
    """Least squares on amplitudes, unweighted: a bias smaller than that of samples by about 2/N."""

    name: ClassVar[str] = "hls"
    traits: ClassVar[Traits] = Traits(nonlinear=True)

    def solve(self, data: Prepared) -> Solution:
        """θ in closed form from the combined amplitudes; of nonlinear rigs by Yasuda and Watanabe's way.

        Raises DataError or UsageError if the channels do not show what this needs.
        """
        if len(data.model.nonlinear):
            return harmonic_least_squares(data)
        observed = combined(data)
        N, r = least_squares_sums(observed)
        theta = solve_sums(observed, N, r)
        bins = np.ones_like(observed.weight)
        return closed_form(theta, sandwich(observed, N, observed.a, theta, noisy_instruments=True, bins=bins))


@dataclass(frozen=True)
class WeightedLeastSquares(Method):
    """Least squares on amplitudes, weighted by Ω = Cov(e)⁻¹ at the unweighted estimate."""

    name: ClassVar[str] = "wls"
    traits: ClassVar[Traits] = Traits(weighted=True, nonlinear=True)

    def solve(self, data: Prepared) -> Solution:
        """θ in closed form, given the weight; of nonlinear rigs from the measured harmonics.

        Raises DataError or UsageError if the channels do not show what this needs.
        """
        model = data.model
        if len(model.nonlinear):
            return closed_form(*harmonic_equations(data).weighted())
        observed = combined(data)
        N, r = least_squares_sums(observed)
        Se = equation_covariance(model, model.parameters(solve_sums(observed, N, r)), data.seen_states)
        Phi, h = regressors(model, observed.a), known_side(model, observed.a, observed.f)
        bread, right = with_priors(model, *normal_sums(Se, Phi, h))
        theta = solve_scaled(bread, right)
        # One round of refinement by the residual: near a resonance Ω spans many powers of ten.
        left = h - np.einsum("klnu,ku->kln", Phi, theta)
        prior = model.prior_precision
        theta = theta + solve_scaled(
            bread, normal_sums(Se, Phi, left)[1] + prior * (model.prior_mean - theta)
        )
        Q = equation_map(observed, model.parameters(theta))
        e = np.einsum("...nc,...c->...n", Q, observed.y)
        Gamma = noise_map(observed)
        A, Oe, OQ = solve_small(Se, Phi), solve_small(Se, e[..., None])[..., 0], solve_small(Se, Q)
        bins = np.ones_like(observed.weight)
        meat = score_covariance(A, Q, Oe, Gamma, OQ, observed.V, 2.0 * bins, bins)
        half = scaled_inverse(bread)
        return closed_form(theta, half @ (meat + np.diag(model.prior_precision)) @ half)


def normal_sums(Se: Complex, Phi: Complex, h: Complex) -> tuple[Real, Real]:
    """2 Re Φᴴ Ω Φ and 2 Re Φᴴ Ω h, summed over lines.

    Se (..., lines, n, n), Phi (..., lines, n, m), h (..., lines, n); the sums are (..., m, m) and (..., m).
    """
    both = np.concatenate([Phi, h[..., None]], axis=-1)
    _, products = weighted_normal(both, Se, both)
    return products[..., :-1, :-1], products[..., :-1, -1]


def with_priors(model: Model, N: Real, right: Real, precision: Real | None = None) -> tuple[Real, Real]:
    """The sums with one more row for each prior, of its own `precision` or another one (..., m).

    N (..., m, m), right (..., m).
    """
    precision = model.prior_precision if precision is None else precision
    return N + precision[..., None] * np.eye(len(model.unknowns)), right + precision * model.prior_mean


def combined(data: Prepared) -> Sampled:
    """Unit forces from the amplitudes z = (X, U, f) that all channels together give; z takes the channels' place."""
    model, spectrum, s = data.model, data.spectrum, data.seen_states
    size = s.z.shape[-1]
    span = np.zeros((len(model.elements), size))
    span[:, : s.n + s.r] = np.concatenate([model.B, model.D], axis=1)
    reading = model.factors(spectrum.omega, spectrum.experiment)[None, :, :, None] * span
    force = np.broadcast_to(
        np.eye(size, dtype=complex)[s.n + s.r :], (1, spectrum.lines, size - s.n - s.r, size)
    )
    a = unit_forces(model, spectrum.omega, s.X, s.U, s.experiment)
    weight = spectrum.samples / 2
    return Sampled(
        model,
        spectrum.omega,
        s.covariance,
        s.z,
        a,
        reading,
        s.U,
        s.f,
        force,
        weight,
        None,
        None,
        s.experiment,
    )


def solve_sums(observed: Sampled, N: Real, r: Real, theta: Real | None = None) -> Real:
    """θ from N and r of (G), priors as further rows scaled by the equation error's variance at `theta`.

    Without `theta` the parameters with a prior are held at it first, to learn that variance.
    """
    model = observed.model
    T = model.T
    matrix, right = T.T @ N @ T, (r - N @ model.p0) @ T
    if not np.any(model.prior_precision):
        return solve_scaled(matrix, right)
    if theta is None:
        diagonal = np.abs(np.diagonal(matrix, axis1=-2, axis2=-1))
        chosen = model.prior_precision > 0
        held = 1e8 * np.max(diagonal[..., chosen] / model.prior_precision[chosen], axis=-1)
        theta = _solve_prior(model, matrix, right, held)
    return _solve_prior(model, matrix, right, equation_variance(observed, theta))


def _solve_prior(model: Model, matrix: Real, right: Real, variance: Real) -> Real:
    return solve_scaled(*with_priors(model, matrix / variance[..., None, None], right / variance[..., None]))


def equation_map(observed: Sampled, p: Real) -> Complex:
    """Q with e = Q y, (K, lines, n, channels): Bᵀ diag(p) reading − S force."""
    model = observed.model
    forces = (model.B.T * p[:, None, None, :]) @ observed.reading
    return forces - model.S @ observed.force if observed.force.shape[-2] else forces


def equation_variance(observed: Sampled, theta: Real) -> Real:
    """Mean variance of the equation error per sample, (K,), N²: what one row of the unweighted sums is worth."""
    Q = equation_map(observed, observed.model.parameters(theta))
    power = np.einsum("...lnc,...lcd,...lnd->...l", Q, observed.V, np.conj(Q)).real
    variance: Real = np.mean(power * observed.weight, axis=-1) / (2 * observed.model.n)
    return np.where(variance > 0, variance, 1.0)


def sandwich(
    observed: Sampled,
    N: Real,
    w: Complex,
    theta: Real,
    *,
    noisy_instruments: bool = False,
    bins: Real | None = None,
) -> Real:
    """Covariance N⁻¹ (Σ cov of the scores) N⁻ᵀ of an unweighted estimate; (K, unknowns, unknowns).  THEORY §5.

    With noisy instruments (w = a) the score is quadratic in the noise: what it adds is the covariance of quadratic
    forms of Gaussian noise, once for each independent `bin` of frequency in which the noise enters (samples / 2 for
    sums over samples, 1 for amplitudes).
    """
    model = observed.model
    Q = equation_map(observed, model.parameters(theta))
    Gamma = noise_map(observed) if noisy_instruments else None
    e = np.einsum("...nc,...c->...n", Q, observed.y)
    one = np.ones_like(observed.weight) if bins is None else bins
    meat = score_covariance(regressors(model, w), Q, e, Gamma, Q, observed.V, observed.weight, one)
    T = model.T
    bread = T.T @ N @ T
    if np.any(model.prior_precision):
        variance = equation_variance(observed, theta)[..., None, None]
        bread = bread / variance + np.diag(model.prior_precision)
        meat = meat / variance**2 + np.diag(model.prior_precision)
    half = scaled_inverse(bread)
    return half @ meat @ np.swapaxes(half, -1, -2)


def noise_map(observed: Sampled) -> Complex:
    """Γ with ΔΦ = Γ Δy, (K or 1, lines, n, unknowns, channels)."""
    return np.einsum(
        "in,iu,...lic->...lnuc", observed.model.B, observed.model.T, observed.reading, optimize=True
    )


def score_covariance(
    A: Complex,
    Q: Complex,
    e: Complex,
    Gamma: Complex | None,
    weighted_Q: Complex,
    V: Complex,
    weight: Real,
    bins: Real,
) -> Real:
    """Covariance of Σ_l weight_l Re(Aᴴ e), where e = Q y, ΔA = Γ Δy and E[Δy Δyᴴ] = V; (K, unknowns, unknowns)."""
    g = hermitian(A) @ Q
    if Gamma is not None:
        g = g + np.einsum("...ln,...lnuc->...luc", np.conj(e), Gamma)
    linear: Real = 0.5 * np.sum((weight**2)[:, None, None] * (g @ V @ hermitian(g)).real, axis=-3)
    if Gamma is None:
        return linear
    # ½ tr(F_u V F_v V) + ½ tr(F_u V F_vᴴ V) with F_u = Γ_uᴴ Q, in products of n rows rather than of channels.
    scale = (weight**2 * bins)[:, None, None]
    by_unknown = np.moveaxis(Gamma, -2, -4)  # (..., unknowns, lines, n, channels)
    spread = by_unknown @ V[..., None, :, :, :]
    crossed = spread @ hermitian(weighted_Q)[..., None, :, :, :]
    power = weighted_Q @ V @ hermitian(weighted_Q)
    first = _flat(crossed * scale) @ np.swapaxes(_flat(np.swapaxes(crossed, -1, -2)), -1, -2)
    second = _flat(power[..., None, :, :, :] @ spread * scale) @ hermitian(_flat(by_unknown))
    return linear + 0.5 * (first + second).real


def _flat(stack: Complex) -> Complex:
    """(..., unknowns, lines, n, k) with the last three axes in one."""
    return stack.reshape(*stack.shape[:-3], int(np.prod(stack.shape[-3:])))


def starts(model: Model, data: States) -> tuple[Real, Real, Real]:
    """Starts for the iterative estimators, each (K, unknowns), the best first.

    Least squares on amplitudes; weighted by Ω at that, twice; and weighted with the noise's own moments taken out.
    Weighting comes first: far from the truth, taking the noise out leaves a matrix that is all but singular.
    Parameters with a prior are held there in the first pass, which has no scale to weigh them by.
    """
    equation_sums = compiled_equation(model, data)
    if equation_sums is not None:
        clean, weighted, plain = equation_sums.starts(threads())
        return clean, weighted, plain
    fixed = without_priors(model)
    free = model.prior_precision == 0
    plain = np.broadcast_to(model.prior_mean, (len(data.z), len(model.unknowns))).copy()
    Phi, h = equation(model, data)
    if np.any(free):
        even = np.broadcast_to(np.eye(model.n, dtype=complex), (len(data.omega), model.n, model.n))
        sides = (Phi, h) if fixed is model else equation(fixed, data)
        plain[:, free] = solve_scaled(*normal_sums(even, *sides))
    weighted = plain
    for _ in range(2):
        Se = equation_covariance(model, model.parameters(weighted), data)
        N, right = with_priors(model, *normal_sums(Se, Phi, h))
        weighted = where_finite(solve_scaled(N, right), weighted)
    Se = equation_covariance(model, model.parameters(weighted), data)
    clean, _ = without_noise(model, data, Se, *normal_sums(Se, Phi, h))
    return where_finite(clean, weighted), weighted, plain


def compensated(model: Model, data: States) -> Real:
    """The best of the `starts`, (K, unknowns)."""
    return starts(model, data)[0]


def where_finite(values: Real, otherwise: Real) -> Real:
    """Repeats of `values` that are finite throughout, else those of `otherwise`.  Both (K, ...)."""
    return np.where(np.all(np.isfinite(values), axis=-1, keepdims=True), values, otherwise)


def equation(model: Model, data: States) -> tuple[Complex, Complex]:
    """Φ and h of the measured amplitudes: e = Φ θ − h; (K, lines, n, unknowns) and (K, lines, n)."""
    a = unit_forces(model, data.omega, data.X, data.U, data.experiment)
    return regressors(model, a), known_side(model, a, data.f)


def without_noise(
    model: Model, data: States, Se: Complex, N: Real, right: Real, precision: Real | None = None
) -> tuple[Real, Bools]:
    """Weighted least squares less what the noise of the regressors adds to its sums; (K, unknowns).

    E[Φᴴ Ω Φ] of the measured regressors is that of the true ones plus a term in Σ, which is known.  Where taking it
    out leaves no positive definite matrix, it is left in, and the second value is False, (K,).  N and `right` are the
    sums with the weight Se⁻¹, without the priors, which have their own `precision` or another one (K, unknowns).
    """
    noise, noise_right = noise_sums(model, data, Se)
    raw, right = with_priors(model, N, right, precision)
    clean = raw - noise
    scale = np.sqrt(np.maximum(np.abs(np.diagonal(raw, axis1=-2, axis2=-1)), 1e-300))
    outer = scale[..., :, None] * scale[..., None, :]
    smallest, of_raw = (np.linalg.eigvalsh(np.nan_to_num(each / outer))[..., 0] for each in (clean, raw))
    usable = smallest > 0.05 * of_raw
    matrix = np.where(usable[..., None, None], clean, raw)
    theta = solve_scaled(matrix, right - np.where(usable[..., None], noise_right, 0.0))
    return theta, usable


def noise_sums(model: Model, data: States, Se: Complex) -> tuple[Real, Real]:
    """What noise adds to 2 Re ΦᴴΩΦ and to 2 Re ΦᴴΩh, by (G): (B Ω Bᵀ) ∘ E[ā aᵀ], (K, unknowns, unknowns or none)."""
    q, E = data.n + data.r, len(model.elements)
    span, factors = np.concatenate([model.B, model.D], axis=1), model.factors(data.omega, data.experiment)
    pairs, forces = np.zeros((E, E)), np.zeros(E)
    at_once = max(1, CHUNK // max(1, len(Se) * E**2))
    for first in range(0, len(factors), at_once):
        few = slice(first, first + at_once)
        reading = factors[few, :, None] * span
        some = Se[..., few, :, :]
        weight = solve_small(some, np.broadcast_to(np.eye(model.n, dtype=complex), some.shape))
        B = np.broadcast_to(model.B, (*some.shape[:-2], *model.B.shape))
        meeting = product(B, weight)
        spread = product(reading, data.covariance[..., few, :q, :])
        crossed = product(spread[..., :q], hermitian(reading))
        pairs = pairs + 2 * np.sum((product(B, np.swapaxes(meeting, -1, -2)) * crossed).real, axis=-3)
        forces = forces + 2 * np.sum(((meeting @ model.S) * np.conj(spread[..., q:])).real, axis=(-1, -3))
    return model.T.T @ pairs @ model.T, (forces - pairs @ model.p0) @ model.T
