"""Plain mistakes of channels in settled dwells of nonlinear rigs, by the equation of motion where all motion is seen.

A rig with laws of its own takes seconds to fit, and a wrong one minutes: each mistake is tried on the regression of the
measured harmonics (Yasuda and Watanabe's, THEORY §9), which takes milliseconds, and the best are fitted in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from dashpot.check.diagnosis.ranking import Cause, ranked
from dashpot.check.diagnosis.trials import Trial, mistakes_of_a_channel, prepared, swapped, untouched
from dashpot.errors import DashpotError
from dashpot.estimate.identify import identify
from dashpot.estimate.nonlinear.starting_values import harmonics_left
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import states_if_seen

PROMISED = 0.3  # of what the equation leaves as it is: as much as it may leave with a mistake put right
MENDED = 0.1  # of the misfit: as much as a mistake may leave
FOLLOWED = 3  # mistakes that are fitted in full


def mistakes_by_equation(data: Prepared, misfit: float) -> list[Cause]:
    """What a channel may show in the place of what is stated, the best first; data of one repeat, all motion seen.

    misfit: χ² over its degrees of freedom as it is; ∞ where there is no fit.
    """
    base = untouched(data)
    trials = _trials(data, base)
    left = np.array([_left(data, trial) for trial in trials])
    mending = np.flatnonzero(left < PROMISED * _left(data, base))
    causes = []
    for k in mending[np.argsort(left[mending])][:FOLLOWED].tolist():
        trial = trials[k]
        mended = replace(
            data.spectrum, amplitudes=np.where(trial.kept, trial.y, np.nan), covariance=trial.V, moments=None
        )
        try:
            fitted = identify(data.model, mended, "ml")
        except DashpotError:
            continue
        remaining = float(fitted.fit.misfit) ** 2
        if remaining < MENDED * misfit:
            causes.append(Cause(trial.kind, trial.of, remaining, trial.value))
    return ranked(causes, misfit)


def _trials(data: Prepared, base: Trial) -> Sequence[Trial]:
    """Each channel with its sign or its phases turned, in another unit, as another derivative, or for another."""
    channels = data.spectrum.channels
    trials = [
        trial
        for c, channel in enumerate(channels)
        for trial in mistakes_of_a_channel(base, channel, c, data.view.omega)
    ]
    for first, second in combinations(range(len(channels)), 2):
        names = channels[first].name, channels[second].name
        trials.append(swapped(base, names, first, second))
    return trials


def _left(data: Prepared, trial: Trial) -> float:
    """Share of the known forces that the equation of motion leaves; ∞ where there is no regression."""
    supposed = prepared(data, trial)
    states = states_if_seen(supposed.view, supposed.spectrum, supposed.covariance)
    try:
        return np.inf if states is None else harmonics_left(replace(supposed, states=states))
    except DashpotError:
        return np.inf
