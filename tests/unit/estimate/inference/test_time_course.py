"""Changes in the course of a whole record: spikes, lost samples, steps of a gain; noise and misfits show none."""

import re
from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, WholeRecord
from dashpot.estimate.identify import identify
from dashpot.estimate.inference.time_course import (
    TIME_CHANGES,
    TimeChange,
    change_in_words,
    change_notice,
    time_changes,
)
from dashpot.estimate.result import Estimate
from tests.unit.data.conditioning.test_transients import MODEL, stepped
from tests.whole_rigs import WholeTest, chain, record_of

SAMPLES, STEP_S = 2000, 0.01
LINES = np.arange(20, 620)  # 1 to 31 Hz of 50
NOISE = 0.02  # of the motion
OUTPUTS = np.array([0, 1])


def motion(rng: np.random.Generator) -> Real:
    """Band-limited random motion of two points, (samples, 2), rms 1."""
    lines = np.zeros((SAMPLES // 2 + 1, 2), dtype=complex)
    lines[LINES] = rng.normal(size=(len(LINES), 2)) + 1j * rng.normal(size=(len(LINES), 2))
    x = np.fft.irfft(lines, SAMPLES, axis=0)
    return x / x.std(axis=0)


def changes(measured: Real, predicted: Real) -> tuple[TimeChange, ...]:
    """Of a record of x1, x2 and the base u, whose noise the residuals tell; histories (samples, 2)."""
    y, shown = (2 / SAMPLES * np.fft.rfft(x, axis=0)[LINES] for x in (measured, predicted))
    noise = np.sqrt(np.mean(np.abs(y - shown) ** 2, axis=0) / 2)
    base, none = np.ones((len(LINES), 1)), np.zeros((len(LINES), 1))
    frequency_hz, zeros = LINES / (SAMPLES * STEP_S), np.zeros(len(LINES), dtype=np.int64)
    of_record = Spectrum(
        tuple(Channel(name, {name: 1.0}) for name in ("x1", "x2", "u")), frequency_hz,
        np.concatenate([y, base], axis=1), np.zeros((len(LINES), 3, 3)), zeros + SAMPLES,
        np.full(len(LINES), 2.0 * len(LINES)), ("residual",) * len(LINES), zeros,
        stretches=(WholeRecord(SAMPLES * STEP_S, SAMPLES),),
    )  # fmt: skip
    left, predicted = (
        np.concatenate([part, rest], axis=1)
        for part, rest in (((y - shown) / noise, none), (shown / noise, base))
    )
    return time_changes(lambda lines, c: (left[lines, c], predicted[lines, c]), of_record, OUTPUTS)


@pytest.mark.slow
def test_noise_changes_nothing_whether_white_or_louder_where_the_motion_is() -> None:
    """100 records of each; the stated chances are 1 in 10,000 and 1 in 1,000,000."""
    rng = np.random.default_rng(5)
    for loudness in (lambda x: 1.0, lambda x: np.abs(x)):
        for _ in range(100):
            x = motion(rng)
            assert changes(x + NOISE * loudness(x) * rng.normal(size=x.shape), x) == ()


def test_noise_that_two_channels_share_is_loud_once() -> None:
    """A block twice as loud in both: noise of one source makes one, and noise of two sources does not."""
    rng = np.random.default_rng(5)
    x = motion(rng)
    louder = 1 + 0.75 * (np.abs(np.arange(SAMPLES) - 1000) < 25)[:, None]
    shared, own = 0, 0
    for _ in range(40):
        noise = NOISE * louder * rng.normal(size=x.shape)
        own += any(change.kind == "block" for change in changes(x + noise, x))
        shared += any(change.kind == "block" for change in changes(x + noise[:, :1], x))
    assert shared < own / 3


@pytest.mark.parametrize(("at_s", "ratio"), [(10.0, 1.1), (6.3, 0.8)])
def test_a_step_of_one_gain_is_found_with_its_time_and_size(at_s: float, ratio: float) -> None:
    rng = np.random.default_rng(6)
    x = motion(rng)
    y = x + NOISE * rng.normal(size=x.shape)
    y[round(at_s / STEP_S) :, 1] *= ratio
    # What a fit predicts has the gain that suits the whole record best.
    y[:, 1] /= np.sum(y[:, 1] * x[:, 1]) / np.sum(x[:, 1] ** 2)
    (change,) = changes(y, x)
    assert (change.kind, change.channels) == ("gain", ("x2",))
    assert change.time_s == pytest.approx(at_s, abs=0.1)
    assert change.size == pytest.approx(ratio, abs=0.02)
    assert change_in_words(change, 1).endswith(f"factor of {change.size:.3g} after {change.time_s:.4g} s")


@pytest.mark.parametrize("gradual", [False, True])
def test_a_clock_that_changes_is_found_with_its_time_and_size(gradual: bool) -> None:
    """Half a sample late from the middle on, or at the end; what a fit predicts is late as on the average."""
    rng = np.random.default_rng(10)
    x = motion(rng)
    late = np.linspace(0, 1, SAMPLES) if gradual else (np.arange(SAMPLES) >= SAMPLES // 2)
    rate = 2j * np.pi * np.fft.rfftfreq(SAMPLES, STEP_S)
    slope = np.fft.irfft(rate * np.fft.rfft(x[:, 0]), SAMPLES)
    y = x + NOISE * rng.normal(size=x.shape)
    y[:, 0] -= 0.5 * STEP_S * (late - 0.5) * slope
    (change,) = changes(y, x)
    assert (change.kind, change.channels, change.gradual) == ("clock", ("x1",), gradual)
    assert change.size == pytest.approx(0.5 * STEP_S, rel=0.1)
    assert change.time_s == pytest.approx(20.0 if gradual else 10.0, abs=0.1)
    words = "at the end than at the start" if gradual else "than before"
    assert change_in_words(change, 1).startswith("x1 is ")
    assert change_in_words(change, 1).endswith(words)


@pytest.mark.parametrize("samples", [1, 3, 12, 40, -8])
def test_a_clock_that_slips_by_more_than_a_part_of_a_cycle_is_no_gain(samples: int) -> None:
    """The shortest cycle is three samples, the usual one six."""
    rng = np.random.default_rng(10)
    x = motion(rng)
    y = x + NOISE * rng.normal(size=x.shape)
    y[600:, 0] += np.roll(x[:, 0], samples)[600:] - x[600:, 0]
    (change,) = changes(y, x)
    assert (change.kind, change.channels, change.gradual) == ("clock", ("x1",), False)
    assert change.size == pytest.approx(samples * STEP_S, rel=0.1)
    assert change.time_s == pytest.approx(6.0, abs=0.03)


def test_gains_of_both_channels_that_differ_are_no_channel_s_step() -> None:
    """A rig that does not fit reads otherwise wherever the drive has moved on."""
    rng = np.random.default_rng(7)
    x = motion(rng)
    y = x + NOISE * rng.normal(size=x.shape)
    y[1000:] *= 1.2
    assert all(change.kind == "jump" for change in changes(y, x))


def test_spikes_are_counted() -> None:
    rng = np.random.default_rng(8)
    x = motion(rng)
    y = x + NOISE * rng.normal(size=x.shape)
    y[[300, 700, 1500], 0] += [0.6, -0.5, 0.5]
    (change,) = changes(y, x)
    assert (change.kind, change.channels, change.times) == ("jump", ("x1",), 3)
    assert change.time_s == pytest.approx(3.0, abs=0.02)
    assert change_notice(change, 1).code == "spikes"


@pytest.mark.parametrize("sample", [0, 3, SAMPLES - 2])
def test_what_stands_out_at_an_end_of_the_record_is_no_spike(sample: int) -> None:
    """The terms of the ends are estimated with the rest, and what they lack of the band stands there."""
    rng = np.random.default_rng(8)
    x = motion(rng)
    y = x + NOISE * rng.normal(size=x.shape)
    y[sample, 0] += 5.0
    assert changes(y, x) == ()


def test_a_jump_of_all_channels_is_one() -> None:
    """What dies away from one time on, as after samples that are lost."""
    rng = np.random.default_rng(9)
    x = motion(rng)
    y = x + NOISE * rng.normal(size=x.shape)
    t = STEP_S * np.arange(SAMPLES - 1200)[:, None]
    y[1200:] += np.exp(-5 * t) * np.cos(2 * np.pi * np.array([4.0, 7.0]) * t)
    (change,) = changes(y, x)
    assert (change.kind, sorted(change.channels)) == ("jump", ["x1", "x2"])
    assert change.time_s == pytest.approx(12.0, abs=0.1)
    text = change_notice(change, 2).text
    assert text.startswith(" and ".join(change.channels) + " depart abruptly from the prediction at 1")
    assert "in record 1" in text
    assert change_notice(change, 5, more=3).text.endswith("in 3 more records")


def test_of(excitation: str) -> WholeTest:
    """A record of two masses, 20 decay times of the slower mode, on a base that moves or pushed by a force."""
    pushed = excitation in ("sweep", "hammer")
    model, theta = chain(2, 0.03, base=not pushed, force=pushed, seed=2)
    return record_of(model, theta, excitation, decay_times=20, seed=1)


test_of.__test__ = False  # type: ignore[attr-defined]


def without(record: Record, count: int) -> Record:
    """The record with samples missing beyond its middle, its stamps even all the same."""
    first = int(0.52 * len(record.time))
    values = np.delete(record.values, slice(first, first + count), axis=0)
    return replace(record, time=record.time[: len(values)], values=values)


def jumps(estimate: Estimate) -> list[str]:
    return [notice.text for notice in estimate.warnings if notice.code in TIME_CHANGES]


@pytest.mark.parametrize("excitation", ["random", "earthquake", "hammer"])
def test_lost_samples_are_named(excitation: str) -> None:
    """One of 5,000 samples, 3 % noise: each block of 48 errs once in 5e7."""
    test = test_of(excitation)
    noisy = test.noisy(np.random.default_rng(1), 0.03 * test.size * [1, 1, 0])
    assert jumps(identify(test.model, spectrum([noisy]))) == []
    (said,) = jumps(identify(test.model, spectrum([without(noisy, 1)])))
    said_at = re.search(r"(?:near|at) ([\d.]+) s", said)
    at = float(said_at.group(1))
    assert at == pytest.approx(0.52 * noisy.time[-1], abs=noisy.time[-1] / 40)


def test_a_rig_that_does_not_fit_does_not_jump() -> None:
    """The second sensor shows 10 % more than there is: the residual is loud where the motion is."""
    test = test_of("earthquake")
    noisy = test.noisy(np.random.default_rng(1), 0.01 * test.size * [1, 1, 0])
    wrong = replace(
        noisy, values=noisy.values * [1, 1.1, 1] + 0.3 * noisy.values**3 / np.max(noisy.values**2, axis=0)
    )
    estimate = identify(test.model, spectrum([wrong]))
    assert jumps(estimate) == []


def test_samples_lost_in_a_dwell_are_named() -> None:
    records = stepped(0.02, periods=30, settle=4.0)
    lost = [*records[:2], without(records[2], 4), *records[3:]]
    assert jumps(identify(MODEL, spectrum(records))) == []
    assert len(jumps(identify(MODEL, spectrum(lost)))) == 1
