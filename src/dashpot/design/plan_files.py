"""A plan as JSON and as a table for the shaker's controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dashpot.design.advise import Answer
from dashpot.design.allocation import ExpectedPrecision, expected_precision
from dashpot.design.plan import Dwell, Plan
from dashpot.io.json_document import to_json


def answer_to_json(answer: Answer) -> str:
    """An answer as JSON: the plan's contract with what was asked beside it; amplitudes in SI units.

    Phases in degrees stand there where inputs move out of step.  Where the target is reached already, a plan of no
    dwell.
    """
    plan = answer.plan
    p = expected_precision(answer.setup, answer.criterion, 0.0) if plan is None else plan.predicted
    content: dict[str, Any] = {
        "dwells": [] if plan is None else [_dwell(dwell) for dwell in plan.dwells],
        "predicted": {
            name: {
                "value": value,
                "sd": sd,
                "relative_sd": relative,
                "interval95": [value - 1.96 * sd, value + 1.96 * sd],
                "unit": unit,
            }
            for name, unit, value, sd, relative in zip(
                p.names, p.units, p.values.tolist(), p.sd.tolist(), p.relative.tolist(), strict=True
            )
        },
        "criterion": answer.criterion.name,
        "figure": p.figure,
        "ideal": p.figure if plan is None else plan.ideal,
        "gap": 0.0 if plan is None else plan.gap,
        "loss": 0.0 if plan is None else plan.loss,
        "samples": 0 if plan is None else plan.samples,
        "time_s": 0 if plan is None else plan.time_s,
        "notes": list(answer.notes),
    }
    if answer.comparison is not None:
        other = answer.comparison
        content["against"] = {
            "frequencies_hz": other.schedule.frequency_hz.tolist(),
            "predicted": _spreads(other.predicted),
            "figure": other.predicted.figure,
            "iv": None if other.iv is None else _spreads(other.iv),
            "sample_factor": other.factor,
            "sample_factor_iv": other.factor_iv,
        }
    if answer.unsettled is not None:
        whole = answer.unsettled
        content["used_whole"] = {
            "predicted": _spreads(whole.predicted),
            "figure": whole.predicted.figure,
            "samples": whole.samples,
            "thrown_away": whole.thrown_away,
            "one_record": whole.joined,
        }
    if answer.choice is not None:
        ranking = answer.choice.ranking[:20]
        content["sensors"] = {
            "best": list(answer.choice.best),
            "complete": answer.choice.complete,
            "ranking": [{"sensors": list(names), "figure": figure} for names, figure in ranking],
        }
    if answer.worst is not None:
        content["worst_case"] = answer.worst
    if answer.so_far is not None:
        s = answer.so_far
        content["so_far"] = {
            "samples": s.samples.tolist(),
            "relative_sd": dict(zip(s.names, s.relative.T.tolist(), strict=True)),
        }
    if answer.verdict is not None:
        v = answer.verdict
        content["enough"] = {
            "reached": v.reached,
            "worst": v.worst,
            "over_target": v.excess,
            "more_samples": v.more,
            "reason": v.reason,
        }
    return to_json(content)


def _spreads(p: ExpectedPrecision) -> dict[str, Any]:
    return {name: {"sd": sd} for name, sd in zip(p.names, p.sd.tolist(), strict=True)}


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
    return entry | ({"phases_deg": phases} if any(phases.values()) else {})


def _amplitude(z: complex) -> float:
    """Signed where the drive is in or against phase, else its size."""
    return z.real if abs(z.imag) <= 1e-12 * abs(z) else abs(z)


def phase_deg(z: complex) -> float:
    """Phase of an amplitude in degrees, 0 where it is in or against phase."""
    return 0.0 if abs(z.imag) <= 1e-12 * abs(z) else float(np.rad2deg(np.angle(z)))


def plan_to_csv(plan: Plan, units: Mapping[str, str]) -> str:
    """A table for the shaker's controller: one dwell a row, in the order in which to run them.

    `units` of the inputs by name stand in the header: u_amplitude_m.
    """
    turned = any(phase_deg(z) for dwell in plan.dwells for z in dwell.amplitudes.values())
    head = ["dwell", "frequency_hz"]
    for name in plan.dwells[0].amplitudes:
        head += [
            f"{name}_amplitude_{units[name].replace('·', '')}",
            *([f"{name}_phase_deg"] if turned else []),
        ]
    rows = [",".join([*head, "settle_s", "periods", "time_s", "samples"])]
    for i, dwell in enumerate(plan.dwells):
        cells = [str(i + 1), f"{dwell.frequency_hz:.9g}"]
        for z in dwell.amplitudes.values():
            cells += [f"{_amplitude(z):.9g}", *([f"{phase_deg(z):.6g}"] if turned else [])]
        timed = ["" if number is None else f"{number:.9g}" for number in (dwell.periods, dwell.time_s)]
        rows.append(",".join([*cells, f"{dwell.settle_s:.6g}", *timed, str(dwell.samples)]))
    return "\n".join(rows) + "\n"
