"""The test setup: a rig, its sensors and its shaker, where it may dwell, and what a sample there tells (THEORY §4, §6).

A channel is y = C(ω, p) (X, U, f) + noise, force channels included: the force in element i is p_i φ_i δ_i, the reaction
at a displacement input u is Dᵀ (p ∘ a).  With J = ∂Y/∂ψ the information of amplitudes with covariance V = E[Δ Δᴴ] is
2 Re Jᴴ V⁻¹ J; inputs that are measured with noise, or not at all, are unknowns of each line and are projected out.
ψ are the unknowns θ and then the unknown gains and delays of the channels, which all lines share.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from dashpot.arrays import Complex, Frozen, Ints, Real, freeze, frozen, hermitian, is_diagonal
from dashpot.channel import Channel
from dashpot.errors import DataError, ModelError, UsageError
from dashpot.estimate.nonlinear.objective import FEWEST, DwellLines, NonlinearPart, WarmStart, evaluate
from dashpot.model.modes import eigenmodes
from dashpot.model.network import Model
from dashpot.model.observation import (
    calibration_factors,
    calibration_slopes,
    channel_unit,
    input_channels,
    measures_input,
    noise_sd,
    nominal_calibrations,
    observation_model,
    slopes_by_unknown,
    transfer,
    unknown_calibrations,
)
from dashpot.model.rigfile.rig import ShakerLimits
from dashpot.unknowns import Unknown, prior_precision

CHUNK = 300_000  # complex numbers at once: they stay in the cache
UNDAMPED = 1e-7  # damping ratio that is rounding
ORDERS = 5  # harmonics of a nonlinear rig's motion that are measured

Robustness = Literal["average", "worst"]


def _without_noise(name: str) -> UsageError:
    return UsageError(
        f"channel {name} has no noise, which makes its information infinite",
        cure="state its noise (or relative_noise) in the rig file, or leave the channel out",
    )


# Rigs with nonlinear elements: harmonics of the settled motion at a given drive.


def dwell_information(
    model: Model, theta: Real, channels: Sequence[Channel], omega: Real, drive: Complex
) -> Real:
    """What one sample of each dwell tells about ψ, (scenarios, dwells, parameters, parameters), SI units of ψ.

    theta (scenarios, unknowns), omega (dwells,), drive (dwells, r + s).  N samples give the amplitude of each harmonic
    a covariance 4 R / N.  A dwell without a settled motion, or on a fold, tells nothing.  Raises UsageError for a
    channel of motion without noise.
    """
    K, R, orders = len(theta), len(omega), np.arange(1, ORDERS + 1)
    noisy_inputs = False
    for channel in channels:
        noisy = channel.noise + channel.relative_noise > 0
        if measures_input(model, channel):
            noisy_inputs |= noisy
        elif not noisy:
            raise _without_noise(channel.name)
    smooth = all(e.force_law is None or e.force_law.smooth for e in model.elements)
    lines = DwellLines(
        frozen(omega, np.float64),
        np.repeat(np.arange(R), ORDERS),
        np.tile(orders, R),
        np.tile(orders - 1, R),
        ORDERS,
        max(FEWEST[smooth], 2 * ORDERS + 1),
    )
    view = observation_model(model, channels, np.outer(omega, orders).ravel())
    q = np.zeros((K, R * ORDERS, drive.shape[-1]), dtype=np.complex128)
    q[:, ::ORDERS] = drive
    psi = np.concatenate([theta, np.tile(view.nominal_calibrations, (K, 1))], axis=1)
    part = NonlinearPart(lines, None, q, np.arange(K), WarmStart())
    at = evaluate(view, part, psi, np.ones((K, len(channels))), q, None, noisy_inputs)
    Y = at.predicted.reshape(K, R, ORDERS, -1)
    sd = noise_sd(channels, Y[:, :, 0])[:, :, None]
    # Next to noisy inputs, those without noise are given almost none.
    sd = np.maximum(sd, 1e-9 * np.max(np.abs(Y), axis=(1, 2), keepdims=True))
    gains = view.nominal_calibrations[: view.gains]
    J = at.J * np.concatenate([np.ones(view.m), gains, np.ones(view.delays)])  # gains as ∂/∂ ln gain
    A = _rows(J.reshape(*Y.shape, -1), sd)
    B = _rows(at.G.reshape(*Y.shape, -1), sd) if noisy_inputs else A[..., :0]
    finite = np.all(np.isfinite(A), axis=(2, 3)) & np.all(np.isfinite(B), axis=(2, 3))  # not so on a fold
    settled = (finite & at.converged.reshape(K, R))[..., None, None]
    if noisy_inputs:
        A, B = np.where(settled, A, 0.0), np.where(settled, B, 0.0)
        A = A - B @ (np.linalg.pinv(B) @ A)
    return np.where(settled, np.swapaxes(A, -1, -2) @ A, 0.0)


def _rows(slopes: Complex, sd: Real) -> Real:
    """Slopes of real and imaginary parts in standard deviations of one sample, (…, dwells, rows, columns)."""
    scaled = slopes / (np.sqrt(2.0) * sd[..., None])
    both = np.stack([scaled.real, scaled.imag], axis=2)
    return both.reshape(*both.shape[:2], -1, both.shape[-1])


# Linear rigs, with any set of channels.


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

    Raises DataError if a channel measures something that the rig lacks.
    """
    r = len(model.displacement_inputs)
    view = observation_model(model, channels, omega)
    rig = transfer(view, p)
    if view.gains or view.delays:
        nominal = np.concatenate([np.zeros(view.m), view.nominal_calibrations])
        kappa = calibration_factors(view, nominal, np.ones(len(channels)))
        rig = replace(rig.calibrated(kappa[..., None], nominal), psi=None)
    q = np.broadcast_to(drive, (*np.broadcast_shapes(rig.X.shape[:-2], drive.shape[:-1]), drive.shape[-1]))
    Y = rig.amplitudes(q)
    relative = np.ones(view.m + view.gains + view.delays)
    by_parameter = np.concatenate([rig.slopes(q), calibration_slopes(view, relative, Y)], axis=-1)
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

    J (..., lines, channels, parameters), G (..., lines, channels, inputs), V (..., lines, channels, channels), or the
    variances (..., lines, channels, 1) of independent noise.  A channel with zero variance is exact: it must not depend
    on the parameters (it fixes inputs).  Rows of zeros are no measurement.  Raises UsageError for an exact channel that
    depends on them; `names` are the channels'.
    """
    lead = np.broadcast_shapes(*(part.shape[:-2] for part in (J, G, V)))
    flat = [np.broadcast_to(part, (*lead, *part.shape[-2:])) for part in (J, G, V)]
    J, G, V = (part.reshape(math.prod(lead), *part.shape[-2:]) for part in flat)
    silent = ~np.any(J != 0, axis=-1) & ~np.any(G != 0, axis=-1)
    exact = (_variances(V) == 0) & ~silent
    kinds = np.concatenate([exact, silent], axis=-1)
    total = np.zeros((len(J), J.shape[-1], J.shape[-1]))
    for kind in (
        kinds[:1] if np.all(kinds == kinds[:1]) else np.unique(kinds, axis=0)
    ):  # lines that measure alike
        fixing, unused = np.split(kind, 2)
        noisy = ~(fixing | unused)
        alike = np.flatnonzero(np.all(kinds == kind, axis=-1))
        part, inputs = J[alike], G[alike]
        each = np.max(np.abs(part), axis=(0, 2), initial=0.0)
        if np.any(each[fixing] > 1e-9 * np.max(each)):
            raise _without_noise(names[int(np.argmax(np.where(fixing, each, -1.0)))])
        # Orthonormal directions of the inputs that exact channels leave free, (lines, inputs, directions)
        E = inputs[:, fixing]
        alone = E.shape[-1]
        if E.shape[-2] == 0 or alone == 0:
            free = np.broadcast_to(np.eye(alone, dtype=complex), (len(E), alone, alone))
        else:
            size = np.max(np.abs(E), axis=-1, keepdims=True)
            _, s, Vh = np.linalg.svd(E / np.where(size > 0, size, 1.0), full_matrices=True)
            rank = int(np.min(np.sum(s > 1e-9, axis=-1)))
            free = hermitian(Vh[:, rank:])
        W = V[alike][:, noisy]
        W = W if W.shape[-1] == 1 else W[:, :, noisy]
        total[alike] = _projected(part[:, noisy], inputs[:, noisy] @ free, W)
    return total.reshape(*lead, *total.shape[1:])


def _variances(V: Complex) -> Real:
    """(..., channels) of `fisher`'s V."""
    variances: Real = (V[..., 0] if V.shape[-1] == 1 else np.diagonal(V, axis1=-2, axis2=-1)).real
    return variances


