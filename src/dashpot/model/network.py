"""The network of elements: incidence, ties, and the map from unknowns to parameters (THEORY §1).

p = T θ + p⁰        δ = B x + D u        Bᵀ (p ∘ a) = S f
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy import sparse

from dashpot.arrays import Complex, Ints, Real, frozen
from dashpot.errors import ModelError, Problem, UsageError
from dashpot.model.elements import MATRICES, Element, Kind

InputKind = Literal["displacement", "force"]
DENSE = 1_000_000  # numbers up to which products of incidences are kept as full matrices


@dataclass(frozen=True)
class Input:
    """A prescribed displacement, or a force that acts `at` coordinates (coordinate → factor)."""

    name: str
    kind: InputKind = "displacement"
    at: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", MappingProxyType(dict(self.at)))

    def __reduce__(self) -> tuple[object, ...]:
        return (Input, (self.name, self.kind, dict(self.at)))

    def __hash__(self) -> int:
        return hash((self.name, self.kind, frozenset(self.at.items())))


@dataclass(frozen=True)
class Unknown:
    """One unknown of θ.  `prior` and `sd` are given where the value is known with a standard deviation."""

    name: str
    unit: str
    prior: float | None = None
    sd: float | None = None
    guess: float | None = None
    lower: float | None = None
    upper: float | None = None


@dataclass(frozen=True)
class Tie:
    """Where an element's parameter comes from: `times` the parameter of the element at index `root`."""

    root: int
    times: float


def parameter_unit(element: Element, angles: Collection[str]) -> str:
    """SI unit of an element's parameter: that of a torsional element where it joins nothing but angles."""
    angular = bool(element.along) and all(point in angles for point in element.along)
    return element.law.unit(angular)


