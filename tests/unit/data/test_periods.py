"""Periods of a multisine: one, with noise from the lines beside that are not excited, and the mean of several."""

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.periods import average_periods, driven_lines, one_period
from dashpot.data.record import Record
from dashpot.errors import DataError

CHANNELS = (Channel("f", {"f": 1}, gain=2.0), Channel("x", {"x": 1}, delay=1e-3))
N, STEP = 512, 0.01
ODD = tuple(range(1, 101, 2))


def multisine(rng, noise, samples=N, start=0.3):
    t = start + STEP * np.arange(samples)
    X = np.exp(2j * np.pi * rng.uniform(size=(len(ODD), 2))) * [1.0, 0.5]
    waves = np.exp(2j * np.pi * np.outer(t, ODD) / (N * STEP))
    return X, Record(CHANNELS, t, np.real(waves @ X) + noise * rng.normal(size=(samples, 2)), 1 / (N * STEP))


def test_amplitudes_of_a_clean_period_are_exact():
    rng = np.random.default_rng(1)
    X, record = multisine(rng, 0.0, samples=700)
    lines = one_period(record, N * STEP, ODD)
    delay = np.exp(2j * np.pi * lines.frequency_hz * 1e-3)
    assert lines.amplitudes[:, 0] == pytest.approx(X[:, 0] / 2, abs=1e-12)
    assert lines.amplitudes[:, 1] == pytest.approx(X[:, 1] * delay, abs=1e-12)
    assert np.max(np.abs(lines.covariance)) < 1e-24


def test_noise_is_as_large_as_it_is():
    """100 records of 50 lines: the mean of error²/V is dof/(dof - 2) = 1.11, known to 3 %."""
    rng = np.random.default_rng(2)
    ratios = []
    for _ in range(100):
        X, record = multisine(rng, 0.3)
        lines = one_period(record, N * STEP, ODD)
        error = lines.amplitudes[:, 0] - X[:, 0] / 2
        ratios.append(np.mean(np.abs(error) ** 2 / lines.covariance[:, 0, 0].real))
    assert np.mean(ratios) == pytest.approx(20 / 18, rel=0.08)


@pytest.mark.parametrize(
    ("samples", "period", "orders", "what"),
    [
        (400, N * STEP, ODD, "shorter than its period"),
        (N, N * STEP * 1.0007, ODD, "not a whole"),
        (N, N * STEP, ODD[:9], "cannot be estimated"),
        (N, N * STEP, [1, 3, 300], "beyond half the sampling"),
    ],
)
def test_what_cannot_be_is_said(samples, period, orders, what):
    _, record = multisine(np.random.default_rng(3), 0.1, samples)
    with pytest.raises(DataError, match=what):
        one_period(record, period, orders)


class TestPeriods:
    RATE, PERIOD = 200.0, 0.5

    def record(self, seed, periods=12, noise=0.1, lines=(2, 5)):
        rng = np.random.default_rng(seed)
        t = np.arange(int(periods * self.RATE * self.PERIOD)) / self.RATE
        clean = sum(k * np.cos(2 * np.pi * k * t / self.PERIOD + k) for k in lines)
        common = noise * rng.standard_normal(len(t))
        values = np.stack([clean + common, 2 * clean + common], axis=-1)
        return Record((Channel("a", {"a": 1}), Channel("b", {"b": 1}, gain=2.0)), t, values)

    @pytest.mark.slow
    def test_amplitudes_and_covariance_with_gains_taken_out(self):
        # 400 repeats: the mean of a variance from 11 periods has a relative standard error of √(1/11/400) = 1.5 %.
        found = [average_periods(self.record(seed), self.PERIOD, (2, 5), skip=1) for seed in range(400)]
        X = np.array([one.amplitudes for one in found])
        true = np.array([[2 * np.exp(2j)] * 2, [5 * np.exp(5j)] * 2])
        V = 4 * 0.1**2 / (11 * 100) * np.array([[1, 0.5], [0.5, 0.25]])
        assert np.abs(np.mean(X, axis=0) - true).max() < 5 * np.sqrt(V[0, 0] / 400)
        mean = np.mean([one.covariance for one in found], axis=0)
        assert mean == pytest.approx(np.stack([V, V]), rel=0.07)
        away = X - true
        assert np.einsum("rlc,rld->lcd", away, away.conj()) / 400 == pytest.approx(np.stack([V, V]), rel=0.25)
        assert found[0].frequency_hz == pytest.approx([4, 10])
        assert list(found[0].dof) == [20, 20]
        assert found[0].noise == ("periods", "periods")
        assert list(found[0].samples) == [1100, 1100]

    def test_what_cannot_be_averaged(self):
        record = self.record(0)
        for period, skip, what in (
            (0.5123, 0, "not a whole number"),
            (np.nan, 0, "not a whole number"),
            (-0.5, 0, "not a whole number"),
            (0.5, 11, "12 periods of 0.5 s, 11"),
            (0.5, -1, "two periods"),
        ):
            with pytest.raises(DataError, match=what):
                average_periods(record, period, (2,), skip=skip)
        uneven = Record(record.channels, record.time + 1e-3 * np.sin(record.time), record.values)
        with pytest.raises(DataError, match="evenly"):
            average_periods(uneven, 0.5, (2,))


