"""What designs predict comes true: identification of simulated tests, and samples saved by planning step by step."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import sequential_design
from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum as conditioned
from dashpot.data.spectrum import Spectrum
from dashpot.design.allocation import Criterion
from dashpot.design.plan import Budget, plan, sample_noise, unsettled_dwells
from dashpot.design.test_setup import Schedule, ShakerLimits, TestSetup, band_grid, nominal_setup
from dashpot.estimate.identify import identify
from dashpot.estimate.method import Method
from dashpot.study.simulate import dwells, simulate_spectrum
from tests.designs import RATE, advised, light_setup, paper_setup
from tests.rigs import paper_rig


def spread(
    own: TestSetup, lines: Schedule, draws: int, seed: int, method: Method | None = None
) -> tuple[float, np.ndarray]:
    """Rms relative spread of an estimator (the optimal one) over repeats of a test, and each parameter's, in parts."""
    test = dwells(own.model, lines.frequency_hz, lines.samples.astype(int))
    data = simulate_spectrum(
        own.model, own.p[0], own.channels, test, np.random.default_rng(seed), draws=draws
    )
    values = identify(own.model, data, method).values / own.theta[0]
    each = np.std(values, axis=0)
    return float(np.sqrt(np.mean(each**2))), each


@pytest.mark.parametrize(
    ("noise", "at_most"),
    [((0.1, 0.0, 0.0), 0.0090), ((0.0, 0.05, 1.5), 0.0092)],
    ids=["relative", "constant"],
)
def test_the_predicted_error_comes_true(noise: tuple[float, float, float], at_most: float) -> None:
    """Within 2 %: 8,000 draws, whose rms over six parameters is itself known to about 0.5 % (1 sd)."""
    own = paper_setup(None, *noise)
    found = plan(own, Criterion("A"), Budget(samples=1400), band_grid(own, 0.25, 25))
    assert found.predicted.figure <= at_most
    rms, each = spread(own, found.schedule, 8000, 20)
    assert rms == pytest.approx(found.predicted.figure, rel=0.02)
    assert each == pytest.approx(found.predicted.relative, rel=0.04)


@pytest.mark.slow
def test_amplitudes_at_the_shakers_limits_come_true() -> None:
    """Constant noise, amplitudes set by the limits: the prediction counts them."""
    rig = paper_rig()
    sensors = [Channel(x, {x: 1.0}, noise=2e-4) for x in ("x1", "x2")]
    own = nominal_setup(
        rig.model, [*sensors, Channel("u", {"u": 1.0})], rig.theta,
        limits=ShakerLimits(stroke=0.02, velocity=0.3, acceleration=8.0),
    )  # fmt: skip
    found = plan(
        own, Criterion("A"), Budget(time=60, rate=100, settle=own.settling()), band_grid(own, 0.5, 25)
    )
    p, rng = own.p[0], np.random.default_rng(3)
    parts = [
        simulate_spectrum(
            own.model, p, own.channels,
            dwells(own.model, [d.frequency_hz], [d.samples], amplitudes=d.amplitudes, rate=100), rng, draws=4000,
        )
        for d in found.dwells
    ]  # fmt: skip
    data = parts[0]
    for part in parts[1:]:
        data = data + part
    values = identify(own.model, data).values / own.theta[0]
    assert np.std(values, axis=0) == pytest.approx(found.predicted.relative, rel=0.04)


@pytest.mark.long
def test_next_best_dwells_against_a_uniform_sweep() -> None:
    """From a poor first test to 1 % of all eight parameters: about half the samples.

    Two repeats: the ratio varies by some per cent from one to the next (benchmarks/ has 200), and 16 errors know their
    rms to about 20 %.
    """
    swept, planned, errors = sequential_design.compare_tests(2, seed=1)
    assert np.median(swept / planned) > 1.8
    assert np.sqrt(np.mean(errors**2)) < 1.5 * sequential_design.TARGET


def drive_known(lines: Spectrum) -> Spectrum:
    """The lines with an exact drive: what is no sine in it, as it passes from dwell to dwell, counts as its noise."""
    V = np.array(lines.covariance)
    V[..., -1, :] = V[..., :, -1] = 0.0
    return replace(lines, covariance=V)


@pytest.mark.long
@pytest.mark.parametrize(("floor", "relative"), [(2e-3, 0.0), (0.0, 0.03)], ids=["constant", "relative"])
def test_a_test_without_settling_gives_what_is_planned(floor: float, relative: float) -> None:
    """Samples in time, drive known; seed 31, 20 draws of 5 unknowns, taken as two independent ones.

    Rms error over the planned sd: 1 ± 3 / √(2 · 40) = ± 0.34.  The stated sd hardly scatters; where dwells are records
    of their own, their noise is known from few lines, and the band found is narrower than the plan's: within 8 %.
    """
    own = light_setup(floor, relative)
    planned = advised(own, settle=0.0, time=62.0)
    lines = planned.plan.schedule
    drive = own.drive(lines.frequency_hz, lines.pattern)
    counts = [round((dwell.time_s or 0.0) * RATE) for dwell in planned.plan.dwells]
    records = unsettled_dwells(
        own.model, own.p[0], own.channels, lines.frequency_hz, drive, counts, [1 / RATE] * len(counts)
    )
    rng, errors, stated = np.random.default_rng(31), [], []
    for _ in range(20):
        noisy = []
        for record in records:
            noise = sample_noise(record, own.channels) * rng.standard_normal(record.values.shape)
            start = 0.0 if planned.unsettled.joined else record.time[0]
            noisy.append(replace(record, time=record.time - start, values=record.values + noise))
        found = identify(own.model, drive_known(conditioned(noisy)))
        errors.append((found.values - own.theta[0]) / planned.unsettled.predicted.sd)
        stated.append(found.sd / planned.unsettled.predicted.sd)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.34)
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(1.0, abs=0.08)