@dataclass(frozen=True)
class Model:
    """A rig: coordinates, inputs and elements.  Immutable; knows nothing of data.

    `angles` names the coordinates and displacement inputs that are angles (rad); elements that join only angles have
    parameters in kg·m², N·m·s/rad and N·m/rad.

    Raises ModelError with every problem found, each placed at the name of what is wrong.
    """

    coordinates: tuple[str, ...]
    inputs: tuple[Input, ...]
    elements: tuple[Element, ...]
    name: str = ""
    angles: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        object.__setattr__(self, "coordinates", tuple(self.coordinates))
        object.__setattr__(self, "inputs", tuple(self.inputs))
        object.__setattr__(self, "elements", tuple(self.elements))
        object.__setattr__(self, "angles", frozenset(self.angles))
        found = list(problems(self.coordinates, self.inputs, self.elements, self.angles))
        if found:
            raise ModelError(found)

    # Names and counts

    @property
    def displacement_inputs(self) -> tuple[str, ...]:
        """Names of the r displacement inputs, in order."""
        return tuple(one.name for one in self.inputs if one.kind == "displacement")

    @property
    def force_inputs(self) -> tuple[str, ...]:
        """Names of the s force inputs, in order."""
        return tuple(one.name for one in self.inputs if one.kind == "force")

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
    def B(self) -> Real:
        """Incidence over the coordinates, (elements, n).  THEORY (E)."""
        return frozen(self.sparse_B.toarray(), np.float64)

    @cached_property
    def sparse_D(self) -> sparse.csr_array:
        """Incidence over the displacement inputs, sparse, (elements, r)."""
        return self._incidence(self.displacement_inputs)

    @cached_property
    def D(self) -> Real:
        """Incidence over the displacement inputs, (elements, r).  THEORY (E)."""
        return frozen(self.sparse_D.toarray(), np.float64)

    @cached_property
    def S(self) -> Real:
        """Where the force inputs act, (n, s).  THEORY (E)."""
        S = np.zeros((self.n, len(self.force_inputs)))
        for column, one in enumerate(one for one in self.inputs if one.kind == "force"):
            for coordinate, factor in one.at.items():
                S[self.coordinates.index(coordinate), column] = factor
        return frozen(S, np.float64)

    # Laws

    @cached_property
    def kinds(self) -> tuple[Kind, ...]:
        """Kind of each element."""
        return tuple(element.kind for element in self.elements)

    @cached_property
    def _by_kind(self) -> Mapping[Kind, Ints]:
        return {
            kind: frozen([i for i, own in enumerate(self.kinds) if own is kind], np.int64)
            for kind in dict.fromkeys(self.kinds)
        }

    def factors(self, omega: Real) -> Complex:
        """φ_i(ω) for `omega` of shape (lines,) in rad/s; shape (lines, elements)."""
        phi = np.empty((*omega.shape, len(self.elements)), dtype=np.complex128)
        for kind, chosen in self._by_kind.items():
            phi[..., chosen] = kind.law.factor(omega)[..., None]
        return phi

    def pole_factors(self, poles: Complex) -> Complex:
        """φ_i(λ) at complex rates λ, 1/s, of shape (...); shape (..., elements)."""
        phi = np.empty((*poles.shape, len(self.elements)), dtype=np.complex128)
        for kind, chosen in self._by_kind.items():
            phi[..., chosen] = kind.law.pole_factor(poles)[..., None]
        return phi

    # Unknowns

    @cached_property
    def ties(self) -> tuple[Tie, ...]:
        """For each element, the element whose value it takes and the factor."""
        index = {element.name: i for i, element in enumerate(self.elements)}
        ties = []
        for i in range(len(self.elements)):
            root, times = i, 1.0
            while (target := self.elements[root].same_as) is not None:
                times *= self.elements[root].times
                root = index[target]
            ties.append(Tie(root, times))
        return tuple(ties)

    @cached_property
    def _unknown_roots(self) -> tuple[int, ...]:
        return tuple(
            i
            for i, element in enumerate(self.elements)
            if element.same_as is None and (element.value is None or element.sd is not None)
        )

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The unknowns of θ, in the order of the elements; those with a prior are known with an sd."""
        chosen = (self.elements[i] for i in self._unknown_roots)
        return tuple(Unknown(e.name, self.unit(e), e.value, e.sd, e.guess, e.lower, e.upper) for e in chosen)

    @cached_property
    def T(self) -> Real:
        """∂p/∂θ, (elements, unknowns).  THEORY §1."""
        T = np.zeros((len(self.elements), len(self._unknown_roots)))
        column = {root: j for j, root in enumerate(self._unknown_roots)}
        for i, tie in enumerate(self.ties):
            if tie.root in column:
                T[i, column[tie.root]] = tie.times
        return frozen(T, np.float64)

    @cached_property
    def p0(self) -> Real:
        """p⁰, the known part of the parameters, (elements,); zero where unknown."""
        p0 = np.zeros(len(self.elements))
        for i, tie in enumerate(self.ties):
            value = self.elements[tie.root].value
            if value is not None and tie.root not in self._unknown_roots:
                p0[i] = tie.times * value
        return frozen(p0, np.float64)

    def parameters(self, theta: Real) -> Real:
        """p = T θ + p⁰ for θ of shape (..., unknowns); shape (..., elements)."""
        return theta @ self.T.T + self.p0

    def theta(self, values: Mapping[str, float]) -> Real:
        """θ, (unknowns,), from values by name; what is not named takes its value or its guess from the model."""
        theta = np.empty(len(self.unknowns))
        for j, unknown in enumerate(self.unknowns):
            choices = (values.get(unknown.name), unknown.prior, unknown.guess)
            found = next((value for value in choices if value is not None), None)
            if found is None:
                raise ModelError(
                    f"{unknown.name} has no value",
                    cure=f"give it one, such as {unknown.name}=1.0, or a guess",
                )
            theta[j] = found
        strangers = set(values) - {unknown.name for unknown in self.unknowns}
        if strangers:
            raise ModelError(
                f"{', '.join(sorted(strangers))} is no unknown of this rig",
                cure=f"its unknowns are {', '.join(unknown.name for unknown in self.unknowns)}",
            )
        return theta

    @cached_property
    def prior_precision(self) -> Real:
        """1/sd² of the unknowns that are known with an sd, else 0; (unknowns,)."""
        return frozen([0.0 if u.sd is None else u.sd**-2.0 for u in self.unknowns], np.float64)

    @cached_property
    def prior_mean(self) -> Real:
        """Values of the unknowns that are known with an sd, else 0; (unknowns,)."""
        return frozen(
            [0.0 if u.sd is None or u.prior is None else u.prior for u in self.unknowns], np.float64
        )

    def require_unknowns(self, where: str | None = None) -> None:
        """Raises UsageError, placed at the file `where`, if there is nothing to find."""
        if not self.unknowns:
            raise UsageError(
                "every parameter of the rig is known", where, "leave out the value of what is to be found"
            )

    @cached_property
    def bounds(self) -> tuple[Real, Real]:
        """Least and largest values allowed to the unknowns, each (unknowns,); −inf and inf where there is no bound."""
        low = [-np.inf if u.lower is None else u.lower for u in self.unknowns]
        high = [np.inf if u.upper is None else u.upper for u in self.unknowns]
        return frozen(low, np.float64), frozen(high, np.float64)

    def unit(self, element: Element) -> str:
        """SI unit of an element's parameter."""
        return parameter_unit(element, self.angles)

    # Groups of elements that the dynamics need

    @cached_property
    def by_matrix(self) -> Mapping[str, Ints]:
        """Indices of the elements that enter M, C, K and the hysteretic H."""
        return {
            letter: frozen([i for i, e in enumerate(self.elements) if e.law.matrix == letter], np.int64)
            for letter in MATRICES
        }

    @cached_property
    def products(self) -> Mapping[str, Real | sparse.csr_array]:
        """b_iᵀ [b_i | d_i] of the elements of M, C, K and H, flattened: (elements of it, n (n + r)).

        Sparse where the rig is large: an element joins few points.
        """
        span = sparse.csr_array(sparse.hstack([self.sparse_B, self.sparse_D]))
        flat = {letter: _row_products(self.sparse_B[i], span[i]) for letter, i in self.by_matrix.items()}
        small = len(self.elements) * self.n * span.shape[1] <= DENSE
        return {
            letter: frozen(part.toarray(), np.float64) if small else part for letter, part in flat.items()
        }

    @cached_property
    def assembly(self) -> tuple[Ints, Ints, sparse.csr_array]:
        """(indices, indptr, A) of the sparse dynamic stiffness by columns: its entries are A (p φ)."""
        flat = _row_products(self.sparse_B, self.sparse_B).tocoo()
        # A cell is row · n + column; as the matrix is symmetric, its rows serve as columns.
        cells, place = np.unique(flat.col, return_inverse=True)
        A = sparse.csr_array((flat.data, (place, flat.row)), shape=(len(cells), len(self.elements)))
        counts = np.bincount(cells // self.n, minlength=self.n)
        indptr = np.concatenate([[0], np.cumsum(counts)])
        return frozen(cells % self.n, np.int64), frozen(indptr, np.int64), A

    def __getstate__(self) -> dict[str, object]:
        names = ("coordinates", "inputs", "elements", "name", "angles")
        return {name: getattr(self, name) for name in names}

    def __hash__(self) -> int:
        return hash((self.coordinates, self.name, len(self.elements)))


def _row_products(left: sparse.csr_array, right: sparse.csr_array) -> sparse.csr_array:
    """Row i: the outer product of row i of both, flattened; (rows, columns of left · columns of right)."""
    rows, columns, values = [], [], []
    width = right.shape[1]
    for i in range(left.shape[0]):
        a, b = slice(*left.indptr[i : i + 2]), slice(*right.indptr[i : i + 2])
        cells = left.indices[a].astype(np.int64)[:, None] * width + right.indices[b]
        columns.append(cells.ravel())
        values.append(np.outer(left.data[a], right.data[b]).ravel())
        rows.append(np.full(cells.size, i))
    shape = (left.shape[0], left.shape[1] * width)
    if not rows:
        return sparse.csr_array(shape)
    return sparse.csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape
    )


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
    points = dict.fromkeys((*coordinates, *(one.name for one in inputs if one.kind == "displacement")))
    attached = {point for element in elements for point in element.along}
    for one in inputs:
        yield from _input_problems(one, coordinates, complete)
        if complete and one.kind == "displacement" and one.name not in attached:
            yield Problem(
                f"no element is attached to the input {one.name}", one.name, "attach one or remove the input"
            )
    for stranger in sorted(set(angles) - set(points)) if complete else ():
        yield Problem(
            f"{stranger} is neither a coordinate nor a displacement input",
            "angles",
            f"there are {listed(points)}",
        )
    for element in elements:
        yield from _element_problems(element, points, complete)
    yield from _tie_problems(elements, frozenset(angles), complete)
    for coordinate in dict.fromkeys(coordinates) if complete else ():
        if coordinate not in attached:
            yield Problem(
                f"nothing is attached to the coordinate {coordinate}",
                coordinate,
                "attach an element or remove it",
            )


