"""Memory that the system limits (`ulimit -v`, `ulimit -d`): room for the libraries, and errors of too little."""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import re
from contextlib import suppress

from dashpot.errors import DashpotError
from dashpot.numerics.blas_threads import THREADS

# Bytes of address space for the libraries of one command on Linux x86-64: measured, 415 MB once they are imported with
# one thread; identify unguarded failed under a limit of 500 MB and worked under 520 MB
ROOM = 512 << 20
EXIT_CODE = 5
CURE = "raise the limit (ulimit -v), or give fewer frequencies, draws or samples at a time"
_LACK = re.compile(
    r"cannot allocate|unable to allocate|failed to map|bad_alloc|out of memory"
    r"|resource temporarily unavailable|can't start new thread",
    re.IGNORECASE,
)


class NotEnoughMemoryError(DashpotError):
    """The system gives this process less memory than the work takes."""

    exit_code = EXIT_CODE


def memory_is_limited() -> bool:
    """Whether the caller limits the address space or the data of this process; false where no such limit exists."""
    try:
        import resource
    except ImportError:  # Windows
        return False
    limits = (getattr(resource, name, None) for name in ("RLIMIT_AS", "RLIMIT_DATA"))
    return any(
        limit is not None and resource.getrlimit(limit)[0] != resource.RLIM_INFINITY for limit in limits
    )


def one_thread() -> None:
    """Let BLAS compute on one thread, unless the user says otherwise; to be called before NumPy is imported.

    Matrices here are small and many: on cores that have other work, waking threads takes most of the time.
    Where memory is limited nothing states otherwise, for each thread takes buffers of its own; Arrow, which ends the
    process where its own pool finds no room, takes the system's.
    """
    if memory_is_limited():
        os.environ.update(
            dict.fromkeys((*THREADS, "ARROW_IO_THREADS"), "1"), ARROW_DEFAULT_MEMORY_POOL="system"
        )
    for name in THREADS:
        os.environ.setdefault(name, "1")


def secure_room() -> None:
    """Where memory is limited: let BLAS take its buffers before anything else can take their place.

    OpenBLAS asks for ever for a buffer that it does not get, within C, where no signal is answered.  Raises
    NotEnoughMemoryError if the limit leaves too little for the libraries.
    """
    if not memory_is_limited():
        return
    try:
        mmap.mmap(-1, ROOM, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS).close()
    except OSError:
        what = f"not enough memory: the libraries need {ROOM >> 20} MB of address space, and the limit leaves less"
        raise NotEnoughMemoryError(what, cure="raise the limit (ulimit -v)") from None
    # Threads share the memory of the C library (glibc): each would reserve 64 to 128 MB of address space.
    with suppress(OSError, TypeError, AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(-8, 1)  # M_ARENA_MAX of its malloc.h
    import numpy as np
    from scipy.linalg import blas  # SciPy brings a BLAS of its own

    ones = np.ones((128, 128))  # which BLAS multiplies in its buffer; matrices of 64 rows do without
    ones @ ones
    blas.dgemm(1.0, ones, ones)


def lacked(error: BaseException) -> bool:
    """Whether an error, or one that it was raised from, is a lack of memory, however a library words it."""
    behind: BaseException | None = error
    while behind is not None:
        if (
            isinstance(behind, MemoryError | NotEnoughMemoryError)
            or getattr(behind, "errno", None) == errno.ENOMEM
        ):
            return True
        if not isinstance(behind, DashpotError) and memory_is_limited() and _LACK.search(str(behind)):
            return True
        before = behind
        behind = behind.__cause__ or behind.__context__
        if behind is before:  # raised from itself
            break
    return False
