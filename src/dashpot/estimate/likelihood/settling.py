"""Whether dwells too short to show it have settled: one test of the boundary loads of all of them together.

With their loads such dwells are right in either case; without, where nothing is left of a transient, several times as
precise (THEORY §8).  The likelihood of all their samples tells: F of what the loads and polynomials of all dwells
explain beyond steady motion at their drive frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from dashpot.arrays import Complex, Real
from dashpot.data.noise import LEVEL
from dashpot.data.spectrum import SettledDwell, Spectrum, WholeRecord
from dashpot.errors import DashpotError, DataError
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.objective import local, measured, nuisance_columns, predict
from dashpot.estimate.likelihood.record_noise import noise_is_sought, with_record_noise
from dashpot.estimate.method import Method
from dashpot.estimate.preparation import Prepared, prepare
from dashpot.model.network import Model
from dashpot.model.observation import calibrated_transfer
from dashpot.notices import Notice


def with_settling_decided(model: Model, spectrum: Spectrum, method: Method | None = None) -> Spectrum:
    """The spectrum with its short dwells as steady motion or as whole records, whichever one test of all of them says.

    As it is where that is decided, where the method (None: any) knows no transients, and where no fit with boundary
    loads can tell: then a notice stands in `notes`.
    """
    if method is not None and not method.traits.transients:
        return spectrum
    whole = spectrum.unsettled
    if whole is None:
        # Dwells used whole with the noise of their residuals have columns for slopes of the sensors only if needed.
        if not _sloping(spectrum) or spectrum.batch or len(model.nonlinear) or not noise_is_sought(spectrum):
            return spectrum
        try:
            return _slopes_decided(model, spectrum)[0]
        except (DashpotError, np.linalg.LinAlgError):
            return spectrum
    as_settled = replace(spectrum, unsettled=None)
    if spectrum.batch or len(model.nonlinear):
        return as_settled
    try:
        whole, p = settling_test(model, as_settled, whole)
    except (DashpotError, np.linalg.LinAlgError):
        return as_settled
    count = len(_dwells(whole))
    dwells = "one dwell is" if count == 1 else f"{count} dwells are"
    others = tuple(note for note in spectrum.notes if note.code != "transient_undetectable")
    if p > LEVEL:
        text = f"{dwells} too short to show a transient individually; together they show none (p = {p:.2g})"
        return replace(as_settled, notes=(*others, Notice("settled_by_evidence", text)))
    text = (
        f"{dwells} not settled (p = {p:.2g}): all samples are used, and start and end transients are "
        "estimated"
    )
    return replace(whole, notes=(*others, Notice("dwells_with_transients", text)))


@dataclass(frozen=True)
class _Fit:
    """ψ and signs of a fit, its −2 ln L, how many columns took part, and degrees of freedom that are left."""

    psi: Real
    sign: Real
    cost: float
    columns: int
    free: int

    @staticmethod
    def at(data: Prepared, psi: Real, sign: Real) -> _Fit:
        """As it is at ψ."""
        likelihood = measured(data)
        with np.errstate(all="ignore"):
            cost = float(local(data.view, likelihood, psi, sign).cost[0])
        columns = nuisance_columns(data.view, likelihood, psi, sign) if np.isfinite(cost) else 0
        return _Fit(psi, sign, cost, columns, likelihood.rows - columns - psi.shape[-1])

    def beside(self, fewer: _Fit) -> float:
        """p-value of this fit's further columns explaining nothing, F."""
        more = self.columns - fewer.columns
        if not np.isfinite(fewer.cost):
            return 0.0
        if more < 1 or self.free < 1 or not np.isfinite(self.cost):
            raise DataError("the dwells cannot be tested for transients")
        return float(
            fdtrc(more, self.free, max(fewer.cost - self.cost, 0.0) / more / (self.cost / self.free))
        )


def settling_test(model: Model, as_settled: Spectrum, whole: Spectrum) -> tuple[Spectrum, float]:
    """The dwells as whole records, with the noise of their residuals, and the p-value of there being no transient."""
    known, fit, method = _slopes_decided(model, whole)
    p = _no_transient(model, as_settled, known, fit, method)
    if p <= LEVEL and _sloping(whole) and not _sloping(known):
        # Loads explain slopes, too, if need be those of another rig: steady motion with slopes may be all there is.
        p = max(p, _no_transient(model, as_settled, *_with_noise(model, whole)))
    return known, p


