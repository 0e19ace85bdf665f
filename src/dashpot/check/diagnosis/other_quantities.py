"""Channels that show another derivative of the motion than they state, in words and as they should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dashpot.channel import Channel, Quantity
from dashpot.check.diagnosis.likeness import Likeness
from dashpot.check.diagnosis.ranking import Cause
from dashpot.estimate.assessment import Finding
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.model.rigfile import channel_line

DERIVATIVES = (Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION)


def other_quantity(channel: Channel, relation: Likeness) -> tuple[Channel, str]:
    """Shown is (jω)^power times what the stated quantity would be."""
    text = f"{channel.name} behaves like another derivative of the motion than {channel.quantity.value}"
    if channel.quantity is Quantity.FORCE:
        return channel, text
    order = channel.quantity.derivative + relation.power
    if not 0 <= order <= 2:
        return channel, text
    true = DERIVATIVES[order]
    return (
        replace(channel, quantity=true, unit="", scale=1.0),
        f"{channel.name} behaves like {_article(true.value)}, not like {_article(channel.quantity.value)}",
    )


def other_quantities(model: Model, channels: Sequence[Channel], cause: Cause, relation: Likeness) -> Finding:
    """All channels of the motion that show another derivative than they state."""
    mended = tuple(other_quantity(channel, relation)[0] for channel in channels)
    true, stated = (f"{each[0].quantity.value}s".replace("ys", "ies") for each in (mended, channels))
    text = f"{joined(cause.of)} behave like {true}, not like {stated}"
    change = "[channels] " + "; ".join(channel_line(channel, model) for channel in mended)
    return Finding(cause.kind, cause.of, text, change, cause.remaining, cause.number, channels=mended)


def _article(word: str) -> str:
    return f"{'an' if word[0] in 'aeiou' else 'a'} {word}"
