"""Everything that stands beside an estimate, in the order in which it is told."""

from __future__ import annotations

from functools import partial

import numpy as np

from dashpot.data.spectrum import Spectrum
from dashpot.estimate.inference import diagnostics, record_findings
from dashpot.estimate.inference.flat_valley import require_end
from dashpot.estimate.inference.uncertainty import Inference
from dashpot.estimate.inference.unseen_laws import require_traces, unseen_laws
from dashpot.estimate.result import Fit
from dashpot.model.network import Model
from dashpot.notices import Notice


def notices(model: Model, spectrum: Spectrum, single: Inference | None, fit: Fit) -> list[Notice]:
    """What an estimate without batch axes shows of itself (None: there are several), and what the data show.

    Raises IdentifiabilityError where the data do not determine a single estimate.
    """
    of_estimate = [] if single is None else _of_estimate(model, spectrum, single, fit)
    return of_estimate + diagnostics.of_data(model, spectrum)


def _of_estimate(model: Model, spectrum: Spectrum, part: Inference, fit: Fit) -> list[Notice]:
    names, bands, bounds = part.names, part.uncertainty.bands, part.solution.bounds
    theta, covariance, noise = (
        part.solution.theta[0],
        part.uncertainty.covariance[0],
        part.uncertainty.noise[0],
    )
    dead = partial(diagnostics.dead_channels, model, spectrum)
    few = partial(record_findings.few_lines, model, spectrum)
    traces = partial(require_traces, model, names, part.information[0])
    diagnostics.require_determined(names, theta, noise, dead, few, traces)
    # What runs off because the rig or a channel is another one has a cause, which an estimate must be there to show.
    sound = not fit.rejected.any() and not np.any(
        theta[: len(model.unknowns)][diagnostics.of_one_sign(model)] < 0
    )
    if part.valley is not None and not bool(part.solution.converged[0]) and sound:
        require_end(part.valley, names, part.units, theta)
    shown = []
    if fit.known_noise and not part.method.traits.maximum_likelihood:
        shown += diagnostics.bias(names, theta, part.most_likely[0], covariance, part.method)
    shown += [] if bands is None else bands.notices(names)
    in_time = part.uncertainty.in_time
    shown += [] if in_time is None else [uneven.notice() for uneven in in_time.uneven if uneven is not None]
    shown += diagnostics.of_estimate(model, theta, covariance, noise, fit)
    shown += unseen_laws(model, theta, noise)
    if part.method.traits.maximum_likelihood:
        shown += diagnostics.prior_conflict(model, theta, noise)
    shown += record_findings.of_records(model, theta, noise, spectrum)
    return shown if bounds is None else shown + diagnostics.held(names, theta, bounds)
