"""The JSON of an estimate of very many unknowns leaves its covariance out, and is read again with the variances."""

import json

import numpy as np
import pytest

from dashpot import Estimate, identify
from dashpot.estimate import result as estimate_json
from tests.partly_seen import noisy_base


def test_above_a_size_the_covariance_is_null(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = noisy_base()
    estimate = identify(bench.model, bench.spectrum(np.random.default_rng(2)))
    whole = json.loads(estimate.to_json())
    assert whole["covariance"] == estimate.covariance.tolist()
    monkeypatch.setattr(estimate_json, "MOST_COVARIANCE", len(estimate.names) - 1)
    text = estimate.to_json()
    assert json.loads(text)["covariance"] is None
    assert json.loads(text)["noise_covariance"] is None
    again = Estimate.from_json(text)
    np.testing.assert_array_equal(again.values, estimate.values)
    np.testing.assert_allclose(again.sd, estimate.sd, rtol=1e-15)
    np.testing.assert_allclose(again.interval(), estimate.interval(), rtol=1e-12)
