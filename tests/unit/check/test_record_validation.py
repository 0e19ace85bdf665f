"""Whole records of nonlinear rigs that were not used, against noise that a record at rest shows."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.validation import validate_records
from dashpot.data.noise import noise_at_rest
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.estimate.result import Estimate
from tests.driven_rigs import cubic


@pytest.mark.slow
def test_the_noise_that_a_rig_passes_on_from_its_base_is_counted() -> None:
    """3 % of noise on the base is five times that of the output behind a light damper.

    χ²/dof of 597 samples: 1 ± 0.06, four standard deviations; a spring 3 % too stiff is seen.  Seeds 1, 2 and 0.
    """
    test = cubic(600)
    sd = np.array([0.01, 0.03]) * np.std(test.record.values, axis=0)
    rest = sd * np.random.default_rng(0).standard_normal(test.record.values.shape)
    still = noise_at_rest([replace(test.record, values=rest)])
    estimate = fit_records(test.model, [test.noisy(0.01, 0.03, 1)], still=still).estimate()

    def per_freedom(judged: Estimate, noise: float) -> float:
        (part,) = validate_records(test.model, judged, [test.noisy(0.01, noise, 2)], still)
        assert part.dof[0] == 597
        return float(part.chi2[0] / part.dof[0])

    assert 0.76 < per_freedom(estimate, 0.03) < 1.24
    stiff = estimate.values * np.where(np.array(estimate.names) == "k", 1.03, 1.0)
    assert per_freedom(replace(estimate, values=stiff), 0.03) > 1.5
    assert np.all(np.isnan(validate_records(test.model, estimate, [test.noisy(0.01, 0.03, 2)])[0].chi2))


def test_the_start_of_a_record_in_the_middle_of_a_strong_motion_is_found() -> None:
    """Two steps of Gauss and Newton from rest left 30 % of the motion of an exact record unexplained."""
    test = cubic(1200)
    first, last = (
        replace(test.record, time=test.record.time[part], values=test.record.values[part])
        for part in (slice(300), slice(900, 1200))
    )
    estimate = fit_records(test.model, [first]).estimate()
    (prediction,) = validate_records(test.model, estimate, [last])
    assert prediction.fit[0] > 0.999
