"""One thread of BLAS while dashpot computes: matrices are small and many, and threads that wait for them spin.

NumPy and SciPy each bring an OpenBLAS, which their extensions link to.  Another BLAS is left alone, and so is all where
the environment says how many threads there are to be.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
EXTENSIONS = ("numpy.linalg._umath_linalg", "scipy.linalg._fblas")
NAMES = tuple(
    f"{prefix}openblas_{{}}_num_threads{suffix}" for prefix in ("scipy_", "") for suffix in ("64_", "")
)
Getter = Callable[[], int]
Setter = Callable[[int], None]

_lock = Lock()
_before: list[tuple[Setter, int]] = []  # how many threads there were before the first of those inside
_inside = 0


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS on one thread as long as anyone is inside, then on as many as before."""
    global _inside
    if any(os.environ.get(name) for name in THREADS):
        yield
        return
    with _lock:
        _inside += 1
        if _inside == 1:
            _before[:] = [(put, get()) for get, put in pools()]
            for put, _ in _before:
                put(1)
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                for put, count in _before:
                    put(count)


def pools() -> list[tuple[Getter, Setter]]:
    """How many threads each OpenBLAS that has been loaded computes on: what reads it, and what sets it."""
    found = (_pool(module) for module in EXTENSIONS if module in sys.modules)
    return [pool for pool in found if pool is not None]


@cache
def _pool(module: str) -> tuple[Getter, Setter] | None:
    """A symbol that is looked for in an extension is looked for in what it links to, but not on Windows."""
    extension = ctypes.CDLL(sys.modules[module].__file__)
    for name in NAMES:
        if hasattr(extension, name.format("get")):
            return getattr(extension, name.format("get")), getattr(extension, name.format("set"))
    return None
