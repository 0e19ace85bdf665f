"""Records whose variables carry the channels' names are read as they are: with times, or the format's own sampling."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.readers import read
from tests.unit.data.readers.column_files import TABLES, excel, famos, hdf5, mat, mdf, npz, tdms, uff
from tests.unit.data.readers.written import wav

RATE = 128.0
T = np.arange(300) / RATE
X = np.round(np.sin(7 * T) * 1024) / 1024


OF_ITS_OWN: dict[str, Callable[[Path, dict[str, Real]], None]] = {
    ".mat": lambda path, columns: mat(path, columns | {"fs": np.array(RATE)}),
    ".h5": lambda path, columns: hdf5(path, columns | {"fs": np.array(RATE)}),
    ".npz": lambda path, columns: npz(path, columns | {"dt": np.array(1 / RATE)}),
    ".tdms": lambda path, columns: tdms(path, columns, wf_increment=1 / RATE),
    ".mf4": lambda path, columns: mdf(path, columns, T),
    ".uff": lambda path, columns: uff(path, columns, T),
    ".raw": lambda path, columns: famos(path, columns, 1 / RATE),
}
CHANNELS = (Channel("x", {"x": 1}), Channel("y", {"x": 1}))


def _same(path: Path, channels: tuple[Channel, ...] = CHANNELS) -> None:
    (record,) = read(path, channels).records
    assert record.frequency_hz is None
    assert record.time - record.time[0] == pytest.approx(T, abs=1e-12)
    assert record.values == pytest.approx(
        np.stack([X, 2 * X], axis=-1), rel=1e-15
    )  # openpyxl writes 16 digits


@pytest.mark.parametrize("suffix", TABLES)
def test_with_times(tmp_path: Path, suffix: str) -> None:
    TABLES[suffix](tmp_path / f"a{suffix}", {"time_s": T, "x": X, "y": 2 * X})
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
    excel(tmp_path / "a.xlsx", {"time_s": T, "x": 1.2345678901e-7 * X, "y": 1e-9 * X})
    values = read(tmp_path / "a.xlsx", CHANNELS).records[0].values
    assert values == pytest.approx(np.stack([1.2345678901e-7 * X, 1e-9 * X], axis=-1), rel=1e-14, abs=0)
