"""A rig as its file describes it: the model, and the channels that its data are made of."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel, Experiment, Quantity, channels_of
from dashpot.errors import UsageError
from dashpot.io.words import choose_from, counted, listed, shown
from dashpot.model.network import Model
from dashpot.shorthand import InNotebooks, call
from dashpot.units import STANDARD_GRAVITY, scale, si_unit

if TYPE_CHECKING:
    from dashpot.check.identifiability import Structure
    from dashpot.data.readers import Reading
    from dashpot.data.record import Record
    from dashpot.estimate.comparison import Comparison
    from dashpot.estimate.result import Estimate
    from dashpot.export.state_space import StateSpace
    from dashpot.export.transfer_functions import TransferFunctions


@dataclass(frozen=True)
class ShakerLimits:
    """What the shaker can do at most, as amplitudes in SI units: m, m/s, m/s², N (rad and N·m for angles).

    At a force input they hold for the motion of the point that it drives; the force of a displacement input is the
    reaction of the rig.  None is no limit.  Together they limit the amplitude by frequency: the stroke at low ones, the
    velocity, then the acceleration.  `by_kind`: those of motion hold for displacement inputs alone, that of force for
    forces, and each kind has a size of its own.
    """

    stroke: float | None = None
    velocity: float | None = None
    acceleration: float | None = None
    force: float | None = None
    by_kind: bool = False

    def __post_init__(self) -> None:
        for name, value in self.given.items():
            if not (np.isfinite(value) and value > 0):
                raise UsageError(f"the limit of {name} is {value:g}", cure="give a positive number")

    @property
    def given(self) -> dict[str, float]:
        """The limits that are there, by name, SI units."""
        limits = ((name, getattr(self, name)) for name in ("stroke", "velocity", "acceleration", "force"))
        return {name: value for name, value in limits if value is not None}

    def text(self, model: Model) -> str:
        """The limits with their units, "10 mm, 1 g"."""
        units = {
            "stroke": ((1e3, "mm"), (1.0, "rad")),
            "velocity": ((1.0, "m/s"), (1.0, "rad/s")),
            "acceleration": ((1 / STANDARD_GRAVITY, "g"), (1.0, "rad/s²")),
            "force": ((1.0, "N"), (1.0, "N·m")),
        }
        parts = []
        for key, value in self.given.items():
            factor, unit = units[key][drive_is_angular(model, key)]
            parts.append(f"{value * factor:.3g} {unit}")
        return ", ".join(parts)

    def use(self, omega: Real, motion: Complex, force: Complex) -> Real:
        """Largest part of a limit that is used, (..., lines), of motion and force (..., lines, inputs), SI units.

        omega (lines,), rad/s.
        """
        X, F = np.abs(motion), np.abs(force)
        w = omega[:, None]
        sizes = {"stroke": X, "velocity": w * X, "acceleration": w**2 * X, "force": F}
        parts = [np.max(sizes[name], axis=-1) / value for name, value in self.given.items()]
        return np.max(parts, axis=0) if parts else np.zeros(X.shape[:-1])


def usual_limits(model: Model) -> ShakerLimits:
    """What is assumed of a shaker unless stated: 10 mm and 1 g, or 10 N; 0.1 rad and 10 rad/s², or 1 N·m."""
    moved, forced = model.displacement_inputs, [s for s in model.inputs if s.kind == "force"]
    force = (1.0 if drive_is_angular(model, "force") else 10.0) if forced or not moved else None
    if not moved:
        return ShakerLimits(force=force)
    turning = drive_is_angular(model, "displacement")
    stroke, acceleration = (0.1, 10.0) if turning else (0.01, STANDARD_GRAVITY)
    return ShakerLimits(stroke=stroke, acceleration=acceleration, force=force, by_kind=bool(forced))


@dataclass(frozen=True)
class Rig(InNotebooks):
    """A model, the channels that its data files are made of, and the `path` of the file it was read from ("": none).

    within: the share of every channel's motion within which the rig is to describe it; None: what suits the noise.
    experiments: those in which elements or channels are otherwise, in the order of `model.experiments`.
    shaker: what its drive can do at most; None if the file does not say it.
    """

    model: Model
    channels: tuple[Channel, ...]
    path: str = ""
    within: float | None = None
    experiments: tuple[Experiment, ...] = ()
    shaker: ShakerLimits | None = None

    @property
    def all_channels(self) -> tuple[Channel, ...]:
        """The channels, and those that are an experiment's own."""
        return (*self.channels, *(channel for each in self.experiments for channel in each.channels))

    def in_experiment(self, name: str | None = None) -> Rig:
        """The rig as it is in one of its experiments, None: in none of them; a rig that does not differ any more.

        What differs keeps its name, such as m3@added.  Raises UsageError if there is no such experiment.
        """
        if not self.experiments and name is None:
            return self
        standing = self.standing_in(name)
        return replace(standing, model=standing.model.alone)

    def standing_in(self, name: str | None = None) -> Rig:
        """The same with the unknowns of all experiments, as an estimate of all has them.  Raises as `in_experiment`."""
        if name is not None and not self.experiments:
            raise UsageError(f"the rig file has no experiment {name}", cure=f"add [experiments.{name}]")
        names = list(self.model.experiments)
        if name is not None and name not in names:
            raise UsageError(f"there is no experiment {name}", cure=choose_from(names, name))
        model = self.model.standing_in(0 if name is None else names.index(name) + 1)
        other = {element.stands_for: element.name for element in model.present_elements}
        channels = tuple(
            replace(
                channel,
                name=channel.column,
                only=None,
                of={other.get(point, point): factor for point, factor in channel.of.items()},
            )
            for channel in channels_of(self.all_channels, name)
        )
        return replace(self, model=model, channels=channels, experiments=())

    def require_alike(self, doing: str) -> None:
        """Raises UsageError if the rig differs by experiment, which `doing` does not know."""
        if self.experiments:
            what = (
                f"{doing} does not support experiments that differ, and the rig file has "
                f"{listed(self.model.experiments)}"
            )
            raise UsageError(what, self.path or None, "use a rig file without [experiments]")

    def __repr__(self) -> str:
        source = f", from {shown(self.path)}" if self.path else ""
        return f"<Rig {self.model.summary}, {counted(len(self.channels), 'channel')}{source}>"

    def identify(self, data: Any, method: Any = None, **options: Any) -> Estimate:
        """Estimate the unknowns from data, such as the name of a file: `dashpot.identify(rig, data, …)`."""
        return cast("Estimate", call("identify", self, data, method, **options))

    def compare(self, data: Any, methods: Any = None, **options: Any) -> Comparison:
        """Estimate the unknowns with several methods: `dashpot.compare(rig, data, …)`."""
        return cast("Comparison", call("compare", self, data, methods, **options))

    def read(self, paths: Any, *, frequency_hz: float | None = None) -> Reading:
        """Read data files whose columns are the channels: `dashpot.read(paths, rig, …)`."""
        return cast("Reading", call("read", paths, self, frequency_hz=frequency_hz))

    def check(self, data: Any = None, **options: Any) -> Structure:
        """Whether the unknowns can be found from the channels and, with data, from their frequencies."""
        return cast("Structure", call("check", self, data, **options))

    def simulate(
        self, values: Mapping[str, Any], frequencies: Any = None, **options: Any
    ) -> tuple[Record, ...]:
        """The records that the rig would yield with values in SI units: `dashpot.simulate(rig, values, …)`."""
        return cast("tuple[Record, ...]", call("simulate", self, values, frequencies, **options))

    def draw(self, estimate: Estimate | None = None, *, mode: int | None = None) -> Any:
        """The rig as a schematic, which notebooks show and `.save("rig.svg")` writes: `dashpot.draw(rig, …)`."""
        return call("draw", self, estimate, mode=mode)

    def to_state_space(self, source: Any = None, **options: Any) -> StateSpace:
        """The state space with an estimate or values by name: `dashpot.state_space(rig, source, …)`."""
        return cast("StateSpace", call("state_space", self, source, **options))

    def to_transfer_functions(self, source: Any = None, **options: Any) -> TransferFunctions:
        """The transfer functions with an estimate or values: `dashpot.transfer_functions(rig, source, …)`."""
        return cast("TransferFunctions", call("transfer_functions", self, source, **options))

    def export(self, path: Any, source: Any = None, **options: Any) -> tuple[str, ...]:
        """Write the rig for another program, with an estimate or values, by the end of the file's name."""
        return cast("tuple[str, ...]", call("export", self, path, source, **options))


