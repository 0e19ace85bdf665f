"""Large rigs in their sparse pattern: against the dense twin."""

import numpy as np
import pytest
from scipy import sparse

from dashpot.model.dynamics import amplitudes, solve_stiffness, sparse_amplitudes
from dashpot.model.network import row_products
from tests.rigs import random_rig


def test_products_of_rows_are_outer_products() -> None:
    rng = np.random.default_rng(0)
    left = rng.normal(size=(40, 6)) * (rng.random((40, 6)) < 0.3)
    right = rng.normal(size=(40, 5)) * (rng.random((40, 5)) < 0.4)
    left[3], right[5] = 0.0, 0.0
    flat = row_products(sparse.csr_array(left), sparse.csr_array(right))
    assert np.array_equal(
        flat.toarray(), np.stack([np.outer(a, b).ravel() for a, b in zip(left, right, strict=True)])
    )


@pytest.mark.parametrize(("displacements", "forces"), [(1, 0), (2, 1), (0, 2)])
def test_responses_are_those_of_dense_matrices(displacements: int, forces: int) -> None:
    rng = np.random.default_rng(displacements)
    rig = random_rig(rng, 5, displacements=displacements, forces=forces)
    lines = len(rig.omega)
    p = rig.p * np.exp(0.1 * rng.standard_normal((3, 1, len(rig.p))))
    U = rng.normal(size=(2, lines, displacements)) + 1j * rng.normal(size=(2, lines, displacements))
    f = rng.normal(size=(lines, forces)) + 0j
    dense, other = (way(rig.model, p, rig.omega, U, f) for way in (amplitudes, sparse_amplitudes))
    assert dense.shape == other.shape == (3, 2, lines, 5)
    np.testing.assert_allclose(other, dense, rtol=1e-7, atol=1e-9 * np.max(np.abs(dense)))


def test_what_nothing_holds_has_no_response() -> None:
    rig = random_rig(np.random.default_rng(1), 3)
    weight = np.zeros(len(rig.p), dtype=complex)
    assert np.all(np.isnan(solve_stiffness(rig.model, weight, np.ones((3, 2), dtype=complex))))
