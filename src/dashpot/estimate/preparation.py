"""What is done to the data before any method sees them: they are weighed, and combined to amplitudes of coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import chdtri

from dashpot.arrays import Bools, Complex, Ints, Real, hermitian, is_diagonal
from dashpot.data.noise import SMOOTH
from dashpot.data.spectrum import FITTED, Spectrum, flattened
from dashpot.errors import DataError
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, observation_model
from dashpot.numerics.kernel import kernel_function

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
    and Kraus 2000).  q is the number of noisy channels, 1 where they are taken as uncorrelated, or as correlated as
    they are over all lines.
    """
    nu = spectrum.dof
    noisy, blocks = _noisy_channels(spectrum), _of_complex(spectrum)
    q = np.where(correlated[:, None] & ~told_by_all(nu, noisy, blocks), noisy, 1)
    given = ~np.isfinite(nu)
    with np.errstate(invalid="ignore", divide="ignore"):
        shrink = np.where(blocks, (nu / 2 - q) / (nu / 2), (nu - q - 1) / nu)
    inflation = _inflation(nu, q, blocks)
    shrink = np.where(np.isfinite(inflation), shrink, np.nan)
    return NoiseQuality(np.where(given, 1.0, inflation), np.where(given, 1.0, shrink), nu)


def _noisy_channels(spectrum: Spectrum) -> Ints:
    """How many channels have noise, (lines,)."""
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real
    return np.sum(np.max(variance.reshape(-1, *variance.shape[-2:]), axis=0) > 0, axis=-1)


def _inflation(nu: Real, q: Ints, blocks: Bools) -> Real:
    """κ of covariances of q channels from nu degrees of freedom; inf where their inverse has no such moment."""
    K = nu / 2
    with np.errstate(invalid="ignore", divide="ignore"):
        white = nu * (nu - 1) / ((nu - q) * (nu - q - 3))
        inflation = np.where(blocks, K**2 / ((K - q) ** 2 - 1), white)
    return np.where(np.where(blocks, K - q - 1, nu - q - 3) > 0, inflation, np.inf)


def told_by_all(nu: Real, q: Ints, blocks: Bools) -> Bools:
    """Lines whose nu degrees of freedom tell so little of the correlation of q channels that all lines tell it."""
    # Four times the variance is twice the width: beyond it a line's own correlations cost more than they tell.
    return np.isfinite(nu) & (_inflation(nu, q, blocks) > 4.0)


def correlated_as_all(spectrum: Spectrum, V: Complex) -> Complex:
    """Covariances (K or 1, lines, channels, channels) in which lines that tell too little take the correlation of all.

    Their variances stay their own.  Where all lines together tell no more, the channels count as uncorrelated.
    """
    nu, q, blocks = spectrum.dof, _noisy_channels(spectrum), _of_complex(spectrum)
    few = told_by_all(nu, q, blocks)
    if not np.any(few):
        return V
    sd = np.sqrt(np.diagonal(V, axis1=-2, axis2=-1).real)
    sizes = sd[..., :, None] * sd[..., None, :]
    R, weight = np.divide(V, sizes, out=np.zeros_like(V), where=sizes > 0), np.where(np.isfinite(nu), nu, 0.0)
    R = np.einsum("l,klcd->kcd", weight, R)[:, None] / np.sum(weight)
    if np.any(told_by_all(np.full(len(nu), np.sum(weight)), q, blocks)):
        R = R * np.eye(R.shape[-1])
    return np.where(few[:, None, None], R * sizes, V)


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
    states       the channels combined to coordinates and inputs; None if some of these are not seen
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
        return replace(
            self,
            view=observation_model(
                model, self.spectrum.channels, self.spectrum.omega, self.spectrum.experiment
            ),
        )

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
            raise DataError(
                "the channels do not measure every coordinate and input", cure="use the method ml"
            )
        return self.states


def prepare(model: Model, spectrum: Spectrum, *, moments: bool = False, states: bool = True) -> Prepared:
    """Weigh the channels, judge what is known of their noise and combine them; batch axes become K repeats.

    Second moments of the samples are kept only where `moments`; without `states` the channels are not combined.
    Raises DataError if exact channels contradict each other, or measure what the model has not.
    """
    flat = flattened(spectrum)
    if not moments and flat.moments is not None:
        flat = replace(flat, moments=None)
    known = flat.noise_known
    if not known and FITTED not in flat.noise:
        nothing = np.full_like(flat.covariance, np.nan)
        flat = replace(flat, covariance=nothing, noise=("unknown",) * flat.lines)
    view = observation_model(model, flat.channels, flat.omega, flat.experiment)
    V = flat.covariance if known else working_covariance(view, flat)
    V = V if V.ndim == 4 else V[None]
    correlated = np.atleast_1d(channels_correlate(flat)) if known else np.ones(len(V), dtype=bool)
    if not correlated.all() and not is_diagonal(V):
        V = np.where(correlated[:, None, None, None], V, V * np.eye(V.shape[-1]))
    if known and correlated.any() and np.isfinite(flat.dof).any():
        V = correlated_as_all(flat, V)
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