def default_channels(model: Model) -> tuple[Channel, ...]:
    """A channel for every coordinate and input, of its own name, in SI units (rad and N·m for angles)."""
    motions = [
        Channel(point, {point: 1.0}, Quantity.DISPLACEMENT, si_unit("displacement", point in model.angles))
        for point in (*model.coordinates, *model.displacement_inputs)
    ]
    forces = [
        Channel(
            source.name,
            {source.name: 1.0},
            Quantity.FORCE,
            si_unit("force", all_angles(source.at, model.angles)),
        )
        for source in model.inputs
        if source.kind == "force"
    ]
    return (*motions, *forces)


def all_angles(points: Iterable[str], angles: Collection[str]) -> bool:
    """Whether there are points, and all of them are angles."""
    points = list(points)
    return bool(points) and all(point in angles for point in points)


def drive_is_angular(model: Model, quantity: str) -> bool:
    """Whether a force of the drive, or another quantity of its motion, is of a rotation, as `limit_is_angular`."""
    forced = [point for source in model.inputs if source.kind == "force" for point in source.at]
    return limit_is_angular(quantity, model.displacement_inputs, forced, model.angles)


def limit_is_angular(
    quantity: str, moved: Sequence[str], forced: Sequence[str], angles: Collection[str]
) -> bool:
    """Whether a limit of force, or of another quantity, is of a rotation: as all points are that are forced, or moved.

    Where no point is forced the force is the reaction of moved ones; where none is moved the motion is of forced ones.
    """
    own, others = (forced, moved) if quantity == "force" else (moved, forced)
    return all_angles(own or others, angles)


def is_electrical(unit: str, quantity: str) -> bool:
    """Whether a unit is none of the quantity itself but of what a sensor puts out: volts or counts."""
    for uncalibrated in (False, True):
        for angular in (False, True):
            try:
                scale(unit, quantity, angular, uncalibrated)
            except UsageError:
                continue
            return uncalibrated
    return False


def scale_of_points(
    unit: str, quantity: str, along: Mapping[str, float], angles: Collection[str], electrical: bool = False
) -> float:
    """Factor of `unit` to SI for what is stretched along some points.  Raises UsageError.

    Angles alone count in rad, N·m … unless a factor other than ±1, an arm in m, may make a length of them; an angle
    next to a displacement always has an arm.
    """
    if not all_angles(along, angles):
        return scale(unit, quantity, False, electrical)
    try:
        return scale(unit, quantity, True, electrical)
    except UsageError:
        if all(abs(factor) == 1 for factor in along.values()):
            raise
        try:
            return scale(unit, quantity, False, electrical)
        except UsageError:
            pass
        raise
