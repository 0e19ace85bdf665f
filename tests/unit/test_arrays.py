"""Arrays: diagonal matrices hold what is on their diagonals, however many there are."""

from typing import Any, cast

import numpy as np
import pytest

from dashpot.arrays import MANY, diagonal_matrices, frozen, is_diagonal, random_generator
from dashpot.errors import UsageError


@pytest.mark.parametrize(
    "shape", [(3,), (4, 3), (2, 4, 3), (MANY // 3 + 1, 3), (2, MANY // 3 + 1, 3), (4, 1)]
)
def test_diagonal_matrices_have_their_diagonals_and_nothing_else(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).normal(size=shape)
    matrices = diagonal_matrices(values)
    assert matrices.shape == (*shape, shape[-1])
    assert np.array_equal(np.diagonal(matrices, axis1=-2, axis2=-1), values)
    assert np.array_equal(matrices, np.where(np.eye(shape[-1], dtype=bool), values[..., None, :], 0.0))
    assert is_diagonal(matrices)
    assert not matrices.flags.writeable
    assert frozen(matrices, np.complex128) is matrices
    assert np.array_equal(matrices @ np.ones(shape[-1]), values)


@pytest.mark.parametrize("lines", [4, MANY])
def test_one_number_beside_the_diagonal_is_seen(lines: int) -> None:
    matrices = np.array(diagonal_matrices(np.ones((lines, 3))))
    matrices[-1, 2, 0] = 1e-300
    assert not is_diagonal(matrices)


def test_very_many_matrices_take_the_memory_of_their_diagonals() -> None:
    def held() -> int:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * 4096

    try:
        before = held()
    except OSError:
        pytest.skip("the system does not say what a process holds")
    values = np.ones((1 << 20, 8))
    matrices = diagonal_matrices(values)
    assert is_diagonal(matrices)
    assert held() - before < 0.5 * matrices.nbytes


@pytest.mark.parametrize("seed", [-1, None, b"1", "1", 1.5, float("nan")])
def test_what_is_no_seed_is_refused(seed: object) -> None:
    with pytest.raises(UsageError, match="seed"):
        random_generator(cast(Any, seed))


@pytest.mark.parametrize("seed", [0, np.int64(7), 1 << 80])
def test_a_seed_draws_the_same_again(seed: int) -> None:
    assert random_generator(seed).random() == random_generator(seed).random()
