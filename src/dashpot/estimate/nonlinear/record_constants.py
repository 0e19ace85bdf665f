"""Which constants of whole records can be found: states at their starts, and constants that sensors of inputs add.

Where nothing joins the rig to the ground and no channel shows where it is, a base may be anywhere and move at any
steady velocity: only motion beside it counts.  Such constants are no unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.estimate.nonlinear.records import RecordData
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.model.nonlinear.moving_base import does_nothing

NONE = 1e-9  # of numbers around 1: what is none but for rounding


@dataclass(frozen=True)
class RecordConstants:
    """Indices of the constants that can be found, in the state of the model that moves and among its force inputs.

    starts (k,): of the state at the start of a record; offsets (o,): of forces, shared by all records; biases (b,): of
    accelerations of bases, each record's own.
    """

    starts: Ints
    offsets: Ints
    biases: Ints

    @property
    def of_record(self) -> int:
        """Unknowns of each record."""
        return len(self.starts) + len(self.biases)


def record_constants(model: Model, data: RecordData) -> RecordConstants:
    """Of the rig as it moves, bases behind its coordinates, and a record of it."""
    bases = len(data.bases.names)
    n, forces = model.n, model.S.shape[1] - bases
    no_position = _hidden(_rows_of_position(model, data), bases)
    no_velocity = _hidden(_rows_of_velocity(model, data), bases)
    states = sum(e.force_law is not None and e.force_law.has_state for e in model.elements)
    starts = np.delete(np.arange(2 * n + states), [*no_position, *(n + i for i in no_velocity)])
    shows = [_shows(model, data, column) for column in range(forces)]
    biases = [
        forces + j
        for j, order in enumerate(data.bases.orders)
        if order == 2 and (n - bases + j not in no_velocity or _shows(model, data, forces + j))
    ]
    return RecordConstants(starts, np.flatnonzero(shows), np.array(biases, dtype=np.int64))


def _rows_of_position(model: Model, data: RecordData) -> Real:
    """What a constant displacement of each coordinate stretches or shows, (rows, n)."""
    held = _linear_springs(model) + _laws_of_position(model)
    shown = [
        c
        for c, (d, drift) in enumerate(zip(data.derivative, data.drift, strict=True))
        if d == 0 and not drift
    ]
    rows: Real = np.concatenate([model.B[held], data.on_x[shown]])
    return rows


def _rows_of_velocity(model: Model, data: RecordData) -> Real:
    """What a constant velocity of each coordinate stretches or shows, (rows, n)."""
    held = [
        row
        for row, e in enumerate(model.elements)
        if e.law.power < 2 and not does_nothing(model.elements[row])
    ]
    shown = [
        c for c, (d, drift) in enumerate(zip(data.derivative, data.drift, strict=True)) if d == 0 or not drift
    ]
    shown = [c for c in shown if data.derivative[c] < 2]
    rows: Real = np.concatenate([model.B[held], data.on_x[shown]])
    return rows


def _linear_springs(model: Model) -> list[int]:
    """Springs without a law of their own that may push."""
    return [
        row
        for row, (kind, element) in enumerate(zip(model.kinds, model.elements, strict=True))
        if kind is Kind.SPRING and element.force_law is None and not does_nothing(element)
    ]


def _laws_of_position(model: Model) -> list[int]:
    """Nonlinear elements whose force depends on where they are, not only on how they move."""
    laws = [(int(row), model.elements[int(row)].force_law) for row in model.nonlinear]
    return [
        r
        for r, law in laws
        if law is not None and "d" in law.expression.names and not does_nothing(model.elements[r])
    ]


def _hidden(rows: Real, bases: int) -> list[int]:
    """Coordinates that may as well stand still, those of bases first: the others move alike without a trace."""
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    n = rows.shape[1]
    _, values, directions = np.linalg.svd(rows / np.where(size > 0, size, 1.0))
    free = directions[int(np.sum(values > NONE)) :]  # (free, n)
    hidden: list[int] = []
    for i in [*range(n - bases, n), *range(n - bases)] if len(free) else []:
        if np.linalg.matrix_rank(free[:, [*hidden, i]], NONE) > len(hidden):
            hidden.append(i)
    return hidden


def _shows(model: Model, data: RecordData, column: int) -> bool:
    """Whether a constant of a force input leaves a trace beyond that of another start.

    It does not in a rig whose laws depend on motion alone, and whose channels have no zeros.
    """
    shown = any(d == 0 and not drift for d, drift in zip(data.derivative, data.drift, strict=True))
    if shown or _laws_of_position(model):
        return True
    n = model.n - len(data.bases.names)
    B = model.B[_linear_springs(model), :n]
    push = (
        model.S[:n, column]
        if column < model.S.shape[1] - len(data.bases.names)
        else _carried(model, data, column)
    )
    rest = np.linalg.lstsq(B.T @ B, push, rcond=None)[0]
    return bool(np.max(np.abs(B.T @ B @ rest - push), initial=0.0) > NONE * np.max(np.abs(push), initial=0.0))


def _carried(model: Model, data: RecordData, column: int) -> Real:
    """Inertia forces on the rig when a base accelerates, of masses of size 1, (n,)."""
    n = model.n - len(data.bases.names)
    base = n + column - (model.S.shape[1] - len(data.bases.names))
    masses = model.B[list(model.by_matrix["M"])]
    push: Real = masses[:, :n].T @ masses[:, base]
    return push
