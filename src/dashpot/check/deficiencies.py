"""What cannot be found of a rig, in words of physics and as plain content for JSON, with what would help."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.check.identifiability import (
    Structure,
    blind_laws,
    determines,
    is_large,
    parallel_unknowns,
    structure,
)
from dashpot.check.structure import Deficiency, enough_lines, lines_of, require_scale, view_of
from dashpot.data.spectrum import Spectrum
from dashpot.errors import IdentifiabilityError, Problem
from dashpot.io.words import listed, with_values
from dashpot.model.elements import Kind
from dashpot.model.network import Model

_POWERS = {"sum": 0, "scale": 1, "series": 2}  # of the unknowns, along the directions


def require_identifiable(
    model: Model, channels: Sequence[Channel], where: str | None = None, spectrum: Spectrum | None = None
) -> None:
    """Raises IdentifiabilityError with one problem for each thing that cannot be found, placed at the file `where`.

    Of very large rigs only the scale of the forces and elements side by side are checked.  Free decays tell by the
    motion that they start with, whichever their lines are.
    """
    if is_large(model):
        require_scale(model, channels, where)
        blind = blind_laws(model, spectrum) if spectrum is not None and len(model.nonlinear) else None
        if blind is not None:
            raise IdentifiabilityError(problems_in_words(blind, model, channels, where))
        require_no_parallels(model, channels, where)
        return
    at_hand = spectrum if model.inputs or (spectrum is not None and not spectrum.records) else None
    unknowns = len(view_of(model, channels).names)
    lines = enough_lines(model, channels, unknowns) if at_hand is None else lines_of(model, at_hand)
    if not determines(model, tuple(channels), lines):
        require_full_rank(structure(model, channels, at_hand), model, channels, where)


def structure_content(model: Model, channels: Sequence[Channel], found: Structure) -> dict[str, Any]:
    """Whether the rig is identifiable; directions are changes of unknowns, in their units, at `nominal`."""
    return {
        "dashpot": "0.1",
        "model": model.name,
        "identifiable": found.identifiable,
        "unknowns": list(found.names),
        "rank": found.rank,
        "nominal": dict(zip(found.names, found.nominal.tolist(), strict=True)),
        "deficiencies": [
            {
                "sort": one.sort,
                "unknowns": list(one.names),
                "can_be_found": list(combinations_in_words(one)),
                **dict(zip(("what", "cure"), in_words(one, found, model, channels), strict=True)),
                "directions": [
                    {name: x for name, x in zip(found.names, row, strict=True) if x != 0}
                    for row in one.directions.tolist()
                ],
            }
            for one in found.deficiencies
        ],
        "exchangeable": [list(pair) for pair in found.permutation_ambiguities],
        "rests_on_sd_of": list(found.prior_dependent),
    }


def require_no_parallels(model: Model, channels: Sequence[Channel], where: str | None = None) -> None:
    """Raises IdentifiabilityError with a problem for each group of unknowns whose sum alone can be found."""
    problems = []
    for names in parallel_unknowns(model, channels):
        reason, more = _parallel(names, model)
        what = f"only {' + '.join(names)} can be found, not {_named(names)} separately: {reason}"
        problems.append(Problem(what, where, with_values(names, len(names) - 1) + more))
    if problems:
        raise IdentifiabilityError(problems)


def require_full_rank(
    found: Structure, model: Model, channels: Sequence[Channel], where: str | None = None
) -> None:
    """The same for a structure that has been worked out.  Raises IdentifiabilityError."""
    if not found.identifiable:
        raise IdentifiabilityError(problems_in_words(found, model, channels, where))


def problems_in_words(
    found: Structure, model: Model, channels: Sequence[Channel], where: str | None = None
) -> list[Problem]:
    """One Problem for each deficiency."""
    said = [in_words(deficiency, found, model, channels) for deficiency in found.deficiencies]
    return [Problem(what, where, cure) for what, cure in said]


def in_words(one: Deficiency, found: Structure, model: Model, channels: Sequence[Channel]) -> tuple[str, str]:
    """(what cannot be told apart, what would help) of one deficiency of a rig."""
    names, count = one.names, len(one.directions)
    give = with_values(names, count)
    elements = {element.name for element in model.elements}
    if one.sort == "unseen":
        what, cure = _unseen(one, found, model, channels)
    elif one.sort == "lines":
        assert one.lines is not None
        count, frequencies, missing = one.lines.lines, one.lines.frequencies, one.lines.missing
        M = len(found.names)
        at = "1 frequency" if frequencies == 1 else f"{frequencies} frequencies"
        held = f"{count} line{'' if count == 1 else 's'} at {at}"
        told = f"{held} determine only {found.rank} combinations of the {M} unknowns"
        what = f"{told}; {_named(one.names)} cannot be determined"
        need = ""
        if missing is not None:
            need = f"measure at {missing} more frequenc{'y' if missing == 1 else 'ies'}, or "
        elif one.lines.without_base:
            need = "also measure the rig without the changes of the experiments, or "
        cure = need + with_values(one.names, M - found.rank)
    elif one.sort == "mixed" and len(names) == 1:
        what = f"no information on {names[0]}: its element never moves far enough for its law to show"
        cure = "increase the drive, or state a value"
    elif one.sort == "mixed":
        what, cure = _moves(one, found), give
    elif one.sort == "scale":
        what, cure = _scaled(one, found, model, give)
    else:
        only = combinations_in_words(one)
        what = f"only {_named(only)} can be found, not {_named(names)} separately"
        if not only:
            what = f"{_named(names)} are not determined at all"
        if one.sort == "sum" and elements.issuperset(names):
            reason, more = _parallel(names, model)
            what, give = f"{what}: {reason}", f"{give}{more}"
        elif one.sort == "series":
            points = [set(e.along) for e in model.elements if e.name in names]
            shared = set.intersection(*points) if points else set()
            what += f": they are in series{f' through {_named(sorted(shared))}' if shared else ''}"
        cure = give
    sensors = []
    for channel in one.sensors[:4]:
        (name,) = channel.of
        if channel.quantity is Quantity.FORCE:
            name = f"the force {name}" if name in model.force_inputs else f"the force that moves {name}"
        sensors.append(name)
    if sensors:
        cure += f", or measure {', '.join(sensors[:-1])}{' or ' if sensors[1:] else ''}{sensors[-1]}"
    return what, cure


def combinations_in_words(one: Deficiency) -> tuple[str, ...]:
    """The sums, products or sums of reciprocals that can be found."""
    power = _POWERS.get(one.sort, 0)
    texts = []
    for row in one.combinations:
        terms = []
        for x, name in zip(row.tolist(), one.names, strict=True):
            near = float(Fraction(x).limit_denominator(12))
            if x != 0:
                terms.append((near if abs(near - x) < 1e-5 * abs(x) else x, name))
        if power == 1:
            over = "·".join(_to_the(name, x) for x, name in terms if x > 0) or "1"
            under = [_to_the(name, -x) for x, name in terms if x < 0]
            below = under[0] if len(under) == 1 else f"({'·'.join(under)})"
            texts.append(f"{over}/{below}" if under else over)
        else:
            text = ""
            for x, name in terms:
                size = "" if abs(abs(x) - 1) < 1e-9 else f"{abs(x):.4g}"
                body = f"{size or '1'}/{name}" if power == 2 else f"{size}·{name}" if size else name
                text += (" - " if x < 0 else " + ") + body if text else ("-" if x < 0 else "") + body
            texts.append(text)
    return tuple(texts)


def _parallel(names: tuple[str, ...], model: Model) -> tuple[str, str]:
    """Why sums are all there is, and a cure other than values."""
    elements = [element for element in model.elements if element.name in names]
    matrices = {e.law.matrix for e in elements}
    tied = {e.same_as for e in model.elements if e.same_as is not None}
    first = elements[0].along
    if len(matrices) > 1:
        return "no measurement separates them", ""
    alike = not tied & set(names)  # stretched alike, but for a factor
    for e in elements:
        ratios = [e.along.get(point, 0.0) / first[point] for point in first]
        alike = alike and e.along.keys() == first.keys() and bool(np.allclose(ratios, ratios[0]))
    if alike:
        together = "both" if len(elements) == 2 else "all"
        verb = "move with" if elements[0].kind is Kind.MASS and len(first) == 1 else "join"
        ends = list(first)
        if len(ends) == 1:
            place = f"{ends[0]} to ground"
        elif len(ends) == 2 and abs(sum(first.values())) < 1e-12:
            place = f"{ends[0]} to {ends[1]}"
        else:
            place = "the same points"
        return f"{together} {verb} {place}", ", or attach one elsewhere"
    return "together they act as one element", ", or attach one elsewhere"


def _scaled(one: Deficiency, found: Structure, model: Model, give: str) -> tuple[str, str]:
    names = one.names
    elements = [element for element in model.elements if element.name in names]
    masses = [element.name for element in elements if element.kind is Kind.MASS]
    cure = f"{give} (weigh {masses[0]}, say)" if masses else give
    exponents = _relative(one, found)
    even = len(exponents) == 1 and np.allclose(exponents[0], exponents[0, 0], rtol=1e-5)
    if even and set(names) == set(model.unknown_names):
        why = " and the drive is a displacement" if model.inputs else " and no force is measured"
        driven = "" if model.force_inputs else why
        together = f"the scale of the forces is not fixed: only the ratios of {_named(names)} can be found"
        return f"no mass, stiffness or force is known{driven}, so {together}", cure
    if even and not elements:
        return (
            f"only the ratios of {_named(names)} can be found",
            f"{give}, such as 1; no other value depends on it",
        )
    if even:
        return f"the forces of {_named(names)} scale together: only their ratios can be found", cure
    only = combinations_in_words(one)
    if len(only) <= 6:
        return f"only {_named(only)} can be found, not {_named(names)} separately", cure
    up = [n for n, x in zip(names, exponents[0], strict=True) if x > 0]
    down = [n for n, x in zip(names, exponents[0], strict=True) if x < 0]
    text = f"any factor on {_named(up)} is undone by its inverse (or a power of it) on {_named(down)}"
    return f"only products and ratios of {_named(names)} can be found: {text}", cure


def _moves(one: Deficiency, found: Structure) -> str:
    """A direction that depends on the rig, in per cent at the nominal values."""
    columns = [found.names.index(name) for name in one.names]
    parts = []
    for direction, share in zip(one.directions[:2, columns], _relative(one, found)[:2], strict=True):
        moved = [
            f"{name} {absolute:+.2g} s"
            if name.endswith(".delay")
            else f"{name} {100 * part:{'+.0f' if abs(part) >= 0.995 else '+.2g'}} %"
            for name, absolute, part in zip(one.names, direction, share, strict=True)
            if part != 0
        ]
        parts.append(", ".join(moved[:8]) + (" …" if len(moved) > 8 else ""))
    count = len(one.directions)
    more = "" if count <= 2 else f" and {count - 2} more"
    return (
        f"{_named(one.names)} can change together and leave the response unchanged (near the nominal values "
        f"{' or '.join(parts)}{more})"
    )


def _relative(one: Deficiency, found: Structure) -> Real:
    """The directions in parts of the nominal values, (k, names)."""
    columns = [found.names.index(name) for name in one.names]
    scale = np.where(found.nominal == 0, 1.0, found.nominal)
    return (one.directions / scale)[:, columns]


def _unseen(one: Deficiency, found: Structure, model: Model, channels: Sequence[Channel]) -> tuple[str, str]:
    inputs = [*model.displacement_inputs, *model.force_inputs]
    quiet = [u for u in inputs if not any(u in channel.of for channel in channels)]
    if len(one.names) == len(found.names) and quiet:
        count = len(channels)
        seen = "one channel is not enough" if count == 1 else f"{count} channels are not enough"
        inputs_are = f"the input {_named(quiet)} is" if len(quiet) == 1 else f"the inputs {_named(quiet)} are"
        return f"{seen} while {inputs_are} unmeasured", f"measure {quiet[0]}, or add sensors"
    give = "state its value or remove it" if len(one.names) == 1 else "state their values or remove them"
    what = f"no measured channel depends on {_named(one.names)}"
    # Coordinates that these elements join and no mass, which follow their neighbours without any force
    joined = {point for element in model.elements if element.name in one.names for point in element.along}
    heavy = {point for element in model.elements if element.kind is Kind.MASS for point in element.along}
    light = [x for x in model.coordinates if x in joined - heavy]
    if not light:
        return what, give
    has = "has" if len(light) == 1 else "have"
    return (
        f"{what}: {_named(light)} {has} no mass",
        f'add [masses] m_{light[0]} = {{ at = "{light[0]}" }}, or {give}',
    )


def _to_the(name: str, x: float) -> str:
    return name if abs(x - 1) < 1e-9 else f"{name}^{x:.3g}"


def _named(names: Sequence[str]) -> str:
    """The names in a sentence, all of them but for very large rigs."""
    # 100 unknowns at the most in one sentence: an undetermined rig of 24 coordinates may have 72
    return listed(names, 100)
