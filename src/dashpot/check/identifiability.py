"""What can be found of a rig from the channels it has, before any data, in words of physics (THEORY §5).

The rank is exact (see `structure`).  Directions that leave every channel unchanged to first order, at any rig, are
sorted by what they mean: δθ = c (only sums can be found), δθ = c θ (only ratios and products), δθ = c θ² (only sums of
reciprocals: elements in series), constants c all of them; what is left changes with the rig and is told at its nominal
values.  This is local identifiability; of exchanges that a whole rig allows only that of unseen coordinates is looked
for.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal

import numpy as np

from dashpot.arrays import Ints, Real, frozen
from dashpot.channel import Channel, Quantity
from dashpot.check.scale import require_scale
from dashpot.check.structure import (
    Draw,
    Lines,
    enough_lines,
    exact,
    floating,
    generic_lines,
    lines_of,
    nominal,
    view_of,
)
from dashpot.data.spectrum import Spectrum
from dashpot.errors import IdentifiabilityError, Problem
from dashpot.io.words import listed
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.numerics import finite_field as field
from dashpot.numerics.finite_field import PRIME

Sort = Literal["unseen", "sum", "scale", "series", "mixed", "lines"]

DRAWS = 3  # random rigs that a constant direction must hold at
ORDERS = 12  # orders of the unknowns tried for short descriptions
SHOWN = 1e-7  # part of the largest slope from which a further sensor shows a direction
CANDIDATES = 40  # further sensors tried as a cure
LARGE = 2_000_000  # coordinates² · unknowns² above which `require_identifiable` looks at the scale of the forces alone


@dataclass(frozen=True)
class Deficiency:
    """Unknowns that cannot be told apart: what is wrong, what would help, and the directions that nothing shows.

    directions (k, M): δψ at the nominal ψ, in the unknowns' units; found: combinations of `names` that can be found.
    """

    sort: Sort
    names: tuple[str, ...]
    directions: Real
    found: tuple[str, ...]
    what: str
    cure: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "directions", frozen(self.directions, np.float64))


@dataclass(frozen=True)
class Structure:
    """Whether the unknowns ψ (those of the rig, then gains and delays) can be found from the channels.

    rank: how many independent combinations can; nominal (M,): ψ at which directions are given; exchanges: pairs of
    unseen coordinates whose parameters may be swapped; leaning: names of the unknowns without whose stated sd nothing
    would fix them.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    rank: int
    nominal: Real
    deficiencies: tuple[Deficiency, ...]
    exchanges: tuple[tuple[str, str], ...] = ()
    leaning: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "nominal", frozen(self.nominal, np.float64))

    @property
    def identifiable(self) -> bool:
        """Whether every unknown can be found, in a neighbourhood."""
        return self.rank == len(self.names)

    def problems(self, where: str | None = None) -> list[Problem]:
        """One Problem for each deficiency."""
        return [Problem(one.what, where, one.cure) for one in self.deficiencies]


def structure(
    model: Model, channels: Sequence[Channel], spectrum: Spectrum | None = None, seed: int = 0
) -> Structure:
    """What the channels can tell of the unknowns; with `spectrum`, also whether its lines are enough.

    Inputs that no channel measures are unknown at every line.  Raises IdentifiabilityError where the rig has no
    steady response, DataError where a channel measures what the rig has not.
    """
    rng = np.random.default_rng(seed)
    view = view_of(model, channels)
    names = view.names
    draws = _draws(model, channels, enough_lines(model, len(channels), len(names)), rng)
    rank = field.rank(draws[0].rows)
    psi, rate = nominal(model, channels)
    leaning = _leaning(model, channels, rng) if rank == len(names) else ()
    base = Structure(names, view.units, rank, psi, (), _exchanges(model, channels), leaning)
    if rank < len(names):
        study = _Study(model, tuple(channels), names, draws, psi, rate, rng)
        found = study.deficiencies()
        return replace(base, deficiencies=tuple(found))
    if spectrum is not None:
        return _with_lines(base, model, channels, lines_of(model, spectrum), rate, rng)
    return base


