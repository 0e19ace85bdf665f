"""What dwells tell that wait for nothing: all samples count, transients included (THEORY §8).

A stepped sine runs from dwell to dwell, from rest.  Its motion is carried through all of it; its lines have the loads
of their records' ends, which the information projects out as `identify` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.data.conditioning.transients import continuous, dwells_with_transients
from dashpot.data.conditioning.whole_record import whole_records
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.design.allocation import Criterion, ExpectedPrecision, expected_precision
from dashpot.design.plan import Plan
from dashpot.design.test_setup import TestSetup
from dashpot.errors import DashpotError
from dashpot.estimate.likelihood.objective import local, measured
from dashpot.estimate.preparation import prepare
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.observation import noise_sd, observation_model, small


@dataclass(frozen=True)
class UnsettledTest:
    """A planned test of which all samples are used, from its start on.

    predicted   what it will tell
    thrown_away share of that information that the settled parts of the dwells leave out, by the criterion
    samples     of the whole test
    joined      whether the dwells are one record; else, where noise goes with amplitude, each is one of its own
    """

    predicted: ExpectedPrecision
    thrown_away: float
    samples: int
    joined: bool


def unsettled_test(
    setup: TestSetup, criterion: Criterion, plan: Plan, rate: float | None
) -> UnsettledTest | None:
    """The test of a plan, used whole at the nominal values, beside what is known before.

    None where nothing can be said: no sampling rate, a rig with nonlinear elements, hysteretic dampers or coordinates
    without mass, delays that are stated, a test too long to compute, a large rig (its 2 n loads at the ends of a record
    cost lines × channels × n²: the plan itself takes less).
    """
    if rate is None or len(setup.model.nonlinear) or not plan.dwells or not small(setup.model):
        return None
    if any(unknown.unit == "s" and unknown.nominal for unknown in setup.calibrations):
        return None
    counts = [round((dwell.settle_s + (dwell.time_s or 0.0)) * rate) for dwell in plan.dwells]
    if sum(counts) * len(setup.channels) * (2 * setup.model.n + len(setup.channels)) > 50_000_000:
        return None  # 400 MB of slopes by the loads at the ends, and of noise
    frequency = np.array([dwell.frequency_hz for dwell in plan.dwells])
    drive = setup.drive(frequency, plan.schedule.pattern)
    joined = not any(channel.relative_noise > 0 for channel in setup.channels)
    nominal = replace(setup, theta=setup.theta[:1])
    try:
        records = unsettled_dwells(
            setup.model, setup.p[0], setup.channels, frequency, drive, counts, [1 / rate] * len(counts)
        )
        lines = lines_of_dwells(records, setup.channels, joined=joined)
        # Information of lines without noise at the true θ, (q, q) in SI units of ψ, loads projected out
        data = prepare(setup.model, lines, states=False)
        psi = np.concatenate([setup.theta[0], data.view.nominal_calibrations])
        at = local(data.view, measured(data), psi[None], np.ones((1, len(lines.channels))))
        information = at.symmetric[0] - np.diag(data.view.prior_precision)  # which the lines do not tell
        information = information * np.outer(setup.gains, setup.gains)
        predicted = expected_precision(nominal, criterion, nominal.relative(information))
        settled = expected_precision(nominal, criterion, plan.schedule.information(nominal))
    except DashpotError:
        return None
    thrown_away = 1 - (predicted.figure / settled.figure) ** 2
    return UnsettledTest(predicted, thrown_away, sum(counts), joined)


def unsettled_dwells(
    model: Model,
    p: Real,
    channels: Sequence[Channel],
    frequency_hz: Real,
    drive: Complex,
    samples: Sequence[int],
    step_s: Sequence[float],
) -> list[Record]:
    """A stepped sine from rest without noise, a record for each dwell, each beginning as the last one ended.

    p (elements,); drive (dwells, r + s) amplitudes of the inputs, which pass over from dwell to dwell within a period;
    known calibrations are left out.  Raises ModelError as `integrator`.
    """
    # The channel with what is known of its calibration taken out
    calibrated = tuple(
        replace(
            channel,
            gain=None if channel.gain is None else 1.0,
            delay=None if channel.delay is None else 0.0,
            sign=None if channel.sign is None else 1,
        )
        for channel in channels
    )
    view = observation_model(model, calibrated, np.ones(1))
    gain = np.append(view.nominal_calibrations[: view.gains], 1.0)[view.gain]
    state, begin, records = np.zeros(2 * model.n), 0.0, []
    before = (0.0, np.zeros(drive.shape[1], dtype=complex))
    for f, q, count, step in zip(frequency_hz.tolist(), drive, samples, step_s, strict=True):
        finer = max(1, int(np.ceil(20 * f * step)))  # so that a spline through the drive is the drive
        time = np.arange(count * finer + 1, dtype=float) * (step / finer)
        share = (1 - np.cos(np.pi * np.minimum(time * f, 1.0)))[:, None] / 2
        inputs = share * _waves(time, f, q) + (1 - share) * _waves(time, *before)
        motion = integrator(model, p, step / finer).motion(inputs, state)
        values = gain * channel_samples(view, p, motion)[:-1:finer]
        stamps = np.arange(count, dtype=float) * step + begin
        records.append(Record(calibrated, stamps, values, f, source=f"dwell at {f:g} Hz"))
        state = np.concatenate([motion.x[-1], motion.v[-1]])
        before = (f, q * np.exp(2j * np.pi * f * time[-1]))
        begin += count * step
    return records


def _waves(time: Real, frequency_hz: float, q: Complex) -> Real:
    """Re(q e^{jωt}), (samples, r + s)."""
    return (q * np.exp(2j * np.pi * frequency_hz * time)[:, None]).real


def lines_of_dwells(records: Sequence[Record], channels: Sequence[Channel], *, joined: bool) -> Spectrum:
    """The lines of dwells with their transients, with the noise that `channels` state.

    One record of all that follow each other where `joined`, which asks for noise of one size; else one for each, with
    noise in proportion to what moves in it.  Raises DataError where a dwell is too short.
    """
    if joined:
        whole = [replace(record, frequency_hz=None) for record in continuous(records)]
        lines = _with_noise(whole_records(whole, ramp=True), sample_noise(whole[0], channels))
    else:
        parts = [
            _with_noise(dwells_with_transients([record]), sample_noise(record, channels))
            for record in records
        ]
        lines = concatenate(parts)
    return replace(lines, channels=tuple(channels), notes=())


def sample_noise(record: Record, channels: Sequence[Channel]) -> Real:
    """Standard deviation of a sample's noise, (channels,), a relative part being of √2 times the rms motion."""
    return noise_sd(channels, 2**0.5 * np.std(record.values, axis=0).astype(np.complex128))


def _with_noise(lines: Spectrum, sd: Real) -> Spectrum:
    """The lines of one record with white noise of sd (channels,) of a sample: E|Δ|² = 4 σ² / N."""
    V = (4 * sd**2 / lines.samples[:, None])[:, :, None] * np.eye(len(sd))
    count = lines.lines
    return replace(
        lines, covariance=V.astype(np.complex128), noise=("given",) * count, dof=np.full(count, np.inf)
    )
