"""Sentences about a planned test: what it gives, how close to optimal it is, whether there are data enough."""

from __future__ import annotations

import math

from dashpot.design.advise import Answer
from dashpot.design.allocation import Criterion
from dashpot.design.plan import Plan
from dashpot.design.transients import UnsettledTest
from dashpot.io.words import joined
from dashpot.present.text.numbers import short

NEGLIGIBLE = 0.01  # per cent that rounding may cost for a test to be called optimal
WASTE = 0.05  # of the information: what waiting for the steady state may cost
_SCENARIOS = {"worst": "worst of", "average": "average over"}


def plan_in_words(answer: Answer, plan: Plan) -> list[str]:
    """What the test gives by its criterion, how close to optimal it is, and how it compares."""
    predicted = plan.predicted
    name = plan.criterion.name
    names = plan.criterion.names
    of = f" of {joined(names)}" if names else ""
    if len(names) == 1:
        name = "relative standard deviation"  # a mean of one
    over = ""
    if answer.robust is not None:
        over = f", {_SCENARIOS[answer.setup.over]} {len(answer.setup.theta)} scenarios"
    figure = figure_in_words(plan.criterion, plan.predicted.figure)
    lines = [f"{name[0].upper()}{name[1:]}{of}{over}: {figure}.", _optimality(plan)]
    if len(predicted.names) > 1:
        rms = short(100 * predicted.rms())
        known = [unknown.name for unknown in answer.setup.model.unknowns if unknown.sd is not None]
        including = f", {joined(known)} included, whose sd is stated" if known else ""
        lines.append(
            f"Rms of the relative standard deviations of all {len(predicted.names)} parameters{including}: {rms} %."
        )
    if answer.robust is not None:
        where = "found by search" if answer.setup.over == "worst" else "of these scenarios"
        lines.append(f"Worst case ({where}): {figure_in_words(plan.criterion, answer.robust.worst)}.")
    if answer.comparison is not None:
        other = answer.comparison
        line = (
            f"The other test ({len(other.schedule.frequency_hz)} frequencies) gives "
            f"{figure_in_words(plan.criterion, other.predicted.figure)} from as many samples: it needs "
            f"{_times(other.factor)} the samples for the same precision"
        )
        if other.factor_iv is not None:
            line += f", {_times(other.factor_iv)} with the paper's instrumental variables"
        lines.append(f"{line}.")
    if answer.unsettled is not None:
        lines.append(_used_whole(plan, answer.unsettled))
    return lines


def _used_whole(plan: Plan, whole: UnsettledTest) -> str:
    """What the same test gives if nothing is left out, and so what it costs to wait."""
    gives = figure_in_words(plan.criterion, whole.predicted.figure)
    if not any(dwell.settle_s for dwell in plan.dwells):
        return (
            f"No dwell waits for the steady state: with the transients in it the test gives {gives}, and the motion "
            "would have to be settled for the figures above."
        )
    if whole.thrown_away > WASTE:
        return (
            f"Waiting for the steady state is a waste: recorded from the first sample on and used whole, transients "
            f"included, the same test gives {gives}; the settled parts alone throw away "
            f"{100 * whole.thrown_away:.0f} % of the information."
        )
    if whole.thrown_away < -WASTE:
        return f"Waiting pays: used whole, with noise in proportion to the transients, the same test gives {gives}."
    return f"Waiting costs little: used whole, transients included, the same test gives {gives}."


def _optimality(plan: Plan) -> str:
    cost = 100 * max(plan.loss, 0.0)
    gap = f"duality gap {plan.gap:.1e}"
    if cost < NEGLIGIBLE:
        best = "better by more than 0.01 %"
        return f"Optimal: no test of {plan.samples:,.0f} samples in this band is {best} ({gap})."
    return (
        f"The best test of as many samples in this band gives {figure_in_words(plan.criterion, plan.ideal)} ({gap}); "
        f"whole periods and limits cost {short(cost, 2)} %."
    )


def figure_in_words(criterion: Criterion, value: float) -> str:
    """A criterion's figure: a relative standard deviation; of targets, in multiples of them."""
    return f"{short(value)} × target" if criterion.targets is not None else f"{short(100 * value)} %"


def _times(factor: float) -> str:
    return f"{factor:.3g} times" if math.isfinite(factor) else "infinitely many times"


def stopping_in_words(answer: Answer) -> str:
    """Whether the data there are reach the target, and what would."""
    verdict = answer.verdict
    assert verdict is not None
    if verdict.reached:
        return f"Enough: {verdict.reason}."
    if not math.isfinite(verdict.more):
        return f"Not enough yet: {verdict.reason}."
    best = ""
    if answer.plan is not None and answer.plan.predicted.figure <= 1.0001:
        best = f", or the test below with {answer.plan.samples:,.0f}"
    return (
        f"Not enough yet: {verdict.reason}; {verdict.more:,.0f} more samples of the same kind would do{best}."
    )


def sensors_in_words(answer: Answer) -> list[str]:
    """The sensors chosen, then the next best sets."""
    choice = answer.choice
    assert choice is not None
    how = "all sets were tried" if choice.complete else "by exchange; perhaps not the very best set"
    lines = [f"Sensors: {joined(choice.best)} ({how})."]
    lines += [
        f"  {joined(names)}: {figure_in_words(answer.criterion, figure)}"
        for names, figure in choice.ranking[1:4]
    ]
    return lines
