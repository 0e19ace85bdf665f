"""Samples to lines of a whole record: scaling, noise, delays, gaps, the band, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.conditioning.whole_record import whole_record, whole_records, without_gaps
from dashpot.data.noise import noise_at_rest
from dashpot.data.record import Record
from dashpot.data.spectrum import WholeRecord
from dashpot.errors import DataError

A, B = Channel("a", {"a": 1.0}), Channel("b", {"b": 1.0})


def record(values: Real, step: float = 0.01, channels: tuple[Channel, ...] = (A, B)) -> Record:
    return Record(channels, step * np.arange(len(values)), values)


def resonant(samples: int, rng: np.random.Generator) -> Real:
    """Two channels that move below 10 Hz, rising and falling, sampled at 100 Hz, with white noise of 0.2."""
    f = rng.uniform(0.5, 10, 40)
    t = 0.01 * np.arange(samples)
    moving = np.cos(2 * np.pi * f[:, None] * t + rng.uniform(0, 6, 40)[:, None])
    rise = np.sin(np.pi * np.arange(samples) / samples)[:, None] ** 4
    both = np.stack([moving.sum(0), 0.3 * (moving * f[:, None]).sum(0)], axis=-1)
    return rise * both + 0.2 * rng.normal(size=(samples, 2))


def test_peak_amplitudes_and_an_offset_that_is_left_out() -> None:
    t = 0.01 * np.arange(1000)
    values = np.stack([3 + 2 * np.cos(2 * np.pi * 4 * t + 0.3), np.cos(2 * np.pi * 7 * t)], axis=-1)
    lines = whole_record(record(values), band_hz=(0.05, 20))
    assert lines.stretches == (WholeRecord(10.0, 1000),)
    assert lines.frequency_hz[0] == pytest.approx(0.1)
    at = int(np.argmin(np.abs(lines.frequency_hz - 4)))
    assert lines.amplitudes[at, 0] == pytest.approx(2 * np.exp(0.3j), abs=1e-12)
    others = np.delete(np.abs(lines.amplitudes[:, 0]), at)
    assert np.max(others) < 1e-12


def test_white_noise_has_four_times_its_variance_over_samples() -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(20000, 2)) * [1.0, 0.3]
    lines = whole_record(record(noise), band_hz=(1, 40))
    power = np.mean(np.abs(lines.amplitudes) ** 2, axis=0)
    np.testing.assert_allclose(power, 4 * np.array([1.0, 0.09]) / 20000, rtol=0.05)  # 4 sd of 7,800 lines


def test_what_moves_at_half_the_sampling_rate_is_said() -> None:
    """A half sine of six samples, sampled as it is; beside it one of sixty, and resonances under white noise."""
    rng = np.random.default_rng(3)
    samples = 4000
    blows = np.zeros((samples, 2))
    for c, length in enumerate((6, 60)):
        blows[500 : 500 + length, c] = np.sin(np.pi * (np.arange(length) + 0.3) / length)
    said = whole_records([record(blows + 1e-3 * rng.normal(size=blows.shape))])
    assert [note.of for note in said.notes if note.code == "folded"] == [("a",)]
    resonances = whole_records([record(resonant(samples, rng))])
    assert "folded" not in {note.code for note in resonances.notes}


def test_the_floor_of_the_noise_is_found() -> None:
    lines = whole_record(record(resonant(4000, np.random.default_rng(2))))
    assert set(lines.noise) == {"floor"}
    floor = np.diagonal(lines.covariance[0]).real
    np.testing.assert_allclose(floor, 4 * 0.04 / 4000, rtol=0.15)  # 4 sd of 760 lines


def test_ends_that_lie_apart_are_no_noise() -> None:
    """They leak into all lines: of the first channel a twentieth of what they leak is noise, of the second nothing."""
    rng = np.random.default_rng(4)
    t = 0.01 * np.arange(1000)
    moving = np.stack([np.sin(2 * np.pi * 0.33 * t + phase) for phase in (0.2, 1.5)], axis=-1)
    assert np.all(np.abs(moving[-1] - moving[0]) > 0.5)
    lines = whole_record(record(moving + rng.normal(size=(1000, 2)) * [2e-3, 0.0]))
    floor = np.diagonal(lines.covariance[0]).real
    assert floor[0] == pytest.approx(4 * 4e-6 / 1000, rel=0.5)  # 4 sd of 190 lines that share neighbours
    assert floor[1] < 1e-3 * floor[0]
    assert "folded" not in {note.code for note in lines.notes}


def test_lines_end_where_nothing_moves_any_more() -> None:
    lines = whole_record(record(resonant(4000, np.random.default_rng(3))))
    assert 10.0 <= lines.frequency_hz[-1] < 13.0


def test_noise_of_a_record_at_rest() -> None:
    rng = np.random.default_rng(4)
    coloured = np.cumsum(rng.normal(size=(30000, 2)), axis=0)
    coloured[1:] -= 0.9 * coloured[:-1]  # not white, and the second channel shares half of the first one's
    coloured[:, 1] += 0.5 * coloured[:, 0]
    still = record(coloured - np.linspace(0, 1, 30000)[:, None] * (coloured[-1] - coloured[0]))
    moving = record(resonant(4000, rng))
    lines = whole_record(moving, band_hz=(2, 10), still=noise_at_rest([still]))
    assert set(lines.noise) == {"rest"}
    assert np.all(lines.dof == 122)
    V = lines.covariance
    share = V[:, 0, 1].real / V[:, 0, 0].real
    assert np.mean(share) == pytest.approx(0.5, abs=0.1)
    again = whole_record(still, band_hz=(2, 10))
    power = np.mean(np.abs(again.amplitudes[:, 0]) ** 2) * 30000 / 4000
    assert np.mean(V[:, 0, 0].real) == pytest.approx(power, rel=0.1)


def test_a_late_channel_is_shifted() -> None:
    values = resonant(2000, np.random.default_rng(5))
    late = np.array(values)
    late[7:, 1] = values[:-7, 1]
    channels = (A, replace(B, delay=0.073))
    shifted = whole_record(record(late, channels=channels), band_hz=(1, 9))
    plain = whole_record(record(values[:1993]), band_hz=(1, 9))
    turn = np.exp(2j * np.pi * plain.frequency_hz * 0.003)  # what is left of seven samples
    np.testing.assert_allclose(shifted.amplitudes[:, 0], plain.amplitudes[:, 0], atol=1e-12)
    np.testing.assert_allclose(shifted.amplitudes[:, 1], plain.amplitudes[:, 1] * turn, atol=1e-12)


def test_gaps_make_records() -> None:
    whole = record(resonant(3000, np.random.default_rng(6)))
    keep = np.r_[0:1000, 1200:1230, 1300:3000]
    cut = replace(whole, time=whole.time[keep], values=whole.values[keep])
    pieces, notes = without_gaps(cut)
    assert [len(piece.time) for piece in pieces] == [1000, 1700]
    assert "samples are missing before 12 s, 13 s" in notes[0].text
    assert "30 samples of short segments" in notes[0].text
    lines = whole_records([cut], band_hz=(1, 9))
    assert len(lines.records) == 2
    assert "2 continuous records" in lines.notes[-1].text


def test_few_missing_samples_are_unknown_in_one_record() -> None:
    whole = record(resonant(3000, np.random.default_rng(6)))
    keep = np.r_[0:1000, 1010:1300, 1301:3000]
    cut = replace(whole, time=whole.time[keep], values=whole.values[keep])
    (piece,), (note,) = without_gaps(cut)
    assert piece.status is not None
    gone = np.setdiff1d(np.arange(3000), keep)
    assert np.array_equal(np.flatnonzero(piece.status[:, 1]), gone)
    np.testing.assert_allclose(piece.time, whole.time)
    assert "11 samples missing before 10.1 s, 13.01 s" in note.text
    lines, every = whole_records([cut], band_hz=(1, 9)), whole_records([whole], band_hz=(1, 9))
    assert len(lines.records) == 1
    # What is put in is as likely as the motion beside: amplitudes are off by little of their size
    off = np.abs(lines.amplitudes - every.amplitudes)
    assert np.all(np.sum(off**2, axis=0) < 3e-3 * np.sum(np.abs(every.amplitudes) ** 2, axis=0))


def test_a_clock_that_slips_makes_records() -> None:
    whole = record(resonant(3000, np.random.default_rng(6)))
    late = whole.time + 0.003 * (whole.time > 9.995)
    lines = whole_records([replace(whole, time=late)], band_hz=(1, 9))
    assert len(lines.records) == 2
    assert "the clock slips before 10.003 s: split into 2 segments" in lines.notes[0].text
    rounded = np.round(np.arange(3000) / 64, 2)
    assert len(without_gaps(replace(whole, time=rounded))[0]) == 1


def refused(values: Real, message: str, **how: object) -> None:
    with pytest.raises(DataError, match=message):
        whole_record(record(values), **how)  # type: ignore[arg-type]


def test_refusals() -> None:
    rng = np.random.default_rng(7)
    values = resonant(2000, rng)
    refused(values, "no line of the record lies between 60 and 70 Hz", band_hz=(60.0, 70.0))
    refused(values[:7], "a record of 7 samples")
    still = np.array(values)
    still[:, 1] = 4.0
    refused(still, "b stays at 4 throughout")
    refused(rng.normal(size=(5000, 2)), "no signal above")
    time = np.sort(rng.uniform(0, 20, 2000))
    with pytest.raises(DataError, match="the samples are not evenly"):
        whole_record(Record((A, B), time, values))


def test_a_band_in_which_nothing_moves_is_named_with_that_in_which_something_does() -> None:
    rng = np.random.default_rng(8)
    time = np.arange(4000) * 0.01
    driven = np.sin(2 * np.pi * np.arange(1, 6, 0.1) * time[:, None]).sum(axis=1)
    values = np.column_stack([driven + 0.1 * rng.normal(size=4000), driven])
    refused(
        values,
        r"no motion above the noise between 20 and 40 Hz, .* between 0.\d+ and [67]",
        band_hz=(20.0, 40.0),
    )
    assert whole_record(record(values), band_hz=(2.0, 40.0)).lines == 1521
    assert whole_record(record(values), band_hz=(2.9, 3.1)).lines == 9


def test_a_band_of_very_many_lines_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dashpot.data.conditioning.whole_record.MANY_LINES", 100)
    long = record(resonant(4000, np.random.default_rng(1)))
    assert "many_lines" in [note.code for note in whole_records([long]).notes]
    assert "many_lines" not in [note.code for note in whole_records([long], band_hz=(0.5, 10)).notes]
