"""The section of a rig file that says what its channels measure."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from dashpot.channel import RESERVED_NAMES, Channel, Quantity
from dashpot.errors import UsageError
from dashpot.io.toml_document import Place
from dashpot.io.words import did_you_mean, listed, quoted, written
from dashpot.model.rigfile.rig import all_angles, is_electrical, scale_of_points
from dashpot.model.rigfile.schema import (
    EXAMPLES,
    EXPERIMENTS,
    GROUND,
    TABLES,
    ChannelEntry,
    RigReading,
    is_share,
    number_of,
)
from dashpot.quantities import Amount
from dashpot.units import SHARE, scale, sensitivity, si_unit
from dashpot.unknowns import Unknown

# Channels recorded in counts, or in shares of the full scale, of a converter whose full scale is known.
#
#     acc = { of = "x1", quantity = "acceleration", unit = "counts", bits = 16, full_scale = "50 g" }
#     acc = { of = "x1", quantity = "acceleration", unit = "counts", bits = 24, full_scale = "10 V", gain = "100 mV/g" }
#     acc = { of = "x1", quantity = "acceleration", unit = "FS", full_scale = "50 g" }
#
# A converter of n bits spans −2^(n−1) … 2^(n−1) − 1 counts over −full_scale … full_scale.


COUNTS = "counts"


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
    full_scale, gain = entry.full_scale, entry.gain
    assert full_scale is not None
    # How many raw units the full scale is
    bits = entry.bits
    if unit == SHARE:
        if bits is not None:
            raise UsageError(
                "bits of a channel in shares of the full scale", cure='leave bits out, or say unit = "counts"'
            )
        codes = 1.0
    else:
        if unit not in (COUNTS, "count"):
            raise UsageError(
                f"a full scale of a channel in {unit}", cure='say unit = "counts" or "FS", or leave it out'
            )
        if bits is None:
            raise UsageError("the counts at full scale are not given", cure="add bits, such as bits = 16")
        if bits != int(bits) or not 2 <= bits <= 64:
            raise UsageError(f"a converter of {bits:g} bits", cure="give a whole number from 2 to 64")
        codes = 2.0 ** (int(bits) - 1)
    size = number_of(full_scale)
    of_scale = full_scale.unit if isinstance(full_scale, Amount) else None
    if not size > 0:
        raise UsageError(f"a full scale of {size:g}", cure="give a positive one")
    given = "gain" in entry.model_fields_set
    if gain is None or entry.same_gain_as is not None:
        raise UsageError("a full scale beside an unknown gain", cure="leave the full scale out, or the gain")
    if of_scale not in (None, COUNTS) and is_electrical(of_scale, quantity):
        volts = size * scale(of_scale, quantity, False, True)
        if not given:
            raise UsageError(
                "a full scale in volts needs a sensitivity", cure='add one such as gain = "100 mV/g"'
            )
        if isinstance(gain, str):
            gain = sensitivity(gain, "V", quantity, all_angles(arms, angles))
        return codes / volts * gain
    if given:
        raise UsageError(
            "a gain beside a full scale of the quantity itself",
            cure="leave the gain out, or give the full scale in V",
        )
    return codes / (size if of_scale is None else size * scale_of_points(of_scale, quantity, arms, angles))


def read_channels(reading: RigReading) -> list[Channel] | None:
    """The channels; None if the file has no such section."""
    # Tables of channels, and of what they are in experiments
    tables = [raw for _, raw in reading.entries("channels")]
    for _, experiment in reading.entries(EXPERIMENTS):
        tables += experiment.values() if isinstance(experiment, dict) else ()
    named = {str(table.get("of")) for raw in tables for table in split_calibrations(raw)[1].values()}
    for name, _ in reading.entries("calibrations"):
        place = ("calibrations", name)
        if name not in named:
            cure = f"say in [channels] whose it is: gain = {{ of = {quoted(name)} }}"
            reading.report.add(place, "no channel has this calibration", cure)
        elif "." in name or name in reading.elements or name in reading.points:
            reading.report.add(
                place, "something else has this name in results", "choose another, without a point"
            )
    if "channels" not in reading.table:
        return None
    # Points, force inputs and elements, faulty ones too
    channels = []
    for name, raw in reading.entries("channels"):
        place, before = ("channels", name), reading.problems
        if not name.isprintable() or name != name.strip() or not name:
            cure = "use the name of the column, without line breaks, tabs or spaces at its ends"
            reading.report.add(place, f"{written(name)} is not a usable name", cure)
            continue
        if name in RESERVED_NAMES:
            reading.report.add(place, *reserved(name))
            continue
        channel = read_channel(reading, name, raw, place)
        if channel is not None and reading.problems == before:
            channels.append(channel)
    _check_shared_gains(reading, channels)
    owners = {channel.name: channel for channel in channels}
    return [
        replace(channel, gain_prior=owners[channel.same_gain_as].gain_prior)
        if channel.same_gain_as in owners
        else channel
        for channel in channels
    ]


def read_channel(reading: RigReading, name: str, raw: object, place: Place) -> Channel | None:
    """The channel at a place of the file; None if it cannot be said, which is reported."""
    # Points, force inputs and elements, faulty ones too
    measurable = (*reading.points, *reading.inputs, *reading.elements, *sorted(reading.faulty))
    plain, tables = split_calibrations(raw)
    entry = reading.entry(ChannelEntry, "channels", name, plain, place)
    channel = None if entry is None else _channel(reading, name, entry, dict.fromkeys(measurable), place)
    return None if channel is None else _with_calibrations(reading, channel, tables, place)


# Gains and delays that are known with an uncertainty, or shared.
#
#     acc = { of = "x1", quantity = "acceleration", gain = { value = 1, sd = "1 %" }, delay = { guess = "2 ms" } }
#     [calibrations]
#     calibrator = { value = 1, sd = "1 %" }        named by gain = { of = "calibrator" }


def split_calibrations(raw: object) -> tuple[object, dict[str, dict[str, Any]]]:
    """A channel's table with "unknown" in place of the tables of gain and delay, and these."""
    if not isinstance(raw, dict):
        return raw, {}
    tables = {key: raw[key] for key in ("gain", "delay") if isinstance(raw.get(key), dict)}
    return {**raw, **dict.fromkeys(tables, "unknown")}, tables


