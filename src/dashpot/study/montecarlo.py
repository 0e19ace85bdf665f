"""Monte Carlo: many simulated tests, identified by several methods, in blocks that any map can share out.

A Scenario is one point of a study.  Its repeats are drawn in blocks of BLOCK; the random numbers of a block follow
from the study's seed, the scenario's own name and the number of the block alone, and blocks are put together in their
order.  So the result is the same to the bit whoever computes which block when, in one go or after an interruption.

A task, and the file that keeps it, is one block among the first ALONE of a scenario, so that small studies are shared
out finely, and TOGETHER blocks after them, for a file costs as much as some 300 quick repeats.  Which blocks go
together does not depend on how many there are: a study that grows keeps its files.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import metadata
from pathlib import Path

import numpy as np

from dashpot.arrays import Bools, Real, freeze
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.registry import method
from dashpot.estimate.result import Estimate
from dashpot.numerics.kernel import description
from dashpot.study.scenario import Scenario
from dashpot.study.store import Label, State, read_block, state_of, write_block

# The repeats of one method, and what they say: bias, spread, coverage, efficiency.


LEVELS = (0.025, 0.25, 0.5, 0.75, 0.975)  # of the quantiles in a Summary


@dataclass(frozen=True)
class Repeats:
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

    def __post_init__(self) -> None:
        freeze(self)

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
    return Repeats(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("values", "sd", "half", "converged", "p")
        )
    )


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
        return float(np.sqrt(np.mean(self.mean**2)))

    @property
    def rms_spread(self) -> float:
        """Root mean square of the spreads over the unknowns, %."""
        return float(np.sqrt(np.mean(self.spread**2)))

    @property
    def rms_error(self) -> float:
        """Root mean square error over the unknowns, %."""
        return float(np.sqrt(np.mean(self.rms**2)))

    @property
    def error_over_bound(self) -> float:
        """Root mean square error over the bound, both over all unknowns; NaN where there is no bound."""
        return self.rms_error / self.rms_bound if self.rms_bound > 0 else math.nan

    @property
    def rms_bound(self) -> float:
        """Root mean square of the bounds over the unknowns, %."""
        return float(np.sqrt(np.mean(self.bound**2)))


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
        return Summary(
            draws, draws - count, lost, lost, lost, lost, lost, np.full((len(LEVELS), unknowns), np.nan), lost,
            bound, lost, lost, np.nan,
        )  # fmt: skip
    mean = np.mean(errors, axis=0)
    away = errors - mean
    variance = np.sum(away**2, axis=0) / (count - 1)
    spread = np.sqrt(variance)
    fourth = np.mean(away**4, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread_se = np.sqrt(np.maximum(fourth - variance**2, 0.0) / count) / (2 * spread)
        inside = np.abs(repeats.values[good] - theta) <= repeats.half[good]
    share = np.mean(inside, axis=0)
    p = repeats.p[good]
    return Summary(
        draws,
        draws - count,
        mean,
        spread / np.sqrt(count),
        spread,
        np.where(spread > 0, spread_se, 0.0),
        np.sqrt(np.mean(errors**2, axis=0)),
        np.quantile(errors, LEVELS, axis=0),
        np.sqrt(np.mean(repeats.sd[good] ** 2, axis=0)) / size,
        bound,
        100 * share,
        100 * np.sqrt(share * (1 - share) / count),
        100 * float(np.mean(p[np.isfinite(p)] < 0.05)) if np.any(np.isfinite(p)) else np.nan,
    )


BLOCK = 500  # repeats; part of what the seed means
ALONE = 32  # blocks at the beginning of a scenario that are tasks of their own
TOGETHER = 8  # blocks that make one task after them
version = cache(metadata.version)  # which reads a file


Block = Mapping[str, Repeats]


# Blocks: what workers do


@dataclass(frozen=True)
class Task:
    """Blocks of one scenario that follow each other; `file` is where they are kept, None where they are handed back.

    index  of the first block in its scenario
    size   repeats in all, `block` in each block but the last
    """

    scenario: Scenario
    index: int
    size: int
    seed: int
    file: str | None = None
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
    def label(self) -> Label:
        """What its file says that it holds."""
        scenario = self.scenario
        return Label(
            scenario.fingerprint, self.seed, self.index, self.size, scenario.methods, len(scenario.model.unknowns),
            f"{version('dashpot')}, {description()}",
        )  # fmt: skip


@dataclass(frozen=True)
class Done:
    """A finished task; `block` where it was not written to a file."""

    key: str
    index: int
    identifications: int
    block: Block | None = None


def generator(seed: int, key: str, index: int) -> np.random.Generator:
    """The random numbers of one block: they depend on nothing else."""
    words = tuple(int(key[i : i + 8], 16) for i in (0, 8))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*words, index)))


def run_task(task: Task) -> Done:
    """Draw the blocks and identify each by all methods of its scenario.

    A function of the module, so that any process can be sent it.  Raises DashpotError that names the scenario.
    """
    scenario = task.scenario
    try:
        parts = [
            {name: _repeats(estimate) for name, estimate in estimates(single)}
            for single in task.single_blocks()
        ]
    except DashpotError as error:
        first = error.problems[0]
        raise UsageError(first.what, f"{scenario.name}", first.cure) from error
    block = {name: all_repeats([part[name] for part in parts]) for name in scenario.methods}
    if task.file is None:
        return Done(scenario.key, task.index, task.identifications, block)
    _write(task, block)
    return Done(scenario.key, task.index, task.identifications)


def _write(task: Task, block: Block) -> None:
    assert task.file is not None
    write_block(Path(task.file), {name: _columns(repeats) for name, repeats in block.items()}, task.label)


def estimates(task: Task) -> Iterable[tuple[str, Estimate]]:
    """The Estimates of a task of one block, method by method, all of the same draws."""
    scenario = task.scenario
    spectrum = scenario.drawn(generator(task.seed, scenario.key, task.index), task.size)
    for name in scenario.methods:
        yield name, identify(scenario.model, spectrum, method(name))


def _repeats(estimate: Estimate) -> Repeats:
    low, high = estimate.interval()
    return Repeats(
        estimate.values, estimate.sd, (high - low) / 2, np.asarray(estimate.converged), estimate.fit.p
    )


def _columns(repeats: Repeats) -> dict[str, Real | Bools]:
    return {name: getattr(repeats, name) for name in ("values", "sd", "half", "converged", "p")}


# Runs: sharing blocks out and putting them together


@dataclass(frozen=True)
class Results:
    """All repeats of a run: handed over in memory, or kept in the files of `folder`.

    `replaced` counts the blocks that lay there and were computed again, by what was wrong with them.
    """

    scenarios: tuple[Scenario, ...]
    seed: int
    block: int
    folder: Path | None = None
    memory: Mapping[tuple[str, int], Block] = field(default_factory=dict)
    replaced: Mapping[State, int] = field(default_factory=dict)

    def repeats(self, scenario: Scenario) -> dict[str, Repeats]:
        """The scenario's repeats by method, blocks in order."""
        parts: dict[str, list[Repeats]] = {name: [] for name in scenario.methods}
        for task in tasks([scenario], self.seed, self.block, self.folder):
            if task.file is None:
                block = self.memory[scenario.key, task.index]
            else:
                columns = read_block(Path(task.file), task.label)
                block = {name: Repeats(**values) for name, values in columns.items()}
            for name in scenario.methods:
                parts[name].append(block[name])
        return {name: all_repeats(blocks) for name, blocks in parts.items()}

    def summaries(self, scenario: Scenario) -> dict[str, Summary]:
        """Bias, spread, coverage and efficiency of each method."""
        bound = scenario.bound_sd()
        return {
            name: summarise(repeats, scenario.theta, bound)
            for name, repeats in self.repeats(scenario).items()
        }


