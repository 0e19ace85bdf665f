"""Monte Carlo: many simulated tests, identified by several methods, in blocks that any map can share out.

A Scenario is one point of a study.  Its repeats are drawn in blocks of BLOCK; the random numbers of a block follow
from the study's seed, the scenario's own name and the number of the block alone, and blocks are put together in their
order.  So the result is the same to the bit whoever computes which block when, in one go or after an interruption.

A task, and the file that keeps it, is one block among the first ALONE of a scenario, so that small studies are shared
out finely, and TOGETHER blocks after them, for a file costs as much as some 300 quick repeats.  Which blocks go
together does not depend on how many there are: a study that grows keeps its files.

study.json                    what lies in a study's folder: name, seed, block size, each scenario with its fingerprint
draws/KEY/000000.parquet      the repeats of a block, or of several from that one on, a row for each method and draw
summary.parquet               bias, spread, coverage and bound, one row for each scenario, method and parameter
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Frozen, Real
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.automatic import identify_each, identify_with_noise
from dashpot.estimate.result import Estimate
from dashpot.io.atomic import write_text
from dashpot.io.json_document import from_json, to_json
from dashpot.notices import Notice
from dashpot.numerics.kernel import description
from dashpot.study.blocks import BlockStore, Columns, Key, Map, State, opened_store, write_table
from dashpot.study.scenario import AUTO, Scenario, Study, scenarios

# The repeats of one method, and what they say: bias, spread, coverage, efficiency.


LEVELS = (0.025, 0.25, 0.5, 0.75, 0.975)  # of the quantiles in a Summary
WIDE = ("values", "sd", "half")  # of Repeats: one column an unknown
SUMMARISED = (
    *("mean", "mean_se", "spread", "spread_se", "rms"),
    *("stated", "bound", "efficiency", "coverage", "coverage_se"),
)


@dataclass(frozen=True)
class Repeats(Frozen):
    """What one method made of the repeats of one scenario.

    values     (draws, unknowns)  estimates
    sd         (draws, unknowns)  the standard deviations that it stated
    half       (draws, unknowns)  half widths of its 95 % intervals
    converged  (draws,)           False where it failed
    p          (draws,)           p-value of χ² of the fit
    """

    values: Real
    sd: Real
    half: Real
    converged: Bools
    p: Real

    @property
    def good(self) -> Bools:
        """Repeats that gave an answer, (draws,)."""
        return self.converged & np.all(np.isfinite(self.values), axis=-1)

    def errors(self, theta: Real) -> Real:
        """Relative errors in % of the repeats that gave an answer, (good draws, unknowns); of a true 0, the values."""
        size = np.where(theta == 0, 1.0, np.abs(theta) / 100)
        return (self.values[self.good] - theta) / size


def all_repeats(parts: Sequence[Repeats]) -> Repeats:
    """All repeats of several blocks, in their order."""
    names = (*WIDE, "converged", "p")
    return Repeats(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True)
class Summary:
    """One method in one scenario; arrays are (unknowns,), in % of the true value where not said otherwise.

    draws, failed   repeats, and those that gave no answer (they are left out of all that follows)
    mean, mean_se   mean error (bias) and its standard error
    spread, spread_se   standard deviation of the errors and its standard error (from their fourth moment)
    rms             root mean square error
    quantiles       of the errors at LEVELS, (5, unknowns)
    stated          root mean square of the standard deviations that the method stated
    bound           Cramér-Rao bound at the truth
    coverage, coverage_se   share of 95 % intervals that hold the truth, in %
    rejected        share of repeats whose χ² fails at 5 %, in %; NaN without χ²
    """

    draws: int
    failed: int
    mean: Real
    mean_se: Real
    spread: Real
    spread_se: Real
    rms: Real
    quantiles: Real
    stated: Real
    bound: Real
    coverage: Real
    coverage_se: Real
    rejected: float

    @property
    def efficiency(self) -> Real:
        """(bound / spread)², (unknowns,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return (self.bound / self.spread) ** 2

    @property
    def rms_bias(self) -> float:
        """Root mean square of the mean errors over the unknowns, %."""
        return _rms(self.mean)

    @property
    def rms_spread(self) -> float:
        """Root mean square of the spreads over the unknowns, %."""
        return _rms(self.spread)

    @property
    def rms_error(self) -> float:
        """Root mean square error over the unknowns, %."""
        return _rms(self.rms)

    @property
    def rms_bound(self) -> float:
        """Root mean square of the bounds over the unknowns, %."""
        return _rms(self.bound)

    @property
    def error_over_bound(self) -> float:
        """Root mean square error over the bound, both over all unknowns; NaN where there is no bound."""
        return self.rms_error / self.rms_bound if self.rms_bound > 0 else math.nan


def _rms(values: Real) -> float:
    return float(np.sqrt(np.mean(values**2)))


def summarise(repeats: Repeats, theta: Real, bound_sd: Real) -> Summary:
    """Sums over the repeats of one method; `theta` and `bound_sd` (unknowns,) are the truth and its bound."""
    size = np.where(theta == 0, 1.0, np.abs(theta) / 100)
    good = repeats.good
    errors = repeats.errors(theta)
    count, unknowns = errors.shape
    bound = bound_sd / size
    draws = len(good)
    if count < 2:
        lost = np.full(unknowns, np.nan)
        quantiles = np.full((len(LEVELS), unknowns), np.nan)
        none = (*(lost,) * 5, quantiles, lost, bound, lost, lost, np.nan)
        return Summary(draws, draws - count, *none)
    mean = np.mean(errors, axis=0)
    away = errors - mean
    variance = np.sum(away**2, axis=0) / (count - 1)
    spread = np.sqrt(variance)
    fourth = np.mean(away**4, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread_se = np.sqrt(np.maximum(fourth - variance**2, 0.0) / count) / (2 * spread)
        inside = np.abs(repeats.values[good] - theta) <= repeats.half[good]
    share, p = np.mean(inside, axis=0), repeats.p[good & np.isfinite(repeats.p)]
    return Summary(
        draws=draws,
        failed=draws - count,
        mean=mean,
        mean_se=spread / np.sqrt(count),
        spread=spread,
        spread_se=np.where(spread > 0, spread_se, 0.0),
        rms=np.sqrt(np.mean(errors**2, axis=0)),
        quantiles=np.quantile(errors, LEVELS, axis=0),
        stated=np.sqrt(np.mean(repeats.sd[good] ** 2, axis=0)) / size,
        bound=bound,
        coverage=100 * share,
        coverage_se=100 * np.sqrt(share * (1 - share) / count),
        rejected=100 * float(np.mean(p < 0.05)) if len(p) else np.nan,
    )


# Blocks: what workers do.


BLOCK = 500  # repeats; part of what the seed means
ALONE = 32  # blocks at the beginning of a scenario that are tasks of their own
TOGETHER = 8  # blocks that make one task after them
version = cache(metadata.version)  # which reads a file


@dataclass(frozen=True)
class Task:
    """Blocks of one scenario that follow each other.

    index  of the first block in its scenario
    size   repeats in all, `block` in each block but the last
    """

    scenario: Scenario
    index: int
    size: int
    seed: int
    block: int = BLOCK

    def single_blocks(self) -> Iterator[Task]:
        """A task for each of its blocks."""
        for number, first in enumerate(range(0, self.size, self.block)):
            yield replace(self, index=self.index + number, size=min(self.block, self.size - first))

    @property
    def identifications(self) -> int:
        """Repeats times methods."""
        return self.size * len(self.scenario.methods)

    @property
    def key(self) -> Key:
        """Where its repeats are kept, and what they are of."""
        scenario = self.scenario
        label = {
            "fingerprint": scenario.fingerprint,
            "seed": self.seed,
            "index": self.index,
            "size": self.size,
            "methods": list(scenario.methods),
            "unknowns": len(scenario.model.unknowns),
            "version": f"{version('dashpot')}, {description()}",
        }
        return Key(f"draws/{scenario.key}/{self.index:06d}", label)


def tasks(scenarios: Iterable[Scenario], seed: int, block: int = BLOCK) -> list[Task]:
    """The blocks of the scenarios, in order; the last of each scenario may be smaller."""
    work = []
    for scenario in scenarios:
        index = 0
        while (left := scenario.draws - index * block) > 0:
            count = 1 if index < ALONE else TOGETHER
            work.append(Task(scenario, index, min(count * block, left), seed, block))
            index += count
    return work


def generator(seed: int, key: str, index: int) -> np.random.Generator:
    """The random numbers of one block: they depend on nothing else."""
    words = tuple(int(key[i : i + 8], 16) for i in (0, 8))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*words, index)))


