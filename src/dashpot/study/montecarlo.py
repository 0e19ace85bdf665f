"""Monte Carlo: many simulated tests, identified by several methods, in blocks that any map can share out.

A Scenario is one point of a study.  Its repeats are drawn in blocks of BLOCK; the random numbers of a block follow
from the study's seed, the scenario's own name and the number of the block alone, and blocks are put together in their
order.  So the result is the same to the bit whoever computes which block when, in one go or after an interruption.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Real, frozen
from dashpot.channel import Channel
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.preparation.state_reconstruction import unseen
from dashpot.estimate.registry import method
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.study.simulate import Dwells, NoiseBasis, clean_spectrum, simulate_spectrum
from dashpot.study.store import Label, State, read_block, state_of, write_block

BLOCK = 500  # repeats; part of what the seed means
LEVELS = (0.025, 0.25, 0.5, 0.75, 0.975)  # of the quantiles in a Summary
SAMPLE_LEVEL = frozenset({"ls", "iv"})  # methods that work on second moments of the samples


@dataclass(frozen=True)
class Scenario:
    """One point of a study: a rig with its true parameters, a test, its noise, and who identifies it.

    factors    what the point stands for, in order: {"rig": "paper", "noise": 0.1, …}; its text names the scenario
    theta      true unknowns, (unknowns,)
    noise      whether the methods are given the covariance of the noise or estimate it from residuals
    drift      degree of the trend solved for with the fundamental; None is none
    """

    factors: Mapping[str, str | float | int]
    model: Model
    theta: Real
    channels: tuple[Channel, ...]
    test: Dwells
    methods: tuple[str, ...]
    draws: int
    noise: NoiseBasis = "given"
    drift: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "factors", MappingProxyType(dict(self.factors)))
        object.__setattr__(self, "theta", frozen(self.theta, np.float64))
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "methods", tuple(self.methods))

    def __getstate__(self) -> dict[str, object]:
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return own | {"factors": dict(self.factors)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "factors", MappingProxyType(dict(self.factors)))

    @cached_property
    def name(self) -> str:
        """Its factors as text: "rig=paper noise=0.1"."""
        return " ".join(
            f"{key}={value:g}" if isinstance(value, float) else f"{key}={value}"
            for key, value in self.factors.items()
        )

    @cached_property
    def key(self) -> str:
        """Sixteen hexadecimal digits that depend on the factors alone: the name of its files and of its randomness."""
        return hashlib.sha256(json.dumps(dict(self.factors)).encode()).hexdigest()[:16]

    @cached_property
    def fingerprint(self) -> str:
        """A digest of all that the repeats depend on but the names, the seed, the methods and the number of draws.

        Every field counts, those that are still to come as well, but for the rig's name, and of the channels the name
        of the unit, whose scale counts, and the rate: the test says when samples are taken.
        """
        model = {name: value for name, value in _fields(self.model) if name != "name"}
        channels = [
            {name: value for name, value in _fields(one) if name not in ("unit", "rate")}
            for one in self.channels
        ]
        parts = (model, self.theta, channels, self.test, self.noise, self.drift)
        return hashlib.sha256(json.dumps(_canonical(parts)).encode()).hexdigest()

    @property
    def p(self) -> Real:
        """True parameters of all elements, (elements,)."""
        return self.model.parameters(self.theta)

    def bound_sd(self) -> Real:
        """Cramér-Rao bound at the truth, (unknowns,), for the true noise.

        Raises DashpotError where the test does not determine the unknowns.
        """
        clean = clean_spectrum(self.model, self.p, self.channels, self.test, drift=self.drift)
        way = "ml" if unseen(self.model, clean) else "oiv"
        return identify(self.model, clean, method(way)).bound_sd


def _fields(value: object) -> list[tuple[str, object]]:
    """Names and values of a dataclass's fields."""
    assert is_dataclass(value)
    return [(one.name, getattr(value, one.name)) for one in fields(value)]


def _canonical(value: object) -> object:
    """A value as JSON of which every bit counts and no order that means nothing: equal values give equal texts."""
    if isinstance(value, Enum):
        return _canonical(value.value)
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        return [str(array.dtype), list(array.shape), hashlib.sha256(array.tobytes()).hexdigest()]
    if is_dataclass(value):
        return {name: _canonical(own) for name, own in _fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _canonical(value[key]) for key in sorted(value)}
    if isinstance(value, frozenset | set):
        return [_canonical(own) for own in sorted(value)]
    if isinstance(value, tuple | list):
        return [_canonical(own) for own in value]
    if isinstance(value, float):
        return value.hex()
    if value is None or isinstance(value, str | int):
        return value
    raise TypeError(f"{type(value).__name__} has no canonical form")


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
        for name in ("values", "sd", "half", "p"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float64))
        object.__setattr__(self, "converged", frozen(self.converged, np.bool_))

    @property
    def good(self) -> Bools:
        """Repeats that gave an answer, (draws,)."""
        answered: Bools = self.converged & np.all(np.isfinite(self.values), axis=-1)
        return answered

    def errors(self, theta: Real) -> Real:
        """Relative errors in % of the repeats that gave an answer, (good draws, unknowns); of a true 0, the values."""
        size = np.where(theta == 0, 1.0, np.abs(theta) / 100)
        relative: Real = (self.values[self.good] - theta) / size
        return relative


