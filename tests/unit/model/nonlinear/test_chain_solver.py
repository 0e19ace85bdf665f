"""Residuals decorrelated by one sparse factorisation, against the covariance written out."""

import numpy as np

from dashpot.model.nonlinear.shooting import ChainSolver
from tests.unit.model.nonlinear.test_tangent import CHANNELS, SAMPLES, around, base


def test_it_is_the_inverse_of_the_covariance() -> None:
    along = around("cubic", base())
    weight, sd = np.array([1e5, 2e2, 1e5, 4e3, 2e2]), np.array([2e-5])
    each = np.eye(SAMPLES)[:, None, :]
    reach = sd * weight[:, None] * along.times(each)
    flat = reach.reshape(SAMPLES * len(CHANNELS), SAMPLES)
    columns = np.random.default_rng(0).standard_normal((SAMPLES, len(CHANNELS), 3))
    dense = np.linalg.solve(np.eye(len(flat)) + flat @ flat.T, columns.reshape(len(flat), 3))
    solved = ChainSolver(along, weight, sd).solve(columns)
    np.testing.assert_allclose(solved.reshape(len(flat), 3), dense, atol=1e-8 * np.abs(dense).max())
