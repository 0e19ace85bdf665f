"""Writing rig files: what `reader` reads back to the same rig."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np

from dashpot.channel import Channel, Experiment
from dashpot.errors import ModelError
from dashpot.io.toml_document import PLACEHOLDER, toml_key
from dashpot.io.words import quoted
from dashpot.model.elements import Element, Kind
from dashpot.model.matrix_elements import free_entries
from dashpot.model.network import Model
from dashpot.model.observation import unknown_calibrations
from dashpot.model.rigfile.reader import law_fields
from dashpot.model.rigfile.rig import Rig, is_electrical
from dashpot.model.rigfile.schema import EXPERIMENTS, GROUND, NOISE, NUMBERS, SHAKER, VERDICT
from dashpot.unknowns import Unknown

OWN = "own"  # an unknown of an experiment's own
USUAL = {"gain": "1.0", "delay": "0.0", "sign": "1.0"}  # calibrations where nothing is said
LARGE = 1e7  # from which a number is written with a power of ten


def write_rig(rig: Rig) -> str:
    """A rig file, TOML, that reads back to the same model and channels; parameters are in SI units.

    Elements are grouped by kind, in the order in which the kinds first appear.  Raises ModelError for a channel
    whose scale is not that of its unit, which a rig file cannot say, and for matrices in files of their own.
    """
    model = rig.model
    if any(element.block is not None for element in model.elements):
        raise ModelError(
            "a rig with [blocks] cannot be written: its matrices are in files of their own",
            cure="copy the rig file",
        )
    lines = [f"name = {quoted(model.name)}"] if model.name else []
    lines.append(f"coordinates = {_list(model.coordinates)}")
    if model.angles:
        lines.append(f"angles = {_list(sorted(model.angles))}")
    if model.inputs:
        placed = {one.name: {"at": _points_text(one.at)} if one.at else {} for one in model.inputs}
        fields = {one.name: {"kind": quoted(one.kind), **placed[one.name]} for one in model.inputs}
        lines += _section("inputs", fields)
    if free := free_entries(model):
        whole = list(combinations(model.coordinates, 2))
        lines += ["", "[free]"]
        for letter, pairs in free.items():
            if len(pairs) in (0, len(whole)):
                lines.append(f"{letter} = {quoted('full' if pairs else 'diagonal')}")
            else:
                lines.append(f"{letter} = [{', '.join(map(_list, pairs))}]")
    usual = [element for element in model.elements if not element.free and element.only is None]
    for kind in dict.fromkeys(element.kind for element in usual):
        members = [element for element in usual if element.kind == kind]
        lines += _section(kind.section, {element.name: _element_fields(element) for element in members})
    own = {f"{channel.name}.{key}" for channel in rig.all_channels for key in ("gain", "delay")}
    shared = [unknown for unknown in unknown_calibrations(rig.all_channels) if unknown.name not in own]
    if shared:
        lines += _section("calibrations", {unknown.name: _stated_fields(unknown) for unknown in shared})
    lines += _section("channels", {channel.name: _channel_fields(channel, model) for channel in rig.channels})
    for experiment in rig.experiments:
        lines += ["", f"[{EXPERIMENTS}.{toml_key(experiment.name)}]", *_differences(rig, experiment)]
    if rig.within is not None:
        lines += ["", f"[{VERDICT}]", f"within = {rig.within!r}"]
    if model.distribution != "normal":
        lines += ["", f"[{NOISE}]", f"distribution = {quoted(model.distribution)}"]
    if rig.shaker is not None:
        lines += ["", f"[{SHAKER}]", *(f"{key} = {value!r}" for key, value in rig.shaker.given.items())]
    return "\n".join(lines) + "\n"


def edited(text: str, before: Rig, after: Rig) -> str:
    """A rig file's text, which reads as `before`, edited to read as `after`: its comments, order and units stay.

    What cannot be edited in place, since the file says it by other words, is written anew.  Raises as `write_rig`.
    """
    from dashpot.model.rigfile.reader import parse_rig

    def written(rig: Rig) -> str:
        elements = tuple(element for element in rig.model.elements if element.block is None)
        return write_rig(replace(rig, model=replace(rig.model, elements=elements)))

    old, new = (tomllib.loads(written(rig)) for rig in (before, after))
    changed = edited_table(text, old, new)
    try:
        again = written(replace(parse_rig(changed, before.path), within=after.within))
    except ModelError:
        return write_rig(after)
    return changed if _rounded(tomllib.loads(again)) == _rounded(new) else write_rig(after)


def edited_table(text: str, before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """A TOML text edited where the table `after` differs from `before`, as which it reads; the rest stays as it is."""
    import tomlkit

    document = tomlkit.parse(text)
    added = _edit(document, before, after)
    lines = tomlkit.dumps(document).splitlines(keepends=True)
    for section, line in added:
        # Behind the last entry of a section, which is made at the end where it is missing
        header = re.compile(rf"\s*\[\s*{re.escape(section)}\s*\]")
        last = next((at for at, each in enumerate(lines) if header.match(each)), None)
        if last is None:
            lines += ["" if not lines or lines[-1].endswith("\n") else "\n", f"\n[{section}]\n", f"{line}\n"]
            continue
        for at in range(last + 1, len(lines)):
            if re.match(r"\[", lines[at]):
                break
            if lines[at].strip() and not lines[at].lstrip().startswith("#"):
                last = at
        lines[last] = lines[last].rstrip("\n") + "\n"
        lines.insert(last + 1, f"{line}\n")
    return "".join(lines)


def _rounded(value: Any) -> Any:
    """A TOML value whose numbers have the digits that `_edit` writes."""
    if isinstance(value, dict):
        return {key: _rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return f"{value:.5g}" if isinstance(value, float) else value


def _edit(
    place: MutableMapping[str, Any], before: Mapping[str, Any], after: Mapping[str, Any], section: str = ""
) -> list[tuple[str, str]]:
    """Change what differs in the entries of a TOML table; sections, and lines for their entries that are new."""
    import tomlkit
    from tomlkit.items import InlineTable

    added: list[tuple[str, str]] = []
    for key in before.keys() - after.keys():
        place.pop(key, None)
    for key, value in after.items():
        old, there, inner = before.get(key), place.get(key), f"{section}.{toml_key(key)}".lstrip(".")
        if old == value:
            continue
        if isinstance(value, dict) and isinstance(there, MutableMapping):
            added += _edit(there, old or {}, value, inner)
        elif isinstance(value, dict) and not section:
            added += [(inner, f"{toml_key(name)} = {_value(each)}") for name, each in value.items()]
        elif isinstance(value, dict) and there is None:
            added.append((section, f"{toml_key(key)} = {_value(value)}"))
        else:
            with_unit = re.fullmatch(r"\s*([-+.\deE]+)\s*(\D.*)", there) if isinstance(there, str) else None
            if with_unit and old and isinstance(old, float) and isinstance(value, float):
                value = f"{float(with_unit[1]) * value / old:.6g} {with_unit[2]}"
            item = tomlkit.item(value)
            spaced = isinstance(place, InlineTable) and place.as_string().endswith(" }")
            if there is None and spaced:
                list(place.values())[-1].trivia.trail = ""
                item.trivia.trail = " "
            place[key] = item
    return added


def _value(value: Any) -> str:
    """A value as a person writes it in one line."""
    import tomlkit

    if isinstance(value, Mapping):
        return _inline({key: _value(each) for key, each in value.items()})
    return str(tomlkit.item(value).as_string())


def _differences(rig: Rig, experiment: Experiment) -> list[str]:
    """What a rig file says of one experiment."""
    model, fields = rig.model, dict[str, str]()
    by_name = {element.name: element for element in model.elements}
    if experiment.data:
        fields["data"] = _list(experiment.data)
    for element in model.elements:
        if element.only != experiment.name or (
            element.stands_for and element.same_as
        ):  # which follows from its tie
            continue
        key, _, value = element_line(element).partition(" = ")
        base = by_name.get(element.stands_for or "")
        if base is not None and all(getattr(base, f) == getattr(element, f) for f in NUMBERS.values()):
            value = quoted(OWN)
        fields[key] = value
    for channel in experiment.channels:
        base_channel = next(each for each in rig.channels if each.name == channel.column)
        there, usual = (_channel_fields(each, model) for each in (channel, base_channel))
        for key, otherwise in USUAL.items():
            if there.get(key) != usual.get(key):
                fields[f"{toml_key(channel.column)}.{key}"] = there.get(key, otherwise)
    return [f"{key} = {value}" for key, value in fields.items()]


def channel_line(channel: Channel, model: Model) -> str:
    """A channel's entry in its section of a rig file.  Raises ModelError as `write_rig`."""
    fields = _channel_fields(channel, model)
    if channel.only is not None:
        fields = {key: fields.get(key, usual) for key, usual in USUAL.items()}
    return f"{toml_key(channel.column)} = {_inline(fields)}"


