"""Dwells in time: what is predicted lies on what was measured, delays and gains of sensors included."""

from dataclasses import replace

import numpy as np

from dashpot import Record, dwells, simulate_spectrum
from dashpot.check.residuals import dwell_histories, residuals
from dashpot.data.conditioning.lines import spectrum, used_dwells
from dashpot.data.conditioning.settings import Conditioning
from tests.unit.present.conftest import RIG, VALUES

SETTINGS = Conditioning(refine="none", transients="none", drift=0, noise="white", settle=0.5)
FREQUENCIES = [1.0, 3.0, 5.0, 7.0]


def records() -> list[Record]:
    """Steady motion of the rig as its sensors show it, one of them late and inverted, times from 5 s on."""
    p = RIG.model.parameters(RIG.model.theta(VALUES))
    exact = tuple(replace(channel, noise=0.0) for channel in RIG.channels)
    lines = simulate_spectrum(
        RIG.model, p, exact, dwells(RIG.model, FREQUENCIES, 200), np.random.default_rng(0)
    )
    late = tuple(replace(c, delay=2e-3, sign=-1) if k == 0 else c for k, c in enumerate(exact))
    time = 5.0 + np.arange(600) / 200
    found = []
    for f, X in zip(FREQUENCIES, lines.amplitudes, strict=True):
        delay = np.array([c.delay or 0.0 for c in late])
        sign = np.array([c.sign for c in late])
        phase = 2j * np.pi * f * (time[:, None] - delay)
        values = sign * (X * np.exp(phase)).real + 0.01
        found.append(Record(late, time, values, frequency_hz=f))
    return found


def test_predictions_lie_on_the_samples() -> None:
    made = records()
    lines = spectrum(made, SETTINGS)
    shown = dwell_histories(
        used_dwells(made, lines, SETTINGS), residuals(RIG.model, RIG.model.theta(VALUES), lines)
    )
    assert len(shown) == 3
    for one in shown:
        assert one.begin == 0.5
        measured = one.measured - np.mean(one.measured, axis=0)
        away = measured - one.predicted(one.time)
        assert np.max(np.abs(away - np.mean(away, axis=0))) < 1e-6 * np.max(np.abs(measured))
