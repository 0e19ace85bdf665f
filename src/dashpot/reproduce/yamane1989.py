"""The paper's rig, and its tables and figures as studies."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Real, frozen
from dashpot.channel import Quantity
from dashpot.errors import UsageError
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.modes import eigenmodes, eigenpairs
from dashpot.model.network import Input, Model
from dashpot.study.blocks import Map
from dashpot.study.montecarlo import LEVELS, Results, Summary, run_scenarios
from dashpot.study.scenario import Scenario, ScenarioGrid, Study, TrueRig, scenarios
from dashpot.study.simulate import standard_channels

# What the paper prints: its rig, its tables, and the corrections without which they cannot be read.


@dataclass(frozen=True)
class Printed:
    """What the paper prints; errors in %, in the order of `unknown`."""

    source: str
    unknown: tuple[str, ...]
    values: Mapping[str, float]
    known: Mapping[str, float]
    eigenvalues: Complex
    cases: Mapping[str, tuple[float, ...]]
    samples: int
    levels: tuple[float, ...]
    table2: Mapping[str, Real]
    table2_eigenvalues: Mapping[str, Complex]
    ls_expected: Mapping[str, Real]
    table3: Mapping[str, float]
    table4: Mapping[str, Real]
    table4_eigenvalues: Mapping[str, Complex]
    bound: Mapping[str, Real]
    corrections: tuple[Mapping[str, str], ...]


@cache
def facts() -> Mapping[str, Any]:
    """The file of facts that comes with this module, as it is."""
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    return MappingProxyType(tomllib.loads(text))


@cache
def paper_prints() -> Printed:
    """The figures of the paper, from the file that comes with this module."""
    raw = facts()

    def numbers(table: Mapping[str, Any]) -> Mapping[str, Real]:
        return MappingProxyType({key: frozen(row, np.float64) for key, row in table.items()})

    def pairs(rows: Sequence[Any]) -> Complex:
        array = np.array(rows, dtype=float)
        return frozen(array[..., 0] + 1j * array[..., 1], np.complex128)

    table2 = raw["table2"]
    return Printed(
        source=raw["source"],
        unknown=tuple(raw["unknown"]),
        values=MappingProxyType(raw["rig"]["values"]),
        known=MappingProxyType(raw["rig"]["known"]),
        eigenvalues=pairs(raw["rig"]["eigenvalues"]),
        cases=MappingProxyType({name: tuple(map(float, row)) for name, row in raw["cases"].items()}),
        samples=raw["measurement"]["samples"],
        levels=tuple(level / 100 for level in table2["levels"]),
        table2=numbers({name: table2[name] for name in ("ls", "iv")}),
        table2_eigenvalues=MappingProxyType(
            {name: pairs(table2[f"{name}_eigenvalues"]) for name in ("ls", "iv")}
        ),
        ls_expected=numbers(table2["ls_expected"]),
        table3=MappingProxyType(dict(zip(raw["table3"]["unknown"], raw["table3"]["iv"], strict=True))),
        table4=numbers(raw["table4"]),
        table4_eigenvalues=MappingProxyType(
            {name: pairs(rows) for name, rows in raw["table4_eigenvalues"].items()}
        ),
        bound=numbers(raw["bound"]),
        corrections=tuple(MappingProxyType(row) for row in raw["corrections"]),
    )


SEED = 1989
DRAWS = 1000
METHODS = ("ls", "iv", "oiv")
FOUR = "four"
FIGURE2_LEVELS = (0.01, 0.025, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35)
FIGURE3_SAMPLES = (50, 75, 100, 150, 200, 300, 400, 600, 800, 1000, 1200, 1400, 1600)


def paper_model() -> Model:
    """The rig of Table 1; k1 and k2 are known, the six others unknown."""
    raw = facts()
    topology, known = raw["topology"], raw["rig"]["known"]
    elements: list[Element] = [mass(name, at) for name, at in topology["masses"].items()]
    for section, kind in (("springs", Kind.SPRING), ("dampers", Kind.DAMPER)):
        for name, (first, second) in topology[section].items():
            elements.append(between(name, kind, first, second, value=known.get(name)))
    order = [*raw["unknown"], *known]
    elements.sort(key=lambda element: order.index(element.name))
    return Model(("x1", "x2"), (Input("u"),), tuple(elements), "Yamane's two masses")


def true_rig() -> TrueRig:
    """The rig with its true values and channels: x1, x2, their velocities, and u without noise."""
    rig = paper_model()
    motions = (Quantity.DISPLACEMENT, Quantity.VELOCITY)
    return TrueRig(rig, paper_prints().values, standard_channels(rig, motions))


def tables_study(draws: int = DRAWS, seed: int = SEED) -> Study:
    """Tables 2 to 4, and their cases under noise of constant size."""
    paper = paper_prints()
    base = _grid(draws)
    every = replace(base, frequencies=tuple(paper.cases))
    grids = (
        replace(base, noise=paper.levels),
        replace(base, unknowns=(FOUR,), methods=("iv", "oiv")),
        every,
        replace(every, kind="constant", reference="CASE-3"),
    )
    return _study("Yamane 1989, Tables 2-4", grids, seed)


def figures_study(draws: int = DRAWS, seed: int = SEED) -> Study:
    """Figures 2 and 3."""
    base = _grid(draws)
    grids = (
        replace(base, noise=FIGURE2_LEVELS),
        replace(base, samples=FIGURE3_SAMPLES, in_all=True, methods=("iv", "oiv")),
    )
    return _study("Yamane 1989, Figures 2-3", grids, seed)


def _grid(draws: int) -> ScenarioGrid:
    """What the paper does where it does not say otherwise."""
    return ScenarioGrid(("paper",), ("CASE-3",), (0.1,), (paper_prints().samples,), METHODS, draws)


def _study(name: str, grids: tuple[ScenarioGrid, ...], seed: int) -> Study:
    """The paper does not say at which instants it sampled.

    Without offset or drift all even spreads over whole half periods have the same distribution, whatever the phase of
    the input (sin ωt in eq. 2, cos ωt here), so half a period is taken: it makes sense of two samples too.
    """
    paper = paper_prints()
    return Study(
        name,
        seed,
        {"paper": true_rig()},
        paper.cases,
        grids,
        unknowns={FOUR: tuple(paper.table3)},
        periods=0.5,
    )


# The noise draws of all scenarios, found by what they vary, and the paper's tables next to them.


# The paper's tables and figures again, by Monte Carlo, next to what it printed, and what that shows beyond the paper.
#
# K. Yamane, "Identification of Multi-Degree-of-Freedom Dynamical Systems Based on the Response in Receiving Forced
# Displacement Inputs (the Case Using Harmonic Excitation Data)", 1989.  Its tables are one noise draw each; here each
# has many draws, so it can be said where the paper's one falls among them.  All errors are in % of the true value.


class Draws:
    """Repeats and summaries of the scenarios of the paper's studies, by scenario and method."""

    def __init__(self, results: Results) -> None:
        self.results = results
        self.paper = paper_prints()
        self.repeats = {scenario.name: results.repeats(scenario) for scenario in results.scenarios}
        self.summaries = {scenario.name: results.summaries(scenario) for scenario in results.scenarios}

    def at(self, **wanted: str | float | int) -> Scenario:
        """The scenario with these factors; CASE-3, relative noise of 10 %, all unknown, 56 a frequency if not said.

        Raises KeyError if there is none.
        """
        samples = {} if "in_all" in wanted else {"samples": self.paper.samples}
        usual = {"frequencies": "CASE-3", "kind": "relative", "noise": 0.1, "unknowns": "all"}
        factors = usual | samples | wanted
        for scenario in self.results.scenarios:
            if all(scenario.factors.get(key) == value for key, value in factors.items()):
                return scenario
        raise KeyError(str(factors))

    def summary(self, scenario: Scenario, method: str) -> Summary:
        """Summary of one method."""
        return self.summaries[scenario.name][method]

    def errors(self, scenario: Scenario, method: str) -> Real:
        """Relative errors in %, (good draws, unknowns)."""
        return self.repeats[scenario.name][method].errors(scenario.theta)

    def rms_spread(self, scenario: Scenario, method: str) -> float:
        """Root mean square over the parameters of the spread of a method's errors, %."""
        return rms_spread(self.errors(scenario, method))[0]