def channel_section(channel: Channel) -> str:
    """The section that a channel stands in."""
    return f"[{EXPERIMENTS}.{toml_key(channel.only)}]" if channel.only is not None else "[channels]"


def element_line(element: Element) -> str:
    """An element's entry in the section of its kind, or in that of its experiment."""
    if element.stands_for is not None:
        numbers = {key: getattr(element, field) for key, field in NUMBERS.items()}
        stated = {key: _number(number) for key, number in numbers.items() if number is not None}
        return f"{toml_key(element.stands_for)} = {_inline(stated) if stated else quoted(OWN)}"
    of_kind = f"{element.kind.section}." if element.only is not None else ""
    return f"{of_kind}{toml_key(element.name)} = {_inline(_element_fields(element))}"


def element_section(element: Element) -> str:
    """The section that an element stands in."""
    return (
        f"[{element.kind.section}]" if element.only is None else f"[{EXPERIMENTS}.{toml_key(element.only)}]"
    )


def _number(value: float) -> str:
    """A number that reads back as it is; large ones without the zeros of 200000000.0."""
    text = repr(float(value))
    if abs(value) < LARGE or "e" in text:
        return text
    return np.format_float_scientific(value, trim="0", exp_digits=1).replace("e+", "e")


def _section(name: str, entries: Mapping[str, Mapping[str, str]]) -> list[str]:
    """The lines of a section, one an entry, behind an empty one."""
    return ["", f"[{name}]", *(f"{toml_key(key)} = {_inline(fields)}" for key, fields in entries.items())]


