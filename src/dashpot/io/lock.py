"""A folder held by one process at a time.  The system frees the lock when its holder dies, however that happens."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from dashpot.errors import UsageError
from dashpot.io.ledger import AnyPath

LOCK = ".lock"  # the file that is locked; it names the process that holds it
_held_here: set[str] = set()  # locks of this process, for a handler that ends it at once


@contextmanager
def locked(folder: AnyPath) -> Iterator[None]:
    """Hold an existing folder until the end.

    Raises UsageError where another process holds it, or nothing can be written there.
    """
    path = os.path.join(folder, LOCK)
    try:
        descriptor = _held(path)
    except OSError as error:
        raise UsageError(
            f"the folder cannot be used ({error.strerror or error})", os.fspath(folder), "name another one"
        ) from None
    if descriptor is None:
        raise UsageError(
            f"another dashpot {_holder(path)}is working in this folder",
            os.fspath(folder),
            "wait until it has finished, or name another folder",
        )
    _held_here.add(path)
    try:
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode())
        yield
    finally:
        with suppress(OSError):
            os.unlink(path)
        _held_here.discard(path)
        os.close(descriptor)


def clear_locks() -> None:
    """Delete the lock files of this process: for a signal handler that ends it at once."""
    for path in tuple(_held_here):
        with suppress(OSError):
            os.unlink(path)


def _held(path: str) -> int | None:
    """A descriptor of the locked file; None where another process has it."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if not _lock(descriptor):
                os.close(descriptor)
                return None
            # Its last holder may have deleted the file between the two calls: the lock is then on nothing.
            if _same(descriptor, path):
                return descriptor
            os.close(descriptor)
        except BaseException:
            with suppress(OSError):
                os.close(descriptor)
            raise


def _lock(descriptor: int) -> bool:
    """Lock at once, or say that another process holds the lock."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    return True


def _same(descriptor: int, path: str) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


def _holder(path: str) -> str:
    """(process 1234), or nothing where the file does not say."""
    with suppress(OSError, ValueError), open(path, "rb") as file:
        return f"(process {int(file.read(32))}) "
    return ""
