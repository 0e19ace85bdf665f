"""What the channels show of a rig: y = κ (C_x X + C_q q + F (p ∘ a)) + noise, the one place of that map (THEORY §4).

q = (U, f) are the inputs, X the coordinates and a the unit forces of the elements.  A motion is a combination of
points, differentiated up to twice; an applied force is an entry of f; the force in an element is p_i a_i, and the
reaction that moves a displacement input u is Dᵀ (p ∘ a).  κ_c = sign · gain · e^{−jωτ} is what is unknown of a
channel's calibration; what is known of it has been taken out when raw numbers became amplitudes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np
from scipy import sparse

from dashpot.arrays import Bools, Complex, Ints, Real, frozen
from dashpot.channel import Channel, Quantity
from dashpot.errors import DataError
from dashpot.model.dynamics import stiffness, stiffness_solver
from dashpot.model.network import Model
from dashpot.numerics.small_systems import SPARSE_FROM, solve_small
from dashpot.units import si_unit
from dashpot.unknowns import Unknown, prior_mean, prior_precision

if TYPE_CHECKING:
    from dashpot.model.reduced import ReducedRig, ReducedTransfer

# How channels hang on coordinates, inputs and elements, and which of their calibrations are unknown.


def channel_incidence(model: Model, channels: Sequence[Channel]) -> tuple[Real, Real, Real]:
    """Factors of the channels on coordinates, on inputs and on element forces; each (channels, …).

    Raises DataError if a channel shows what the rig has not.
    """
    r, s = len(model.displacement_inputs), len(model.force_inputs)
    on_x, on_q, force = parts = tuple(
        np.zeros((len(channels), size)) for size in (model.n, r + s, len(model.elements))
    )
    moved = {name: j for j, name in enumerate(model.displacement_inputs)}
    points = {name: (on_x, i) for i, name in enumerate(model.coordinates)}
    points |= {name: (on_q, j) for name, j in moved.items()}
    forces = {name: (on_q, r + j) for j, name in enumerate(model.force_inputs)}
    forces |= {element.name: (force, i) for i, element in enumerate(model.elements)}
    replacing: dict[str, list[int]] = {}  # elements that stand for another in some experiment
    for i, element in enumerate(model.elements):
        if element.stands_for is not None:
            replacing.setdefault(element.stands_for, []).append(i)
    for c, channel in enumerate(channels):
        is_force = channel.quantity is Quantity.FORCE
        for name, factor in channel.of.items():
            part, column = (forces if is_force else points).get(name, (None, 0))
            if part is not None:
                part[c, column] += factor
                if part is force:
                    force[c, replacing.get(name, [])] += factor
            elif is_force and name in moved:
                force[c] += factor * model.D[:, moved[name]]
            else:
                what, names = ("the force of ", [*moved, *forces]) if is_force else ("", list(points))
                raise DataError(
                    f"channel {channel.name} measures {what}{name}, which the rig does not have",
                    cure=f"it has {', '.join(names)}",
                )
    on_x, on_q, force = (frozen(part, np.float64) for part in parts)
    return on_x, on_q, force


def unknown_calibrations(channels: Sequence[Channel]) -> tuple[Unknown, ...]:
    """The calibrations that are estimated with θ: gains, then delays; those of one name, which channels share, once."""
    gains = [channel.unknown_gain for channel in channels if channel.same_gain_as is None]
    delays = [channel.unknown_delay for channel in channels]
    return tuple({u.name: u for u in (*gains, *delays) if u is not None}.values())


def calibration_indices(channels: Sequence[Channel]) -> tuple[Ints, Ints]:
    """Index of each channel's unknown gain and delay, −1 where known; (channels,) each.

    Raises DataError if a channel shares a gain that is known.
    """
    gains = dict.fromkeys(c.unknown_gain.name for c in channels if c.unknown_gain and c.same_gain_as is None)
    delays = dict.fromkeys(c.unknown_delay.name for c in channels if c.unknown_delay)
    for channel in channels:
        if channel.unknown_gain is not None and channel.unknown_gain.name not in gains:
            raise DataError(
                f"channel {channel.name} shares the gain of {channel.same_gain_as}, which has no unknown gain",
                cure='name a channel with gain = "unknown"',
            )
    gain = [-1 if c.unknown_gain is None else list(gains).index(c.unknown_gain.name) for c in channels]
    delay = [-1 if c.unknown_delay is None else list(delays).index(c.unknown_delay.name) for c in channels]
    return frozen(gain, np.int64), frozen(delay, np.int64)


# What a channel measures


def measures_input(model: Model, channel: Channel) -> bool:
    """Whether a channel measures inputs and nothing else: moved points, or applied forces.

    The reaction force at a moved point is not an input: it depends on the parameters.
    """
    names = model.force_inputs if channel.quantity is Quantity.FORCE else model.displacement_inputs
    return set(channel.of) <= set(names)


def is_direct(model: Model, channel: Channel) -> bool:
    """Whether a channel depends on X, U and f alone: its calibration is known, and it measures no element's force."""
    if None in (channel.gain, channel.delay, channel.sign):
        return False
    return channel.quantity is not Quantity.FORCE or measures_input(model, channel)


