"""Samples in which a channel holds a value while the motion goes on are unknown in whole records."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.data.conditioning.unmeasured import marked_whole
from dashpot.data.conditioning.whole_record import whole_records
from dashpot.data.record import Record
from dashpot.data.spectrum import WholeRecord

CHANNELS = (Channel("x", {"x": 1.0}), Channel("f", {"f": 1.0}, Quantity.FORCE))
N = 2000


def moving(seed: int = 0, *, bits: int = 12, noise: float = 0.01) -> Real:
    """A motion of many tones and noise through a converter, (samples,)."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.5, 12, 30), rng.uniform(0, 6.3, 30)
    time = np.arange(N)[:, None] / 100
    x = np.sum(np.cos(2 * np.pi * f * time + phase), axis=1)
    x += noise * np.std(x) * rng.standard_normal(N)
    step = 2 * np.max(np.abs(x)) / 2**bits
    return np.asarray(step * np.round(x / step))


def record(x: Real, f: Real | None = None) -> Record:
    force = moving(1) if f is None else f
    return Record(CHANNELS, np.arange(N) / 100, np.column_stack([x, force]), source="run.csv")


@pytest.mark.parametrize("value", ["held", "zero"])
def test_samples_held_are_unknown_and_the_record_stays_whole(value: str) -> None:
    x = moving()
    x[800:950] = x[800] if value == "held" else 0.0
    (part,), (note,) = marked_whole(record(x))
    assert part.status is not None
    assert np.array_equal(np.flatnonzero(part.status[:, 0]), np.arange(800, 950))
    assert not np.any(part.status[:, 1])
    assert (note.code, note.of) == ("held_samples", ("x",))
    assert note.text.startswith("run.csv: x holds one value for 150 samples, first at 8 s")
    lines = whole_records([record(x)])
    (whole,) = lines.stretches
    assert isinstance(whole, WholeRecord)
    assert [len(of.samples) for of in whole.unmeasured] == [150]
    assert any(told.code == "held_samples" for told in lines.notes)


def test_the_record_is_cut_where_too_many_samples_are_held() -> None:
    x, count = np.concatenate([moving(seed) for seed in range(4)]), 700
    x[800 : 800 + count] = x[800]
    long = Record(CHANNELS, np.arange(4 * N) / 100, np.column_stack([x, x[::-1]]), source="run.csv")
    parts, (note,) = marked_whole(long)
    assert [len(part.time) for part in parts] == [800, 4 * N - 800 - count]
    assert "split into 2 segments" in note.text


def test_what_rests_for_a_reason_is_left_alone() -> None:
    """A held drive, a limit, a coarse converter, a motion that dies away, a record that begins at rest."""
    dying = 0.01 * np.round(100 * moving(2) * np.exp(-np.arange(N) / 150))
    begun = moving(3)
    begun[:150] = 0.0
    for sound in (
        record(moving(), np.repeat(moving(1)[::100], 100)),
        record(np.clip(moving(), -5, 5)),
        record(moving(bits=3)),
        record(dying),
        record(begun),
        record(np.where(np.arange(N) % 400 < 60, 0.0, moving())),
    ):
        parts, notes = marked_whole(sound)
        assert len(parts) == 1
        assert {note.code for note in notes} <= {"unclipped"}


@pytest.mark.slow
def test_no_clean_record_is_cut() -> None:
    for seed in range(40):
        for bits in (6, 8, 12, 24):
            assert marked_whole(record(moving(seed, bits=bits, noise=0.0)))[1] == ()


def test_repeats_stay_as_they_are() -> None:
    one = record(moving())
    two = replace(one, values=np.stack([one.values, one.values]))
    assert marked_whole(two) == ([two], ())


def test_a_spike_is_unknown_and_peaks_that_a_blow_makes_are_not() -> None:
    x = moving()
    x[[700, 1500]] += 8.0, -9.0
    (part,), (note,) = marked_whole(record(x))
    assert part.status is not None
    assert np.argwhere(part.status).tolist() == [[700, 0], [1500, 0]]
    assert (note.code, note.of) == ("dropouts", ("x",))
    lines = whole_records([record(x)], marks=False)
    assert not any(told.code == "dropouts" for told in lines.notes)
    # A blow of two samples, and the acceleration of a stiff mass that follows it
    blow = np.zeros(N)
    blow[400:402] = 50.0, 30.0
    rng = np.random.default_rng(4)
    answer = np.convolve(blow, np.exp(-np.arange(50) / 2) * np.cos(np.arange(50)))[:N] + 0.01 * rng.normal(
        size=N
    )
    assert marked_whole(record(answer, blow + 0.01 * rng.normal(size=N)))[1] == ()
    # Nor a force's own, and an event that all channels show
    assert marked_whole(record(moving(), blow))[1] == ()
    both = np.column_stack([moving(), moving(3)])
    both[900] += 20.0
    motions = replace(record(x), values=both, channels=(CHANNELS[0], Channel("y", {"y": 1.0})))
    assert marked_whole(motions)[1] == ()


def test_a_spike_moves_no_line_by_more_than_noise() -> None:
    """One sample off by eight times the motion: lines of the record with it marked are those without, but for noise."""
    x = moving(noise=0.001)
    spoilt = np.array(x)
    spoilt[1234] += 30.0
    clean, marked, as_is = (
        whole_records([record(of)], band_hz=(0.5, 12.0), marks=marks)
        for of, marks in ((x, True), (spoilt, True), (spoilt, False))
    )
    size = np.median(np.abs(clean.amplitudes[:, 0]))
    off = [np.max(np.abs(of.amplitudes - clean.amplitudes)[:, 0]) / size for of in (marked, as_is)]
    assert off[0] < 0.02 * off[1]


def test_a_step_is_no_spike() -> None:
    """Of a channel whose clock slips one sample departs as far as of a spike; beside it the next does as well."""
    time = np.arange(2000) / 500
    values = np.stack([np.sin(2 * np.pi * 1.3 * time), np.cos(2 * np.pi * 1.3 * time)], axis=1)
    values += 0.002 * np.random.default_rng(4).standard_normal(values.shape)
    channels = (Channel("x", {"x": 1.0}), Channel("u", {"u": 1.0}))
    for slipped, missed in ((True, 0), (False, 1)):
        shown = np.array(values)
        shown[1000 : None if slipped else 1001, 0] += 1.0
        (part,), _ = marked_whole(Record(channels, time, shown))
        assert np.count_nonzero(part.marks()) == missed