def rms_spread(errors: Real) -> tuple[float, float]:
    """Root mean square over the parameters of the spread of errors (draws, parameters), and its standard error."""
    squares = np.mean((errors - np.mean(errors, axis=0)) ** 2, axis=-1)
    count = len(squares)
    rms = float(np.sqrt(np.sum(squares) / (count - 1)))
    return rms, float(np.std(squares) / (2 * rms * np.sqrt(count)))


def farther(errors: Real, given: Real) -> float:
    """Share of the draws (draws, parameters) farther from their mean than `given`, by Mahalanobis' distance."""
    away = errors - np.mean(errors, axis=0)
    L = np.linalg.cholesky(np.cov(away.T))
    distance = np.sum(np.linalg.solve(L, away.T) ** 2, axis=0)
    distance_of_given = float(np.sum(np.linalg.solve(L, given - np.mean(errors, axis=0)) ** 2))
    return float((1 + np.sum(distance >= distance_of_given)) / (1 + len(distance)))


@dataclass(frozen=True)
class TableEntry:
    """One parameter in one column of a table; `printed` is None where the paper has nothing.

    z           (printed − mean) / spread
    percentile  share of the draws below the printed value, %
    """

    parameter: str
    printed: float | None
    mean: float
    mean_se: float
    spread: float
    spread_se: float
    low: float
    high: float
    bound: float
    coverage: float
    z: float | None
    percentile: float | None