def input_channels(model: Model) -> tuple[Channel, ...]:
    """Every input as a channel of its own, in the order of q = (U, f)."""
    moved = tuple(Channel(name, {name: 1.0}) for name in model.displacement_inputs)
    return (*moved, *(Channel(name, {name: 1.0}, Quantity.FORCE) for name in model.force_inputs))


def channel_unit(model: Model, channel: Channel) -> str:
    """SI unit of a channel's quantity."""
    along = {element.name: element.along for element in model.elements}
    along |= {given.name: given.at for given in model.inputs if given.kind == "force"}
    points = {point for name in channel.of for point in along.get(name, {name: 1.0})}
    return si_unit(channel.quantity.value, bool(points) and points <= set(model.angles))


# The map


@dataclass(frozen=True)
class ObservationModel:
    """The channels of one rig at given frequencies.  Holds no data and no parameters.

    on_x (channels, n), on_q (channels, r + s): factors of displacements and applied forces
    derivative (channels,): how often they are differentiated
    force (channels, elements): factors of p_i a_i in channels that measure element forces or reactions
    gain, delay (channels,): index into the gains and delays that are estimated, −1 where known
    flips (channels,): whether the sign is to be found
    reduced: a large rig on the span of few motions, in place of itself (`model.reduced`)
    experiment (lines,): in which each line was measured, of a rig that differs by experiment; None: it does not

    ψ = (θ, gains, delays) are the unknowns.
    """

    model: Model
    channels: tuple[Channel, ...]
    omega: Real
    on_x: Real
    on_q: Real
    derivative: Ints
    force: Real
    gain: Ints
    delay: Ints
    flips: Bools
    reduced: ReducedRig | None = None
    experiment: Ints | None = None

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """What is known of ψ beforehand."""
        return (*self.model.unknowns, *unknown_calibrations(self.channels))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns ψ."""
        return tuple(unknown.name for unknown in self.unknowns)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of ψ."""
        return tuple(unknown.unit for unknown in self.unknowns)

    @cached_property
    def prior_precision(self) -> Real:
        """Precision of the priors over ψ, 0 where there is none; (M,)."""
        return prior_precision(self.unknowns)

    @cached_property
    def prior_mean(self) -> Real:
        """Means of the priors over ψ, 0 where there is none; (M,)."""
        return prior_mean(self.unknowns)

    @cached_property
    def nominal_calibrations(self) -> Real:
        """Gains and delays as they are stated or guessed, else 1 and 0, (gains + delays,)."""
        return nominal_calibrations(self.unknowns[self.m :])

    @cached_property
    def gains(self) -> int:
        """Number of unknown gains."""
        return int(np.max(self.gain, initial=-1)) + 1

    @cached_property
    def delays(self) -> int:
        """Number of unknown delays."""
        return int(np.max(self.delay, initial=-1)) + 1

    @cached_property
    def m(self) -> int:
        """Number of unknowns of the rig itself."""
        return len(self.model.unknowns)

    @cached_property
    def has_forces(self) -> bool:
        """Whether some channel measures a force that depends on the parameters."""
        return bool(np.any(self.force))

    @cached_property
    def inputs_alone(self) -> Bools:
        """Which channels show inputs and nothing else of the rig, (channels,)."""
        return np.any(self.on_q, axis=-1) & ~np.any(self.on_x, axis=-1) & ~np.any(self.force, axis=-1)

    @property
    def calibration_known(self) -> Bools:
        """Of which channels gain, delay and sign are known, (channels,)."""
        return (self.gain < 0) & (self.delay < 0) & ~self.flips

    @cached_property
    def sees(self) -> Bools:
        """Which inputs each channel shows in a rig of this structure, (channels, r + s).

        A channel sees an input that reaches its coordinates through elements; a force on another rig of the same
        model, or on a part that is connected only to moved inputs, it does not.
        """
        model = self.model
        member, driven = model.connected
        looking, direct = np.abs(self.on_x), np.abs(self.on_q)
        if self.has_forces:
            looking = looking + abs(self.force) @ abs(model.sparse_B)
            direct[:, : model.D.shape[1]] += abs(self.force) @ abs(model.D)
        return ((looking @ member > 0).astype(float) @ driven > 0) | (direct > 0)

    def at_lines(self, lines: slice) -> ObservationModel:
        """The same channels at some of the frequencies; made once for each."""
        key = (lines.start, lines.stop)
        if key not in self._parts:
            self._parts[key] = self.at(lines)
        return self._parts[key]

    def at(self, lines: slice | Ints) -> ObservationModel:
        """The same channels at some of the frequencies."""
        experiment = None if self.experiment is None else self.experiment[lines]
        return replace(self, omega=self.omega[lines], experiment=experiment)

    @cached_property
    def factors(self) -> Complex:
        """φ of the elements that are there at each line, (lines, elements)."""
        return frozen(self.model.factors(self.omega, self.experiment), np.complex128)

    @cached_property
    def _parts(self) -> dict[tuple[int, int], ObservationModel]:
        return {}

    @cached_property
    def is_direct(self) -> Bools:
        """Which channels depend on X, U and f alone, (channels,)."""
        return np.array([is_direct(self.model, channel) for channel in self.channels], dtype=bool)

    @cached_property
    def direct(self) -> Complex:
        """[C_x | C_q] of the channels that are direct, 0 of the others; (lines, channels, n + r + s)."""
        return frozen(self.rates[..., None] * self.direct_incidence, np.complex128)

    @cached_property
    def direct_incidence(self) -> Real:
        """The same without the powers of jω, (channels, n + r + s)."""
        both = np.concatenate([self.on_x, self.on_q], axis=-1)
        return frozen(both * self.is_direct[:, None], np.float64)

    @cached_property
    def single_entries(self) -> tuple[Complex, Ints] | None:
        """What each direct channel shows, (lines, channels), and which entry of z that is, (channels,), −1 where none.

        None where some channel shows several.
        """
        shows = self.direct_incidence != 0
        if (np.count_nonzero(shows, axis=-1) > 1).any():
            return None
        entry = np.where(shows.any(axis=-1), shows.argmax(axis=-1), -1)
        return frozen(self.direct.sum(axis=-1), np.complex128), frozen(entry, np.int64)

    @cached_property
    def undetermined(self) -> dict[bytes, Bools]:
        """Entries of z = (X, U, f) that the channels of a line leave undetermined, by which of them are there."""
        return {}

    @cached_property
    def rates(self) -> Complex:
        """(jω)^derivative of each channel, (lines, channels)."""
        powers = np.stack([np.ones_like(self.omega), 1j * self.omega, -(self.omega**2)], axis=-1)
        return frozen(powers[:, self.derivative], np.complex128)

    @cached_property
    def direct_x(self) -> Complex:
        """C_x, (lines, channels, n)."""
        return frozen(self.rates[..., None] * self.on_x, np.complex128)

    @cached_property
    def direct_q(self) -> Complex:
        """C_q, (lines, channels, r + s)."""
        return frozen(self.rates[..., None] * self.on_q, np.complex128)