def require_identifiable(
    model: Model, channels: Sequence[Channel], where: str | None = None, spectrum: Spectrum | None = None
) -> None:
    """Raises IdentifiabilityError with one problem for each thing that cannot be found.

    Of large rigs only the scale of the forces is checked.
    """
    if model.n**2 * len(model.unknowns) ** 2 > LARGE:
        require_scale(model, channels, where)
        return
    found = structure(model, channels, spectrum)
    if not found.identifiable:
        raise IdentifiabilityError(found.problems(where))


def _draws(model: Model, channels: Sequence[Channel], lines: Lines, rng: np.random.Generator) -> list[Draw]:
    """Random rigs of the highest rank found: one where that is full, else DRAWS."""
    draws, ranks = [exact(model, channels, lines, rng)], []
    ranks.append(field.rank(draws[0].rows))
    if ranks[0] == len(draws[0].psi):
        return draws
    for _ in range(DRAWS - 1):
        draws.append(exact(model, channels, lines, rng))
        ranks.append(field.rank(draws[-1].rows))
    return [draw for draw, rank in zip(draws, ranks, strict=True) if rank == max(ranks)]


def _leaning(model: Model, channels: Sequence[Channel], rng: np.random.Generator) -> tuple[str, ...]:
    """Unknowns with a prior whose loss would leave something undetermined."""
    known = [unknown.name for unknown in model.unknowns if unknown.sd is not None]
    found = []
    for name in known:
        elements = tuple(
            replace(element, value=None, sd=None) if element.name == name else element
            for element in model.elements
        )
        free = replace(model, elements=elements)
        view = view_of(free, channels)
        draw = exact(free, channels, enough_lines(free, len(channels), len(view.names)), rng)
        if field.rank(draw.rows) < len(view.names):
            found.append(name)
    return tuple(found)