def run_task(task: Task) -> Columns:
    """Draw the blocks and identify each by all methods of its scenario: rows method after method.

    A function of the module, so that any process can be sent it.  Raises DashpotError that names the scenario.
    """
    try:
        parts = [repeats_of(single) for single in task.single_blocks()]
    except DashpotError as error:
        first = error.problems[0]
        raise UsageError(first.what, task.scenario.name, first.cure) from error
    methods = task.scenario.methods
    whole = all_repeats([part[name] for name in methods for part in parts])
    columns: Columns = {"method": np.repeat(methods, task.size), "converged": whole.converged, "p": whole.p}
    for name in WIDE:
        columns |= {f"{name}_{i}": np.array(column) for i, column in enumerate(getattr(whole, name).T)}
    return columns


def repeats_of(task: Task) -> dict[str, Repeats]:
    """What each method makes of a task of one block, all of the same draws."""
    scenario = task.scenario
    spectrum = scenario.drawn(generator(task.seed, scenario.key, task.index), task.size)
    count, unknowns = len(spectrum.amplitudes), len(scenario.model.unknowns)
    repeats = {}
    for method in scenario.methods:
        # A method that is named takes all repeats as one batch; where none is, some need a second look (`identify`).
        if method != AUTO:
            repeats[method] = _repeats(identify_with_noise(scenario.model, spectrum, method)[0], unknowns)
            continue
        whole: Columns = {name: np.full((count, unknowns), np.nan) for name in WIDE}
        whole |= {"converged": np.zeros(count, dtype=bool), "p": np.full(count, np.nan)}
        for places, estimate in identify_each(scenario.model, spectrum):
            if isinstance(estimate, Estimate):
                found = _repeats(estimate, unknowns)
                rows = places if len(found.p) == count else np.zeros(1, dtype=int)
                for name, values in whole.items():
                    values[places] = getattr(found, name)[rows]
            elif not isinstance(estimate, DashpotError):
                raise estimate
        repeats[method] = Repeats(**whole)
    return repeats


