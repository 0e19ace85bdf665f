"""What is done to the data before any method sees them, once and in one place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Complex, Real, is_diagonal
from dashpot.data.local_noise import SMOOTH
from dashpot.data.spectrum import FITTED, Spectrum, flattened
from dashpot.errors import DataError
from dashpot.estimate.preparation.state_reconstruction import States, require_seen, states_if_seen
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, observation_model

# What estimates are worth: information, bound, and what estimating the noise costs (THEORY §5).


@dataclass(frozen=True)
class NoiseQuality:
    """How well the covariance of the noise is known, for each repeat and line, (K or 1, lines).

    inflation   κ with E[Ŵ V Ŵ] = κ E[Ŵ] for Ŵ = V̂⁻¹: the factor by which variances must widen
    shrink      E[V̂⁻¹] = V⁻¹ / shrink: the factor by which χ² is too large
    dof         residual degrees of freedom, (lines,); inf where the covariance is given
    """

    inflation: Real
    shrink: Real
    dof: Real


def noise_quality(spectrum: Spectrum, correlated: Bools) -> NoiseQuality:
    """Moments of the inverse of an estimated covariance; `correlated` (K or 1,) says whether all of it was used.

    White residuals give a real Wishart matrix with ν degrees of freedom, E[S⁻¹] = 1/(ν−q−1) and
    E[S⁻²] = (ν−1) / ((ν−q)(ν−q−1)(ν−q−3)); blocks and periods give a complex one with ν/2 (Muirhead 1982, §3.2; Maiwald
    and Kraus 2000).  q is the number of noisy channels, 1 where they are taken as uncorrelated.
    """
    nu = spectrum.dof
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real
    variance = np.max(variance.reshape(-1, *variance.shape[-2:]), axis=0)
    q = np.where(correlated[:, None], np.sum(variance > 0, axis=-1), 1)
    blocks = _of_complex(spectrum)
    K = nu / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        white_inflation = nu * (nu - 1) / ((nu - q) * (nu - q - 3))
        white_shrink = (nu - q - 1) / nu
        block_inflation = K**2 / ((K - q) ** 2 - 1)
        block_shrink = (K - q) / K
    given = ~np.isfinite(nu)
    enough = given | (np.where(blocks, K - q - 1, nu - q - 3) > 0)
    inflation = np.where(enough, np.where(blocks, block_inflation, white_inflation), np.inf)
    shrink = np.where(enough, np.where(blocks, block_shrink, white_shrink), np.nan)
    return NoiseQuality(np.where(given, 1.0, inflation), np.where(given, 1.0, shrink), nu)


def _of_complex(spectrum: Spectrum) -> Bools:
    """Lines whose covariance comes from complex amplitudes, not from real residuals of samples; (lines,)."""
    return np.array([kind in ("blocks", "periods", "rest", "residual", SMOOTH) for kind in spectrum.noise])


def channels_correlate(spectrum: Spectrum, level: float = 0.01) -> Bools:
    """Whether the noise of the channels is correlated, (...,): likelihood ratio test over all lines with residuals.

    −(ν − (2q+5)/6) ln |R| is χ² with q(q−1)/2 degrees of freedom for each line (Bartlett 1950).  Given covariances
    are taken at their word: True.
    """
    V = spectrum.covariance
    if not np.isfinite(spectrum.dof).all():
        return np.ones(V.shape[:-3], dtype=bool)
    if is_diagonal(V):
        return np.zeros(V.shape[:-3], dtype=bool)
    from scipy.special import chdtri

    variance = np.diagonal(V, axis1=-2, axis2=-1).real
    noisy = np.all(variance.reshape(-1, variance.shape[-1]) > 0, axis=0)
    q = int(np.sum(noisy))
    if q < 2:
        return np.zeros(V.shape[:-3], dtype=bool)
    V = V[..., noisy, :][..., noisy]
    sd = np.sqrt(variance[..., noisy])
    R = V / (sd[..., :, None] * sd[..., None, :])
    blocks = _of_complex(spectrum)
    _, logarithm = np.linalg.slogdet(R)
    per_line = np.where(blocks, q * (q - 1.0), q * (q - 1) / 2)
    factor = np.where(blocks, spectrum.dof - (2 * q + 1) / 3, spectrum.dof - (2 * q + 5) / 6)
    # With fewer degrees of freedom than channels the matrix is singular: the diagonal is all there is.
    possible = factor > q
    statistic = -np.sum(
        np.where(possible, factor * np.where(np.isfinite(logarithm), logarithm, 0.0), 0.0), axis=-1
    )
    count = float(np.sum(np.where(possible, per_line, 0.0)))
    return np.asarray(statistic > (chdtri(count, level) if count else np.inf))


def interval_dof(lines_share: Real, dof: Real, exact: Real) -> Real:
    """Satterthwaite's degrees of freedom of variances that are sums over lines and a part that is known exactly.

    lines_share: each line's part of the variance, (..., lines, unknowns); dof: (lines,); exact and result
    (..., unknowns).
    """
    total = np.sum(lines_share, axis=-2) + exact
    with np.errstate(invalid="ignore", divide="ignore"):
        doubt = np.sum(lines_share**2 / dof[:, None], axis=-2)
        result: Real = np.where(doubt > 0, total**2 / doubt, np.inf)
    return result


# How the channels weigh: their covariance as it is known, or equal relative noise where nothing is known.


def working_covariance(view: ObservationModel, spectrum: Spectrum) -> Complex:
    """Covariance of the channels to weigh with, (..., lines, channels, channels).

    As known; unknown noise leaves the inputs exact and gives each other channel the same relative noise: what that
    lacks is one common factor, which the residuals supply.
    """
    if not np.isnan(spectrum.covariance).any():
        return spectrum.covariance
    present = spectrum.present
    X = np.where(present, spectrum.amplitudes, 0.0)
    size = np.sqrt(np.sum(np.abs(X) ** 2, axis=-2) / np.maximum(np.sum(present, axis=0), 1))
    variance = np.where(view.inputs_alone, 0.0, size**2)[..., None, :] * np.ones((spectrum.lines, 1))
    return (variance[..., :, None] * np.eye(len(spectrum.channels))).astype(np.complex128)


@dataclass(frozen=True)
class Prepared:
    """Data as every method gets them: one leading axis of K repeats on the amplitudes.

    view         what the channels show of the rig at the lines
    covariance   the channels' V, (K or 1, lines, channels, channels)
    states       the channels combined to coordinates and inputs; None where some of these are not seen
    noise_known  whether V is the noise's own; else it is so up to one factor, which the residuals supply
    correlated   (K or 1,) whether the channels' noise is correlated
    """

    view: ObservationModel
    spectrum: Spectrum
    covariance: Complex
    states: States | None
    noise_known: bool
    correlated: Bools

    @property
    def model(self) -> Model:
        """The rig."""
        return self.view.model

    @cached_property
    def kept(self) -> dict[str, Any]:
        """What later stages have made of these very data, by name."""
        return {}

    def of_rig(self, model: Model) -> Prepared:
        """The same data of a rig with the same coordinates and inputs."""
        return replace(self, view=observation_model(model, self.spectrum.channels, self.spectrum.omega))

    def without_priors(self) -> Prepared:
        """With the uncertain known values of rig and channels taken as exact."""
        model, spectrum = without_priors(self.model), with_exact_calibrations(self.spectrum)
        return self.of_rig(model) if spectrum is self.spectrum else prepare(model, spectrum)

    def only(self, repeat: int) -> Prepared:
        """One of the repeats."""
        V = self.covariance if len(self.covariance) == 1 else self.covariance[repeat : repeat + 1]
        spectrum = replace(
            self.spectrum, amplitudes=self.spectrum.amplitudes[repeat : repeat + 1], moments=None
        )
        states = None if self.states is None else self.states.rows(np.array([repeat]))
        return replace(self, spectrum=spectrum, covariance=V, states=states)

    def scaled(self, factor: np.ndarray) -> Prepared:
        """With the noise's variances times `factor` (K,)."""
        V = self.covariance * factor[:, None, None, None]
        return replace(self, covariance=V, states=states_if_seen(self.view, self.spectrum, V))

    @property
    def seen_states(self) -> States:
        """`states`.  Raises DataError, which names what is not seen, where there are none."""
        if self.states is None:
            require_seen(self.view, self.spectrum)
            raise DataError("the channels do not show every coordinate and input", cure="use the method ml")
        return self.states


