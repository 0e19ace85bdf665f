"""A planned test to read and to look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from dashpot.arrays import Complex
from dashpot.design.advise import Answer
from dashpot.design.criteria import Criterion
from dashpot.design.plan import Plan
from dashpot.design.plan_curves import plan_curves
from dashpot.design.plan_files import phase_deg
from dashpot.design.precision import ExpectedPrecision
from dashpot.design.test_setup import drive_units
from dashpot.io.words import joined
from dashpot.present.figures import design as draw
from dashpot.present.text.numbers import alike, percent, rounded, short

NOTHING = "–"
_DOUBT = {"worst": "the worst of", "average": "on average over"}


def show(found: Answer, out: Console) -> None:
    """Dwells, the intervals to expect, and what they are worth."""
    out.print()
    if found.setup.model.name:
        out.print(Text(found.setup.model.name, style="bold"))
    if found.verdict is not None:
        _stopping(found, out)
    if found.choice is not None:
        _sensors(found, out)
    if found.plan is None:
        out.print(Text("No test is needed: what is known reaches the target already.", style="green"))
        return
    out.print(_dwells(found.plan, drive_units(found.setup.model)))
    out.print()
    table = _expected(found)
    if Measurement.get(out, out.options.update_width(1000), table).maximum > out.width:
        table = _expected(found, interval=False)
    out.print(table)
    out.print()
    for line in _words(found, found.plan):
        out.print(Text(line), soft_wrap=False)
    for note in found.notes:
        out.print(Text(f"Note: {note}.", style="yellow"), soft_wrap=False)


def _table() -> Table:
    return Table(box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False, show_edge=False)


def _dwells(plan: Plan, units: Mapping[str, str]) -> Table:
    table = _table()
    inputs = list(plan.dwells[0].amplitudes)
    timed = plan.time_s is not None
    table.add_column("dwell", justify="right")
    table.add_column("frequency, Hz", justify="right")
    for name in inputs:
        table.add_column(f"drive {name}, {units[name]}", justify="right")
    for title in ("settle, s", "periods", "measure, s") if timed else ():
        table.add_column(title, justify="right")
    table.add_column("samples", justify="right")
    for i, dwell in enumerate(plan.dwells):
        cells = [str(i + 1), f"{dwell.frequency_hz:.6g}"]
        for name in inputs:
            z = dwell.amplitudes[name]
            turned = abs(z.imag) > 1e-12 * abs(z)
            cells.append(f"{abs(z):.4g} ∠{np.degrees(np.angle(z)):.0f}°" if turned else f"{z.real:.4g}")
        if timed:
            cells += [short(dwell.settle_s), str(dwell.periods), short(dwell.time_s or 0.0, 4)]
        table.add_row(*cells, str(dwell.samples))
    total = [""] * (2 + len(inputs))
    total[1] = "in all"
    if timed:
        settle = sum(dwell.settle_s for dwell in plan.dwells)
        total += [short(settle), "", short((plan.time_s or 0.0) - settle, 4)]
    table.add_section()
    table.add_row(*total, str(plan.samples), style="dim")
    return table


def _expected(found: Answer, interval: bool = True) -> Table:
    assert found.plan is not None
    p = found.plan.predicted
    other = None if found.comparison is None else found.comparison
    table = _table()
    for title in ("parameter", "value", "± to expect", "± %", *(("95 % interval",) if interval else ())):
        table.add_column(title, justify="left" if title == "parameter" else "right", no_wrap=True)
    if found.estimate is not None:
        table.add_column("now\n± %", justify="right", no_wrap=True)
    if other is not None:
        table.add_column("other\n± %", justify="right", no_wrap=True)
    if other is not None and other.iv is not None:
        table.add_column("other,\niv ± %", justify="right", no_wrap=True)
    table.add_column("unit")
    now = None if found.estimate is None else _now(found)
    for j, name in enumerate(p.names):
        v, sd = float(p.values[j]), float(p.sd[j])
        value, spread = rounded(v, sd)
        ends = (" … ".join(alike([v - 1.96 * sd, v + 1.96 * sd], sd)),) if interval else ()
        cells = [name, value, spread, _percent(p, name), *ends]
        if now is not None:
            cells.append(now.get(name, NOTHING))
        if other is not None:
            cells.append(_percent(other.predicted, name))
        if other is not None and other.iv is not None:
            cells.append(_percent(other.iv, name))
        table.add_row(*cells, "" if p.units[j] == "1" else p.units[j])
    return table


def _now(found: Answer) -> dict[str, str]:
    assert found.estimate is not None
    e = found.estimate
    return {name: percent(float(sd), float(v)) for name, sd, v in zip(e.names, e.sd, e.values, strict=True)}


def _percent(p: ExpectedPrecision, name: str) -> str:
    if name not in p.names or p.values[p.names.index(name)] == 0:
        return NOTHING
    return short(100 * float(p.relative[p.names.index(name)]), 2)


def _words(found: Answer, plan: Plan) -> list[str]:
    p = plan.predicted
    over = "" if found.robust is None else f", {_DOUBT[found.robustness]} {found.setup.scenarios} scenarios"
    first = f"{plan.criterion.name[0].upper()}{plan.criterion.name[1:]}{over}: {_figure(plan.criterion, p.figure)}. "
    first += f"Optimal: no test of {_grouped(plan.samples)} samples in this band is better than "
    first += f"{_figure(plan.criterion, plan.ideal)} by more than the duality gap of {plan.gap:.1e}; "
    cost = 100 * max(plan.loss, 0.0)
    first += f"whole periods and limits cost {f'{short(cost, 2)} %' if cost >= 0.01 else 'less than 0.01 %'}."
    words = [first]
    if len(p.names) > 1:
        words.append(f"Rms of the relative standard deviations of all parameters: {short(100 * p.rms())} %.")
    if found.robust is not None:
        searched = found.robustness == "worst"
        where = "of the whole doubt, as far as a search finds it" if searched else "of these scenarios"
        words.append(f"In the worst case {where}: {_figure(plan.criterion, found.robust.worst)}.")
    if found.comparison is not None:
        c = found.comparison
        line = f"The other test ({len(c.schedule.frequency_hz)} frequencies) gives "
        line += f"{_figure(plan.criterion, c.predicted.figure)} from as many samples: it takes "
        line += f"{_times(c.factor)} the samples for the same precision"
        if c.factor_iv is not None:
            line += f", {_times(c.factor_iv)} with the paper's instrumental variables"
        words.append(line + ".")
    return words


def _times(factor: float) -> str:
    return f"{factor:.3g} times" if np.isfinite(factor) else "infinitely many times"


def _figure(criterion: Criterion, value: float) -> str:
    """A criterion's figure in words: a relative sd; of targets, in parts of them."""
    return f"{short(value)} × target" if criterion.in_targets else f"{short(100 * value)} %"


