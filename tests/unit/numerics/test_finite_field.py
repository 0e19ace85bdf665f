"""Exact ranks, null spaces and solutions modulo a prime."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.numerics import finite_field as field
from dashpot.numerics.finite_field import PRIME


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 6), st.integers(0, 6))
def test_ranks_and_null_spaces_of_integers(seed: int, rows: int, columns: int, inner: int) -> None:
    """Against floating point, on products of small integers whose rank both can tell."""
    rng = np.random.default_rng(seed)
    A = rng.integers(-3, 4, (rows, inner)) @ rng.integers(-3, 4, (inner, columns))
    assert field.rank(A) == np.linalg.matrix_rank(A)
    basis = field.null_space(A)
    assert len(basis) == columns - field.rank(A)
    assert not np.any((A % PRIME) @ basis.T.astype(object) % PRIME)


@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_solutions_are_exact(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    A, b = rng.integers(0, PRIME, (3, n, n)), rng.integers(0, PRIME, (3, n, 2))
    A[0, 0] = 0
    x, regular = field.solve_modulo(A, b)
    assert not regular[0]
    assert np.all(regular[1:])
    assert np.all((A[1:].astype(object) @ x[1:].astype(object) - b[1:]) % PRIME == 0)


def test_residues_read_numbers_as_they_are_written() -> None:
    assert (field.residue(0.1) + field.residue(0.2) - field.residue(0.3)) % PRIME == 0
    assert field.residue(1 / 3) * 3 % PRIME == 1
    assert field.residue(-2.5) * 2 % PRIME == PRIME - 5
    assert (field.ROOT**2 + 1) % PRIME == 0
