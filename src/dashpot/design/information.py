"""Fisher information of a planned test, for any linear set of channels (THEORY §4, §6).

A channel is y = C(ω, p) (X, U, f) + noise, force channels included: the force in element i is p_i φ_i δ_i, the reaction
at a displacement input u is Dᵀ (p ∘ a).  With J = ∂Y/∂ψ the information of amplitudes with covariance V = E[Δ Δᴴ] is
2 Re Jᴴ V⁻¹ J; inputs that are measured with noise, or not at all, are unknowns of each line and are projected out.
ψ are the unknowns θ and then the unknown gains and delays of the channels, which all lines share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Complex, Real, hermitian
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError, UsageError
from dashpot.model.channel_noise import noise_sd
from dashpot.model.network import Model
from dashpot.model.observation import calibration_slopes, observation_model, transfer

NONE = 1e-9  # of a channel's largest sensitivity: below it, a channel does not see the parameters


@dataclass(frozen=True)
class Outputs:
    """Noise-free amplitudes of the channels and their slopes, SI units.

    Y             (..., lines, channels)
    by_parameter  ∂Y/∂ψ, (..., lines, channels, parameters), gains as ∂/∂ ln gain
    by_input      ∂Y/∂(U, f), (..., lines, channels, r + s)
    motion        displacement of each input along itself, (..., lines, r + s), m: U, and Sᵀ X for forces
    force         force that each input exerts, (..., lines, r + s), N: reactions, and f
    """

    Y: Complex
    by_parameter: Complex
    by_input: Complex
    motion: Complex
    force: Complex


def outputs(model: Model, p: Real, channels: Sequence[Channel], omega: Real, drive: Complex) -> Outputs:
    """What the channels show of the rig with parameters p (..., elements) under `drive` = (U, f) (..., lines, r + s).

    Raises DataError where a channel measures what the rig has not.
    """
    r = len(model.displacement_inputs)
    view = observation_model(model, channels, omega)
    rig = transfer(view, p)
    q = np.broadcast_to(drive, (*np.broadcast_shapes(rig.X.shape[:-2], drive.shape[:-1]), drive.shape[-1]))
    Y = rig.amplitudes(q)
    nominal = np.array([*[0.0] * view.m, *[1.0] * view.gains, *[0.0] * view.delays])
    by_parameter = np.concatenate([rig.slopes(q), calibration_slopes(view, nominal, Y)], axis=-1)
    X, U, f = np.einsum("...nq,...q->...n", rig.X, q), q[..., :r], q[..., r:]
    reactions = (p[..., None, :] * rig.unit_forces(q)) @ model.D
    return Outputs(
        Y,
        by_parameter,
        np.broadcast_to(rig.G, (*q.shape[:-1], *rig.G.shape[-2:])),
        np.concatenate([U, X @ model.S], axis=-1),
        np.concatenate([reactions, f], axis=-1),
    )


def fisher(J: Complex, G: Complex, V: Complex, names: Sequence[str]) -> Real:
    """2 Re Jᴴ V⁻¹ J with the line's own unknowns (slopes G) projected out; (..., lines, parameters, parameters).

    J (..., lines, channels, parameters), G (..., lines, channels, inputs), V (..., lines, channels, channels).  A
    channel with zero variance is exact: it must not depend on the parameters (it fixes inputs).  Rows of zeros are
    no measurement.  Raises UsageError for an exact channel that depends on them; `names` are the channels'.
    """
    variance = np.diagonal(V, axis1=-2, axis2=-1).real
    silent = ~np.any(J != 0, axis=-1) & ~np.any(G != 0, axis=-1)
    exact = (variance == 0) & ~silent
    count = exact.shape[-1]
    patterns = np.concatenate([exact, silent], axis=-1)
    flat = patterns.reshape(-1, patterns.shape[-2], patterns.shape[-1])
    if np.any(flat != flat[:1]):  # repeats that differ in what they measure: one by one
        lead = J.shape[:-3]
        whole = [np.broadcast_to(part, (*lead, *part.shape[-3:])) for part in (J, G, V)]
        parts = [fisher(whole[0][k], whole[1][k], whole[2][k], names) for k in np.ndindex(lead)]
        return np.stack(parts).reshape(*lead, *parts[0].shape)
    total = np.zeros((*J.shape[:-2], J.shape[-1], J.shape[-1]))
    for pattern in np.unique(flat[0], axis=0):
        lines = np.flatnonzero(np.all(flat[0] == pattern, axis=-1))
        at_exact, unused = pattern[:count], pattern[count:]
        noisy = ~at_exact & ~unused
        part = J[..., lines, :, :]
        seen = part[..., at_exact, :]
        size = np.max(np.abs(part), initial=0.0)
        if seen.size and np.max(np.abs(seen)) > NONE * size:
            worst = np.flatnonzero(at_exact)[
                int(np.argmax(np.max(np.abs(seen), axis=(*range(seen.ndim - 2), -1))))
            ]
            raise UsageError(
                f"channel {names[worst]} has no noise, which makes its information infinite",
                cure="state its noise (or relative_noise) in the rig file, or leave the channel out",
            )
        free = _free_inputs(G[..., lines, :, :][..., at_exact, :])
        W = V[..., lines, :, :][..., noisy, :][..., noisy]
        total[..., lines, :, :] = _projected(
            part[..., noisy, :], G[..., lines, :, :][..., noisy, :] @ free, W
        )
    return total


def _free_inputs(E: Complex) -> Complex:
    """Orthonormal directions of the inputs that exact channels leave free, (..., lines, inputs, directions)."""
    inputs = E.shape[-1]
    if E.shape[-2] == 0 or inputs == 0:
        return np.broadcast_to(np.eye(inputs, dtype=complex), (*E.shape[:-2], inputs, inputs))
    size = np.max(np.abs(E), axis=-1, keepdims=True)
    _, s, Vh = np.linalg.svd(E / np.where(size > 0, size, 1.0), full_matrices=True)
    rank = int(np.min(np.sum(s > 1e-9, axis=-1)))
    return hermitian(Vh[..., rank:, :])


def _projected(J: Complex, G: Complex, V: Complex) -> Real:
    """2 Re Jᴴ V⁻¹ J without the part that G explains."""
    sd = np.sqrt(np.diagonal(V, axis1=-2, axis2=-1).real)
    J, G = J / sd[..., None], G / sd[..., None]
    R = V / (sd[..., :, None] * sd[..., None, :])
    correlated: Bools = R * (1 - np.eye(R.shape[-1])) != 0
    if np.any(correlated):
        try:
            root = np.linalg.cholesky(R)
        except np.linalg.LinAlgError:
            raise DataError(
                "the noise of some channels is perfectly correlated", cure="leave one of them out"
            ) from None
        J = np.linalg.solve(root, J).astype(np.complex128)
        G = np.linalg.solve(root, G).astype(np.complex128)
    if G.shape[-1]:
        size = np.linalg.norm(G, axis=-2, keepdims=True)
        basis, s, _ = np.linalg.svd(G / np.where(size > 0, size, 1.0), full_matrices=False)
        Q: Complex = basis * (s > 1e-12 * np.max(s, axis=-1, keepdims=True, initial=0.0))[..., None, :]
        J = J - Q @ (hermitian(Q) @ J)
    return 2 * (hermitian(J) @ J).real


def per_sample(channels: Sequence[Channel], seen: Outputs) -> Real:
    """Information that one sample of each line adds, (..., lines, parameters, parameters), in SI units of ψ.

    N samples of a dwell give amplitudes with V = 4 R / N, R the covariance of one sample (white noise, whole periods
    or many).  What the size of relative noise itself tells about the parameters is left out, as the estimators do.
    """
    sd = noise_sd(channels, seen.Y)
    dumb = _without_signal(channels, seen, sd)
    # Relative noise of a channel that does not move is no noise, but no signal either: the channel is left out.
    J = np.where(dumb[..., None], 0.0, seen.by_parameter)
    G = np.where(dumb[..., None], 0.0, seen.by_input)
    V = ((4 * sd**2)[..., None] * np.eye(len(channels))).astype(np.complex128)
    return fisher(J, G, V, [channel.name for channel in channels])


def _without_signal(channels: Sequence[Channel], seen: Outputs, sd: Real) -> Bools:
    """Channels that see the rig move (not only its inputs), have relative noise and are silent at a line."""
    relative = np.array([c.relative_noise > 0 and c.noise == 0 for c in channels])
    sees = np.any(np.abs(seen.by_parameter) > 0, axis=(*range(seen.by_parameter.ndim - 2), -1))
    silent: Bools = relative & sees & (sd == 0)
    return silent


def spectrum_information(model: Model, p: Real, spectrum: Spectrum, drive: Complex) -> Real:
    """Information of each line of existing data at parameters p, (lines, parameters, parameters), SI units of ψ.

    `drive` (lines, r + s) are the amplitudes of the inputs.  The noise is the spectrum's covariance.
    """
    seen = outputs(model, p, spectrum.channels, spectrum.omega, drive)
    present = np.isfinite(spectrum.amplitudes)
    J = np.where(present[..., None], seen.by_parameter, 0.0)
    G = np.where(present[..., None], seen.by_input, 0.0)
    names = [channel.name for channel in spectrum.channels]
    return fisher(J, G, np.where(np.isnan(spectrum.covariance), 0.0, spectrum.covariance), names)
