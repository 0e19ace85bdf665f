"""What a test will tell: standard deviations of the unknowns, and what each frequency adds to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints, Real, freeze
from dashpot.design.criteria import Criterion, Robustness, criterion_value
from dashpot.design.schedule import Schedule
from dashpot.design.test_setup import TestSetup
from dashpot.errors import IdentifiabilityError
from dashpot.model.observation import calibration_names


@dataclass(frozen=True)
class ExpectedPrecision:
    """What a test will tell, at the nominal values.

    sd, relative  (q,)    standard deviations of ψ in SI units, and in parts of the values
    covariance    (q, q)  SI units
    figure        the criterion, as a relative standard deviation
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    sd: Real
    covariance: Real
    figure: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def relative(self) -> Real:
        """sd in parts of |value| (of 1 where the value is 0)."""
        return self.sd / np.where(self.values == 0, 1.0, np.abs(self.values))

    def rms(self, names: Sequence[str] = ()) -> float:
        """Root mean square of the relative standard deviations of all (or some) of the parameters."""
        chosen = [self.names.index(name) for name in names] if names else list(range(len(self.names)))
        return float(np.sqrt(np.mean(self.relative[chosen] ** 2)))


def expected_precision(
    setup: TestSetup, criterion: Criterion, information: Real, robustness: Robustness = "worst"
) -> ExpectedPrecision:
    """What information (scenarios, q, q) in parts of the parameters' sizes, prior included, will give.

    Raises IdentifiabilityError where it leaves some parameter open.
    """
    at = criterion_value(criterion.terms(setup, robustness), information)
    if not np.isfinite(at.F):
        raise IdentifiabilityError(
            "this test does not determine the unknowns", cure="give it more frequencies, or another sensor"
        )
    size = setup.sizes[0]
    C = at.C[0] * size[:, None] * size
    units = tuple(u.unit for u in setup.model.unknowns) + tuple(
        "s" if name.endswith(".delay") else "1" for name in calibration_names(setup.channels)
    )
    # Calibrations are errors of ln gain and of delay; their value is 1 and 0.
    extra = [0.0 if name.endswith(".delay") else 1.0 for name in calibration_names(setup.channels)]
    values = np.concatenate([setup.theta[0], extra])
    return ExpectedPrecision(setup.names, units, values, np.sqrt(np.diagonal(C)), C, criterion.figure(at.F))


def information_gain(
    setup: TestSetup, criterion: Criterion, schedule: Schedule, prior: Real, frequency_hz: Real, pattern: Ints
) -> Real:
    """How much a sample at each frequency adds to what is known of each parameter, (frequencies, q).

    (C M(f) C)_jj / C_jj at the nominal values, times the test's samples: 1 is what its average sample adds.
    """
    C = criterion_value(criterion.terms(setup, "worst"), prior + schedule.information(setup)).C[0]
    each = setup.information(frequency_hz, pattern)[0]
    gain = np.einsum("ja,iab,bj->ij", C, each, C)
    total: Real = float(np.sum(schedule.samples)) * gain / np.diagonal(C)
    return total
