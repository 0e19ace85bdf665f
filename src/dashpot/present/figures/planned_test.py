"""Pictures of a planned test and of data as they came in: from answers to arrays to figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from dashpot.arrays import Complex
from dashpot.design.advise import Answer
from dashpot.design.plan import Plan
from dashpot.design.plan_curves import plan_curves
from dashpot.design.plan_files import phase_deg
from dashpot.present.figures import design as draw
from dashpot.present.text.numbers import short


def planned_test_figure(answer: Answer) -> Figure:
    """Dwells on the directional derivative, information of each frequency about each parameter, intervals."""
    assert answer.plan is not None
    plan, setup = answer.plan, answer.setup
    curves = plan_curves(setup, answer.criterion, plan, answer.known, answer.grid.low, answer.grid.high)
    names = drive_names([*setup.model.displacement_inputs, *setup.model.force_inputs], setup.drives)
    labelled = [(names[k], curve) for k, curve in zip(curves.patterns, curves.derivative, strict=True)]
    timed = plan.time_s is not None
    amounts = np.array([d.time_s if timed else d.samples for d in plan.dwells], dtype=float)
    title = f"The next test: {len(plan.dwells)} dwell{'s'[: len(plan.dwells) - 1]}, {plan.samples} samples"
    title += "" if plan.time_s is None else f", {short(plan.time_s, 3)} s"
    p = plan.predicted
    bars = [j for j in range(len(p.names)) if p.values[j] != 0]  # a delay of 0 has no relative error
    return draw.plan_figure(
        title, curves.frequency_hz, labelled, np.array([d.frequency_hz for d in plan.dwells]), amounts,
        "s" if timed else "samples", p.names, curves.gain, [p.names[j] for j in bars], _bars(answer, plan, bars),
    )  # fmt: skip


def _bars(answer: Answer, plan: Plan, bars: list[int]) -> list[draw.Bars]:
    """Relative standard deviations of the tests that are compared, of the parameters `bars`."""
    p = plan.predicted
    tests = [draw.Bars("this test", 100 * p.relative[bars])]
    if answer.estimate is not None:
        e = answer.estimate
        now = {n: float(s / abs(v)) if v else np.nan for n, s, v in zip(e.names, e.sd, e.values, strict=True)}
        tests.append(draw.Bars("known now", 100 * np.array([now.get(p.names[j], np.nan) for j in bars])))
    if answer.comparison is not None:
        tests.append(
            draw.Bars("other test, as many samples", 100 * answer.comparison.predicted.relative[bars])
        )
        iv = answer.comparison.iv
        if iv is not None and len(iv.names) == len(p.names):
            tests.append(draw.Bars("other test by the paper's iv", 100 * iv.relative[bars]))
    return tests


def drive_names(inputs: Sequence[str], drives: Complex) -> list[str]:
    """Patterns of a drive in words: "u", "u + v", "u − v".  drives (patterns, inputs)."""
    words = []
    for row in drives:
        text = ""
        for name, z in zip(inputs, row, strict=True):
            if z == 0:
                continue
            sign = "−" if abs(z.imag) < 1e-12 and z.real < 0 else "+"
            turn = "" if abs(z.imag) < 1e-12 else f"∠{phase_deg(complex(z)):.0f}°"
            text += f"{f' {sign} ' if text else ('−' if sign == '−' else '')}{name}{turn}"
        words.append(text)
    return words


def sequential_figure(answer: Answer, targets: Mapping[str, float]) -> Figure | None:
    """Intervals against samples as data came; None where the data did not determine the unknowns before their end."""
    so_far, verdict = answer.so_far, answer.verdict
    if so_far is None:
        return None
    times = 4.0
    if verdict is not None and np.isfinite(verdict.more):
        times = max(1.3 * verdict.more / float(so_far.samples[-1]) + 1.3, 1.5)
    ahead, relative = so_far.extrapolated(times)
    aims = np.array([100 * targets.get(name, np.nan) for name in so_far.names])
    return draw.progress_figure(
        so_far.names, so_far.samples.astype(float), 100 * so_far.relative, ahead, 100 * relative, aims
    )
