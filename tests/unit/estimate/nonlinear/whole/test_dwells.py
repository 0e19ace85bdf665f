"""Identification of nonlinear rigs from the harmonics of dwells."""

import numpy as np
import pytest

from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from tests.nonlinear_rigs import motions, settled, two_masses

FREQUENCIES = [2, 3, 4, 5, 6, 7, 8, 9.5, 11, 12.5, 14]
ALL = motions("x1", "x2", "u")


@pytest.mark.long
def test_a_one_sided_spring_is_found_where_its_regression_misleads():
    """Harmonics 1 and 3 show neither the offset nor the second harmonic that such a spring makes."""
    model, theta = two_masses("one-sided")
    spectrum = settled(model, theta, ALL, FREQUENCIES, noise=0.005, rng=np.random.default_rng(3))
    estimate = identify(model, spectrum, "ml")
    assert float(estimate.fit.p) > 0.01
    assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)


def test_noisy_harmonics_give_intervals_that_hold():
    model, theta = two_masses("cubic")
    spectrum = settled(model, theta, ALL, FREQUENCIES, noise=0.01, rng=np.random.default_rng(3))
    estimate = identify(model, spectrum)
    assert estimate.method == "ml"
    assert float(estimate.fit.p) > 0.01
    assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)
    assert np.allclose(estimate.sd, estimate.bound_sd, rtol=1e-6)


def test_the_fit_is_judged_with_the_harmonics_that_the_search_needed():
    """A stiff spring needs fifteen; with seven the end of the search is no minimum."""
    model, theta = two_masses("quintic")
    spectrum = settled(model, theta, ALL, FREQUENCIES, noise=0.005, rng=np.random.default_rng(3))
    estimate = identify(model, spectrum, "ml")
    assert bool(estimate.converged)
    assert np.all(np.abs(estimate.values - theta) < 4 * estimate.sd)


def test_a_noisy_input_widens_the_intervals_and_they_hold():
    model, theta = two_masses("cubic")
    rng = np.random.default_rng(5)
    exact = identify(model, settled(model, theta, ALL, FREQUENCIES, noise=0.005, rng=rng))
    spectrum = settled(model, theta, ALL, FREQUENCIES, noise=0.005, input_noise=0.005, rng=rng)
    noisy = identify(model, spectrum)
    assert float(noisy.fit.p) > 0.01
    assert np.all(np.abs(noisy.values - theta) < 4 * noisy.sd)
    assert np.all(noisy.sd > exact.sd)


def test_a_linear_rig_fitted_to_nonlinear_data_does_not_fit():
    model, theta = two_masses("cubic")
    spectrum = settled(model, theta, ALL, FREQUENCIES, orders=(1,), noise=0.005, rng=np.random.default_rng(3))
    linear = type(model)(model.coordinates, model.inputs, model.elements[:-1])
    assert bool(identify(linear, spectrum, "ml").fit.rejected)


def test_methods_that_know_linear_rigs_only_say_so():
    model, theta = two_masses("cubic")
    with pytest.raises(UsageError, match="nonlinear"):
        identify(model, settled(model, theta, ALL, FREQUENCIES), "tls")
