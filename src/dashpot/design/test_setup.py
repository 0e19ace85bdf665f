"""The test setup: a rig, its sensors and its shaker, and the information in one sample at any frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from dashpot.arrays import Complex, Ints, Real, freeze
from dashpot.channel import Channel
from dashpot.design.harmonic_information import dwell_information
from dashpot.design.information import Outputs, outputs, per_sample
from dashpot.errors import ModelError, UsageError
from dashpot.model.modes import modes
from dashpot.model.network import Model
from dashpot.model.observation import calibration_names, channel_unit, input_channels

UNDAMPED = 1e-7  # damping ratio that is rounding
CHUNK = 300_000  # complex numbers at once: they stay in the cache
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
            "stroke": self.stroke, "velocity": self.velocity, "acceleration": self.acceleration, "force": self.force,
        }  # fmt: skip
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
        most: Real = np.max(np.stack(parts), axis=0)
        return most


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
        relative: Real = information * self.sizes[:, :, None] * self.sizes[:, None, :]
        return relative

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
            seen = outputs(self.model, self.p[first : first + step], self.channels, omega, drive)
            parts.append(per_sample(self.channels, seen))
        relative: Real = np.concatenate(parts) * (self.sizes[:, None, :, None] * self.sizes[:, None, None, :])
        return relative

    @cached_property
    def undamped(self) -> tuple[float, ...]:
        """Resonances, Hz, that nothing damps in some scenario.  Raises ModelError where all parameters are 0."""
        return tuple(f for f, zeta in self.resonances() if zeta < UNDAMPED)

    @cached_property
    def prior(self) -> Real:
        """Information of parameters that are known with an sd, in parts of their size, (scenarios, q, q)."""
        extra = np.zeros(len(self.names) - len(self.model.unknowns))
        precision = np.concatenate([self.model.prior_precision, extra])
        diagonal: Real = (precision * self.sizes**2)[..., None] * np.eye(len(precision))
        return diagonal

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
