"""The network of elements: incidence, ties, and the map from unknowns to parameters (THEORY §1).

p = T θ + p⁰        δ = B x + D u        Bᵀ (p ∘ a) = S f
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from dashpot.arrays import Bools, Complex, Ints, Real, frozen
from dashpot.channel import kind_of
from dashpot.errors import ModelError, Problem, UsageError, printable
from dashpot.io.words import choose_from, counted, listed, shown
from dashpot.model.elements import MATRICES, Element, Kind
from dashpot.model.nonlinear.force_law import Constant, ForceLaw, unit_of
from dashpot.quantities import LARGEST, SMALLEST
from dashpot.unknowns import Unknown, bounds_of, prior_mean, prior_precision

# Parameters that are tied to others.


@dataclass(frozen=True)
class Tie:
    """Where an element's parameter comes from: `times` the parameter of the element at index `root`."""

    root: int
    times: float


# Inputs: what drives a rig.


InputKind = Literal["displacement", "force"]
Distribution = Literal["normal", "student", "auto"]


@dataclass(frozen=True)
class Input:
    """A prescribed displacement, or a force.

    name  of the input
    kind  "displacement" or "force"
    at    of a force: coordinates and their factors, or arms in m
    """

    name: str
    kind: InputKind = "displacement"
    at: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", MappingProxyType(dict(self.at)))

    def __reduce__(self) -> tuple[object, ...]:
        return (Input, (self.name, self.kind, dict(self.at)))

    def __hash__(self) -> int:
        return hash((self.name, self.kind, frozenset(self.at.items())))


# Products of sparse incidence matrices, row by row, without a loop over the rows.


def row_products(left: sparse.csr_array, right: sparse.csr_array) -> sparse.csr_array:
    """Row i: the outer product of row i of both, flattened; (rows, columns of left · columns of right)."""
    width = right.shape[1]
    of_left, of_right = np.diff(left.indptr), np.diff(right.indptr)
    pairs = of_left.astype(np.int64) * of_right
    row = np.repeat(np.arange(left.shape[0]), pairs)
    ends = np.cumsum(pairs)
    within = np.arange(len(row)) - np.repeat(ends - pairs, pairs)
    across = np.maximum(of_right, 1)[row]
    a = left.indptr[row] + within // across
    b = right.indptr[row] + within % across
    columns = left.indices[a].astype(np.int64) * width + right.indices[b]
    indptr = np.concatenate([[0], ends])
    shape = (left.shape[0], left.shape[1] * width)
    return sparse.csr_array((left.data[a] * right.data[b], columns, indptr), shape=shape)


# What has been made of a model lately, kept because it is asked for over and over.


MOST = 8


class Recent(dict[tuple[object, ...], Any]):
    """The last MOST entries; the oldest goes where there are more."""

    def __setitem__(self, key: tuple[object, ...], value: Any) -> None:
        if key not in self and len(self) >= MOST:
            del self[next(iter(self))]
        super().__setitem__(key, value)


