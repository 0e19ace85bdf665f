"""Small faults that χ² passes are found by tests that look for them, and clean data raise no alarm."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.check.explain.examine import directed, examined
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.model.elements import Kind, between
from dashpot.model.network import Model
from tests import rigs
from tests.mistakes import times

RIG = rigs.paper_rig()
CHANNELS = rigs.channels(RIG, (Quantity.DISPLACEMENT,))


def clean(seed: int, noise: float = 0.002, inputs: float = 0.002) -> Spectrum:
    V = rigs.covariance(RIG, CHANNELS, noise, inputs=inputs)
    return rigs.noisy(RIG, CHANNELS, V, np.random.default_rng(seed))


def late(spectrum: Spectrum, tau: float) -> Spectrum:
    for c in (0, 1):
        spectrum = times(spectrum, c, np.exp(-1j * spectrum.omega * tau))
    return spectrum


@pytest.mark.parametrize("inputs", [0.002, 0.0])
def test_motions_that_are_late_are_found_where_chi2_passes(inputs: float) -> None:
    """0.3 ms at 25 Hz and less.  An input that is exact is early instead."""
    told = passed = 0
    for seed in range(12):
        spectrum = late(clean(seed, inputs=inputs), 3e-4)
        estimate = identify(RIG.model, spectrum)
        passed += bool(estimate.fit.p > 0.01)
        causes = directed(RIG.model, spectrum, estimate)
        told += bool(causes) and causes[0].kind == "delay"
        if causes and causes[0].of == ("d_u",):
            assert causes[0].number is not None
            assert -5e-4 < causes[0].number < -1e-4
    assert told >= 9
    assert passed >= (5 if inputs else 1)


def test_a_gain_of_half_a_per_cent_forbids_a_fit_and_is_named() -> None:
    spectrum = times(clean(1, 0.004, 0.004), 0, 1.005)
    estimate = identify(RIG.model, spectrum)
    assert estimate.fit.p > 0.01
    assessment = examined(RIG.model, spectrum, estimate).assessment
    assert assessment.verdict == "does not fit"
    assert assessment.reasons[0].code == "directed"
    first = assessment.findings[0]
    assert (first.kind, first.of) == ("gain", ("d_x1",))
    assert first.number == pytest.approx(1.005, abs=0.002)
    assert "gain = 1.0" in first.change


def test_a_spring_that_is_missing_is_found() -> None:
    """To the ground, so weak that χ² passes."""
    extra = between("k3", Kind.SPRING, "x1", "ground", value=15.0)
    stiffer = replace(RIG, model=replace(RIG.model, elements=(*RIG.model.elements, extra)))
    spectrum = rigs.noisy(
        stiffer, CHANNELS, rigs.covariance(stiffer, CHANNELS, 0.003, inputs=0.003), np.random.default_rng(3)
    )
    estimate = identify(RIG.model, spectrum)
    assert estimate.fit.p > 0.01
    first = directed(RIG.model, spectrum, estimate)[0]
    assert (first.kind, first.of) == ("element", ("x1", "ground"))
    assert first.number == pytest.approx(15, abs=6)


def test_clean_data_raise_no_alarm() -> None:
    """One in a thousand by design: more than two of sixty have a chance of 4e-5."""
    alarms = 0
    for seed in range(60):
        spectrum = clean(1000 + seed, 0.01, 0.01)
        alarms += bool(directed(RIG.model, spectrum, identify(RIG.model, spectrum)))
    assert alarms <= 2


def test_what_has_no_noise_size_is_not_tested() -> None:
    spectrum = clean(1)
    unknown = rigs.of_unknown_noise(spectrum)
    model: Model = RIG.model
    assert directed(model, unknown, identify(model, unknown)) == ()
