"""Simulated dwells and records of nonlinear rigs, and their curves."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.record import Record
from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.study.montecarlo import run_scenarios
from dashpot.study.response_curves import frequency_curve
from dashpot.study.scenario import Scenario
from dashpot.study.simulate import (
    driven_record,
    dwells,
    settled_motion,
    settled_spectrum,
    steady_records,
    with_noise_drawn,
)
from tests.nonlinear_rigs import motions, two_masses

ALL = motions("x1", "x2", "u")
SOFT = {"u": 1e-3}


def test_dwells_settle_to_what_integration_settles_to():
    model, theta = two_masses("cubic")
    test = dwells(model, [4.0], 400, amplitudes=SOFT, periods=40)
    settled = steady_records(ALL, settled_motion(model, theta, ALL, test), test, np.random.default_rng(0))[0]
    drive = Record((ALL[2],), settled.time, settled.values[:, 2:])
    driven = driven_record(model, theta, ALL, drive, np.random.default_rng(0))
    last = slice(-100, None)
    away = np.max(np.abs(settled.values[last] - driven.values[last]), axis=0)
    assert np.all(away < 2e-4 * np.max(np.abs(settled.values), axis=0))


def test_a_table_of_amplitudes_gives_the_parameters_back():
    model, theta = two_masses("cubic")
    test = dwells(model, np.arange(2.0, 14.0, 1.5), 200, amplitudes=SOFT)
    motion = settled_motion(model, theta, ALL, test)
    spectrum = with_noise_drawn(settled_spectrum(ALL, motion, test), np.random.default_rng(0))
    assert spectrum.lines == 5 * len(test.frequency_hz)
    assert np.max(np.abs(identify(model, spectrum).values / theta - 1)) < 1e-6


def test_curves_tell_the_swing_of_every_channel_and_need_a_nonlinear_rig():
    model, theta = two_masses("cubic")
    curve = frequency_curve(model, theta, ALL, SOFT, (8.0, 14.0))
    assert curve.channels == ("x1", "x2", "u")
    assert np.allclose(curve.swing[:, 2], 1e-3, rtol=1e-9)
    assert np.all(curve.stable)
    with pytest.raises(UsageError, match="no nonlinear element"):
        frequency_curve(replace(model, elements=model.elements[:-1]), theta[:5], ALL, SOFT, (8.0, 14.0))


def test_studies_draw_nonlinear_rigs():
    """60 draws: the ratio of spread to bound scatters by 0.09, of six parameters 1.35 is beyond 1 in 2,000."""
    model, theta = two_masses("cubic")
    channels = tuple(replace(channel, relative_noise=0.01 * (channel.name != "u")) for channel in ALL)
    test = dwells(model, [2.0, 4.0, 6.0, 8.0, 10.0, 12.0], 100, amplitudes=SOFT)
    scenario = Scenario({"rig": "bent"}, model, theta, channels, test, ("ml",), 60)
    repeats = run_scenarios([scenario], 3).repeats(scenario)["ml"]
    assert np.all(repeats.converged)
    ratio = np.std(repeats.values, axis=0) / scenario.bound_sd()
    assert np.all((ratio > 0.65) & (ratio < 1.35))
    with pytest.raises(UsageError, match="need the noise"):
        run_scenarios([replace(scenario, noise="estimated")], 3)
