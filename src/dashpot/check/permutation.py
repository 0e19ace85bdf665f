"""Exchanges of unseen coordinates that a whole rig allows: the data cannot say which is which."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dashpot.channel import Channel
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Model

CANDIDATES = 40  # unseen coordinates looked at

Shape = tuple[Kind, frozenset[tuple[str, float]]]  # of an element


def permutation_ambiguities(model: Model, channels: Sequence[Channel]) -> tuple[tuple[str, str], ...]:
    """Pairs of coordinates that no channel and no force touches, with elements alike whose values are all unknown."""
    hidden = _hidden(model, channels)[:CANDIDATES]
    tied = {e.same_as for e in model.elements} | {e.name for e in model.elements if e.same_as is not None}
    shapes = {_shape(e, e.along) for e in model.elements}
    pairs = []
    for i, first in enumerate(hidden):
        for second in hidden[i + 1 :]:
            moved = [e for e in model.elements if (first in e.along) != (second in e.along)]
            if not moved or any(e.value is not None or e.name in tied for e in moved):
                continue
            swap = {first: second, second: first}
            if all(_has_image(e, swap, shapes) for e in moved):
                pairs.append((first, second))
    return tuple(pairs)


def _hidden(model: Model, channels: Sequence[Channel]) -> list[str]:
    """Coordinates that no channel and no force touches."""
    touched = {point for channel in channels for point in channel.of}
    touched |= {point for given in model.inputs for point in given.at}
    for element in model.elements:
        if element.name in touched:
            touched |= set(element.along)
    return [x for x in model.coordinates if x not in touched]


def _shape(element: Element, along: Mapping[str, float]) -> Shape:
    return element.kind, frozenset(along.items())


def _has_image(element: Element, swap: Mapping[str, str], shapes: set[Shape]) -> bool:
    """Whether the rig has the element that this one becomes when two coordinates are exchanged."""
    image = {swap.get(point, point): factor for point, factor in element.along.items()}
    turned = {point: -factor for point, factor in image.items()}
    return _shape(element, image) in shapes or _shape(element, turned) in shapes