@dataclass(frozen=True)
class _Study:
    """The draws of one deficient rig, from which deficiencies are made."""

    model: Model
    channels: tuple[Channel, ...]
    names: tuple[str, ...]
    draws: list[Draw]
    psi: Real
    rate: float
    rng: np.random.Generator

    def deficiencies(self) -> list[Deficiency]:
        first = self.draws[0]
        M = len(self.names)
        unseen = [j for j in range(M) if not np.any(first.rows[:, j])]
        found = []
        if unseen:
            found.append(self._unseen(unseen))
        rest = [j for j in range(M) if j not in set(unseen)]
        explained = np.zeros((0, M), dtype=np.int64)
        count = M - field.rank(first.rows) - len(unseen)
        sorts: tuple[Sort, ...] = ("sum", "scale", "series")
        for power, sort in enumerate(sorts):
            if len(explained) == count:
                break
            new = []
            for constant in self._constant(rest, power):
                direction = constant * _power(first.psi, power) % PRIME
                more = np.concatenate([explained, direction[None]])
                if field.rank(more) == len(more):
                    explained = more
                    new.append(constant)
            found += [self._described(sort, power, block) for block in _blocks(new)]
        if len(explained) < count:
            _, fixed = field.echelon(explained)
            open_ones = [j for j in rest if j not in set(fixed)]
            found += [self._described("mixed", 0, block) for block in _blocks(self._circuits(open_ones))]
        cures = self._sensors(found)
        return [
            replace(one, cure=one.cure + (f", or measure {_either(more)}" if more else ""))
            for one, more in zip(found, cures, strict=True)
        ]

    def _constant(self, columns: list[int], power: int) -> Ints:
        """Constants c with δψ = c ψ^power unseen at every draw, (k, M), in echelon form."""
        stacked = np.concatenate(
            [draw.rows[:, columns] * _power(draw.psi, power)[columns] % PRIME for draw in self.draws]
        )
        basis = field.null_space(stacked)
        whole = np.zeros((len(basis), len(self.names)), dtype=np.int64)
        whole[:, columns] = basis
        return whole

    def _circuits(self, columns: list[int]) -> list[Ints]:
        """A basis of the unseen directions among some unknowns, of small support."""
        rows = self.draws[0].rows
        pool: list[Ints] = []
        for turn in range(ORDERS):
            order = np.array(columns) if turn == 0 else self.rng.permutation(columns)
            for vector in field.null_space(rows[:, order]):
                whole = np.zeros(len(self.names), dtype=np.int64)
                whole[order] = vector
                pool.append(whole)
        pool.sort(key=lambda vector: int(np.count_nonzero(vector)))
        chosen: list[Ints] = []
        for vector in pool:
            if field.rank(np.array([*chosen, vector])) > len(chosen):
                chosen.append(vector)
        return chosen

    def _numbers(self, vector: Ints, power: int, draws: int) -> Real:
        """The constants of a direction whose unknowns are known, (M,), the largest 1."""
        support = np.flatnonzero(vector)
        lines = enough_lines(self.model, len(self.channels), len(self.names))
        scale = np.where(self.psi == 0, 1.0, self.psi)
        rows = []
        for turn in range(draws):
            shift = np.exp(self.rng.uniform(-0.4, 0.4, len(scale))) if turn else np.ones(len(scale))
            at = self.psi * shift
            slopes = floating(self.model, self.channels, lines, at, self.rate, self.rng)
            rows.append((slopes * np.where(self.psi == 0, 1.0, at * shift ** (power - 1.0)))[:, support])
        stacked = np.concatenate(rows)
        size = np.linalg.norm(stacked, axis=0)
        v = _right_vectors(stacked / size)[-1] / size
        v = v / v[np.argmax(np.abs(v))]
        whole = np.zeros(len(self.names))
        whole[support] = np.where(np.abs(v) < 1e-9, 0.0, v)
        return whole  # δψ = v ψ^power scale^(1 − power)

    def _described(self, sort: Sort, power: int, block: list[Ints]) -> Deficiency:
        own = sorted({int(j) for vector in block for j in np.flatnonzero(vector)})
        relative = np.array([self._numbers(v, power, 1 if sort == "mixed" else DRAWS) for v in block])
        scale = np.where(self.psi == 0, 1.0, self.psi)
        directions = relative * scale
        names = tuple(self.names[j] for j in own)
        count = len(block)
        give = "give one of them a value" if count == 1 else f"give {count} of them a value"
        if sort == "mixed":
            what = self._moves(names, directions[:, own], relative[:, own])
            return Deficiency(sort, names, directions, (), what, give)
        # Sums have the physical constants, ratios the relative ones, reciprocals δ(1/θ) = −c.
        constants = relative[:, own] * scale[own] ** (1.0 - power)
        found = tuple(_combination(row, names, power) for row in _complement(constants))
        if sort == "scale":
            what, cure = self._scaled(names, relative[:, own], found, give)
            return Deficiency(sort, names, directions, found, what, cure)
        if not found:
            what = f"{listed(names)} can change by any amounts"
        else:
            what = f"of {listed(names)} only {listed(found)} can be found"
        if sort == "sum" and all(self._element(name) for name in names):
            reason, cure = self._parallel(names, count)
            return Deficiency(sort, names, directions, found, f"{what}: {reason}", f"{give}{cure}")
        if sort == "series":
            joint = self._between(names)
            what += f": they are in series{joint}"
        return Deficiency(sort, names, directions, found, what, give)

    def _element(self, name: str) -> bool:
        return any(element.name == name for element in self.model.elements)

    def _parallel(self, names: tuple[str, ...], count: int) -> tuple[str, str]:
        """Why sums are all there is, and a cure beside values."""
        elements = [element for element in self.model.elements if element.name in names]
        kinds = {e.law.matrix for e in elements}
        tied = {e.same_as for e in self.model.elements if e.same_as is not None}
        first = elements[0].along
        alike = len(kinds) == 1 and not tied & set(names) and all(_parallel(first, e.along) for e in elements)
        if alike:
            together = "both" if len(elements) == 2 else "all"
            kind = elements[0].kind
            verb = "move with" if kind is Kind.MASS and len(first) == 1 else "join"
            return f"{together} {verb} {_place(first)}", ", or attach one elsewhere"
        if len(kinds) == 1:
            return "together they act as one element would", ", or attach one elsewhere"
        return "nothing that is measured tells them apart", ""

    def _scaled(
        self, names: tuple[str, ...], exponents: Real, found: tuple[str, ...], give: str
    ) -> tuple[str, str]:
        own = [name for name in names if self._element(name)]
        masses = [e.name for e in self.model.elements if e.kind is Kind.MASS and e.name in own]
        weigh = f" (weigh {masses[0]}, say)" if masses else ""
        cure = f"{give}{weigh}"
        even = len(exponents) == 1 and np.allclose(exponents[0], exponents[0, 0], rtol=1e-5)
        if even and set(names) == {unknown.name for unknown in self.model.unknowns}:
            driven = "" if self.model.force_inputs else " and only displacements go in"
            together = f"all forces scale together: only the ratios of {listed(names)} can be found"
            return f"nothing is known{driven}, so {together}", cure
        if even and not own:
            return f"only the ratios of {listed(names)} can be found", give
        if even:
            return f"the forces of {listed(names)} scale together: only their ratios can be found", cure
        if len(found) <= 6:
            return f"of {listed(names)} only {listed(found)} can be found", cure
        up = [n for n, x in zip(names, exponents[0], strict=True) if x > 0]
        down = [n for n, x in zip(names, exponents[0], strict=True) if x < 0]
        text = f"{listed(up)} may grow by any factor while {listed(down)} shrink by it (or a power of it)"
        return f"only products and ratios of {listed(names)} can be found: {text}", cure

    def _moves(self, names: tuple[str, ...], directions: Real, relative: Real) -> str:
        """A direction that depends on the rig, in per cent at the nominal values."""
        parts = []
        for direction, share in zip(directions[:2], relative[:2], strict=True):
            moved = []
            for name, absolute, part in zip(names, direction, share, strict=True):
                if part == 0:
                    continue
                late = name.endswith(".delay")
                moved.append(f"{name} {absolute:+.2g} s" if late else f"{name} {_share(100 * part)} %")
            parts.append(", ".join(moved[:8]) + (" …" if len(moved) > 8 else ""))
        more = "" if len(directions) <= 2 else f" and {len(directions) - 2} more"
        return (
            f"{listed(names)} can change together without a trace "
            f"(at about the nominal values {' or '.join(parts)}{more})"
        )

    def _between(self, names: tuple[str, ...]) -> str:
        points = [set(e.along) for e in self.model.elements if e.name in names]
        shared = set.intersection(*points) if points else set()
        return f" through {listed(sorted(shared))}" if shared else ""

    def _unseen(self, columns: list[int]) -> Deficiency:
        names = tuple(self.names[j] for j in columns)
        directions = np.eye(len(self.names))[columns] * np.where(self.psi == 0, 1.0, self.psi)
        give = "give it a value or leave it out" if len(names) == 1 else "give them values or leave them out"
        inputs = [*self.model.displacement_inputs, *self.model.force_inputs]
        quiet = [u for u in inputs if not any(u in channel.of for channel in self.channels)]
        if len(columns) == len(self.names) and quiet:
            count = len(self.channels)
            seen = "one channel" if count == 1 else f"{count} channels"
            what = f"{seen} cannot tell the rig from what drives it: {listed(quiet)} is not measured"
            return Deficiency("unseen", names, directions, (), what, f"measure {quiet[0]}, or more points")
        what = f"nothing that is measured depends on {listed(names)}"
        return Deficiency("unseen", names, directions, (), what, give)

    def _sensors(self, found: Sequence[Deficiency]) -> list[list[str]]:
        """For each deficiency, single further sensors that show all its directions; calibrations are not mended so."""
        cures: list[list[str]] = [[] for _ in found]
        scale = np.where(self.psi == 0, 1.0, self.psi)
        for label, channel in _candidates(self.model, self.channels)[:CANDIDATES]:
            more = (*self.channels, channel)
            lines = enough_lines(self.model, len(more), len(self.names))
            slopes = floating(self.model, more, lines, self.psi, self.rate, self.rng)
            size = float(np.max(np.linalg.norm(slopes * scale, axis=0)))
            for k, one in enumerate(found):
                shown = np.linalg.svd(slopes @ one.directions.T, compute_uv=False)
                if shown[-1] > SHOWN * size and any(self._element(name) for name in one.names):
                    cures[k].append(label)
        return cures


