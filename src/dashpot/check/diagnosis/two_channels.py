"""Two channels that are wrong at once, each with another sign or in another unit: neither mends the fit alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

from dashpot.arrays import Real
from dashpot.check.diagnosis.ranking import Cause
from dashpot.check.diagnosis.search import Workbench
from dashpot.check.diagnosis.trials import Trial, scaled
from dashpot.model.observation import measures_input

FACTORS = (-1.0, 1e3, 1e-3, 9.80665, 1 / 9.80665, 2**0.5, 0.5**0.5)  # that a channel reads
MOST_CHANNELS = 8


def two_channels(bench: Workbench, base: Trial, pool: Sequence[Real], most: float) -> list[Cause]:
    """The best two, where all motion is seen: each trial has then a start of its own; [] elsewhere.

    most: χ² per degree of freedom that they may leave, for two of so many explain a part of anything.
    Motions are blamed before inputs: with all signs turned the fit is the same.
    """
    model, channels = bench.data.model, bench.view.channels
    if bench.data.states is None or len(channels) > MOST_CHANNELS:
        return []
    order = sorted(range(len(channels)), key=lambda c: measures_input(model, channels[c]))
    trials, members = [], []
    for pair in combinations(order, 2):
        for factors in product(FACTORS, repeat=2):
            trial, both = base, []
            for c, factor in zip(pair, factors, strict=True):
                kind = "sign" if factor < 0 else "unit"
                trial = scaled(trial, kind, channels[c].name, c, 1 / factor, factor)
                both.append((kind, channels[c].name, factor))
            trials.append(trial)
            members.append(both)
    outcomes = bench.refitted(trials, pool)
    best = min(range(len(outcomes)), key=lambda k: round(outcomes[k].reduced, 6))
    left = outcomes[best].reduced
    parts = tuple(Cause(kind, (name,), left, factor) for kind, name, factor in members[best])
    if not left < most:
        return []
    return [Cause("two", tuple(name for part in parts for name in part.of), left, parts=parts)]
