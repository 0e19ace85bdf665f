"""Candidates of a search: what calibrates them is what the likelihood predicts."""

import numpy as np

from dashpot.estimate.likelihood.global_search import _response
from dashpot.estimate.likelihood.objective import measured, predict
from dashpot.estimate.preparation import prepare
from dashpot.model.observation import observation_model
from tests.partly_seen import calibrations, reaction


def test_responses_without_slopes_are_those_of_the_likelihood() -> None:
    for make in (
        calibrations,
        reaction,
    ):  # unknown gains, delays and signs; forces that depend on the parameters
        bench, rng = make(), np.random.default_rng(2)
        spectrum = bench.spectrum(rng, 1)
        data = prepare(bench.model, spectrum)
        view = observation_model(bench.model, spectrum.channels, spectrum.omega)
        soft = measured(data, 1.0)
        assert soft.q is not None
        psi = bench.psi * np.exp(0.3 * rng.standard_normal((5, len(bench.psi))))
        sign = rng.choice([-1.0, 1.0], size=(5, len(view.channels)))
        expected = soft.y - predict(view, soft, psi, sign).r
        np.testing.assert_allclose(_response(view, soft, psi, sign), expected, rtol=1e-9, atol=1e-12)
