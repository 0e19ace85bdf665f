"""Whether a rig as a trial's fit has it can be built: parts that are negative beyond doubt cannot."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Bools
from dashpot.check.diagnosis.search import Workbench
from dashpot.check.diagnosis.trials import Outcome, prepared
from dashpot.check.verdict import BEYOND
from dashpot.estimate.inference.diagnostics import of_one_sign
from dashpot.estimate.likelihood.objective import local, measured


def negative_parts(bench: Workbench, outcome: Outcome) -> Bools:
    """Parts of the rig that are negative beyond doubt where a trial ended, (unknowns,).

    Where the noise is not known, or the trial leaves more than noise, deviations are as large as the residuals say.
    """
    model, data = bench.data.model, prepared(bench.data, outcome.trial)
    with np.errstate(all="ignore"):
        at = local(bench.view, measured(data), outcome.psi[None], bench.sign[None])
        sd = np.sqrt(np.diagonal(at.inverse[0]))[: bench.view.m]
    scale = outcome.reduced**0.5
    if bench.data.noise_known:
        scale = max(1.0, scale)
    negative: Bools = (outcome.psi[: bench.view.m] < -BEYOND * scale * sd) & of_one_sign(model)
    return negative
