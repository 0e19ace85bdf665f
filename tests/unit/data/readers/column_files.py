"""Columns of doubles written by the library of each format, without any digit lost where the format can hold them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.record import Record
from tests.unit.data.readers.famos_bytes import HEAD, channel


def csv(path: Path, columns: dict[str, Real]) -> None:
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    path.write_text(",".join(columns) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))


def mat(path: Path, columns: dict[str, Real]) -> None:
    from scipy.io import savemat

    savemat(path, columns)


def hdf5(path: Path, columns: dict[str, Real]) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, column in columns.items():
            file[name] = column


def parquet(path: Path, columns: dict[str, Real]) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    pa.parquet.write_table(pa.table(columns), path)


def feather(path: Path, columns: dict[str, Real]) -> None:
    import pyarrow as pa
    import pyarrow.feather

    pa.feather.write_feather(pa.table(columns), str(path))


def excel(path: Path, columns: dict[str, Real]) -> None:
    from openpyxl import Workbook

    book = Workbook()
    book.active.append(list(columns))
    for row in zip(*(column.tolist() for column in columns.values()), strict=True):
        book.active.append(row)
    book.save(path)


def tdms(path: Path, columns: dict[str, Real], **properties: float) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject("g", n, c, properties=properties) for n, c in columns.items()])


def mdf(path: Path, columns: dict[str, Real], times: Real) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(column, times, name=name) for name, column in columns.items()])
        file.save(path, overwrite=True)


def uff(path: Path, columns: dict[str, Real], times: Real) -> None:
    from dashpot.data.readers.uff_writer import write_uff_records

    channels = tuple(Channel(name, {name: 1}) for name in columns)
    write_uff_records([Record(channels, times, np.stack(list(columns.values()), axis=-1))], path)


def famos(path: Path, columns: dict[str, Real], step: float) -> None:
    blocks = [channel(i + 1, n, "", c.tobytes(), 8, 8, step) for i, (n, c) in enumerate(columns.items())]
    path.write_bytes(HEAD + b"".join(blocks))


def npz(path: Path, columns: dict[str, Real]) -> None:
    np.savez(path, **columns)


# Formats of which a file is a table of columns, whatever these are.
TABLES: dict[str, Callable[[Path, dict[str, Real]], None]] = {
    ".csv": csv, ".mat": mat, ".h5": hdf5, ".npz": npz, ".parquet": parquet, ".feather": feather, ".xlsx": excel,
    ".tdms": tdms,
}  # fmt: skip
