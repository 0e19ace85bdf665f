"""Which arithmetic does the work: the compiled kernel of the package dashpot-kernels, or its twins in NumPy.

The environment variable DASHPOT_KERNEL says: "auto" (the default: compiled where it is installed), "compiled" (or an
error), "numpy"; it is read once.  `using` says it for a piece of a program.  Both give the same results to rounding.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from types import ModuleType
from typing import Any

from dashpot.errors import UsageError

VARIABLE = "DASHPOT_KERNEL"
THREADS = "DASHPOT_KERNEL_THREADS"
CHOICES = ("auto", "compiled", "numpy")
# Processors that one process can be bound to (CPU_SETSIZE of glibc); more threads only wait
MOST_THREADS = 1024

_choice: ContextVar[str | None] = ContextVar("kernel", default=None)


def kernel() -> Any | None:
    """The compiled module, None where NumPy is to do the work.

    Raises UsageError if the compiled kernel is asked for and not installed, or the choice is none.
    """
    choice = _choice.get() or environment()[0]
    if choice == "numpy":
        return None
    if choice not in CHOICES:
        raise UsageError(f"{VARIABLE} is {choice!r}", cure=f"it may be {', '.join(CHOICES)}")
    module = _compiled()
    if module is None and choice == "compiled":
        raise UsageError(
            "the compiled kernel is not installed",
            cure="pip install ./kernels from the copy of dashpot (needs a C++ compiler), or let the choice be auto",
        )
    return module


def kernel_function(name: str) -> Any | None:
    """A function of the compiled module; None if NumPy is to do the work, or where that module is older than it."""
    return getattr(kernel(), name, None)


@contextmanager
def using(choice: str) -> Iterator[None]:
    """Let `kernel` answer as `choice` says for as long as this context lasts.

    Raises UsageError if there is no such choice.
    """
    if choice not in CHOICES:
        raise UsageError(f"no kernel {choice!r}", cure=f"choose from {', '.join(CHOICES)}")
    token = _choice.set(choice)
    try:
        yield
    finally:
        _choice.reset(token)


def threads() -> int:
    """Threads of one call of the kernel: DASHPOT_KERNEL_THREADS, else one, since commands work in processes."""
    return environment()[1]


@cache
def environment() -> tuple[str, int]:
    """The choice and the threads that the environment asks for, read once: a single fit asks for them many times.

    Raises UsageError if the threads are no whole number or too many.
    """
    given = os.environ.get(THREADS) or "1"
    count = (
        int(given) if given.isascii() and given.isdecimal() and len(given) <= len(str(MOST_THREADS)) else -1
    )
    if not 0 <= count <= MOST_THREADS:
        cure = f"give a whole number up to {MOST_THREADS}, or leave it unset for one thread"
        raise UsageError(f"{THREADS} is {given[:40]!r}", cure=cure)
    return os.environ.get(VARIABLE) or "auto", max(1, count)


def description() -> str:
    """What does the work, for records of a run: "numpy" or the kernel's version and instruction set."""
    module = kernel()
    return "numpy" if module is None else f"compiled {module.__version__} {module.instruction_set()}"


@cache
def _compiled() -> ModuleType | None:
    try:
        import dashpot_kernels
    except ImportError:
        return None
    return dashpot_kernels
