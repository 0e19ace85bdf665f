"""FAMOS files made by hand as imc devices write them; imctermite reads the samples of its repository alike."""

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.readers import famos, read
from dashpot.data.readers.datafile import open_file
from dashpot.errors import DashpotError, DataError
from tests.unit.data.readers.famos_bytes import HEAD, channel, dwell
from tests.unit.data.readers.written import CHANNELS, recording


@pytest.fixture(params=[False, True], ids=["small", "large"], autouse=True)
def _size(request, monkeypatch):
    """Every file as it is, and as if it were too large to be held."""
    if request.param:
        monkeypatch.setattr("dashpot.data.readers.datafile.LARGE", 1)
        monkeypatch.setattr(famos, "PIECE", 2)


def test_a_dwell(tmp_path):
    record = recording()[0]
    path = tmp_path / "test_2Hz.raw"
    path.write_bytes(dwell(record))
    (got,) = read(path, CHANNELS).records
    assert got.time == pytest.approx(record.time, abs=1e-12)
    assert got.values == pytest.approx(record.values, rel=1e-15)
    assert got.frequency_hz == 2.0


@pytest.mark.parametrize(
    ("kind", "dtype"),
    [(1, "u1"), (2, "i1"), (3, "<u2"), (4, "<i2"), (5, "<u4"), (6, "<i4"), (7, "<f4"), (8, "<f8")],
)
def test_kinds_of_numbers(tmp_path, kind, dtype):
    whole = np.array([1, 2, 3, 100, 5, 6], dtype=dtype)
    path = tmp_path / "a.dat"
    path.write_bytes(
        HEAD + channel(1, "x, y", "", whole.tobytes(), kind, whole.itemsize, 0.5, 3.0, factor=0.25)
    )
    (got,) = read(path, (Channel("x, y", {"x": 1}),)).records
    assert got.values[:, 0] == pytest.approx(0.25 * whole.astype(float) + 0.5)
    assert got.time == pytest.approx(3 + 0.5 * np.arange(6))


def test_a_buffer_that_has_gone_round(tmp_path):
    raw = np.array([4.0, 5.0, 1.0, 2.0, 3.0]).tobytes()
    path = tmp_path / "a.dat"
    path.write_bytes(HEAD + channel(1, "x", "", raw, 8, 8, 0.5, rotated=16))
    assert read(path, (Channel("x", {"x": 1}),)).records[0].values[:, 0].tolist() == [1, 2, 3, 4, 5]


def test_units_in_the_characters_of_windows(tmp_path):
    path = tmp_path / "a.dat"
    raw = channel(1, "x", "?", np.arange(3.0).tobytes(), 8, 8, 0.5)
    path.write_bytes(HEAD + raw.replace(b",1,1,?", b",1,1,\xb0"))
    (part,) = famos.read_famos(open_file(path))
    assert part.units == (None, "°")


def test_switches_are_passed_over(tmp_path):
    path = tmp_path / "a.dat"
    switch = channel(1, "on", "", np.arange(4, dtype="<u2").tobytes(), 11, 2, 0.5)
    bit = channel(2, "bit", "", np.arange(4, dtype="<u2").tobytes(), 3, 2, 0.5).replace(b",16,0,", b",16,4,")
    path.write_bytes(HEAD + switch + bit + channel(3, "x", "", np.arange(4.0).tobytes(), 8, 8, 0.5))
    (part,) = famos.read_famos(open_file(path))
    assert part.header == ("time_s", "x")
    path.write_bytes(HEAD + switch)
    with pytest.raises(DataError, match="no channels with samples"):
        read(path, CHANNELS)


@pytest.mark.parametrize(
    "layout", [b",64,0,8,1,0;", b",64,0,0,1,8;"]
)  # behind eight bytes, eight bytes apart
def test_samples_between_others_are_refused(tmp_path, layout):
    path = tmp_path / "a.dat"
    raw = channel(1, "x", "", np.arange(4.0).tobytes(), 8, 8, 0.5)
    path.write_bytes(HEAD + raw.replace(b",64,0,0,1,0;", layout))
    with pytest.raises(DataError, match="the samples of x"):
        list(famos.read_famos(open_file(path)))


def test_damaged_files(tmp_path):
    path = tmp_path / "a.dat"
    raw = np.arange(50.0).tobytes()
    data = HEAD + channel(1, "x", "V", raw, 8, 8, 0.1)
    for length in range(30, len(data) - 3, 7):
        path.write_bytes(data[:length])
        with pytest.raises(DataError, match=r"a\.dat"):
            read(path, (Channel("x", {"x": 1}, gain=None),))
    rng = np.random.default_rng(0)
    for _ in range(150):
        broken = bytearray(data)
        broken[int(rng.integers(7, 320))] = int(rng.integers(0, 256))
        path.write_bytes(bytes(broken))
        said = ""
        try:
            read(path, (Channel("x", {"x": 1}, gain=None),))
        except DashpotError as error:
            said = str(error)
        assert "\n" not in said
