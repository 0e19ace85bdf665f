"""Files are written whole or not at all, through links, into devices and pipes, and leave nothing behind."""

import errno
import os
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from dashpot.errors import DataError, UsageError
from dashpot.io import atomic, ledger
from dashpot.io.atomic import write_bytes, write_text


def test_a_new_file_has_the_mode_that_the_umask_leaves(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "new", "x\n")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o640
    assert os.listdir(tmp_path) == ["new"]


def test_an_existing_file_keeps_its_mode(tmp_path: Path) -> None:
    target = tmp_path / "old"
    target.write_text("before")
    target.chmod(0o600)
    write_text(target, "after")
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    assert target.read_text() == "after"


@pytest.mark.parametrize("exists", [True, False])
def test_writes_through_links(tmp_path: Path, exists: bool) -> None:
    (tmp_path / "far").mkdir()
    real = tmp_path / "far" / "real"
    if exists:
        real.write_text("before")
    (tmp_path / "middle").symlink_to("far/real")
    (tmp_path / "link").symlink_to(tmp_path / "middle")
    write_text(tmp_path / "link", "after")
    assert real.read_text() == "after"
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "middle").is_symlink()
    assert sorted(os.listdir(tmp_path)) == ["far", "link", "middle"]
    assert os.listdir(tmp_path / "far") == ["real"]


def test_a_ring_of_links_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(DataError, match="cannot be written"):
        write_text(tmp_path / "a", "x")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_devices_stay_devices(tmp_path: Path) -> None:
    write_text("/dev/null", "x")
    with pytest.raises(DataError, match="No space left"):
        write_text("/dev/full", "x")
    (tmp_path / "link").symlink_to("/dev/full")
    with pytest.raises(DataError, match="No space left"):
        write_text(tmp_path / "link", "x")
    for name in ("/dev/null", "/dev/full"):
        assert stat.S_ISCHR(os.stat(name).st_mode)


def test_a_pipe_gets_the_bytes(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    seen: list[bytes] = []
    reader = threading.Thread(target=lambda: seen.append(pipe.read_bytes()))
    reader.start()
    write_bytes(pipe, (b"one ", memoryview(b"two")))
    reader.join(10)
    assert seen == [b"one two"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_a_descriptor_gets_the_bytes_where_it_stands(tmp_path: Path) -> None:
    with open(tmp_path / "log", "w+") as file:
        file.write("before ")
        file.flush()
        write_text(f"/dev/fd/{file.fileno()}", "after")
        assert (tmp_path / "log").read_text() == "before after"
        file.write(" end")
    assert (tmp_path / "log").read_text() == "before after end"


@pytest.mark.parametrize(
    ("name", "told"),
    [("folder", "Is a directory"), ("none/x", "No such file"), ("n" * 300, "too long"), ("a\0b", "null")],
)
def test_what_cannot_be_written_is_told(tmp_path: Path, name: str, told: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(DataError, match=told):
        write_text(os.path.join(tmp_path, name), "x")
    assert os.listdir(tmp_path) == ["folder"]


def test_halves_of_characters_are_escaped(tmp_path: Path) -> None:
    write_text(tmp_path / "out", "\udcff")
    assert (tmp_path / "out").read_bytes() == b"\\udcff"


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_an_interruption_leaves_the_old_file_alone(tmp_path: Path, error: type[BaseException]) -> None:
    (tmp_path / "out").write_text("before")

    def parts() -> Iterator[bytes]:
        yield b"half"
        raise error

    with pytest.raises(error):
        write_bytes(tmp_path / "out", parts())
    assert (tmp_path / "out").read_text() == "before"
    assert os.listdir(tmp_path) == ["out"]


class FaultySystem:
    """The module os, of which the k-th call of those that matter here fails, writes short, or lies."""

    CALLS = ("open", "write", "fsync", "close", "chmod", "replace", "stat")

    def __init__(self, k: int, kind: str) -> None:
        self.k, self.kind, self.count = k, kind, 0

    def __getattr__(self, name: str) -> object:
        real = getattr(os, name)
        if name not in self.CALLS:
            return real

        def call(*args: object, **keywords: object) -> object:
            self.count += 1
            if self.count != self.k:
                return real(*args, **keywords)
            if name == "write" and self.kind == "short":
                return os.write(args[0], bytes(args[1])[:1])  # type: ignore[arg-type, call-overload]
            if name == "write" and self.kind == "lies":
                return len(args[1])  # type: ignore[arg-type]
            if name == "close":
                real(*args)
            raise OSError(errno.ENOSPC if self.kind == "full" else errno.EIO, "fault")

        return call


@pytest.mark.parametrize("kind", ["fails", "full", "short", "lies"])
@pytest.mark.parametrize("there", [True, False])
def test_old_or_complete_whatever_call_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, there: bool
) -> None:
    target = tmp_path / "out"
    outcomes = set()
    for k in range(1, 40):
        target.unlink(missing_ok=True)
        if there:
            target.write_text("old")
        system = FaultySystem(k, kind)
        with monkeypatch.context() as patched:
            patched.setattr(atomic, "os", system)
            try:
                write_bytes(target, (b"first ", b"second"))
                failed = False
            except DataError:
                failed = True
        outcomes.add(failed)
        content = target.read_text() if target.exists() else None
        if failed:
            assert content in (("old", "first second") if there else (None, "first second")), k
        else:
            assert content == "first second", k
        assert [name for name in os.listdir(tmp_path) if name != "out"] == [], k
        if system.count < k:
            break
    else:
        pytest.fail("40 calls for one file")
    assert True in outcomes


def test_an_input_is_never_replaced(tmp_path: Path) -> None:
    data = tmp_path / "data.csv"
    data.write_text("measured")
    (tmp_path / "soft").symlink_to(data)
    os.link(data, tmp_path / "hard")
    with ledger.opened():
        ledger.noted(data)
        for name in ("data.csv", "soft", "hard", "../" + tmp_path.name + "/data.csv"):
            with pytest.raises(UsageError, match="would overwrite an input file"):
                write_text(tmp_path / name, "x")
        write_text(tmp_path / "other", "x")
        with pytest.raises(UsageError, match="two outputs"):
            write_text(tmp_path / "other", "y")
        with pytest.raises(UsageError, match="would overwrite an input file"):
            ledger.noted(tmp_path / "other")
    assert data.read_text() == "measured"
    write_text(data, "a program's own business")
    assert data.read_text() == "a program's own business"


def test_devices_are_read_and_written_at_once() -> None:
    with ledger.opened():
        ledger.noted("/dev/null")
        write_text("/dev/null", "x")
        write_text("/dev/null", "y")


def test_a_device_that_never_ends_is_not_read() -> None:
    with pytest.raises(DataError, match="/dev/zero: is a device"):
        ledger.noted("/dev/zero")


def test_a_folder_that_is_gone_is_no_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert ledger.keys_of("data.csv") == ()
    monkeypatch.chdir(tmp_path)
