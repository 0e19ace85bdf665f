"""Record: one stretch of sampled channels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dashpot.arrays import Real, freeze
from dashpot.channel import Channel
from dashpot.errors import DataError
from dashpot.shorthand import InNotebooks


@dataclass(frozen=True)
class Record(InNotebooks):
    """Samples of all channels on one clock, in SI units.

    time          (samples,)             s, increasing, not necessarily uniform
    values        (..., samples, channels)  SI units; gain, sign and delay of the channels are still in them
    frequency_hz  the drive frequency of a stepped-sine dwell, None where it is not one
    experiment    which experiment the record belongs to
    source        where it came from, for messages
    """

    channels: tuple[Channel, ...]
    time: Real
    values: Real
    frequency_hz: float | None = None
    experiment: int = 0
    source: str = "record"

    def __repr__(self) -> str:
        driven = "" if self.frequency_hz is None else f", driven at {self.frequency_hz:g} Hz"
        names = ", ".join(channel.name for channel in self.channels)
        return f"<Record {self.source}: {len(self.time)} samples of {names}{driven}>"

    @cached_property
    def kept(self) -> dict[object, object]:
        """What several steps of conditioning ask of the samples, by what was asked."""
        return {}

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", tuple(self.channels))
        freeze(self)
        if self.values.shape[-2:] != (len(self.time), len(self.channels)):
            raise DataError(
                f"values of shape {self.values.shape} do not fit {len(self.time)} samples "
                f"of {len(self.channels)} channels",
                self.source,
            )
        if not _all_finite(self.time):
            raise DataError(
                f"the time is not finite at row {int(np.argmin(np.isfinite(self.time))) + 1}", self.source
            )
        back = self.time[1:] <= self.time[:-1]
        if np.any(back):
            row = int(np.argmax(back)) + 2
            raise DataError(
                f"the time does not increase at row {row}", self.source, "sort the rows or split the record"
            )
        if not _all_finite(self.values):
            row, column = (int(k) for k in np.argwhere(~np.isfinite(self.values))[0][-2:])
            raise DataError(
                f"{self.channels[column].name} is not finite at row {row + 1}",
                self.source,
                "cut the gap out or fill it",
            )


def _all_finite(values: Real) -> bool:
    """Whether all are finite, without an array as large as they are."""
    return not values.size or bool(np.isfinite(np.min(values)) and np.isfinite(np.max(values)))
