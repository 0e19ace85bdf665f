"""Rounding to the steps of a converter counts as noise where the residual cannot show it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import fdtr

from dashpot.data.conditioning.harmonic_fit import fit_harmonics, rounding_steps
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.record import Record
from dashpot.errors import DataError
from tests.unit.data.conditioning.signals import X1, U, wave

STEP = 0.01


def dwell(f: float, size: complex, *, periods: float = 20.0, each: int = 16, noise: float = 0.0) -> Record:
    """Two channels of `each` samples a period, the first rounded to STEP."""
    t = np.arange(int(periods * each)) / (each * f)
    rng = np.random.default_rng(int(1e6 * abs(size)))
    values = wave(t, f, [size, 1.0]) + noise * rng.normal(size=(len(t), 2)) * [1, 0]
    values[:, 0] = np.round(values[:, 0] / STEP) * STEP
    values[:, 1] += 1e-3 * rng.normal(size=len(t))
    return Record((X1, U), t, values, f)


@pytest.mark.slow
def test_the_error_of_rounded_amplitudes_is_what_is_stated() -> None:
    """80 amplitudes of periods that repeat to the bit: error over stated sd has rms 1 within a quarter.

    Were the rounding of samples independent, it would be about √100.
    """
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(80):
        size = complex(*(0.03 * rng.normal(size=2)))
        records = [dwell(2.0, size, periods=50.0, each=10), dwell(2.0, 0.3 * np.exp(1j))]
        lines = spectrum(records, refine="none", transients="none")
        variance = lines.covariance[0, 0, 0].real
        ratios.append(abs(lines.amplitudes[0, 0] - size) ** 2 / variance)
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1.0, abs=0.25)


def test_a_channel_on_one_code_is_not_exact() -> None:
    records = [dwell(2.0, 0.3), dwell(2.0, 0.001)]
    assert np.ptp(records[1].values[:, 0]) == 0
    lines = spectrum(records, refine="none", transients="none")
    assert lines.covariance[1, 0, 0].real >= 4 * STEP**2 / 12 / 320


def test_a_sine_that_was_computed_at_few_phases_is_no_converter() -> None:
    """Its values of a phase are apart by their last digits: 0.5 and 0.5000000000000001, where a converter has one."""
    t = np.arange(60) / 24.0
    values = wave(t, 4.0, [1.0, 1.0]) + 1e-3 * np.random.default_rng(2).normal(size=(60, 2)) * [0, 1]
    assert len(np.unique(values[:, 0])) > len(np.unique(np.round(values[:, 0], 12)))
    np.testing.assert_array_equal(rounding_steps([Record((X1, U), t, values, 4.0)]), 0.0)
    codes = np.round(values / 0.5) * 0.5
    np.testing.assert_allclose(rounding_steps([Record((X1, U), t, codes, 4.0)]), 0.5)


def test_each_dwell_has_the_step_of_its_own_range() -> None:
    fine, coarse = dwell(2.0, 0.3), dwell(2.0, 1.1)
    values = np.array(coarse.values)
    values[:, 0] = np.round(values[:, 0] / (10 * STEP)) * 10 * STEP
    resting, odd = dwell(2.0, 0.001), replace(fine, values=fine.values * np.array([np.e, 1.0]))
    steps = rounding_steps([fine, replace(coarse, values=values), resting])
    np.testing.assert_allclose(steps[:, 0], [STEP, 10 * STEP, STEP])
    np.testing.assert_allclose(rounding_steps([fine, odd])[:, 0], [STEP, np.e * STEP])


def test_noise_that_dithers_is_left_as_the_residual_shows_it() -> None:
    noisy = [dwell(2.0, 0.3 + 0.1 * k, noise=0.02) for k in range(2)]
    fine = [
        replace(r, values=r.values + 1e-9 * np.random.default_rng(1).normal(size=r.values.shape))
        for r in noisy
    ]
    np.testing.assert_allclose(spectrum(noisy).covariance, spectrum(fine).covariance, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 2, 4, 64])
def test_what_a_coarse_converter_rounds_is_known_to_its_cell(steps: float) -> None:
    """60 sines of so many steps from end to end under noise of 0.3 steps: error over stated sd, and what that is.

    Of unrounded samples the variance would be 4 σ²/N; the likelihood of cells has 1.9 times that.
    """
    rng = np.random.default_rng(4)
    z2, over = [], []
    for _ in range(60):
        size = steps / 2 * STEP * np.exp(1j * rng.uniform(0, 6.28))
        t = np.arange(200) / 100.07
        values = (
            wave(t, 4.0, [size, 1.0]) + 0.3 * STEP * rng.normal(size=(200, 2)) + [rng.uniform(0, STEP), 0]
        )
        values[:, 0] = np.round(values[:, 0] / STEP) * STEP
        lines = spectrum([Record((X1, U), t, values, 4.0)], transients="none", refine="none")
        variance = lines.covariance[0, 0, 0].real
        z2.append(abs(lines.amplitudes[0, 0] - size) ** 2 / variance)
        over.append(variance / (4 * (0.3 * STEP) ** 2 / 200))
    assert 0.55 < np.mean(z2) < 1.6  # 1 ± 0.13
    assert 1.4 < np.mean(over) < 2.6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "noise"), [(1, 0.1), (2, 0.02), pytest.param(4, 0.1, marks=pytest.mark.long)]
)
def test_codes_under_little_noise_give_intervals_that_hold_and_tell_as_much(
    steps: float, noise: float
) -> None:
    """60 dwells each, 1.5 to 40 periods of 12 to 40 samples: 95 % intervals hold to three deviations of so many, 8.4 %.

    With noise of a fiftieth of a step what is stated is less than rounding, were it independent noise, would leave.
    """
    rng = np.random.default_rng(6)
    held, stated = [], []
    for _ in range(60):
        periods, each = np.exp(rng.uniform(np.log(1.5), np.log(40))), rng.uniform(12, 40)
        t = np.arange(int(periods * each)) / (4.0 * each)
        size = steps / 2 * STEP * np.exp(1j * rng.uniform(0, 2 * np.pi))
        values = wave(t, 4.0, [size, 1.0])
        values[:, 0] += STEP * (rng.uniform(-0.5, 0.5) + noise * rng.normal(size=len(t)))
        values[:, 0] = np.round(values[:, 0] / STEP) * STEP
        values[:, 1] += 1e-3 * rng.normal(size=len(t))
        lines = spectrum([Record((X1, U), t, values, 4.0)], transients="none", refine="none")
        variance = lines.covariance[0, 0, 0].real
        held.append(fdtr(2, lines.dof[0], abs(lines.amplitudes[0, 0] - size) ** 2 / variance) < 0.95)
        stated.append(np.sqrt(variance * len(t)) / STEP)
    assert np.mean(held) > 0.95 - 0.084
    if noise < 0.1:
        assert np.median(stated) < 2 / 12**0.5


@pytest.mark.slow
def test_codes_of_short_dwells_leave_the_noise_open() -> None:
    """100 dwells of 30 samples, 64 steps from end to end under noise of 0.1 steps: (error over sd)² is 1 ± 0.1."""
    rng = np.random.default_rng(11)
    z2 = []
    for _ in range(100):
        size = 32 * STEP * np.exp(1j * rng.uniform(0, 2 * np.pi))
        t = np.arange(30) / 61.2
        values = wave(t, 4.0, [size, 1.0])
        values[:, 0] += STEP * (rng.uniform(-0.5, 0.5) + 0.1 * rng.normal(size=30))
        values[:, 0] = np.round(values[:, 0] / STEP) * STEP
        fit = fit_harmonics(Record((X1, U), t, values, 4.0, cell=np.array([STEP, 0.0])), drift=0)
        z2.append(abs(fit.amplitudes[0, 0] - size) ** 2 / fit.covariance[0, 0, 0].real)
    assert 0.7 < np.mean(z2) < 1.25


@pytest.mark.slow
def test_rounding_is_no_harmonic() -> None:
    """30 dwells of 2 and 4 steps under noise of 0.02 steps have none, and half a step of the third is found in most."""
    rng = np.random.default_rng(2)
    found = []
    for k in range(60):
        steps, third = ((2, 4)[k % 2], 0.0) if k < 30 else (64, 0.5)
        each = round(rng.uniform(12, 40)) if k % 4 < 2 else rng.uniform(12, 40)
        t = np.arange(int(15 * each)) / (4.0 * each)
        values = wave(t, 4.0, [steps / 2 * np.exp(1j * rng.uniform(0, 6.28)), 1.0])
        values[:, 0] += wave(t, 12.0, [third])[:, 0] + rng.uniform(-0.5, 0.5)
        values[:, 0] = np.round(values[:, 0] + (0.1 if third else 0.02) * rng.normal(size=len(t)))
        values[:, 1] += 1e-3 * rng.normal(size=len(t))
        found.append(
            fit_harmonics(Record((X1, U), t, values, 4.0, cell=np.array([1.0, 0.0])), orders=(1,)).orders
        )
    assert sum(orders != (1,) for orders in found[:30]) <= 3
    assert sum(3 in orders for orders in found[30:]) >= 24


@pytest.mark.slow
def test_turning_points_of_a_coarse_converter_are_no_missed_samples() -> None:
    """Runs of one value at each turning point, 3 to 8 bits, 25 to 60 samples a period."""
    for bits in range(3, 9):
        for each in (25, 40, 60):
            t = np.arange(8 * each) / (4.0 * each)
            values = wave(t, 4.0, [1.0, np.exp(0.3j)])
            values = np.round(values * 2 ** (bits - 1)) / 2 ** (bits - 1)
            assert "dropouts" not in [note.code for note in spectrum([Record((X1, U), t, values, 4.0)]).notes]


@pytest.mark.slow
def test_codes_that_tell_too_little_are_no_failure() -> None:
    """One, two and three codes, 12 to 60 samples, with and without noise and limits: a line, or a reasoned refusal."""
    rng = np.random.default_rng(5)
    for _ in range(60):
        t = np.arange(rng.integers(12, 61)) / 80.0
        values = wave(t, 4.0, [STEP * rng.uniform(0, 2), 1.0]) + STEP * rng.choice(
            [0, 0.1, 0.4]
        ) * rng.normal(size=(len(t), 2))
        values[:, 0] = np.clip(np.round(values[:, 0] / STEP), -1, rng.integers(0, 3)) * STEP
        try:
            lines = spectrum([Record((X1, U), t, values, 4.0), dwell(2.0, 0.3)])
        except DataError:
            continue
        assert np.all(np.isfinite(lines.amplitudes))
        assert np.all(np.isfinite(lines.covariance))
