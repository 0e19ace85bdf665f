"""The network of elements: incidence, ties, and the map from unknowns to parameters (THEORY §1).

p = T θ + p⁰        δ = B x + D u        Bᵀ (p ∘ a) = S f
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import sparse

from dashpot.arrays import Complex, Ints, Real, frozen
from dashpot.errors import ModelError, UsageError
from dashpot.io.words import counted, shown
from dashpot.model.elements import MATRICES, Element, Kind
from dashpot.model.incidence import row_products
from dashpot.model.inputs import Input as Input
from dashpot.model.nonlinear.force_law import Constant, unit_of
from dashpot.model.recent import Recent
from dashpot.model.unknowns import Tie, Unknown
from dashpot.model.validation import problems

DENSE = 1_000_000  # numbers up to which products of incidences are kept as full matrices


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
        for name in ("coordinates", "inputs", "elements"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "angles", frozenset(self.angles))
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

    # Laws

    @cached_property
    def kinds(self) -> tuple[Kind, ...]:
        """Kind of each element."""
        return tuple(element.kind for element in self.elements)

    @cached_property
    def _by_kind(self) -> Mapping[Kind, Ints]:
        return {
            kind: frozen(
                [i for i, e in enumerate(self.elements) if e.kind is kind and e.force_law is None], np.int64
            )
            for kind in dict.fromkeys(self.kinds)
        }

    @cached_property
    def nonlinear(self) -> Ints:
        """Indices of the elements with a nonlinear law, (e,)."""
        return frozen([i for i, e in enumerate(self.elements) if e.force_law is not None], np.int64)

    @cached_property
    def constants(self) -> tuple[tuple[Element, Constant], ...]:
        """Inner constants of the nonlinear laws, (G,), each with its element."""
        return tuple((e, c) for e in self.elements if e.force_law is not None for c in e.force_law.constants)

    @cached_property
    def constant_slices(self) -> tuple[slice, ...]:
        """For each nonlinear element, where its constants stand among all of them."""
        counts = [len(e.force_law.constants) for e in self.elements if e.force_law is not None]
        ends = np.cumsum([0, *counts])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    def factors(self, omega: Real) -> Complex:
        """φ_i(ω) for `omega` of shape (lines,) in rad/s; shape (lines, elements); 0 for nonlinear elements."""
        phi = np.zeros((*omega.shape, len(self.elements)), dtype=np.complex128)
        for kind, chosen in self._by_kind.items():
            phi[..., chosen] = kind.law.factor(omega)[..., None]
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
        """θ, (unknowns,), from values by name, else the model's values or guesses.  Raises ModelError where none is."""
        theta = np.empty(len(self.unknowns))
        for j, unknown in enumerate(self.unknowns):
            choices = (values.get(unknown.name), unknown.prior, unknown.guess)
            value = next((choice for choice in choices if choice is not None), None)
            if value is None:
                cure = f"give it one, such as {unknown.name}=1.0, or a guess"
                raise ModelError(f"{unknown.name} has no value", cure=cure)
            theta[j] = value
        others = sorted(set(values) - set(self.unknown_names))
        if others:
            cure = f"its unknowns are {', '.join(self.unknown_names)}"
            raise ModelError(f"{', '.join(others)} is not an unknown of this rig", cure=cure)
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
        """Least and largest values allowed to the unknowns, (unknowns,) each, SI units; ∓inf where none is."""
        low = [-np.inf if u.lower is None else u.lower for u in self.unknowns]
        high = [np.inf if u.upper is None else u.upper for u in self.unknowns]
        return frozen(low, np.float64), frozen(high, np.float64)

    def unit(self, element: Element) -> str:
        """SI unit of an element's parameter."""
        return element.unit(self.angles)

    # Groups of elements that the dynamics need

    @cached_property
    def by_matrix(self) -> Mapping[str, Ints]:
        """Indices of the elements that enter M, C, K and the hysteretic H, (elements,) each."""
        return {
            letter: frozen(
                [i for i, e in enumerate(self.elements) if e.law.matrix == letter and e.force_law is None],
                np.int64,
            )
            for letter in MATRICES
        }

    @cached_property
    def letters(self) -> Ints:
        """Index in MATRICES of the matrix that each element enters, −1 for nonlinear elements; (elements,)."""
        index = {letter: k for k, letter in enumerate(MATRICES)}
        return frozen([-1 if e.force_law else index[e.law.matrix] for e in self.elements], np.int64)

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
        """What has been made of this model for channels and frequencies."""
        return Recent()

    def __getstate__(self) -> dict[str, object]:
        names = ("coordinates", "inputs", "elements", "name", "angles")
        return {name: getattr(self, name) for name in names}

    def __hash__(self) -> int:
        return hash((self.coordinates, self.name, len(self.elements)))
