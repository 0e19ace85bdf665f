"""Errors of known parameters move the estimates as stated."""

import numpy as np
import pytest

from dashpot.check.evidence import known_errors
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables, OptimalIV
from dashpot.estimate.method import Method
from tests.networks import changed, network
from tests.rigs import Rig, measured, paper_rig
from tests.whole_rigs import chain, record_of


@pytest.mark.parametrize(
    "method", [OptimalIV(), MaximumLikelihood(), InstrumentalVariables()], ids=lambda m: m.name
)
def test_errors_of_known_parameters_move_the_estimate_as_told(method: Method) -> None:
    """Against identification with a known spring off by ±0.5 %, residuals of 3 %: to the curvature of that."""
    rig = paper_rig()
    spectrum = measured(rig)
    estimate = identify(rig.model, spectrum, method)
    found = known_errors(rig.model, spectrum, estimate, method)
    assert found.known == ("k1", "k2")
    for k, name in enumerate(found.known):
        ends = [
            identify(rig.knowing({name: {"value": 4600.0 * (1 + off)}}).model, spectrum, method).values
            for off in (0.005, -0.005)
        ]
        moved = (ends[0] - ends[1]) / estimate.values / 0.01
        np.testing.assert_allclose(found.relative[k], moved, rtol=1e-3, atol=1e-3)
    # All forces scale together: 1 % on both springs is 1 % on everything.
    np.testing.assert_allclose(np.sum(found.relative, axis=0), 1.0, atol=1e-4)


def test_errors_of_a_value_with_sd_are_those_of_its_prior() -> None:
    rig = paper_rig().knowing({"k1": {"value": 4600.0, "sd": 60.0}})
    spectrum = measured(rig)
    estimate = identify(rig.model, spectrum)
    found = known_errors(rig.model, spectrum, estimate)
    k = found.known.index("k1")
    assert found.stated[k] == 60.0
    ends = [
        identify(rig.knowing({"k1": {"value": 4600.0 + off, "sd": 60.0}}).model, spectrum).values
        for off in (20.0, -20.0)
    ]
    np.testing.assert_allclose(found.slopes[k], (ends[0] - ends[1]) / 40.0, rtol=2e-3, atol=1e-7)


def test_errors_of_known_parameters_in_whole_records() -> None:
    """The loads of a record's ends follow the rig in which the known mass is free."""
    model, theta = chain(2)
    test = record_of(model, theta, "random")
    spectrum = whole_record(test.noisy(np.random.default_rng(4), 0.01 * test.size))
    estimate = identify(model, spectrum)
    found = known_errors(model, spectrum, estimate)
    assert found.known == ("m1",)
    value = float(found.known_values[0])
    ends = []
    for off in (0.005, -0.005):
        ends.append(identify(changed(model, "m1", value=value * (1 + off)), spectrum).values)
    moved = (ends[0] - ends[1]) / (0.01 * value)
    np.testing.assert_allclose(
        found.slopes[0] / estimate.sd, moved / estimate.sd, rtol=2e-2, atol=0.02 / value
    )


def test_nothing_known_has_no_errors() -> None:
    model = network("x", "f@x", "m@x k:x-ground")
    rig = Rig(
        model,
        np.array([1.0, 400.0]),
        np.array([1.0, 4.0]),
        np.zeros((2, 0), complex),
        np.ones((2, 1), complex),
    )
    spectrum = measured(rig)
    with pytest.raises(UsageError, match="no parameter"):
        known_errors(model, spectrum, identify(model, spectrum))
