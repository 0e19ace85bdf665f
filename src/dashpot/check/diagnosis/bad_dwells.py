"""One dwell that is wrong: of another frequency, exchanged with another, with its phases the other way, or left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.check.diagnosis.ranking import ALIKE, HELPS, Cause, cause_of
from dashpot.check.diagnosis.search import Workbench
from dashpot.check.diagnosis.trials import Outcome, Trial, cells, conjugated_line, exchanged_lines, without

MOST_DWELLS = 40
RELABELLED = 6.0  # χ² for each number of a dwell below which it belongs to another frequency


def bad_dwells(bench: Workbench, base: Trial, pool: Sequence[Real]) -> list[Cause]:
    """Each dwell left out; of the one that helps most, what else may be wrong with it.

    None where the lines are those of a record, not of dwells.
    """
    lines = len(base.y)
    if not bench.lines_are_runs or lines <= 3:
        return []
    worst = np.argsort(-np.min([bench.misfit(psi, base) for psi in pool], axis=0))[:MOST_DWELLS]
    chosen = sorted(worst.tolist())
    labels = [f"{frequency:g} Hz" for frequency in bench.data.spectrum.frequency_hz]
    trials = [without(base, "dwell", (labels[line],), cells(base.kept, line=line)) for line in chosen]
    outcomes = bench.refitted(trials, pool)
    best = int(np.argmin([outcome.reduced for outcome in outcomes]))
    line, without_it = chosen[best], outcomes[best]
    causes_found = [cause_of(outcome) for outcome in outcomes]
    # The harmonics of a nonlinear rig go with the frequency of their dwell.
    if not len(bench.data.model.nonlinear):
        number, left = bench.other_frequency(without_it.psi, base, line)
        if left < RELABELLED * base.y.shape[1] * 2:
            causes_found.append(Cause("frequency", without_it.trial.of, without_it.reduced, number))
        causes_found += _exchanged(bench, base, line, labels, without_it, pool)
    return [*causes_found, *_conjugated(bench, base, line, without_it)]


def _exchanged(
    bench: Workbench, base: Trial, line: int, labels: Sequence[str], without_it: Outcome, pool: Sequence[Real]
) -> list[Cause]:
    """The labels of the dwell and of another one exchanged, where that explains more than leaving the one out."""
    others = [k for k in range(len(labels)) if labels[k] != labels[line]]
    trials = [
        exchanged_lines(base, "frequency", tuple(labels[i] for i in sorted((k, line))), k, line)
        for k in others
    ]
    best = min(bench.refitted(trials, [*pool, without_it.psi]), key=lambda outcome: outcome.reduced)
    return [replace(cause_of(best), number=None)] if best.reduced < HELPS * without_it.reduced else []


def _conjugated(bench: Workbench, base: Trial, line: int, without_it: Outcome) -> list[Cause]:
    """The dwell with all phases the other way, where that explains as much as leaving it out."""
    turned = conjugated_line(base, "conjugate", without_it.trial.of, line)
    (end,) = bench.refitted([turned], [without_it.psi])
    return [cause_of(end)] if end.reduced < ALIKE * max(without_it.reduced, 1.0) else []
