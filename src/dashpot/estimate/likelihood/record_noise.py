"""The noise of whole records from what the model leaves over, iterated with the parameters (THEORY §8, c).

A record brings a first idea of each channel's noise, white, from where nothing moves.  After a fit the residual shows
more: its power smoothed over neighbouring lines, with what the fitted inputs have taken out of it put back (a step of
expectation and maximisation).  Where the lines do not differ by more than chance the noise is white, and all lines
tell its size.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from dashpot.arrays import Bools, Complex, Ints, Real, hermitian
from dashpot.data.conditioning.whole_record import FLOOR, HALF_WINDOW, smoothed
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood, bounds, local
from dashpot.estimate.likelihood.objective import measured, predict
from dashpot.estimate.method import Method
from dashpot.estimate.preparation.prepared import Prepared, flattened, in_chunks
from dashpot.estimate.preparation.state_reconstruction import states_if_seen
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, calibrated_transfer, observation_model
from dashpot.numerics.levenberg_marquardt import minimise

RESIDUAL = "residual"
ROUNDS = 12
SETTLED = 3e-3  # change of a standard deviation at which the rounds end
FIRST = 1e-2  # of a channel's size: its noise before the first fit, where nothing else is known
SMALLEST = 1e-7  # of a channel's size: below it noise is rounding
WHITE_LEVEL = 0.01  # of the test for coloured noise


def noise_is_sought(spectrum: Spectrum) -> bool:
    """Whether whole records are among the data whose noise the residuals have to tell."""
    return any(kind == FLOOR for kind in spectrum.noise)


def with_record_noise(model: Model, spectrum: Spectrum, method: Method | None = None) -> Spectrum:
    """The spectrum with the noise of its whole records as the residuals of a fit show it; itself where that is known.

    What `identify` does first; the spectrum it works with, for those who judge the fit.
    """
    if not noise_is_sought(spectrum):
        return spectrum
    chosen = method if isinstance(method, MaximumLikelihood) else MaximumLikelihood()
    repeats = [noise_from_residuals(model, repeat, chosen) for repeat in in_chunks(flattened(spectrum), 1)]
    V = np.concatenate([repeat.covariance for repeat in repeats])
    dof = np.min([repeat.dof for repeat in repeats], axis=0)
    covariance = V.reshape(*spectrum.batch, *V.shape[1:])
    return replace(spectrum, covariance=covariance, noise=repeats[0].noise, dof=dof)


def noise_from_residuals(model: Model, spectrum: Spectrum, method: MaximumLikelihood) -> Spectrum:
    """The spectrum of one repeat, (1, lines, channels), with the noise that its residuals show.

    The channels that measure inputs alone keep the noise they have (none, where it could not be told from motion).
    """
    view = observation_model(model, spectrum.channels, spectrum.omega)
    sought = np.array([kind == FLOOR for kind in spectrum.noise])
    outputs = ~view.inputs_alone
    V = _first(spectrum, sought, outputs)
    psi = sign = None
    used, dof = 0.0, np.array(spectrum.dof)
    for _ in range(ROUNDS):
        data = Prepared(model, spectrum, V, states_if_seen(model, spectrum, V), True, np.ones(1, dtype=bool))
        exact = measured(data, view)
        if psi is None or sign is None:
            solution = method.solve(data)
            psi, sign = solution.theta, _signs(spectrum, solution.signs)
        else:
            psi = _descended(view, exact, psi, sign, method)
        at = predict(view, exact, psi, sign)
        used = (at.columns + len(view.names)) / (2 * np.sum(sought) * max(np.sum(outputs), 1))
        power = np.abs(at.r[0]) ** 2 + _explained(view, exact.W[0], exact.q is None, psi, sign)
        variance, dof = _smoothed(spectrum, power / max(1 - used, 0.1), V[0], sought, outputs)
        before = np.diagonal(V[0], axis1=-2, axis2=-1).real[sought][:, outputs]
        after = variance[sought][:, outputs]
        V = _diagonal(
            np.where(sought[:, None] & outputs, variance, np.diagonal(V[0], axis1=-2, axis2=-1).real)
        )
        if np.all(np.abs(after - before) <= 2 * SETTLED * after):
            break
    kinds = tuple(RESIDUAL if s else kind for s, kind in zip(sought.tolist(), spectrum.noise, strict=True))
    return replace(spectrum, covariance=V, noise=kinds, dof=dof * (1 - used))


def _signs(spectrum: Spectrum, signs: object) -> Real:
    sign = np.ones((1, len(spectrum.channels)))
    for name, value in dict(signs).items():  # type: ignore[call-overload]
        sign[:, spectrum.index(name)] = value
    return sign


def _first(spectrum: Spectrum, sought: Bools, outputs: Bools) -> Complex:
    """Noise before the first fit, (1, lines, channels, channels): as the records show it where nothing moves."""
    variance = np.diagonal(spectrum.covariance[0], axis1=-2, axis2=-1).real
    size = np.nan_to_num(np.abs(spectrum.amplitudes[0])) ** 2
    unknown = sought[:, None] & outputs & ~(variance > 0)
    first = FIRST**2 * np.mean(size, axis=0)
    return _diagonal(np.where(unknown, first, variance))


def _diagonal(variance: Real) -> Complex:
    V: Complex = (variance[None, :, :, None] * np.eye(variance.shape[-1])).astype(np.complex128)
    return V


def _descended(
    view: ObservationModel, data: object, psi: Real, sign: Real, method: MaximumLikelihood
) -> Real:
    lower, upper = bounds(view, method.positive)
    found = minimise(
        lambda x, rows: local(view, data, x, sign[rows]),  # type: ignore[arg-type]
        psi, limit=method.max_iterations, tolerance=1e-3, lower=lower, upper=upper,
    )  # fmt: skip
    return found.x


def _explained(view: ObservationModel, W: Complex, fitted: bool, psi: Real, sign: Real) -> Real:
    """What fitting the inputs takes out of the residual's power: diagonal of G (Gᴴ W G)⁻¹ Gᴴ, (lines, channels)."""
    if not fitted:
        return np.zeros(W.shape[:2])
    G = calibrated_transfer(view, psi, sign).G[0]
    normal = hermitian(G) @ W @ G
    spread = np.linalg.pinv(normal, hermitian=True)
    taken: Real = np.einsum("lcq,lqp,lcp->lc", G, spread, np.conj(G)).real
    return taken


