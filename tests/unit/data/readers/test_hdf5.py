"""HDF5: no other file is read through one, and no way through it is without end."""

import time

import numpy as np
import pytest

from dashpot.data.readers import datafile, hdf5
from dashpot.data.readers.registry import reader_of
from dashpot.errors import DataError
from tests.unit.data.readers.attacks import READS_ANOTHER, write_hdf5

h5py = pytest.importorskip("h5py")


def opened(path):
    file = datafile.open_file(path)
    return reader_of(file).parts(file)


def parts(path):
    return [(part.source, part.header, part.rows) for part in opened(path)]


@pytest.mark.parametrize("name", ["data.h5", "data.mat"])
@pytest.mark.parametrize("attack", READS_ANOTHER)
def test_what_is_kept_in_another_file_is_refused(tmp_path, name, attack):
    path = tmp_path / name
    write_hdf5(path, attack)
    with pytest.raises(DataError) as refused:
        parts(path)
    assert "u is " in str(refused.value)
    assert name in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("depth", [1000, 1200])
def test_deep_groups_take_no_minute(tmp_path, depth):
    path = tmp_path / "deep.h5"
    with h5py.File(path, "w") as file:
        group = file
        for _ in range(depth):
            group = group.create_group("g")
        group["x"] = np.arange(5.0)
    start = time.process_time()
    if depth <= hdf5.DEEPEST:
        assert [rows for _, _, rows in parts(path)] == [5]
    else:
        with pytest.raises(DataError, match="nested"):
            parts(path)
    assert time.process_time() - start < 5


def test_links_in_circles_and_to_nothing(tmp_path):
    path = tmp_path / "links.h5"
    with h5py.File(path, "w") as file:
        file["x"] = np.arange(5.0)
        inner = file.create_group("a/b")
        inner["y"] = np.arange(5.0)
        inner["up"], inner["root"] = file["a"], file["/"]  # hard
        file["loop1"], file["loop2"] = h5py.SoftLink("/loop2"), h5py.SoftLink("loop1")
        file["nothing"], file["through"] = h5py.SoftLink("/none"), h5py.SoftLink("/x/y")
        file["alias"] = h5py.SoftLink("a/b/root/./x")
        file["empty"] = h5py.Empty("f8")
        file["empty"].attrs["unit"] = file.attrs["fs"] = h5py.Empty("f8")
    assert parts(path) == [(str(path), ("alias", "x"), 5), (f"{path} (a/b)", ("y",), 5)]


def test_the_links_of_a_file_are_counted(tmp_path, monkeypatch):
    path = tmp_path / "many.h5"
    with h5py.File(path, "w") as file:
        for k in range(20):
            file[f"x{k}"] = np.arange(5.0)
    monkeypatch.setattr(hdf5, "MOST_OBJECTS", 19)
    with pytest.raises(DataError, match="19 objects"):
        parts(path)


def test_attributes_of_groups_around_a_group_are_its_own_unless_it_has_them(tmp_path):
    path = tmp_path / "attributes.h5"
    with h5py.File(path, "w") as file:
        file.attrs["fs"], file.attrs["frequency_hz"] = 100.0, 2.0
        for k in range(2):
            file[f"run{k}/x"] = np.arange(5.0)
        file["run1"].attrs["frequency_hz"] = 3.0
    read = [part.numbers(range(3)) for part in opened(path)]
    assert [columns[1][0] for columns in read] == [2.0, 3.0]
    assert [columns[2][1] for columns in read] == [0.01, 0.01]
