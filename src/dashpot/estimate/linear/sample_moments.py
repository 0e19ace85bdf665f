"""The paper's methods work on samples: a_i(t) from the channel that measures the right derivative (eq. 7-15).

A spring's unit force is read from displacements, a damper's from velocities, a mass's from accelerations or, as in
the paper's J(ω), from −ω² x.  All sums over samples are bilinear in q(t) = (channels, cos ωt, sin ωt), so the second
moments Σ q qᵀ of the Spectrum hold them; without moments they are those of whole periods, N/2 Re(w̄ a).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.channel import Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError, UsageError
from dashpot.estimate.linear.gram import gram, gram_force
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import reconstruction, unseen
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel


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

    def rows(self, rows: Ints) -> Sampled:
        """Some of the repeats, rows (k,)."""

        def pick(part: np.ndarray) -> np.ndarray:
            return part if len(part) == 1 else part[rows]

        return Sampled(
            self.model, self.omega, pick(self.V), self.y[rows], self.a[rows], pick(self.reading), self.U[rows],
            self.f[rows], pick(self.force), self.weight,
            None if self.coefficients is None else self.coefficients[rows],
            None if self.moments is None else pick(self.moments),
        )  # fmt: skip


def sampled(data: Prepared) -> Sampled:
    """Read the unit forces from the channels.  Raises DataError where some coordinate is not seen."""
    view, spectrum, V = data.view, data.spectrum, data.covariance
    model = view.model
    _ = data.seen_states  # raises where some of them are not seen
    y = np.nan_to_num(spectrum.amplitudes)
    drive = view.inputs_alone & view.is_direct
    derivative = np.array(
        [-1 if c.quantity is Quantity.FORCE else c.quantity.derivative for c in spectrum.channels]
    )
    P = {
        k: reconstruction(view, spectrum, V, drive | chosen)
        for k, chosen in _channels_for(view, spectrum, drive, derivative)
    }
    n, r = model.n, len(model.displacement_inputs)
    span = np.concatenate([model.B, model.D], axis=1)
    phi = model.factors(spectrum.omega)
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
    coefficients = None
    moments = None
    if spectrum.moments is not None:
        moments = spectrum.moments.products
        coefficients = _time_coefficients(reading, y, drive)
    return Sampled(
        model, spectrum.omega, V, y, a, reading, U, f, force, spectrum.samples / 2, coefficients, moments
    )


def _channels_for(
    view: ObservationModel,
    spectrum: Spectrum,
    drive: np.ndarray,
    derivative: np.ndarray,
) -> list[tuple[int, np.ndarray]]:
    """For each derivative that elements need (and 0), the motion channels that it is read from."""
    chosen = []
    for k in sorted({0, *(element.law.power for element in view.model.elements)}):
        tries = [derivative == k, derivative == 2 - k] if k != 1 else [derivative == 1]
        chosen_channels = next((t for t in tries if not unseen(view, spectrum, drive | t)), None)
        if chosen_channels is None:
            if spectrum.moments is not None and k != 1:
                chosen_channels = (derivative == 0) | (derivative == 2)
            if chosen_channels is None or unseen(view, spectrum, drive | chosen_channels):
                chosen_channels = derivative >= 0
        chosen.append((k, chosen_channels))
    return chosen


def _time_coefficients(reading: Complex, y: Complex, drive: np.ndarray) -> Real | None:
    """Coefficients over q(t); None where some unit force is no instantaneous function of the channels.

    Channels enter as samples, the inputs (known functions of time in the paper) by their amplitudes.
    """
    samples = np.where(drive, 0.0, reading)
    if np.any(np.abs(samples.imag) > 1e-9 * np.max(np.abs(samples), axis=-1, keepdims=True)):
        return None
    driven = np.einsum("...lic,...lc->...li", np.where(drive, reading, 0.0), y)
    real = np.broadcast_to(samples.real, (*driven.shape, reading.shape[-1]))
    return np.concatenate([real, driven.real[..., None], -driven.imag[..., None]], axis=-1)


def _moments_and_coefficients(observed: Sampled) -> tuple[Real, Real]:
    """What the sums over samples need.  Raises UsageError or DataError where it is missing."""
    if observed.moments is None:
        raise UsageError(
            "ls is least squares on samples, as in the paper, and these data are amplitudes",
            cure="give the records themselves, or use hls, least squares on amplitudes",
        )
    if observed.coefficients is None:
        raise DataError(
            "ls reads dampers from velocity channels, and some velocity is not measured",
            cure="add the velocity channels, or use hls, which works on amplitudes",
        )
    return observed.moments, observed.coefficients


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
    moments, coefficients = _moments_and_coefficients(observed)
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
