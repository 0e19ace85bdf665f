"""Records whose variables carry the channels' names are read as they are: with times, or the format's own sampling."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.readers import read
from dashpot.data.record import Record
from tests.unit.data.readers.famos_bytes import HEAD, channel
from tests.unit.data.readers.written import wav

RATE = 128.0
T = np.arange(300) / RATE
X = np.round(np.sin(7 * T) * 1024) / 1024


def _csv(path: Path, columns: dict[str, Real]) -> None:
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    path.write_text(",".join(columns) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))


def _mat(path: Path, columns: dict[str, Real]) -> None:
    from scipy.io import savemat

    savemat(path, columns)


def _hdf5(path: Path, columns: dict[str, Real]) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, column in columns.items():
            file[name] = column


def _parquet(path: Path, columns: dict[str, Real]) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    pa.parquet.write_table(pa.table(columns), path)


def _feather(path: Path, columns: dict[str, Real]) -> None:
    import pyarrow as pa
    import pyarrow.feather

    pa.feather.write_feather(pa.table(columns), str(path))


def _excel(path: Path, columns: dict[str, Real]) -> None:
    from openpyxl import Workbook

    book = Workbook()
    book.active.append(list(columns))
    for row in zip(*(column.tolist() for column in columns.values()), strict=True):
        book.active.append(row)
    book.save(path)


def _tdms(path: Path, columns: dict[str, Real], **properties: float) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject("g", n, c, properties=properties) for n, c in columns.items()])


def _mdf(path: Path, columns: dict[str, Real]) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(column, T, name=name) for name, column in columns.items()])
        file.save(path, overwrite=True)


def _uff(path: Path, columns: dict[str, Real]) -> None:
    from dashpot.data.readers.uff.writer import write_uff_records

    channels = tuple(Channel(name, {name: 1}) for name in columns)
    write_uff_records([Record(channels, T, np.stack(list(columns.values()), axis=-1))], path)


def _famos(path: Path, columns: dict[str, Real]) -> None:
    blocks = [channel(i + 1, n, "", c.tobytes(), 8, 8, 1 / RATE) for i, (n, c) in enumerate(columns.items())]
    path.write_bytes(HEAD + b"".join(blocks))


def _npz(path: Path, columns: dict[str, Real]) -> None:
    np.savez(path, **columns)


WITH_TIMES: dict[str, Callable[[Path, dict[str, Real]], None]] = {
    ".csv": _csv, ".mat": _mat, ".h5": _hdf5, ".npz": _npz, ".parquet": _parquet, ".feather": _feather,
    ".xlsx": _excel, ".tdms": _tdms,
}  # fmt: skip
OF_ITS_OWN: dict[str, Callable[[Path, dict[str, Real]], None]] = {
    ".mat": lambda path, columns: _mat(path, columns | {"fs": np.array(RATE)}),
    ".h5": lambda path, columns: _hdf5(path, columns | {"fs": np.array(RATE)}),
    ".npz": lambda path, columns: _npz(path, columns | {"dt": np.array(1 / RATE)}),
    ".tdms": lambda path, columns: _tdms(path, columns, wf_increment=1 / RATE),
    ".mf4": _mdf, ".uff": _uff, ".raw": _famos,
}  # fmt: skip
CHANNELS = (Channel("x", {"x": 1}), Channel("y", {"x": 1}))


def _same(path: Path, channels: tuple[Channel, ...] = CHANNELS) -> None:
    (record,) = read(path, channels).records
    assert record.frequency_hz is None
    assert record.time - record.time[0] == pytest.approx(T, abs=1e-12)
    assert record.values == pytest.approx(
        np.stack([X, 2 * X], axis=-1), rel=1e-15
    )  # openpyxl writes 16 digits


@pytest.mark.parametrize("suffix", WITH_TIMES)
def test_with_times(tmp_path: Path, suffix: str) -> None:
    WITH_TIMES[suffix](tmp_path / f"a{suffix}", {"time_s": T, "x": X, "y": 2 * X})
    _same(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", OF_ITS_OWN)
def test_with_the_sampling_of_the_format(tmp_path: Path, suffix: str) -> None:
    OF_ITS_OWN[suffix](tmp_path / f"a{suffix}", {"x": X, "y": 2 * X})
    _same(tmp_path / f"a{suffix}")


def test_sound(tmp_path: Path) -> None:
    (tmp_path / "a.wav").write_bytes(wav(np.stack([X, 2 * X], axis=-1), int(RATE)))
    _same(tmp_path / "a.wav", (Channel("channel_1", {"x": 1}), Channel("channel_2", {"x": 1})))


def test_small_numbers_of_workbooks_keep_their_digits(tmp_path: Path) -> None:
    """As text the library gives them rounded to nine decimals, which is nothing for a motion of micrometres."""
    _excel(tmp_path / "a.xlsx", {"time_s": T, "x": 1.2345678901e-7 * X, "y": 1e-9 * X})
    values = read(tmp_path / "a.xlsx", CHANNELS).records[0].values
    assert values == pytest.approx(np.stack([1.2345678901e-7 * X, 1e-9 * X], axis=-1), rel=1e-14, abs=0)