def nominal_calibrations(unknowns: Sequence[Unknown]) -> Real:
    """Gains and delays as they are stated or guessed, else 1 and 0, (unknowns,)."""
    usual = {"1": 1.0, "s": 0.0}  # by unit
    return frozen([usual[u.unit] if u.nominal is None else u.nominal for u in unknowns], np.float64)


def calibration_names(channels: Sequence[Channel]) -> tuple[str, ...]:
    """Names of the calibrations that are estimated with θ; an unknown sign is none, being ±1."""
    return tuple(unknown.name for unknown in unknown_calibrations(channels))


def observation_model(
    model: Model, channels: Sequence[Channel], omega: Real, experiment: Ints | None = None
) -> ObservationModel:
    """What `channels` show of `model` at `omega` (lines,), rad/s, in the `experiment` of each line.

    The last views of a model are kept, for an identification asks for the same ones over and over.
    Raises DataError if a channel measures something that the rig lacks, or shares a gain that is not unknown.
    """
    # A view holds its channels, so that their ids stay theirs.
    experiment = experiment if model.differs else None
    key = (*map(id, channels), omega.tobytes(), None if experiment is None else experiment.tobytes())
    if key not in model.views:
        channels = tuple(channels)
        on_x, on_q, force = channel_incidence(model, channels)
        derivative = [0 if c.quantity is Quantity.FORCE else c.quantity.derivative for c in channels]
        gain, delay = calibration_indices(channels)
        # A gain that is entirely unknown includes the sign.
        flips = [c.sign is None and (c.gain is not None or c.gain_prior is not None) for c in channels]
        orders, signs = frozen(derivative, np.int64), frozen(flips, np.bool_)
        at = frozen(omega, np.float64)
        model.views[key] = ObservationModel(
            model, channels, at, on_x, on_q, orders, force, gain, delay, signs, None, experiment
        )
    return cast(ObservationModel, model.views[key])


