"""Channels recorded in counts, or in shares of the full scale, of a converter whose full scale is known.

    acc = { of = "x1", quantity = "acceleration", unit = "counts", bits = 16, full_scale = "50 g" }
    acc = { of = "x1", quantity = "acceleration", unit = "counts", bits = 24, full_scale = "10 V", gain = "100 mV/g" }
    acc = { of = "x1", quantity = "acceleration", unit = "FS", full_scale = "50 g" }

A converter of n bits spans −2^(n−1) … 2^(n−1) − 1 counts over −full_scale … full_scale.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from dashpot.errors import UsageError
from dashpot.model.rigfile.amounts import number_of
from dashpot.model.rigfile.rig import all_angles, is_electrical, scale_of_points
from dashpot.model.rigfile.schema import ChannelEntry
from dashpot.quantities import Amount
from dashpot.unit_symbols import SHARE
from dashpot.units import scale, sensitivity

COUNTS = "counts"
MOST_BITS = 64


def raw_unit(entry: ChannelEntry) -> str | None:
    """The unit of the raw numbers: the one given, else counts where there are bits, else shares of the full scale."""
    if entry.unit is not None or entry.full_scale is None:
        return entry.unit
    return SHARE if entry.bits is None else COUNTS


def full_scale_gain(
    entry: ChannelEntry, unit: str, quantity: str, arms: Mapping[str, float], angles: Collection[str]
) -> float:
    """Raw numbers (in `unit`) per SI unit of the quantity, from full scale, bits and, in volts, the sensitivity.

    Raises UsageError for what is missing or contradicts itself.
    """
    assert entry.full_scale is not None
    codes = _codes(entry, unit)
    size, of_scale = number_of(entry.full_scale), _unit(entry.full_scale)
    if not size > 0:
        raise UsageError(f"a full scale of {size:g}", cure="give a positive one")
    given = "gain" in entry.model_fields_set
    if entry.same_gain_as is not None or (given and entry.gain is None):
        raise UsageError("a full scale beside an unknown gain", cure="leave the full scale out, or the gain")
    if of_scale is not None and of_scale != COUNTS and is_electrical(of_scale, quantity):
        volts = size * scale(of_scale, quantity, False, True)
        if not given:
            raise UsageError(
                "a full scale in volts needs a sensitivity", cure='add one such as gain = "100 mV/g"'
            )
        gain = entry.gain
        if isinstance(gain, str):
            gain = sensitivity(gain, "V", quantity, all_angles(arms, angles))
        assert gain is not None
        return codes / volts * gain
    if given:
        raise UsageError(
            "a gain beside a full scale of the quantity itself",
            cure="leave the gain out, or give the full scale in V",
        )
    if of_scale is None:
        return codes / size
    return codes / (size * scale_of_points(of_scale, quantity, arms, angles))


def _unit(full_scale: float | Amount) -> str | None:
    return full_scale.unit if isinstance(full_scale, Amount) else None


def _codes(entry: ChannelEntry, unit: str) -> float:
    """How many raw units the full scale is."""
    if unit == SHARE:
        if entry.bits is not None:
            raise UsageError(
                "bits of a channel in shares of the full scale", cure='leave bits out, or say unit = "counts"'
            )
        return 1.0
    if unit not in (COUNTS, "count"):
        raise UsageError(
            f"a full scale of a channel in {unit}", cure='say unit = "counts" or "FS", or leave it out'
        )
    if entry.bits is None:
        raise UsageError("the counts at full scale are not given", cure="add bits, such as bits = 16")
    if entry.bits != int(entry.bits) or not 2 <= entry.bits <= MOST_BITS:
        raise UsageError(
            f"a converter of {entry.bits:g} bits", cure=f"give a whole number from 2 to {MOST_BITS}"
        )
    return 2.0 ** (int(entry.bits) - 1)
