"""Clocks of sensors: offset and drift against those that made the data, with intervals that hold them."""

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.clocks import Clock, ClockedRecords, Sensor, aligned_sensors, clocked_lines, estimated_clock
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.record import Record
from dashpot.errors import DataError

A, B = (Channel(name, {name: 1}, Quantity.ACCELERATION) for name in ("a", "b"))


def band_limited(rng, length=60.0, highest=8.0):
    """A random motion as a function of time."""
    count = int(length * highest)
    f = rng.uniform(0.2, highest, count)
    X = rng.normal(size=count) + 1j * rng.normal(size=count)
    return lambda t: np.cos(2 * np.pi * np.outer(t, f) + np.angle(X)) @ np.abs(X) / np.sqrt(count)


def sensors(rng, motion, offset, drift, noise=0.02, rate=(100.0, 90.0)):
    t = np.arange(0, 60, 1 / rate[0])
    own = np.arange(-3.0, 52.0, 1 / rate[1])
    true = own + offset + drift * (own - np.mean(own))
    first = motion(t) + noise * rng.normal(size=len(t))
    second = 1.3 * motion(true) + noise * rng.normal(size=len(own))
    return Sensor("first", (A,), t, first[:, None]), Sensor("second", (B,), own, second[:, None])


@pytest.mark.slow
def test_offset_and_drift_are_found_with_their_uncertainty():
    """30 recordings: mean of (error/sd)² is 1 with a standard error of 26 %; interpolation adds a little."""
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(30):
        motion = band_limited(rng)
        offset, drift = rng.uniform(1, 6), rng.uniform(-5e-5, 5e-5)
        reference, sensor = sensors(rng, motion, offset, drift)
        clock = estimated_clock(reference, sensor, "test")
        at = clock.middle
        expected = offset + drift * (at - np.mean(sensor.time))
        errors.append(((clock.offset - expected) / clock.offset_sd, (clock.drift - drift) / clock.drift_sd))
        assert abs(clock.offset - expected) < 2e-3
        assert clock.offset_sd < 1e-3
    assert np.mean(np.square(errors), axis=0) == pytest.approx([1, 1], abs=0.78)  # 3 standard errors


def test_a_single_sine_cannot_set_a_clock():
    rng = np.random.default_rng(5)
    reference, sensor = sensors(rng, lambda t: np.sin(2 * np.pi * t), 1.0, 0.0)
    with pytest.raises(DataError, match="repeats itself too"):
        estimated_clock(reference, sensor, "test")


def test_sensors_that_see_nothing_alike():
    rng = np.random.default_rng(6)
    t = np.arange(0, 60, 0.01)
    noise = [Sensor(n, (c,), t, rng.normal(size=(6000, 1))) for n, c in (("one", A), ("two", B))]
    with pytest.raises(DataError, match="cannot be synchronised"):
        estimated_clock(*noise, "test")


def test_aligned_sensors_give_the_amplitudes_of_one_clock():
    rng = np.random.default_rng(7)
    rough = band_limited(rng, highest=5.0)

    def motion(t):
        return rough(t) + 0.7 * np.cos(2 * np.pi * 7 * t)

    reference, sensor = sensors(rng, motion, 2.5, 2e-5)
    joint, notes = aligned_sensors([reference, sensor], 7.0, 3, "test")
    assert [note.code for note in notes] == ["clock_estimated"]
    lines = clocked_lines(joint, Conditioning(harmonics="none"))
    assert lines.experiment.tolist() == [3]
    ratio = lines.amplitudes[0, 1] / lines.amplitudes[0, 0]
    assert abs(ratio) == pytest.approx(1.3, rel=0.01)
    phase_sd = np.sqrt(lines.covariance[0, 1, 1].real / 2) / abs(lines.amplitudes[0, 1])
    assert abs(np.angle(ratio)) < 4 * phase_sd + 0.01
    assert phase_sd >= 2 * np.pi * 7 * joint.clocks[1].sd_over(joint.parts[1].time) / np.sqrt(2) * 0.99


def test_one_clock_is_as_one_record():
    rng = np.random.default_rng(8)
    t = np.arange(1000) / 100
    y = np.stack([np.cos(6 * np.pi * t), np.sin(6 * np.pi * t)], axis=-1) + 0.1 * rng.normal(size=(1000, 2))
    parts = tuple(Record((c,), t, y[:, i : i + 1], 3.0) for i, c in enumerate((A, B)))
    settings = Conditioning(harmonics="none", noise="white", refine="auto")
    split = clocked_lines(ClockedRecords(parts, (Clock(), Clock())), settings)
    whole = spectrum([Record((A, B), t, y, 3.0)], settings)
    assert split.amplitudes == pytest.approx(whole.amplitudes, rel=1e-3)
    diagonal = np.diagonal(whole.covariance[0]).real
    assert np.diagonal(split.covariance[0]).real == pytest.approx(diagonal, rel=1e-2)
    with pytest.raises(DataError, match="no common sample times"):
        clocked_lines(ClockedRecords(parts, (Clock(), Clock())), Conditioning(moments=True))
    with pytest.raises(DataError, match="drive frequency is not known"):
        clocked_lines(ClockedRecords((Record((A,), t, y[:, :1]),), (Clock(),)), settings)