def _stopping(found: Answer, out: Console) -> None:
    v = found.verdict
    assert v is not None
    if v.reached:
        out.print(Text(f"Enough: {v.reason}.", style="green"))
        return
    more = "" if not np.isfinite(v.more) else f"; {_grouped(v.more)} more samples of the same kind would do"
    best = ""
    if found.plan is not None and np.isfinite(v.more) and found.plan.predicted.figure <= 1.0001:
        best = f", the test below adds {_grouped(found.plan.samples)}"
    out.print(Text(f"Not enough yet: {v.reason}{more}{best}."), soft_wrap=False)


def _grouped(count: float) -> str:
    """12 544, kept on one line."""
    return f"{count:,.0f}".replace(",", "\N{NO-BREAK SPACE}")


def _sensors(found: Answer, out: Console) -> None:
    assert found.choice is not None
    ranking = found.choice.ranking
    how = "all sets were tried" if found.choice.complete else "by exchange: perhaps not the very best"
    out.print(Text(f"Sensors: {joined(found.choice.best)} ({how})."), soft_wrap=False)
    for names, figure in ranking[1:4]:
        out.print(
            Text(f"  {joined(names)}: {_figure(found.criterion, figure)}", style="dim"), soft_wrap=False
        )
    out.print()


def figure(found: Answer) -> Figure:
    """Dwells on the directional derivative, information of each frequency about each parameter, intervals."""
    assert found.plan is not None
    plan, setup = found.plan, found.setup
    curves = plan_curves(setup, found.criterion, plan, found.known, found.grid.low, found.grid.high)
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
        "s" if timed else "samples", p.names, curves.gain, [p.names[j] for j in bars], _bars(found, plan, bars),
    )  # fmt: skip


def _bars(found: Answer, plan: Plan, bars: list[int]) -> list[draw.Bars]:
    """Relative standard deviations of the tests that are compared, of the parameters `bars`."""
    p = plan.predicted
    tests = [draw.Bars("this test", 100 * p.relative[bars])]
    if found.estimate is not None:
        e = found.estimate
        now = {n: float(s / abs(v)) if v else np.nan for n, s, v in zip(e.names, e.sd, e.values, strict=True)}
        tests.append(draw.Bars("known now", 100 * np.array([now.get(p.names[j], np.nan) for j in bars])))
    if found.comparison is not None:
        tests.append(
            draw.Bars("other test, as many samples", 100 * found.comparison.predicted.relative[bars])
        )
        iv = found.comparison.iv
        if iv is not None and len(iv.names) == len(p.names):
            tests.append(draw.Bars("other test by the paper's iv", 100 * iv.relative[bars]))
    return tests


def drive_names(inputs: Sequence[str], drives: Complex) -> list[str]:
    """Patterns of a drive in words: "u", "u + v", "u − v"."""
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


def sequential_figure(found: Answer, targets: Mapping[str, float]) -> Figure | None:
    """Intervals against samples as data came; None where the data did not determine the unknowns before their end."""
    so_far, verdict = found.so_far, found.verdict
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