def _right_vectors(matrix: Real) -> Real:
    """All right singular vectors, (columns, columns), without the left ones of a tall matrix."""
    tall = matrix.shape[0] >= matrix.shape[1]
    vectors: Real = np.linalg.svd(matrix, full_matrices=not tall)[2]
    return vectors


def _power(psi: Ints, power: int) -> Ints:
    result = np.ones_like(psi)
    for _ in range(power):
        result = result * psi % PRIME
    return result


def _blocks(vectors: Iterable[Ints]) -> list[list[Ints]]:
    """Directions that share an unknown, together."""
    blocks: list[tuple[set[int], list[Ints]]] = []
    for vector in vectors:
        support, members = set(np.flatnonzero(vector).tolist()), [vector]
        apart = []
        for other, own in blocks:
            if other & support:
                support |= other
                members = own + members
            else:
                apart.append((other, own))
        blocks = [*apart, (support, members)]
    return [members for _, members in blocks]


def _complement(vectors: Real) -> Real:
    """Combinations that do not change along any of the vectors, in echelon form."""
    size = np.max(np.abs(vectors), axis=0)
    scaled = vectors / size
    Vh = np.linalg.svd(scaled)[2]
    rows = Vh[np.linalg.matrix_rank(scaled, 1e-6) :] / size
    for column in range(rows.shape[1]):
        done = column if column < len(rows) else len(rows)
        if done == len(rows):
            break
        chosen = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[chosen, column]) * size[column] < 1e-6:
            continue
        rows[[done, chosen]] = rows[[chosen, done]]
        rows[done] /= rows[done, column]
        others = np.arange(len(rows)) != done
        rows[others] -= rows[others, column][:, None] * rows[done]
    small = np.abs(rows * size) < 1e-6 * np.max(np.abs(rows * size), axis=1, initial=1e-300, keepdims=True)
    return np.where(small, 0.0, rows)