# Channels that each show one entry of z = (X, U, f), their noise uncorrelated: weighted means instead of
# systems.


# From channels to the amplitudes of coordinates, inputs and forces (THEORY §3, §4).
#
# The state of line l is z = (X, U, f).  A channel shows a linear combination of it, y = C(ω) z + noise; where the
# channels of a line see every entry of z, generalised least squares combines them by their covariances: velocity and
# displacement of one point, accelerations, differences, several sensors on one point all measure one amplitude.


def states_by_point(
    view: ObservationModel, used: Bools, V: Complex, y: Complex
) -> tuple[Complex, Complex, Complex] | None:
    """ẑ (..., lines, q), its covariance (..., lines, q, q) and P (..., lines, q, channels) with ẑ = P y; None as below.

    used (lines, channels), V (..., lines, channels, channels), y (..., lines, channels).
    """
    compiled = kernel_function("point_states")
    if compiled is None or V.ndim != 4 or y.ndim != 3:
        simple = combined_by_point(view.direct, used, V)
        return None if simple is None else ((simple[0] @ y[..., None])[..., 0], simple[1], simple[0])
    if view.single_entries is None:
        return None
    return compiled(*view.single_entries, used, V, y, view.direct_incidence.shape[-1])


def combined_by_point(C: Complex, used: Bools, V: Complex) -> tuple[Complex, Complex] | None:
    """P (..., lines, q, channels) with ẑ = P y, and the covariance of ẑ (..., lines, q, q); None if it is not so.

    C (lines, channels, q) as `ObservationModel.direct`, used (lines, channels), V (..., lines, channels, channels).  A
    channel of a point weighs with |C|²/V; an exact one alone counts.
    """
    shows = (C != 0).any(axis=0)
    if (np.count_nonzero(shows, axis=-1) > 1).any():
        return None
    variance = V.diagonal(axis1=-2, axis2=-1).real
    if np.count_nonzero(V) != np.count_nonzero(variance):
        return None
    nonzero = shows.astype(float)
    reading: Complex = C.sum(axis=-1)  # of the one entry
    seen = used & (reading != 0)
    exact = seen & (variance <= 0)
    exactly = exact @ nonzero
    if (exactly > 1).any():
        return None  # two exact channels of one point
    counted: Bools = seen & (exact | (exactly @ nonzero.T == 0))
    size: Real = (reading * reading.conj()).real
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.where(counted, size / np.where(exact, size, variance), 0.0)
        information = weight @ nonzero
        share = np.where(counted, weight / (information @ nonzero.T) / reading, 0.0)
        spread = np.where(exactly > 0, 0.0, 1 / information)
    P: Complex = nonzero.T * share[..., None, :]
    covariance = np.zeros((*spread.shape, C.shape[-1]), dtype=np.complex128)
    entry = np.arange(C.shape[-1])
    covariance[..., entry, entry] = spread
    return P, covariance


@dataclass(frozen=True)
class States:
    """Amplitudes z = (X, U, f) = P y, (..., lines, q), q = n + r + s, and their covariance E[Δ Δᴴ], (..., lines, q, q).

    `reconstruction` is P, (..., lines, q, channels); `compiled` is what the kernel has made of these states.
    """

    omega: Real
    z: Complex
    covariance: Complex
    reconstruction: Complex
    n: int
    r: int
    experiment: Ints | None = None
    compiled: dict[object, Any] = field(default_factory=dict, compare=False, repr=False)

    def rows(self, rows: Ints) -> States:
        """Some of the repeats, rows (k,); what all repeats share stays shared."""
        covariance = self.covariance if len(self.covariance) == 1 else self.covariance[rows]
        P = self.reconstruction if len(self.reconstruction) == 1 else self.reconstruction[rows]
        return States(self.omega, self.z[rows], covariance, P, self.n, self.r, self.experiment)

    def lines(self, lines: Ints) -> States:
        """Some of the lines, (l,)."""
        return States(
            self.omega[lines],
            self.z[:, lines],
            self.covariance[:, lines],
            self.reconstruction[:, lines],
            self.n,
            self.r,
            None if self.experiment is None else self.experiment[lines],
        )

    @property
    def X(self) -> Complex:
        """Coordinates, (..., lines, n), m."""
        return self.z[..., : self.n]

    @property
    def U(self) -> Complex:
        """Displacement inputs, (..., lines, r), m."""
        return self.z[..., self.n : self.n + self.r]

    @property
    def f(self) -> Complex:
        """Force inputs, (..., lines, s), N."""
        return self.z[..., self.n + self.r :]


