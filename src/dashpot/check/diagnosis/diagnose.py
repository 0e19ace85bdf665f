"""The verb: diagnose(model, spectrum) names what would make the rig fit, best first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.check.diagnosis.causes import causes
from dashpot.check.diagnosis.search import Workbench
from dashpot.check.diagnosis.wording import finding
from dashpot.check.verdict import assess
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord
from dashpot.estimate.assessment import Finding
from dashpot.estimate.likelihood.starting_values import candidates
from dashpot.estimate.method import Prepared
from dashpot.estimate.preparation.noise_quality import channels_correlate, without_correlation
from dashpot.estimate.preparation.state_reconstruction import (
    noise_is_known,
    states_if_seen,
    working_covariance,
)
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import observation_model

LARGEST = 12  # coordinates of the rigs that are diagnosed: trials of larger ones take too long to wait for


def diagnose(
    model: Model, spectrum: Spectrum, estimate: Estimate | None = None, *, seed: int = 0
) -> tuple[Finding, ...]:
    """Causes that would explain most of a misfit, the best first; () where nothing that was tried does.

    `spectrum` has no batch axes.  The estimate, where there is one, is one more start.  Nothing is applied.
    """
    transients = any(isinstance(stretch, WholeRecord) and stretch.loads for stretch in spectrum.stretches)
    if model.n > LARGEST or transients:
        return ()
    data = _prepared(model, spectrum)
    view = observation_model(model, spectrum.channels, spectrum.omega)
    middle, signs = candidates(data, view, 1, np.random.default_rng(seed))
    psi, sign = middle[0], signs[0]
    if estimate is not None and np.all(np.isfinite(estimate.values)):
        psi = estimate.values
        for name, turned in estimate.signs.items():
            sign[spectrum.index(name)] = float(turned)
    _, found = causes(Workbench(data, view, psi, sign), seed)
    return tuple(finding(model, spectrum.channels, cause) for cause in found)


def _prepared(model: Model, spectrum: Spectrum) -> Prepared:
    """One repeat, weighed as for an estimate; noise that is not known is taken in parts of each channel's size."""
    known = noise_is_known(spectrum) and bool(np.any(spectrum.covariance))
    whole = replace(spectrum, amplitudes=spectrum.amplitudes[None], moments=None)
    if not known:
        nothing = np.full_like(spectrum.covariance, np.nan)
        whole = replace(whole, covariance=nothing, noise=("unknown",) * spectrum.lines)
    V = np.atleast_3d(working_covariance(model, whole))
    V = V if V.ndim == 4 else V[None]
    if known:
        V = np.where(np.atleast_1d(channels_correlate(whole))[:, None, None, None], V, without_correlation(V))
    return Prepared(model, whole, V, states_if_seen(model, whole, V))


def examined(model: Model, spectrum: Spectrum, estimate: Estimate, *, seed: int = 0) -> Estimate:
    """The estimate with its assessment, and with a diagnosis where the rig does not fit; batches as they are."""
    if estimate.values.ndim != 1:
        return estimate
    assessment = assess(model, spectrum, estimate)
    if assessment.verdict == "does not fit" or not bool(estimate.converged):
        assessment = replace(assessment, findings=diagnose(model, spectrum, estimate, seed=seed))
    return replace(estimate, assessment=assessment)
