"""Without a named method: the one that suits, and another where it is no answer."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dashpot.channel import Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.errors import IdentifiabilityError
from dashpot.estimate import automatic
from dashpot.estimate.automatic import identify_with_noise, plausible
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.result import Estimate
from tests import rigs


def chain(seed: int, n: int = 5) -> tuple[rigs.Rig, Spectrum]:
    """A fully seen rig at 20 % relative noise."""
    rig = rigs.plain_rig(np.random.default_rng(100 * n + seed), n)
    channels = rigs.channels(rig, (Quantity.DISPLACEMENT,))
    V = rigs.covariance(rig, channels, 0.2)
    return rig, rigs.noisy(rig, channels, V, np.random.default_rng(seed))


def test_an_answer_is_left_alone() -> None:
    rig, spectrum = chain(0, n=2)
    first = identify(rig.model, spectrum)
    assert plausible(rig.model, first)
    again = identify_with_noise(rig.model, spectrum)[0]
    assert again.method == "oiv"
    np.testing.assert_array_equal(again.values, first.values)


def test_another_method_answers_where_the_first_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, spectrum = chain(1, n=2)

    def refusing(model, spectrum, method, **rest):  # type: ignore[no-untyped-def]
        raise IdentifiabilityError("the data do not determine m1")

    monkeypatch.setattr(automatic, "estimate_by_plan", refusing)
    estimate = identify_with_noise(rig.model, spectrum)[0]
    assert estimate.method == "ml"
    assert [warning.code for warning in estimate.warnings][-1] == "another_method"
    assert np.all(np.abs(estimate.values - rig.theta) < 6 * estimate.sd)


def constant(seed: int, n: int) -> tuple[rigs.Rig, Spectrum]:
    """A fully seen rig whose channels have a noise of 5 % of their rms at every line."""
    rig, _ = chain(seed, n)
    channels = rigs.channels(rig, (Quantity.DISPLACEMENT,))
    Y = rigs.amplitudes(rig, channels)
    driven = set(rig.model.displacement_inputs)
    noisy = np.array([not set(channel.of) <= driven for channel in channels])
    variance = 0.05**2 * np.mean(np.abs(Y) ** 2, axis=0) * noisy
    V = np.broadcast_to(np.diag(variance).astype(complex), (rig.lines, len(channels), len(channels)))
    return rig, rigs.noisy(rig, channels, V, np.random.default_rng(seed))


def beside_truth(rig: rigs.Rig, spectrum: Spectrum) -> Estimate:
    """The minimum that a descent from the true values ends in."""
    signs = (1.0,) * len(spectrum.channels)
    return identify(rig.model, spectrum, MaximumLikelihood(start=tuple(rig.theta.tolist()), start_sign=signs))


def told(estimate: Estimate) -> bool:
    return any(warning.code == "not_unique" for warning in estimate.warnings)


@pytest.mark.parametrize(("seed", "n"), [(0, 5), (21, 5), (5, 2)])
def test_a_valley_that_fits_is_left_for_a_lower_one(seed: int, n: int) -> None:
    """χ² does not reject where oiv ends (p 0.05, 0.80 and 0.48), yet it lies 31, 18, 20 above the truth's minimum."""
    rig, spectrum = chain(seed, n)
    first, best = identify(rig.model, spectrum), beside_truth(rig, spectrum)
    assert first.fit.p > 0.01
    assert first.fit.chi2 > best.fit.chi2 + 15
    estimate = identify_with_noise(rig.model, spectrum)[0]
    np.testing.assert_allclose(estimate.values, best.values, rtol=1e-4)


@pytest.mark.parametrize(("seed", "n"), [(1115, 5), (1080, 3)])
def test_a_minimum_with_a_part_of_the_other_sign_is_found_from_about_an_end(seed: int, n: int) -> None:
    """Positive parts lead to an end 6.8 and 0.7 of χ² above: within the odds of 100 to 1, so that it is told."""
    rig, spectrum = chain(seed, n)
    estimate = identify_with_noise(rig.model, spectrum)[0]
    np.testing.assert_allclose(estimate.values, beside_truth(rig, spectrum).values, rtol=1e-4)
    assert told(estimate)


def test_what_fits_alike_is_told() -> None:
    """The other minimum lies 0.5 of χ² from the truth's: neither can be called wrong."""
    rig, spectrum = chain(31)
    estimate = identify_with_noise(rig.model, spectrum)[0]
    assert abs(estimate.fit.chi2 - beside_truth(rig, spectrum).fit.chi2) < 1
    assert told(estimate)


def test_what_runs_off_to_infinity_is_no_end() -> None:
    rig, spectrum = chain(38, n=3)
    estimate = identify_with_noise(rig.model, spectrum)[0]
    assert plausible(rig.model, estimate)
    assert not plausible(rig.model, replace(estimate, noise_covariance=1e16 * estimate.noise_covariance))
    assert estimate.converged
    assert np.all(estimate.noise_sd < 1e2 * np.abs(rig.theta))


@pytest.mark.long
@pytest.mark.parametrize(("make", "n"), [(chain, 3), (chain, 5), (constant, 5)])
def test_no_wrong_valley_is_silent(make: Callable[..., tuple[rigs.Rig, Spectrum]], n: int) -> None:
    """An end is wrong whose χ² lies above that beside the truth, where no part is negative beyond doubt.

    At most one of 80 may be, by chance of the starts; none without a word of the other.  oiv alone is wrong in up to
    half of them.
    """
    wrong = silent = 0
    for seed in range(80):
        rig, spectrum = make(seed, n)
        best = beside_truth(rig, spectrum)
        estimate = identify_with_noise(rig.model, spectrum)[0]
        physical = bool(best.converged) and bool(np.all(best.values > -2 * best.noise_sd))
        above = float(estimate.fit.chi2 - best.fit.chi2)
        wrong += physical and above > 0.05
        silent += physical and above > 0.05 and bool(estimate.converged) and not told(estimate)
    assert wrong <= 1
    assert silent == 0
