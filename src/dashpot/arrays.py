"""Array types, what makes arrays read-only, and the generators of random ones."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from operator import index
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dashpot.errors import UsageError

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

Scalar = TypeVar("Scalar", bound=np.generic)

MANY = 1 << 17  # numbers of all lines from which diagonal matrices are laid out by planes


def random_generator(seed: int) -> np.random.Generator:
    """What draws the numbers that a seed stands for.  Raises UsageError if it is no whole number from 0 on."""
    try:
        if index(seed) >= 0:
            return np.random.default_rng(index(seed))
    except TypeError:
        pass
    raise UsageError(f"the seed is {seed!r}", cure="give a whole number from 0 on")


def without_denormals(values: ArrayLike, axis: int) -> np.ndarray:
    """The values, with 0 along `axis` where all of them are below SMALLEST: nothing was measured there."""
    array = np.asarray(values)
    if not array.size or array.ndim < -axis:
        return array
    ends = np.max(array, axis=axis, keepdims=True), np.min(array, axis=axis, keepdims=True)
    largest = np.maximum(*map(np.abs, ends))
    nothing = (largest > 0) & (largest < 1e-100)  # below this squares underflow, and no measurement is meant
    return np.where(nothing, 0.0, array) if np.any(nothing) else array


def zeros_for_nan(values: NDArray[Scalar]) -> NDArray[Scalar]:
    """NumPy's nan_to_num, without its parts and copies where all are numbers already, as they mostly are."""
    return values if np.all(np.isfinite(values)) else np.nan_to_num(values)


def frozen(values: ArrayLike, dtype: type[Scalar]) -> NDArray[Scalar]:
    """A read-only copy of `values`; an array that nobody can write to is shared."""
    if isinstance(values, np.ndarray) and values.dtype == dtype:
        if _settled(values):
            return values
        copy: NDArray[Any] = values.copy("K")
    else:
        copy = np.array(values, dtype=dtype)
    copy.setflags(write=False)
    return copy


def _settled(values: np.ndarray) -> bool:
    """Whether an array is read-only for good: it owns its data, or is all of one that does, also many times over."""
    if values.flags.writeable:
        return False
    owner: object = values.base
    if owner is None:
        return True
    if not isinstance(owner, np.ndarray) or values.nbytes < owner.nbytes:
        return False
    return owner.base is None and not owner.flags.writeable


def is_diagonal(matrices: NDArray[Any]) -> bool:
    """Whether (..., n, n) matrices have nothing off their diagonals."""
    n = matrices.shape[-1]
    if n == 1:
        return True
    if matrices.ndim > 2 and matrices.strides[-3] == matrices.itemsize:  # as `diagonal_matrices` makes them
        return not any(np.any(matrices[..., i, j]) for i in range(n) for j in range(n) if i != j)
    # Row after row without the last number, what lies n + 1 apart is the diagonal.
    rest = matrices.reshape(*matrices.shape[:-2], n * n)[..., :-1].reshape(*matrices.shape[:-2], n - 1, n + 1)
    return not np.any(rest[..., 1:])


def diagonal_matrices(values: Real) -> Complex:
    """Read-only matrices (..., n, n) with values (..., n) on their diagonals.

    Of very many lines (..., lines, n), each number of the matrices is a plane of memory by itself: those off the
    diagonals, which nobody writes, are no more than promised by the system, so that n numbers are held and not n².
    """
    n = values.shape[-1]
    if values.ndim < 2 or values.shape[-2] * n < MANY:
        matrices = np.zeros((*values.shape, n), dtype=np.complex128)
    else:
        matrices = np.moveaxis(np.zeros((n, n, *values.shape[:-1]), dtype=np.complex128), (0, 1), (-2, -1))
    matrices[..., np.arange(n), np.arange(n)] = values
    (matrices if matrices.base is None else matrices.base).setflags(write=False)
    matrices.setflags(write=False)
    return matrices


_DTYPES: dict[str, type[np.generic]] = {
    "Real": np.float64,
    "Complex": np.complex128,
    "Ints": np.int64,
    "Bools": np.bool_,
}


@cache
def _array_fields(kind: Any) -> tuple[tuple[str, type[np.generic]], ...]:
    """Names and dtypes of the fields that are declared as Real, Complex, Ints or Bools, or as one of them or None."""
    declared = ((field.name, str(field.type).removesuffix(" | None")) for field in fields(kind))
    return tuple((name, _DTYPES[words]) for name, words in declared if words in _DTYPES)


def freeze(value: object) -> None:
    """Make the arrays among the fields of a frozen dataclass read-only, as declared: for its `__post_init__`."""
    for name, dtype in _array_fields(cast(Any, type(value))):
        array = getattr(value, name)
        if array is not None:
            object.__setattr__(value, name, frozen(array, dtype))


class Frozen:
    """A frozen dataclass whose arrays are read-only."""

    def __post_init__(self) -> None:
        freeze(self)


def hermitian(matrix: NDArray[Scalar]) -> NDArray[Scalar]:
    """Conjugate transpose of the last two axes."""
    return np.conj(np.swapaxes(matrix, -1, -2))
