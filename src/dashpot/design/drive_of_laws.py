"""At which drive the nonlinear elements of a rig show in a planned test."""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Real
from dashpot.design.schedule import Schedule
from dashpot.design.test_setup import TestSetup, drive_units
from dashpot.numerics.small_systems import scaled_inverse

SHARES = np.geomspace(0.01, 1.0, 17)  # of the planned drive
CLEAR = 3.0  # standard deviations at which a law shows


def drives_that_show(setup: TestSetup, schedule: Schedule, known: Real) -> list[str]:
    """A sentence for each nonlinear element: from which share of the planned drive its parameter is clear of zero.

    known (scenarios, q, q): what is known before the test, in parts of the sizes.
    """
    model, names = setup.model, setup.names
    planned = setup.drive(schedule.frequency_hz, schedule.pattern)
    clear = np.zeros((len(SHARES), len(names)), dtype=bool)
    for row, share in enumerate(SHARES):
        each = setup.per_sample(schedule.frequency_hz, share * planned)
        M = known[0] + np.einsum("i,iab->ab", schedule.samples, each[0])
        with np.errstate(all="ignore"):
            relative = np.sqrt(np.diagonal(scaled_inverse(M)))
        clear[row] = CLEAR * relative < 1
    sentences = []
    unit = "/".join(dict.fromkeys(drive_units(model).values()))
    size = float(np.max(np.abs(planned)))
    for index in model.nonlinear:
        for j in np.flatnonzero(model.T[index]):
            rows = np.flatnonzero(clear[:, j])
            if not len(rows):
                sentences.append(f"{names[j]} does not show at this drive: drive further, or measure longer")
            elif rows[0]:
                share = float(SHARES[rows[0]])
                sentences.append(
                    f"{names[j]} shows (three standard deviations) from about {100 * share:.2g} % of the drive on, "
                    f"{share * size:.2g} {unit} at most"
                )
    return list(dict.fromkeys(sentences))
