"""Cross-talk: a part of one channel's signal that another shows as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Real
from dashpot.check.diagnosis.search import Workbench
from dashpot.check.diagnosis.trials import Outcome, Trial

LEAST, MOST = 1e-4, 1.0  # shares of the other channel's rms over its own: what is looked for
FOLLOWED = 2  # pairs whose share is found closely
STEP = 0.2  # of a share, to both sides of it


def cross_talk(
    bench: Workbench, base: Trial, without_one: Sequence[Outcome], pool: Sequence[Real]
) -> list[Outcome]:
    """Trials with a part of one channel taken out of another, each fitted; `without_one`: fits without each channel."""
    trials = []
    for c, outcome in enumerate(without_one):
        away = np.where(base.kept[:, c], base.y[:, c] - bench.expected(outcome)[:, c], 0.0)
        variance = base.V[:, c, c].real
        weight = 1 / variance if np.all(variance > 0) else np.ones(len(variance))
        power = weight @ np.abs(base.y) ** 2
        shared = weight @ (np.conj(base.y) * away[:, None]).real
        for other in np.flatnonzero(power > 0).tolist():
            share = float(shared[other] / power[other])
            # With no power of its own a channel is left out, and has no share of another to be rid of.
            relative = abs(share) * np.sqrt(power[other] / power[c]) if power[c] > 0 else np.inf
            if other != c and LEAST < relative < MOST:
                trials.append(_cleared(bench, base, c, other, share))
    outcomes = bench.refitted(trials, pool)
    best = sorted(outcomes, key=lambda outcome: outcome.reduced)[:FOLLOWED]
    return [_closer(bench, base, outcome) for outcome in best]


def _closer(bench: Workbench, base: Trial, outcome: Outcome) -> Outcome:
    """The share at the vertex of the parabola through χ² at three of them; the outcome's where that is not lower."""
    names = [channel.name for channel in bench.view.channels]
    c, other = (names.index(name) for name in outcome.trial.of)
    share, step = outcome.trial.value, STEP * outcome.trial.value
    beside = [_cleared(bench, base, c, other, share + side * step) for side in (-1, 1)]
    low, high = (end.chi2 for end in bench.refitted(beside, [outcome.psi]))
    bend = low - 2 * outcome.chi2 + high
    if not (np.isfinite(bend) and bend > 0):
        return outcome
    nearer = _cleared(bench, base, c, other, share + 0.5 * step * (low - high) / bend)
    (end,) = bench.refitted([nearer], [outcome.psi])
    return min(outcome, end, key=lambda one: one.chi2)


def _cleared(bench: Workbench, base: Trial, c: int, other: int, share: float) -> Trial:
    """Channel `c` without `share` times another."""
    mixing = np.eye(base.y.shape[1])
    mixing[c, other] = -share
    names = [channel.name for channel in bench.view.channels]
    of = (names[c], names[other])
    # The other's noise, times a small share, is left out.
    return replace(base, kind="crosstalk", of=of, value=share, y=base.y @ mixing.T)
