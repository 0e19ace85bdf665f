"""Array types, and what makes arrays read-only."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import Any, TypeVar, cast

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


def hermitian(matrix: NDArray[Scalar]) -> NDArray[Scalar]:
    """Conjugate transpose of the last two axes."""
    transposed: NDArray[Scalar] = np.conj(np.swapaxes(matrix, -1, -2))
    return transposed
