"""Criteria, their slopes and curvature against differences."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot.design.criteria import (
    AOptimal,
    Criterion,
    DOptimal,
    Minimax,
    MinimaxTargets,
    criterion_curvature,
    criterion_slopes,
    criterion_value,
)
from tests.designs import random_information, setup_in_scenarios

CRITERIA: list[Criterion] = [
    AOptimal(), Minimax(), DOptimal(), AOptimal(("c2",)), DOptimal(("m1", "c4")),
    MinimaxTargets({"c2": 0.02, "m1": 0.005}),
]  # fmt: skip


@pytest.mark.parametrize("criterion", CRITERIA, ids=str)
@pytest.mark.parametrize("robustness", ["average", "worst"])
def test_slopes_and_curvature_against_differences(criterion: Criterion, robustness: str) -> None:
    rng = np.random.default_rng(0)
    own = setup_in_scenarios(2)
    terms = criterion.terms(own, robustness)  # type: ignore[arg-type]
    M = random_information(rng, 5, 6)
    w = rng.uniform(0.5, 1, 5)
    y = rng.uniform(0.1, 1, len(terms.weights))

    def parts(w: np.ndarray) -> np.ndarray:
        return criterion_value(terms, np.einsum("i,siab->sab", w, M)).parts

    at = criterion_value(terms, np.einsum("i,siab->sab", w, M))
    step = 1e-5
    ends = [(parts(w + step * e), parts(w - step * e)) for e in np.eye(5)]
    slope = np.array([(a - b) / (2 * step) for a, b in ends]).T
    assert np.allclose(-criterion_slopes(terms, at, M), slope, rtol=1e-6, atol=1e-9)
    H = np.empty((5, 5))
    for i, e in enumerate(np.eye(5)):
        up, down = (criterion_value(terms, np.einsum("i,siab->sab", w + s * step * e, M)) for s in (1, -1))
        H[i] = y @ (-criterion_slopes(terms, up, M) + criterion_slopes(terms, down, M)) / (2 * step)
    assert np.allclose(criterion_curvature(terms, at, M, y), H, rtol=1e-5, atol=1e-8 * np.max(np.abs(H)))


def test_what_rounding_alone_determines_is_open() -> None:
    """Two lines of one sensor are 4 numbers for 6 unknowns: Cholesky may or may not notice."""
    rng = np.random.default_rng(1)
    terms = AOptimal().terms(setup_in_scenarios(1), "worst")
    for _ in range(200):
        J = rng.standard_normal((4, 6)) * 10 ** rng.uniform(-3, 3, 6)
        assert np.inf == criterion_value(terms, (J.T @ J)[None]).F
