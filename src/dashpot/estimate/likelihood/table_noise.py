"""The noise of amplitudes for which none is given, from what the model leaves of them (THEORY §11).

The variance of a channel is a constant and a share of its motion, a² + b²|y|², found with the parameters by restricted
maximum likelihood.  Each step of `sizes_of_parts` lowers the deviance where the parameters are kept; many at once are
tried first.  Intervals pay for weights that were found from few amplitudes as Kenward and Roger say (Biometrics 53,
1997).  Inputs that a channel shows are exact: an error of theirs is one of all outputs, in proportion to the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.data.noise import sizes_of_parts
from dashpot.data.spectrum import FITTED, Spectrum, flattened, in_chunks
from dashpot.errors import DashpotError
from dashpot.estimate.likelihood.descent import Likelihood
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.measured import Measured
from dashpot.estimate.likelihood.objective import measured, predict
from dashpot.estimate.likelihood.record_noise import with_record_noise
from dashpot.estimate.method import Method, Solution
from dashpot.estimate.preparation import Prepared, prepare, with_exact_calibrations, without_priors
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel
from dashpot.notices import Notice
from dashpot.numerics.small_systems import scaled_inverse


def with_table_noise(model: Model, spectrum: Spectrum, method: Method) -> Spectrum:
    """The amplitudes with the noise that their residuals show.

    As they are where noise is known, where the method does not weigh by it, and where no fit tells it.
    """
    traits = method.traits
    if spectrum.noise_known or FITTED in spectrum.noise or spectrum.records or len(model.nonlinear):
        return spectrum
    if not (traits.weighted or traits.maximum_likelihood):
        return spectrum
    if spectrum.lines * len(spectrum.channels) * (len(model.unknowns) + 1) > 2_000_000:  # slopes at once
        return spectrum
    try:
        # Priors weigh only against noise that is known.
        exact, flat = without_priors(model), flattened(with_exact_calibrations(spectrum))
        each = [_of_repeat(exact, repeat, method) for repeat in in_chunks(flat, 1)]
    except (DashpotError, np.linalg.LinAlgError):  # `identify` says what is wrong
        return spectrum
    fitted = [V for V in each if V is not None]
    if len(fitted) < len(each):
        return spectrum
    V = np.concatenate(fitted)
    text = "no noise given: it is estimated from the residuals, per channel, as a function of frequency"
    return replace(
        spectrum,
        covariance=V.reshape(*spectrum.batch, *V.shape[1:]),
        noise=(FITTED,) * spectrum.lines,
        notes=(*spectrum.notes, Notice("noise_fitted", text)),
    )


def doubts_of_weights(data: Prepared, solution: Solution) -> tuple[Real, Real]:
    """What the covariance of each repeat's parameters grows by, (K, M, M), as their weights were found from residuals,
    and the degrees of freedom of each variance, (K, M): the adjustment of Kenward and Roger, and Satterthwaite's."""
    signs = data.spectrum.signs(solution.signs, len(solution.theta))
    each = []
    for k in range(len(solution.theta)):
        one = data.only(k)
        psi = solution.theta[k : k + 1]
        sign = signs[k : k + 1]
        exact = measured(one)
        left = _Left.at(one.view, exact, psi, sign, even=True)
        variance = np.diagonal(one.covariance[0], axis1=-2, axis2=-1).real[left.cells]
        if not len(variance):
            each.append((np.zeros((psi.shape[-1],) * 2), np.ones(psi.shape[-1])))
        else:
            relative = variance / left.parts[:, 0]
            if np.ptp(relative) > 1e-9 * np.max(relative):  # more than rounding
                left = _Left.at(one.view, exact, psi, sign)
            fit = left.weighed(variance)
            of_parts = scaled_inverse((left.parts * (fit.unused / variance**2)[:, None]).T @ left.parts)
            J, parts = left.slopes / np.sqrt(variance)[:, None], left.parts / variance[:, None]
            lost = 2 * np.einsum("im,ij,in->jmn", J.conj(), parts, J).real
            both = np.einsum("ij,jk,ik->i", parts, of_parts, parts)
            twice = 2 * (J.conj().T @ (both[:, None] * J)).real
            once = np.einsum("jmn,no,kop,jk->mp", lost, fit.spread, lost, of_parts, optimize=True)
            slope = np.einsum("mn,jno,om->mj", fit.spread, lost, fit.spread)
            scatter = np.einsum("mj,jk,mk->m", slope, of_parts, slope)
            size = np.diagonal(fit.spread)
            each.append(
                (
                    2 * fit.spread @ (twice - once) @ fit.spread,
                    2 * size**2 / np.maximum(scatter, 1e-300 * size**2),
                )
            )
    return np.stack([grown for grown, _ in each]), np.stack([freedom for _, freedom in each])


@dataclass(frozen=True)
class _Weighed:
    """Deviance of the noise, covariance (M, M) of ψ and 1 − leverage of each amplitude, (rows,), at given variances."""

    deviance: float
    spread: Real
    unused: Real


