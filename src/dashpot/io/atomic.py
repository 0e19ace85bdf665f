"""The one way to write a file: it is there whole, or what was there before is still there.

A temporary file in the same folder takes the file's place once it is complete and on the disk.  Links are followed,
devices and pipes are written directly, and a file that was there keeps its mode and owner.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import signal
import stat
import sys
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import current_thread, main_thread

from dashpot.errors import DataError, UsageError
from dashpot.io import ledger
from dashpot.io.ledger import AnyPath

# A signal handler runs between any two steps of the program, so that a file which has just been made might not be
# known yet to those who clear it away.


_postponed: list[int] | None = None  # signals that came within a section that is not to be cut; None outside


@contextmanager
def uncut() -> Iterator[None]:
    """What is done here is done whole, as a file is made and noted: a signal is answered at the end."""
    global _postponed
    if current_thread() is not main_thread():  # signals are answered in the main thread alone
        yield
        return
    outer, _postponed = _postponed, [] if _postponed is None else _postponed
    try:
        yield
    finally:
        came, _postponed = _postponed, outer
        for number in came if outer is None else ():
            signal.raise_signal(number)


def postponed(number: int) -> bool:
    """For signal handlers: whether this signal has to wait, and comes again by itself."""
    if _postponed is None:
        return False
    _postponed.append(number)
    return True


_temporary: dict[
    str, int
] = {}  # files and folders that are there for a while, and the process that made each


def clear_away() -> None:
    """Delete what this process has made for a while: for a signal handler that ends it at once."""
    for path in tuple(_temporary):
        _let_go(path)


def _let_go(path: str) -> None:
    """Delete a temporary file or folder; in processes that were forked from the one that made it, forget it."""
    if _temporary.get(path) == os.getpid():
        if os.path.isdir(path):
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                os.unlink(path)
    _temporary.pop(path, None)


# Files that other programs need for a moment: in a folder of their own, gone when the work is done.


@dataclass(frozen=True)
class Scratch:
    """A folder that lasts as long as the work in it."""

    folder: Path

    def write(self, name: str, content: bytes | Iterable[bytes]) -> Path:
        """Where the content, whole or in pieces, now stands.  Raises DataError if there is no room for it."""
        path = self.folder / name
        with path.open("wb", buffering=0) as file:
            for piece in (content,) if isinstance(content, bytes) else content:
                left = memoryview(piece)
                try:
                    while left:
                        left = left[file.write(left) :]
                except OSError as error:
                    what = f"no space for a temporary file ({error.strerror})"
                    cure = "free space there, or set TMPDIR to a folder on a larger disk"
                    raise DataError(what, str(self.folder), cure) from None
        return path

    def read(self, name: str) -> bytes:
        """What another program has written there.  Raises OSError if it has not."""
        return (self.folder / name).read_bytes()


@contextmanager
def scratch() -> Iterator[Scratch]:
    """A folder for files in between, removed at the end whatever happens."""
    lasting = lasting_scratch()
    try:
        yield lasting
    finally:
        _let_go(str(lasting.folder))


def lasting_scratch() -> Scratch:
    """A folder for files that are read until their reader is let go: removed with it, or when the process ends."""
    with uncut():
        folder = tempfile.mkdtemp(prefix="dashpot-")
        lasting = Scratch(Path(folder))
        _temporary[folder] = os.getpid()
        weakref.finalize(lasting, _let_go, folder)
    return lasting


# A folder held by one process at a time. The system frees the lock when its holder dies, however that
# happens.


LOCK = ".lock"  # the file that is locked; it names the process that holds it


@contextmanager
def locked(folder: AnyPath) -> Iterator[None]:
    """Hold an existing folder until the end.

    Raises UsageError if another process holds it, or nothing can be written there.
    """
    path = os.path.join(folder, LOCK)
    try:
        with uncut():
            descriptor = _held(path)
            if descriptor is not None:
                _temporary[path] = os.getpid()
    except OSError as error:
        raise UsageError(
            f"the folder cannot be used ({error.strerror or error})", os.fspath(folder), "name another one"
        ) from None
    if descriptor is None:
        holder = ""  # where the file does not say
        with suppress(OSError, ValueError), open(path, "rb") as file:
            holder = f"(process {int(file.read(32))}) "
        raise UsageError(
            f"another dashpot {holder}is working in this folder",
            os.fspath(folder),
            "wait until it has finished, or name another folder",
        )
    try:
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode())
        yield
    finally:
        with uncut():
            _let_go(path)
            os.close(descriptor)


def _held(path: str) -> int | None:
    """A descriptor of the locked file; None if another process has it."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if not _lock(descriptor):
                os.close(descriptor)
                return None
            # Its last holder may have deleted the file between the two calls: the lock is then on nothing.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), os.stat(path)):
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


