"""What is mostly noise must not buy a fit, nor an unstable rig pass for one."""

from dataclasses import replace

import numpy as np

from dashpot.check.verdict import assess
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.noise import with_local_noise
from dashpot.data.periods import average_periods
from dashpot.estimate.identify import identify
from dashpot.present.estimate import verdict_in_words
from tests.unit.data.test_local_noise import RIG, functions
from tests.whole_rigs import chain, record_of

QUAKE = record_of(*chain(2, 0.05, seed=4), "random", decay_times=3.0).record
TENTH = 3 / (QUAKE.time[-1] - QUAKE.time[0])  # Hz, of three periods


def test_an_earthquake_passed_as_multiples_of_a_low_frequency_is_no_fit() -> None:
    """A record of random base motion, that knows nothing of those frequencies, once fitted with p = 0.96."""
    model, _ = chain(2, 0.05, seed=4)
    dwell = replace(QUAKE, frequency_hz=TENTH)
    quake = spectrum([dwell], orders=range(1, 60), refine="none", transients="none")
    assert assess(model, quake, identify(model, quake)).verdict != "fits"


def test_an_earthquake_given_as_a_dwell_is_said_to_be_none() -> None:
    lines = spectrum([replace(QUAKE, frequency_hz=TENTH)], transients="none")
    (note,) = [note for note in lines.notes if note.code == "other_motion"]
    assert "not a steady sine" in note.text
    several = spectrum([replace(QUAKE, frequency_hz=TENTH * k) for k in (1, 1.3, 1.6)], transients="none")
    (note,) = [note for note in several.notes if note.code == "other_motion"]
    assert "2 more dwells" in note.text


def test_an_earthquake_given_as_periods_is_said_not_to_repeat() -> None:
    """On the other hand periods with noise of three quarters of the motion do."""
    samples = len(QUAKE.time) // 4
    step = (QUAKE.time[-1] - QUAKE.time[0]) / (len(QUAKE.time) - 1)
    lines = average_periods(QUAKE, samples * step, range(5, 40))
    assert [note.code for note in lines.notes] == ["periods_differ"]
    once = QUAKE.values[:samples]
    noise = 0.75 * np.std(once, axis=0) * np.random.default_rng(8).normal(size=(4 * samples, once.shape[1]))
    repeated = replace(QUAKE, time=QUAKE.time[: 4 * samples], values=np.tile(once, (4, 1)) + noise)
    assert average_periods(repeated, samples * step, range(1, 12)).notes == ()


def test_as_many_unknowns_as_data_are_no_fit() -> None:
    """χ² is 0 to rounding then, which once read "residuals are 6.6e-24 × the noise"."""
    model, _ = chain(2, 0.05, seed=4)
    lines = spectrum([replace(QUAKE, frequency_hz=TENTH)], orders=range(1, 9), transients="none")
    estimate = identify(model, lines)
    exact = replace(estimate, fit=replace(estimate.fit, chi2=np.array(1e-40), dof=0))
    assessment = assess(model, lines, exact)
    assert assessment.verdict != "fits"
    assert assessment.worst == ()
    assert "× the noise" not in verdict_in_words(exact.fit, assessment)


def test_a_channel_of_noise_is_named_and_buys_no_fit() -> None:
    lines = with_local_noise(functions(300, 0.02))
    rng = np.random.default_rng(5)
    amplitudes = np.array(lines.amplitudes)
    sd = np.median(np.abs(amplitudes[:, 1]))
    amplitudes[:, 1] = sd * (rng.normal(size=300) + 1j * rng.normal(size=300))
    covariance = np.array(lines.covariance)
    covariance[:, 1, 1] = 2 * sd**2
    noise = replace(lines, amplitudes=amplitudes, covariance=covariance)
    assessment = assess(RIG, noise, identify(RIG, noise))
    assert assessment.verdict != "fits"
    assert ("x2",) in [reason.of for reason in assessment.reasons]