def test_a_sensor_that_clips_is_used_by_its_other_samples():
    rng = np.random.default_rng(8)
    t = np.arange(2000) / 100
    first = np.cos(6 * np.pi * t) + 0.02 * rng.normal(size=2000)
    second = np.clip(np.sin(6 * np.pi * (t + 0.003)) + 0.02 * rng.normal(size=2000), -0.7, 0.7)
    parts = tuple(Record((c,), x, y[:, None], 3.0) for c, x, y in ((A, t, first), (B, t + 0.003, second)))
    lines = clocked_lines(ClockedRecords(parts, (Clock(), Clock())), Conditioning())
    assert [note.code for note in lines.notes] == ["unclipped"]
    sd = np.sqrt(np.diagonal(lines.covariance[0]).real)
    assert np.all(np.abs(np.abs(lines.amplitudes[0]) - 1) < 3 * sd)
    assert sd[0] < sd[1] < 3 * sd[0]


LAG = 1.0  # rad, by which the second point of a rig moves behind the first one


def of_a_rig(rng):
    """Two sensors shaken together for ten seconds, then at points of a rig that is driven at 4 Hz; the true offset."""
    together, offset, drift = band_limited(rng, highest=12.0), rng.uniform(1, 4), rng.uniform(-3e-5, 3e-5)
    f = 8 * np.pi
    t, own = np.arange(0, 30, 1 / 120), np.arange(-0.5, 25, 1 / 117.3)
    true = own + offset + drift * (own - np.mean(own))
    driven = [3 * np.sin(f * t), 3 * np.sin(f * true - LAG)]
    values = [
        np.where(each < 10, together(each), np.where(each > 11, sine, 0.0))
        + 0.03 * rng.normal(size=len(each))
        for each, sine in zip((t, true), driven, strict=True)
    ]
    first, second = (
        Sensor(c.name, (c,), x, y[:, None]) for c, x, y in zip((A, B), (t, own), values, strict=True)
    )
    return first, second


def test_phases_of_a_rig_are_not_taken_for_an_offset_of_clocks():
    """Aligned by the whole recording, the second point would be in phase with the first: ten degrees are refused."""
    for seed in range(5):
        first, second = of_a_rig(np.random.default_rng(seed))
        with pytest.raises(DataError, match=r"too regularly.*align_s"):
            aligned_sensors([first, second], 4.0, 0, "test")


@pytest.mark.slow
def test_a_drive_louder_than_the_shaking_hides_no_clock():
    """Near its resonance a point moves 30 times as much as the shaking, and rests on another offset."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        together, offset = band_limited(rng, highest=20.0), rng.uniform(-5, 5)
        t, own = np.arange(0, 35, 1 / 200), np.arange(0.3, 35, 1 / 199.3)
        first, second = (
            np.where(
                each < 10, together(each), np.where(each > 11, X * np.cos(2 * np.pi * 3.5 * each) + g, 0)
            )
            + 0.2 * rng.normal(size=len(each))
            for each, X, g in ((t, 1.0, 0.0), (own, 30.0, 9.8))
        )
        sensors = Sensor("a", (A,), t, first[:, None]), Sensor("b", (B,), own - offset, second[:, None])
        joint, _ = aligned_sensors(sensors, 3.5, 0, "test", (0.2, 9.8))
        clock = joint.clocks[1]
        assert abs(clock.offset - offset) < 4 * clock.offset_sd + 1e-3
        # Times count from the start of the first sensor's recording, as align_s does.
        assert joint.parts[1].time[0] == pytest.approx(0.3, abs=0.02)


@pytest.mark.slow
def test_sensors_shaken_together_keep_the_phases_of_the_rig():
    """12 recordings: mean of (error/sd)² of the phase is 1, with a standard error of 41 %, or less."""
    settings = Conditioning(harmonics="none", settle=12.0)
    errors = []
    for seed in range(12):
        first, second = of_a_rig(np.random.default_rng(100 + seed))
        joint, _ = aligned_sensors([first, second], 4.0, 0, "test", (0.2, 9.5))
        lines = clocked_lines(joint, settings)
        X, V = lines.amplitudes[0], lines.covariance[0]
        sd = np.sqrt(sum(V[k, k].real / 2 / abs(X[k]) ** 2 for k in range(2)))
        errors.append(np.angle(X[1] / X[0] * np.exp(1j * LAG)) / sd)
        assert abs(X[1] / X[0]) == pytest.approx(1, abs=0.01)
        assert sd < np.radians(3)
    assert np.mean(np.square(errors)) < 1 + 3 * 0.41
    with pytest.raises(DataError, match=r"0 samples of a in align_s"):
        aligned_sensors([first, second], 4.0, 0, "test", (100.0, 110.0))
