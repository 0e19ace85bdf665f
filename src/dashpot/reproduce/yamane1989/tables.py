"""The paper's tables again: each printed number beside what many draws give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.model.modes import eigenpairs, modes
from dashpot.model.network import Model
from dashpot.reproduce.yamane1989.rig import FOUR, METHODS, paper_model, paper_prints
from dashpot.study.montecarlo import Repeats, Results, Summary
from dashpot.study.scenario import Scenario

# The noise draws of all scenarios, found by what they vary, and measures of their spread.


class Draws:
    """Repeats and summaries of the scenarios of the paper's studies, kept once computed."""

    def __init__(self, results: Results) -> None:
        self.results = results
        self.paper = paper_prints()
        self._repeats: dict[str, dict[str, Repeats]] = {}
        self._summaries: dict[str, dict[str, Summary]] = {}

    def at(self, **wanted: str | float | int) -> Scenario:
        """The scenario with these factors; CASE-3, relative noise of 10 %, all unknown, 56 a frequency if not said.

        Raises KeyError where there is none.
        """
        usual: dict[str, str | float | int] = {
            "frequencies": "CASE-3",
            "kind": "relative",
            "noise": 0.1,
            "unknowns": "all",
        }
        if "in_all" not in wanted:
            usual["samples"] = self.paper.samples
        factors = usual | wanted
        for scenario in self.results.scenarios:
            if all(scenario.factors.get(key) == value for key, value in factors.items()):
                return scenario
        raise KeyError(str(factors))

    def repeats(self, scenario: Scenario) -> dict[str, Repeats]:
        """Repeats by method, kept."""
        if scenario.name not in self._repeats:
            self._repeats[scenario.name] = self.results.repeats(scenario)
        return self._repeats[scenario.name]

    def summary(self, scenario: Scenario, method: str) -> Summary:
        """Summary of one method, kept."""
        if scenario.name not in self._summaries:
            self._summaries[scenario.name] = self.results.summaries(scenario)
        return self._summaries[scenario.name][method]

    def errors(self, scenario: Scenario, method: str) -> Real:
        """Relative errors in %, (good draws, unknowns)."""
        return self.repeats(scenario)[method].errors(scenario.theta)

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
    order = np.argsort(np.where(upper, np.abs(values), np.inf), axis=-1)[:, : rig.n]
    return np.where(
        np.take_along_axis(upper, order, axis=-1), np.take_along_axis(values, order, axis=-1), np.nan
    )


def table_1() -> tuple[EigenvalueEntry, ...]:
    """Eigenvalues of the rig as modelled here beside the printed ones."""
    paper, rig = paper_prints(), paper_model()
    modelled = modes(rig, rig.parameters(rig.theta(dict(paper.values)))).eigenvalues
    return tuple(
        EigenvalueEntry("Table 1", "model", "–", complex(value), complex(ours), 0j)
        for value, ours in zip(paper.eigenvalues, modelled, strict=True)
    )


def table_2(draws: Draws) -> tuple[PrintedColumn, ...]:
    """Noise levels: every method at every level."""
    columns = []
    for row, level in enumerate(draws.paper.levels):
        for name in METHODS:
            rows = draws.paper.table2.get(name)
            given = None if rows is None else rows[row]
            columns.append(
                table_column(draws, "Table 2", f"{100 * level:g} %", draws.at(noise=level), name, given)
            )
    return tuple(columns)


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
    return tuple(
        table_column(
            draws,
            "Table 4",
            case,
            draws.at(frequencies=case),
            name,
            paper.table4[case] if name == "iv" else None,
        )
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
    return PrintedColumn(
        table,
        title,
        method,
        summary.draws,
        summary.failed,
        _entries(draws, scenario, method, given),
        rms,
        rms_se,
        rms_error=float(np.sqrt(np.mean(size**2))),
        bound=summary.rms_bound,
        printed_rms=printed_rms,
        luck=None if printed_rms is None else 100 * float(np.mean(size < printed_rms)),
        joint_p=None if given is None else farther(errors, given),
    )


def _entries(draws: Draws, scenario: Scenario, method: str, given: Real | None) -> tuple[TableEntry, ...]:
    summary, errors = draws.summary(scenario, method), draws.errors(scenario, method)
    entries = []
    for j, unknown in enumerate(scenario.model.unknowns):
        value = None if given is None else float(given[j])
        entries.append(
            TableEntry(
                unknown.name,
                value,
                float(summary.mean[j]),
                float(summary.mean_se[j]),
                float(summary.spread[j]),
                float(summary.spread_se[j]),
                low=float(summary.quantiles[0, j]),
                high=float(summary.quantiles[-1, j]),
                bound=float(summary.bound[j]),
                coverage=float(summary.coverage[j]),
                z=None if value is None else float((value - summary.mean[j]) / summary.spread[j]),
                percentile=None if value is None else 100 * float(np.mean(errors[:, j] < value)),
            )
        )
    return tuple(entries)


def identified_eigenvalues(draws: Draws) -> tuple[EigenvalueEntry, ...]:
    """Eigenvalues of the identified rigs, as Tables 2 and 4 print them."""
    paper = draws.paper
    entries: list[EigenvalueEntry] = []
    for name in ("ls", "iv"):
        for level, given in zip(paper.levels, paper.table2_eigenvalues[name], strict=False):
            entries += _eigenvalue_entries(
                draws, "Table 2", f"{100 * level:g} %", draws.at(noise=level), name, given
            )
    for case, given in paper.table4_eigenvalues.items():
        entries += _eigenvalue_entries(draws, "Table 4", case, draws.at(frequencies=case), "iv", given)
    return tuple(entries)


def _eigenvalue_entries(
    draws: Draws, table: str, title: str, scenario: Scenario, method: str, given: Complex
) -> list[EigenvalueEntry]:
    repeats = draws.repeats(scenario)[method]
    values = eigenvalues(scenario.model, repeats.values[repeats.good])
    return [
        EigenvalueEntry(
            table, title, method, complex(value), complex(np.mean(column)),
            complex(float(np.std(column.real)), float(np.std(column.imag))),
        )
        for value, column in zip(given, values.T, strict=True)
    ]  # fmt: skip


def ranking(draws: Draws) -> tuple[Rank, ...]:
    """The four cases under both kinds of noise."""
    return tuple(rank for kind in ("relative", "constant") for rank in _ranks(draws, kind))


def _ranks(draws: Draws, kind: str) -> list[Rank]:
    scenarios = {case: draws.at(frequencies=case, kind=kind) for case in draws.paper.cases}
    spreads = {
        name: {case: rms_spread(draws.errors(scenario, name)) for case, scenario in scenarios.items()}
        for name in ("iv", "oiv")
    }
    ranks = []
    for case, scenario in scenarios.items():
        places = [
            1 + sum(other[0] < spreads[name][case][0] for other in spreads[name].values())
            for name in ("iv", "oiv")
        ]
        ranks.append(
            Rank(
                kind,
                case,
                int(np.sum(scenario.test.samples)),
                *spreads["iv"][case],
                *spreads["oiv"][case],
                ls=float(np.sqrt(np.mean(draws.errors(scenario, "ls") ** 2))),
                bound=draws.summary(scenario, "oiv").rms_bound,
                place_iv=places[0],
                place_oiv=places[1],
            )
        )
    return ranks
