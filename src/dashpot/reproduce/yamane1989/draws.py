"""The noise draws of all scenarios, found by what they vary, and measures of their spread."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Real
from dashpot.reproduce.yamane1989.printed import paper_prints
from dashpot.study.montecarlo import Results
from dashpot.study.scenario import Scenario
from dashpot.study.summary import Repeats, Summary


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