# Calibrations


def calibration_factors(view: ObservationModel, psi: Real, sign: Real) -> Complex:
    """κ of each channel, (..., lines, channels); ψ (..., M), signs (..., channels)."""
    shape = (*psi.shape[:-1], len(view.omega), sign.shape[-1])
    kappa = np.broadcast_to(sign[..., None, :].astype(np.complex128), shape)
    if view.gains:
        gains = psi[..., view.m : view.m + view.gains]
        kappa = kappa * np.where(view.gain >= 0, gains[..., view.gain], 1.0)[..., None, :]
    if view.delays:
        delays = psi[..., view.m + view.gains :]
        late = np.where(view.delay >= 0, delays[..., view.delay], 0.0)
        kappa = kappa * np.exp(-1j * view.omega[:, None] * late[..., None, :])
    return kappa


def calibration_slopes(view: ObservationModel, psi: Real, Y: Complex) -> Complex:
    """∂y/∂gain = y / gain and ∂y/∂τ = −jω y of amplitudes Y (..., lines, channels); (..., lines, channels, count)."""
    gain = view.gain[:, None] == np.arange(view.gains)
    delay = view.delay[:, None] == np.arange(view.delays)
    by_gain = Y[..., None] * gain / psi[..., None, None, view.m : view.m + view.gains]
    by_delay = -1j * view.omega[:, None, None] * Y[..., None] * delay
    return np.concatenate([by_gain, by_delay], axis=-1)


# Amplitudes and slopes


def channel_amplitudes(view: ObservationModel, X: Complex, q: Complex, forces: Complex) -> Complex:
    """C_x X + C_q q + F (p ∘ a), (..., lines, channels), SI units, of any state of the rig; calibrations left out.

    X (..., lines, n) m, q = (U, f) (..., lines, r + s), `forces` p ∘ a of the elements (..., lines, elements) N: the
    elements' own law says what they are.
    """
    return view.rates * (X @ view.on_x.T + q @ view.on_q.T) + forces @ view.force.T


