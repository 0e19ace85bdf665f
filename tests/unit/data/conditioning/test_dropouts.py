"""Samples that a channel missed within a dwell are told by their one value and replaced by the motion around them."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.unmeasured import marked
from dashpot.data.record import Record
from tests.unit.data.conditioning.signals import X1, U, wave

SIZE, NOISE = 1.0 - 0.4j, 0.01


def dwell(seed: int, *, missed: str = "", f: float = 3.0, each: int = 40, periods: int = 12) -> Record:
    """A noisy sine in two channels, of which the first holds a value or reads 0 for two short whiles."""
    rng = np.random.default_rng(seed)
    t = np.arange(each * periods) / (each * f)
    values = wave(t, f, [SIZE, 1.0]) + NOISE * rng.normal(size=(len(t), 2))
    for begin, end in ((103, 115), (301, 306)):
        if missed:
            values[begin:end, 0] = values[begin - 1, 0] if missed == "held" else 0.0
    return Record((X1, U), t, values, f)


@pytest.mark.parametrize("missed", ["held", "zero"])
def test_missed_samples_cost_no_more_than_their_number(missed: str) -> None:
    lines = [spectrum([dwell(seed, missed=missed)]) for seed in range(30)]
    assert all([note.code for note in of.notes if note.code == "dropouts"] == ["dropouts"] for of in lines)
    error = np.array([of.amplitudes[0, 0] - SIZE for of in lines])
    stated = np.array([of.covariance[0, 0, 0].real for of in lines])
    # 60 numbers: their mean square is within a factor of 1 ± 0.5 but for six cases in a thousand; the seeds are fixed.
    assert np.mean(np.abs(error) ** 2) == pytest.approx(float(np.mean(stated)), rel=0.5)
    assert np.mean(stated) == pytest.approx(2 * NOISE**2 * 2 / 480, rel=0.1)
    as_they_are = spectrum([dwell(0, missed=missed)], refine="none")
    assert abs(as_they_are.amplitudes[0, 0] - SIZE) > 10 * np.sqrt(np.mean(stated))


def test_the_notice_says_channel_dwell_and_how_many() -> None:
    [record], [notice] = marked([dwell(1, missed="zero")])
    assert record.status is not None
    assert np.flatnonzero(record.status[:, 0]).tolist() == [*range(103, 115), *range(301, 306)]
    assert notice.of == ("x1",)
    assert notice.text.startswith("x1 has 17 missing samples in the dwell at 3 Hz (")


def test_a_spike_is_a_sample_that_is_missed() -> None:
    """Two spikes of half the amplitude, fifty deviations: the amplitude is that of the samples beside them."""
    sound = dwell(3)
    values = np.array(sound.values)
    values[[77, 310], 0] += 0.5
    lines, whole = spectrum([replace(sound, values=values)]), spectrum([sound])
    assert [note.of for note in lines.notes if note.code == "dropouts"] == [("x1",)]
    sd = np.sqrt(whole.covariance[0, 0, 0].real)
    assert abs(lines.amplitudes[0, 0] - whole.amplitudes[0, 0]) < 0.3 * sd
    assert lines.covariance[0, 0, 0].real == pytest.approx(sd**2, rel=0.1)


def test_knocks_of_every_period_are_motion() -> None:
    sound = dwell(3)
    values = np.array(sound.values)
    values[7::40, 0] += 0.5
    assert marked([replace(sound, values=values)])[1] == []


def rounded(y: Real) -> Real:
    """To a twentieth of the amplitude: several samples in a row are alike at each turning point."""
    return np.round(y / 0.05) * 0.05


def clipped(y: Real) -> Real:
    """At 80 % of the amplitude."""
    return np.clip(y, -0.8, 0.8)


def repeated(y: Real) -> Real:
    """Every sample four times, as by a slower converter."""
    return np.repeat(y[::4], 4)


def stuck(y: Real) -> Real:
    """Friction holds the mass twice a period."""
    held = np.array(y)
    for begin in range(7, len(y) - 4, 20):
        held[begin : begin + 4] = held[begin]
    return held


@pytest.mark.parametrize("change", [lambda y: y, rounded, clipped, repeated, stuck, np.zeros_like])
def test_what_is_no_dropout_stays_as_it_is(change: object) -> None:
    record = dwell(2)
    assert callable(change)
    values = np.stack([change(record.values[:, 0]), record.values[:, 1]], axis=1)
    given = replace(record, values=values)
    dwells, notices = marked([given])
    assert "dropouts" not in [notice.code for notice in notices]
    if change is not clipped:
        assert dwells[0] is given