# What may be wrong with a model: everything is found and told at once, placed at the name that is wrong.


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
    names = [*coordinates, *(source.name for source in inputs), *(element.name for element in elements)]
    for name, count in Counter(names).items():
        if name == "ground":
            yield Problem("the name ground is taken: it is the inertial ground", name, "choose another name")
        elif not name.isprintable() or name != name.strip() or name in ("", "?"):
            yield Problem(
                f"{name!r} is not a usable name",
                name,
                "use a name without line breaks, tabs or spaces at its ends; replace ? by a name",
            )
        elif count > 1:
            yield Problem(
                f"the name {name} is used {count} times",
                name,
                "every coordinate, input and element needs its own",
            )
    moved = [source.name for source in inputs if source.kind == "displacement"]
    reached = {point for element in elements for point in element.along}
    unlisted = not coordinates and (not moved or bool(reached - set(moved)))  # else a stand of elements alone
    if complete and unlisted:
        yield Problem("there are no coordinates", "coordinates", 'list them, such as coordinates = ["x1"]')
    if complete and not elements:
        yield Problem("there are no elements", "masses", "add masses, springs or dampers")
    complete = complete and not unlisted and bool(elements)
    points = dict.fromkeys((*coordinates, *moved))
    for source in inputs:
        yield from _input_problems(source, coordinates, complete)
    for element in elements:
        yield from _element_problems(element, points, complete)
    yield from _tie_problems(elements, frozenset(angles), complete)
    if complete:
        # Points that nothing is attached to, and angles that are no points
        strangers = set(angles) - set(points)
        for name in moved:
            if name not in reached:
                what = f"no element is attached to the input {name}"
                yield Problem(what, name, "attach one or remove the input")
        for name in sorted(strangers):
            what = f"{name} is neither a coordinate nor a displacement input"
            yield Problem(what, "angles", choose_from((*coordinates, *moved)))
        for name in dict.fromkeys(coordinates):
            if name not in reached:
                what = f"nothing is attached to the coordinate {name}"
                yield Problem(what, name, "attach an element or remove it")


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
            cure = choose_from(points)
            yield Problem(f"{point} is neither a coordinate nor a displacement input", name, cure)
        else:
            yield from _factor_problems(point, factor, name)
    numbers = _numbers(element)
    for key, number in numbers.items():
        if not np.isfinite(number):
            yield Problem(f"{key} is {number:g}", name, "give a finite number")
    value = element.value
    if value is not None and value < 0 and element.force_law is None:
        what = f"a {element.kind} of {value:g} {element.law.unit()} is negative"
        yield Problem(what, element.name, "give a value of 0 or more")
    yield from number_problems(name, numbers)


def number_problems(name: str, numbers: Mapping[str, float]) -> Iterator[Problem]:
    """What is wrong with the numbers of an unknown, by the keys of a rig file."""
    value, sd = numbers.get("value"), numbers.get("sd")
    # Below 1e-150 the weight 1/sd² leaves the range of numbers.
    if sd is not None and sd < 1e-150:
        yield Problem(f"sd is {sd:g}", name, "give a positive sd, or leave it out if the value is exact")
    if sd is not None and value is None:
        yield Problem("sd without a value", name, "give the value that the sd belongs to")
    if "guess" in numbers and value is not None:
        yield Problem("both a value and a guess", name, "a known parameter needs no guess: remove one")
    lower, upper = numbers.get("min", -np.inf), numbers.get("max", np.inf)
    if lower >= upper:
        yield Problem(f"min {lower:g} is not below max {upper:g}", name, "swap or change them")
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
    named = {"value": "value", "sd": "sd", "guess": "guess", "min": "lower", "max": "upper", "times": "times"}
    numbers = {key: getattr(element, field) for key, field in named.items()}
    return {key: number for key, number in numbers.items() if number is not None}


def _tie_problems(elements: Sequence[Element], angles: frozenset[str], complete: bool) -> Iterator[Problem]:
    by_name = {element.name: element for element in elements}
    # Where the chain of ties of each element ends, None where it runs into a circle; each tie is followed
    # once
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
    for element in elements:
        if element.same_as is not None:
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
                cure = choose_from(by_name)
                yield Problem(f"same_as names {end}, which is not an element", element.name, cure)
        elif element.times != 1.0:
            cure = "say which element it is a multiple of"
            yield Problem("`times` without `same_as`", element.name, cure)


def _circle(element: Element, by_name: Mapping[str, Element]) -> str | None:
    """The circle that a tie is part of, None where it only leads into one; of a long one its beginning."""
    chain = [element.name]
    while len(chain) <= 20:  # links of a circle of ties
        target = by_name[chain[-1]].same_as
        if target == element.name:
            return " → ".join([*chain, target])
        if target is None or target in chain:
            return None
        chain.append(target)
    return " → ".join([*chain, "…"])


DENSE = 1_000_000  # numbers up to which products of incidences are kept as full matrices


