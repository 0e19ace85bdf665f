"""Which sensors to mount: the best few of those that could be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from dashpot.arrays import Real
from dashpot.design.allocation import optimise
from dashpot.design.criteria import Criterion, Robustness
from dashpot.design.frequency_grid import FrequencyGrid
from dashpot.design.test_setup import TestSetup
from dashpot.errors import IdentifiabilityError, UsageError
from dashpot.model.observation import measures_input

EXACT = 300  # sets that are all tried
COARSE = 60  # points of the grid on which sets are ranked

Sensors = tuple[str, ...]  # names of channels


@dataclass(frozen=True)
class Choice:
    """Sets of sensors in order of merit: names and the criterion's figure at the best test with them.

    `complete` says whether all sets were tried; else a greedy choice was improved by exchanges.
    """

    ranking: tuple[tuple[tuple[str, ...], float], ...]
    complete: bool

    @property
    def best(self) -> tuple[str, ...]:
        """Names of the best set."""
        return self.ranking[0][0]


def choose(
    setup: TestSetup,
    criterion: Criterion,
    samples: float,
    grid: FrequencyGrid,
    count: int,
    among: Sequence[str] = (),
    *,
    known: Real | None = None,
    robustness: Robustness = "worst",
) -> Choice:
    """The best `count` of the channels `among` (by default all that see more than inputs); the others stay.

    Raises UsageError for names that are no channels, IdentifiabilityError where no set determines the unknowns.
    """
    pool = _pool(setup, count, among, after_data=known is not None)
    step = max(1, len(grid.frequency_hz) // COARSE)
    coarse = FrequencyGrid(grid.frequency_hz[::step], grid.pattern[::step], free=False)
    figures: dict[Sensors, float] = {}

    def figure(chosen: Sensors, grid: FrequencyGrid) -> float:
        kept = [c for c in setup.channels if c.name not in pool or c.name in chosen]
        try:
            chosen_setup = setup.with_channels(kept)
            prior = chosen_setup.prior if known is None else known
            terms = criterion.terms(chosen_setup, robustness)
            return criterion.figure(optimise(chosen_setup.information, terms, prior, samples, grid).F)
        except (IdentifiabilityError, UsageError):
            return np.inf

    def score(chosen: Sensors) -> float:
        if chosen not in figures:
            figures[chosen] = figure(chosen, coarse)
        return figures[chosen]

    complete = comb(len(pool), count) <= EXACT
    if complete:
        for chosen in combinations(pool, count):
            score(chosen)
    else:
        _exchange(pool, count, score)
    sets = sorted((chosen for chosen in figures if len(chosen) == count), key=figures.__getitem__)
    figures |= {chosen: figure(chosen, grid) for chosen in sets[:3]}
    ranking = sorted(((c, figures[c]) for c in sets if np.isfinite(figures[c])), key=lambda entry: entry[1])
    if not ranking or not np.isfinite(ranking[0][1]):
        raise IdentifiabilityError(
            f"no {count} of these sensors determine the unknowns",
            cure="mount more, or give a parameter its value",
        )
    return Choice(tuple(ranking), complete)


def _pool(setup: TestSetup, count: int, among: Sequence[str], after_data: bool) -> list[str]:
    """Names of the sensors to choose from."""
    names = [channel.name for channel in setup.channels]
    pool = list(among) if among else [c.name for c in setup.channels if not measures_input(setup.model, c)]
    for name in pool:
        if name not in names:
            raise UsageError(f"the rig has no channel {name}", cure=f"it has {', '.join(names)}")
    if not 0 < count <= len(pool):
        raise UsageError(f"{count} of {len(pool)} sensors", cure=f"pick between 1 and {len(pool)}")
    if after_data and len(setup.names) > len(setup.model.unknowns):
        raise UsageError(
            "sensors with unknown calibrations cannot be chosen after data", cure="calibrate them"
        )
    return pool


def _exchange(pool: Sequence[str], count: int, score: Callable[[Sensors], float]) -> None:
    """Leave out the least useful sensor until `count` are left, then exchange one by one while that helps."""
    order = {name: i for i, name in enumerate(pool)}

    def figure(names: set[str]) -> float:
        return score(tuple(sorted(names, key=order.__getitem__)))

    chosen = set(pool)
    while len(chosen) > count:
        chosen = min((chosen - {name} for name in chosen), key=figure)
    lowest = figure(chosen)
    for _ in range(10):
        swaps = [(chosen - {a}) | {b} for a in chosen for b in set(pool) - chosen]
        best = min(swaps, key=figure)
        if figure(best) >= lowest * (1 - 1e-9):
            return
        chosen, lowest = best, figure(best)