@dataclass(frozen=True)
class Transfer:
    """The channels as functions of the inputs at parameters p, y = G q, and what their slopes are made of.

    G (..., lines, channels, r + s)
    X (..., lines, n, r + s): coordinates per unit of each input
    E (..., lines, channels, elements): ∂y_c/∂p_i = E_ci a_i, the effect of an internal force in element i
    psi (..., M): the unknowns, where G and E hold κ; None if calibrations are left out
    by_theta (..., lines, channels, r + s, unknowns): ∂G/∂θ in place of E, where that is less
    """

    view: ObservationModel
    G: Complex
    X: Complex
    E: Complex
    psi: Real | None = None
    by_theta: Complex | None = None

    def calibrated(self, kappa: Complex, psi: Real) -> Transfer:
        """The same with calibrations κ (..., lines, channels, 1) at ψ."""
        by_theta = None if self.by_theta is None else kappa[..., None] * self.by_theta
        return Transfer(self.view, kappa * self.G, self.X, kappa * self.E, psi, by_theta)

    def amplitudes(self, q: Complex) -> Complex:
        """y = G q under inputs q (..., lines, r + s); (..., lines, channels)."""
        return np.einsum("...cq,...q->...c", self.G, q)

    def unit_forces(self, q: Complex) -> Complex:
        """a = φ (B X + D U) under inputs q (..., lines, r + s); (..., lines, elements), N per unit of p."""
        model = self.view.model
        X = np.einsum("...nq,...q->...n", self.X, q)
        B = model.B if small(model) else model.sparse_B
        U = q[..., : model.D.shape[1]]
        return self.view.factors * (_times(X, B.T) + U @ model.D.T)

    def slopes(self, q: Complex) -> Complex:
        """∂y/∂ψ at fixed inputs q (..., lines, r + s), ∂y/∂θ without calibrations; (..., lines, channels, M)."""
        model = self.view.model
        if self.by_theta is None:
            T = model.T if small(model) else model.sparse_T
            by_theta = _times(self.E * self.unit_forces(q)[..., None, :], T)
        else:
            by_theta = np.einsum("...cqm,...q->...cm", self.by_theta, q)
        if self.psi is None or not (self.view.gains or self.view.delays):
            return by_theta
        by_calibration = calibration_slopes(self.view, self.psi, self.amplitudes(q))
        return np.concatenate([by_theta, by_calibration], axis=-1)


def transfer(view: ObservationModel, p: Real) -> Transfer:
    """The channels at parameters p (..., elements); NaN where the rig has no steady response.

    ∂X/∂p_i = −D⁻¹ b_iᵀ a_i is never formed: one adjoint solve per channel, D being symmetric, gives all its slopes,
    E = F − (B D⁻¹ cᵀ)ᵀ.  Of a large rig with more channels than unknowns, one solve per input and unknown does.
    """
    return _transfer_dense(view, p) if small(view.model) else _transfer_sparse(view, p)


def calibrated_transfer(view: ObservationModel, psi: Real, sign: Real) -> Transfer | ReducedTransfer:
    """The same with calibrations, at ψ (..., M) and signs (..., channels); of the reduced rig where there is one."""
    theta, rig = psi[..., : view.m], view.reduced
    known: Transfer | ReducedTransfer = (
        transfer(view, view.model.parameters(theta)) if rig is None else rig.transfer(view, theta)
    )
    if not (view.gains or view.delays) and np.all(sign == 1):
        return known
    return known.calibrated(calibration_factors(view, psi, sign)[..., None], psi)


def small(model: Model) -> bool:
    """Whether stacks of full matrices beat factorisations of the sparse pattern."""
    return model.n < SPARSE_FROM


def slopes_by_unknown(model: Model, channels: Sequence[Channel]) -> bool:
    """Whether `transfer` solves for the motions by each input and unknown, far fewer than the channels."""
    return not small(model) and 2 * len(model.inputs) * len(model.unknowns) < len(channels)