def _with_calibrations(
    reading: RigReading, channel: Channel, tables: Mapping[str, dict[str, Any]], at: Place
) -> Channel:
    """The channel with the gain and the delay that tables state; reported if they make no sense."""
    changes: dict[str, Any] = {}
    for key, table in tables.items():
        place = (*at, key)
        if key == "gain" and channel.same_gain_as is not None:
            reading.report.add(place, "the gain is given as well", "keep same_gain_as, or the gain")
            return channel
        found = (
            _shared_calibration(reading, place, table, channel)
            if "of" in table
            else _calibration(reading, place, table, f"{channel.name}.{key}", key, channel)
        )
        if isinstance(found, Unknown):
            changes[f"{key}_prior"] = found
        elif found is not None:
            changes[key] = found
    return replace(channel, **changes)


def _shared_calibration(
    reading: RigReading, place: Place, table: Mapping[str, Any], channel: Channel
) -> float | Unknown | None:
    """The calibration that a table names."""
    declared, name, key = dict(reading.entries("calibrations")), table["of"], str(place[-1])
    if len(table) > 1:
        reading.report.add(place, "a shared calibration with numbers of its own", "keep `of`, or the numbers")
    elif not isinstance(name, str) or name not in declared:
        cure = f"{did_you_mean(str(name), declared)}there are {listed(declared)}"
        if not declared:
            cure = f"declare it: write {name} = {EXAMPLES['calibrations']} below [calibrations]"
        reading.report.add((*place, "of"), f"{written(name)} is not a calibration", cure)
    elif reading.calibrations.setdefault(name, key) != key:
        reading.report.add((*place, "of"), f"{name} is a gain and a delay", "declare one for each")
    else:
        return _calibration(reading, ("calibrations", name), declared[name], name, key, channel)
    return None


UNITS = {"gain": "1", "delay": "s"}


