"""What data say beside the values of an estimate: collinearity, profiles, what errors of known parameters do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dashpot.check.chi2_surface import chi2_surface
from dashpot.check.collinearity import Collinearity, collinearity
from dashpot.check.profile import Profile, profile
from dashpot.check.sensitivity import KnownErrors, known_errors
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model


@dataclass(frozen=True)
class DataFindings:
    """An estimate and what was asked of the data; `known_errors` None where it was not asked."""

    estimate: Estimate
    collinearity: Collinearity
    profiles: tuple[Profile, ...]
    known_errors: KnownErrors | None


def data_findings(
    model: Model, spectrum: Spectrum, estimate: Estimate, profiled: Sequence[str], level: float, known: bool
) -> DataFindings:
    """Collinearity, the profiles of the unknowns `profiled` at `level` and, with `known`, what known errors do.

    Raises UsageError where there is no such unknown, IdentifiabilityError where nothing is known of one.
    """
    return DataFindings(
        estimate,
        collinearity(chi2_surface(model, spectrum, estimate), estimate.covariance),
        tuple(profile(model, spectrum, name, level, estimate) for name in profiled),
        known_errors(model, spectrum, estimate) if known else None,
    )
