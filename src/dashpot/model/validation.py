"""What may be wrong with a model: everything is found and told at once, placed at the name that is wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

import numpy as np

from dashpot.errors import Problem
from dashpot.io.words import listed
from dashpot.model.elements import Element
from dashpot.model.inputs import Input
from dashpot.quantities import LARGEST, SMALLEST

MOST_TOLD = 20  # links of a circle of ties


def problems(
    coordinates: Sequence[str],
    inputs: Sequence[Input],
    elements: Sequence[Element],
    angles: Iterable[str] = (),
    complete: bool = True,
) -> Iterator[Problem]:
    """Everything that is wrong with the parts of a model, each placed at the name of what is wrong.

    With `complete` False some inputs or elements are missing (a file's reader has found them faulty already), and
    what only their absence may have caused is not reported.
    """
    yield from _name_problems(coordinates, inputs, elements)
    if complete and not coordinates:
        yield Problem("there are no coordinates", "coordinates", 'list them, such as coordinates = ["x1"]')
    if complete and not elements:
        yield Problem("there are no elements", "masses", "add masses, springs or dampers")
    complete = complete and bool(coordinates) and bool(elements)
    moved = [source.name for source in inputs if source.kind == "displacement"]
    points = dict.fromkeys((*coordinates, *moved))
    for source in inputs:
        yield from _input_problems(source, coordinates, complete)
    for element in elements:
        yield from _element_problems(element, points, complete)
    yield from _tie_problems(elements, frozenset(angles), complete)
    if complete:
        yield from _loose_ends(coordinates, moved, elements, set(angles) - set(points))


def _loose_ends(
    coordinates: Sequence[str], moved: Sequence[str], elements: Sequence[Element], strangers: Collection[str]
) -> Iterator[Problem]:
    """Points that nothing is attached to, and angles that are no points."""
    attached = {point for element in elements for point in element.along}
    for name in moved:
        if name not in attached:
            what = f"no element is attached to the input {name}"
            yield Problem(what, name, "attach one or remove the input")
    for name in sorted(strangers):
        what = f"{name} is neither a coordinate nor a displacement input"
        yield Problem(what, "angles", f"there are {listed((*coordinates, *moved))}")
    for name in dict.fromkeys(coordinates):
        if name not in attached:
            what = f"nothing is attached to the coordinate {name}"
            yield Problem(what, name, "attach an element or remove it")


def _name_problems(
    coordinates: Sequence[str], inputs: Sequence[Input], elements: Sequence[Element]
) -> Iterator[Problem]:
    names = [*coordinates, *(source.name for source in inputs), *(element.name for element in elements)]
    for name, count in Counter(names).items():
        if name == "ground":
            yield Problem("the name ground is taken: it is the inertial ground", name, "choose another name")
        elif not name.isprintable() or name != name.strip() or not name:
            yield Problem(
                f"{name!r} is not a usable name",
                name,
                "use a name without line breaks, tabs or spaces at its ends",
            )
        elif count > 1:
            yield Problem(
                f"the name {name} is used {count} times",
                name,
                "every coordinate, input and element needs its own",
            )


def _input_problems(source: Input, coordinates: Sequence[str], complete: bool) -> Iterator[Problem]:
    if source.kind not in ("displacement", "force"):
        yield Problem(f"{source.kind!r} is not a kind of input", source.name, 'use "displacement" or "force"')
        return
    if source.kind == "displacement":
        if source.at:
            yield Problem(
                "a displacement input takes no `at`",
                source.name,
                "elements attach to it by its name in `between`",
            )
        return
    if not source.at:
        yield Problem("a force input must say where it acts", source.name, 'add at = "x1"')
    for coordinate, factor in source.at.items():
        if complete and coordinate not in coordinates:
            cure = f"a force acts at coordinates: {listed(coordinates)}"
            yield Problem(f"the force acts at {coordinate}, which is not a coordinate", source.name, cure)
        else:
            yield from _factor_problems(coordinate, factor, source.name)


def _factor_problems(point: str, factor: float, name: str) -> Iterator[Problem]:
    if not SMALLEST <= abs(factor) <= LARGEST:
        cure = f"give a factor other than 0, from {SMALLEST:g} to {LARGEST:g} in size"
        yield Problem(f"the factor of {point} is {factor:g}", name, cure)


def _element_problems(element: Element, points: Collection[str], complete: bool) -> Iterator[Problem]:
    name = element.name
    if not element.along and element.block != name:
        yield Problem("both ends are on the ground", name, "attach it to a coordinate")
    for point, factor in element.along.items():
        if complete and point not in points:
            cure = f"there are {listed(points)}"
            yield Problem(f"{point} is neither a coordinate nor a displacement input", name, cure)
        else:
            yield from _factor_problems(point, factor, name)
    numbers = _numbers(element)
    for key, number in numbers.items():
        if not np.isfinite(number):
            yield Problem(f"{key} is {number:g}", name, "give a finite number")
    yield from _value_problems(element)
    yield from _limit_problems(name, numbers)


def _value_problems(element: Element) -> Iterator[Problem]:
    name, value, sd = element.name, element.value, element.sd
    if value is not None and value < 0 and element.force_law is None:
        what = f"a {element.kind} of {value:g} {element.law.unit()} is negative"
        yield Problem(what, name, "give a value of 0 or more")
    # Below 1e-150 the weight 1/sd² leaves the range of numbers.
    if sd is not None and sd < 1e-150:
        yield Problem(f"sd is {sd:g}", name, "give a positive sd, or leave it out where the value is exact")
    if sd is not None and value is None:
        yield Problem("sd without a value", name, "give the value that the sd belongs to")
    if element.guess is not None and value is not None:
        yield Problem("both a value and a guess", name, "a known parameter needs no guess: remove one")


def _limit_problems(name: str, numbers: Mapping[str, float]) -> Iterator[Problem]:
    lower, upper = numbers.get("min", -np.inf), numbers.get("max", np.inf)
    if lower >= upper:
        yield Problem(f"min {lower:g} is not below max {upper:g}", name, "exchange or change them")
        return
    for key in ("value", "guess"):
        if key not in numbers:
            continue
        if numbers[key] < lower:
            what = f"the {key} {numbers[key]:g} is below min {lower:g}"
            yield Problem(what, name, f"change the {key} or min")
        if numbers[key] > upper:
            what = f"the {key} {numbers[key]:g} is above max {upper:g}"
            yield Problem(what, name, f"change the {key} or max")


def _numbers(element: Element) -> dict[str, float]:
    """The numbers that an element states, under the names that a rig file gives them."""
    numbers = {
        "value": element.value, "sd": element.sd, "guess": element.guess, "min": element.lower, "max": element.upper,
        "times": element.times,
    }  # fmt: skip
    return {key: number for key, number in numbers.items() if number is not None}


def _tie_problems(elements: Sequence[Element], angles: frozenset[str], complete: bool) -> Iterator[Problem]:
    by_name = {element.name: element for element in elements}
    ends = _tie_ends(by_name)
    for element in elements:
        if element.same_as is not None:
            yield from _tied_problems(element, by_name, ends, angles, complete)
        elif element.times != 1.0:
            cure = "say which element it is a multiple of"
            yield Problem("`times` without `same_as`", element.name, cure)


def _tied_problems(
    element: Element,
    by_name: Mapping[str, Element],
    ends: Mapping[str, str | None],
    angles: frozenset[str],
    complete: bool,
) -> Iterator[Problem]:
    if element.times == 0:
        yield Problem("times is 0", element.name, "remove the element instead")
    if _numbers(element).keys() - {"times"}:
        cure = "keep same_as or the numbers, not both"
        yield Problem("a tied parameter has a value, guess or limit of its own", element.name, cure)
    end = ends[element.name]
    if end is None:
        circle = _circle(element, by_name)
        if circle is not None:
            yield Problem(f"a circular tie: {circle}", element.name, "let one of them stand alone")
    elif end in by_name:
        root = by_name[end]
        unit, root_unit = element.unit(angles), root.unit(angles)
        if unit != root_unit:
            what = f"a {element.kind} ({unit}) cannot be tied to the {root.kind} {root.name} ({root_unit})"
            yield Problem(what, element.name, "tie parameters of one unit")
    elif end == element.same_as and complete:
        cure = f"there are {listed(by_name)}"
        yield Problem(f"same_as names {end}, which is not an element", element.name, cure)


def _tie_ends(by_name: Mapping[str, Element]) -> dict[str, str | None]:
    """Where the chain of ties of each element ends, None where it runs into a circle; each tie is followed once."""
    ends: dict[str, str | None] = {}
    for name in by_name:
        chain: dict[str, None] = {}
        at: str = name
        while at in by_name and at not in ends and at not in chain:
            chain[at] = None
            target = by_name[at].same_as
            if target is None:
                break
            at = target
        end = None if at in chain and by_name[at].same_as is not None else ends.get(at, at)
        ends.update(dict.fromkeys(chain, end))
    return ends


def _circle(element: Element, by_name: Mapping[str, Element]) -> str | None:
    """The circle that a tie is part of, None where it only leads into one; of a long one its beginning."""
    chain = [element.name]
    while len(chain) <= MOST_TOLD:
        target = by_name[chain[-1]].same_as
        if target == element.name:
            return " → ".join([*chain, target])
        if target is None or target in chain:
            return None
        chain.append(target)
    return " → ".join([*chain, "…"])
