"""What a diagnosis says: one cause with its remedy, and the rig file as the remedy would have it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dashpot.channel import Channel
from dashpot.model.elements import Element
from dashpot.model.network import Model

# What explains as much and is more particular is named first.
ORDER = (
    "sign",
    "unit",
    "swap",
    "conjugate",
    "quantity",
    "frequency",
    "dwell",
    "delay",
    "gain",
    "value",
    "element",
    "channel",
)


@dataclass(frozen=True)
class Finding:
    """One cause of a misfit.

    `kind` is one of ORDER; `of` names what is meant: the channel, both channels of a swap, the frequency of a dwell,
    the points an element would join; empty where it concerns everything.  `remaining` is χ² over its degrees of
    freedom once the remedy is taken, `number` what was found (a gain, a delay in s, a frequency in Hz, a parameter).
    `channels` and `elements` are the entries of the rig file as they would be; () where the data must be mended.
    """

    kind: str
    of: tuple[str, ...]
    text: str
    change: str
    remaining: float
    number: float | None = None
    channels: tuple[Channel, ...] = ()
    elements: tuple[Element, ...] = ()

    def as_json(self) -> dict[str, object]:
        """kind, of, text and change, as the JSON of an estimate lists them."""
        return {
            "kind": self.kind,
            "of": list(self.of),
            "text": self.text,
            "change": self.change,
            "remaining": self.remaining,
            "number": self.number,
        }


def applied(
    model: Model, channels: Sequence[Channel], finding: Finding
) -> tuple[Model, tuple[Channel, ...]]:
    """Model and channels with a finding's remedy taken: entries of the same names replaced, new elements added."""
    changed = {channel.name: channel for channel in finding.channels}
    elements = {element.name: element for element in finding.elements}
    kept = tuple(elements.pop(element.name, element) for element in model.elements)
    new_model = replace(model, elements=(*kept, *elements.values())) if finding.elements else model
    return new_model, tuple(changed.get(channel.name, channel) for channel in channels)
