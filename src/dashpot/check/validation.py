"""How well an estimate predicts what it was not made of: records or lines, from their inputs alone.

ŷ = G v + transients, v being the inputs as their own channels show them; the unknown start and end of a whole record is
all that is fitted to it.  FIT = 1 − ‖y − ŷ‖ / ‖y − ȳ‖ over the lines used, which is that of the samples in the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Bools, Complex, Frozen, Real
from dashpot.check.residuals import calibrations_of, projection
from dashpot.check.verdict import REJECTED
from dashpot.data.conditioning.whole_record import FLOOR
from dashpot.data.noise import Still
from dashpot.data.record import Record
from dashpot.data.spectrum import SettledDwell, Spectrum, WholeRecord, history_of_lines
from dashpot.errors import DataError
from dashpot.estimate.likelihood.objective import inputs_by_channel
from dashpot.estimate.nonlinear.objective import noise_of_measured_inputs, predicted_lines
from dashpot.estimate.nonlinear.record_problem import (
    LinearisedRecord,
    NotSolvedError,
    OutputCovariance,
    known_inputs,
)
from dashpot.estimate.nonlinear.records import noise_of_channels
from dashpot.estimate.nonlinear.whole_record import followed_record
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import channel_unit, observation_model

MISSED = 0.8  # FIT below which the data may be wrong, or the rig another one


@dataclass(frozen=True)
class RecordPrediction(Frozen):
    """One record (or all settled lines) against what was predicted of it; outputs only.

    channels, units  names and SI units
    frequency_hz     (lines,)
    measured, predicted  (lines, channels)
    fit              (channels,) 1 − ‖y − ŷ‖ / ‖y‖
    chi2             (channels,) over the noise of the channel and, through the rig, of the inputs; NaN where unknown
    dof              (channels,) real lines of each channel
    duration_s, samples  of a whole record, 0 of settled lines
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    frequency_hz: Real
    measured: Complex
    predicted: Complex
    fit: Real
    chi2: Real
    dof: Real
    duration_s: float
    samples: int

    @property
    def rms_error(self) -> Real:
        """Rms of what was measured less what was predicted of a record, in its units, (channels,); NaN of lines."""
        if not self.samples:
            return np.full(len(self.channels), np.nan)
        _, measured_motion, predicted_motion = self.histories()
        return np.asarray(np.sqrt(np.mean((measured_motion - predicted_motion) ** 2, axis=0)))

    def rescaled(self) -> tuple[Real, Real]:
        """The factor by which each prediction is nearest to what was measured, and FIT with it, (channels,) each."""
        there = np.isfinite(self.measured)
        y, shown = np.where(there, self.measured, 0.0), np.where(there, self.predicted, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            factor = np.sum(np.conj(shown) * y, axis=0).real / np.sum(np.abs(shown) ** 2, axis=0)
            left = np.linalg.norm(y - factor * shown, axis=0) / np.linalg.norm(y, axis=0)
        return factor, 1 - left

    @property
    def p(self) -> Real:
        """Probability of a χ² as large by noise alone, the estimate taken as exact, (channels,); NaN: not known."""
        return np.where(np.isfinite(self.chi2), chdtrc(np.maximum(self.dof, 1.0), self.chi2), np.nan)

    def histories(self) -> tuple[Real, Real, Real]:
        """Time (samples,) s, and measured and predicted histories (samples, channels) of the lines in the band."""
        lines = np.rint(self.frequency_hz * self.duration_s).astype(int)
        measured_motion, predicted_motion = (
            history_of_lines(values, lines, self.samples) for values in (self.measured, self.predicted)
        )
        time = np.arange(self.samples, dtype=np.float64) * (self.duration_s / self.samples)
        return time, measured_motion, predicted_motion


def within_noise(predictions: Sequence[RecordPrediction]) -> bool | None:
    """Whether no channel of any record differs by more than the noise of its sensors; None if it is unknown."""
    probabilities = np.concatenate([part.p for part in predictions])
    tested = probabilities[np.isfinite(probabilities)]
    if not len(tested) or len(tested) < len(probabilities):
        return None
    return bool(np.min(tested) * len(tested) > REJECTED)


def missed(predictions: Sequence[RecordPrediction]) -> bool:
    """Whether some channel is predicted so badly that more than the estimate's own error must be behind it."""
    return not within_noise(predictions) and any(bool(np.any(part.fit < MISSED)) for part in predictions)


def validate(model: Model, estimate: Estimate, spectrum: Spectrum) -> tuple[RecordPrediction, ...]:
    """What the estimate predicts of each whole record of `spectrum` (no batch axes), and of its settled lines.

    Raises DataError if the channels do not give the inputs, or do not match the estimate's rig.
    """
    view = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment)
    estimate.require_unknowns(view.names, ())
    outputs = ~view.inputs_alone
    # Variances with the inputs taken as exact, (lines, channels, channels), and whether they are the sensors'
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real
    usable = np.isfinite(variance) & (variance > 0)
    # The quiet end of a band is no measure of the noise elsewhere.
    known = bool(np.all(usable[:, outputs])) and FLOOR not in spectrum.noise
    size = np.nanmean(np.abs(spectrum.amplitudes) ** 2, axis=0)
    # 1e-2 of a channel's size: its weight in the fit of the transients where its noise is not known
    chosen = np.where(usable & known, variance, 1e-2**2 * size) * outputs
    V: Complex = (chosen[..., None] * np.eye(len(spectrum.channels))).astype(np.complex128)
    predicted, of_inputs = _predicted(model, estimate, spectrum, V, outputs, known)
    variance = np.diagonal(V, axis1=-2, axis2=-1).real + of_inputs
    parts = []
    # Lines of what is predicted by itself: the settled ones together, and those of each whole record
    settled = np.array([isinstance(value, SettledDwell) for value in spectrum.stretches])
    first = int(np.argmax(settled))
    owner = np.where(settled, first, np.arange(len(settled)))[spectrum.stretch]
    for lines, value in [(np.flatnonzero(owner == k), spectrum.stretches[k]) for k in np.unique(owner)]:
        at = np.flatnonzero(outputs)
        y, shown = spectrum.amplitudes[lines][:, at], predicted[lines][:, at]
        there = np.isfinite(y)
        away = np.sum(np.where(there, np.abs(y - shown) ** 2, 0.0), axis=0)
        size = np.sum(np.where(there, np.abs(y) ** 2, 0.0), axis=0)
        noise = variance[lines][:, at]
        with np.errstate(invalid="ignore", divide="ignore"):
            fit = np.where(size > 0, 1 - np.sqrt(away / size), np.nan)
            chi2 = 2 * np.sum(np.where(there, np.abs(y - shown) ** 2 / noise, 0.0), axis=0)
        record = value if isinstance(value, WholeRecord) else None
        parts.append(
            RecordPrediction(
                tuple(spectrum.channels[c].name for c in at),
                tuple(channel_unit(model, spectrum.channels[c]) for c in at),
                spectrum.frequency_hz[lines],
                y,
                shown,
                fit,
                chi2 if known else np.full(len(at), np.nan),
                2.0 * np.sum(there, axis=0),
                0.0 if record is None else record.duration_s,
                0 if record is None else record.samples,
            )
        )
    return tuple(parts)