@dataclass(frozen=True)
class Model:
    """A rig: coordinates, inputs and elements.  Immutable; knows nothing of data.

    `angles` names the coordinates and displacement inputs that are angles (rad); elements that join only angles have
    parameters in kg·m², N·m·s/rad and N·m/rad.  `name` is kept on one line, control characters escaped.
    `experiments` names tests in which the rig differs: some elements are present in one of them only.  A Model is the
    rig in one of them, number `standing`, or in none (0); `standing_in` gives the others, with the same elements and
    unknowns.  `distribution` is that of the sensor noise: "normal", "student" (heavy tails), or "auto" (heavy tails if
    the data show them).

    Raises ModelError with every problem found, each placed at the faulty name.
    """

    coordinates: tuple[str, ...]
    inputs: tuple[Input, ...]
    elements: tuple[Element, ...]
    name: str = ""
    angles: frozenset[str] = frozenset()
    experiments: tuple[str, ...] = ()
    standing: int = 0
    distribution: Distribution = "normal"

    def __post_init__(self) -> None:
        for name in ("coordinates", "inputs", "elements", "experiments"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "angles", frozenset(self.angles))
        object.__setattr__(self, "name", printable(" ".join(self.name.split())))
        faults = list(problems(self.coordinates, self.inputs, self.elements, self.angles))
        if faults:
            raise ModelError(faults)

    @property
    def summary(self) -> str:
        """Name and size in a few words: "Two masses: 2 coordinates, 1 input, 8 elements, 6 unknowns"."""
        counts = (
            counted(self.n, "coordinate"),
            counted(len(self.inputs), "input"),
            counted(len(self.elements), "element"),
            counted(len(self.unknowns), "unknown"),
        )
        return f"{shown(self.name)}: {', '.join(counts)}" if self.name else ", ".join(counts)

    def __repr__(self) -> str:
        return f"<Model {self.summary}>"

    # Names and counts

    @property
    def displacement_inputs(self) -> tuple[str, ...]:
        """Names of the r displacement inputs, in order."""
        return tuple(source.name for source in self.inputs if source.kind == "displacement")

    @property
    def force_inputs(self) -> tuple[str, ...]:
        """Names of the s force inputs, in order."""
        return tuple(source.name for source in self.inputs if source.kind == "force")

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    # Incidence

    def _incidence(self, points: Sequence[str]) -> sparse.csr_array:
        index = {name: i for i, name in enumerate(points)}
        rows, columns, factors = [], [], []
        for row, element in enumerate(self.elements):
            for point, factor in element.along.items():
                if point in index:
                    rows.append(row)
                    columns.append(index[point])
                    factors.append(factor)
        shape = (len(self.elements), len(points))
        return sparse.csr_array((np.array(factors, dtype=float), (rows, columns)), shape=shape)

    @cached_property
    def sparse_B(self) -> sparse.csr_array:
        """Incidence over the coordinates, sparse, (elements, n)."""
        return self._incidence(self.coordinates)

    @cached_property
    def connected(self) -> tuple[sparse.csr_array, Bools]:
        """Parts that elements connect: their coordinates, (n, parts), and which inputs drive them, (parts, r + s)."""
        B = abs(self.sparse_B)
        count, part = connected_components(B.T @ B, directed=False)
        member = sparse.csr_array((np.ones(self.n), (np.arange(self.n), part)), shape=(self.n, count))
        driven = np.concatenate([B.T @ abs(self.D), abs(self.S)], axis=1)
        return member, member.T @ driven > 0

    @cached_property
    def B(self) -> Real:
        """Incidence over the coordinates, (elements, n): factors, or arms in m.  THEORY (E)."""
        return frozen(self.sparse_B.toarray(), np.float64)

    @cached_property
    def sparse_D(self) -> sparse.csr_array:
        """Incidence over the displacement inputs, sparse, (elements, r)."""
        return self._incidence(self.displacement_inputs)

    @cached_property
    def D(self) -> Real:
        """Incidence over the displacement inputs, (elements, r): factors, or arms in m.  THEORY (E)."""
        return frozen(self.sparse_D.toarray(), np.float64)

    @cached_property
    def S(self) -> Real:
        """Where the force inputs act, (n, s): factors, or arms in m.  THEORY (E)."""
        S = np.zeros((self.n, len(self.force_inputs)))
        index = {name: i for i, name in enumerate(self.coordinates)}
        for column, source in enumerate(source for source in self.inputs if source.kind == "force"):
            for coordinate, factor in source.at.items():
                S[index[coordinate], column] = factor
        return frozen(S, np.float64)

    # Experiments in which some elements are others

    @cached_property
    def differs(self) -> bool:
        """Whether some elements belong to one experiment only."""
        return any(element.only is not None for element in self.elements)

    @property
    def here(self) -> str | None:
        """Name of the experiment that the rig is in, None for none."""
        return self.experiments[self.standing - 1] if self.standing else None

    @cached_property
    def acts(self) -> Bools:
        """Which elements are present in this experiment, (elements,)."""
        here = self.here
        replaced = {e.stands_for for e in self.elements if here is not None and e.only == here}
        own = [e.only == here or (e.only is None and e.name not in replaced) for e in self.elements]
        return frozen(own, np.bool_)

    @property
    def present_elements(self) -> tuple[Element, ...]:
        """The elements that are present in this experiment."""
        return tuple(element for element, acts in zip(self.elements, self.acts, strict=True) if acts)

    @property
    def alone(self) -> Model:
        """The rig of this experiment, without the elements of others."""
        if not self.experiments:
            return self
        there = (replace(element, only=None, stands_for=None) for element in self.present_elements)
        return replace(self, elements=tuple(there), experiments=(), standing=0)

    def standing_in(self, number: int) -> Model:
        """The rig in one of its experiments, by number from 1; 0: in none of them."""
        if number not in self._standings:
            self._standings[number] = replace(self, standing=number)
        return self._standings[number]

    @cached_property
    def _standings(self) -> dict[int, Model]:
        return {self.standing: self}

    def by_experiment(self, experiment: Ints | None) -> Iterator[tuple[Model, slice | Ints]]:
        """The rig of each experiment, with the lines whose `experiment` (lines,) it is, numbered as in `channel.py`.

        If there are no experiments, or `experiment` is None, all lines belong to the rig as it is.
        """
        if experiment is None or not self.differs or not len(experiment):
            yield self, slice(None)
            return
        kind = self.kind_of(experiment)
        present = np.unique(kind)
        for number in present.tolist():
            lines = slice(None) if len(present) == 1 else np.flatnonzero(kind == number)
            yield self.standing_in(number), lines

    def kind_of(self, experiment: Ints) -> Ints:
        """Number from 1 of the experiment of each line, (lines,), 0 for none."""
        kind = kind_of(experiment)
        return np.where(kind <= len(self.experiments), kind, 0)

    # Laws

    @cached_property
    def kinds(self) -> tuple[Kind, ...]:
        """Kind of each element."""
        return tuple(element.kind for element in self.elements)

    @cached_property
    def _by_kind(self) -> Mapping[Kind, Ints]:
        return {
            kind: frozen(
                [
                    i
                    for i, e in enumerate(self.elements)
                    if e.kind is kind and e.force_law is None and self.acts[i]
                ],
                np.int64,
            )
            for kind in dict.fromkeys(self.kinds)
        }

    @cached_property
    def nonlinear(self) -> Ints:
        """Indices of the elements with a nonlinear law, (e,)."""
        return frozen([i for i, e in enumerate(self.elements) if e.force_law is not None], np.int64)

    @cached_property
    def laws(self) -> tuple[ForceLaw, ...]:
        """The laws of the nonlinear elements, in order, (e,)."""
        return tuple(e.force_law for e in self.elements if e.force_law is not None)

    @cached_property
    def constants(self) -> tuple[tuple[Element, Constant], ...]:
        """Inner constants of the nonlinear laws, (G,), each with its element."""
        return tuple((e, c) for e in self.elements if e.force_law is not None for c in e.force_law.constants)

    @cached_property
    def constant_slices(self) -> tuple[slice, ...]:
        """For each nonlinear element, the slice of its constants among all of them."""
        counts = [len(e.force_law.constants) for e in self.elements if e.force_law is not None]
        ends = np.cumsum([0, *counts])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    def factors(self, omega: Real, experiment: Ints | None = None) -> Complex:
        """φ_i(ω) for `omega` of shape (lines,) in rad/s; shape (lines, elements); 0 for nonlinear elements.

        Also 0 for elements that are absent in the `experiment` of a line, (lines,).
        """
        phi = np.zeros((*omega.shape, len(self.elements)), dtype=np.complex128)
        for rig, lines in self.by_experiment(experiment):
            part = np.zeros((*omega[lines].shape, len(self.elements)), dtype=np.complex128)
            for kind, chosen in rig._by_kind.items():
                part[..., chosen] = kind.law.factor(omega[lines])[..., None]
            phi[lines] = part
        return phi

    def pole_factors(self, poles: Complex) -> Complex:
        """φ_i(λ), (..., elements), at complex rates (poles) λ (...,), 1/s."""
        phi = np.zeros((*poles.shape, len(self.elements)), dtype=np.complex128)
        for kind, chosen in self._by_kind.items():
            phi[..., chosen] = kind.law.pole_factor(poles)[..., None]
        return phi

    # Unknowns

    @cached_property
    def ties(self) -> tuple[Tie, ...]:
        """For each element, the element whose value it takes and the factor."""
        index = {element.name: i for i, element in enumerate(self.elements)}
        known: dict[int, Tie] = {}
        for i in range(len(self.elements)):
            chain = [i]  # followed to what is known already, so that each tie is followed once
            while chain[-1] not in known and (target := self.elements[chain[-1]].same_as) is not None:
                chain.append(index[target])
            tie = known.setdefault(chain[-1], Tie(chain[-1], 1.0))
            for j in reversed(chain[:-1]):
                tie = known[j] = Tie(tie.root, self.elements[j].times * tie.times)
        return tuple(known[i] for i in range(len(self.elements)))

    @cached_property
    def _unknown_roots(self) -> tuple[int, ...]:
        return tuple(
            i
            for i, element in enumerate(self.elements)
            if element.same_as is None and (element.value is None or element.sd is not None)
        )

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The unknowns of θ: parameters in the order of the elements, then inner constants of nonlinear laws."""
        chosen = (self.elements[i] for i in self._unknown_roots)
        parts = [Unknown(e.name, self.unit(e), e.value, e.sd, e.guess, e.lower, e.upper) for e in chosen]
        inner = [
            Unknown(f"{e.name}.{c.name}", self.constant_unit(e, c), c.value, c.sd, c.guess, c.lower, c.upper)
            for e, c in self.constants
            if c.unknown
        ]
        return (*parts, *inner)

    @cached_property
    def unknown_names(self) -> tuple[str, ...]:
        """Their names, in order."""
        return tuple(unknown.name for unknown in self.unknowns)

    @cached_property
    def unknown_units(self) -> tuple[str, ...]:
        """Their units."""
        return tuple(unknown.unit for unknown in self.unknowns)

    @cached_property
    def sparse_T(self) -> sparse.csr_array:
        """∂p/∂θ, sparse, (elements, unknowns): every element has one unknown at most."""
        column = {root: j for j, root in enumerate(self._unknown_roots)}
        entries = [(i, column[tie.root], tie.times) for i, tie in enumerate(self.ties) if tie.root in column]
        rows, columns, times = zip(*entries, strict=True) if entries else ((), (), ())
        shape = (len(self.elements), len(self.unknowns))
        return sparse.csr_array((np.array(times, dtype=float), (rows, columns)), shape=shape)

    @cached_property
    def T(self) -> Real:
        """∂p/∂θ, (elements, unknowns).  THEORY §1."""
        return frozen(self.sparse_T.toarray(), np.float64)

    @cached_property
    def pushes(self) -> Real:
        """−Bᵀ ∘ T, (n · unknowns, elements): N on a coordinate by an unknown, per N of an element's unit force."""
        return frozen((-self.B.T[:, None, :] * self.T.T).reshape(-1, len(self.elements)), np.float64)

    @cached_property
    def p0(self) -> Real:
        """p⁰, the known part of the parameters, (elements,), SI units; zero where unknown."""
        p0 = np.zeros(len(self.elements))
        unknown = set(self._unknown_roots)
        for i, tie in enumerate(self.ties):
            value = self.elements[tie.root].value
            if value is not None and tie.root not in unknown:
                p0[i] = tie.times * value
        return frozen(p0, np.float64)

    @cached_property
    def known_parameters(self) -> tuple[tuple[str, float, str], ...]:
        """(name, value, unit) of inner constants and parameters that are exactly known, those of entries left out."""
        constants = tuple(
            (f"{e.name}.{c.name}", float(c.value), self.constant_unit(e, c))
            for e, c in self.constants
            if not c.unknown and c.value is not None
        )
        unknown = set(self.unknown_names)
        return constants + tuple(
            (element.name, float(value), self.unit(element))
            for element, value, moved in zip(self.elements, self.p0, self._moved, strict=True)
            if element.name not in unknown and not moved and not element.is_entry
        )

    @cached_property
    def tied_parameters(self) -> tuple[tuple[str, str, float, str], ...]:
        """(name, unknown, times, unit) of the parameters that are a multiple of an unknown."""
        return tuple(
            (element.name, self.elements[tie.root].name, tie.times, self.unit(element))
            for element, tie, moved in zip(self.elements, self.ties, self._moved, strict=True)
            if element.same_as is not None and not element.is_entry and moved
        )

    @property
    def _moved(self) -> list[bool]:
        """Whether an element's parameter follows from an unknown, (elements,)."""
        return (np.diff(self.sparse_T.indptr) > 0).tolist()

    def parameters(self, theta: Real) -> Real:
        """p = T θ + p⁰, (..., elements), of θ (..., unknowns), SI units."""
        if len(self.elements) * len(self.unknowns) <= DENSE:
            return theta @ self.T.T + self.p0
        flat: Real = theta.reshape(-1, theta.shape[-1]) @ self.sparse_T.T
        return flat.reshape(*theta.shape[:-1], len(self.elements)) + self.p0

    @cached_property
    def constants_map(self) -> tuple[Real, Real]:
        """(∂g/∂θ (G, unknowns), g⁰ (G,)): inner constants g of the nonlinear laws, SI units, from the unknowns."""
        slope, known = np.zeros((len(self.constants), len(self.unknowns))), np.zeros(len(self.constants))
        column = len(self._unknown_roots)
        for row, (_, constant) in enumerate(self.constants):
            if constant.unknown:
                slope[row, column] = 1.0
                column += 1
            else:
                known[row] = constant.value
        return frozen(slope, np.float64), frozen(known, np.float64)

    def inner_constants(self, theta: Real) -> Real:
        """Inner constants of the nonlinear laws, (..., G), of θ (..., unknowns), SI units."""
        slope, known = self.constants_map
        return np.asarray(theta @ slope.T + known)

    def constant_unit(self, element: Element, constant: Constant) -> str:
        """SI unit of an inner constant."""
        assert element.force_law is not None
        angular = bool(element.along) and all(point in self.angles for point in element.along)
        return unit_of(element.force_law.exponents[1].get(constant.name, (0.0, 0.0)), angle=angular)

    def theta(self, values: Mapping[str, float]) -> Real:
        """θ, (unknowns,), from values by name, else the model's values or guesses.  Raises ModelError if none is."""
        theta = np.empty(len(self.unknowns))
        for j, unknown in enumerate(self.unknowns):
            value = values.get(unknown.name, unknown.nominal)
            if value is None:
                give = f"give it one ({unknown.name}=1.0; of a command --set {unknown.name}=1.0)"
                cure = f"{give}, or a guess in the rig file"
                raise ModelError(f"{unknown.name} has no value", cure=cure)
            theta[j] = value
        others = sorted(map(str, set(values) - set(self.unknown_names)))
        if others:
            cure = f"its unknowns are {', '.join(self.unknown_names)}"
            raise ModelError(f"{', '.join(others)} is not an unknown of this rig", cure=cure)
        return theta

    @cached_property
    def prior_precision(self) -> Real:
        """1/sd² of the unknowns that are known with an sd, else 0; (unknowns,)."""
        return prior_precision(self.unknowns)

    @cached_property
    def prior_mean(self) -> Real:
        """Values of the unknowns that are known with an sd, else 0; (unknowns,)."""
        return prior_mean(self.unknowns)

    def require_unknowns(self, where: str | None = None) -> None:
        """Raises UsageError, placed at the file `where`, if nothing is unknown."""
        if not self.unknowns:
            raise UsageError(
                "every parameter of the rig is known",
                where,
                "leave out the value of the parameters to be estimated",
            )

    @cached_property
    def bounds(self) -> tuple[Real, Real]:
        """Least and largest values allowed to the unknowns, (unknowns,) each, SI units; ∓inf where none is."""
        return bounds_of(self.unknowns)

    def unit(self, element: Element) -> str:
        """SI unit of an element's parameter."""
        return element.unit(self.angles)

    # Groups of elements that the dynamics need

    @cached_property
    def by_matrix(self) -> Mapping[str, Ints]:
        """Indices of the present elements that enter M, C, K and the hysteretic H, (elements,) each."""
        return {
            letter: frozen(
                [
                    i
                    for i, e in enumerate(self.elements)
                    if e.law.matrix == letter and e.force_law is None and self.acts[i]
                ],
                np.int64,
            )
            for letter in MATRICES
        }

    @cached_property
    def letters(self) -> Ints:
        """Index in MATRICES of the matrix that each element enters, −1 for nonlinear and absent ones; (elements,)."""
        index = {letter: k for k, letter in enumerate(MATRICES)}
        linear = [e.force_law is None and bool(self.acts[i]) for i, e in enumerate(self.elements)]
        letters = [index[e.law.matrix] for e in self.elements]
        return frozen(np.where(linear, letters, -1), np.int64)

    @cached_property
    def products(self) -> Mapping[str, Real | sparse.csr_array]:
        """b_iᵀ [b_i | d_i] of the elements of M, C, K and H, flattened: (elements, columns) each, n (n + r) columns.

        Sparse where the rig is large: an element joins few points.
        """
        span = sparse.csr_array(sparse.hstack([self.sparse_B, self.sparse_D]))
        flat = {letter: row_products(self.sparse_B[i], span[i]) for letter, i in self.by_matrix.items()}
        small = len(self.elements) * self.n * span.shape[1] <= DENSE
        return {key: frozen(part.toarray(), np.float64) if small else part for key, part in flat.items()}

    @cached_property
    def assembly(self) -> tuple[Ints, Ints, sparse.csr_array]:
        """(indices, indptr, A) of the sparse dynamic stiffness by columns: its entries are A (p φ)."""
        flat = row_products(self.sparse_B, self.sparse_B).tocoo()
        # A cell is row · n + column; as the matrix is symmetric, its rows serve as columns.
        cells, place = np.unique(flat.col, return_inverse=True)
        A = sparse.csr_array((flat.data, (place, flat.row)), shape=(len(cells), len(self.elements)))
        counts = np.bincount(cells // self.n, minlength=self.n)
        indptr = np.concatenate([[0], np.cumsum(counts)])
        return frozen(cells % self.n, np.int64), frozen(indptr, np.int64), A

    @cached_property
    def views(self) -> Recent:
        """Cache of what was derived from this model for channels and frequencies."""
        return Recent()

    def __getstate__(self) -> dict[str, object]:
        names = ("coordinates", "inputs", "elements", "name", "angles", "experiments", "standing")
        return {name: getattr(self, name) for name in names}

    def __hash__(self) -> int:
        return hash((self.coordinates, self.name, len(self.elements)))


def pushed_everywhere(model: Model) -> Model:
    """The rig with a force input at every coordinate, behind its own inputs."""
    taken = {*model.coordinates, *(given.name for given in model.inputs)}
    loads = []
    for coordinate in model.coordinates:
        name = f"load at {coordinate}"
        while name in taken:
            name += "'"
        loads.append(Input(name, "force", {coordinate: 1.0}))
    return replace(model, inputs=(*model.inputs, *loads))
