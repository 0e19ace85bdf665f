"""Records that repeat are the mean of their settled periods; others are not."""

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.noise import moderated
from dashpot.data.periods import average_periods, averaged_periods
from dashpot.data.record import Record

CHANNELS = (Channel("f", {"f": 1.0}), Channel("x1", {"x1": 1.0}))
STEP, SAMPLES = 1e-3, 500
EXCITED = np.arange(6, 61)


def multisine(periods: int = 12, *, noise: float = 0.02, transient: float = 0.0) -> Record:
    """Fifty-five lines, a response that falls with the square of the frequency."""
    rng = np.random.default_rng(3)
    t = STEP * np.arange(periods * SAMPLES)
    phase = rng.uniform(0, 2 * np.pi, len(EXCITED))
    waves = np.cos(2 * np.pi * np.outer(t, EXCITED) / (SAMPLES * STEP) + phase)
    values = np.stack([waves.sum(axis=1), waves @ (30.0 / EXCITED**2)], axis=1)
    values += noise * np.std(values, axis=0) * rng.normal(size=values.shape)
    values[:, 1] += transient * np.std(values[:, 1]) * np.exp(-t / 0.2) * np.cos(40 * t)
    return Record(CHANNELS, t, values)


def other(kind: str) -> Real:
    rng, t = np.random.default_rng(1), STEP * np.arange(6000)
    if kind == "noise":
        return rng.normal(size=(6000, 2))
    if kind == "sine":
        return np.sin(2 * np.pi * 10 * t)[:, None] * [1.0, 2.0]
    if kind == "decay":
        return (np.exp(-t) * np.sin(2 * np.pi * 10 * t))[:, None] * [1.0, 2.0]
    return np.sin(2 * np.pi * (5 * t + 4 * t**2))[:, None] * [1.0, 2.0]


def test_the_period_and_its_lines_are_found() -> None:
    record = multisine()
    lines = spectrum([record])
    known = moderated(average_periods(record, SAMPLES * STEP, EXCITED.tolist()), kind="periods")
    assert np.allclose(lines.frequency_hz, known.frequency_hz)
    assert np.allclose(lines.amplitudes, known.amplitudes)
    assert np.allclose(lines.covariance, known.covariance)
    assert [note.code for note in lines.notes] == ["periods_averaged", "noise_moderated"]
    assert spectrum([record], transients="estimate").records


@pytest.mark.parametrize("transient", [0.1, 5.0])
def test_periods_that_have_not_settled_are_left_out(transient: float) -> None:
    lines, _ = averaged_periods(multisine(transient=transient))
    assert "the first" in lines.notes[0].text
    assert lines.samples[0] < 12 * SAMPLES
    settled, _ = averaged_periods(multisine())
    assert settled.samples[0] == 12 * SAMPLES


def test_a_record_that_goes_on_settling_is_taken_whole() -> None:
    """A mode that rings on over periods had been averaged in: its values were ten standard deviations off."""
    record = multisine(noise=0.02)
    t = np.asarray(record.time)
    for decay, averaged in ((0.05 * SAMPLES * STEP, True), (3 * SAMPLES * STEP, False)):
        ringing = 0.5 * np.std(record.values[:, 1]) * np.exp(-t / decay) * np.cos(2 * np.pi * 31.3 * t)
        values = record.values + ringing[:, None] * [0, 1]
        lines = spectrum([Record(CHANNELS, record.time, values)])
        assert bool(lines.records) != averaged


@pytest.mark.parametrize("kind", ["noise", "sine", "decay", "sweep"])
def test_other_records_do_not_repeat(kind: str) -> None:
    assert averaged_periods(Record(CHANNELS, STEP * np.arange(6000), other(kind))) is None


def test_a_stated_frequency_is_that_of_the_period_where_nothing_moves_at_it() -> None:
    record = multisine()
    stated = Record(CHANNELS, record.time, record.values, 1 / (SAMPLES * STEP))
    assert spectrum([stated]).lines == len(EXCITED)


def test_records_too_short_to_repeat_do_not() -> None:
    """Fewer than 33 samples for each of six periods leave no lag to look at."""
    record = multisine()
    for samples in (12, 192, 197):
        rows = slice(samples)
        assert averaged_periods(Record(CHANNELS, record.time[rows], record.values[rows])) is None
