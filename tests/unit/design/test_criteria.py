"""Criteria, their slopes and curvature against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.design.allocation import Criterion
from tests.designs import random_information, setup_in_scenarios

CRITERIA: list[Criterion] = [
    Criterion("A"),
    Criterion("minimax"),
    Criterion("D"),
    Criterion("A", ("c2",)),
    Criterion("D", ("m1", "c4")),
    Criterion("minimax", targets={"c2": 0.02, "m1": 0.005}),
]


@pytest.mark.parametrize("criterion", CRITERIA, ids=str)
@pytest.mark.parametrize("robustness", ["average", "worst"])
def test_slopes_and_curvature_against_differences(criterion: Criterion, robustness: str) -> None:
    rng = np.random.default_rng(0)
    own = setup_in_scenarios(2)
    terms = criterion.terms(replace(own, over=robustness))
    M = random_information(rng, 5, 6)
    w = rng.uniform(0.5, 1, 5)
    y = rng.uniform(0.1, 1, len(terms.weights))

    def parts(w: np.ndarray) -> np.ndarray:
        return terms.at(np.einsum("i,siab->sab", w, M)).parts

    at = terms.at(np.einsum("i,siab->sab", w, M))
    step = 1e-5
    ends = [(parts(w + step * e), parts(w - step * e)) for e in np.eye(5)]
    slope = np.array([(a - b) / (2 * step) for a, b in ends]).T
    assert np.allclose(-at.slopes(M), slope, rtol=1e-6, atol=1e-9)
    H = np.empty((5, 5))
    for i, e in enumerate(np.eye(5)):
        up, down = (terms.at(np.einsum("i,siab->sab", w + s * step * e, M)) for s in (1, -1))
        H[i] = y @ (-up.slopes(M) + down.slopes(M)) / (2 * step)
    assert np.allclose(at.curvature(M, y), H, rtol=1e-5, atol=1e-8 * np.max(np.abs(H)))


def test_what_rounding_alone_determines_is_open() -> None:
    """Two lines of one sensor are 4 numbers for 6 unknowns: Cholesky may or may not notice."""
    rng = np.random.default_rng(1)
    terms = Criterion("A").terms(setup_in_scenarios(1))
    for _ in range(200):
        J = rng.standard_normal((4, 6)) * 10 ** rng.uniform(-3, 3, 6)
        assert np.inf == terms.at((J.T @ J)[None]).F