def _repeats(estimate: Estimate, unknowns: int) -> Repeats:
    """Of an estimate with batch axes or without, the rig's own unknowns."""
    low, high = estimate.interval()
    values, sd, half = (
        np.atleast_2d(part)[:, :unknowns] for part in (estimate.values, estimate.sd, (high - low) / 2)
    )
    return Repeats(values, sd, half, np.atleast_1d(estimate.converged), np.atleast_1d(estimate.fit.p))


# Runs: sharing blocks out and putting them together.


@dataclass(frozen=True)
class Results:
    """All repeats of a run, in the blocks of its store."""

    scenarios: tuple[Scenario, ...]
    seed: int
    block: int
    store: BlockStore

    def repeats(self, scenario: Scenario) -> dict[str, Repeats]:
        """The scenario's repeats by method, blocks in order.  Raises DataError if one has been damaged since."""
        parts: dict[str, list[Repeats]] = {name: [] for name in scenario.methods}
        unknowns = range(len(scenario.model.unknowns))
        for task in tasks([scenario], self.seed, self.block):
            columns = self.store.read(task.key)
            for k, repeats in enumerate(parts.values()):
                rows = slice(k * task.size, (k + 1) * task.size)
                parts_of = {name: columns[name][rows] for name in ("converged", "p")}
                for name in WIDE:
                    parts_of[name] = np.stack([columns[f"{name}_{i}"][rows] for i in unknowns], axis=-1)
                repeats.append(Repeats(**parts_of))
        return {name: all_repeats(blocks) for name, blocks in parts.items()}

    def summaries(self, scenario: Scenario) -> dict[str, Summary]:
        """Bias, spread, coverage and efficiency of each method."""
        bound, repeats = scenario.bound_sd(), self.repeats(scenario)
        return {name: summarise(own, scenario.theta, bound) for name, own in repeats.items()}


def run_scenarios(
    scenarios: Sequence[Scenario],
    seed: int,
    *,
    store: BlockStore | None = None,
    block: int = BLOCK,
    mapper: Map = map,
    progress: Callable[[int, int], None] | None = None,
) -> Results:
    """Compute all blocks that are not in the `store` yet, by any `mapper`; the order of its results does not matter.

    `progress(done, all)` counts identifications.  Raises UsageError if two scenarios have the same factors, or
    where a method cannot do what is asked.
    """
    name, times = Counter(scenario.name for scenario in scenarios).most_common(1)[0] if scenarios else ("", 0)
    if times > 1:
        raise UsageError(f"{name} occurs twice in the study", cure="remove one of the two")
    kept = BlockStore() if store is None else store
    work = tasks(scenarios, seed, block)
    done, total = 0, sum(task.identifications for task in work)
    for finished in kept.map(run_task, work, key=lambda task: task.key, mapper=mapper):
        done += finished.task.identifications
        if progress is not None:
            progress(done, total)
    return Results(tuple(scenarios), seed, block, kept)


# A study in a folder: blocks as they are finished, a summary at the end, and going on where it was interrupted.


FORMAT = 3
REPLACED: Mapping[State, str] = {
    "damaged": "damaged, or not in its place",
    "outdated": "another version of dashpot had computed it",
}


@dataclass(frozen=True)
class SummaryRow:
    """What one method did in one scenario."""

    scenario: Scenario
    method: str
    summary: Summary


