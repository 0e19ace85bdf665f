"""A plan as JSON and as a table for the shaker's controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dashpot.design.advise import Answer
from dashpot.design.allocation import Allocation
from dashpot.design.criteria import ExpectedPrecision, expected_precision
from dashpot.design.plan import Plan
from dashpot.design.schedule import Dwell, Schedule
from dashpot.io.json_document import to_json


def answer_to_json(answer: Answer) -> str:
    """An answer as JSON: the plan's contract with what was asked beside it."""
    extra: dict[str, Any] = {"notes": list(answer.notes)}
    if answer.comparison is not None:
        other = answer.comparison
        extra["against"] = {
            "frequencies_hz": other.schedule.frequency_hz.tolist(),
            "predicted": _spreads(other.predicted),
            "figure": other.predicted.figure,
            "iv": None if other.iv is None else _spreads(other.iv),
            "sample_factor": other.factor,
            "sample_factor_iv": other.factor_iv,
        }
    if answer.unsettled is not None:
        whole = answer.unsettled
        extra["used_whole"] = {
            "predicted": _spreads(whole.predicted),
            "figure": whole.predicted.figure,
            "samples": whole.samples,
            "thrown_away": whole.thrown_away,
            "one_record": whole.joined,
        }
    if answer.choice is not None:
        ranking = answer.choice.ranking[:20]
        extra["sensors"] = {
            "best": list(answer.choice.best),
            "complete": answer.choice.complete,
            "ranking": [{"sensors": list(names), "figure": figure} for names, figure in ranking],
        }
    if answer.robust is not None:
        extra["worst_case"] = answer.robust.worst
    if answer.so_far is not None:
        s = answer.so_far
        extra["so_far"] = {
            "samples": s.samples.tolist(),
            "relative_sd": {name: s.relative[:, j].tolist() for j, name in enumerate(s.names)},
        }
    if answer.verdict is not None:
        v = answer.verdict
        extra["enough"] = {
            "reached": v.reached, "worst": v.worst, "over_target": v.excess, "more_samples": v.more, "reason": v.reason,
        }  # fmt: skip
    plan = _nothing_to_do(answer) if answer.plan is None else answer.plan
    return plan_to_json(plan, extra)


def _spreads(p: ExpectedPrecision) -> dict[str, Any]:
    return {name: {"sd": float(sd)} for name, sd in zip(p.names, p.sd, strict=True)}


def _nothing_to_do(answer: Answer) -> Plan:
    """A plan without dwells: the target is reached already."""
    none, index = np.zeros(0), np.zeros(0, dtype=np.int64)
    predicted = expected_precision(answer.setup, answer.criterion, answer.known)
    allocation = Allocation(none, index, none, 0.0, 0.0, (none, index, none))
    return Plan(
        answer.criterion, (), Schedule(none, index, none), predicted, predicted.figure, 0.0, 0.0, allocation
    )


def plan_to_json(plan: Plan, extra: Mapping[str, Any] | None = None) -> str:
    """A plan as JSON; amplitudes in SI units, with phases in degrees where inputs move out of step."""
    predicted = {}
    p = plan.predicted
    for j, name in enumerate(p.names):
        sd, v = float(p.sd[j]), float(p.values[j])
        predicted[name] = {
            "value": v,
            "sd": sd,
            "relative_sd": float(p.relative[j]),
            "interval95": [v - 1.96 * sd, v + 1.96 * sd],
            "unit": p.units[j],
        }
    content: dict[str, Any] = {
        "dwells": [_dwell(dwell) for dwell in plan.dwells],
        "predicted": predicted,
        "criterion": plan.criterion.name,
        "figure": p.figure,
        "ideal": plan.ideal,
        "gap": plan.gap,
        "loss": plan.loss,
        "samples": plan.samples,
        "time_s": plan.time_s,
        "notes": list(plan.notes),
    }
    content |= {} if extra is None else dict(extra)
    return to_json(content)


def _dwell(dwell: Dwell) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "frequency_hz": dwell.frequency_hz,
        "samples": dwell.samples,
        "amplitudes": {name: _amplitude(z) for name, z in dwell.amplitudes.items()},
        "time_s": dwell.time_s,
        "settle_s": dwell.settle_s,
        "periods": dwell.periods,
    }
    phases = {name: phase_deg(z) for name, z in dwell.amplitudes.items()}
    if any(phases.values()):
        entry["phases_deg"] = phases
    return entry


def _amplitude(z: complex) -> float:
    """Signed where the drive is in or against phase, else its size."""
    return z.real if abs(z.imag) <= 1e-12 * abs(z) else abs(z)


def phase_deg(z: complex) -> float:
    """Phase of an amplitude in degrees, 0 where it is in or against phase."""
    return 0.0 if abs(z.imag) <= 1e-12 * abs(z) else float(np.rad2deg(np.angle(z)))


def plan_to_csv(plan: Plan, units: Mapping[str, str] | None = None) -> str:
    """A table for the shaker's controller: one dwell a row, in the order in which to run them.

    `units` of the inputs by name stand in the header: u_amplitude_m.
    """
    inputs = list(plan.dwells[0].amplitudes) if plan.dwells else []
    turned = any(phase_deg(z) for dwell in plan.dwells for z in dwell.amplitudes.values())
    head = ["dwell", "frequency_hz"]
    for name in inputs:
        unit = "" if units is None else f"_{units[name].replace('·', '')}"
        head += [f"{name}_amplitude{unit}"] + ([f"{name}_phase_deg"] if turned else [])
    rows = [",".join([*head, "settle_s", "periods", "time_s", "samples"])]
    for i, dwell in enumerate(plan.dwells):
        cells = [str(i + 1), f"{dwell.frequency_hz:.9g}"]
        for name in inputs:
            z = dwell.amplitudes[name]
            cells.append(f"{_amplitude(z):.9g}")
            if turned:
                cells.append(f"{phase_deg(z):.6g}")
        cells += [f"{dwell.settle_s:.6g}", _cell(dwell.periods), _cell(dwell.time_s), str(dwell.samples)]
        rows.append(",".join(cells))
    return "\n".join(rows) + "\n"


def _cell(number: float | None) -> str:
    return "" if number is None else f"{number:.9g}"
