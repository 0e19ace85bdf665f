"""Record: one stretch of sampled channels; the known sign, gain and delay of channels as factors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar, cast

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, freeze, without_denormals
from dashpot.channel import Channel
from dashpot.errors import DataError
from dashpot.notices import Notice
from dashpot.shorthand import InNotebooks

# Samples that rest at the greatest or least value of a channel: a converter or amplifier at its limit.


def samples_at_limit(values: Real) -> int:
    """How many samples (samples,) are at the greatest or the least value, where three in a row are."""
    return int(np.count_nonzero(at_limits(values)))


ALIKE = 3  # samples at a limit of a channel in which no two others are alike


def at_limits(values: Real, *, with_steps: bool = False) -> Bools:
    """Which samples are at the greatest value, and which at the least, where those are limits: (2, samples).

    with_steps: those on which a coarse converter turns count, too; the motion around has to tell them apart.
    """
    limits = np.zeros((2, len(values)), dtype=bool)
    if not len(values) or np.ptp(values) == 0:
        return limits
    for side, signed in enumerate((values, -values)):
        limit = np.max(signed)
        at = signed == limit
        count = int(np.count_nonzero(at))
        # A value that half of all samples have is where the channel rests.
        if count < 3 or count > 0.5 * len(values):
            continue
        if not (with_steps or np.any(at[2:] & at[1:-1] & at[:-2])):  # three follow each other nowhere
            continue
        median = float(np.median(signed[:: 1 + (len(values) >> 20)]))  # of a million samples, evenly spread
        # 0.5 of the way from the median to the limit, beyond which a sample is loud
        loud = np.count_nonzero(signed > median + 0.5 * (limit - median)) if limit != median else len(values)
        following = np.max(signed, where=~at, initial=np.min(signed))
        # 8: times as many samples as at the value next to the limit: fewer are the steps of a converter
        many = with_steps or count >= 8 * np.sum(signed == following)
        # 1 % of all samples, or of ten times as many as are loud, so that the short blows of a hammer count, too
        if many and count >= 0.01 * min(len(values), 10 * loud):
            limits[side] = at
    return limits


def limits(column: Real) -> Bools:
    """Which samples are at the greatest value, and which at the least, where those may be limits: (2, samples).

    Where values come again elsewhere, as those of a coarse converter and of a sine in step with the sampling do, three
    have to follow each other.  Where no two others are alike, three alike are a limit, and at the other end of a
    channel that has one two are.
    """
    ends = np.stack([column == np.max(column), column == np.min(column)])
    others = column[~np.any(ends, axis=0)]
    if not len(others) or np.ptp(column) == 0:
        return at_limits(column, with_steps=True)
    different = len(np.unique(np.round(others / np.ptp(column), 9)))  # but for rounding
    # 0.9 of the other samples, all of different values: then two alike at a limit are no chance
    if different <= 0.9 * len(others):
        return at_limits(column, with_steps=True)
    counts = np.count_nonzero(ends, axis=1)
    limited: Bools = (counts >= ALIKE) | ((counts >= 2) & (np.max(counts) >= ALIKE))
    return np.asarray(ends & limited[:, None])


def runs_of_one_value(column: Real, shortest: int) -> Iterator[tuple[int, int]]:
    """Begin and end of each run of one number in a channel (samples,), of so many samples at the least."""
    edges = np.flatnonzero(np.diff(column) != 0) + 1
    begin, end = np.append(0, edges), np.append(edges, len(column))
    long = end - begin >= shortest
    yield from zip(begin[long].tolist(), end[long].tolist(), strict=True)


ABOVE, BELOW, MISSING = 1, -1, 2  # how a value counts that is not measured
T = TypeVar("T")


@dataclass(frozen=True)
class Record(InNotebooks):
    """Samples of all channels on one clock, in SI units.

    time          (samples,)             s, increasing, not necessarily uniform
    values        (..., samples, channels)  SI units; gain, sign and delay of the channels are still in them
    frequency_hz  drive frequency of a stepped-sine dwell, None for other records
    experiment    which experiment the record belongs to
    source        where it came from, for messages
    sd            (samples, channels), standard deviation of values predicted by an estimate
    status        (samples, channels): 0 measured, ABOVE or BELOW clipped (the signal is at or beyond the value), or
                  MISSING (not used); None if all are measured
    cell          (channels,), step of a converter whose values stand for everything rounded to them, else 0
    """

    channels: tuple[Channel, ...]
    time: Real
    values: Real
    frequency_hz: float | None = None
    experiment: int = 0
    source: str = "record"
    sd: Real | None = None
    status: Ints | None = None
    cell: Real | None = None

    def __repr__(self) -> str:
        driven = "" if self.frequency_hz is None else f", driven at {self.frequency_hz:g} Hz"
        names = ", ".join(channel.name for channel in self.channels)
        return f"<Record {self.source}: {len(self.time)} samples of {names}{driven}>"

    @cached_property
    def kept(self) -> dict[object, object]:
        """Intermediate results that several steps of conditioning share, by key."""
        return {}

    @property
    def step_s(self) -> float:
        """Mean sampling step, s."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    @property
    def duration_s(self) -> float:
        """Time that the samples stand for: the span and one mean step, s."""
        return len(self.time) * self.step_s

    @property
    def stated_hz(self) -> float:
        """The drive frequency, Hz.  Raises DataError where there is none."""
        if self.frequency_hz is None:
            raise DataError(
                "the drive frequency is not known", self.source, "give the frequency of the record"
            )
        return self.frequency_hz

    @property
    def periods(self) -> float:
        """Periods of the drive; 0 without a frequency."""
        return 0.0 if self.frequency_hz is None else self.frequency_hz * self.duration_s

    def notice(self, code: str, text: str) -> Notice:
        """A notice of this record."""
        return Notice(code, f"{self.source}: {text}", (self.source,))

    def part(self, rows: slice) -> Record:
        """The record with some of its samples only."""
        some = replace(self, time=self.time[rows], values=self.values[..., rows, :], sd=None, status=None)
        if self.sd is None and self.status is None:
            return some
        sd = None if self.sd is None else self.sd[rows]
        return replace(some, sd=sd, status=None if self.status is None else self.status[rows])

    def marks(self) -> Ints:
        """How each value counts, as `status`, to be changed, (samples, channels)."""
        return np.zeros(self.values.shape, dtype=np.int64) if self.status is None else np.array(self.status)

    @property
    def whole_channels(self) -> Bools:
        """(channels,): whether every sample is measured."""
        if self.status is None:
            return np.ones(len(self.channels), dtype=bool)
        whole: Bools = ~np.any(self.status, axis=0)
        return whole

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "channels", tuple(self.channels))
            object.__setattr__(self, "values", without_denormals(self.values, -2))
            freeze(self)
        except (TypeError, ValueError):
            cure = "give Channels, times (samples,) and values (samples, channels)"
            raise DataError("channels, time or values are no arrays of numbers", self.source, cure) from None
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
                "remove the gap, or fill it",
            )


