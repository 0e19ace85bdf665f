"""Scratch files go with what needs them."""

import gc
import os
from pathlib import Path

import pytest

from dashpot.errors import DataError
from dashpot.io.atomic import Scratch, clear_away, lasting_scratch


def test_it_lasts_as_long_as_it_is_held() -> None:
    lasting = lasting_scratch()
    folder = lasting.folder
    assert lasting.write("a", iter([b"one, ", b"two"])).read_bytes() == b"one, two"
    assert lasting.read("a") == b"one, two"
    del lasting
    gc.collect()
    assert not folder.exists()


def test_a_process_that_is_forked_leaves_it_alone() -> None:
    lasting = lasting_scratch()
    child = os.fork()
    if child == 0:
        clear_away()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert lasting.folder.exists()
    clear_away()
    assert not lasting.folder.exists()


def test_a_full_disk_is_told(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("/dev/full")
    with pytest.raises(DataError, match=r"no space for a temporary file"):
        Scratch(tmp_path).write("a", b"x")
