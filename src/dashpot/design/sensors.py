"""Which sensors to mount: the best few of those that could be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from dashpot.arrays import Real
from dashpot.design.allocation import Grid, optimise
from dashpot.design.criteria import Doubt, Goal
from dashpot.design.test_setup import Bench
from dashpot.errors import IdentifiabilityError, UsageError
from dashpot.model.observation import measures_input

EXACT = 300  # sets that are all tried
COARSE = 60  # points of the grid on which sets are ranked


@dataclass(frozen=True)
class Choice:
    """Sets of sensors in order of merit: names and the goal's figure at the best test with them.

    `complete` says whether all sets were tried; else a greedy choice was improved by exchanges.
    """

    ranking: tuple[tuple[tuple[str, ...], float], ...]
    complete: bool

    @property
    def best(self) -> tuple[str, ...]:
        """Names of the best set."""
        return self.ranking[0][0]


def choose(
    bench: Bench,
    goal: Goal,
    samples: float,
    grid: Grid,
    count: int,
    among: Sequence[str] = (),
    *,
    known: Real | None = None,
    doubt: Doubt = "worst",
) -> Choice:
    """The best `count` of the channels `among` (by default all that see more than inputs); the others stay.

    Raises UsageError for names that are no channels, IdentifiabilityError where no set determines the unknowns.
    """
    names = [channel.name for channel in bench.channels]
    pool = list(among) if among else [c.name for c in bench.channels if not measures_input(bench.model, c)]
    for name in pool:
        if name not in names:
            raise UsageError(f"{name} is no channel of this rig", cure=f"it has {', '.join(names)}")
    if not 0 < count <= len(pool):
        raise UsageError(f"{count} of {len(pool)} sensors", cure=f"pick between 1 and {len(pool)}")
    if bench.names[len(bench.model.unknowns) :] and known is not None:
        raise UsageError(
            "sensors with unknown calibrations cannot be chosen after data", cure="calibrate them"
        )
    step = max(1, len(grid.frequency_hz) // COARSE)
    few = Grid(grid.frequency_hz[::step], grid.pattern[::step], free=False)
    tried: dict[tuple[str, ...], float] = {}

    def figure(chosen: tuple[str, ...], where: Grid) -> float:
        kept = [c for c in bench.channels if c.name not in pool or c.name in chosen]
        try:
            own = bench.with_channels(kept)
            prior = own.prior if known is None else known
            return goal.figure(optimise(own.information, goal.terms(own, doubt), prior, samples, where).F)
        except (IdentifiabilityError, UsageError):
            return np.inf

    def score(chosen: tuple[str, ...]) -> float:
        if chosen not in tried:
            tried[chosen] = figure(chosen, few)
        return tried[chosen]

    complete = comb(len(pool), count) <= EXACT
    if complete:
        for chosen in combinations(pool, count):
            score(chosen)
    else:
        _exchange(pool, count, score)
    order = sorted(tried, key=lambda chosen: tried[chosen])
    sized = [chosen for chosen in order if len(chosen) == count]
    finals = {chosen: figure(chosen, grid) for chosen in sized[:3]}
    ranking = [(c, finals.get(c, tried[c])) for c in sized if np.isfinite(tried[c])]
    ranking.sort(key=lambda entry: entry[1])
    if not ranking or not np.isfinite(ranking[0][1]):
        raise IdentifiabilityError(
            f"no {count} of these sensors determine the unknowns",
            cure="mount more, or give a parameter its value",
        )
    return Choice(tuple(ranking), complete)


def _exchange(pool: Sequence[str], count: int, score: object) -> None:
    """Leave out the least useful sensor until `count` are left, then exchange one by one while that helps."""
    assert callable(score)
    order = {name: i for i, name in enumerate(pool)}

    def sort(names: set[str]) -> tuple[str, ...]:
        return tuple(sorted(names, key=order.__getitem__))

    chosen = set(pool)
    while len(chosen) > count:
        chosen = min((chosen - {name} for name in chosen), key=lambda c: float(score(sort(c))))
    now = float(score(sort(chosen)))
    for _ in range(10):
        swaps = [(chosen - {a}) | {b} for a in chosen for b in set(pool) - chosen]
        best = min(swaps, key=lambda c: float(score(sort(c))))
        if float(score(sort(best))) >= now * (1 - 1e-9):
            return
        chosen, now = best, float(score(sort(best)))