def _projected(J: Complex, G: Complex, V: Complex) -> Real:
    """2 Re Jᴴ V⁻¹ J without the part that G explains."""
    sd = np.sqrt(_variances(V))
    J, G = J / sd[..., None], G / sd[..., None]
    if not is_diagonal(V):
        try:
            root = np.linalg.cholesky(V / (sd[..., :, None] * sd[..., None, :]))
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
    return 2 * (np.swapaxes(rows, -1, -2) @ rows)


def per_sample(model: Model, channels: Sequence[Channel], seen: Outputs) -> Real:
    """Information that one sample of each line adds, (..., lines, parameters, parameters), in SI units of ψ.

    N samples of a dwell give amplitudes with V = 4 R / N, R the covariance of one sample (white noise, whole periods
    or many).  What the size of relative noise itself tells about the parameters is left out, as the estimators do.
    """
    sd = noise_sd(channels, seen.Y)
    # Relative noise of a channel that does not move is no noise, but no signal either: the channel is left out, except
    # where it shows that an input rests.
    relative = [
        c.relative_noise > 0
        and c.noise == 0
        and (c.gain is None or c.delay is None or not measures_input(model, c))
        for c in channels
    ]
    seeing = (~(np.array(relative) & (sd == 0)))[..., None]
    V = (4 * sd**2)[..., None].astype(np.complex128)
    J, G = np.where(seeing, seen.by_parameter, 0.0), np.where(seeing, seen.by_input, 0.0)
    return fisher(J, G, V, [channel.name for channel in channels])