def listed(names: Iterable[str], most: int = 12) -> str:
    """Names for a message: the first `most`, separated by commas."""
    names = list(names)
    return ", ".join(names[:most]) + (f" … ({len(names)} in all)" if len(names) > most else "")


def _name_problems(
    coordinates: Sequence[str], inputs: Sequence[Input], elements: Sequence[Element]
) -> Iterator[Problem]:
    names = [*coordinates, *(one.name for one in inputs), *(one.name for one in elements)]
    for name, count in Counter(names).items():
        if name == "ground":
            yield Problem("the name ground is taken: it is the inertial ground", name, "choose another name")
        elif not name.isprintable() or name != name.strip() or not name:
            yield Problem(
                f"{name!r} is no usable name",
                name,
                "use a name without line breaks, tabs or spaces at its ends",
            )
        elif count > 1:
            yield Problem(
                f"the name {name} is used {count} times",
                name,
                "every coordinate, input and element needs its own",
            )


def _input_problems(one: Input, coordinates: Sequence[str], complete: bool) -> Iterator[Problem]:
    if one.kind not in ("displacement", "force"):
        yield Problem(f"{one.kind!r} is no kind of input", one.name, 'use "displacement" or "force"')
        return
    if one.kind == "displacement":
        if one.at:
            yield Problem(
                "a displacement input takes no `at`",
                one.name,
                "elements attach to it by its name in `between`",
            )
        return
    if not one.at:
        yield Problem("a force input must say where it acts", one.name, 'add at = "x1"')
    for coordinate, factor in one.at.items():
        if complete and coordinate not in coordinates:
            cure = f"a force acts at coordinates: {listed(coordinates)}"
            yield Problem(f"the force acts at {coordinate}, which is no coordinate", one.name, cure)
        elif not np.isfinite(factor) or factor == 0:
            yield Problem(
                f"the factor of {coordinate} is {factor:g}", one.name, "give a finite factor other than 0"
            )