def _calibration(
    reading: RigReading, place: Place, raw: object, name: str, key: str, channel: Channel
) -> float | Unknown | None:
    """A gain or a delay as stated: known, or an unknown of this name; None, and reported, if it cannot be read."""
    before = reading.problems
    entry = reading.constant_entry(place, raw, f"{written(raw)} is not a calibration")
    if entry is None:
        return None

    def in_si(unit: str) -> float:
        if key == "delay":
            return scale(unit, "time")
        if place[0] == "calibrations":
            raise UsageError(
                f"a gain in {unit} that channels share", cure="write a number, a factor of all of them"
            )
        return sensitivity(
            f"1 {unit}", channel.unit, channel.quantity, all_angles(channel.of, reading.angles)
        )

    stated = reading.stated(place, entry, in_si)
    value, guess = stated.pop("value", None), stated.get("guess")
    if key == "gain" and 0 in (value, guess):
        reading.report.add(place, "a gain of 0 measures nothing", 'give another one, or "unknown"')
    if reading.problems > before:
        return None
    return value if value is not None and "sd" not in stated else Unknown(name, UNITS[key], value, **stated)


def reserved(name: str) -> tuple[str, str]:
    """What is wrong with a channel of a name that data files use themselves, and the cure."""
    cause = f"{written(name)} is reserved for a column of data files"
    return cause, "name the channel differently, in the data too"


def _check_shared_gains(reading: RigReading, channels: Sequence[Channel]) -> None:
    """Whoever shares a gain shares an unknown one, of a channel that has it from nobody else."""
    by_name = {channel.name: channel for channel in channels}
    table = reading.table["channels"]
    names = table if isinstance(table, dict) else {}
    for channel in channels:
        owner = channel.same_gain_as
        place = ("channels", channel.name, "same_gain_as")
        if owner is None:
            continue
        if owner not in names:
            others = [name for name in names if name != channel.name]
            cure = f"{did_you_mean(owner, others)}there are {listed(others)}" if others else "list it"
            reading.report.add(place, f"{written(owner)} is not a channel", cure)
        elif owner == channel.name:
            reading.report.add(place, "the channel shares its gain with itself", "name another one")
        elif owner in by_name and by_name[owner].gain is not None:
            reading.report.add(place, f"the gain of {owner} is known", f'give {owner} gain = "unknown"')
        elif owner in by_name and by_name[owner].same_gain_as is not None:
            cure = f"name {by_name[owner].same_gain_as}"
            reading.report.add(place, f"{owner} has its gain from another channel", cure)


def _channel(
    reading: RigReading, name: str, entry: ChannelEntry, measurable: Collection[str], place: Place
) -> Channel | None:
    """A channel; None if it cannot be said, which is reported unless it follows from another problem."""
    before = reading.problems
    given = {point: factor for point, factor in entry.of.items() if point != GROUND}
    of = reading.factors((*place, "of"), given)
    for key, what, cure in _wrong_numbers(entry):
        reading.report.add((*place, key), what, cure)
    if not of:
        reading.report.add((*place, "of"), "the ground does not move", "name what the channel measures")
    called = "point, input or element"
    reading.require_points((*place, "of"), of, measurable, called, ("coordinates", *TABLES))
    if reading.problems > before or reading.faulty & of.keys():
        return None
    if entry.quantity is not None:
        quantity = Quantity(entry.quantity)
    else:  # force inputs and elements do nothing else
        quantity = Quantity.DISPLACEMENT if any(point in reading.points for point in of) else Quantity.FORCE
    fault = _not_measurable(reading, of, quantity)
    if fault is not None:
        reading.report.add((*place, "of"), *fault)
        return None
    return _calibrated(reading, name, entry, of, quantity, place)


def _not_measurable(
    reading: RigReading, of: Mapping[str, float], quantity: Quantity
) -> tuple[str, str] | None:
    """What is wrong with measuring `quantity` of `of`, and the cure."""
    if quantity is not Quantity.FORCE:
        motionless = next((name for name in of if name not in reading.points), None)
        if motionless is None:
            return None
        kind = "an element" if motionless in reading.elements else "a force"
        return f"{motionless} is {kind}: it has no {quantity}", 'say quantity = "force", or name points'
    if all(name in reading.elements for name in of):
        return None
    if len(of) > 1:
        return "a force of several things", "name one input, or elements only"
    (name,) = of
    if name in reading.points and name not in reading.inputs:
        cure = f"name an input or elements: {listed((*reading.inputs, *reading.elements))}"
        return f"{name} is a coordinate: no force is measured there", cure
    return None