@dataclass(frozen=True)
class PrintedColumn:
    """One method in one column of a table.

    rms          root mean square spread over the parameters, %, and its standard error
    bound        the same of the Cramér-Rao bound
    printed_rms  root mean square of the printed errors;   luck  share of draws whose rms error is smaller, %
    joint_p      probability of a draw as far from the mean as the printed one, all parameters together
    """

    table: str
    title: str
    method: str
    draws: int
    failed: int
    entries: tuple[TableEntry, ...]
    rms: float
    rms_se: float
    rms_error: float
    bound: float
    printed_rms: float | None
    luck: float | None
    joint_p: float | None


@dataclass(frozen=True)
class EigenvalueEntry:
    """One eigenvalue (1/s) of the identified rigs: printed, mean over the draws, sd of real and imaginary part."""

    table: str
    title: str
    method: str
    printed: complex
    mean: complex
    sd: complex


@dataclass(frozen=True)
class Rank:
    """A case under one kind of noise: rms spreads (of ls the rms error, bias included), %; places, 1 is the best."""

    kind: str
    case: str
    samples: int
    iv: float
    iv_se: float
    oiv: float
    oiv_se: float
    ls: float
    bound: float
    place_iv: int
    place_oiv: int


def eigenvalues(rig: Model, theta: Real) -> Complex:
    """Eigenvalues with Im > 0 of many rigs, in order of |λ|, (draws, n); theta (draws, unknowns).

    Rigs with overdamped modes have fewer: what is missing is NaN.
    """
    values, _ = eigenpairs(rig, rig.parameters(theta))
    upper = values.imag > 1e-9 * np.abs(values)
    order = np.argsort(np.where(upper, np.abs(values), np.inf), axis=-1, kind="stable")[:, : rig.n]
    return np.where(
        np.take_along_axis(upper, order, axis=-1), np.take_along_axis(values, order, axis=-1), np.nan
    )


def table_1() -> tuple[EigenvalueEntry, ...]:
    """Eigenvalues of the rig as modelled here, next to the printed ones."""
    paper, rig = paper_prints(), paper_model()
    modelled = eigenmodes(rig, rig.parameters(rig.theta(dict(paper.values)))).eigenvalues
    return tuple(
        EigenvalueEntry("Table 1", "model", "–", complex(value), complex(ours), 0j)
        for value, ours in zip(paper.eigenvalues, modelled, strict=True)
    )


def table_2(draws: Draws) -> tuple[PrintedColumn, ...]:
    """Noise levels: every method at every level."""
    levels, printed = draws.paper.levels, draws.paper.table2
    return tuple(
        table_column(draws, "Table 2", f"{100 * level:g} %", draws.at(noise=level), name, given)
        for row, level in enumerate(levels)
        for name, given in ((name, printed[name][row] if name in printed else None) for name in METHODS)
    )