def _element_problems(element: Element, points: Collection[str], complete: bool) -> Iterator[Problem]:
    name, value, sd, lower, upper = element.name, element.value, element.sd, element.lower, element.upper
    if not element.along:
        yield Problem("both ends are on the ground", name, "attach it to a coordinate")
    for point, factor in element.along.items():
        if complete and point not in points:
            cure = f"there are {listed(points)}"
            yield Problem(f"{point} is neither a coordinate nor a displacement input", name, cure)
        elif not np.isfinite(factor) or factor == 0:
            yield Problem(f"the factor of {point} is {factor:g}", name, "give a finite factor other than 0")
    numbers = _numbers(element)
    for key, number in numbers.items():
        if not np.isfinite(number):
            yield Problem(f"{key} is {number:g}", name, "give a finite number")
    if value is not None and value < 0:
        unit = element.law.unit()
        yield Problem(f"a {element.kind} of {value:g} {unit} is negative", name, "give a value of 0 or more")
    # Below 1e-150 the weight 1/sd² leaves the range of numbers.
    if sd is not None and sd < 1e-150:
        yield Problem(f"sd is {sd:g}", name, "give a positive sd, or leave it out where the value is exact")
    if sd is not None and value is None:
        yield Problem("sd without a value", name, "give the value that the sd belongs to")
    if element.guess is not None and value is not None:
        yield Problem("both a value and a guess", name, "a known parameter needs no guess: remove one")
    if lower is not None and upper is not None and lower >= upper:
        yield Problem(f"min {lower:g} is not below max {upper:g}", name, "exchange or change them")
        return
    for key in ("value", "guess"):
        start = numbers.get(key)
        if start is not None and lower is not None and start < lower:
            yield Problem(f"the {key} {start:g} is below min {lower:g}", name, f"change the {key} or min")
        if start is not None and upper is not None and start > upper:
            yield Problem(f"the {key} {start:g} is above max {upper:g}", name, f"change the {key} or max")


def _numbers(element: Element) -> dict[str, float]:
    """The numbers that an element states, under the names that a rig file gives them."""
    numbers = {
        "value": element.value, "sd": element.sd, "guess": element.guess, "min": element.lower, "max": element.upper,
        "times": element.times,
    }  # fmt: skip
    return {key: number for key, number in numbers.items() if number is not None}


def _tie_problems(elements: Sequence[Element], angles: frozenset[str], complete: bool) -> Iterator[Problem]:
    by_name = {element.name: element for element in elements}
    for element in elements:
        if element.same_as is None:
            if element.times != 1.0:
                yield Problem(
                    "`times` without `same_as`", element.name, "say which element it is a multiple of"
                )
            continue
        if element.times == 0:
            yield Problem("times is 0", element.name, "remove the element instead")
        if _numbers(element).keys() - {"times"}:
            cure = "keep same_as or the numbers, not both"
            yield Problem("a tied parameter has a value, guess or limit of its own", element.name, cure)
        seen = [element.name]
        target: str | None = element.same_as
        while target is not None and target in by_name and target not in seen:
            seen.append(target)
            target = by_name[target].same_as
        if target is not None and target not in by_name:
            if complete and len(seen) == 1:
                cure = f"there are {listed(by_name)}"
                yield Problem(f"same_as names {target}, which is no element", element.name, cure)
        elif target is not None:
            if target == element.name:
                circle = " → ".join([*seen, target])
                yield Problem(f"a tie in a circle: {circle}", element.name, "let one of them stand alone")
        else:
            root = by_name[seen[-1]]
            own, other = parameter_unit(element, angles), parameter_unit(root, angles)
            if own != other:
                yield Problem(
                    f"a {element.kind} ({own}) cannot be tied to the {root.kind} {root.name} ({other})",
                    element.name,
                    "tie parameters of one unit",
                )
