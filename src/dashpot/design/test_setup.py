"""The test setup: a rig, its sensors and its shaker, and the information in one sample at any frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, freeze, frozen, hermitian
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError, ModelError, UsageError
from dashpot.estimate.nonlinear.dwells import FEWEST, DwellLines, WarmStart
from dashpot.estimate.nonlinear.objective import Evaluated, NonlinearPart, evaluate
from dashpot.model.modes import modes
from dashpot.model.network import Model
from dashpot.model.observation import (
    calibration_names,
    calibration_slopes,
    channel_unit,
    input_channels,
    measures_input,
    noise_sd,
    observation_model,
    transfer,
)

# Fisher information of dwells of rigs with nonlinear elements: harmonics of the settled motion at a given
# drive.


ORDERS = 5  # harmonics that are measured
EXACT = 1e-9  # of the largest amplitude: noise of inputs without noise beside noisy ones


def dwell_information(
    model: Model, theta: Real, channels: Sequence[Channel], omega: Real, drive: Complex
) -> Real:
    """What one sample of each dwell tells about ψ, (scenarios, dwells, parameters, parameters), SI units of ψ.

    theta (scenarios, unknowns), omega (dwells,), drive (dwells, r + s).  N samples give the amplitude of each harmonic
    a covariance 4 R / N.  A dwell without a settled motion, or on a fold, tells nothing.  Raises UsageError for a
    channel of motion without noise.
    """
    moving = np.array([not measures_input(model, channel) for channel in channels])
    exact = [
        c.name for c, moves in zip(channels, moving, strict=True) if moves and not c.noise + c.relative_noise
    ]
    if exact:
        raise UsageError(
            f"channel {exact[0]} has no noise, which makes its information infinite",
            cure="state its noise (or relative_noise) in the rig file, or leave the channel out",
        )
    noisy = any(
        c.noise + c.relative_noise > 0 for c, moves in zip(channels, moving, strict=True) if not moves
    )
    at = _evaluated(model, theta, channels, omega, drive, noisy)
    K, R = len(theta), len(omega)
    Y = at.predicted.reshape(K, R, ORDERS, -1)
    sd = noise_sd(channels, Y[:, :, 0])[:, :, None]
    sd = np.maximum(sd, EXACT * np.max(np.abs(Y), axis=(1, 2), keepdims=True))
    A = _rows(at.J.reshape(*Y.shape, -1), sd)
    B = _rows(at.G.reshape(*Y.shape, -1), sd) if noisy else A[..., :0]
    finite = np.all(np.isfinite(A), axis=(2, 3)) & np.all(np.isfinite(B), axis=(2, 3))  # not so on a fold
    settled = (finite & at.converged.reshape(K, R))[..., None, None]
    if noisy:
        A, B = np.where(settled, A, 0.0), np.where(settled, B, 0.0)
        A = A - B @ (np.linalg.pinv(B) @ A)
    return np.where(settled, np.swapaxes(A, -1, -2) @ A, 0.0)


def _evaluated(
    model: Model, theta: Real, channels: Sequence[Channel], omega: Real, drive: Complex, noisy: bool
) -> Evaluated:
    """Channels at the harmonics of all dwells, (scenarios, dwells · ORDERS, channels), and their slopes."""
    dwells, orders = len(omega), np.arange(1, ORDERS + 1)
    smooth = all(e.force_law is None or e.force_law.smooth for e in model.elements)
    lines = DwellLines(
        frozen(omega, np.float64), np.repeat(np.arange(dwells), ORDERS), np.tile(orders, dwells),
        np.tile(orders - 1, dwells), ORDERS, max(FEWEST[smooth], 2 * ORDERS + 1),
    )  # fmt: skip
    view = observation_model(model, channels, np.outer(omega, orders).ravel())
    q = np.zeros((len(theta), dwells * ORDERS, drive.shape[-1]), dtype=np.complex128)
    q[:, ::ORDERS] = drive
    part = NonlinearPart(lines, None, q, np.arange(len(theta)), WarmStart())
    calibrations = np.concatenate([np.ones(view.gains), np.zeros(view.delays)])
    psi = np.concatenate([theta, np.tile(calibrations, (len(theta), 1))], axis=1)
    return evaluate(view, part, psi, np.ones((len(theta), len(channels))), q, None, noisy)


def _rows(slopes: Complex, sd: Real) -> Real:
    """Slopes of real and imaginary parts in standard deviations of one sample, (…, dwells, rows, columns)."""
    scaled = slopes / (np.sqrt(2.0) * sd[..., None])
    both = np.stack([scaled.real, scaled.imag], axis=2)
    return both.reshape(*both.shape[:2], -1, both.shape[-1])


# Fisher information of a planned test, for any linear set of channels (THEORY §4, §6).
#
# A channel is y = C(ω, p) (X, U, f) + noise, force channels included: the force in element i is p_i φ_i
# δ_i, the reaction at a displacement input u is Dᵀ (p ∘ a). With J = ∂Y/∂ψ the information of amplitudes
# with covariance V = E[Δ Δᴴ] is 2 Re Jᴴ V⁻¹ J; inputs that are measured with noise, or not at all, are
# unknowns of each line and are projected out. ψ are the unknowns θ and then the unknown gains and delays of
# the channels, which all lines share.


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
    rows = np.concatenate([J.real, J.imag], axis=-2)
    information: Real = 2 * (np.swapaxes(rows, -1, -2) @ rows)
    return information


def per_sample(channels: Sequence[Channel], seen: Outputs) -> Real:
    """Information that one sample of each line adds, (..., lines, parameters, parameters), in SI units of ψ.

    N samples of a dwell give amplitudes with V = 4 R / N, R the covariance of one sample (white noise, whole periods
    or many).  What the size of relative noise itself tells about the parameters is left out, as the estimators do.
    """
    sd = noise_sd(channels, seen.Y)
    dumb = _without_signal(
        channels, seen, np.any(np.abs(seen.by_parameter) > 0, axis=(*range(seen.Y.ndim - 1), -1))
    )
    # Relative noise of a channel that does not move is no noise, but no signal either: the channel is left out.
    J = np.where(dumb[..., None], 0.0, seen.by_parameter)
    G = np.where(dumb[..., None], 0.0, seen.by_input)
    V = ((4 * sd**2)[..., None] * np.eye(len(channels))).astype(np.complex128)
    return fisher(J, G, V, [channel.name for channel in channels])


def _without_signal(channels: Sequence[Channel], seen: Outputs, sees: Bools | bool) -> Bools:
    """Channels that see the rig move (not only its inputs), have relative noise and are silent at a line."""
    relative = np.array([c.relative_noise > 0 and c.noise == 0 for c in channels])
    return relative & sees & (noise_sd(channels, seen.Y) == 0)


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


UNDAMPED = 1e-7  # damping ratio that is rounding
CHUNK = 300_000  # complex numbers at once: they stay in the cache
LINES = 300_000  # slopes of channels at once, complex numbers: 5 MB, of which there are several copies
SETTLED = 1e-3  # what is left of a transient when a dwell starts


@dataclass(frozen=True)
class ShakerLimits:
    """What the shaker can do at most, as amplitudes in SI units: m, m/s, m/s², N (rad and N·m for angles).

    At a force input they hold for the motion of the point that it drives; the force of a displacement input is the
    reaction of the rig.  None is no limit.
    """

    stroke: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    force: float | None = None

    def __post_init__(self) -> None:
        for name, value in self.given.items():
            if not (np.isfinite(value) and value > 0):
                raise UsageError(f"the limit of {name} is {value:g}", cure="give a positive number")

    @property
    def given(self) -> dict[str, float]:
        """The limits that are there, by name, SI units."""
        every = {
            "stroke": self.stroke,
            "velocity": self.velocity,
            "acceleration": self.acceleration,
            "force": self.force,
        }
        return {name: value for name, value in every.items() if value is not None}

    def use(self, omega: Real, motion: Complex, force: Complex) -> Real:
        """Largest part of a limit that is used, (..., lines), of motion and force (..., lines, inputs), SI units.

        omega (lines,), rad/s.
        """
        X, F = np.abs(motion), np.abs(force)
        w = omega[:, None]
        sizes = {"stroke": X, "velocity": w * X, "acceleration": w**2 * X, "force": F}
        parts = [np.max(sizes[name], axis=-1) / value for name, value in self.given.items()]
        if not parts:
            return np.zeros(X.shape[:-1])
        return np.max(np.stack(parts), axis=0)


@dataclass(frozen=True)
class TestSetup:
    """What stays the same from dwell to dwell.

    theta        (scenarios, unknowns)  values that the unknowns may have; the first is the nominal one
    probability  (scenarios,)           how likely each is; sums to 1
    channels     the sensors, with their noise
    drives       (patterns, r + s)      which inputs move together, and how; scaled to the limits
    amplitude    size of a drive where no limit is given, m or N
    """

    __test__: ClassVar[bool] = False  # pytest takes classes of such a name for tests

    model: Model
    channels: tuple[Channel, ...]
    theta: Real
    probability: Real
    drives: Complex
    limits: ShakerLimits = field(default_factory=ShakerLimits)
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        freeze(self)
        object.__setattr__(self, "channels", tuple(self.channels))
        self.model.require_unknowns()
        if not self.model.inputs:
            raise UsageError("the rig has no input: nothing shakes it", cure="add one under [inputs]")
        if not any(c.noise > 0 or c.relative_noise > 0 for c in self.channels):
            raise UsageError(
                "no channel states its noise",
                cure="add noise or relative_noise to the channels in the rig file",
            )

    @property
    def scenarios(self) -> int:
        """Number of scenarios."""
        return len(self.theta)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of ψ: the unknowns, then the calibrations that are estimated with them."""
        return self.model.unknown_names + calibration_names(self.channels)

    @cached_property
    def p(self) -> Real:
        """Parameters of the elements, (scenarios, elements)."""
        return self.model.parameters(self.theta)

    @cached_property
    def sizes(self) -> Real:
        """What errors are relative to, (scenarios, parameters), SI units: |θ|, 1 for ln gain and where θ is 0."""
        return self.sizes_of(self.theta)

    def sizes_of(self, theta: Real) -> Real:
        """What errors at θ (scenarios, unknowns) are relative to, (scenarios, parameters), SI units."""
        size = np.where(theta == 0, 1.0, np.abs(theta))
        return np.concatenate([size, np.ones((len(size), len(self.names) - size.shape[1]))], axis=1)

    def known(self, information: Real) -> Real:
        """An information (q, q) in SI units of ψ, in parts of the sizes of each scenario, (scenarios, q, q)."""
        return information * self.sizes[:, :, None] * self.sizes[:, None, :]

    def with_channels(self, channels: Sequence[Channel]) -> TestSetup:
        """The same setup with other sensors."""
        return replace(self, channels=tuple(channels))

    def with_scenarios(self, theta: Real, probability: Real | None = None) -> TestSetup:
        """The same setup with other values of the unknowns, theta (scenarios, unknowns), SI units.

        They are equally likely without a probability (scenarios,).
        """
        p = np.full(len(theta), 1 / len(theta)) if probability is None else probability
        return replace(self, theta=theta, probability=p)

    def drive(self, frequency_hz: Real, pattern: Ints) -> Complex:
        """Amplitudes (U, f) of each line, (lines, r + s), SI units: at the first limit met in any scenario.

        frequency_hz and pattern (lines,).  Raises UsageError where the shaker meets none of its limits, DataError where
        a channel shares a gain that is known.
        """
        omega = 2 * np.pi * frequency_hz
        unit = self.drives[pattern]
        if not self.limits.given:
            return self.amplitude * unit
        if len(self.model.nonlinear):
            return self._driven_directly(frequency_hz, unit)
        scale = np.full(len(omega), np.inf)
        step = max(1, CHUNK // max(1, len(omega) * len(self.model.elements) * self.model.n))
        for first in range(0, len(self.p), step):
            seen = outputs(self.model, self.p[first : first + step], (), omega, unit)
            with np.errstate(divide="ignore"):
                use = self.limits.use(omega, np.broadcast_to(seen.motion, seen.force.shape), seen.force)
                scale = np.minimum(scale, 1 / np.max(use, axis=0))
        return _scaled(frequency_hz, unit, scale)

    def _driven_directly(self, frequency_hz: Real, unit: Complex) -> Complex:
        """`drive` of a nonlinear rig, whose motions and reactions are not proportional to it.

        Raises UsageError where a limit holds for such.
        """
        r, omega = len(self.model.displacement_inputs), 2 * np.pi * frequency_hz
        moved = [name for name in self.limits.given if name != "force"]
        if (r < unit.shape[1] and moved) or (r and self.limits.force is not None):
            wrong, right = (moved[0], "force") if r < unit.shape[1] and moved else ("force", "stroke")
            raise UsageError(
                f"the limit of {wrong} holds for what is not proportional to the drive of a nonlinear rig",
                cure=f"state the largest {right}, or the amplitude of the drive",
            )
        motion, force = unit.copy(), unit.copy()
        motion[:, r:], force[:, :r] = 0.0, 0.0
        with np.errstate(divide="ignore"):
            return _scaled(frequency_hz, unit, 1 / self.limits.use(omega, motion, force))

    def seen(self, frequency_hz: Real, pattern: Ints, scenario: int = 0) -> Outputs:
        """What the channels show at each line; frequency_hz and pattern (lines,).

        Raises UsageError as `drive`, DataError where a channel measures what the rig has not.
        """
        drive = self.drive(frequency_hz, pattern)
        return outputs(self.model, self.p[scenario], self.channels, 2 * np.pi * frequency_hz, drive)

    def information(self, frequency_hz: Real, pattern: Ints) -> Real:
        """What one sample at each line tells about ψ in parts of its size, (scenarios, lines, q, q).

        Nothing within 1 % of a resonance that nothing damps: no test can dwell there.  frequency_hz and pattern
        (lines,).  Raises UsageError as `drive`, DataError where a channel measures what the rig has not, ModelError
        where all parameters are 0.
        """
        every = self.per_sample(frequency_hz, self.drive(frequency_hz, pattern))
        for f in self.undamped:
            every[:, np.abs(frequency_hz / f - 1) < 0.01] = 0.0
        return every

    def per_sample(self, frequency_hz: Real, drive: Complex) -> Real:
        """`information` (scenarios, lines, q, q) at a given drive (lines, r + s), SI units, near resonances as well.

        frequency_hz (lines,).  Raises DataError where a channel measures what the rig has not, UsageError where one
        has noise in proportion to an amplitude that is 0.
        """
        omega = 2 * np.pi * frequency_hz
        lines, q = len(omega), len(self.names)
        numbers = max(1, lines * (len(self.channels) * q + len(self.model.elements) * self.model.n))
        step = max(1, CHUNK // numbers)
        parts = [np.zeros((0, lines, q, q))]
        for first in range(0, self.scenarios, step):
            if len(self.model.nonlinear):
                theta = self.theta[first : first + step]
                parts.append(dwell_information(self.model, theta, self.channels, omega, drive))
                continue
            parts.append(self._of_lines(self.p[first : first + step], omega, drive))
        every = np.concatenate(parts)
        every *= self.sizes[:, None, :, None] * self.sizes[:, None, None, :]
        return every

    def _of_lines(self, p: Real, omega: Real, drive: Complex) -> Real:
        """`per_sample` at parameters p (scenarios, elements), some lines at a time: slopes of all would fill memory.

        Where a channel with noise in proportion alone is silent, lines are looked at together: whether it sees the rig
        shows at some.
        """
        each = len(p) * max(len(self.channels) * (len(self.names) + len(self.model.elements)), 1)
        step, parts = max(1, LINES // each), []
        for first in range(0, max(len(omega), 1), step):
            some = slice(first, first + step)
            seen = outputs(self.model, p, self.channels, omega[some], drive[some])
            if step < len(omega) and np.any(_without_signal(self.channels, seen, sees=True)):
                return per_sample(self.channels, outputs(self.model, p, self.channels, omega, drive))
            parts.append(per_sample(self.channels, seen))
        return np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]

    @cached_property
    def undamped(self) -> tuple[float, ...]:
        """Resonances, Hz, that nothing damps in some scenario.  Raises ModelError where all parameters are 0."""
        return tuple(f for f, zeta in self.resonances() if zeta < UNDAMPED)

    @cached_property
    def prior(self) -> Real:
        """Information of parameters that are known with an sd, in parts of their size, (scenarios, q, q)."""
        extra = np.zeros(len(self.names) - len(self.model.unknowns))
        precision = np.concatenate([self.model.prior_precision, extra])
        return (precision * self.sizes**2)[..., None] * np.eye(len(precision))

    def resonances(self) -> list[tuple[float, float]]:
        """(frequency in Hz, damping ratio) of all oscillating modes of all scenarios.

        Raises ModelError where all parameters are 0.
        """
        every = []
        for p in self.p:
            rig = modes(self.model, p)
            for value, f, zeta in zip(rig.eigenvalues, rig.frequency_hz, rig.damping_ratio, strict=True):
                if value.imag > 0:
                    every.append((float(f), float(zeta)))
        return every

    def settling(self) -> float:
        """Time in which the slowest transient falls to 1e-3, s, in the worst scenario.

        Raises UsageError where a mode never dies out, ModelError where all parameters are 0.  Hysteretic dampers damp
        a mode as e^{−Im √… t} near its frequency; a rigid-body motion (a zero eigenvalue) is no vibration and is left
        out.
        """
        slowest = np.inf
        for p in self.p:
            values = modes(self.model, p).eigenvalues
            moving = values[np.abs(values) > 0]
            if moving.size == 0:
                continue
            decay = -moving.real
            if np.any(decay <= 1e-12 * np.abs(moving)):
                f = np.abs(moving[int(np.argmin(decay))]) / 2 / np.pi
                raise UsageError(
                    f"the mode at {f:.4g} Hz never settles: nothing damps it",
                    cure="state the settling time",
                )
            slowest = min(slowest, float(np.min(decay)))
        return float(-np.log(SETTLED) / slowest) if np.isfinite(slowest) else 0.0


def _scaled(frequency_hz: Real, unit: Complex, scale: Real) -> Complex:
    """Drives (lines, r + s) times what brings them to their limits, (lines,).  Raises UsageError where nothing does."""
    if not np.all(np.isfinite(scale)):
        line = int(np.argmin(np.isfinite(scale)))
        raise UsageError(
            f"at {frequency_hz[line]:.4g} Hz the shaker meets none of its limits",
            cure="give its stroke too",
        )
    return unit * (scale * (1 - 1e-12))[:, None]


def drive_units(model: Model) -> dict[str, str]:
    """SI units of the inputs by name: m or rad of those that are moved, N or N·m of forces."""
    return {channel.name: channel_unit(model, channel) for channel in input_channels(model)}


def drive_patterns(model: Model, chosen: Sequence[str] = ()) -> Complex:
    """Patterns in which the inputs move, (patterns, r + s).

    `chosen` names them: "u" alone, "u,v" together, "u,-v" against each other, "u,v@90" with a phase in degrees.
    Without any: each input alone and, with several, all together; of two also opposed and in quadrature.
    """
    names = [*model.displacement_inputs, *model.force_inputs]
    if chosen:
        return np.array([_pattern(text, names) for text in chosen])
    patterns = list(np.eye(len(names), dtype=complex))
    if len(names) == 2 and len(model.force_inputs) != 1:
        patterns += [np.array([1, factor], dtype=complex) for factor in (1, -1, 1j)]
    elif len(names) > 2 and len({given.kind for given in model.inputs}) == 1:
        patterns.append(np.ones(len(names), dtype=complex))
    return np.array(patterns)


def _pattern(text: str, names: Sequence[str]) -> Complex:
    pattern = np.zeros(len(names), dtype=complex)
    for part in text.split(","):
        word, _, angle = part.strip().partition("@")
        sign = -1.0 if word.startswith("-") else 1.0
        name = word.removeprefix("-").strip()
        if name not in names:
            raise UsageError(f"the rig has no input {name!r}", cure=f"it has {', '.join(names)}")
        try:
            phase = float(angle) if angle else 0.0
        except ValueError:
            raise UsageError(f"{angle!r} is not an angle", cure='write degrees, such as "u,v@90"') from None
        pattern[names.index(name)] = sign * np.exp(1j * np.deg2rad(phase))
    return pattern


def nominal_setup(
    model: Model,
    channels: Sequence[Channel],
    theta: Real | Mapping[str, float],
    *,
    limits: ShakerLimits | None = None,
    amplitude: float = 1.0,
    drives: Sequence[str] = (),
) -> TestSetup:
    """A setup with one scenario: the nominal values of the unknowns, θ or by name.

    theta (unknowns,), SI units.  Raises ModelError where there are more or fewer values than unknowns, UsageError where
    `drives` or the channels' noise cannot be meant.
    """
    nominal = model.theta(theta) if isinstance(theta, Mapping) else np.asarray(theta, dtype=float)
    if nominal.shape != (len(model.unknowns),):
        raise ModelError(f"{len(model.unknowns)} values are needed, not {nominal.size}")
    return TestSetup(
        model, tuple(channels), nominal[None], np.ones(1), drive_patterns(model, drives),
        ShakerLimits() if limits is None else limits, amplitude,
    )  # fmt: skip