def _combination(row: Real, names: Sequence[str], power: int) -> str:
    """A sum, a product or a sum of reciprocals as text."""
    terms = [(_simple(float(x)), name) for x, name in zip(row, names, strict=True) if x != 0]
    if power == 1:
        over = [_to_the(name, x) for x, name in terms if x > 0]
        under = [_to_the(name, -x) for x, name in terms if x < 0]
        top = "·".join(over) if over else "1"
        below = under[0] if len(under) == 1 else f"({'·'.join(under)})"
        return f"{top}/{below}" if under else top
    text = ""
    for x, name in terms:
        size = "" if abs(abs(x) - 1) < 1e-9 else f"{abs(x):.4g}"
        body = (f"{size}·{name}" if size else name) if power == 0 else f"{size if size else '1'}/{name}"
        text += (" - " if x < 0 else " + ") + body if text else ("-" if x < 0 else "") + body
    return text


def _simple(x: float) -> float:
    near = float(Fraction(x).limit_denominator(12))
    return near if abs(near - x) < 1e-5 * abs(x) else x


def _to_the(name: str, x: float) -> str:
    return name if abs(x - 1) < 1e-9 else f"{name}^{x:.3g}"


def _parallel(first: object, second: object) -> bool:
    """Whether two elements are stretched alike, but for a factor."""
    a, b = dict(first), dict(second)  # type: ignore[call-overload]
    if a.keys() != b.keys():
        return False
    ratios = [b[point] / a[point] for point in a]
    return bool(np.allclose(ratios, ratios[0]))


def _place(along: object) -> str:
    points = dict(along)  # type: ignore[call-overload]
    ends = list(points)
    if len(points) == 1:
        return f"{ends[0]} to ground"
    if len(points) == 2 and abs(sum(points.values())) < 1e-12:
        return f"{ends[0]} to {ends[1]}"
    return "the same points"


def _share(percent: float) -> str:
    return f"{percent:+.0f}" if abs(percent) >= 99.5 else f"{percent:+.2g}"


def _either(names: Sequence[str]) -> str:
    shown = list(names[:4])
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} or {shown[-1]}"