def _element_fields(element: Element) -> dict[str, str]:
    factors = element.along
    match list(factors.items()):
        case [(point, 1.0)] if element.kind == Kind.MASS:
            fields = {"at": quoted(point)}
        case [(point, 1.0)]:
            fields = {"between": _list([point, GROUND])}
        case [(first, 1.0), (second, -1.0)] if element.kind != Kind.MASS:
            fields = {"between": _list([first, second])}
        case _:
            fields = {
                "along": _inline({toml_key(point): _number(factor) for point, factor in factors.items()})
            }
    numbers = {key: getattr(element, field) for key, field in NUMBERS.items()}
    fields |= {key: _number(number) for key, number in numbers.items() if number is not None}
    if element.force_law is not None:
        fields |= law_fields(element.force_law)
    if element.same_as is not None:
        fields["same_as"] = quoted(element.same_as)
        if element.times != 1.0:
            fields["times"] = _number(element.times)
    return fields


def _channel_fields(channel: Channel, model: Model) -> dict[str, str]:
    fields = {"of": _points_text(channel.of), "quantity": quoted(channel.quantity.value)}
    if channel.unit:
        fields["unit"] = quoted(channel.unit)
    elif channel.scale != 1.0:
        what = f"the channel {channel.name} has a scale of {channel.scale:g} and no unit"
        raise ModelError(what, cure="give it the unit that has this scale")
    calibration = {"gain": channel.gain, "delay": channel.delay, "sign": channel.sign}
    usual = {"gain": 1.0, "delay": 0.0, "sign": 1.0}
    for key, number in calibration.items():
        # The gain of a voltage is stated even where it is 1: else the channel would count as not calibrated.
        stated = number != usual[key] or (
            key == "gain" and is_electrical(channel.unit, channel.quantity.value)
        )
        if stated:
            fields[key] = '"unknown"' if number is None else _number(number)
    for key, number in (("noise", channel.noise), ("relative_noise", channel.relative_noise)):
        if number != 0:
            fields[key] = _number(number)
    if channel.rate is not None:
        fields["rate"] = _number(channel.rate)
    if channel.same_gain_as is not None:
        fields["same_gain_as"] = quoted(channel.same_gain_as)
    for key, number, prior in (
        ("gain", channel.gain, channel.gain_prior),
        ("delay", channel.delay, channel.delay_prior),
    ):
        if prior is not None and number is None and (key == "delay" or channel.same_gain_as is None):
            own = prior.name == f"{channel.name}.{key}"
            fields[key] = _inline(_stated_fields(prior) if own else {"of": quoted(prior.name)})
    return fields


def _stated_fields(unknown: Unknown) -> dict[str, str]:
    numbers = (unknown.prior, unknown.sd, unknown.guess, unknown.lower, unknown.upper)
    named = zip(NUMBERS, numbers, strict=True)
    return {key: _number(number) for key, number in named if number is not None}


def _points_text(points: Mapping[str, float]) -> str:
    match list(points.items()):
        case [(point, 1.0)]:
            return quoted(point)
    return _inline({toml_key(point): _number(factor) for point, factor in points.items()})


def _inline(fields: Mapping[str, str]) -> str:
    return "{ " + ", ".join(f"{key} = {value}" for key, value in fields.items()) + " }"


def _list(texts: Iterable[str]) -> str:
    return "[" + ", ".join(map(quoted, texts)) + "]"


# A rig file to start from: a chain of masses, shaken, pushed or let go, or an element on its stand; all unknown.


MOST_MASSES = 50
STAND_IN = 1.0  # kg, of a first mass that nobody has weighed where nothing else gives the scale


Drive = Literal["base", "force", "release", "stand"]


