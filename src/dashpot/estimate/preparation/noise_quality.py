"""What estimates are worth: information, bound, and what estimating the noise costs (THEORY §5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Complex, Real, is_diagonal
from dashpot.data.local_noise import SMOOTH
from dashpot.data.spectrum import Spectrum


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
    correlate: Bools = np.asarray(statistic > (chdtri(count, level) if count else np.inf))
    return correlate


def without_correlation(covariance: Complex) -> Complex:
    """The same variances, off-diagonal entries 0.  (..., channels, channels)."""
    if is_diagonal(covariance):
        return covariance
    diagonal: Complex = covariance * np.eye(covariance.shape[-1])
    return diagonal


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
