"""Which parameters are in doubt: intervals tell little of them, or the channels cannot determine them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.channel import Channel
from dashpot.check.identifiability import structure
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

MOST = 0.5  # half an interval over the value


def doubtful(estimate: Estimate, level: float = 0.95) -> tuple[str, ...]:
    """Names of the unknowns whose interval at `level` reaches further than half their value to a side.

    All of them where the iteration did not converge (no batch axes).
    """
    if not bool(estimate.converged):
        return estimate.names
    low, high = estimate.interval(level)
    half = np.maximum(high - estimate.values, estimate.values - low)
    with np.errstate(invalid="ignore"):
        good = half <= MOST * np.abs(estimate.values)
    return tuple(name for name, kept in zip(estimate.names, good.tolist(), strict=True) if not kept)


def undetermined(model: Model, channels: Sequence[Channel]) -> tuple[str, ...]:
    """Names of the unknowns that no data of these channels can determine.

    None where the rig has no steady response, or is nonlinear: ranks say nothing of those.
    """
    if not model.unknowns or not channels or len(model.nonlinear):
        return ()
    try:
        judged = structure(model, channels)
    except IdentifiabilityError:
        return ()
    return tuple(dict.fromkeys(name for part in judged.deficiencies for name in part.names))