def _predicted(
    model: Model, estimate: Estimate, spectrum: Spectrum, V: Complex, outputs: Bools, known: bool
) -> tuple[Complex, Real]:
    """What the channels show under the measured inputs, (lines, channels), and its variance by the noise of these.

    V takes the inputs as exact; known: whether the noise is.
    """
    theta, found = estimate.values[: len(model.unknowns)], calibrations_of(model, estimate)
    if len(model.nonlinear):
        shown = predicted_lines(model, theta, spectrum, V, found)[0]
        noise = noise_of_measured_inputs(model, theta, spectrum, V, found) if known else np.zeros(shown.shape)
        return shown, noise * outputs
    view = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment)
    if inputs_by_channel(view, np.isfinite(spectrum.amplitudes) & view.inputs_alone & view.is_direct) is None:
        raise DataError(
            "some input is not measured, so the motion cannot be predicted", cure="record the inputs as well"
        )
    shown, _, H = projection(model, theta, spectrum, V, found)
    of_inputs = np.where(~outputs[:, None] & ~outputs, np.nan_to_num(spectrum.covariance), 0.0)
    return shown, np.einsum("lij,ljk,lik->li", H, of_inputs, H.conj()).real * outputs


# How well an estimate of a nonlinear rig predicts whole records that it was not made of, from their inputs
# alone.


def validate_records(
    model: Model, estimate: Estimate, records: Sequence[Record], still: Still | None = None
) -> tuple[RecordPrediction, ...]:
    """What the estimate predicts of each whole record of a nonlinear rig; the state at its start is taken from it.

    still: the noise that an at-rest record shows; χ² counts that of the channels and, through the rig, of the inputs.
    Raises DataError if the estimate is of another rig, or a record does not suit it.
    """
    estimate.require_unknowns([unknown.name for unknown in model.unknowns])
    found = []
    for record in records:
        followed = followed_record(model, estimate, record)
        motion = followed.compared()
        samples, channels = motion.measured.shape
        duration = float(motion.time[-1] + motion.time[1])
        units = {channel.name: channel_unit(model, channel) for channel in record.channels}
        lines = _lines(motion.measured)
        chi2, dof = np.full(channels, np.nan), np.full(channels, float(samples))
        if still is not None and len(model.inputs):
            noise = noise_of_channels(model, record, still)
            data = followed.data
            known = known_inputs(data.inputs, np.sqrt(noise.inputs))
            problem = replace(followed.problem, sd=noise.outputs, inputs=(known,))
            residual, J, V = problem.with_covariance(0, followed.psi)
            if J is None or V is None:
                raise DataError(
                    "the simulation does not follow the measured motion",
                    data.source,
                    "check that the record belongs to this rig",
                )
            starts = np.arange(problem.inner, len(followed.psi))
            chi2, dof = np.empty(len(data.names)), np.empty(len(data.names))
            for c in range(len(data.names)):
                only = np.array([c])
                along = replace(V.tangent, shown=V.tangent.shown[:, only], direct=V.tangent.direct[:, only])
                by_itself = OutputCovariance(along, V.weight[only], known)
                drifting = np.flatnonzero(np.array(data.drift)[only])
                linear = LinearisedRecord(
                    by_itself, residual[:, only], J[:, only][..., starts], starts, drifting
                )
                try:
                    free = np.linalg.lstsq(linear.matrix, linear.gradient, rcond=1e-12)[0]
                    chi2[c] = linear.cost - float(linear.gradient @ free)
                except NotSolvedError:
                    chi2[c] = np.nan
                dof[c] = data.samples - len(starts) - len(drifting)
        found.append(
            RecordPrediction(
                motion.names,
                tuple(units[name] for name in motion.names),
                np.arange(len(lines)) / duration,
                lines,
                _lines(motion.predicted),
                1 - motion.relative,
                chi2,
                dof,
                duration,
                samples,
            )
        )
    return tuple(found)


def _lines(history: Real) -> Complex:
    """Peak amplitudes of a history (samples, channels) at the multiples of 1/T, the constant term among them."""
    return np.fft.rfft(history, axis=0) * (2 / len(history))