@dataclass(frozen=True)
class _Left:
    """What a fit leaves of the amplitudes that were measured and are no inputs, at cells (rows,) of the table.

    power (rows,) of the residuals, slopes (rows, M), parts (rows, parts): the unit of each part of the noise;
    precision (M,) of the priors.
    """

    cells: tuple[Ints, Ints]
    power: Real
    slopes: Complex
    parts: Real
    precision: Real

    @staticmethod
    def at(view: ObservationModel, data: Measured, psi: Real, sign: Real, *, even: bool = False) -> _Left:
        """What is left over at ψ (1, M); of noise that is `even` there is but one part."""
        prediction = predict(view, data, psi, sign)
        weight = np.diagonal(data.W[0], axis1=-2, axis2=-1).real
        line, channel = np.nonzero((weight > 0) & ~view.inputs_alone)
        residual, slopes = prediction.r[0, line, channel], prediction.J[0, line, channel]
        measured_motion = data.y[0, line, channel]
        size = np.bincount(channel, np.abs(measured_motion) ** 2) / np.maximum(np.bincount(channel), 1)
        parts = np.stack([size[channel], np.abs(measured_motion - residual) ** 2], axis=1)
        channels = np.unique(channel)
        if even:
            parts = parts[:, :1]
        elif 2 * len(line) - psi.shape[-1] >= 10 * len(channels):  # degrees of freedom, five for each part
            own = channel[:, None] == channels
            parts = (parts[:, :, None] * own[:, None, :]).reshape(len(line), -1)
        return _Left((line, channel), np.abs(residual) ** 2, slopes, parts, view.prior_precision)

    def weighed(self, variance: Real) -> _Weighed:
        """With amplitudes of these variances, (rows,)."""
        J = self.slopes / np.sqrt(variance)[:, None]
        information = 2 * (J.conj().T @ J).real + np.diag(self.precision)
        spread = scaled_inverse(information)
        leverage = np.einsum("im,mn,in->i", J.conj(), spread, J).real
        deviance = 2 * np.sum(np.log(variance) + self.power / variance) + np.linalg.slogdet(information)[1]
        return _Weighed(float(deviance), spread, np.clip(1 - leverage, 0.0, 1.0))


def _of_repeat(model: Model, spectrum: Spectrum, method: Method) -> Complex | None:
    """Covariance of the amplitudes of one repeat, (1, lines, channels, channels), even where its fit does not say more.

    None of tables too small, or where no exact channels show the inputs.
    """
    even = prepare(model, spectrum)
    solution = method.solve(even)
    if measured(even).q is None:
        return None
    search = method if isinstance(method, MaximumLikelihood) else MaximumLikelihood()
    sign = even.spectrum.signs(solution.signs)

    def fitted(V: Complex, psi: Real) -> tuple[Real, _Left]:
        likelihood = Likelihood.of(replace(even, covariance=V), search.effort)
        psi = likelihood.descend(psi, sign).x
        return psi, _Left.at(even.view, likelihood.exact, psi, sign)

    V = even.covariance
    psi, left = fitted(V, solution.theta)
    variance = np.diagonal(V[0], axis1=-2, axis2=-1).real[left.cells]
    freedom = 2 * len(variance) - psi.shape[-1]
    if freedom < 6:  # too few degrees of freedom for weights
        return None
    level = 2 * float(np.sum(left.power / variance)) / freedom
    if not np.all(solution.converged) or not level > 1e-18:  # of the mean square: exact data leave rounding
        return V
    sizes = level * np.repeat([1.0, 0.5], left.parts.shape[1] // 2)  # before the first step
    begun = _Fit(level * V, psi, left, sizes, left.weighed(level * variance))
    best = _descended(begun, fitted)
    if best is None:
        return None
    # Noise that is not even shows from 20 degrees of freedom on.
    if freedom >= 20 and begun.weighed.deviance - best.weighed.deviance < 2 * (len(sizes) - 1):  # Akaike
        return begun.V
    return best.V


@dataclass(frozen=True)
class _Fit:
    """A fit at ψ (1, M) with covariance V, and its residuals, weighed by parts of the noise of these sizes."""

    V: Complex
    psi: Real
    left: _Left
    sizes: Real
    weighed: _Weighed


def _descended(fit: _Fit, fitted: Callable[[Complex, Real], tuple[Real, _Left]]) -> _Fit | None:
    """The noise and the rig fitted in turns, until the deviance falls no more; None if it leads nowhere."""
    for turn in range(30):
        for steps in (200, 1):
            sizes = sizes_of_parts(fit.left.power, fit.left.parts, fit.weighed.unused, fit.sizes, steps)
            # The covariance with these variances, (rows,), of the amplitudes that are no inputs
            changed = np.array(fit.V)
            line, channel = fit.left.cells
            changed[0, line, channel, channel] = fit.left.parts @ sizes
            V = changed
            psi, left = fitted(V, fit.psi)
            if len(left.power) < len(fit.left.power):  # noise of no size: the rig is no better than none
                return None
            tried = _Fit(V, psi, left, sizes, left.weighed(left.parts @ sizes))
            gain = fit.weighed.deviance - tried.weighed.deviance
            if gain >= -0.01:  # a rise that rounding explains
                break
        if turn and not gain >= -0.01:
            return fit
        fit = tried
        if turn and gain < 0.05:
            return fit
    return fit


# The noise of data that do not tell it themselves, from what the model leaves of them.


def with_residual_noise(model: Model, spectrum: Spectrum, method: Method) -> tuple[Spectrum, Method]:
    """The spectrum with the noise of whole records, or of amplitudes given without any.

    The method begins at the fit whose residuals show it where that of records is.  Both are as they are where noise is
    known.  `identify` does it first; what judges a fit wants the same spectrum.
    """
    if spectrum.records:
        return with_record_noise(model, spectrum, method)
    return with_table_noise(model, spectrum, method), method