def table_3(draws: Draws) -> tuple[PrintedColumn, ...]:
    """Six unknowns and four."""
    six, four = draws.at(), draws.at(unknowns=FOUR)
    values = np.array(list(draws.paper.table3.values()))
    return (
        table_column(draws, "Table 3", "6 unknown", six, "iv", draws.paper.table4["CASE-3"]),
        table_column(draws, "Table 3", "4 unknown", four, "iv", values),
        table_column(draws, "Table 3", "6 unknown", six, "oiv", None),
        table_column(draws, "Table 3", "4 unknown", four, "oiv", None),
    )


def table_4(draws: Draws) -> tuple[PrintedColumn, ...]:
    """Input frequencies: every method in every case."""
    paper = draws.paper
    given = {name: paper.table4 if name == "iv" else dict.fromkeys(paper.cases) for name in METHODS}
    return tuple(
        table_column(draws, "Table 4", case, draws.at(frequencies=case), name, given[name][case])
        for case in paper.cases
        for name in METHODS
    )


def table_column(
    draws: Draws, table: str, title: str, scenario: Scenario, method: str, given: Real | None
) -> PrintedColumn:
    """One column; `given` (unknowns,) are the printed errors, %, None where the paper has none."""
    summary, errors = draws.summary(scenario, method), draws.errors(scenario, method)
    rms, rms_se = rms_spread(errors)
    size = np.sqrt(np.mean(errors**2, axis=-1))
    printed_rms = None if given is None else float(np.sqrt(np.mean(given**2)))
    found = []
    for j, unknown in enumerate(scenario.model.unknowns):
        printed = None if given is None else float(given[j])
        mean, spread = float(summary.mean[j]), float(summary.spread[j])
        found.append(
            TableEntry(
                parameter=unknown.name,
                printed=printed,
                mean=mean,
                mean_se=float(summary.mean_se[j]),
                spread=spread,
                spread_se=float(summary.spread_se[j]),
                low=float(summary.quantiles[0, j]),
                high=float(summary.quantiles[-1, j]),
                bound=float(summary.bound[j]),
                coverage=float(summary.coverage[j]),
                z=None if printed is None else (printed - mean) / spread,
                percentile=None if printed is None else 100 * float(np.mean(errors[:, j] < printed)),
            )
        )
    entries = tuple(found)
    counts = (summary.draws, summary.failed)
    return PrintedColumn(
        *(table, title, method, *counts, entries, rms, rms_se),
        rms_error=float(np.sqrt(np.mean(size**2))),
        bound=summary.rms_bound,
        printed_rms=printed_rms,
        luck=None if printed_rms is None else 100 * float(np.mean(size < printed_rms)),
        joint_p=None if given is None else farther(errors, given),
    )


def identified_eigenvalues(draws: Draws) -> tuple[EigenvalueEntry, ...]:
    """Eigenvalues of the identified rigs, as Tables 2 and 4 print them."""
    paper = draws.paper
    places = [
        ("Table 2", f"{100 * level:g} %", draws.at(noise=level), name, given)
        for name in ("ls", "iv")
        for level, given in zip(paper.levels, paper.table2_eigenvalues[name], strict=False)
    ]
    places += [
        ("Table 4", case, draws.at(frequencies=case), "iv", given)
        for case, given in paper.table4_eigenvalues.items()
    ]
    entries = []
    for table, title, scenario, method, given in places:
        repeats = draws.repeats[scenario.name][method]
        values = eigenvalues(scenario.model, repeats.values[repeats.good])
        for value, column in zip(given, values.T, strict=True):
            sd = complex(float(np.std(column.real)), float(np.std(column.imag)))
            mean = complex(np.mean(column))
            entries.append(EigenvalueEntry(table, title, method, complex(value), mean, sd))
    return tuple(entries)