def _arms(reading: RigReading, of: Mapping[str, float], quantity: Quantity) -> Mapping[str, float]:
    """Points and factors that decide between m and rad, N and N·m.  Raises UsageError if forces differ in it."""
    first = next(iter(of))
    if quantity is not Quantity.FORCE or first in reading.points:
        return of
    if first not in reading.elements:
        return reading.inputs[first].at
    if len({all_angles(reading.elements[name].along, reading.angles) for name in of}) > 1:
        raise UsageError("forces and torques cannot be added", cure="name elements of one kind")
    return reading.elements[first].along


def _wrong_numbers(entry: ChannelEntry) -> Iterator[tuple[str, str, str]]:
    """Keys whose numbers make no sense, what is wrong with them, and the cure."""
    if entry.same_gain_as is not None and "gain" in entry.model_fields_set and entry.gain is not None:
        yield "same_gain_as", "the gain is given as well", 'write gain = "unknown", or leave it out'
    if entry.gain == 0:
        yield "gain", "a gain of 0 measures nothing", 'give another one, or "unknown"'
    if entry.sign is not None and entry.sign not in (1.0, -1.0):
        yield "sign", f"the sign is {entry.sign:g}", 'write 1, -1 or "unknown"; a factor belongs in gain'
    if entry.bits is not None and entry.full_scale is None:
        yield "bits", "bits without a full scale", 'add full_scale, such as "50 g"'
    for key in ("noise", "relative_noise"):
        if number_of(getattr(entry, key)) < 0:
            yield key, f"a standard deviation of {number_of(getattr(entry, key)):g}", "give 0 or more"
    if is_share(entry.noise) and "relative_noise" in entry.model_fields_set:
        yield "noise", "the relative noise is given twice", "leave out relative_noise, or noise"
    if entry.rate is not None and number_of(entry.rate) <= 0:
        yield (
            "rate",
            f"a rate of {number_of(entry.rate):g} Hz",
            "give a positive number of samples per second",
        )


def _calibrated(
    reading: RigReading,
    name: str,
    entry: ChannelEntry,
    of: Mapping[str, float],
    quantity: Quantity,
    place: Place,
) -> Channel | None:
    """A channel with its unit, calibration, noise and rate; None, and reported, if a unit does not fit."""
    key = "unit"
    try:
        arms, angles = _arms(reading, of, quantity), reading.angles
        unit = raw_unit(entry) or si_unit(quantity.value, all_angles(arms, angles))
        # A voltage with a stated gain is in V per SI unit; with the default gain of 1 nobody has calibrated it.
        gain = None if entry.same_gain_as is not None else entry.gain
        electrical = gain is None or bool({"gain", "full_scale"} & entry.model_fields_set)
        factor = scale_of_points(unit, quantity.value, arms, angles, electrical)
        key = "gain" if entry.full_scale is None else "full_scale"
        if entry.full_scale is not None:
            gain = full_scale_gain(entry, unit, quantity.value, arms, angles)
        elif isinstance(gain, str):
            gain = sensitivity(gain, unit, quantity.value, all_angles(arms, angles))
    except UsageError as error:
        reading.include((*place, key), error)
        return None

    def in_channel_units(noise_unit: str) -> float:
        if is_electrical(noise_unit, quantity.value) != is_electrical(unit, quantity.value):
            raise UsageError(f"noise in {noise_unit} of a channel in {unit}", cure=f"write it in {unit}")
        return scale_of_points(noise_unit, quantity.value, arms, angles, electrical) / factor

    def timed(key: str, of_what: str) -> float | None:
        given = getattr(entry, key)
        return (
            None
            if given is None
            else reading.in_si((*place, key), given, 1.0, partial(scale, quantity=of_what))
        )

    relative, noise = entry.relative_noise, 0.0
    if is_share(entry.noise):
        relative = number_of(entry.noise) / 100
    else:
        noise = reading.in_si((*place, "noise"), entry.noise, 1.0, in_channel_units)
    return Channel(
        name,
        of,
        quantity,
        unit,
        scale=factor,
        gain=gain,
        delay=timed("delay", "time"),
        sign=entry.sign,
        noise=noise,
        relative_noise=relative,
        rate=timed("rate", "frequency"),
        same_gain_as=entry.same_gain_as,
    )
