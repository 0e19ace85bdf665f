"""From channels to the amplitudes of coordinates, inputs and forces (THEORY §3, §4).

The state of line l is z = (X, U, f).  A channel shows a linear combination of it, y = C(ω) z + noise; where the
channels of a line see every entry of z, generalised least squares combines them by their covariances: velocity and
displacement of one point, accelerations, differences, several sensors on one point all measure one amplitude.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, hermitian
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.model.observation import ObservationModel
from dashpot.numerics.kernel import kernel_function

# Channels that each show one entry of z = (X, U, f), their noise uncorrelated: weighted means instead of
# systems.


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
    """P (..., lines, q, channels) with ẑ = P y, and the covariance of ẑ (..., lines, q, q); None where it is not so.

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
    compiled: dict[object, Any] = field(default_factory=dict, compare=False, repr=False)

    def rows(self, rows: Ints) -> States:
        """Some of the repeats, rows (k,); what all repeats share stays shared."""
        covariance = self.covariance if len(self.covariance) == 1 else self.covariance[rows]
        P = self.reconstruction if len(self.reconstruction) == 1 else self.reconstruction[rows]
        return States(self.omega, self.z[rows], covariance, P, self.n, self.r)

    def lines(self, lines: Ints) -> States:
        """Some of the lines, (l,)."""
        return States(
            self.omega[lines],
            self.z[:, lines],
            self.covariance[:, lines],
            self.reconstruction[:, lines],
            self.n,
            self.r,
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
    Raises DataError where some entry of z is not seen.
    """
    C, used = view.direct, spectrum.present & view.is_direct
    if channels is not None:
        used = used & channels
    both = used[:, :, None] & used[:, None, :]
    sd = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1).real, 0.0))
    exact = used & (sd == 0)
    # Each noisy channel is measured in its standard deviations and each entry of z in those of its best channel.
    y_size = np.where(used & ~exact, sd, _sizes(spectrum))
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
        "two exact channels measure the same thing, or some coordinate is not seen",
        cure="give the channels their noise (a column NAME_sd), or leave one out",
    )


def _sizes(spectrum: Spectrum) -> Real:
    """Typical sizes of the channels, (lines, channels), which exact ones are measured in."""
    magnitude = np.abs(np.nan_to_num(spectrum.amplitudes)).reshape(-1, *spectrum.amplitudes.shape[-2:])
    size = np.mean(magnitude, axis=0)
    overall = np.max(size, axis=0, initial=0.0)
    return np.maximum(size, 1e-6 * np.where(overall > 0, overall, 1.0))


def states_if_seen(view: ObservationModel, spectrum: Spectrum, covariance: Complex) -> States | None:
    """The amplitudes z, all direct channels combined; None where some coordinate or input is not seen.

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
    return States(spectrum.omega, *by_point, view.model.n, len(view.model.displacement_inputs))


def require_seen(view: ObservationModel, spectrum: Spectrum) -> None:
    """Raises DataError that names what no channel sees."""
    missing = unseen(view, spectrum)
    if missing:
        raise DataError(
            f"no channel sees {', '.join(missing)} at every line",
            cure="this method needs every coordinate and input: use the method ml, or add the channel",
        )
