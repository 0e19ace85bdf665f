"""Array types and the one helper that makes them read-only."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

Scalar = TypeVar("Scalar", bound=np.generic)


def frozen(values: ArrayLike, dtype: type[Scalar]) -> NDArray[Scalar]:
    """A read-only copy of `values`; an array that is read-only already and owns its data is shared."""
    if (
        isinstance(values, np.ndarray)
        and values.dtype == dtype
        and not values.flags.writeable
        and values.base is None
    ):
        return values
    copy: NDArray[Any] = np.array(values, dtype=dtype)
    copy.setflags(write=False)
    return copy


def hermitian(matrix: NDArray[Scalar]) -> NDArray[Scalar]:
    """Conjugate transpose of the last two axes."""
    transposed: NDArray[Scalar] = np.conj(np.swapaxes(matrix, -1, -2))
    return transposed
