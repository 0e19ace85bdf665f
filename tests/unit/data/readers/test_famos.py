"""FAMOS files made by hand as imc devices write them; imctermite reads the samples of its repository alike."""

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.readers import read
from dashpot.errors import DashpotError, DataError
from tests.unit.data.readers.written import CHANNELS, NAMES, RATE, recording


def key(tag, content, version=1):
    return f"|{tag},{version},{len(content):6d},".encode() + content + b";"


def channel(number, name, unit, raw, kind, width, step, start=0.0, factor=None, rotated=0):
    """One channel with its block of samples."""
    scaled = b"0, 1.0, 0.0" if factor is None else f"1, {factor!r}, 0.5".encode()
    return b"".join(
        [
            key("CG", b"1,1,1"),
            key("CD", f" {step!r},1,1,s,0,0,0, 0.0,1".encode(), 2),
            key("CC", b"1,1"),
            key("CP", f"{number},{width},{kind},{8 * width},0,0,1,0".encode()),
            key("CR", scaled + f",1,{len(unit)},{unit}".encode()),
            key("CN", f"0,0,0,{len(name)},{name},0,".encode()),
            key("Cb", f"1,0,{number},{number},0,{len(raw)},{rotated},{len(raw)},1, {start!r}, 0.0,".encode()),
            key("CS", f"{number},".encode() + raw),
            b"\r\n",
        ]
    )


HEAD = b"|CF,2,1,1;|CK,1,3,1,1;" + key("NO", b"1,6,by|;us,0,")


def test_a_dwell(tmp_path):
    record = recording()[0]
    path = tmp_path / "test_2Hz.raw"
    columns = [np.round(x * 1e3 * 1024) / 1024 for x in record.values.T]
    parts = [
        channel(i + 1, name, "mm", x.astype("<f8").tobytes(), 8, 8, 1 / RATE)
        for i, (name, x) in enumerate(zip(NAMES, columns, strict=True))
    ]
    path.write_bytes(HEAD + b"".join(parts))
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
