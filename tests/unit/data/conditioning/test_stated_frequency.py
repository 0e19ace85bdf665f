"""Whether records move where it is stated: refused elsewhere, refined by evidence, left alone otherwise."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.data.conditioning.drive_frequency import at_drive_frequencies, moves_elsewhere
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.errors import DataError
from tests import rigs
from tests.unit.data.conditioning.signals import X1, U

RIG = rigs.paper_rig()
CHANNELS = rigs.channels(RIG, (Quantity.DISPLACEMENT,))


def dwells(seed: int, *, noise: float = 0.1, periods: float = 4.0, stated: float = 1.0) -> list[Record]:
    """25 dwells of the paper's rig, their frequencies stated `stated` times too high."""
    rng = np.random.default_rng(seed)
    records = rigs.records(RIG, CHANNELS, rng, samples=int(16 * periods), periods=periods, relative=noise)
    return [replace(r, frequency_hz=stated * (r.frequency_hz or 0.0)) for r in records]


def test_radians_per_second_are_refused_and_named() -> None:
    with pytest.raises(DataError) as refused:
        spectrum(dwells(1, periods=20.0, stated=2 * np.pi))
    assert len(refused.value.problems) == 1
    assert "25 of 25 dwells alike" in str(refused.value)
    assert "is stated, but the response is at" in str(refused.value)
    assert "rad/s?" in str(refused.value)


@pytest.mark.parametrize("periods", [10.0, 20.0])
def test_revolutions_per_minute_are_named_beyond_half_the_sampling_rate(periods: float) -> None:
    """16 samples a period: 60 times the frequency folds to a quarter of the rate, where nothing moves."""
    with pytest.raises(DataError, match=r"is stated, but") as refused:
        spectrum(dwells(1, periods=periods, stated=60.0))
    assert len(refused.value.problems) == 1


def test_dwells_sampled_below_their_frequency_move_where_it_folds_to() -> None:
    """Every sixteenth sample and a bit: the drive is seen at a fraction of its frequency."""
    records = [
        replace(r, time=np.arange(len(r.time)) * 1.3 / (r.frequency_hz or 1.0))
        for r in dwells(1, periods=20.0)
    ]
    rng = np.random.default_rng(2)
    turns = [2 * np.pi * (r.frequency_hz or 0.0) * r.time for r in records]
    moving = [
        replace(r, values=np.cos(turn)[:, None] + 0.05 * rng.normal(size=(len(turn), 3)))
        for r, turn in zip(records, turns, strict=True)
    ]
    assert [moves_elsewhere(record) for record in moving] == [None] * 25


def test_a_time_base_twice_too_fast_is_refused() -> None:
    with pytest.raises(DataError, match="wrong by the factor"):
        spectrum(dwells(2, periods=10.0, stated=2.0))


def test_a_mislabelled_dwell_is_named_alone() -> None:
    records = dwells(3, periods=10.0)
    records[7] = replace(records[7], frequency_hz=1.3 * (records[7].frequency_hz or 0.0), source="run8.csv")
    with pytest.raises(DataError, match=r"run8.csv: .* is stated") as refused:
        spectrum(records)
    assert len(refused.value.problems) == 1
    assert spectrum(records, refine="none").lines == 25


def test_noise_and_dead_channels_are_no_motion_elsewhere() -> None:
    """2,000 records of noise alone: none dominated by one line of 64 samples, whatever is stated."""
    rng = np.random.default_rng(4)
    t = np.arange(64) / 64
    noise = [Record(CHANNELS, t, rng.normal(size=(64, 3)), 5.0) for _ in range(200)]
    assert [moves_elsewhere(record) for record in noise] == [None] * 200
    assert moves_elsewhere(Record(CHANNELS, t, np.zeros((64, 3)), 5.0)) is None


def test_one_ratio_of_clocks_is_found_and_taken_out() -> None:
    records = dwells(5, noise=0.02, periods=10.0, stated=1.004)
    lines = spectrum(records)
    np.testing.assert_allclose(lines.frequency_hz, RIG.frequency_hz, rtol=2e-5)
    assert [note.code for note in lines.notes] == ["clock_refined", "settled_dwells"]


def test_dwells_of_little_more_than_a_period_show_their_clock_together() -> None:
    refined, notes = at_drive_frequencies(dwells(7, noise=0.02, periods=1.25, stated=1.02))
    assert [note.code for note in notes] == ["clock_refined"]
    np.testing.assert_allclose([r.frequency_hz for r in refined], RIG.frequency_hz, rtol=2e-3)  # 4 sd
    # Alone they get no frequency of their own: a transient looks the same.
    some = dwells(8, noise=0.02, periods=1.25)
    for k in range(0, 25, 3):
        some[k] = replace(some[k], frequency_hz=(1 + 0.04 * (-1) ** k) * (some[k].frequency_hz or 0.0))
    assert at_drive_frequencies(some) == (some, [])
    right = dwells(9, noise=0.05, periods=1.25)
    assert at_drive_frequencies(right) == (right, [])


def test_one_dwell_gets_a_frequency_of_its_own() -> None:
    records = dwells(6, noise=0.02, periods=10.0)
    records[3] = replace(records[3], frequency_hz=1.01 * (records[3].frequency_hz or 0.0))
    lines = spectrum(records)
    assert lines.frequency_hz[3] == pytest.approx(RIG.frequency_hz[3], rel=1e-3)
    assert [note.code for note in lines.notes] == ["frequency_refined", "settled_dwells"]


@pytest.mark.slow
def test_frequencies_that_are_right_are_left_alone() -> None:
    """60 tests of 25 dwells, p < 1e-3 each: at most one false alarm with a probability of 0.998."""
    alarms = sum(at_drive_frequencies(right)[0] != right for right in (dwells(100 + k) for k in range(60)))
    assert alarms <= 1


def test_a_transient_of_one_channel_is_no_frequency_of_the_drive() -> None:
    """A free motion near the drive turns one channel's phase; the drive itself, and the others, do not move."""
    rng = np.random.default_rng(3)
    time = np.arange(400) / 200
    records = []
    for f in (4.6, 5.0, 5.4):
        drive = np.sin(2 * np.pi * f * time)
        free = 0.5 * np.exp(-0.8 * time) * np.cos(2 * np.pi * 5.2 * time)
        values = np.stack([3 * drive + free, drive], axis=-1) + 0.002 * rng.normal(size=(400, 2))
        records.append(Record((X1, U), time, values, f))
    assert [record.frequency_hz for record in at_drive_frequencies(records)[0]] == [4.6, 5.0, 5.4]