@dataclass(frozen=True)
class ChannelLine:
    """A channel of a rig file: its column, the point, what is measured in which unit; PLACEHOLDER where it is open."""

    column: str
    of: str
    quantity: str
    unit: str
    gain: str | float | None = None  # of volts or counts, which want a sensitivity

    @property
    def line(self) -> str:
        """Its line in [channels]."""
        gain = (
            "" if self.gain is None else f", gain = {self.gain if self.gain == 1 else quoted(str(self.gain))}"
        )
        fields = (
            f"of = {quoted(self.of)}, quantity = {quoted(self.quantity)}, unit = {quoted(self.unit)}{gain}"
        )
        return f"{toml_key(self.column)} = {{ {fields} }}"


@dataclass(frozen=True)
class Chain:
    """What a few questions tell of a rig.

    masses     in a row, x1 the farthest from the base
    drive      "base": the base moves; "force": a force on the last mass, the base stands still; "release": nothing
               drives, the masses are let go; "stand": no masses, an element between a moved end and the ground
    motion     what the sensors on the masses (and on the base) measure
    unit       of their numbers
    force_unit of the force's
    known      kg of x1; None: it was not weighed, and where no force gives the scale STAND_IN stands there
    at         the mass that the force acts on; None: the last
    forces     how many forces act, f, f2, …; where the others do is left open
    sensors    the channels; none: every coordinate and what drives, of those names
    """

    name: str = "My rig"
    masses: int = 2
    drive: Drive = "base"
    motion: Literal["displacement", "velocity", "acceleration"] = "acceleration"
    unit: str = "m/s²"
    force_unit: str = "N"
    known: float | None = None
    at: str | None = None
    forces: int = 1
    sensors: tuple[ChannelLine, ...] = ()

    @property
    def lacks_scale(self) -> bool:
        """Whether only ratios to the first mass can be found."""
        return self.known is None and self.drive not in ("force", "stand")


def starter_text(chain: Chain) -> str:
    """The rig file, TOML, with what to do next in its comments.  Raises ModelError for numbers out of range."""
    if not 1 <= chain.masses <= MOST_MASSES:
        raise ModelError(f"a chain of {chain.masses} masses", cure=f"give 1 to {MOST_MASSES}")
    if chain.known is not None and not 0 < chain.known < 1e12:
        raise ModelError(f"a mass of {chain.known:g} kg", cure="give one above 0")
    names = [] if chain.drive == "stand" else [f"x{i + 1}" for i in range(chain.masses)]
    base = "u" if chain.drive == "base" else "ground"
    coordinates = ", ".join(f'"{name}"' for name in names)
    lines = [f"name = {quoted(chain.name)}", f"coordinates = [{coordinates}]"]
    if chain.drive in ("base", "stand"):
        lines += ["", "[inputs]", 'u = { kind = "displacement" }']
    elif chain.drive == "force":
        lines += ["", "[inputs]", f'f = {{ kind = "force", at = {quoted(chain.at or names[-1])} }}']
        for number in range(2, chain.forces + 1):
            lines.append(f'f{number} = {{ kind = "force", at = "{PLACEHOLDER}" }}')
    channels = [sensor.line for sensor in chain.sensors]
    if not channels:  # of every coordinate, and of the base or the force
        fields = f'quantity = "{chain.motion}", unit = {quoted(chain.unit)}'
        shown = [*names, "u"] if chain.drive == "base" else names
        channels = [f'{name} = {{ of = "{name}", {fields} }}' for name in shown]
        if chain.drive == "force":
            channels.append(f'f = {{ of = "f", unit = {quoted(chain.force_unit)} }}')
    lines += [
        "",
        (
            "# An element without a value is estimated; value = …, sd = … is prior knowledge, such as a weighed "
            "mass."
        ),
        *_elements(chain, names, [*names, base] if names else ["u", "ground"]),
        "",
        "# One entry for each column of the data, under its name.",
        "[channels]",
        *channels,
    ]
    return "\n".join(lines) + "\n"


def _elements(chain: Chain, names: Sequence[str], points: Sequence[str]) -> Iterator[str]:
    """Sections of masses, springs and dampers; each spring and damper joins a point to the next."""
    if names:
        yield "[masses]"
        if chain.lacks_scale:
            yield (
                "# PLACEHOLDER: no force is measured, so one mass must be known. Replace this value with the "
                "weighed mass."
            )
    first = STAND_IN if chain.lacks_scale else chain.known
    for i, name in enumerate(names):
        value = f", value = {first!r}" if i == 0 and first is not None else ""
        yield f'm{i + 1} = {{ at = "{name}"{value} }}'
    for number, (section, letter) in enumerate((("springs", "k"), ("dampers", "c"))):
        yield from ("", f"[{section}]") if names or number else (f"[{section}]",)
        for i in range(len(points) - 1):
            yield f'{letter}{i + 1} = {{ between = ["{points[i]}", "{points[i + 1]}"] }}'