Block = Mapping[str, Repeats]


def joined(parts: Sequence[Repeats]) -> Repeats:
    """All repeats of several blocks, in their order."""
    return Repeats(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("values", "sd", "half", "converged", "p")
        )
    )


# Blocks: what workers do


@dataclass(frozen=True)
class Task:
    """One block of one scenario; `file` is where it is kept, None where it is handed back."""

    scenario: Scenario
    index: int
    size: int
    seed: int
    file: str | None = None

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
            version("dashpot"),
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
    """Draw one block and identify it by all methods of its scenario.

    A function of the module, so that any process can be sent it.  Raises DashpotError that names the scenario.
    """
    scenario = task.scenario
    try:
        block = {name: _repeats(estimate) for name, estimate in estimates(task)}
    except DashpotError as error:
        first = error.problems[0]
        raise UsageError(first.what, f"{scenario.name}", first.cure) from error
    if task.file is None:
        return Done(scenario.key, task.index, task.identifications, block)
    write_block(Path(task.file), {name: _columns(one) for name, one in block.items()}, task.label)
    return Done(scenario.key, task.index, task.identifications)


def estimates(task: Task) -> Iterable[tuple[str, Estimate]]:
    """The block's Estimates, method by method, all of the same draws."""
    scenario = task.scenario
    spectrum = simulate_spectrum(
        scenario.model,
        scenario.p,
        scenario.channels,
        scenario.test,
        generator(task.seed, scenario.key, task.index),
        draws=task.size,
        noise=scenario.noise,
        moments=not SAMPLE_LEVEL.isdisjoint(scenario.methods),
        drift=scenario.drift,
    )
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
                block = {name: Repeats(**own) for name, own in columns.items()}
            for name in scenario.methods:
                parts[name].append(block[name])
        return {name: joined(own) for name, own in parts.items()}

    def summaries(self, scenario: Scenario) -> dict[str, Summary]:
        """Bias, spread, coverage and efficiency of each method."""
        bound = scenario.bound_sd()
        return {name: summarise(own, scenario.theta, bound) for name, own in self.repeats(scenario).items()}


def tasks(
    scenarios: Iterable[Scenario], seed: int, block: int = BLOCK, folder: Path | None = None
) -> list[Task]:
    """The blocks of the scenarios, in order; the last of each scenario may be smaller."""
    found = []
    for scenario in scenarios:
        for index, first in enumerate(range(0, scenario.draws, block)):
            file = None if folder is None else str(block_file(folder, scenario, index))
            found.append(Task(scenario, index, min(block, scenario.draws - first), seed, file))
    return found


def block_file(folder: Path, scenario: Scenario, index: int) -> Path:
    """Where a block is kept."""
    return folder / "draws" / scenario.key / f"{index:06d}.parquet"


Map = Callable[[Callable[[Task], Done], Iterable[Task]], Iterable[Done]]


def run(
    scenarios: Sequence[Scenario],
    seed: int,
    *,
    folder: Path | None = None,
    block: int = BLOCK,
    mapper: Map = map,
    progress: Callable[[int, int], None] | None = None,
) -> Results:
    """Compute all blocks that are not there yet, by any `mapper`; order and number of its workers do not matter.

    With a `folder` each block is written when it is done, whole or not at all, and what lies there is not computed
    again (the caller sees to it that it is the same study's).  `progress(done, all)` counts identifications.

    Raises UsageError where two scenarios have the same factors, or where a method cannot do what is asked.
    """
    names = [scenario.name for scenario in scenarios]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise UsageError(f"{twice} occurs twice in the study", cure="remove one of the two")
    work = tasks(scenarios, seed, block, folder)
    total = sum(task.identifications for task in work)
    states = [
        (task, "absent" if task.file is None else state_of(Path(task.file), task.label)) for task in work
    ]
    left = [task for task, state in states if state != "whole"]
    replaced: Counter[State] = Counter(state for _, state in states if state in ("damaged", "outdated"))
    done = total - sum(task.identifications for task in left)
    for parent in {Path(task.file).parent for task in left if task.file is not None}:
        parent.mkdir(parents=True, exist_ok=True)
    if progress is not None:
        progress(done, total)
    memory: dict[tuple[str, int], Block] = {}
    for finished in mapper(run_task, left):
        if finished.block is not None:
            memory[finished.key, finished.index] = finished.block
        done += finished.identifications
        if progress is not None:
            progress(done, total)
    return Results(tuple(scenarios), seed, block, folder, memory, replaced)


# What the repeats say


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
    def rms_spread(self) -> float:
        """Root mean square of the spreads over the unknowns, %."""
        return float(np.sqrt(np.mean(self.spread**2)))

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
