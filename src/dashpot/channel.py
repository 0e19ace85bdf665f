"""What a measured channel is: a quantity of a point, of a combination of points, or of an element."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from dashpot.arrays import Ints
from dashpot.errors import UsageError
from dashpot.unknowns import Unknown

RESERVED_NAMES = ("time_s", "frequency_hz", "experiment")  # columns of data files that no channel can be


class Quantity(StrEnum):
    """What is measured.  Displacement, velocity and acceleration are derivatives 0, 1, 2 of the same motion."""

    DISPLACEMENT = "displacement"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    FORCE = "force"

    @property
    def derivative(self) -> int:
        """How often the displacement is differentiated (motions only)."""
        return MOTIONS.index(self)


MOTIONS = (Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION)


@dataclass(frozen=True)
class Channel:
    """One channel, and how its raw values relate to the physical quantity in SI units.

    raw(t) · scale = sign · gain · quantity(t − delay).  Known calibrations are removed when raw values
    become a Spectrum.  `gain`, `delay` or `sign` None means unknown: it is estimated with the parameters.  `gain_prior`
    and `delay_prior` hold what is known of an unknown gain or delay beforehand, and its name in results; channels whose
    priors have the same name share one unknown.

    `name` is the column in data files, `unit` the unit of the raw values, and `scale` that unit in SI.
    `of` maps points (coordinates, displacement inputs) to factors.  With quantity "force", `of` names one force
    input (the applied force), one displacement input (the reaction force that moves it) or elements (the force in
    them).  `noise` (in `unit`) and `relative_noise` (of the amplitude) are standard deviations of one sample, `rate`
    is in Hz; they are used in simulation and design, never in identification.  `same_gain_as` names the channel whose
    unknown gain this one shares (the same amplifier in another experiment).  `only` names the one experiment of the
    rig file that the channel belongs to; there it replaces the channel with the same column name.
    `stated` is the unit that the data themselves state, in a heading or a file's description of the channel.
    """

    name: str
    of: Mapping[str, float]
    quantity: Quantity = Quantity.DISPLACEMENT
    unit: str = ""
    scale: float = 1.0
    gain: float | None = 1.0
    delay: float | None = 0.0
    sign: float | None = 1.0
    noise: float = 0.0
    relative_noise: float = 0.0
    rate: float | None = None
    same_gain_as: str | None = None
    gain_prior: Unknown | None = None
    delay_prior: Unknown | None = None
    only: str | None = None
    stated: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "of", MappingProxyType(dict(self.of)))
        except (TypeError, ValueError):
            cure = 'give points with factors, such as {"x1": 1}'
            raise UsageError(f"channel {self.name} measures {self.of!r}", cure=cure) from None

    @property
    def column(self) -> str:
        """Name of its column in data files."""
        return self.name if self.only is None else self.name.removesuffix(f"@{self.only}")

    @property
    def factor(self) -> float:
        """Known sign · gain, with 1 for unknown ones: raw · scale = factor · quantity."""
        return (1.0 if self.gain is None else self.gain) * (1.0 if self.sign is None else self.sign)

    @property
    def unknown_gain(self) -> Unknown | None:
        """The gain that is estimated; None if it is known."""
        if self.gain is not None and self.same_gain_as is None:
            return None
        return self.gain_prior or Unknown(f"{self.same_gain_as or self.name}.gain", "1")

    @property
    def unknown_delay(self) -> Unknown | None:
        """The delay that is estimated, s; None if it is known."""
        return None if self.delay is not None else self.delay_prior or Unknown(f"{self.name}.delay", "s")

    def without_prior(self, name: str) -> Channel:
        """The channel with nothing known beforehand of the calibration of this name."""
        gain, delay = (
            Unknown(prior.name, prior.unit) if prior is not None and prior.name == name else prior
            for prior in (self.gain_prior, self.delay_prior)
        )
        return replace(self, gain_prior=gain, delay_prior=delay)

    def __reduce__(self) -> tuple[object, ...]:
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return Channel, tuple((values | {"of": dict(self.of)}).values())

    def __hash__(self) -> int:
        return hash((self.name, tuple(self.of.items()), self.quantity, self.unit))


# Experiments in which a rig or its channels are otherwise, and the numbers by which data say which one they are of.
#
# A line or a record has one number, `experiment`: which run it is of (0, 1, 2, … in the order of the files), and, in
# the digits above those, which experiment of the rig file that run belongs to, 0 where it is none.


RUNS = 2**32  # runs that numbers of data may count; what is above tells the experiment of the rig file


@dataclass(frozen=True)
class Experiment:
    """One experiment of a rig file.

    name      which a column `experiment` may hold, or a manifest
    data      patterns of the names of its files
    channels  of the rig that are calibrated otherwise, each as a channel `only` of this experiment
    """

    name: str
    data: tuple[str, ...] = ()
    channels: tuple[Channel, ...] = ()


def kind_of(experiment: Ints) -> Ints:
    """Number from 1 of the experiment of the rig file that lines are of, (lines,), 0 of none."""
    return np.asarray(experiment) // RUNS


def numbered(kind: int, run: int) -> int:
    """The number of a run of the experiment of that number."""
    return kind * RUNS + run % RUNS


def channels_of(channels: Sequence[Channel], experiment: str | None) -> tuple[Channel, ...]:
    """Those of all channels of a rig that there are in an experiment, None: in none of the rig file.

    A channel that is the experiment's own takes the place of the one whose column it is.
    """
    own = {channel.column: channel for channel in channels if experiment and channel.only == experiment}
    return tuple(own.get(channel.name, channel) for channel in channels if channel.only is None)
