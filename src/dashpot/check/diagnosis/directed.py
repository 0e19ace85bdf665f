"""Tests of a fit that point at one thing: the gain or delay of a channel, an element between two points (THEORY §11).

χ² spreads what it finds over all amplitudes; a score test looks along one column, projected out of what the rig's own
unknowns can do, and finds a tenth of the misfit that χ² needs.  All columns come from one evaluation of the likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from dashpot.check.diagnosis.open_calibrations import as_stated, with_open_calibrations
from dashpot.check.diagnosis.ranking import Cause
from dashpot.check.diagnosis.rig_changes import missing_elements
from dashpot.check.diagnosis.score_test import Promise, promises
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import SettledDwell
from dashpot.errors import DashpotError
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.elements import Element
from dashpot.model.network import Model

LEVEL = 1e-3  # of all directions together: one clean test in a thousand
APART = 0.03  # part of a column that the rig's own unknowns must leave
LARGEST = 12  # coordinates
MOST_AMPLITUDES = 20_000
MOST = 3  # causes that are named


def directed_causes(model: Model, spectrum: Spectrum, estimate: Estimate) -> list[Cause]:
    """What of a fit that χ² passes is off beyond doubt, the clearest first; [] where nothing is, or no noise is known.

    Each direction is tested by itself beside the rig's unknowns, at LEVEL over their number.
    """
    settled = all(isinstance(stretch, SettledDwell) for stretch in spectrum.stretches)
    small = model.n <= LARGEST and spectrum.amplitudes.size <= MOST_AMPLITUDES
    able = settled and small and not len(model.nonlinear) and estimate.fit.known_noise
    if not able or not bool(estimate.converged) or estimate.fit.dof < 1:
        return []
    elements = missing_elements(model)
    extended = replace(model, elements=(*model.elements, *elements))
    channels, exact_inputs = with_open_calibrations(model, spectrum)
    try:
        data = prepare(extended, replace(spectrum, channels=channels, moments=None), states=False)
        exact = measured(data)
    except DashpotError:
        return []  # channels that contradict each other, say
    view = data.view
    known = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    (sign,) = spectrum.signs(estimate.signs)
    added = set(view.names) - known.keys()
    # An input without noise is late where all that it moves is early.
    together = {
        f"{exact_inputs[0]}.{word}": [name for name in added if name.endswith(f".{word}")]
        for word in ("gain", "delay")
        if len(exact_inputs) == 1
    }
    # Where the noise was estimated, χ² scatters as much more as the intervals are wider.
    with np.errstate(invalid="ignore", divide="ignore"):
        widened = float(np.nanmax(np.append((estimate.noise_sd / estimate.bound_sd) ** 2, 1.0)))
    tested = promises(view, exact, as_stated(view.names, known), sign, added, APART, together)
    certain = [
        promise for promise in tested if float(chdtrc(1, promise.fall / widened)) * len(tested) < LEVEL
    ]
    certain.sort(key=lambda promise: -promise.fall)
    return [_cause(promise, promise.name in together, estimate, elements) for promise in certain[:MOST]]


def _cause(promise: Promise, opposite: bool, estimate: Estimate, elements: Sequence[Element]) -> Cause:
    """The cause that a direction stands for, and χ² per degree of freedom with it."""
    name, step = promise.name, -promise.step if opposite else promise.step
    remaining = (promise.chi2 - promise.fall) / max(estimate.fit.dof - 1, 1)
    channel, _, calibration = name.rpartition(".")
    if channel and calibration == "gain":
        return Cause("gain", (channel,), remaining, 1.0 + step)
    if channel and calibration == "delay":
        return Cause("delay", (channel,), remaining, step)
    element = next(candidate for candidate in elements if candidate.name == name)
    points = tuple(element.along)
    return Cause(
        "element", points if len(points) > 1 else (*points, "ground"), remaining, step, element=element
    )
