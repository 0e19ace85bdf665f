"""Profile likelihood: ends and bounds."""

import numpy as np
import pytest

from dashpot.check.profile import profile
from dashpot.errors import UsageError
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.table_noise import with_residual_noise
from dashpot.estimate.linear.instrumental_variables import OptimalIV
from tests.networks import changed
from tests.rigs import channels, covariance, measured, of_unknown_noise, paper_rig, perfect


def test_profile_of_a_parabola_is_the_normal_interval() -> None:
    rig = paper_rig()
    spectrum = measured(rig, 1e-3)
    estimate = identify(rig.model, spectrum)
    for name in estimate.names:
        for level in (0.68, 0.95):
            found = profile(rig.model, spectrum, name, level, estimate)
            assert found.difference < 0.005
            assert not found.misleads
    assert not found.improved
    assert np.all(np.diff(found.points) > 0)
    assert np.min(found.rise) == 0.0


def test_profile_ends_are_where_a_search_with_the_value_fixed_says() -> None:
    """χ² of the fit with the damper known at the end, against the threshold; the rig is far from linear there."""
    rig = paper_rig([2.0, 4.0, 9.0])
    spectrum = measured(rig, 0.15, seed=3)
    estimate = identify(rig.model, spectrum)
    found = profile(rig.model, spectrum, "c2", 0.95, estimate)
    assert found.misleads
    for end in (found.lower, found.upper):
        if not np.isfinite(end) or end < 0:
            continue
        held = identify(rig.knowing({"c2": {"value": float(end)}}).model, spectrum, OptimalIV())
        assert held.fit.chi2 - estimate.fit.chi2 == pytest.approx(float(found.threshold), rel=0.01)


def test_profile_stops_at_a_bound() -> None:
    rig = paper_rig([2.0, 4.0, 9.0])
    bounded = changed(rig.model, "c2", lower=35.0)
    spectrum = measured(rig, 0.15, seed=3)
    found = profile(bounded, spectrum, "c2", estimate=identify(bounded, spectrum, MaximumLikelihood()))
    assert found.lower == 35.0


def test_profile_where_the_noise_is_unknown_uses_the_residuals() -> None:
    rig = paper_rig()
    spectrum = measured(rig, 1e-3)
    silent = of_unknown_noise(spectrum)
    silent, method = with_residual_noise(rig.model, silent, automatic(rig.model, silent))
    estimate = identify(rig.model, silent, method)
    found = profile(rig.model, silent, "m1", estimate=estimate)
    assert found.difference < 0.005


def test_profile_of_a_stranger() -> None:
    rig = paper_rig()
    with pytest.raises(UsageError, match="not among the unknowns"):
        profile(rig.model, perfect(rig, channels(rig), covariance(rig, channels(rig), 0.01)), "k1")
