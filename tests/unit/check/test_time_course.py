"""Changes in the course of a whole record: spikes, lost samples, steps of a gain; noise shows none."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.check.residuals import Residuals
from dashpot.check.time_course import TimeChange, change_finding, change_in_words, time_changes
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord

SAMPLES, STEP_S = 2000, 0.01
LINES = np.arange(20, 620)  # 1 to 31 Hz of 50
NOISE = 0.02  # of the motion
OUTPUTS = np.array([True, True, False])


def motion(rng: np.random.Generator) -> Real:
    """Band-limited random motion of two points, (samples, 2), rms 1."""
    lines = np.zeros((SAMPLES // 2 + 1, 2), dtype=complex)
    lines[LINES] = rng.normal(size=(len(LINES), 2)) + 1j * rng.normal(size=(len(LINES), 2))
    x = np.fft.irfft(lines, SAMPLES, axis=0)
    return x / x.std(axis=0)


def changes(measured: Real, predicted: Real) -> tuple[TimeChange, ...]:
    """Of a record of x1, x2 and the base u, whose noise the residuals tell; histories (samples, 2)."""
    y, shown = (2 / SAMPLES * np.fft.rfft(x, axis=0)[LINES] for x in (measured, predicted))
    base = np.ones((len(LINES), 1))
    noise = np.sqrt(np.mean(np.abs(y - shown) ** 2, axis=0) / 2)
    normalised = np.concatenate([(y - shown) / noise, np.full((len(LINES), 1), np.nan)], axis=1)
    frequency_hz = LINES / (SAMPLES * STEP_S)
    names, zeros = ("x1", "x2", "u"), np.zeros(len(LINES), dtype=np.int64)
    left = Residuals(
        names, ("m",) * 3, ("u",), ("m",), frequency_hz, zeros, np.concatenate([y, base], axis=1),
        np.concatenate([shown, base], axis=1), np.tile([*noise, 0.0], (len(LINES), 1)), normalised, base + 0j, False,
    )  # fmt: skip
    spectrum = Spectrum(
        tuple(Channel(name, {name: 1.0}) for name in names), frequency_hz, left.measured,
        np.zeros((len(LINES), 3, 3)), zeros + SAMPLES, np.full(len(LINES), 2.0 * len(LINES)),
        ("residual",) * len(LINES), zeros, stretches=(WholeRecord(SAMPLES * STEP_S, SAMPLES),),
    )  # fmt: skip
    return time_changes(left, spectrum, OUTPUTS)


def test_noise_changes_nothing_whether_white_or_louder_where_the_motion_is() -> None:
    """100 records of each; the stated chances are 1 in 10,000 and 1 in 1,000,000."""
    rng = np.random.default_rng(5)
    for loudness in (lambda x: 1.0, lambda x: np.abs(x)):
        for _ in range(100):
            x = motion(rng)
            assert changes(x + NOISE * loudness(x) * rng.normal(size=x.shape), x) == ()


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
    assert (
        change_in_words(change, 1)
        == f"x2 reads {change.size:.3g} × as much after {change.time_s:.4g} s as before"
    )


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
    assert change_finding(change, 1).change == "leave those samples out: the record is then used in pieces"
    assert change_finding(change, 1).remaining is None  # that remedy is not tried


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
    assert change_finding(change, 2).text.startswith(
        " and ".join(change.channels) + " jump off the prediction at 1"
    )
    assert "in record 1" in change_finding(change, 2).text
