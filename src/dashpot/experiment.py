"""Experiments in which a rig or its channels are otherwise, and the numbers by which data say which one they are of.

A line or a record has one number, `experiment`: which run it is of (0, 1, 2, … in the order of the files), and, in the
digits above those, which experiment of the rig file that run belongs to, 0 where it is none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints
from dashpot.channel import Channel

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


def experiment_text(experiments: Sequence[str], experiment: int) -> str:
    """How a line's experiment is called: by name where the rig file has one, else by the number of the run."""
    kind = experiment // RUNS
    return experiments[kind - 1] if 0 < kind <= len(experiments) else str(experiment % RUNS)


def channels_of(channels: Sequence[Channel], experiment: str | None) -> tuple[Channel, ...]:
    """Those of all channels of a rig that there are in an experiment, None: in none of the rig file.

    A channel that is the experiment's own takes the place of the one whose column it is.
    """
    own = {channel.column: channel for channel in channels if experiment and channel.only == experiment}
    return tuple(own.get(channel.name, channel) for channel in channels if channel.only is None)