def _transfer_dense(view: ObservationModel, p: Real) -> Transfer:
    model, r = view.model, view.model.D.shape[1]
    lead = (*p.shape[:-1], len(view.omega))
    C_x, C_q = view.direct_x, view.direct_q
    if view.has_forces:
        rows = view.force * (p[..., None, :] * view.factors)[..., None, :]
        C_x = C_x + rows @ model.B
        C_q = np.broadcast_to(C_q, (*lead, *C_q.shape[-2:])).copy()
        C_q[..., :r] += rows @ model.D
    C_x = np.broadcast_to(C_x, (*lead, *C_x.shape[-2:]))
    both = stiffness(model, p, view.omega, view.experiment)
    S = np.broadcast_to(model.S.astype(np.complex128), (*lead, *model.S.shape))
    sides = [np.swapaxes(C_x, -1, -2), -both[..., model.n :], S]
    solved = solve_small(both[..., : model.n], np.concatenate(sides, axis=-1))
    adjoint, X = solved[..., : len(view.channels)], solved[..., len(view.channels) :]
    return Transfer(view, C_q + C_x @ X, X, view.force - np.swapaxes(model.B @ adjoint, -1, -2))


def _transfer_sparse(view: ObservationModel, p: Real) -> Transfer:
    model = view.model
    B, D, T, lines, channels = model.sparse_B, model.D, model.sparse_T, len(view.omega), len(view.channels)
    Bt, on_x, force = B.T.tocsr(), sparse.csr_array(view.on_x), sparse.csr_array(view.force)
    flat = p.reshape(-1, p.shape[-1])
    r, S = D.shape[1], model.S.astype(np.complex128)
    forward = slopes_by_unknown(model, view.channels)
    G = np.empty((len(flat), lines, channels, r + S.shape[1]), dtype=np.complex128)
    X = np.empty((len(flat), lines, model.n, r + S.shape[1]), dtype=np.complex128)
    E = np.empty((len(flat), lines, channels, 0 if forward else len(model.elements)), dtype=np.complex128)
    by_theta = np.empty((*G.shape, view.m if forward else 0), dtype=np.complex128)
    for line, factors in enumerate(view.factors):
        rates = view.rates[line][:, None]
        for k, weights in enumerate(flat * factors):
            solve, weight = stiffness_solver(model, weights), weights[:, None]
            X[k, line] = solve(np.concatenate([-(Bt @ (weight * D)), S], axis=1))
            delta = B @ X[k, line]
            delta[:, :r] += D
            G[k, line] = rates * (on_x @ X[k, line] + view.on_q) + force @ (weight * delta)
            if not forward:
                adjoint = solve(view.on_x.T * rates.T + Bt @ (weight * view.force.T))
                E[k, line] = view.force - (B @ adjoint).T
                continue
            for j, a in enumerate((factors[:, None] * delta).T):
                pushed = (T * a[:, None]).toarray()
                moved = -solve(Bt @ pushed)
                by_theta[k, line, :, j] = rates * (on_x @ moved) + force @ (weight * (B @ moved) + pushed)
    lead = p.shape[:-1]
    G, X, E, by_theta = (part.reshape(*lead, *part.shape[1:]) for part in (G, X, E, by_theta))
    return Transfer(view, G, X, E, None, by_theta if forward else None)


def _times(rows: Complex, matrix: Real | sparse.csr_array | sparse.csc_array) -> Complex:
    """rows (..., k) times a full or sparse matrix (k, j)."""
    flat: Complex = np.asarray(rows.reshape(math.prod(rows.shape[:-1]), rows.shape[-1]) @ matrix)
    return flat.reshape(*rows.shape[:-1], matrix.shape[1])


# The noise that channels are declared to have, for simulation and design.


def noise_sd(channels: Sequence[Channel], Y: Complex) -> Real:
    """Standard deviation of one sample's noise, SI units of the quantity; `Y` (..., lines, channels) amplitudes.

    Absolute and relative part are independent: √((noise · scale / |sign · gain|)² + (relative_noise |Y|)²).
    """
    floor = np.array([channel.noise * channel.scale / abs(channel.factor) for channel in channels])
    relative = np.array([channel.relative_noise for channel in channels])
    return np.hypot(floor, relative * np.abs(Y))


def with_relative_noise(
    model: Model, channels: Iterable[Channel], level: float, *, drives: bool = False
) -> tuple[Channel, ...]:
    """Channels with noise of sd = level × amplitude of that channel at that frequency and no other (paper eq. 21).

    Channels of the inputs stay as they are unless `drives`.
    """
    return tuple(
        channel
        if measures_input(model, channel) and not drives
        else replace(channel, noise=0.0, relative_noise=level)
        for channel in channels
    )