@dataclass(frozen=True)
class StudyOutcome:
    """A finished study: a row for each scenario and method, in the order of the study."""

    name: str
    seed: int
    rows: tuple[SummaryRow, ...]
    notes: tuple[Notice, ...] = ()

    def columns(self) -> dict[str, list[Any]]:
        """The summary as a table: one row for each scenario, method and parameter; errors in % of the true value."""
        factors = list(dict.fromkeys(key for row in self.rows for key in row.scenario.factors))
        table: list[dict[str, Any]] = []
        for row in self.rows:
            scenario, s = row.scenario, row.summary
            for j, unknown in enumerate(scenario.model.unknowns):
                entry = {key: scenario.factors.get(key) for key in factors}
                entry |= {"method": row.method, "parameter": unknown.name, "unit": unknown.unit}
                entry |= {"true_value": float(scenario.theta[j]), "draws": s.draws, "failed": s.failed}
                entry |= {"rejected": s.rejected} | {name: float(getattr(s, name)[j]) for name in SUMMARISED}
                entry |= {f"quantile_{level:g}": float(s.quantiles[k, j]) for k, level in enumerate(LEVELS)}
                table.append(entry)
        return {key: [entry[key] for entry in table] for key in (table[0] if table else factors)}


def run_study(
    study: Study,
    folder: Path | None = None,
    *,
    mapper: Map = map,
    progress: Callable[[int, int], None] | None = None,
    block: int = BLOCK,
) -> StudyOutcome:
    """Compute what is not in `folder` yet, by any `mapper`, and summarise; without a folder all stays in memory.

    The result depends on the study alone: not on the mapper, nor on interruptions.  A study that has grown (more
    draws, levels, methods …) uses what an earlier one left.  `progress(done, all)` counts identifications.

    Raises UsageError if the folder holds something else, another process works in it, or a method cannot do what is
    asked of it; DataError if the folder cannot be written; ModelError if a rig has no steady response;
    IdentifiabilityError if a test does not determine the unknowns.
    """
    points = scenarios(study)
    rehearse(points)
    if folder is None:
        return _outcome(
            study, run_scenarios(points, study.seed, block=block, mapper=mapper, progress=progress)
        )
    manifest = folder / "study.json"
    with opened_store(folder, lambda _: manifest.exists(), "name a new folder for the study") as store:
        # Write down whose folder it is, or see that it is this study's
        own: dict[str, Any] = {"format": FORMAT, "name": study.name, "seed": study.seed, "block": block}
        new = {
            point.key: {"factors": dict(point.factors), "fingerprint": point.fingerprint} for point in points
        }
        old: dict[str, Any] = {}
        if manifest.exists():
            another = "name another folder, or delete this one"
            try:
                other = from_json(manifest.read_text(encoding="utf-8"))
                old = dict(other["scenarios"])
                fingerprints = {key: str(entry["fingerprint"]) for key, entry in old.items()}
            except (OSError, ValueError, KeyError, TypeError):
                raise UsageError("this is not a study of dashpot", str(manifest), another) from None
            for key in ("format", "seed", "block"):
                if other.get(key) != own[key]:
                    what = f"the folder holds a study with {key} {other.get(key)}, not {own[key]}"
                    raise UsageError(what, str(manifest), another)
            for point in points:
                if fingerprints.get(point.key, point.fingerprint) != point.fingerprint:
                    what = f"the folder holds another study: {point.name} is different"
                    raise UsageError(what, str(manifest), another)
        write_text(manifest, to_json({**own, "scenarios": old | new}))
        outcome = _outcome(
            study,
            run_scenarios(points, study.seed, store=store, block=block, mapper=mapper, progress=progress),
        )
        write_table(folder / "summary.parquet", outcome.columns())
    return outcome


def _outcome(study: Study, results: Results) -> StudyOutcome:
    rows = [
        SummaryRow(scenario, name, summary)
        for scenario in results.scenarios
        for name, summary in results.summaries(scenario).items()
    ]
    states = results.store.states
    notes = [
        Notice(f"{state}_blocks", f"{states[state]} of the study's blocks computed again: {why}")
        for state, why in REPLACED.items()
        if states[state]
    ]
    return StudyOutcome(study.name, study.seed, tuple(rows), tuple(notes))


def rehearse(points: Sequence[Scenario]) -> None:
    """Two draws of every scenario by every method, and its bound: what cannot work fails now, not hours later.

    Raises the DashpotError, placed at the scenario.
    """
    for point in points:
        try:
            point.bound_sd()
        except DashpotError as error:
            first = error.problems[0]
            raise type(error)(first.what, point.name, first.cure) from error
        run_task(Task(point, 0, 2, 0))
