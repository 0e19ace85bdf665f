"""Linear algebra over the integers modulo a prime: ranks without rounding.

The generic rank of a matrix of rational functions is the rank at a random point of a large field, but for a chance of
(degree / PRIME), and never less than generic at none (Schwartz 1980; Zippel 1979).  −1 has a square root here, so jω is
an element like any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache

import numpy as np

from dashpot.arrays import Bools, Ints

PRIME = 2147483629  # the largest below 2³¹ with −1 a square: products fit 64 bits
ROOT = pow(2, (PRIME - 1) // 4, PRIME)  # √−1, 2 being no square


@lru_cache(maxsize=4096)
def residue(number: float) -> int:
    """The number as it is written (0.6 is 3/5, 1/3 in sixteen digits is 1/3), modulo PRIME."""
    fraction = Fraction(number).limit_denominator(1000)
    if abs(float(fraction) - number) > 4e-16 * abs(number):
        fraction = Fraction(repr(float(number)))
    return fraction.numerator * pow(fraction.denominator, -1, PRIME) % PRIME


def residues(numbers: Sequence[float]) -> Ints:
    """`residue` of each, (numbers,)."""
    return np.array([residue(number) for number in numbers], dtype=np.int64)


def inverse(numbers: Ints) -> Ints:
    """Multiplicative inverses (Fermat); 0 for 0."""
    result, square, exponent = np.ones_like(numbers), numbers % PRIME, PRIME - 2
    while exponent:
        if exponent & 1:
            result = result * square % PRIME
        square = square * square % PRIME
        exponent >>= 1
    return result


def solve_modulo(matrix: Ints, right: Ints) -> tuple[Ints, Bools]:
    """(matrix⁻¹ right, whether it exists) for stacks (lines, n, n) and (lines, n, k), by Gauss and Jordan."""
    n = matrix.shape[-1]
    whole = np.concatenate([matrix, right], axis=-1) % PRIME
    lines = np.arange(len(whole))
    regular = np.ones(len(whole), dtype=bool)
    for column in range(n):
        pivot = column + np.argmax(whole[:, column:, column] != 0, axis=1)
        regular &= whole[lines, pivot, column] != 0
        row = whole[lines, pivot]
        whole[lines, pivot] = whole[:, column]
        row = row[:, column:] * inverse(row[:, column])[:, None] % PRIME
        factors = whole[:, :, column].copy()
        factors[:, column] = 0
        used = np.flatnonzero(np.any(factors != 0, axis=0))
        whole[:, used, column:] = (
            whole[:, used, column:] - factors[:, used, None] * row[:, None, :] % PRIME
        ) % PRIME
        whole[:, column, column:] = row
    return whole[..., n:], regular


def echelon(matrix: Ints, columns: int | None = None) -> tuple[Ints, list[int]]:
    """(reduced row echelon form, pivot columns) of (rows, k), eliminating only the first `columns`."""
    M = matrix % PRIME
    pivots: list[int] = []
    for column in range(M.shape[1] if columns is None else columns):
        rank = len(pivots)
        if rank == len(M):
            break
        below = np.flatnonzero(M[rank:, column])
        if not len(below):
            continue
        chosen = rank + int(below[0])
        M[[rank, chosen]] = M[[chosen, rank]]
        M[rank] = M[rank] * pow(int(M[rank, column]), -1, PRIME) % PRIME
        others = np.flatnonzero(M[:, column])
        others = others[others != rank]
        M[others] = (M[others] - M[others, column][:, None] * M[rank] % PRIME) % PRIME
        pivots.append(column)
    return M, pivots


def rank(matrix: Ints) -> int:
    """Rank of (rows, k)."""
    return len(echelon(matrix)[1])


def null_space(matrix: Ints) -> Ints:
    """A basis of {x: matrix x = 0}, (dimension, k): each vector has 1 at a column of its own and minimal support."""
    reduced, pivots = echelon(matrix)
    free = [column for column in range(matrix.shape[1]) if column not in set(pivots)]
    basis = np.zeros((len(free), matrix.shape[1]), dtype=np.int64)
    for k, column in enumerate(free):
        basis[k, column] = 1
        basis[k, pivots] = -reduced[: len(pivots), column] % PRIME
    return basis