def _no_transient(
    model: Model, as_settled: Spectrum, known: Spectrum, fit: _Fit, method: MaximumLikelihood
) -> float:
    """The p-value of steady motion, with slopes where the dwells have columns for them, against the fit with loads.

    The rig of the steady motion is that near the fit, or where that is none the one that a search ends in.
    """

    def beside_fit(psi: Real, sign: Real) -> float:
        amplitudes, stretches = np.array(known.amplitudes), list(known.stretches)
        for number, value in enumerate(known.stretches):
            if not isinstance(value, WholeRecord) or value.drive_hz is None:
                continue
            lines = np.flatnonzero(known.stretch == number)
            # The lines of a cosine and of a sine at the drive's frequency, (lines, 2)
            phase = 2 * np.pi * value.drive_hz * value.step_s * np.arange(value.samples)
            both_waves = np.fft.rfft(np.stack([np.cos(phase), np.sin(phase)], axis=1), axis=0)
            waves: Complex = both_waves[value.orders(known.frequency_hz[lines])] * (2 / value.samples)
            shown_lines = known.amplitudes[lines]
            sides = np.concatenate([shown_lines.real, shown_lines.imag])
            there = np.all(np.isfinite(sides), axis=0)
            both = np.concatenate([waves.real, waves.imag])
            shown = np.linalg.lstsq(both, np.where(there, sides, 0.0), rcond=None)[0]
            # The steady motion (channels,) that the rig makes of the inputs in what the channels have shown
            dwell = replace(
                known.select(lines[:1]),
                frequency_hz=np.array([value.drive_hz]),
                amplitudes=np.where(there, shown[0] - 1j * shown[1], np.nan)[None],
                stretch=np.zeros(0, dtype=np.int64),
                stretches=(SettledDwell(),),
            )
            data = prepare(model, dwell, states=False)
            inputs = predict(data.view, measured(data), psi, sign).q
            steady = calibrated_transfer(data.view, psi, sign).amplitudes(inputs)[0, 0]
            amplitudes[lines] -= waves @ np.stack([steady.real, -steady.imag])
            # A slope aliases like the ends of a record do.
            stretches[number] = replace(value, loads=False, polynomial=value.polynomial if value.ramp else 0)
        steady = prepare(
            model, replace(known, amplitudes=amplitudes, stretches=tuple(stretches)), states=False
        )
        return fit.beside(_Fit.at(steady, psi, sign))

    p = beside_fit(*_solved(_from(method, fit), prepare(model, as_settled, states=False)))
    if p > LEVEL:
        return p
    return max(p, beside_fit(*_solved(MaximumLikelihood(), prepare(model, as_settled))))


def _sloping(spectrum: Spectrum) -> bool:
    """Whether dwells have columns for slopes of the sensors."""
    return any(value.ramp for value in _dwells(spectrum))


def _slopes_decided(model: Model, whole: Spectrum) -> tuple[Spectrum, _Fit, MaximumLikelihood]:
    """As `_with_noise`; slopes, which short transients look like, have columns only where loads do not explain them.

    Not needed, they make the intervals of dwells of one period three times as wide.
    """
    known, fit, method = _with_noise(model, _changed(whole, ramp=False))
    if _sloping(whole):
        sloping = _fitted(_from(method, fit), prepare(model, _changed(known, ramp=True), states=False))
        if sloping.beside(fit) < 1e-3:
            return _with_noise(model, whole)
    return known, fit, method


def _with_noise(model: Model, whole: Spectrum) -> tuple[Spectrum, _Fit, MaximumLikelihood]:
    """Whole records with the noise of their residuals, their fit, and the method that it is the end of."""
    known, method = with_record_noise(model, whole, MaximumLikelihood())
    assert isinstance(method, MaximumLikelihood)
    return known, _fitted(method, prepare(model, known, states=not method.start)), method


def _from(method: MaximumLikelihood, fit: _Fit) -> MaximumLikelihood:
    """The method with one descent from a fit in place of its search."""
    return replace(
        method, start=tuple(fit.psi[0].tolist()), start_sign=tuple(fit.sign[0].tolist()), rivals=()
    )


def _fitted(method: MaximumLikelihood, data: Prepared) -> _Fit:
    return _Fit.at(data, *_solved(method, data))


def _dwells(whole: Spectrum) -> list[WholeRecord]:
    """The stretches that are dwells with their transients."""
    return [v for v in whole.stretches if isinstance(v, WholeRecord) and v.drive_hz is not None]


def _changed(whole: Spectrum, *, ramp: bool) -> Spectrum:
    """The same with or without slopes of the sensors in the dwells."""
    dwells = _dwells(whole)
    return replace(
        whole, stretches=tuple(replace(v, ramp=ramp) if v in dwells else v for v in whole.stretches)
    )


def _solved(method: MaximumLikelihood, data: Prepared) -> tuple[Real, Real]:
    """ψ and the channels' signs at the maximum of the likelihood, (1, …) each."""
    solution = method.solve(data)
    return solution.theta, data.spectrum.signs(solution.signs)
