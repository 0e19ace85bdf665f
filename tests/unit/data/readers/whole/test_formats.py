"""Every format gives the same samples, whole or packed; what is damaged gives a right answer or one clear line."""

import gc
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dashpot.data.readers import read
from dashpot.data.readers.guarded import library
from dashpot.errors import DashpotError, DataError
from tests.unit.data.readers.written import CHANNELS, WRITERS, as_read, packed, recording, wav


def same(records, expected, one_clock=False):
    assert len(records) == len(expected)
    for record, wanted in zip(records, expected, strict=True):
        assert record.frequency_hz == wanted.frequency_hz
        assert record.time - record.time[0] == pytest.approx(wanted.time - wanted.time[0], abs=1e-12)
        assert record.values == pytest.approx(wanted.values, rel=1e-15)


@pytest.mark.parametrize("name", WRITERS)
def test_the_same_recording(tmp_path, name):
    suffix, write = WRITERS[name]
    path = tmp_path / f"test{suffix}"
    expected = recording()
    write(path, expected)
    same(as_read(path), expected)
    same(as_read(packed(path)), expected)


def test_wav_by_a_manifest(tmp_path):
    record = recording()[0]
    millimetres = np.round(record.values * 1e3 * 1024) / 1024
    (tmp_path / "2Hz.wav").write_bytes(wav(millimetres))
    (tmp_path / "test.toml").write_text(
        '[[files]]\nname = "{frequency}Hz.wav"\ncolumns = { x1 = "channel_1", x2 = "channel_2", u = "channel_3" }\n'
    )
    same(as_read(tmp_path / "test.toml"), [record])


def test_units_of_files_count(tmp_path):
    """A file in inches is read in inches where the rig says nothing, and refused where it says mm."""
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "test.h5"
    with h5py.File(path, "w") as file:
        file["x1"] = np.arange(1, 9.0)
        file["x1"].attrs["units"] = "in"
        file["time_s"] = np.arange(8) / 10
    from dashpot.channel import Channel

    (record,) = read(path, (Channel("x1", {"x1": 1}),)).records
    assert record.values[:, 0] == pytest.approx(0.0254 * np.arange(1, 9))
    with pytest.raises(DataError, match="column x1: in in, the rig"):
        read(path, CHANNELS[:1])


def test_an_extra_that_is_missing_is_named():
    with pytest.raises(DataError, match=r"nptdmz is needed.*\.\[formats\]"):
        library("nptdmz.x", "formats", "a.tdms", "TDMS")


def outcome(path: Path) -> str:
    """What becomes of a file: the records, or the one line that refuses it.  Everything else is a failure."""
    start, records, said = time.process_time(), [], ""
    try:
        records = as_read(path)
    except DashpotError as error:
        said = str(error)
    assert "\n" not in said
    assert path.name in said or not said
    assert all(np.all(np.isfinite(record.values)) for record in records)
    assert time.process_time() - start < 5
    return said


def whole(folder: Path, name: str) -> tuple[Path, bytes]:
    """A path for a file of the format, and what a sound one holds."""
    suffix, write = WRITERS[name]
    path = folder / f"whole{suffix}"
    write(path, recording(64))
    return path, path.read_bytes()


@pytest.fixture(scope="module")
def _frozen() -> Iterator[None]:
    """What is there already is not looked through after each file."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


DAMAGED = [
    pytest.param(name, marks=pytest.mark.long) if name == "MDF" else name for name in WRITERS
]  # asammdf is slow


@pytest.mark.usefixtures("_frozen")
@pytest.mark.parametrize("name", DAMAGED)
@pytest.mark.filterwarnings("ignore")
def test_files_cut_off(tmp_path, name):
    path, data = whole(tmp_path, name)
    expected = recording(64)
    rng = np.random.default_rng(0)
    for length in {0, 1, 8, 64, 512, len(data) // 2, len(data) - 1, *rng.integers(1, len(data), 2).tolist()}:
        path.write_bytes(data[:length])
        if outcome(path) == "" and name != "CSV":  # text ends where it ends
            same(as_read(path), expected)


@pytest.mark.slow
@pytest.mark.usefixtures("_frozen")
@pytest.mark.parametrize("name", DAMAGED)
@pytest.mark.filterwarnings("ignore")
def test_flipped_bytes(tmp_path, name):
    path, data = whole(tmp_path, name)
    rng = np.random.default_rng(1)
    for k in range(8):
        broken = bytearray(data)
        reach = min(len(data), 400 if k % 2 else len(data))
        for at in rng.integers(0, reach, 1 + k % 4):
            broken[at] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(broken))
        outcome(path)


@pytest.mark.parametrize(
    "suffix", [".mat", ".h5", ".npz", ".parquet", ".feather", ".xlsx", ".tdms", ".wav", ".mf4", ".uff"]
)
def test_files_of_a_wrong_name(tmp_path, suffix):
    path = tmp_path / f"noise{suffix}"
    for content in (b"\x00" * 100, b"frequency_hz", bytes(range(256)) * 4):
        path.write_bytes(content)
        assert outcome(path) != ""
