"""What a rig leaves of the motion beyond noise: bounds that hold, and the verdict by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arrays import random_generator
from dashpot.check.explain.examine import examined
from dashpot.check.residuals import Residuals, discrepancies, residuals
from dashpot.check.verdict import assess
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.spectrum import Spectrum
from dashpot.errors import ModelError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import measures_input
from dashpot.model.rigfile import parse_rig, write_rig
from tests import rigs
from tests.networks import changed
from tests.whole_rigs import WholeTest, chain, record_of

PAPER = rigs.paper_rig()
CHANNELS = rigs.channels(PAPER)
MOTIONS = np.array([not measures_input(PAPER.model, channel) for channel in CHANNELS])
DRAWS = 400


@pytest.fixture(scope="module")
def fitted() -> tuple[Residuals, Estimate]:
    """Residuals and estimate of the paper's rig with 1 % noise."""
    data = rigs.noisy(PAPER, CHANNELS, rigs.covariance(PAPER, CHANNELS, 0.01), random_generator(1))
    estimate = identify(PAPER.model, data)
    return residuals(PAPER.model, estimate.values, data), estimate


def _drawn(left: Residuals, share: float, noise: float, lines: int, seed: int) -> Residuals:
    """Motions of random phase at `lines` dense lines, of which a share is left and noise is added."""
    rng = random_generator(seed)
    shape = (lines, len(left.channels))
    y, e = (rng.normal(size=shape) + 1j * rng.normal(size=shape) for _ in range(2))
    frequency = np.linspace(0.5, 12, lines)
    turned = np.exp(0.3j * frequency)[:, None]
    return replace(
        left, frequency_hz=frequency, experiment=np.zeros(lines, dtype=np.int64), predicted=y, normalised=e,
        measured=y + share * turned * y + noise * e, variance=np.full(shape, 2 * noise**2), sd=np.full(shape, noise),
        inputs=y[:, :1],
    )  # fmt: skip


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("share", [0.0, 0.02])
def test_bounds_hold_as_stated(fitted: tuple[Residuals, Estimate], share: float, known: bool) -> None:
    """Each of the two in 95 % of 400 draws at least; fewer than 92.5 % have a chance of 1.5 % (binomial).

    An upper bound of nothing is never missed, and a lower one of more than 0 in 5 % at the most.
    """
    left, estimate = fitted
    free = replace(estimate, names=())  # nothing has been fitted to these draws
    name = left.channels[int(np.flatnonzero(MOTIONS)[0])]
    above = below = 0
    for seed in range(DRAWS):
        drawn = _drawn(left, share, 0.05, 400, seed)
        found = discrepancies(drawn, free, MOTIONS, known)[name]
        assert found is not None
        above += found.upper95 >= share
        below += found.lower95 <= share
    assert min(above, below) >= 0.925 * DRAWS
    assert share == 0 or above < DRAWS  # a bound that always holds says nothing


def test_exact_residuals_have_no_bounds_apart(fitted: tuple[Residuals, Estimate]) -> None:
    left, estimate = fitted
    found = discrepancies(_drawn(left, 0.02, 0.0, 60, 1), estimate, MOTIONS, known_noise=True)
    for each in found.values():
        assert each is not None
        assert each.lower95 == each.value == each.upper95 == pytest.approx(0.02, rel=1e-2)


def _judged(model: Model, data: Spectrum, within: float | None = None) -> Estimate:
    return examined(model, data, identify(model, data), within=within)


@pytest.fixture(scope="module")
def shaken() -> WholeTest:
    """Two masses on a base that moves at random, without noise."""
    model, theta = chain(2, 0.03)
    return record_of(model, theta, "random", decay_times=12, seed=3)


def _whole(test: WholeTest, noise: float, seed: int) -> Spectrum:
    sd = np.where([channel.name == "u" for channel in test.record.channels], 0.0, noise) * test.size
    return spectrum([test.noisy(random_generator(seed), sd)])


@pytest.mark.slow
def test_whole_records_fit_without_a_record_at_rest(shaken: WholeTest) -> None:
    """Three draws of 0.3 to 5 % noise; all miss less than half of their noise."""
    for seed, noise in enumerate((0.003, 0.02, 0.05)):
        assessment = _judged(shaken.model, _whole(shaken, noise, seed)).assessment
        assert assessment is not None
        assert assessment.verdict == "fits"
        for each in assessment.discrepancy.values():
            assert each is not None
            assert each.upper95 < noise / 2


def test_a_whole_record_of_another_rig_does_not_fit(shaken: WholeTest) -> None:
    """A known mass that is 10 % too small, hidden from χ², which has no power there."""
    m1 = next(element.value for element in shaken.model.elements if element.name == "m1")
    wrong = changed(changed(shaken.model, "m1", value=0.9 * m1), "m2", value=float(shaken.theta[0]))
    data = _whole(shaken, 0.01, 0)
    assessment = assess(wrong, data, identify(wrong, data))
    assert assessment.verdict == "does not fit"
    assert any(each is not None and each.lower95 > each.within for each in assessment.discrepancy.values())


@pytest.mark.slow
def test_what_is_asked_decides(shaken: WholeTest) -> None:
    data = _whole(shaken, 0.02, 1)
    for within, verdict, codes in ((0.05, "fits", set()), (1e-6, "cannot tell", {"discrepancy_bound"})):
        estimate = _judged(shaken.model, data, within)
        assert estimate.assessment is not None
        assert estimate.assessment.verdict == verdict
        assert {reason.code for reason in estimate.assessment.reasons} == codes
        again = Estimate.from_json(estimate.to_json()).assessment
        assert again is not None
        assert again.within == within
        assert dict(again.discrepancy) == dict(estimate.assessment.discrepancy)


@pytest.mark.slow
def test_little_that_chi2_rejects_fits_and_much_does_not() -> None:
    """Noise of 0.01 % makes χ² reject what the rounding of 0.2 % leaves; rounding of 10 % is too much."""
    exact = rigs.perfect(PAPER, CHANNELS)
    V = np.zeros_like(exact.covariance)
    V[..., MOTIONS, MOTIONS] = (1e-4 * np.abs(exact.amplitudes[:, MOTIONS])) ** 2

    def rounded(size: float) -> tuple[Spectrum, Estimate]:
        rng = random_generator(5)
        shape = exact.amplitudes.shape
        away = size * (rng.normal(size=shape) + 1j * rng.normal(size=shape)) * MOTIONS
        data = replace(
            exact, amplitudes=exact.amplitudes * (1 + away), covariance=V, noise=("given",) * exact.lines
        )
        estimate = identify(PAPER.model, data)
        assert float(estimate.fit.p) < 0.01
        return data, estimate

    assert examined(PAPER.model, *rounded(0.002)).assessment.verdict == "fits"
    assert assess(PAPER.model, *rounded(0.1)).verdict == "does not fit"


def test_a_rig_file_says_within_what() -> None:
    text = 'coordinates = ["x"]\n[masses]\nm = { at = "x", value = 1 }\n[springs]\nk = { between = ["x", "ground"] }\n'
    rig = parse_rig(text + '[verdict]\nwithin = "2 %"\n')
    assert rig.within == 0.02
    assert parse_rig(write_rig(rig)).within == 0.02
    assert parse_rig(text).within is None
    for wrong in ('within = "2 N"', "within = 0", "within = 2", "withn = 0.1"):
        with pytest.raises(ModelError, match="verdict"):
            parse_rig(f"{text}[verdict]\n{wrong}\n")
