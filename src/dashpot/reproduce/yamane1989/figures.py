"""The paper's figures again, as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real
from dashpot.reproduce.yamane1989.draws import Draws
from dashpot.reproduce.yamane1989.rig import FIGURE2_LEVELS, FIGURE3_SAMPLES, METHODS
from dashpot.study.scenario import Scenario
from dashpot.study.summary import LEVELS

FIGURE2_PARAMETERS = ("m1", "m2", "c3")
FIGURE3_PARAMETERS = ("m1", "m2")
CLAIM_SAMPLES = 1400


@dataclass(frozen=True)
class ErrorCurve:
    """Error of one parameter by one method along a figure's abscissa: mean, spread and the middle 95 % of the draws.

    All arrays (points,), errors in %; `failed`: share of draws without an estimate, %.
    """

    method: str
    parameter: str
    x: Real
    mean: Real
    spread: Real
    low: Real
    high: Real
    bound: Real
    failed: Real


@dataclass(frozen=True)
class PrintedPoint:
    """A value of the tables that belongs in a figure."""

    method: str
    parameter: str
    x: float
    error: float


@dataclass(frozen=True)
class FigureData:
    """Data of one figure, over the noise level in % or the number of samples."""

    over: str
    curves: tuple[ErrorCurve, ...]
    points: tuple[PrintedPoint, ...]


def figure_2(draws: Draws) -> FigureData:
    """Error against noise level."""
    paper = draws.paper
    scenarios = [draws.at(noise=level) for level in FIGURE2_LEVELS]
    x = 100 * np.array(FIGURE2_LEVELS)
    points = [
        PrintedPoint(
            name, parameter, 100 * level, float(paper.table2[name][row, paper.unknown.index(parameter)])
        )
        for name in ("ls", "iv")
        for row, level in enumerate(paper.levels)
        for parameter in FIGURE2_PARAMETERS
    ]
    curves = [
        _curve(draws, scenarios, x, name, parameter) for parameter in FIGURE2_PARAMETERS for name in METHODS
    ]
    return FigureData("noise", tuple(curves), tuple(points))


def figure_3(draws: Draws) -> FigureData:
    """Error against the number of samples."""
    paper = draws.paper
    scenarios = [draws.at(in_all=samples) for samples in FIGURE3_SAMPLES]
    x = np.array(FIGURE3_SAMPLES, dtype=float)
    points = [
        PrintedPoint(
            "iv",
            parameter,
            float(CLAIM_SAMPLES),
            float(paper.table4["CASE-3"][paper.unknown.index(parameter)]),
        )
        for parameter in FIGURE3_PARAMETERS
    ]
    curves = [
        _curve(draws, scenarios, x, name, parameter)
        for parameter in FIGURE3_PARAMETERS
        for name in ("iv", "oiv")
    ]
    return FigureData("samples", tuple(curves), tuple(points))


def _curve(draws: Draws, scenarios: Sequence[Scenario], x: Real, method: str, parameter: str) -> ErrorCurve:
    j = draws.paper.unknown.index(parameter)
    summaries = [draws.summary(scenario, method) for scenario in scenarios]
    return ErrorCurve(
        method,
        parameter,
        x,
        mean=np.array([summary.mean[j] for summary in summaries]),
        spread=np.array([summary.spread[j] for summary in summaries]),
        low=np.array([summary.quantiles[LEVELS.index(0.025), j] for summary in summaries]),
        high=np.array([summary.quantiles[LEVELS.index(0.975), j] for summary in summaries]),
        bound=np.array([summary.bound[j] for summary in summaries]),
        failed=np.array([100 * summary.failed / summary.draws for summary in summaries]),
    )
