"""What is mostly noise must not buy a fit, nor an unstable rig pass for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.verdict import assess
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.local_noise import with_local_noise
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from tests.two_masses import PUSHED
from tests.unit.data.test_local_noise import RIG, functions
from tests.whole_rigs import chain, record_of


@pytest.fixture(scope="module")
def quake() -> Spectrum:
    """A record of random base motion, passed as multiples of 0.1 Hz that it knows nothing of."""
    model, theta = chain(2, 0.05, seed=4)
    record = record_of(model, theta, "random", decay_times=3.0).record
    dwell = replace(record, frequency_hz=3 / (record.time[-1] - record.time[0]))
    return spectrum([dwell], orders=range(1, 60), refine="none", transients="none")


def test_a_record_that_does_not_repeat_is_no_fit(quake: Spectrum) -> None:
    model, _ = chain(2, 0.05, seed=4)
    assert assess(model, quake, identify(model, quake)).verdict != "fits"


def test_functions_without_noise_sizes_and_an_unstable_rig_do_not_fit() -> None:
    unstable = with_local_noise(functions(300, 0.01, truth=PUSHED | {"c1": -1.0, "c2": -0.5}))
    assessment = assess(RIG, unstable, identify(RIG, unstable))
    assert assessment.verdict == "does not fit"
    assert "unstable" in {reason.code for reason in assessment.reasons}


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


def test_a_channel_that_does_not_move_is_named() -> None:
    lines = with_local_noise(functions(300, 0.02))
    amplitudes, covariance = np.array(lines.amplitudes), np.array(lines.covariance)
    amplitudes[:, 1], covariance[:, 1, 1] = 0.0, 0.0
    silent = replace(lines, amplitudes=amplitudes, covariance=covariance)
    estimate = identify(RIG, lines)
    assessment = assess(RIG, silent, estimate)
    assert assessment.verdict == "does not fit"
    assert ("silent_channel", ("x2",)) in [(reason.code, reason.of) for reason in assessment.reasons]