def ranking(draws: Draws) -> tuple[Rank, ...]:
    """The four cases under both kinds of noise."""
    ranks = []
    for kind in ("relative", "constant"):
        scenarios = {case: draws.at(frequencies=case, kind=kind) for case in draws.paper.cases}
        spreads = {
            name: {case: rms_spread(draws.errors(scenario, name)) for case, scenario in scenarios.items()}
            for name in ("iv", "oiv")
        }
        for case, scenario in scenarios.items():
            iv, oiv = (
                1 + sum(other[0] < each[case][0] for other in each.values()) for each in spreads.values()
            )
            samples = int(np.sum(scenario.test.samples))
            ls = float(np.sqrt(np.mean(draws.errors(scenario, "ls") ** 2)))
            bound = draws.summary(scenario, "oiv").rms_bound
            both = (*spreads["iv"][case], *spreads["oiv"][case])
            ranks.append(Rank(kind, case, samples, *both, ls, bound, place_iv=iv, place_oiv=oiv))
    return tuple(ranks)


# The paper's figures again, as data.


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
    columns = {parameter: paper.unknown.index(parameter) for parameter in FIGURE2_PARAMETERS}
    points = [
        PrintedPoint(name, parameter, 100 * level, float(paper.table2[name][row, column]))
        for name in ("ls", "iv")
        for row, level in enumerate(paper.levels)
        for parameter, column in columns.items()
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
    printed = dict(zip(paper.unknown, paper.table4["CASE-3"].tolist(), strict=True))
    points = [
        PrintedPoint("iv", parameter, float(CLAIM_SAMPLES), printed[parameter])
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


# What the repeats show beyond the paper, in numbers; `present` puts them into words.  Errors and shares in %.


@dataclass(frozen=True)
class PrintedAmongDraws:
    """Of `total` printed errors, `inside` lie in the middle 95 % of the draws; joint probabilities by column."""

    inside: int
    total: int
    least_p: float
    largest_p: float


@dataclass(frozen=True)
class WorstBias:
    """The parameter that least squares puts off most at a noise level: mean and spread of its error."""

    level: float
    parameter: str
    mean: float
    spread: float


@dataclass(frozen=True)
class LeastSquaresBias:
    """Bias at 10 and 20 %; its growth from 5 to 10 %; least and largest coverage of the 95 % intervals at 10 %."""

    worst: tuple[WorstBias, ...]
    growth: float
    coverage: tuple[float, float]


@dataclass(frozen=True)
class Efficiency:
    """Rms spreads at CASE-3, 10 %, and the bound; oiv over the bound in the four cases, least and largest."""

    iv: float
    oiv: float
    bound: float
    oiv_ratios: tuple[float, float]


@dataclass(frozen=True)
class OneDraw:
    """How nearly the columns of Table 2, divided by their levels, are one: disagreement, least correlation, spread."""

    disagreement: float
    correlation: float
    spread: float


@dataclass(frozen=True)
class Luck:
    """The paper's draw at CASE-3: its rms error at 10 % and the share of draws as good, the rms spread of iv;
    its largest error at 20 % and the share of draws that stay within it, by method."""

    rms: float
    as_good: float
    spread: float
    largest: float
    within: Mapping[str, float]


@dataclass(frozen=True)
class IntervalCoverage:
    """Least and largest coverage of 95 % intervals over cases and parameters, by method, with its standard error."""

    draws: int
    standard_error: float
    by_method: Mapping[str, tuple[float, float]]

    @property
    def holds(self) -> bool:
        """Whether no figure is farther from 95 % than chance explains.

        48 figures: the largest of so many standard normal ones stays below 4 but for 3 in 1,000 times.
        """
        away = max(abs(end - 95) for ends in self.by_method.values() for end in ends)
        return away < 4 * self.standard_error


@dataclass(frozen=True)
class FewerUnknowns:
    """Spread of iv and the bound, with six unknowns and with four, by parameter of Table 3.

    `worse_printed`: those whose printed error was larger with four; `worse`: those whose spread is.
    """

    spread: Mapping[str, tuple[float, float]]
    bound: Mapping[str, tuple[float, float]]
    worse_printed: tuple[str, ...]

    @property
    def worse(self) -> tuple[str, ...]:
        """Parameters that iv finds less well although more is known."""
        return tuple(name for name, (six, four) in self.spread.items() if four > six)


@dataclass(frozen=True)
class PaperOrder:
    """Whether CASE-3 before CASE-2 before CASE-1 is the order of iv, by kind of noise; share of draws in that order."""

    kept: Mapping[str, bool]
    by_chance: float


@dataclass(frozen=True)
class SamplesForOnePerCent:
    """Share of draws with all parameters within about 1 % at `samples`; samples for an rms spread of 1 %, by method."""

    samples: int
    within: float
    needed: Mapping[str, float]

    @property
    def enough(self) -> bool:
        """Whether iv reaches an rms spread of 1 % with so many."""
        return self.needed["iv"] <= self.samples


@dataclass(frozen=True)
class Findings:
    """All findings, in the order of the paper."""

    printed_among_draws: PrintedAmongDraws
    bias: LeastSquaresBias
    efficiency: Efficiency
    one_draw: OneDraw
    luck: Luck
    coverage: IntervalCoverage
    fewer_unknowns: FewerUnknowns
    order: PaperOrder
    samples: SamplesForOnePerCent


def findings(draws: Draws) -> Findings:
    """All findings from the repeats."""
    inside, total, probabilities = 0, 0, []
    paper = draws.paper
    columns = [
        (draws.at(noise=level), name, paper.table2[name][row])
        for name in ("ls", "iv")
        for row, level in enumerate(paper.levels)
    ]
    columns.append((draws.at(unknowns=FOUR), "iv", np.array(list(paper.table3.values()))))
    columns += [
        (draws.at(frequencies=case), "iv", row) for case, row in paper.table4.items() if case != "CASE-3"
    ]
    for scenario, method, given in columns:
        errors = draws.errors(scenario, method)
        low, high = np.quantile(errors, (0.025, 0.975), axis=0)
        inside += int(np.sum((low <= given) & (given <= high)))
        total += len(given)
        probabilities.append(farther(errors, given))
    scenario = draws.at()
    cases = [draws.at(frequencies=case) for case in draws.paper.cases]
    ratios = [draws.rms_spread(case, "oiv") / draws.summary(case, "oiv").rms_bound for case in cases]
    efficiency = Efficiency(
        draws.rms_spread(scenario, "iv"),
        draws.rms_spread(scenario, "oiv"),
        draws.summary(scenario, "iv").rms_bound,
        (min(ratios), max(ratios)),
    )
    paper = draws.paper
    scaled = paper.table2["iv"] / (100 * np.array(paper.levels))[:, None]
    correlation = np.corrcoef(scaled)[np.triu_indices(len(scaled), 1)]
    one_draw = OneDraw(
        100 * float(np.max(np.abs(scaled[1:] / scaled[-2] - 1))),
        float(np.min(correlation)),
        draws.rms_spread(draws.at(noise=paper.levels[-1]), "iv"),
    )
    ten, twenty = draws.at(), draws.at(noise=0.2)
    rms = float(np.sqrt(np.mean(draws.paper.table4["CASE-3"] ** 2)))
    sizes = np.sqrt(np.mean(draws.errors(ten, "iv") ** 2, axis=-1))
    largest = float(np.max(np.abs(draws.paper.table2["iv"][-1])))
    within = {
        name: 100 * float(np.mean(np.max(np.abs(draws.errors(twenty, name)), axis=-1) <= largest))
        for name in ("iv", "oiv")
    }
    luck = Luck(rms, 100 * float(np.mean(sizes <= rms)), draws.rms_spread(ten, "iv"), largest, within)
    count = draws.at().draws
    by_method = {}
    for name in ("iv", "oiv"):
        summaries = [draws.summary(draws.at(frequencies=case), name) for case in draws.paper.cases]
        covered = np.concatenate([summary.coverage for summary in summaries])
        by_method[name] = (float(np.min(covered)), float(np.max(covered)))
    coverage = IntervalCoverage(count, 100 * float(np.sqrt(0.95 * 0.05 / count)), by_method)
    scenario = draws.at(in_all=CLAIM_SAMPLES)
    largest = np.max(np.abs(draws.errors(scenario, "iv")), axis=-1)
    needed = {name: CLAIM_SAMPLES * draws.rms_spread(scenario, name) ** 2 for name in ("iv", "oiv")}
    # 1.04 %: what "about 1 %" takes in (section 3.3)
    samples = SamplesForOnePerCent(CLAIM_SAMPLES, 100 * float(np.mean(largest <= 1.04)), needed)
    return Findings(
        PrintedAmongDraws(inside, total, min(probabilities), max(probabilities)),
        _bias(draws),
        efficiency,
        one_draw,
        luck,
        coverage,
        _fewer_unknowns(draws),
        _order(draws),
        samples,
    )


def _bias(draws: Draws) -> LeastSquaresBias:
    worst = []
    for level in (0.1, 0.2):
        summary = draws.summary(draws.at(noise=level), "ls")
        j = int(np.argmax(np.abs(summary.mean)))
        worst.append(
            WorstBias(100 * level, draws.paper.unknown[j], float(summary.mean[j]), float(summary.spread[j]))
        )
    small, large = (draws.summary(draws.at(noise=level), "ls").mean for level in (0.05, 0.1))
    covered = draws.summary(draws.at(), "ls").coverage
    return LeastSquaresBias(
        tuple(worst),
        float(np.linalg.norm(large) / np.linalg.norm(small)),
        (float(np.min(covered)), float(np.max(covered))),
    )


def _fewer_unknowns(draws: Draws) -> FewerUnknowns:
    paper = draws.paper
    six, four = draws.summary(draws.at(), "iv"), draws.summary(draws.at(unknowns=FOUR), "iv")
    index = {name: (paper.unknown.index(name), j) for j, name in enumerate(paper.table3)}
    return FewerUnknowns(
        {name: (float(six.spread[i]), float(four.spread[j])) for name, (i, j) in index.items()},
        {name: (float(six.bound[i]), float(four.bound[j])) for name, (i, j) in index.items()},
        tuple(
            name
            for name, error in paper.table3.items()
            if abs(error) > abs(paper.table4["CASE-3"][index[name][0]])
        ),
    )


def _order(draws: Draws) -> PaperOrder:
    best_first = ("CASE-3", "CASE-2", "CASE-1")  # as the paper ranks them, from one draw each
    kept = {}
    for kind in ("relative", "constant"):
        first, second, third = (
            draws.rms_spread(draws.at(frequencies=case, kind=kind), "iv") for case in best_first
        )
        kept[kind] = first < second < third
    sizes = [
        np.sqrt(np.mean(draws.errors(draws.at(frequencies=case), "iv") ** 2, axis=-1)) for case in best_first
    ]
    count = min(len(size) for size in sizes)
    a, b, c = (size[:count] for size in sizes)
    return PaperOrder(kept, 100 * float(np.mean((a < b) & (b < c))))


FEWEST = 20


@dataclass(frozen=True)
class Reproduction:
    """All of it, as plain numbers."""

    draws: int
    seed: int
    source: str
    unknown: tuple[str, ...]
    eigenvalues: tuple[EigenvalueEntry, ...]
    table2: tuple[PrintedColumn, ...]
    table3: tuple[PrintedColumn, ...]
    table4: tuple[PrintedColumn, ...]
    identified_eigenvalues: tuple[EigenvalueEntry, ...]
    ranking: tuple[Rank, ...]
    figure2: FigureData
    figure3: FigureData
    findings: Findings
    corrections: tuple[Mapping[str, str], ...]


def reproduce(
    draws: int = DRAWS,
    seed: int = SEED,
    progress: Callable[[int, int], None] | None = None,
    *,
    mapper: Map = map,
) -> Reproduction:
    """Tables 1-4 and Figures 2-3 with `draws` noise draws for each point; `progress(done, all)` counts identifications.

    The same seed gives the same numbers whatever the `mapper`.  About 2 ms a draw and point.  Raises UsageError for
    fewer than FEWEST draws.
    """
    if draws < FEWEST:
        raise UsageError(f"{draws} draws are too few for a standard deviation", cure=f"use {FEWEST} or more")
    points = (*scenarios(figures_study(draws, seed)), *scenarios(tables_study(draws, seed)))
    unique = {point.name: point for point in points}
    repeats = Draws(run_scenarios(list(unique.values()), seed, mapper=mapper, progress=progress))
    return Reproduction(
        draws,
        seed,
        repeats.paper.source,
        repeats.paper.unknown,
        table_1(),
        table_2(repeats),
        table_3(repeats),
        table_4(repeats),
        identified_eigenvalues(repeats),
        ranking(repeats),
        figure_2(repeats),
        figure_3(repeats),
        findings(repeats),
        repeats.paper.corrections,
    )
