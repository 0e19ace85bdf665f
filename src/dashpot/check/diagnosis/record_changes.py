"""Another linear rig as the cause of a misfit of whole records: fitted to all of their lines, with loads of the ends.

Lines without transients (`steady_lines`) are good to a few per cent, which hides a value that is wrong by as little and
leaves of a larger one more than it should.  Few candidates need a fit: their scores tell which.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.check.diagnosis.ranking import HELPS, Cause, points_of
from dashpot.check.diagnosis.rig_changes import changes
from dashpot.check.diagnosis.search import LONG, Workbench, descended
from dashpot.check.diagnosis.steady_lines import working_noise
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.likelihood.record_noise import RESIDUAL
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

MOST_AMPLITUDES = 30_000  # complex numbers of all channels: more take seconds
NAMED = 3
QUIETEST = 1.3  # χ² per degree of freedom that noise leaves if it is taken to be as low as where it is lowest


@dataclass(frozen=True)
class RigChanges:
    """Rigs with one linear part otherwise, the best first, and χ² per degree of freedom of the rig as it is.

    noise: χ² per degree of freedom that noise alone leaves.
    """

    as_is: float = np.inf
    causes: tuple[Cause, ...] = ()
    noise: float = 1.0

    @property
    def left(self) -> float:
        """The part of what noise does not explain that the best of them leaves, 1 where there is none."""
        if not self.causes or self.as_is <= self.noise:
            return 1.0
        return max(self.causes[0].remaining - self.noise, 0.0) / (self.as_is - self.noise)


def with_quiet_noise(spectrum: Spectrum) -> tuple[Spectrum, float]:
    """The spectrum of whole records for trials, and χ² per degree of freedom that noise alone leaves there.

    Noise that was read from the residuals of this very rig is taken to be as low as where it is lowest.
    """
    if RESIDUAL not in spectrum.noise:
        return spectrum, 1.0
    variance = working_noise(spectrum)[:, :, None] * np.eye(len(spectrum.channels))
    return replace(spectrum, covariance=variance.astype(np.complex128)), QUIETEST


def record_changes(model: Model, spectrum: Spectrum, estimate: Estimate | None) -> RigChanges:
    """What a missing linear element, or a stated value that is wrong, explains of whole records."""
    if (
        estimate is None
        or not np.all(np.isfinite(estimate.values))
        or spectrum.amplitudes.size > MOST_AMPLITUDES
    ):
        return RigChanges()
    quiet, noise = with_quiet_noise(spectrum)
    try:
        data = prepare(model, quiet, states=False)
    except DashpotError:
        return RigChanges()
    sign, exact = quiet.signs(estimate.signs), measured(data)
    row = np.zeros(1, dtype=np.int64)
    ends, chi2 = descended(data.view, exact, estimate.values[None], sign, row, LONG)
    as_is = float(chi2[0]) / max(exact.rows - len(ends[0]), 1)
    if not np.isfinite(as_is):
        return RigChanges()
    tried = [
        Cause(each.kind, points_of(each.element, model), each.reduced, each.number, element=each.element)
        for each in changes(Workbench(data, ends[0], sign[0]), ends[0], NAMED)
        if each.reduced - noise < HELPS * (as_is - noise)
    ]
    return RigChanges(as_is, tuple(sorted(tried, key=lambda cause: cause.remaining)[:NAMED]), noise)