def tasks(
    scenarios: Iterable[Scenario], seed: int, block: int = BLOCK, folder: Path | None = None
) -> list[Task]:
    """The blocks of the scenarios, in order; the last of each scenario may be smaller."""
    work = []
    for scenario in scenarios:
        index = 0
        while (left := scenario.draws - index * block) > 0:
            count = 1 if index < ALONE else TOGETHER
            file = None if folder is None else str(block_file(folder, scenario, index))
            work.append(Task(scenario, index, min(count * block, left), seed, file, block))
            index += count
    return work


def block_file(folder: Path, scenario: Scenario, index: int) -> Path:
    """Where a task's blocks are kept, the first of which is `index`."""
    return folder / "draws" / scenario.key / f"{index:06d}.parquet"


def _not_whole(work: Sequence[Task]) -> tuple[list[Task], Counter[State]]:
    """The blocks that are not on disk as they should be, with folders for them; how many there are to be replaced."""
    states: list[State] = [
        "absent" if task.file is None else state_of(Path(task.file), task.label) for task in work
    ]
    left = [task for task, state in zip(work, states, strict=True) if state != "whole"]
    for parent in {Path(task.file).parent for task in left if task.file is not None}:
        parent.mkdir(parents=True, exist_ok=True)
    return left, Counter(state for state in states if state in ("damaged", "outdated"))


Map = Callable[[Callable[[Task], Done], Iterable[Task]], Iterable[Done]]


def run_scenarios(
    scenarios: Sequence[Scenario],
    seed: int,
    *,
    folder: Path | None = None,
    block: int = BLOCK,
    mapper: Map = map,
    progress: Callable[[int, int], None] | None = None,
    remote: bool = False,
) -> Results:
    """Compute all blocks that are not there yet, by any `mapper`; order and number of its workers do not matter.

    With a `folder` each block is written when it is done, whole or not at all, and what lies there is not computed
    again (the caller sees to it that it is the same study's).  `progress(done, all)` counts identifications.  With
    `remote`, workers hand their blocks back instead of writing them.

    Raises UsageError where two scenarios have the same factors, or where a method cannot do what is asked.
    """
    name, times = Counter(scenario.name for scenario in scenarios).most_common(1)[0] if scenarios else ("", 0)
    if times > 1:
        raise UsageError(f"{name} occurs twice in the study", cure="remove one of the two")
    work = tasks(scenarios, seed, block, folder)
    left, replaced = _not_whole(work)
    total = sum(task.identifications for task in work)
    done = total - sum(task.identifications for task in left)
    if progress is not None:
        progress(done, total)
    memory: dict[tuple[str, int], Block] = {}
    places = {(task.scenario.key, task.index): task for task in left}
    for finished in mapper(run_task, [replace(task, file=None) for task in left] if remote else left):
        if finished.block is not None and folder is not None:
            _write(places[finished.key, finished.index], finished.block)
        elif finished.block is not None:
            memory[finished.key, finished.index] = finished.block
        done += finished.identifications
        if progress is not None:
            progress(done, total)
    return Results(tuple(scenarios), seed, block, folder, memory, replaced)
