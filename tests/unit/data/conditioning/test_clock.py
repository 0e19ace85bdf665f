"""Time stamps that are coarser than the sampling."""

import numpy as np
import pytest

from dashpot.data.conditioning.clock import even_step, with_even_stamps
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from tests.unit.data.conditioning.signals import X1, U, wave

RATE, F = 64.0, 7.3


def stamped(digit: float) -> Record:
    """640 samples of two sines at 64 Hz, their times rounded."""
    t = 0.25 + np.arange(640) / RATE
    rng = np.random.default_rng(1)
    values = wave(t, F, [1.0, 0.5j]) + 1e-3 * rng.normal(size=(640, 2))
    return Record((X1, U), np.round(t / digit) * digit, values, F)


def test_rounded_stamps_are_taken_as_even() -> None:
    even, note = with_even_stamps(stamped(0.01))
    assert note.code == "stamps_rounded"
    np.testing.assert_allclose(np.diff(even.time), 1 / RATE, rtol=1e-9)
    lines = spectrum([stamped(0.01)], transients="none")
    ratio = lines.amplitudes[0, 0] / lines.amplitudes[0, 1]
    assert abs(ratio - 1 / 0.5j) < 5e-3
    assert lines.covariance[0, 0, 0].real < 10 * 4 * 1e-6 / 640


@pytest.mark.parametrize("digit", [1e-4, 1e-5])
def test_stamps_with_few_decimals_are_no_jitter(digit: float) -> None:
    """64 samples a second, as a spreadsheet writes them: what is left of an exact sine is nothing."""
    rounded = stamped(digit)
    even, note = with_even_stamps(rounded)
    assert note is None
    np.testing.assert_allclose(np.diff(even.time), 1 / RATE, rtol=1e-9)
    assert np.max(np.abs(even.time - rounded.time)) < digit


@pytest.mark.parametrize(("samples", "said"), [(4000, False), (16384, True)])
def test_stamps_of_six_figures_are_no_jitter(samples: int, said: bool) -> None:
    """Milliseconds at 4,096 Hz, as `%.6g` writes them: 0.244141, 1000.24."""
    t = np.array([float(f"{1e3 * each:.6g}") for each in np.arange(samples) / 4096]) / 1e3
    even, note = with_even_stamps(Record((X1, U), t, np.zeros((samples, 2))))
    assert (note is not None) is said
    np.testing.assert_allclose(even.time, np.arange(samples) / 4096, atol=6e-6)
    assert even_step(Record((X1, U), t, np.zeros((samples, 2)))) == 1 / 4096
    t[samples // 2] += 2e-4
    assert with_even_stamps(Record((X1, U), t, np.zeros((samples, 2))))[1] is None


def test_jitter_and_gaps_are_left_alone() -> None:
    fine = stamped(1e-4)
    rng = np.random.default_rng(2)
    jitter = Record((X1, U), fine.time + rng.uniform(-0.005, 0.005, 640), fine.values, F)
    assert with_even_stamps(jitter)[0] is jitter
    kept = np.delete(np.arange(640), np.arange(100, 140))
    gap = Record((X1, U), stamped(0.01).time[kept], fine.values[kept], F)
    assert with_even_stamps(gap)[0] is gap
    one = Record((X1, U), np.delete(0.01 * np.arange(641), 300), fine.values, F)
    assert with_even_stamps(one)[0] is one  # steps of 10 ms, and one of 20: no clock of 99.85 Hz


@pytest.mark.parametrize("start", [0.0, 0.25, 1.7e9])
@pytest.mark.parametrize("step", [0.01, 0.0005, 1 / 64, 1 / 51200, 0.0123456, 1 / 333.3])
def test_a_step_comes_out_as_it_was_written(step: float, start: float) -> None:
    """Exactly, wherever the clock starts, although no stamp but the first few is a multiple of it to the last bit."""
    for samples in (16, 1000, 50000):
        time = start + step * np.arange(samples)
        if np.spacing(time[-1]) < 1e-9 * step:
            assert even_step(Record((X1, U), time, np.zeros((samples, 2)))) == step
    generator = np.random.default_rng(3)
    jitter = start + step * (np.arange(1000) + generator.uniform(-0.01, 0.01, 1000))
    if np.spacing(jitter[-1]) < 1e-3 * step:
        assert even_step(Record((X1, U), jitter, np.zeros((1000, 2)))) == pytest.approx(step, rel=1e-5)