def prepare(model: Model, spectrum: Spectrum, *, moments: bool = False, states: bool = True) -> Prepared:
    """Weigh the channels, judge what is known of their noise and combine them; batch axes become K repeats.

    Second moments of the samples are kept only where `moments`; without `states` the channels are not combined.
    Raises DataError where exact channels contradict each other, or measure what the model has not.
    """
    flat = flattened(spectrum)
    if not moments and flat.moments is not None:
        flat = replace(flat, moments=None)
    known = flat.noise_known
    if not known and FITTED not in flat.noise:
        nothing = np.full_like(flat.covariance, np.nan)
        flat = replace(flat, covariance=nothing, noise=("unknown",) * flat.lines)
    view = observation_model(model, flat.channels, flat.omega)
    V = flat.covariance if known else working_covariance(view, flat)
    V = V if V.ndim == 4 else V[None]
    correlated = np.atleast_1d(channels_correlate(flat)) if known else np.ones(len(V), dtype=bool)
    if not correlated.all() and not is_diagonal(V):
        V = np.where(correlated[:, None, None, None], V, V * np.eye(V.shape[-1]))
    return Prepared(view, flat, V, states_if_seen(view, flat, V) if states else None, known, correlated)


def without_priors(model: Model) -> Model:
    """The model with its uncertain known values taken as exact."""
    if not np.any(model.prior_precision):
        return model
    return replace(model, elements=tuple(replace(element, sd=None) for element in model.elements))


def with_exact_calibrations(spectrum: Spectrum) -> Spectrum:
    """The amplitudes with uncertain known gains and delays taken as exact, and so taken out."""
    channels, kappa = [], np.ones((spectrum.lines, len(spectrum.channels)), dtype=np.complex128)
    for c, channel in enumerate(spectrum.channels):
        gain, delay = channel.unknown_gain, channel.unknown_delay
        if gain is not None and gain.sd is not None and gain.prior is not None:
            channel = replace(channel, gain=gain.prior, same_gain_as=None, gain_prior=None)
            kappa[:, c] *= gain.prior
        if delay is not None and delay.sd is not None and delay.prior is not None:
            channel = replace(channel, delay=delay.prior, delay_prior=None)
            kappa[:, c] *= np.exp(-1j * spectrum.omega * delay.prior)
        channels.append(channel)
    if tuple(channels) == spectrum.channels:
        return spectrum
    V = spectrum.covariance / (kappa[:, :, None] * kappa.conj()[:, None, :])
    amplitudes = spectrum.amplitudes / kappa
    return replace(spectrum, channels=tuple(channels), amplitudes=amplitudes, covariance=V, moments=None)