def _candidates(model: Model, channels: Sequence[Channel]) -> list[tuple[str, Channel]]:
    """Sensors that might be added, with a name for each."""
    motion = {next(iter(c.of)) for c in channels if c.quantity is not Quantity.FORCE and len(c.of) == 1}
    force = {next(iter(c.of)) for c in channels if c.quantity is Quantity.FORCE and len(c.of) == 1}
    found = []
    for name in (*model.displacement_inputs, *model.coordinates):
        if name not in motion:
            found.append((name, Channel("…", {name: 1.0})))
    for name in model.force_inputs:
        if name not in force:
            found.append((f"the force {name}", Channel("…", {name: 1.0}, Quantity.FORCE)))
    for name in model.displacement_inputs:
        if name not in force:
            found.append((f"the force that moves {name}", Channel("…", {name: 1.0}, Quantity.FORCE)))
    return found


def _exchanges(model: Model, channels: Sequence[Channel]) -> tuple[tuple[str, str], ...]:
    """Pairs of coordinates that no channel and no force touches, with elements alike whose values are all unknown."""
    touched = {point for channel in channels for point in channel.of}
    touched |= {point for one in model.inputs for point in one.at}
    for element in model.elements:
        if element.name in touched:
            touched |= set(element.along)
    hidden = [x for x in model.coordinates if x not in touched]
    tied = {e.same_as for e in model.elements} | {e.name for e in model.elements if e.same_as is not None}
    shapes = {(e.kind, frozenset(e.along.items())) for e in model.elements}
    found = []
    for i, one in enumerate(hidden[:CANDIDATES]):
        for other in hidden[i + 1 : CANDIDATES]:
            swap = {one: other, other: one}
            moved = [e for e in model.elements if (one in e.along) != (other in e.along)]
            if not moved or any(e.value is not None or e.name in tied for e in moved):
                continue
            images = ({swap.get(point, point): x for point, x in e.along.items()} for e in moved)
            pairs = list(zip(moved, images, strict=True))
            if all(
                (e.kind, frozenset(image.items())) in shapes
                or (e.kind, frozenset((point, -x) for point, x in image.items())) in shapes
                for e, image in pairs
            ):
                found.append((one, other))
    return tuple(found)


def _with_lines(
    base: Structure,
    model: Model,
    channels: Sequence[Channel],
    lines: Lines,
    rate: float,
    rng: np.random.Generator,
) -> Structure:
    """The verdict on the lines at hand, where more lines would determine everything."""
    draw = exact(model, channels, lines, rng)
    rank = field.rank(draw.rows)
    M = len(base.names)
    if rank < M:  # once more: a random point may be unlucky
        draw = exact(model, channels, lines, rng)
        rank = max(rank, field.rank(draw.rows))
    if rank == M:
        return base
    reduced, pivots = field.echelon(draw.rows)
    free = [j for j in range(M) if j not in set(pivots)]
    involved = [j for j in range(M) if j in free or np.any(reduced[: len(pivots), free][pivots.index(j)])]
    names = tuple(base.names[j] for j in involved)
    slopes = floating(model, channels, lines, base.nominal, rate, rng)
    scale = np.where(base.nominal == 0, 1.0, base.nominal)
    directions = _right_vectors(slopes * scale)[rank:] * scale
    count, distinct = len(lines.frequency), len(np.unique(lines.frequency))
    more = _lines_missing(model, channels, lines, rng, M)
    at = "1 frequency" if distinct == 1 else f"{distinct} frequencies"
    held = f"{count} line{'' if count == 1 else 's'} at {at}"
    what = f"{held} fix only {rank} combinations of the {M} unknowns: {listed(names)} stay open"
    need = "" if more is None else f"measure at {more} more frequenc{'y' if more == 1 else 'ies'}, or "
    cure = f"{need}give {M - rank} of them a value"
    return replace(base, rank=rank, deficiencies=(Deficiency("lines", names, directions, (), what, cure),))


def _lines_missing(
    model: Model, channels: Sequence[Channel], lines: Lines, rng: np.random.Generator, M: int
) -> int | None:
    """How many more lines, with all channels and inputs, would do."""
    for more in range(1, M + 1):
        top = int(np.max(lines.frequency)) + 1
        extra = generic_lines(model, len(channels), more)
        longer = Lines(
            np.concatenate([lines.frequency, top + extra.frequency]),
            np.concatenate([lines.present, extra.present]),
            np.concatenate([lines.driven, extra.driven]),
        )
        if field.rank(exact(model, channels, longer, rng).rows) == M:
            return more
    return None