def drive_at_limits(
    model: Model, p: Real, limits: ShakerLimits, frequency_hz: Real, unit: Complex
) -> Complex:
    """Drives (lines, r + s) in the proportions of `unit`, as large as the shaker can at each frequency.

    p (scenarios, elements); what the first scenario to meet a limit allows.  Of limits by kind, displacement inputs and
    forces have a size each.  Raises UsageError as `TestSetup.drive`.
    """
    omega = 2 * np.pi * frequency_hz
    if limits.by_kind:
        moved = np.arange(unit.shape[1]) < len(model.displacement_inputs)
        motion, force = np.where(moved, unit, 0), np.where(moved, 0, unit)
        sizes = [limits.use(omega, motion, 0 * force), limits.use(omega, 0 * motion, force)]
        use_of = np.where(moved, *(np.where(each > 0, each, 1.0)[:, None] for each in sizes))
        return np.asarray(unit / use_of * (1 - 1e-12))
    if len(model.nonlinear):
        r = len(model.displacement_inputs)
        of_motion = [name for name in limits.given if name != "force"]
        if (r < unit.shape[1] and of_motion) or (r and limits.force is not None):
            wrong, right = (of_motion[0], "force") if r < unit.shape[1] and of_motion else ("force", "stroke")
            raise UsageError(
                f"the limit of {wrong} does not apply to a nonlinear rig, where {wrong} is not proportional to the "
                "drive",
                cure=f"state the largest {right}, or the drive amplitude",
            )
        motion, force = unit.copy(), unit.copy()
        motion[:, r:], force[:, :r] = 0.0, 0.0
        use = limits.use(omega, motion, force)
    else:
        use = np.zeros(len(omega))
        step = max(1, CHUNK // max(1, len(omega) * len(model.elements) * model.n))
        for first in range(0, len(p), step):
            seen = outputs(model, p[first : first + step], (), omega, unit)
            motion = np.broadcast_to(seen.motion, seen.force.shape)
            use = np.maximum(use, np.max(limits.use(omega, motion, seen.force), axis=0))
    if not np.all(use > 0):
        raise UsageError(
            f"at {frequency_hz[int(np.argmin(use > 0))]:.4g} Hz the shaker meets none of its limits",
            cure="give its stroke too",
        )
    return unit * (1 / use * (1 - 1e-12))[:, None]


@dataclass(frozen=True)
class TestSetup:
    """What stays the same from dwell to dwell.

    channels   the sensors, with their noise
    theta      (scenarios, unknowns)  values that the unknowns may have, equally likely; the first is the nominal one
    drives     (patterns, r + s)      which inputs move together, and how; scaled to the limits
    amplitude  size of a drive where no limit is given, m or N
    earlier    (q, q)                 what earlier data tell about ψ, SI units, the rig's priors included; None: these
                                      alone are known
    over       whether the worst of the scenarios counts, or their average
    """

    __test__: ClassVar[bool] = False  # pytest takes classes of such a name for tests

    model: Model
    channels: tuple[Channel, ...]
    theta: Real
    drives: Complex
    limits: ShakerLimits = field(default_factory=ShakerLimits)
    amplitude: float = 1.0
    earlier: Real | None = None
    over: Robustness = "worst"

    def __post_init__(self) -> None:
        freeze(self)
        object.__setattr__(self, "channels", tuple(self.channels))
        self.model.require_unknowns()
        if not self.model.inputs:
            raise UsageError("the rig has no input", cure="add one under [inputs]")
        if not any(c.noise > 0 or c.relative_noise > 0 for c in self.channels):
            raise UsageError(
                "no channel states its noise",
                cure="add noise or relative_noise to the channels in the rig file",
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of ψ: the unknowns, then the calibrations that are estimated with them."""
        return (*self.model.unknown_names, *(unknown.name for unknown in self.calibrations))

    @cached_property
    def calibrations(self) -> tuple[Unknown, ...]:
        """The calibrations that are estimated with the unknowns."""
        return unknown_calibrations(self.channels)

    @cached_property
    def p(self) -> Real:
        """Parameters of the elements, (scenarios, elements)."""
        return self.model.parameters(self.theta)

    @cached_property
    def sizes(self) -> Real:
        """What errors are relative to, (scenarios, parameters), SI units: |θ|, 1 for ln gain and where θ is 0."""
        size = np.where(self.theta == 0, 1.0, np.abs(self.theta))
        return np.concatenate([size, np.ones((len(size), len(self.names) - size.shape[1]))], axis=1)

    def relative(self, information: Real) -> Real:
        """An information (q, q) in SI units of ψ, in parts of the sizes of each scenario, (scenarios, q, q)."""
        return information * self.sizes[:, :, None] * self.sizes[:, None, :]

    @cached_property
    def prior(self) -> Real:
        """What is known before the test, in parts of the sizes, (scenarios, q, q)."""
        if self.earlier is not None:
            return self.relative(self.earlier)
        known = prior_precision((*self.model.unknowns, *self.calibrations)) * self.gains**2
        return (known * self.sizes**2)[..., None] * np.eye(len(known))

    @cached_property
    def gains(self) -> Real:
        """Nominal gains, (q,), whose relative errors count; 1 for all else."""
        nominal = nominal_calibrations(self.calibrations)
        relative = [
            value if u.unit == "1" else 1.0 for u, value in zip(self.calibrations, nominal, strict=True)
        ]
        return frozen([*np.ones(len(self.model.unknowns)), *relative], np.float64)

    def drive(self, frequency_hz: Real, pattern: Ints) -> Complex:
        """Amplitudes (U, f) of each line, (lines, r + s), SI units: at the first limit met in any scenario.

        frequency_hz and pattern (lines,).  Raises UsageError if the shaker meets none of its limits, or one of what
        is not proportional to the drive of a nonlinear rig, DataError if a channel shares a gain that is known.
        """
        unit = self.drives[pattern]
        if not self.limits.given:
            return self.amplitude * unit
        return drive_at_limits(self.model, self.p, self.limits, frequency_hz, unit)

    def seen(self, frequency_hz: Real, pattern: Ints) -> Outputs:
        """What the channels show at each line, at the nominal values; frequency_hz and pattern (lines,).

        Raises UsageError as `drive`, DataError if a channel measures something that the rig lacks.
        """
        drive = self.drive(frequency_hz, pattern)
        return outputs(self.model, self.p[0], self.channels, 2 * np.pi * frequency_hz, drive)

    def information(self, frequency_hz: Real, pattern: Ints) -> Real:
        """What one sample at each line tells about ψ in parts of its size, (scenarios, lines, q, q).

        Nothing within 1 % of a resonance that nothing damps: no test can dwell there.  frequency_hz and pattern
        (lines,).  Raises UsageError as `drive`, DataError if a channel measures what the rig lacks, ModelError
        where all parameters are 0.
        """
        every = self.per_sample(frequency_hz, self.drive(frequency_hz, pattern))
        for f in self._undamped:
            every[:, np.abs(frequency_hz / f - 1) < 0.01] = 0.0
        return every

    @cached_property
    def _undamped(self) -> tuple[float, ...]:
        """Resonances, Hz, that nothing damps in some scenario."""
        return tuple(f for f, zeta in self.resonances() if zeta < UNDAMPED)

    def per_sample(self, frequency_hz: Real, drive: Complex) -> Real:
        """`information` (scenarios, lines, q, q) at a given drive (lines, r + s), SI units, near resonances as well.

        frequency_hz (lines,).  Raises DataError if a channel measures something that the rig lacks, UsageError if one
        has noise in proportion to an amplitude that is 0.
        """
        model, channels, omega = self.model, self.channels, 2 * np.pi * frequency_hz
        lines, q, elements = len(omega), len(self.names), len(self.model.elements)
        scenarios = max(1, CHUNK // max(1, lines * (len(channels) * q + elements * model.n)))
        held = len(model.inputs) * q if slopes_by_unknown(model, channels) else elements
        at_once = max(1, CHUNK // max(1, min(scenarios, len(self.p)) * len(channels) * (q + held)))
        parts = [np.zeros((0, lines, q, q))]
        for first in range(0, len(self.p), scenarios):
            some = slice(first, first + scenarios)
            if len(model.nonlinear):
                parts.append(dwell_information(model, self.theta[some], channels, omega, drive))
                continue
            pieces = [np.zeros((len(self.p[some]), 0, q, q))]
            for line in range(0, lines, at_once):  # the slopes of all lines would fill the memory
                few = slice(line, line + at_once)
                seen = outputs(model, self.p[some], channels, omega[few], drive[few])
                pieces.append(per_sample(model, channels, seen))
            parts.append(np.concatenate(pieces, axis=1))
        every = np.concatenate(parts)
        every *= self.sizes[:, None, :, None] * self.sizes[:, None, None, :]
        return every

    def resonances(self) -> list[tuple[float, float]]:
        """(frequency in Hz, damping ratio) of all oscillating modes of all scenarios.

        Raises ModelError if all parameters are 0.
        """
        every: list[tuple[float, float]] = []
        for p in self.p:
            rig = eigenmodes(self.model, p)
            swinging = rig.eigenvalues.imag > 0
            every += zip(
                rig.frequency_hz[swinging].tolist(), rig.damping_ratio[swinging].tolist(), strict=True
            )
        return every

    def settling(self) -> float:
        """Time in which the slowest transient falls to 1e-3, s, in the worst scenario.

        Raises UsageError if a mode never dies out, ModelError if all parameters are 0.  Hysteretic dampers damp
        a mode as e^{−Im √… t} near its frequency; a rigid-body motion (a zero eigenvalue) is no vibration and is left
        out.
        """
        slowest = np.inf
        for p in self.p:
            values = eigenmodes(self.model, p).eigenvalues
            moving = values[np.abs(values) > 0]
            decay = -moving.real
            if np.any(decay <= 1e-12 * np.abs(moving)):
                f = np.abs(moving[int(np.argmin(decay))]) / 2 / np.pi
                raise UsageError(
                    f"the mode at {f:.4g} Hz never settles: nothing damps it", cure="state the settling time"
                )
            slowest = min(slowest, float(np.min(decay, initial=np.inf)))
        return float(np.log(1e3) / slowest)


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
        patterns = []
        for text in chosen:
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
                    raise UsageError(
                        f"{angle!r} is not an angle", cure='write degrees, such as "u,v@90"'
                    ) from None
                pattern[names.index(name)] = sign * np.exp(1j * np.deg2rad(phase))
            patterns.append(pattern)
        return np.array(patterns)
    patterns = list(np.eye(len(names), dtype=complex))
    if len(names) == 2 and len(model.force_inputs) != 1:
        patterns += [np.array([1, factor], dtype=complex) for factor in (1, -1, 1j)]
    elif len(names) > 2 and len({given.kind for given in model.inputs}) == 1:
        patterns.append(np.ones(len(names), dtype=complex))
    return np.array(patterns)


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

    theta (unknowns,), SI units.  Raises ModelError if there are more or fewer values than unknowns, UsageError if
    `drives` or the channels' noise cannot be meant.
    """
    nominal = model.theta(theta) if isinstance(theta, Mapping) else np.asarray(theta, dtype=float)
    if nominal.shape != (len(model.unknowns),):
        raise ModelError(f"{len(model.unknowns)} values are needed, not {nominal.size}")
    patterns = drive_patterns(model, drives)
    limits = ShakerLimits() if limits is None else limits
    return TestSetup(model, tuple(channels), nominal[None], patterns, limits, amplitude)


# Where a test may dwell, and where it does.


@dataclass(frozen=True)
class FrequencyGrid:
    """Where to look for frequencies: points (g,), with their patterns (g,); `free` lets frequencies move off them."""

    frequency_hz: Real
    pattern: Ints
    free: bool = True

    @property
    def low(self) -> float:
        """Lower end of the band, Hz."""
        return float(np.min(self.frequency_hz))

    @property
    def high(self) -> float:
        """Upper end of the band, Hz."""
        return float(np.max(self.frequency_hz))


def band_grid(setup: TestSetup, low: float, high: float, step: float | None = None) -> FrequencyGrid:
    """Points in low … high (Hz) for every pattern of the drive: multiples of `step`, or about 2 % apart and free.

    Without a step, points crowd around each resonance of each scenario, where lightly damped rigs change fast.
    Raises UsageError for a band that is none.
    """
    if not (np.isfinite(low) and np.isfinite(high) and 0 < low <= high):
        raise UsageError(
            f"{low:g} to {high:g} Hz is not a band", cure="give two positive frequencies, the lower first"
        )
    if step is None:
        f = np.geomspace(low, high, int(np.clip(np.log(high / low) / 0.02, 2, 400)) if high > low else 1)
        widths = np.array([0, 0.3, 0.6, 1, 1.5, 2.2, 3.3, 5, 8])  # half-widths of a resonance, on both sides
        around = np.concatenate([widths, -widths])
        # Resonances that differ by more than half a half-width; at most 60
        kept: list[tuple[float, float]] = []
        for resonance, zeta in sorted(setup.resonances()):
            if not kept or resonance > kept[-1][0] * (1 + max(zeta, 1e-5) / 2):
                kept.append((resonance, zeta))
        if len(kept) > 60:
            kept = [kept[i] for i in np.linspace(0, len(kept) - 1, 60).astype(int)]
        for resonance, zeta in kept:
            if UNDAMPED < zeta < 0.1:  # narrower than the grid resolves
                near = resonance * np.exp(around * max(zeta, 1e-5))
                f = np.concatenate([f, near[(near > low) & (near < high)]])
        f = np.unique(f)
    else:
        if not (np.isfinite(step) and step > 0):
            raise UsageError(f"a grid step of {step:g} Hz", cure="give a positive step")
        count = np.arange(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1)
        if len(count) > 20_000:
            raise UsageError(f"{len(count)} grid points", cure="give a larger step or a narrower band")
        if len(count) == 0:
            raise UsageError(
                f"no multiple of {step:g} Hz lies in {low:g} to {high:g} Hz", cure="give a smaller step"
            )
        f = step * count.astype(float)
    patterns = len(setup.drives)
    return FrequencyGrid(np.tile(f, patterns), np.repeat(np.arange(patterns), len(f)), step is None)


def natural_band(setup: TestSetup, rate: float | None = None) -> tuple[float, float]:
    """A band about the rig's resonances: a fifth of the lowest to three times the highest, Hz, to three digits.

    Raises UsageError if the rig has none.
    """
    resonances = [f for f, _ in setup.resonances()]
    if not resonances:
        raise UsageError("the rig has no resonance to take the band from", cure="state the band")
    high = 3 * max(resonances) if rate is None else min(3 * max(resonances), 0.4 * rate)
    return float(f"{min(0.2 * min(resonances), high / 10):.3g}"), float(f"{high:.3g}")


@dataclass(frozen=True)
class Schedule(Frozen):
    """A test as the information sees it: frequency, pattern of the drive and samples of each line; () is none."""

    frequency_hz: Real
    pattern: Ints
    samples: Real

    def information(self, setup: TestSetup) -> Real:
        """Of all lines together, (scenarios, q, q)."""
        if len(self.frequency_hz) == 0:
            return np.zeros_like(setup.prior)
        each = setup.information(self.frequency_hz, self.pattern)
        return np.einsum("i,siab->sab", self.samples, each)


NO_TEST = Schedule(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0))


def even_schedule(
    frequencies: Sequence[float], samples: float, weights: Sequence[float] | None = None
) -> Schedule:
    """A test of given frequencies that share the samples evenly, or as `weights` say.

    Raises UsageError if there is no frequency, or one is not positive.
    """
    f = np.asarray(frequencies, dtype=float)
    if len(f) == 0:
        raise UsageError(
            "the test to compare with has no frequencies", cure="list them in Hz, such as 1,1.5,2"
        )
    if np.any(~np.isfinite(f) | (f <= 0)):
        raise UsageError("a frequency that is not positive", cure="write frequencies in Hz, such as 1,1.5,2")
    w = np.ones(len(f)) if weights is None else np.asarray(weights, dtype=float)
    return Schedule(f, np.zeros(len(f), dtype=np.int64), samples * w / np.sum(w))
