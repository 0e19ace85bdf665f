"""Starts far from the end of a whole record: the motion is held near the measured one, less and less.

Of a motion that is integrated freely the misfit has many valleys where the rig is strongly nonlinear.  Springs and
dampers between what a channel shows of the rig and what it measured keep the motion near; with them the misfit has one
wide valley, whose bottom moves to that of the free motion as they are weakened.  Source: Vyasarayani, Uchida, Carvalho
and McPhee (2012), Multibody System Dynamics 26, 411.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.estimate.nonlinear.record_problem import RecordProblem
from dashpot.estimate.nonlinear.records import RecordData
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Input, Model
from dashpot.numerics.levenberg_marquardt import OptimizeResult

HOLDS = (3.0, 1.0, 0.3, 0.1, 0.03)  # natural frequency of a channel on its spring over that of its motion
DAMPING = 0.7  # of that spring
NEAR = 4.0  # misfit of the free motion over that of the held one at which it need be held no more
FOLLOWED = 30.0  # the same of pieces, which are short enough for the search to go on from there
CUTS = 5  # halvings of a record, at most
SHORTEST = 32  # samples of a piece


def released(
    problem: RecordProblem, psi: Real, descend: Callable[[RecordProblem, Real], OptimizeResult]
) -> tuple[RecordProblem, Real]:
    """(problem, ψ) from which the free motion's misfit leads to its least; `descend` finds the least of a held problem.

    Records whose free motion is lost between one end and the other are cut into pieces with starts of their own.  As
    given where no channel shows a displacement with a known gain.
    """
    shown = _shown(problem.records[0])
    if not len(shown):
        return problem, psi
    records = tuple(_with_measured_motion(problem.model, data, shown) for data in problem.records)
    least = np.inf
    for hold in HOLDS:
        held = replace(
            problem, model=_held(problem, psi, shown, hold), records=records, last=problem.motions()
        )
        if not np.isfinite(held.misfit(psi)):
            held.last = {}
        end = descend(held, psi)
        if not (end.converged[0] and end.cost[0] < NEAR * least):  # too weak to hold this motion
            break
        psi, least, problem.last = end.x[0], float(end.cost[0]), held.motions()
        if problem.misfit(psi) < NEAR * least:
            return problem, psi
    states = [problem.last[k].state for k in range(len(problem.records)) if k in problem.last]
    problem.last = {}  # the free motion may be far from the last one that was held
    for _ in range(CUTS if states else 0):
        if min(data.samples for data in problem.records) < 2 * SHORTEST:
            break
        problem, psi, states = _halved(problem, psi, states)
        if problem.misfit(psi) < FOLLOWED * least:
            break
    return problem, psi


def _halved(problem: RecordProblem, psi: Real, states: list[Real]) -> tuple[RecordProblem, Real, list[Real]]:
    """The same with each record cut in two, and likewise the states (samples, states) of their motions."""
    free = problem.constants
    records, parts, own = [], [], [psi[: problem.inner]]
    for k, (data, state) in enumerate(zip(problem.records, states, strict=True)):
        middle = data.samples // 2
        for part in (slice(0, middle), slice(middle, data.samples)):
            records.append(replace(data, inputs=data.inputs[part], outputs=data.outputs[part]))
            parts.append(state[part])
            own += [state[part][0, free.starts], psi[problem.of_record(k)][len(free.starts) :]]
    begun = tuple(part[0] for part in parts)
    substeps = tuple(count for count in problem.substeps for _ in range(2))
    return (
        replace(problem, records=tuple(records), begun=begun, substeps=substeps, pieces=2 * problem.pieces),
        np.concatenate(own),
        parts,
    )


def _shown(data: RecordData) -> list[int]:
    """Outputs that are displacements with known gains, and move."""
    moves = np.ptp(data.outputs, axis=0) > 0
    return [c for c in range(len(data.names)) if data.derivative[c] == 0 and data.gain[c] < 0 and moves[c]]


def _with_measured_motion(model: Model, data: RecordData, shown: list[int]) -> RecordData:
    """The record with what channels show of the coordinates as further displacement inputs."""
    r = model.D.shape[1]
    motion = data.outputs[:, shown] - data.inputs @ data.on_q[shown].T
    inputs = np.concatenate([data.inputs[:, :r], motion, data.inputs[:, r:]], axis=1)
    on_q = np.insert(data.on_q, r, np.zeros((len(shown), 1)), axis=1)
    rated = (*data.rated[:r], *[False] * len(shown), *data.rated[r:]) if data.rated else ()
    return replace(data, inputs=inputs, on_q=on_q, rated=rated)


def _held(problem: RecordProblem, psi: Real, shown: list[int], hold: float) -> Model:
    """The rig with a spring and a damper from each of the channels to its own measurement."""
    model, data = problem.model, problem.records[0]
    inverse = np.linalg.inv(matrices(model, model.parameters(psi[: len(model.unknowns)])).M)
    inputs, elements = [], []
    for c in shown:
        seen = data.on_x[c]
        mass = 1 / float(seen @ inverse @ seen)
        signal = data.outputs[:, c] - np.mean(data.outputs[:, c])
        rate = np.sqrt(np.sum(np.diff(signal) ** 2) / np.sum(signal**2)) / data.step_s
        omega = hold * float(rate)
        name = f"{data.names[c]} as measured"
        along = dict(zip(model.coordinates, seen.tolist(), strict=True)) | {name: -1.0}
        along = {point: factor for point, factor in along.items() if factor}
        inputs.append(Input(name))
        elements.append(Element(f"{name}, spring", Kind.SPRING, along, value=mass * omega**2))
        elements.append(Element(f"{name}, damper", Kind.DAMPER, along, value=2 * DAMPING * mass * omega))
    forces = [source for source in model.inputs if source.kind == "force"]
    moved = [source for source in model.inputs if source.kind != "force"]
    return replace(model, inputs=(*moved, *inputs, *forces), elements=(*model.elements, *elements))
