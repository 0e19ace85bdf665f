"""The verdict on whole records of nonlinear rigs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.record_verdict import assess_records
from dashpot.data.record import Record
from dashpot.estimate.nonlinear.record_inference import CUT_RECORD
from dashpot.estimate.nonlinear.whole_record import identify_records
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.notices import Notice
from tests.nonlinear_rigs import motions
from tests.unit.estimate.nonlinear.test_whole_record import record


@pytest.fixture(scope="module")
def fitted() -> tuple[Model, Record, Estimate]:
    model, _, data = record("cubic", motions("x1", "x2", "u"), noise=0.02)
    return model, data, identify_records(model, [data])


def test_residuals_are_told_in_parts_of_the_motion(fitted: tuple[Model, Record, Estimate]) -> None:
    """2 % of white noise on 800 samples: rms within 2.5 % (one standard deviation); seed 0."""
    model, data, estimate = fitted
    assessment = assess_records(model, [data, data], estimate)
    assert assessment.verdict == "cannot tell"
    assert [reason.code for reason in assessment.reasons] == ["no_noise"]
    assert assessment.relative_residual == pytest.approx({"x1": 0.02, "x2": 0.02}, rel=0.1)
    assert len(assessment.worst) == 3


def test_a_part_that_is_negative_beyond_doubt_is_no_fit(fitted: tuple[Model, Record, Estimate]) -> None:
    model, data, estimate = fitted
    damper = estimate.names.index("c1")
    values = np.where(np.arange(len(estimate.names)) == damper, -estimate.values, estimate.values)
    assessment = assess_records(model, [data], replace(estimate, values=values))
    assert assessment.verdict == "does not fit"
    assert assessment.reasons[0].text == "c1 is negative"


def test_motion_that_cannot_be_followed_whole_is_not_compared(fitted: tuple[Model, Record, Estimate]) -> None:
    model, data, estimate = fitted
    cut = replace(estimate, warnings=(Notice(CUT_RECORD, "cut into 3 pieces"),))
    assert assess_records(model, [data], cut).relative_residual == {}