def _smoothed(
    spectrum: Spectrum, power: Real, before: Complex, sought: Bools, outputs: Bools
) -> tuple[Real, Real]:
    """Variances (lines, channels) from the power of residuals, and their degrees of freedom (lines,).

    Over 2·HALF_WINDOW + 1 lines of a record, over all lines of all records where they are white.
    """
    variance, dof = np.array(power), np.array(spectrum.dof)
    records = [
        np.flatnonzero((spectrum.stretch == number) & sought)
        for number, value in enumerate(spectrum.stretches)
        if isinstance(value, WholeRecord)
    ]
    records = [lines for lines in records if len(lines)]
    width = 2 * HALF_WINDOW + 1
    for lines in records:
        local_mean = smoothed(power[lines].astype(np.complex128), HALF_WINDOW).real
        mean = np.mean(power[lines], axis=0)
        white = np.array([_is_white(power[lines, c], width) for c in range(power.shape[1])])
        variance[lines] = np.where(white, mean, local_mean)
        dof[lines] = 2.0 * (len(lines) if np.all(white[outputs]) else min(width, len(lines)))
    size = np.mean(np.nan_to_num(np.abs(spectrum.amplitudes[0])) ** 2, axis=0)
    return np.maximum(variance, SMALLEST**2 * size), dof


def _is_white(power: Real, width: int) -> bool:
    """Whether the mean powers of groups of lines differ by no more than chance: Bartlett's test on exponentials."""
    groups = len(power) // width
    if groups < 2:
        return True
    edges: Ints = np.arange(groups) * width
    mean = np.add.reduceat(power[: groups * width], edges) / width
    with np.errstate(divide="ignore"):
        statistic = 2 * width * groups * (np.log(np.mean(mean)) - np.mean(np.log(mean)))
    correction = 1 + (groups + 1) / (6 * groups * width)
    return bool(statistic / correction < chdtri(groups - 1, WHITE_LEVEL))
