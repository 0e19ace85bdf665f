"""Fisher information of a planned test, for any linear set of channels (THEORY §4, §6).

A channel is y = C(ω, p) (X, U, f) + noise, force channels included: the force in element i is p_i φ_i δ_i, the reaction
at a displacement input u is Dᵀ (p ∘ a).  With J = ∂Y/∂ψ the information of amplitudes with covariance V = E[Δ Δᴴ] is
2 Re Jᴴ V⁻¹ J; inputs that are measured with noise, or not at all, are unknowns of each line and are projected out.
ψ are the unknowns θ and then the unknown gains and delays of the channels, which all lines share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Complex, Real, hermitian
from dashpot.channel import Channel, Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError, UsageError
from dashpot.estimate.preparation.state_reconstruction import measurement
from dashpot.model.dynamics import dynamic_stiffness, input_stiffness, unit_forces
from dashpot.model.network import Model
from dashpot.numerics.small_systems import solve_small

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


def calibrations(channels: Sequence[Channel]) -> tuple[str, ...]:
    """Names of the calibrations that are estimated with θ.  An unknown sign costs no information: it is ±1.

    A gain that several channels share is one unknown, named after its owner.
    """
    gains = tuple(f"{c.name}.gain" for c in channels if c.gain is None and c.same_gain_as is None)
    return gains + tuple(f"{c.name}.delay" for c in channels if c.delay is None)


def outputs(model: Model, p: Real, channels: Sequence[Channel], omega: Real, drive: Complex) -> Outputs:
    """What the channels show of the rig with parameters p (..., elements) under `drive` = (U, f) (..., lines, r + s).

    Raises DataError where a channel measures what the rig has not.
    """
    n, r = model.n, len(model.displacement_inputs)
    stiffness = dynamic_stiffness(model, p, omega)
    into = input_stiffness(model, p, omega)
    into = np.concatenate(
        [into, np.broadcast_to(model.S.astype(complex), (*into.shape[:-1], model.S.shape[1]))], axis=-1
    )
    by_drive = solve_small(stiffness, into)
    X = np.einsum("...ij,...j->...i", by_drive, drive)
    U, f = drive[..., :r], drive[..., r:]
    U = np.broadcast_to(U, (*X.shape[:-1], r))
    a = unit_forces(model, omega, X, U)
    # ∂X/∂θ directly: one right side an unknown, not one an element.
    pull = (model.B.T * a[..., None, :]) @ model.T
    slope = -solve_small(stiffness, pull)
    C = np.broadcast_to(
        _direct(model, channels, omega), (*X.shape[:-1], len(channels), n + drive.shape[-1])
    ).copy()
    own = np.zeros((*X.shape[:-1], len(channels), len(model.unknowns)), dtype=np.complex128)
    stretch = np.concatenate(
        [model.B, model.D, np.zeros((len(model.elements), len(model.force_inputs)))], axis=1
    )
    strength = p[..., None, :] * model.factors(omega)
    for i, factors in _force_rows(model, channels):
        C[..., i, :] = (factors * strength) @ stretch
        own[..., i, :] = (factors * a) @ model.T
    z = np.concatenate([X, np.broadcast_to(drive, (*X.shape[:-1], drive.shape[-1]))], axis=-1)
    Y = np.einsum("...ij,...j->...i", C, z)
    by_parameter = own + C[..., :n] @ slope
    by_input = C[..., n:] + C[..., :n] @ by_drive
    extra = [
        sum((_column(Y, k) for k in _sharing(channels, c)), np.zeros_like(Y))
        for c in channels
        if c.gain is None and c.same_gain_as is None
    ]
    extra += [-1j * omega[:, None] * _column(Y, i) for i, c in enumerate(channels) if c.delay is None]
    if extra:
        by_parameter = np.concatenate([by_parameter, np.stack(extra, axis=-1)], axis=-1)
    motion = np.concatenate([U, X @ model.S], axis=-1)
    force = np.concatenate(
        [(p[..., None, :] * a) @ model.D, np.broadcast_to(f, (*X.shape[:-1], f.shape[-1]))], axis=-1
    )
    return Outputs(Y, by_parameter, by_input, motion, force)


def _column(Y: Complex, i: int) -> Complex:
    alone = np.zeros_like(Y)
    alone[..., i] = Y[..., i]
    return alone


def _sharing(channels: Sequence[Channel], owner: Channel) -> list[int]:
    """Indices of the channels whose unknown gain is the owner's."""
    return [i for i, c in enumerate(channels) if c.gain is None and owner.name in (c.name, c.same_gain_as)]


def _is_element_force(model: Model, channel: Channel) -> bool:
    return channel.quantity is Quantity.FORCE and not set(channel.of) <= set(model.force_inputs)


def _direct(model: Model, channels: Sequence[Channel], omega: Real) -> Complex:
    """C of the channels that look at (X, U, f) alone; rows of force channels are 0."""
    calibrated = [replace(c, gain=1.0, delay=0.0, sign=1.0) for c in channels]
    return measurement(model, calibrated, omega)


def _force_rows(model: Model, channels: Sequence[Channel]) -> list[tuple[int, Real]]:
    """For each channel that measures element forces or a reaction: its index and the factors on p_i a_i."""
    names = {element.name: i for i, element in enumerate(model.elements)}
    found = []
    for i, channel in enumerate(channels):
        if not _is_element_force(model, channel):
            continue
        factors = np.zeros(len(model.elements))
        for name, factor in channel.of.items():
            if name in names:
                factors[names[name]] += factor
            elif name in model.displacement_inputs:
                factors += factor * model.D[:, model.displacement_inputs.index(name)]
            else:
                raise DataError(
                    f"channel {channel.name} measures the force of {name}, which the rig has not",
                    cure=f"it has {', '.join((*names, *model.displacement_inputs, *model.force_inputs))}",
                )
        found.append((i, factors))
    return found


def noise_sd(channels: Sequence[Channel], Y: Complex) -> Real:
    """Standard deviation of one sample, SI units, shape of Y: floor and relative part are independent."""
    floor = np.array([abs(c.noise * c.scale / (1.0 if c.gain is None else c.gain)) for c in channels])
    relative = np.array([c.relative_noise for c in channels])
    sd: Real = np.hypot(floor, relative * np.abs(Y))
    return sd


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
        own = [fisher(whole[0][k], whole[1][k], whole[2][k], names) for k in np.ndindex(lead)]
        return np.stack(own).reshape(*lead, *own[0].shape)
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
                f"the channel {names[worst]} has no noise, so one sample of it would tell everything",
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