PART = ".dashpot-", ".part"  # what the names of temporary files begin and end with
_BINARY = getattr(os, "O_BINARY", 0)
_NO_TERMINAL = getattr(os, "O_NOCTTY", 0)
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)


def require_json_or_nothing(path: str) -> None:
    """Raises UsageError if a file is there that holds something else, such as a record named where none was meant."""
    if os.path.isfile(path) and os.access(path, os.R_OK):
        with open(path, "rb") as file:
            if file.read(64).lstrip()[:1] not in (b"", b"{"):
                raise UsageError("this file is there and is not JSON", path, "name another file")


def write_text(path: ledger.AnyPath, text: str) -> None:
    """Write a text file, UTF-8.  Raises as `write_bytes`.

    Half characters, as names of files that are no UTF-8 leave them, are written as JSON would (\\udcff).
    """
    write_bytes(path, text.encode("utf-8", errors="backslashreplace"))


def write_bytes(path: ledger.AnyPath, content: bytes | Iterable[bytes | memoryview]) -> None:
    """Write a file from its bytes, all at once or in parts.

    Raises DataError if it cannot be written, UsageError if this run reads it or has written it already.
    """
    name = os.fspath(path)
    entries = ledger.current()
    if entries is not None:
        entries.note_written(name)
    parts = (content,) if isinstance(content, bytes) else content
    try:
        target = _destination(name)
        if isinstance(target, int):
            _fill(os.dup(target), parts)
        elif _is_stream(target):
            _fill(os.open(target, os.O_WRONLY | _BINARY | _NO_TERMINAL), parts)
        else:
            # Write a temporary file next to the target, and let it take the target's place
            before = os.stat(target) if os.path.exists(target) else None
            temporary = os.path.join(os.path.dirname(target), secrets.token_hex(8).join(PART))
            _temporary[temporary] = os.getpid()
            try:
                flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY | _NO_LINK
                size = _fill(
                    os.open(temporary, flags, 0o666), parts, sync=True
                )  # the system takes its umask off
                if os.stat(temporary).st_size != size:
                    raise OSError(errno.EIO, "the disk did not keep what was written")
                if before is not None:
                    if hasattr(os, "chown"):
                        with suppress(PermissionError):
                            os.chown(temporary, before.st_uid, before.st_gid)
                    os.chmod(temporary, stat.S_IMODE(before.st_mode))
                os.replace(temporary, target)
            finally:
                _let_go(temporary)
    except (OSError, ValueError) as error:  # a ValueError is a path with a null character
        reason = getattr(error, "strerror", None) or str(error)
        raise DataError(f"cannot be written ({reason})", name, "check the path and the space left") from None


def remove_parts(folder: ledger.AnyPath) -> None:
    """Delete the temporary files that processes which were killed have left in a folder."""
    with suppress(OSError):
        for name in os.listdir(folder):
            if name.startswith(PART[0]) and name.endswith(PART[1]):
                with suppress(OSError):
                    os.unlink(os.path.join(folder, name))


def _destination(name: str) -> str | int:
    """Where a path leads through all links: a path, or a descriptor of this process (/dev/stdout, /dev/fd/3)."""
    path = os.path.abspath(name)
    for _ in range(40):  # links, as Linux follows
        folder, last = os.path.realpath(os.path.dirname(path)), os.path.basename(path)
        if re.fullmatch(rf"/proc/(?:self|{os.getpid()})/fd", folder) and last.isdigit():
            return int(last)
        path = os.path.join(folder, last)
        if not os.path.islink(path):
            return path
        path = os.path.join(folder, os.readlink(path))
    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))


def _is_stream(path: str) -> bool:
    """Whether a character device or a pipe lies there.  Raises OSError for what cannot be replaced by a file."""
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return False
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if stat.S_ISBLK(mode):
        raise OSError(errno.EPERM, "this is a disk")
    if stat.S_ISREG(mode) and not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return not stat.S_ISREG(mode)


def _fill(descriptor: int, parts: Iterable[bytes | memoryview], sync: bool = False) -> int:
    """Write all parts, on the disk where `sync`, and close; how many bytes they were."""
    total = 0
    try:
        for part in parts:
            rest = memoryview(part).cast("B")
            while rest:
                count = os.write(descriptor, rest)
                if count == 0:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                rest, total = rest[count:], total + count
        if sync:
            os.fsync(descriptor)
    except BaseException:
        with suppress(OSError):
            os.close(descriptor)
        raise
    os.close(descriptor)  # a full network disk may say so only now
    return total
