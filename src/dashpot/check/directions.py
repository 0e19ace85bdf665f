"""Directions of the unknowns that leave every channel unchanged, sorted by what they mean (THEORY §5).

To first order, at any rig: δθ = c (only sums can be found), δθ = c θ (only ratios and products), δθ = c θ² (only sums
of reciprocals: elements in series), constants c all of them; what is left changes with the rig and is stated at its
nominal values.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dashpot.arrays import Ints, Real, freeze
from dashpot.channel import Channel, Quantity
from dashpot.check.structure import Draw, enough_lines, floating
from dashpot.model.network import Model
from dashpot.numerics import finite_field as field
from dashpot.numerics.finite_field import PRIME

Sort = Literal["unseen", "sum", "scale", "series", "mixed", "lines"]

DRAWS = 3  # random rigs that a constant direction must hold at
ORDERS = 12  # orders of the unknowns tried for short descriptions
SHOWN = 1e-7  # part of the largest slope from which a further sensor shows a direction
CANDIDATES = 40  # further sensors tried as a cure


@dataclass(frozen=True)
class LinesAtHand:
    """Data whose lines are too few: `lines` at `frequencies` different ones.

    `missing` more with all channels and inputs would do, None where no number does.
    """

    lines: int
    frequencies: int
    missing: int | None


@dataclass(frozen=True)
class Deficiency:
    """Unknowns that cannot be told apart.

    directions    (k, M): δψ at the nominal ψ, in the unknowns' units, that nothing shows
    combinations  (c, names): coefficients of what can be found: of sums of the unknowns (sum), of their logarithms
                  (scale), of their reciprocals (series); (0, names) elsewhere
    sensors       further sensors each of which would show all the directions
    lines         where it is the lines at hand that do not suffice
    """

    sort: Sort
    names: tuple[str, ...]
    directions: Real
    combinations: Real
    sensors: tuple[Channel, ...] = ()
    lines: LinesAtHand | None = None

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class Deficient:
    """A rig whose unknowns `names` (M,) cannot all be found: random rigs `draws`, nominal `psi` (M,), rad/s `rate`."""

    model: Model
    channels: tuple[Channel, ...]
    names: tuple[str, ...]
    draws: list[Draw]
    psi: Real
    rate: float
    rng: np.random.Generator

    def deficiencies(self) -> list[Deficiency]:
        """What cannot be told apart, with the sensors that would help."""
        rows, M = self.draws[0].rows, len(self.names)
        unseen = [j for j in range(M) if not np.any(rows[:, j])]
        rest = [j for j in range(M) if j not in set(unseen)]
        described = [self._unseen(unseen)] if unseen else []
        explained = np.zeros((0, M), dtype=np.int64)
        count = M - field.rank(rows) - len(unseen)
        sorts: tuple[Sort, ...] = ("sum", "scale", "series")
        for power, sort in enumerate(sorts):
            if len(explained) == count:
                break
            explained, constants = self._explained(explained, rest, power)
            described += [self._described(sort, power, block) for block in _blocks(constants)]
        if len(explained) < count:
            _, fixed = field.echelon(explained)
            open_ones = [j for j in rest if j not in set(fixed)]
            described += [self._described("mixed", 0, block) for block in _blocks(self._circuits(open_ones))]
        sensors = self._sensors(described)
        return [
            replace(deficiency, sensors=more) for deficiency, more in zip(described, sensors, strict=True)
        ]

    def _explained(self, explained: Ints, columns: list[int], power: int) -> tuple[Ints, list[Ints]]:
        """`explained` with the directions c ψ^power that it has not yet, and their constants."""
        new = []
        for constant in self._constant(columns, power):
            direction = constant * _power(self.draws[0].psi, power) % PRIME
            more = np.concatenate([explained, direction[None]])
            if field.rank(more) == len(more):
                explained = more
                new.append(constant)
        return explained, new

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
        v = right_vectors(stacked / size)[-1] / size
        v = v / v[np.argmax(np.abs(v))]
        whole = np.zeros(len(self.names))
        whole[support] = np.where(np.abs(v) < 1e-9, 0.0, v)
        return whole  # δψ = v ψ^power scale^(1 − power)

    def _described(self, sort: Sort, power: int, block: list[Ints]) -> Deficiency:
        columns = sorted({int(j) for vector in block for j in np.flatnonzero(vector)})
        names = tuple(self.names[j] for j in columns)
        relative = np.array([self._numbers(v, power, 1 if sort == "mixed" else DRAWS) for v in block])
        scale = np.where(self.psi == 0, 1.0, self.psi)
        if sort == "mixed":
            return Deficiency(sort, names, relative * scale, np.zeros((0, len(columns))))
        # Sums have the physical constants, ratios the relative ones, reciprocals δ(1/θ) = −c.
        constants = relative[:, columns] * scale[columns] ** (1.0 - power)
        return Deficiency(sort, names, relative * scale, _complement(constants))

    def _unseen(self, columns: list[int]) -> Deficiency:
        names = tuple(self.names[j] for j in columns)
        directions = np.eye(len(self.names))[columns] * np.where(self.psi == 0, 1.0, self.psi)
        return Deficiency("unseen", names, directions, np.zeros((0, len(columns))))

    def _sensors(self, found: Sequence[Deficiency]) -> list[tuple[Channel, ...]]:
        """For each deficiency, single further sensors that show all its directions; calibrations are not mended so."""
        elements = {element.name for element in self.model.elements}
        sensors: list[list[Channel]] = [[] for _ in found]
        scale = np.where(self.psi == 0, 1.0, self.psi)
        for channel in _candidates(self.model, self.channels)[:CANDIDATES]:
            more = (*self.channels, channel)
            lines = enough_lines(self.model, len(more), len(self.names))
            slopes = floating(self.model, more, lines, self.psi, self.rate, self.rng)
            size = float(np.max(np.linalg.norm(slopes * scale, axis=0)))
            for k, deficiency in enumerate(found):
                shown = np.linalg.svd(slopes @ deficiency.directions.T, compute_uv=False)
                if shown[-1] > SHOWN * size and elements & set(deficiency.names):
                    sensors[k].append(channel)
        return [tuple(more) for more in sensors]


def right_vectors(matrix: Real) -> Real:
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
        for other, vectors_of_other in blocks:
            if other & support:
                support |= other
                members = vectors_of_other + members
            else:
                apart.append((other, vectors_of_other))
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


def _candidates(model: Model, channels: Sequence[Channel]) -> list[Channel]:
    """Sensors that might be added: motions, applied forces, reaction forces."""
    motion = {next(iter(c.of)) for c in channels if c.quantity is not Quantity.FORCE and len(c.of) == 1}
    force = {next(iter(c.of)) for c in channels if c.quantity is Quantity.FORCE and len(c.of) == 1}
    points = (*model.displacement_inputs, *model.coordinates)
    forces = (*model.force_inputs, *model.displacement_inputs)
    return [
        *(Channel("…", {name: 1.0}) for name in points if name not in motion),
        *(Channel("…", {name: 1.0}, Quantity.FORCE) for name in forces if name not in force),
    ]
