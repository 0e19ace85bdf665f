"""Samples at the limit of a channel's range: what they hide is told by the others, and what rests is left alone."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.unmeasured import expected, marked, marked_whole, with_likely
from dashpot.data.conditioning.whole_record import whole_records
from dashpot.data.record import Record
from dashpot.data.spectrum import WholeRecord

CHANNELS = (Channel("x1", {"x1": 1}), Channel("u", {"u": 1}))
F, EACH = 4.0, 25


def dwell(
    rng: np.random.Generator, limit: float = np.inf, periods: int = 8, noise: float = 0.02, slope: float = 0.0
) -> Record:
    """A sine of amplitude 1 at x1, clipped, beside the drive."""
    t = np.arange(periods * EACH) / (EACH * F)
    x = np.sin(2 * np.pi * F * t + 0.4) + noise * rng.normal(size=len(t)) + slope * np.linspace(-1, 1, len(t))
    u = np.sin(2 * np.pi * F * t) + noise * rng.normal(size=len(t))
    return Record(CHANNELS, t, np.stack([np.clip(x, -limit, limit), u], axis=1), F)


def amplitude(record: Record) -> tuple[complex, float]:
    """Of x1, with its standard deviation along either axis."""
    lines = spectrum([record])
    return complex(lines.amplitudes[0, 0]), float(np.sqrt(lines.covariance[0, 0, 0].real / 2))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "periods"),
    [(0.95, 8), (0.8, 2), *(pytest.param(0.8, many, marks=pytest.mark.long) for many in (8, 30))],
)
def test_the_amplitude_of_a_clipped_sine_is_right_and_its_sd_counts_what_is_missing(
    limit: float, periods: int
) -> None:
    """60 draws: the mean lies within 4 deviations of it; z² has a mean of 2 ± 0.26 were sd exact."""
    rng = np.random.default_rng(8)
    truth = np.exp(1j * (0.4 - np.pi / 2))
    errors, sds = [], []
    for _ in range(60):
        X, sd = amplitude(dwell(rng, limit, periods))
        errors.append(X - truth)
        sds.append(sd)
    away = np.array(errors)
    spread = np.sqrt(np.mean(np.abs(away) ** 2) / 2 / len(away))
    assert abs(np.mean(away)) < 4.0 * spread
    z2 = np.mean((np.abs(away) / np.array(sds)) ** 2)
    assert 0.8 < z2 < 2.6  # the larger of two deviations stands for both
    wrong = abs(np.mean([amplitude_as_measured(dwell(rng, limit, periods)) for _ in range(10)]) - truth)
    assert wrong > 5 * abs(np.mean(away))


@pytest.mark.parametrize("steps", [8, 128, 4096])
@pytest.mark.parametrize("limit", [np.inf, 0.95, 0.8])
def test_clipping_in_step_with_the_sampling_is_told_from_turning_points(steps: int, limit: float) -> None:
    """Each value comes again in every period, those next to the limit as well: the motion around tells."""
    rng = np.random.default_rng(3)
    for noise in (0.0, 3e-4):
        record = dwell(rng, limit, noise=noise)
        coarse = replace(record, values=np.round(record.values * steps) / steps)
        clips = 1 - limit > 0.5 / steps
        assert [note.of for note in marked([coarse])[1]] == [("x1",)] * clips
        assert abs(abs(amplitude(coarse)[0]) - 1) < 0.4 / steps + 1e-3


def test_second_moments_of_a_clipped_dwell_from_a_coarse_converter_are_those_of_the_whole_sine() -> None:
    record = dwell(np.random.default_rng(5), 0.8, noise=0.002)
    coarse = replace(record, values=np.round(record.values * 64) / 64)
    moments = spectrum([coarse], moments=True).moments
    assert moments is not None
    power = moments.products[0].diagonal() / len(record.time)
    np.testing.assert_allclose(power, 0.5, rtol=0.02)


@pytest.mark.slow
def test_a_clipped_dwell_whose_frequency_is_off_is_put_right_at_its_own() -> None:
    """Stated 2 % off, 30 draws: by the stated frequency amplitudes are up to a fifth off."""
    rng = np.random.default_rng(11)
    truth = np.exp(1j * (0.4 - np.pi / 2))
    away, sds = [], []
    for _ in range(30):
        X, sd = amplitude(replace(dwell(rng, 0.7, 12, noise=0.003), frequency_hz=1.02 * F))
        away.append(X - truth)
        sds.append(sd)
    assert np.mean((np.abs(away) / np.array(sds)) ** 2) < 4.0


@pytest.mark.parametrize("clip", [0.97, 0.9])
def test_few_clipped_samples_of_a_short_dwell_are_seen(clip: float) -> None:
    """Of 37 samples three to ten at a limit: with no two others alike, that is no chance.  30 draws each."""
    rng = np.random.default_rng(12)
    truth = np.exp(1j * (0.4 - np.pi / 2))
    away, told = [], 0
    for _ in range(30):
        whole = dwell(rng, clip, 2, noise=0.003)
        record = Record(CHANNELS, whole.time[:37], whole.values[:37], F)
        told += bool(marked([record])[1])
        X, sd = amplitude(record)
        away.append(abs(X - truth) / sd)
    assert told == 30
    assert np.mean(np.array(away) ** 2) < 4.0  # 2 were sd exact; some 100 with the samples as they are


def test_a_converter_in_noise_has_no_limits() -> None:
    """200 dwells of 40 samples, 12 bits: its greatest code comes three times in some, by chance."""
    rng = np.random.default_rng(13)
    for _ in range(200):
        whole = dwell(rng, periods=2, noise=0.003)
        values = np.round(whole.values[:40] * 1024) / 1024
        assert marked([Record(CHANNELS, whole.time[:40], values, F)])[1] == []


def amplitude_as_measured(record: Record) -> complex:
    return complex(spectrum([record], refine="none").amplitudes[0, 0])


def test_a_slope_under_the_clipped_sine_stays_in_its_line() -> None:
    rng = np.random.default_rng(8)
    X, sd = amplitude(dwell(rng, 0.85, slope=0.1))
    assert abs(abs(X) - 1) < 5 * sd


def test_each_clipping_channel_is_told_with_its_samples() -> None:
    record = dwell(np.random.default_rng(9), 0.8)
    [clipped], [notice] = marked([record])
    count = int(np.sum(np.abs(record.values[:, 0]) == 0.8))
    assert (notice.code, notice.of) == ("unclipped", ("x1",))
    assert f"({count} samples)" in notice.text
    assert np.array_equal(clipped.values, record.values)
    at = np.where(np.abs(record.values[:, 0]) == 0.8, np.sign(record.values[:, 0]), 0)
    assert clipped.status is not None
    assert np.array_equal(clipped.status, np.stack([at, np.zeros(len(at))], axis=1))


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "limit"), [(0.02, 0.8), (0.1, 0.8), (0.05, 0.9)])
def test_a_clipped_sine_costs_what_the_censored_likelihood_says(noise: float, limit: float) -> None:
    """60 draws: error over stated sd, and stated over that of the samples below the limit alone."""
    rng = np.random.default_rng(17)
    truth = np.exp(1j * (0.4 - np.pi / 2))
    z2, below = [], []
    for _ in range(60):
        record = dwell(rng, limit, noise=noise)
        lines = spectrum([record])
        variance = lines.covariance[0, 0, 0].real
        z2.append(abs(lines.amplitudes[0, 0] - truth) ** 2 / variance)
        t = record.time[np.abs(record.values[:, 0]) < limit]
        A = np.stack([np.ones(len(t)), t, np.cos(2 * np.pi * F * t), np.sin(2 * np.pi * F * t)], axis=1)
        below.append(variance / (noise**2 * np.trace(np.linalg.inv(A.T @ A)[2:, 2:])))
    assert 0.55 < np.mean(z2) < 1.6  # 1 ± 0.13 where both axes are alike
    assert 0.4 < np.mean(below) < 1.0  # what is known of clipped samples helps


def unsettled(rng: np.random.Generator, periods: float, limit: float) -> tuple[Record, Real]:
    """A clipped dwell whose transient decays within two periods, and x1 as it would be without the limit."""
    t = np.arange(int(periods * EACH)) / (EACH * F)
    x = np.sin(2 * np.pi * F * t + 0.4) + 0.8 * np.exp(-t * F) * np.cos(1.4 * np.pi * F * t)
    noise = 0.005 * rng.normal(size=(2, len(t)))
    values = np.stack([np.clip(x + noise[0], -limit, limit), np.sin(2 * np.pi * F * t) + noise[1]], axis=1)
    return Record(CHANNELS, t, values, F), x


def test_what_stands_in_for_clipped_samples_follows_a_transient() -> None:
    """20 draws: a steady sine through seven periods is 0.24 off beside the transient, rms."""
    rng = np.random.default_rng(14)
    off = []
    for _ in range(20):
        record, motion = unsettled(rng, 8, 0.9)
        [clipped], notices = marked([record])
        assert len(notices) == 1
        values = expected(clipped).values[:, 0]
        off.append(np.sqrt(np.mean((values - motion)[values != record.values[:, 0]] ** 2)))
    assert np.mean(off) < 0.1


def test_whole_records_know_what_their_clipped_samples_do_not_tell() -> None:
    record, _ = unsettled(np.random.default_rng(15), 8, 0.9)
    (whole,) = spectrum([record]).stretches
    assert isinstance(whole, WholeRecord)
    (unmeasured,) = whole.unmeasured
    assert unmeasured.channel.name == "x1"
    assert np.array_equal(unmeasured.samples, np.flatnonzero(np.abs(record.values[:, 0]) == 0.9))
    # Next to the limit it is known that the signal is beyond it, else hardly more than from nothing
    sd = 1 / np.sqrt(np.diagonal(unmeasured.precision))
    assert np.min(sd) < 0.05
    assert np.max(sd) > 0.1


@pytest.mark.parametrize("limit", [0.8, np.inf])
def test_unsettled_dwells_of_few_periods_that_clip_are_in_doubt(limit: float) -> None:
    record, _ = unsettled(np.random.default_rng(16), 1.8, limit)
    notes = {note.code: note for note in spectrum([record]).notes}
    assert ("clipped_in_doubt" in notes) == np.isfinite(limit)
    if np.isfinite(limit):
        assert notes["clipped_in_doubt"].of == ("x1",)


def random_record(limit: float, noise: float, seed: int = 18) -> tuple[Record, Real]:
    """Thirty tones, of which x1 is clipped; and x1 without a limit."""
    rng = np.random.default_rng(seed)
    t = np.arange(1500) / 100
    hz, phase = rng.uniform(0.5, 6, 30), rng.uniform(0, 2 * np.pi, 30)
    x = np.cos(2 * np.pi * hz * t[:, None] + phase).sum(axis=1) + noise * rng.normal(size=len(t))
    u = np.sin(2 * np.pi * hz * t[:, None] + phase).sum(axis=1) + noise * rng.normal(size=len(t))
    return Record(CHANNELS, t, np.stack([np.clip(x, -limit, limit), u], axis=1)), x


@pytest.mark.slow
@pytest.mark.parametrize("noise", [pytest.param(0.05, marks=pytest.mark.long), 0.5])
def test_clipped_samples_of_a_whole_record_are_unknown_beyond_the_limit(noise: float) -> None:
    """What is put in is off by as much as is stated, of 40 draws."""
    z2, beyond, count = [], [], 0
    for seed in range(40):
        record, x = random_record(7.0, noise, seed)
        lines = whole_records([record])
        (whole,) = lines.stretches
        assert isinstance(whole, WholeRecord)
        (of,) = whole.unmeasured
        assert np.array_equal(of.samples, np.flatnonzero(np.abs(record.values[:, 0]) == 7.0))
        (clipped,), _ = marked_whole(record)
        likely, _ = with_likely(clipped)
        error = (x - likely.values[:, 0])[of.samples] - of.mean
        z2.append(error @ of.precision @ error)
        beyond.append(np.mean(np.abs(likely.values[of.samples, 0])))
        count += len(of.samples)
    assert 0.6 < np.sum(z2) / count < 1.5
    assert np.min(beyond) > 7.0
    assert [note.code for note in whole_records([record]).notes if note.code == "unclipped"] == ["unclipped"]


@pytest.mark.parametrize("kind", ["sound", "in step", "coarse", "mostly clipped", "repeats"])
def test_what_does_not_clip_or_tells_too_little_stays(kind: str) -> None:
    record = dwell(np.random.default_rng(10), 0.5 if kind == "mostly clipped" else np.inf)
    values = record.values
    if kind == "in step":  # the sine without noise is at its greatest once in each period
        values = dwell(np.random.default_rng(10), noise=0.0).values
    if kind == "coarse":
        values = np.round(values * 16) / 16
    if kind == "repeats":
        values = np.stack([values, values])
    record = Record(CHANNELS, record.time, values, F)
    assert marked([record]) == ([record], [])


@pytest.mark.slow
def test_dwells_of_one_period_and_few_samples_show_that_they_clip() -> None:
    """Sixteen samples, ten of them measured: all had counted as measured, and values were ten deviations off."""
    rng = np.random.default_rng(3)
    t = np.arange(16) / (15 * F)
    away, marks = [], 0
    for _ in range(60):
        phase = rng.uniform(0, 2 * np.pi)
        y = np.stack([np.cos(2 * np.pi * F * t + phase), np.sin(2 * np.pi * F * t)], axis=1)
        y = np.clip(y + 0.01 * rng.normal(size=(16, 2)), [-0.8, -2.0], [0.8, 2.0])
        lines = spectrum([Record(CHANNELS, t, y, F)])
        marks += "unclipped" in [note.code for note in lines.notes]
        away.append(
            (lines.amplitudes[0, 0] - np.exp(1j * phase)) / np.sqrt(lines.covariance[0, 0, 0].real / 2)
        )
    assert marks == 60
    assert np.mean(np.abs(away) ** 2) < 2 * 2.5  # of t² with some six degrees of freedom 2 · 1.5
