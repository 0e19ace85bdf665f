"""Dwells whose frequency wanders are found and used whole; noise of any colour is no wandering."""

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.steadiness import WANDERS
from dashpot.data.record import Record
from dashpot.estimate.identify import identify
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.observation import observation_model
from tests.unit.data.conditioning.signals import noisy_sines
from tests.whole_rigs import chain

MODEL, THETA = chain(1, 0.04)
CHANNELS = (Channel("x1", {"x1": 1.0}), Channel("u", {"u": 1.0}))


def dwell(f: float, drift: float, rng: np.random.Generator, seconds: float = 6.0) -> Record:
    """A dwell whose frequency runs from f (1 − drift) to f (1 + drift), with 2 % noise; its start is cut off."""
    rate, finer, before = 20 * f, 4, 2.0
    fine = np.arange(int((seconds + before) * rate) * finer + 1) / (rate * finer) - before
    cycles = f * (fine + drift * (fine - seconds / 2) ** 2 / seconds)
    motion = integrator(MODEL, p := MODEL.parameters(THETA), 1 / (rate * finer)).motion(
        1e-3 * np.sin(2 * np.pi * cycles)[:, None]
    )
    values = channel_samples(observation_model(MODEL, CHANNELS, np.ones(1)), p, motion)
    values = values[int(before * rate) * finer : -1 : finer]
    noise = 0.02 * np.std(values, axis=0) * rng.normal(size=values.shape)
    return Record(CHANNELS, np.arange(len(values)) / rate, values + noise, f)


def test_dwells_that_drift_are_whole_records() -> None:
    rng = np.random.default_rng(1)
    dwells = [dwell(f, 0.02, rng) for f in (6.0, 9.0, 12.0)]
    assert WANDERS.p(dwells) < 1e-20
    lines = spectrum(dwells)
    assert len(lines.records) == 3
    assert "not steady (the drive frequency drifts)" in lines.notes[-1].text
    found = identify(MODEL, lines)
    assert found.values == pytest.approx(THETA, rel=0.01)
    assert np.all(np.abs(found.values - THETA) < 4 * found.sd)


def test_dwells_that_are_told_to_be_steady_are_named() -> None:
    drifting = [dwell(9.0, 0.02, np.random.default_rng(2))]
    for how in ({"settle": "auto"}, {"refine": "always"}, {"transients": "none"}):
        lines = spectrum(drifting, **how)  # type: ignore[arg-type]
        assert not lines.records
        assert "drive_wanders" in [note.code for note in lines.notes]


def test_steady_dwells_stay() -> None:
    lines = spectrum([dwell(f, 0.0, np.random.default_rng(3)) for f in (6.0, 9.0, 12.0)])
    assert not lines.records
    assert "drive_wanders" not in [note.code for note in lines.notes]


@pytest.mark.parametrize(("memory", "alike"), [(0.0, 0.0), (0.9, 0.7)])
def test_noise_is_no_wandering(memory: float, alike: float) -> None:
    """80 tests of two dwells of 12 periods: uniform p values, 4 standard deviations; seed of each its number."""
    p = [WANDERS.p(noisy_sines(memory, alike, np.random.default_rng(k))) for k in range(80)]
    assert np.mean(p) == pytest.approx(0.5, abs=4 / np.sqrt(12 * 80))
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 80))


def test_stamps_that_jitter_are_no_wandering() -> None:
    """As above with 4 % of a step of jitter: without its share 7 of 80 were taken for wandering."""
    p = [WANDERS.p(noisy_sines(0.0, 0.0, np.random.default_rng(k), 0.002, 0.04)) for k in range(40)]
    assert min(p) > 1e-4
    assert np.mean(np.array(p) < 0.05) < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 40)
