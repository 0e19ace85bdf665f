"""Sums over the lines of the equation of motion."""

import numpy as np
import pytest

from dashpot.estimate.linear.gram import sums_of_lines


@pytest.mark.filterwarnings("error")
def test_without_priors_a_search_that_goes_far_astray_has_a_cost() -> None:
    """The square of 1e200 times a precision of 0 was no number, and a warning in the middle of the output."""
    theta = np.array([[1e200, -3e170]])
    sums = sums_of_lines(
        np.ones((1, 5, 2, 2)), np.ones((1, 5, 2)), np.full((1, 5), 2.0), theta, np.zeros(2), np.zeros(2)
    )
    assert sums.cost.tolist() == [10.0]
    with_prior = sums_of_lines(
        np.ones((1, 5, 2, 2)), np.ones((1, 5, 2)), np.full((1, 5), 2.0), np.array([[3.0, 1e200]]),
        np.array([0.5, 0.0]), np.array([1.0, 0.0]),
    )  # fmt: skip
    assert with_prior.cost.tolist() == [12.0]
