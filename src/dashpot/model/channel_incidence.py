"""How channels hang on coordinates, inputs and elements, and which of their calibrations are unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Ints, Real, frozen
from dashpot.channel import Channel, Quantity
from dashpot.errors import DataError
from dashpot.model.network import Model


def channel_incidence(model: Model, channels: Sequence[Channel]) -> tuple[Real, Real, Real]:
    """Factors of the channels on coordinates, on inputs and on element forces; each (channels, …).

    Raises DataError where a channel shows what the rig has not.
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
    for c, channel in enumerate(channels):
        is_force = channel.quantity is Quantity.FORCE
        for name, factor in channel.of.items():
            part, column = (forces if is_force else points).get(name, (None, 0))
            if part is not None:
                part[c, column] += factor
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


def unknown_calibrations(channels: Sequence[Channel]) -> tuple[Ints, Ints]:
    """Index of each channel's unknown gain and delay, −1 where known; (channels,) each.

    Raises DataError where a channel shares a gain that is known.
    """
    names = {channel.name: c for c, channel in enumerate(channels)}
    gain, delay = np.full(len(channels), -1), np.full(len(channels), -1)
    for c, channel in enumerate(channels):
        if channel.gain is None and channel.same_gain_as is None:
            gain[c] = int(np.max(gain)) + 1
        if channel.delay is None:
            delay[c] = int(np.max(delay)) + 1
    for c, channel in enumerate(channels):
        if channel.same_gain_as is not None:
            owner = names.get(channel.same_gain_as)
            if owner is None or gain[owner] < 0:
                raise DataError(
                    f"channel {channel.name} shares the gain of {channel.same_gain_as}, which has no unknown gain",
                    cure='name a channel with gain = "unknown"',
                )
            gain[c] = gain[owner]
    return frozen(gain, np.int64), frozen(delay, np.int64)