def kept(find: Callable[[Record], T]) -> Callable[[Record], T]:
    """What several steps of conditioning ask of a record: found once, kept with it."""

    def found(record: Record) -> T:
        if find not in record.kept:
            record.kept[find] = find(record)
        return cast("T", record.kept[find])

    return found


def _all_finite(values: Real) -> bool:
    """Whether all are finite, without an array as large as they are."""
    return not values.size or bool(np.isfinite(np.min(values)) and np.isfinite(np.max(values)))


def calibration(channels: Sequence[Channel], frequency_hz: Real) -> Complex:
    """Factors that turn raw amplitudes into the quantity, (lines, channels): e^{jωτ} / (sign · gain).

    What is unknown stays in.  Raises DataError for a gain or sign of zero.
    """
    h = np.ones((len(frequency_hz), len(channels)), dtype=complex)
    for i, channel in enumerate(channels):
        h[:, i] /= real_factor(channel)
        if channel.delay is not None and channel.delay != 0:
            h[:, i] *= np.exp(2j * np.pi * frequency_hz * channel.delay)
    return h


def calibrated(
    channels: Sequence[Channel], frequency_hz: Real, X: Complex, V: Complex
) -> tuple[Complex, Complex]:
    """Amplitudes (lines, channels) and their covariance (lines, channels, channels) with what is known taken out."""
    h = calibration(channels, frequency_hz)
    return X * h, V * h[:, :, None] * np.conj(h)[:, None, :]


def real_factor(channel: Channel) -> float:
    """Known sign · gain.  Raises DataError if it is 0 or not finite."""
    factor = channel.factor
    if factor == 0 or not np.isfinite(factor):
        raise DataError(
            f"channel {channel.name} has gain · sign = {factor:g}", cure="give a factor other than zero"
        )
    return factor