def unseen(view: ObservationModel, spectrum: Spectrum, channels: Bools | None = None) -> tuple[str, ...]:
    """Names of coordinates and inputs that the direct channels (or some of them) do not determine at some line.

    `view` is that of the spectrum, here as below; channels (channels,).
    """
    used = view.is_direct if channels is None else view.is_direct & channels
    missing = np.zeros(view.direct_incidence.shape[-1], dtype=bool)
    for pattern in used[None] if spectrum.complete else np.unique(spectrum.present & used, axis=0):
        key = pattern.tobytes()
        if key not in view.undetermined:
            C = view.direct_incidence[pattern]  # rates scale rows, and do not change what they show
            shown = np.flatnonzero(np.any(C != 0, axis=0))  # of a large rig few coordinates
            _, s, Vh = np.linalg.svd(C[:, shown], full_matrices=True)
            rank = int(np.sum(s > 1e-9 * max(1.0, float(s[0]) if s.size else 0.0)))
            view.undetermined[key] = np.ones(C.shape[1], dtype=bool)
            view.undetermined[key][shown] = ~(np.linalg.norm(Vh[rank:], axis=0) <= 1e-9)
        missing |= view.undetermined[key]
    model = view.model
    names = (*model.coordinates, *model.displacement_inputs, *model.force_inputs) if missing.any() else ()
    return tuple(name for name, lost in zip(names, missing, strict=False) if lost)


def reconstruction(
    view: ObservationModel, spectrum: Spectrum, covariance: Complex, channels: Bools | None = None
) -> Complex:
    """P with ẑ = P y, (..., lines, n + r + s, channels): generalised least squares from the direct channels.

    ẑ minimises (y − C z)ᴴ V⁻¹ (y − C z); exact channels are met exactly.  `channels` limits what is used.
    Raises DataError if some entry of z is not seen.
    """
    C, used = view.direct, spectrum.present & view.is_direct
    if channels is not None:
        used = used & channels
    both = used[:, :, None] & used[:, None, :]
    sd = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1).real, 0.0))
    exact = used & (sd == 0)
    # Each noisy channel is measured in its standard deviations and each entry of z in those of its best channel.
    # Typical sizes of the channels, (lines, channels), which exact ones are measured in
    magnitude = np.abs(np.nan_to_num(spectrum.amplitudes)).reshape(-1, *spectrum.amplitudes.shape[-2:])
    size = np.mean(magnitude, axis=0)
    overall = np.max(size, axis=0, initial=0.0)
    y_size = np.where(used & ~exact, sd, np.maximum(size, 1e-6 * np.where(overall > 0, overall, 1.0)))
    C = C * used[..., None] / y_size[..., None]
    largest = np.max(np.abs(C), axis=-2)
    z_size = 1 / np.where(largest > 0, largest, 1.0)
    C = C * z_size[..., None, :]
    weakest = np.where(exact, np.max(np.abs(C), axis=-1), 1.0)
    weakest = np.where(weakest > 0, weakest, 1.0)
    C, y_size = C / weakest[..., None], y_size * weakest
    # No weights could tell exact channels apart that say the same thing more than once.
    twice = np.sum(exact, axis=-1)
    several = np.flatnonzero(np.any((twice > 1).reshape(-1, C.shape[-3]), axis=0))
    if len(several):
        s = np.linalg.svd((C * exact[..., None])[..., several, :, :], compute_uv=False)
        expected = np.arange(s.shape[-1]) < twice[..., several, None]
        if np.any(twice[..., several] > s.shape[-1]) or np.any(expected & (s < 1e-9)):
            raise _contradiction()
    V = np.where(both, covariance / (y_size[..., :, None] * y_size[..., None, :]), np.eye(C.shape[-2]))
    count, q = C.shape[-2:]
    system = np.zeros((*V.shape[:-2], count + q, count + q), dtype=np.complex128)
    system[..., :count, :count] = V
    system[..., :count, count:] = C
    system[..., count:, :count] = hermitian(C)
    right = np.zeros((count + q, count))
    right[:count] = np.eye(count)
    try:
        solved = np.linalg.solve(system, np.broadcast_to(right, (*V.shape[:-2], *right.shape)))
    except np.linalg.LinAlgError as error:
        raise _contradiction() from error
    P: Complex = solved[..., count:, :]
    return P * used[:, None, :] * z_size[..., :, None] / y_size[..., None, :]


def _contradiction() -> DataError:
    return DataError(
        "two exact channels measure the same thing, or some coordinate is not measured",
        cure="state the noise of the channels (a column NAME_sd), or leave one out",
    )


def states_if_seen(view: ObservationModel, spectrum: Spectrum, covariance: Complex) -> States | None:
    """The amplitudes z, all direct channels combined; None if some coordinate or input is not seen.

    covariance (..., lines, channels, channels).  Raises DataError as `reconstruction`.
    """
    if unseen(view, spectrum):
        return None
    Y = spectrum.amplitudes
    y = Y if spectrum.complete else np.where(np.isnan(Y), 0.0, Y)
    by_point = states_by_point(view, spectrum.present & view.is_direct, covariance, y)
    if by_point is None:
        P = reconstruction(view, spectrum, covariance)
        by_point = (P @ y[..., None])[..., 0], P @ covariance @ hermitian(P), P
    moved = len(view.model.displacement_inputs)
    return States(spectrum.omega, *by_point, view.model.n, moved, view.experiment)


def require_seen(view: ObservationModel, spectrum: Spectrum) -> None:
    """Raises DataError that names what no channel sees."""
    missing = unseen(view, spectrum)
    if missing:
        raise DataError(
            f"no channel measures {', '.join(missing)} at every line",
            cure="this method needs every coordinate and input: use the method ml, or add the channel",
        )
