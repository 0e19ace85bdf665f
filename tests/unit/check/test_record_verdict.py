"""The verdict on whole records of nonlinear rigs."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.explain.in_time import assess_records
from dashpot.data.noise import noise_at_rest
from dashpot.data.record import Record
from dashpot.estimate.assessment import Assessment
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.notices import Notice
from tests.driven_rigs import coulomb, cubic
from tests.nonlinear_rigs import motions
from tests.unit.estimate.nonlinear.test_whole_record import chaotic, record


@pytest.fixture(scope="module")
def fitted() -> tuple[Model, Record, Estimate]:
    model, _, data = record("cubic", motions("x1", "x2", "u"), noise=0.02, samples=300)
    return model, data, fit_records(model, [data]).estimate()


@pytest.mark.slow
def test_residuals_are_told_in_parts_of_the_motion(fitted: tuple[Model, Record, Estimate]) -> None:
    """2 % of white noise on 300 samples: rms within 4.1 % (one standard deviation); seed 0."""
    model, data, estimate = fitted
    assessment = assess_records(model, [data, data], estimate)
    assert assessment.verdict == "cannot tell"
    assert [reason.code for reason in assessment.reasons] == ["no_noise"]
    assert assessment.relative_residual == pytest.approx({"x1": 0.02, "x2": 0.02}, rel=0.1)
    assert len(assessment.worst) == 3


@pytest.mark.long
def test_a_part_that_is_negative_beyond_doubt_is_no_fit(fitted: tuple[Model, Record, Estimate]) -> None:
    model, data, estimate = fitted
    damper = estimate.names.index("c1")
    values = np.where(np.arange(len(estimate.names)) == damper, -estimate.values, estimate.values)
    assessment = assess_records(model, [data], replace(estimate, values=values))
    assert assessment.verdict == "does not fit"
    assert assessment.reasons[0].text == "c1 is negative"


def test_motion_that_cannot_be_followed_whole_is_not_compared(fitted: tuple[Model, Record, Estimate]) -> None:
    model, data, estimate = fitted
    cut = replace(estimate, warnings=(Notice("cut_record", "cut into 3 pieces"),))
    assert assess_records(model, [data], cut).relative_residual == {}


@pytest.mark.slow
def test_noise_of_the_base_calls_for_nothing_and_a_record_at_rest_makes_the_fit_testable() -> None:
    """3 % of noise on a base, which a light damper amplifies: friction seemed to explain 37 % of it; seeds 1 and 0.

    Residuals twice as large as the noise at rest are no fit.
    """
    test = cubic(250)
    record = test.noisy(0.01, 0.03, 1)
    sd = np.array([0.01, 0.03]) * np.std(test.record.values, axis=0)
    at_rest = np.random.default_rng(0).standard_normal(record.values.shape)

    def judged(noise: float) -> Assessment:
        still = noise_at_rest([replace(record, values=noise * sd * at_rest)])
        fitted = fit_records(test.model, [record], still=still)
        return assess_records(test.model, [record], fitted.estimate(), fitted)

    fits, too_large = judged(1.0), judged(0.5)
    assert (fits.verdict, too_large.verdict) == ("fits", "does not fit")
    assert [reason.code for reason in too_large.reasons] == ["chi2"]
    assert fits.relative_residual["x"] == pytest.approx(0.01, rel=0.2)  # beside the likeliest inputs


@pytest.mark.long
def test_an_element_that_is_missing_is_named_beside_noise_of_the_base() -> None:
    friction, rig = coulomb(500), cubic(500).model
    record = friction.noisy(0.01, 0.01, 2)
    fitted = fit_records(rig, [record])
    assert fitted.noise is not None
    assessment = assess_records(rig, [record], fitted.estimate(), fitted)
    assert assessment.verdict == "does not fit"
    assert "friction" in assessment.findings[0].text


@pytest.mark.long
def test_a_record_that_is_cut_into_segments_is_judged_by_them() -> None:
    """For longer no motion can be followed: what a search from its start leaves has no cause."""
    model, _, data = chaotic(1000)
    fitted = fit_records(model, [data])
    assessment = assess_records(model, [data], fitted.estimate(), fitted)
    assert fitted.problem.pieces > 1
    assert assessment.verdict == "cannot tell"
    assert assessment.findings == ()
    assert assessment.relative_residual["x"] == pytest.approx(0.01, rel=0.15)
