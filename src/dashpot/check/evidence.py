"""What there is to show of an estimate beside its values: residuals, responses, histories, profiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dashpot.check.data_findings import Collinearity, collinearity
from dashpot.check.profile import Profile, chi2_surface, profile
from dashpot.check.residuals import (
    DwellHistory,
    FrequencyResponse,
    Residuals,
    calibrations_of,
    dwell_histories,
    residuals,
    responses_of_channels,
)
from dashpot.check.validation import RecordPrediction, validate
from dashpot.data.conditioning.used_dwells import UsedDwell
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, DataError
from dashpot.estimate.registry import AUTOMATIC  # those that end in the minimum of χ²
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

MOST_PROFILED = 12  # unknowns whose profile is computed: with more, or with more amplitudes than this,
MOST_AMPLITUDES = 3000  # profiles take longer than a report is worth


@dataclass(frozen=True)
class Evidence:
    """What the data say of an estimate beside its values; None or empty where it cannot be said.

    responses   output over input, of the channels where such can be formed
    records     whole records as the estimate predicts them from their inputs
    dwells      some of the dwells behind the lines, in time
    profiles    of the unknowns whose normal interval misleads
    """

    residuals: Residuals | None = None
    collinearity: Collinearity | None = None
    responses: tuple[FrequencyResponse, ...] = ()
    records: tuple[RecordPrediction, ...] = ()
    dwells: tuple[DwellHistory, ...] = ()
    profiles: tuple[Profile, ...] = ()


def evidence_of(
    model: Model,
    spectrum: Spectrum | None,
    estimate: Estimate,
    level: float = 0.95,
    dwells: Sequence[UsedDwell] = (),
) -> Evidence:
    """The evidence of an estimate (no batch axes); `dwells` are those that the spectrum's lines come from."""
    if spectrum is None:
        return Evidence()
    left = residuals_of(model, spectrum, estimate)
    try:
        weak = collinearity(chi2_surface(model, spectrum, estimate), estimate.covariance)
    except DashpotError:
        weak = None  # of such a rig nothing is said of single lines
    return Evidence(
        left,
        weak,
        tuple(responses_of_channels(model, estimate, spectrum, left)),
        _records(model, spectrum, estimate),
        tuple(dwell_histories(dwells, left)),
        _misleading(model, spectrum, estimate, level),
    )


def residuals_of(model: Model, spectrum: Spectrum, estimate: Estimate) -> Residuals:
    """What the estimate leaves over of a spectrum, its calibrations included (no batch axes)."""
    theta = estimate.values[: len(model.unknowns)]
    return residuals(model, theta, spectrum, calibrations_of(model, estimate))


def _has_records(spectrum: Spectrum) -> bool:
    return any(getattr(stretch, "samples", 0) for stretch in spectrum.stretches)


def _records(model: Model, spectrum: Spectrum, estimate: Estimate) -> tuple[RecordPrediction, ...]:
    if len(model.nonlinear) or not _has_records(spectrum):
        return ()
    try:
        return tuple(part for part in validate(model, estimate, spectrum) if part.samples)
    except DataError:
        return ()


def _misleading(model: Model, spectrum: Spectrum, estimate: Estimate, level: float) -> tuple[Profile, ...]:
    """Profiles where the normal interval misleads; none where they cost much, or mean nothing."""
    many = len(estimate.names) > MOST_PROFILED or spectrum.amplitudes.size > MOST_AMPLITUDES
    if _has_records(spectrum) or many or len(model.nonlinear) or estimate.method not in AUTOMATIC:
        return ()
    try:
        profiles = [profile(model, spectrum, name, level, estimate) for name in estimate.names]
    except DashpotError:
        return ()  # nothing is said of the surface of such a rig
    return tuple(each for each in profiles if bool(each.misleads))
