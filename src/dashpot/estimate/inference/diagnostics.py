"""What in the data or in the rig file is probably a slip: told beside the estimate, never acted upon."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.model.network import Model
from dashpot.notices import Notice

APART = 4.0  # standard deviations beyond which two statements contradict each other
# Share of a prior's variance in the posterior beyond which the data say too little to contradict it.
MOST_TOLD = 0.95
SILENT = 1e-12  # of the largest amplitude of the same quantity: rounding


def dead_channels(model: Model, spectrum: Spectrum) -> list[str]:
    """Channels of a moving point that show nothing at any line, though others of their quantity do."""
    size = np.nan_to_num(np.abs(spectrum.amplitudes)).max(axis=tuple(range(spectrum.amplitudes.ndim - 1)))
    found = []
    for channel, largest in zip(spectrum.channels, size, strict=True):
        alike = [other.quantity is channel.quantity for other in spectrum.channels]
        moves = channel.quantity is not Quantity.FORCE and not set(channel.of).isdisjoint(model.coordinates)
        if moves and largest <= SILENT * np.max(size[alike]):
            found.append(channel.name)
    return found


def duplicated_lines(spectrum: Spectrum) -> list[Notice]:
    """A warning of lines whose noisy amplitudes are those of another line to the last digit."""
    if not np.any(spectrum.covariance):
        return []
    Y = np.moveaxis(np.nan_to_num(spectrum.amplitudes), -2, 0).reshape(spectrum.lines, -1)
    rows = np.concatenate([np.asarray(spectrum.omega)[:, None], Y.real, Y.imag], axis=1)
    rows = rows[np.any(Y != 0, axis=1)]
    more = len(rows) - len(np.unique(rows, axis=0))
    if not more:
        return []
    text = (
        f"{more} of {spectrum.lines} lines repeat another line to the last digit and are counted as independent "
        "measurements; if the same data were given twice, the intervals are too small"
    )
    return [Notice("duplicated_lines", text)]


def prior_conflict(model: Model, theta: Real, noise_covariance: Real) -> list[Notice]:
    """Warnings of parameters stated with an sd that the data, left alone, put elsewhere; θ counts the statement.

    An efficient estimate θ and the statement μ ± s it has used differ by s² − var θ in variance where both are right.
    """
    notices = []
    for j in np.flatnonzero(model.prior_precision):
        stated, variance = 1 / model.prior_precision[j], noise_covariance[j, j]
        own = max(stated - variance, (1 - MOST_TOLD) * stated)
        apart = abs(theta[j] - model.prior_mean[j]) / np.sqrt(own)
        if not apart > APART:
            continue
        alone = (theta[j] - model.prior_mean[j] * variance / stated) / (1 - min(variance / stated, MOST_TOLD))
        name, unit = model.unknowns[j].name, model.unknowns[j].unit
        text = (
            f"{name} is stated as {model.prior_mean[j]:.4g} ± {np.sqrt(stated):.2g} {unit}, but the data alone give "
            f"{alone:.4g}, {apart:.2g} standard deviations away: the statement, the data or the model is wrong"
        )
        notices.append(Notice("prior_conflict", text, (name,)))
    return notices


def reversed_phase(model: Model, theta: Real, noise_covariance: Real) -> list[Notice]:
    """A hint where every damper comes out negative beyond doubt: phases that count the other way do that."""
    dissipative = {element.name for element in model.elements if element.law.dissipative}
    dampers = [j for j, unknown in enumerate(model.unknowns) if unknown.name in dissipative]
    if not dampers or np.any(theta[dampers] > -APART * np.sqrt(np.diagonal(noise_covariance)[dampers])):
        return []
    text = (
        "all unknown dampers are negative: the phases may have the opposite sign; dashpot reads amplitudes as "
        "x(t) = Re(X e^{jωt}), for data of the other convention change the sign of the imaginary parts"
    )
    return [Notice("reversed_phase", text, tuple(model.unknowns[j].name for j in dampers))]