FOURTH = np.arange(11, 251, 4)


def every_fourth(noise=0.01, cubic=0.0, square=0.0, periods=8, seed=0):
    """A drive at every fourth of 240 lines, and a channel that answers falling with frequency, with distortion."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(N)
    waves = np.exp(2j * np.pi * (np.outer(t, FOURTH) / (N * STEP) + rng.uniform(size=len(FOURTH))))
    drive, answer = waves.real.sum(axis=1), (waves @ (40.0 / (40 + 1j * FOURTH))).real
    answer = answer / np.std(answer)
    answer = answer + cubic * answer**3 + square * answer**2
    one = np.column_stack([drive / np.std(drive), answer])
    values = np.tile(one, (periods, 1)) + noise * rng.normal(size=(periods * N, 2))
    return Record(CHANNELS, STEP * np.arange(periods * N), values, 1 / (N * STEP)), one


def test_lines_that_are_driven_are_found_among_those_stated():
    record, _ = every_fourth()
    for lines in (
        average_periods(record, N * STEP, range(11, 251)),
        one_period(record, N * STEP, range(11, 251)),
    ):
        assert np.rint(lines.frequency_hz * N * STEP).tolist() == FOURTH.tolist()
        assert [note.code for note in lines.notes] == ["lines_driven"]
        assert "60 of 240 lines are driven, one in 4 from 11 to 247" in lines.notes[0].text
    assert average_periods(record, N * STEP, FOURTH).notes == ()


def test_distortion_is_what_repeats_at_lines_that_are_not_driven():
    record, one = every_fourth(noise=0.02, cubic=0.01, square=0.01, seed=1)
    lines = average_periods(record, N * STEP, range(11, 251))
    (note,) = [note for note in lines.notes if note.code == "distortion"]
    size = np.abs(np.fft.rfft(one[:, 1]))
    between = np.setdiff1d(np.arange(11, 248), FOURTH)
    usual = np.sqrt(np.mean(size[FOURTH] ** 2))
    odd, even = (np.sqrt(np.mean(size[between[between % 2 == k]] ** 2)) / usual for k in (1, 0))
    said = [float(word) / 100 for word in note.text.replace(",", "").split() if word[0].isdigit()]
    assert said == pytest.approx([odd, even], rel=0.15)
    assert note.of == ("x",)
    clean = average_periods(every_fourth(noise=0.02, seed=1)[0], N * STEP, range(11, 251))
    assert "distortion" not in [note.code for note in clean.notes]


def test_the_channel_that_moves_in_the_widest_band_tells_what_is_driven():
    """The answer falls below its noise half way up the band."""
    n = np.arange(1, 601)
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(600, 2)) + 1j * rng.normal(size=(600, 2))
    drive = (n % 2 == 1) * np.exp(6j * rng.uniform(size=600))
    X = np.stack([drive, 30 * drive / (1 + (n / 20.0) ** 2)], axis=1) + [0.03, 0.002] * noise
    assert np.array_equal(driven_lines(X), n % 2 == 1)


@pytest.mark.parametrize("rest", [5.0, 5.3, 0.1])
def test_a_channel_at_rest_tells_nothing(rest):
    """Rounding of its lines looks like a pattern, and is no distortion."""
    n, time = np.arange(1, 201), np.arange(8000) / 1000
    rng = np.random.default_rng(0)
    drive = np.cos(2 * np.pi * np.outer(time, n) + rng.uniform(0, 6.3, 200)).sum(axis=1)
    values = np.column_stack([drive + 1e-3 * rng.normal(size=8000), np.full(8000, rest)])
    lines = average_periods(Record(CHANNELS, time, values), 1.0, n)
    assert lines.lines == 200
    assert lines.notes == ()


def test_a_channel_that_moves_at_every_line_outvotes_a_pattern():
    rng = np.random.default_rng(0)
    drive, odd = np.exp(6j * rng.uniform(size=(2, 200)))
    odd[::2] *= 1e-3
    assert np.count_nonzero(driven_lines(odd[:, None])) == 100
    assert np.all(driven_lines(np.stack([drive, odd], axis=1)))


def test_lines_all_driven_are_all_kept():
    """A flat multisine, one that falls, random motion, a sweep, hum beside noise, a resonance: 40 draws of each."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n = np.arange(1, 301)
        phase = np.exp(2j * np.pi * rng.uniform(size=(300, 2)))
        random = rng.normal(size=(300, 2)) + 1j * rng.normal(size=(300, 2))
        peak = 1 / (1 - (n / 80.0) ** 2 + 0.02j * n / 80)
        sweep = np.fft.rfft(np.cos(2 * np.pi * (20 * (t := np.arange(1024) / 1024) + 60 * t**2)))[1:301, None]
        hum = random + 1e3 * (n % 50 == 0)[:, None]
        noise = 1e-3 * random
        for X in (phase, phase / n[:, None], random, peak[:, None] * random, sweep + noise, hum):
            assert np.all(driven_lines(X))
