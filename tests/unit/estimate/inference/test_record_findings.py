"""Inputs that have nothing to do with the motion, and bands too narrow for the ends of a record, are named."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.spectrum import WholeRecord
from dashpot.errors import DataError, IdentifiabilityError
from dashpot.estimate.identify import identify
from dashpot.estimate.inference.diagnostics import modes_outside, unrelated_inputs
from dashpot.model.modes import eigenmodes
from dashpot.notices import Notice
from tests.whole_rigs import chain, record_of

MODEL, THETA = chain(1, 0.04)
TEST = record_of(MODEL, THETA, "random", decay_times=30)


def codes(values: np.ndarray, band: tuple[float, float] | None = None) -> list[str]:
    record = replace(TEST.record, values=values)
    return [notice.code for notice in identify(MODEL, whole_record(record, band_hz=band)).warnings]


def test_an_input_that_shows_noise_alone_is_named() -> None:
    rng = np.random.default_rng(1)
    noisy = TEST.noisy(rng, 0.02 * TEST.size).values
    assert "unrelated_inputs" not in codes(noisy)
    dead = np.array(noisy)
    dead[:, 1] = 1e-6 * rng.normal(size=len(dead))
    assert "unrelated_inputs" in codes(dead)
    with pytest.raises(DataError, match="no motion above the noise between 60"):
        codes(noisy, (60.0, 95.0))  # nothing was driven there


def test_few_tones_in_a_long_record_are_related() -> None:
    """60 tones in 10,000 bins of lines: looked for in every twenty-fifth they were not found."""
    lines, at = 12 * 10_000, 12 * (150 * np.arange(60) + 7) + 3
    rng = np.random.default_rng(5)
    X = 1e-3 * (rng.normal(size=(lines, 2)) + 1j * rng.normal(size=(lines, 2)))
    X[at] += [[1.0, 2.0]]
    record = WholeRecord(1e3, 4 * lines)
    long = replace(
        whole_record(TEST.record), frequency_hz=np.arange(1, lines + 1) / 1e3, amplitudes=X,
        covariance=np.zeros((lines, 2, 2), dtype=complex), samples=np.full(lines, record.samples), dof=np.ones(lines),
        noise=("given",) * lines, experiment=np.zeros(lines, dtype=int), stretch=np.zeros(lines, dtype=int),
        stretches=(record,),
    )  # fmt: skip
    assert unrelated_inputs(MODEL, long) == []


@pytest.mark.slow
def test_weak_motion_under_noise_is_related() -> None:
    """The output 6 dB below its noise; and of 100 unrelated inputs 1 passes on average, 6 with p = 1e-4."""
    rng = np.random.default_rng(2)
    weak = whole_record(TEST.noisy(rng, np.array([2.0, 0.02]) * TEST.size), band_hz=(0.5, 20))
    assert unrelated_inputs(MODEL, weak) == []
    named = 0
    for _ in range(100):
        values = rng.normal(size=TEST.record.values.shape)
        values[:, 0] = TEST.record.values[:, 0] / TEST.size[0]
        lines = whole_record(replace(TEST.record, values=values), band_hz=(0.5, 20))
        named += bool(unrelated_inputs(MODEL, lines))
    assert named >= 94


def test_narrow_bands_are_named() -> None:
    rng = np.random.default_rng(3)
    noisy = TEST.noisy(rng, 0.02 * TEST.size).values
    assert "few_lines" not in codes(noisy)
    T = len(noisy) * (TEST.record.time[1] - TEST.record.time[0])
    middle = round(6.0 * T) / T
    with pytest.raises(IdentifiabilityError, match="5 frequency lines for 6") as refused:
        codes(noisy, (middle - 2.2 / T, middle + 2.2 / T))
    assert "widen the band" in str(refused.value)


def test_a_band_without_some_modes_is_named_where_that_leaves_unknowns_open() -> None:
    model, theta = chain(3, 0.02)
    record = record_of(model, theta, "random", decay_times=3).record
    frequency = eigenmodes(model, model.parameters(theta)).frequency_hz
    sd = np.array([0.2 if name == "k3" else 0.01 for name in model.unknown_names]) * theta

    def named(band: tuple[float, float], covariance: np.ndarray) -> list[Notice]:
        return modes_outside(model, theta, covariance, frequency, whole_record(record, band_hz=band))

    (notice,) = named((2.0, 6.0), np.diag(sd**2))
    assert "1 of the rig's 3 modes" in notice.text
    assert named((2.0, 30.0), np.diag(sd**2)) == []
    assert named((2.0, 6.0), np.diag((0.01 * theta) ** 2)) == []


@pytest.mark.parametrize(("periods", "named"), [(0.8, True), (1.5, False)])
def test_a_record_shorter_than_a_period_is_named(periods: float, named: bool) -> None:
    slowest = float(eigenmodes(MODEL, MODEL.parameters(THETA)).frequency_hz[0])
    samples = int(periods / slowest / TEST.record.time[1])
    record = TEST.noisy(np.random.default_rng(4), 1e-4 * TEST.size)
    short = replace(record, time=record.time[:samples], values=record.values[:samples])
    notices = [n for n in identify(MODEL, whole_record(short)).warnings if n.code == "short_record"]
    assert len(notices) == named
    assert not named or "shorter than one period of the slowest mode" in notices[0].text
