"""The noise of whole records from the residuals of a fit: its size, its colour, and what noisy inputs hide of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from dashpot.channel import Quantity
from dashpot.check.residuals import residuals_of
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.record import Record
from dashpot.errors import UsageError
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.record_noise import share_without_misfit, with_record_noise
from dashpot.model.elements import Kind
from tests.networks import changed
from tests.record_draws import CASES
from tests.whole_rigs import WholeTest, chain, record_of


def swept(seed: int = 1) -> WholeTest:
    model, theta = chain(2, 0.05, seed=seed)
    return record_of(
        model,
        theta,
        "sweep",
        decay_times=12,
        quantities=(Quantity.DISPLACEMENT, Quantity.VELOCITY),
        seed=seed,
    )


def test_white_noise_is_found_by_its_size() -> None:
    test = swept()
    sd = 0.05 * test.size * np.array([1, 2, 1, 0.5, 0])
    record = test.noisy(np.random.default_rng(2), sd)
    found, _ = with_record_noise(test.model, whole_record(record), MaximumLikelihood())
    assert set(found.noise) == {"residual"}
    size = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2).real * len(record.time) / 4)
    np.testing.assert_allclose(size[0], size[-1])  # white: one size for all lines
    np.testing.assert_allclose(size[0, :4], sd[:4], rtol=0.06)  # 4 sd of 1,100 lines
    assert size[0, 4] < 0.02 * test.size[4]  # the base has none; its spectrum ends somewhere


def test_what_a_wrong_rig_leaves_is_no_noise() -> None:
    """A spring 5 % off leaves 7 to 11 times the noise; what does not follow the base the noise."""
    test = swept()
    sd = 0.005 * test.size * np.array([1, 1, 1, 1, 0])
    record = whole_record(test.noisy(np.random.default_rng(5), sd))
    true = test.theta[test.model.unknown_names.index("k1")]
    for factor, most in ((1.0, 1.1), (1.05, 1.3)):
        rig = changed(test.model, "k1", value=factor * true)
        known, method = with_record_noise(rig, record, MaximumLikelihood())
        left = residuals_of(rig, known, identify(rig, known, method))
        inputs = np.array([channel.name == "u" for channel in record.channels])
        share = share_without_misfit(known, inputs, left.measured - left.predicted)
        alone = np.diagonal(known.covariance, axis1=1, axis2=2).real * share
        size = np.sqrt(np.mean(alone * known.samples[:, None] / 4, axis=0))[:4]
        assert np.all(size > 0.9 * sd[:4])
        assert np.all(size < most * sd[:4])


def test_coloured_noise_is_followed() -> None:
    test = swept()
    rng = np.random.default_rng(3)
    noise = lfilter([0.3], [1, -0.95], rng.normal(size=(len(test.record.time) + 500, 5)), axis=0)[500:]
    noise *= 0.05 * test.size * np.array([1, 1, 1, 1, 0])
    record = Record(test.record.channels, test.record.time, test.record.values + noise)
    found, _ = with_record_noise(test.model, whole_record(record), MaximumLikelihood())
    step = record.time[1]
    expected = 4 / len(record.time) * 0.09 / np.abs(1 - 0.95 * np.exp(-1j * found.omega * step)) ** 2
    ratio = np.diagonal(found.covariance, axis1=1, axis2=2).real[:, 0] / (0.05 * test.size[0]) ** 2 / expected
    inside = slice(30, -30)
    assert np.mean(ratio[inside]) == pytest.approx(1.0, abs=0.1)
    assert np.std(np.log(ratio[inside])) < 0.3  # 61 lines: 0.13


def test_a_channel_that_some_short_records_lack_has_the_noise_of_the_others() -> None:
    """Of twelve records of 40 samples eight lack it; 25 %: 4 sd of what 80 lines tell of a standard deviation."""
    test = swept()
    sd = 0.05 * test.size * np.array([1, 1, 1, 1, 0])
    record = test.noisy(np.random.default_rng(4), sd)
    begins = np.linspace(200, len(record.time) - 200, 12).astype(int)
    short = spectrum(
        [replace(record, time=record.time[k : k + 40], values=record.values[k : k + 40]) for k in begins],
        drift="none",
    )
    amplitudes = short.amplitudes.copy()
    amplitudes[short.stretch < 8, 0] = np.nan
    found, _ = with_record_noise(test.model, replace(short, amplitudes=amplitudes), MaximumLikelihood())
    size = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2).real * short.samples[:, None] / 4)
    assert size[-1, 0] == pytest.approx(sd[0], rel=0.25)


def test_records_share_the_course_of_their_noise_over_frequency() -> None:
    """Ten records of 150 samples, noise of first order: each alone would smooth 61 of its 75 lines into one size.

    At the slowest tenth of the lines, where its power is five times the mean, what is found lies within 25 % of it
    (150 lines of two numbers each tell it to 12 % at two deviations).
    """
    test, rng = swept(), np.random.default_rng(8)
    size, pole = 0.05 * test.size * np.array([1, 1, 1, 1, 0]), 0.8
    samples = test.record.values.shape
    noise = lfilter([1], [1, -pole], rng.normal(size=(samples[0] + 100, samples[1])), axis=0)[100:]
    values = test.record.values + size * noise * np.sqrt(1 - pole**2)
    begins = np.linspace(200, samples[0] - 400, 10).astype(int)
    record = replace(test.record, values=values)
    parts = [replace(record, time=record.time[k : k + 150], values=values[k : k + 150]) for k in begins]
    short = spectrum(parts, drift="none")
    found, _ = with_record_noise(test.model, short, MaximumLikelihood())
    power = np.diagonal(found.covariance, axis1=1, axis2=2).real[:, 0] * short.samples / 4
    step = float(record.time[1] - record.time[0])
    true = (
        size[0] ** 2 * (1 - pole**2) / np.abs(1 - pole * np.exp(-2j * np.pi * short.frequency_hz * step)) ** 2
    )
    slow = short.frequency_hz <= np.quantile(short.frequency_hz, 0.1)
    assert np.mean(true[slow]) > 4 * np.mean(true)
    assert np.mean(power[slow]) == pytest.approx(np.mean(true[slow]), rel=0.25)


def test_noise_of_the_base_is_read_where_nothing_moves() -> None:
    test = swept()
    sd = 0.05 * test.size
    record = test.noisy(np.random.default_rng(4), sd)
    found, _ = with_record_noise(test.model, whole_record(record), MaximumLikelihood())
    size = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2).real * len(record.time) / 4).mean(axis=0)
    np.testing.assert_allclose(size, sd, rtol=0.1)


def test_one_call_does_it_all() -> None:
    test = swept()
    record = test.noisy(np.random.default_rng(5), 0.05 * test.size * np.array([1, 1, 1, 1, 0]))
    lines = whole_record(record)
    assert automatic(test.model, lines).name == "ml"
    estimate = identify(test.model, lines)
    away = (estimate.values - test.theta) / np.sqrt(np.diagonal(estimate.covariance))
    assert np.max(np.abs(away)) < 3.5
    assert np.max(np.abs(estimate.values / test.theta - 1)) < 0.05
    with pytest.raises(UsageError, match="oiv needs settled dwells"):
        identify(test.model, lines, "oiv")


def test_a_fit_with_negative_parts_is_no_start() -> None:
    """A free decay whose even weights lead to parts a thousand times too large and below zero, which fit the noise that
    is reckoned with before the first fit."""
    case = CASES[3]
    test = case.test()
    noise = np.random.default_rng((3, 1073)).normal(size=test.record.values.shape)
    record = replace(test.record, values=test.record.values + case.noise * test.size * noise)
    found = identify(test.model, spectrum([record]))
    assert np.all(np.abs(found.values - test.theta) < 4 * found.sd)


@pytest.mark.parametrize("seed", range(3))
def test_a_mass_that_is_stated_with_a_tolerance_gives_the_scale(seed: int) -> None:
    """Motions of a shaken base leave the scale free; from start to start it had shrunk to 1e-29 kg, and was refused."""
    rig, theta = chain(1, 0.03, base=True, seed=seed)
    test = record_of(rig, theta, "random", decay_times=8, quantities=(Quantity.ACCELERATION,), seed=seed)
    (m,) = (element for element in rig.elements if element.kind is Kind.MASS)
    stated = replace(m, value=1.01 * m.value, sd=0.02 * m.value)
    model = replace(rig, elements=tuple(stated if element is m else element for element in rig.elements))
    lines = whole_record(test.noisy(np.random.default_rng(seed), 0.1 * test.size * [1, 0]))
    estimate = identify(model, lines)
    assert estimate["m1"].value == pytest.approx(1.01 * m.value, rel=1e-3)
    away = estimate.values - np.array([1.01 * m.value, *(1.01 * theta)])
    assert np.all(np.abs(away) < 4 * estimate.sd)
