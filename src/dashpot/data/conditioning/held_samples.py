"""Samples of a whole record in which a channel holds one value, or reads 0, while the motion goes on.

The record is cut there, as it is where samples are missing: what is on either side is used as a record of its own.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Quantity
from dashpot.data.conditioning.dropouts import runs_of_one_value
from dashpot.data.record import Record
from dashpot.io.words import counted, joined
from dashpot.notices import Notice

SHORTEST = 10  # samples of a run
AROUND = 20  # samples on either side that show how the channel moves
RESOLVED = 4.0  # steps of the converter from sample to sample, in rms, of a motion that does not stand still by chance
MOST_RUNS = 5  # in one channel: what rests more often does so for a reason
MOST = 0.1  # of a channel's samples, or those at one value: a channel that rests more is at rest there
SIDES = 64  # samples of a part that is used


def without_held_samples(record: Record) -> tuple[list[Record], tuple[Notice, ...]]:
    """The parts of a record before, between and behind the runs in which channels hold a value, and a note of them.

    Channels of forces are left alone: a drive may hold its value.  Repeats (leading axes) stay as they are.
    """
    if record.values.ndim != 2:
        return [record], ()
    held = np.zeros(len(record.time), dtype=bool)
    names = []
    still = record.values[1:] == record.values[:-1]
    suspect = np.any(still[1:] & still[:-1], axis=0)
    for c, channel in enumerate(record.channels):
        if channel.quantity is Quantity.FORCE or not suspect[c]:
            continue
        runs = _runs_held(record.values[:, c])
        if runs:
            names.append(channel.name)
        for begin, end in runs:
            held[begin:end] = True
    edges = [0, *(np.flatnonzero(np.diff(held)) + 1).tolist(), len(held)]
    parts = [
        replace(record, time=record.time[a:b], values=record.values[a:b])
        for a, b in pairwise(edges)
        if not held[a] and b - a >= SIDES
    ]
    if not names or not parts:
        return [record], ()
    at = record.time[int(np.argmax(held))]
    text = (
        f"{record.source}: {joined(names)} hold{'s' if len(names) == 1 else ''} a value in {int(np.sum(held))} "
        f"samples, first at {at:.6g} s, while the motion goes on: used as {counted(len(parts), 'record')}"
    )
    return parts, (Notice("held_samples", text, tuple(names)),)


def _runs_held(column: Real) -> list[tuple[int, int]]:
    """Begin and end of each run of one value (samples,) that the motion around it does not explain."""
    runs = list(runs_of_one_value(column, SHORTEST))
    values, counts = np.unique(column, return_counts=True)
    resting = values[counts > MOST * len(column)]
    if not 0 < len(runs) <= MOST_RUNS or sum(end - begin for begin, end in runs) > MOST * len(column):
        return []
    if len(resting) or len(values) < 2:
        return []
    step = float(np.min(np.diff(values)))
    inside = (np.array([r[0] for r in runs]) > 0) & (np.array([r[1] for r in runs]) < len(column))
    return [run for run, within in zip(runs, inside, strict=True) if within and _lost(column, *run, step)]


def _lost(column: Real, begin: int, end: int, step: float) -> bool:
    """Whether the channel moves around a run, by more than the steps of its converter hide, as it does not in it."""
    sides = (np.diff(column[max(begin - AROUND, 0) : begin]), np.diff(column[end : end + AROUND]))
    usual = min(float(np.sqrt(np.mean(part**2))) if len(part) else 0.0 for part in sides)
    limit = column[begin] in (column.min(), column.max())
    return not limit and usual > RESOLVED * step
