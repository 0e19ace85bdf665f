"""One stepped-sine recording of two masses, written by the library of each format (or by hand)."""

from __future__ import annotations

import gzip
import io
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from dashpot.channel import Channel
from dashpot.data.readers import read, write_records
from dashpot.data.record import Record
from tests.two_masses import OPEN

RIG = OPEN.replace('m1 = { at = "x1" }', 'm1 = { at = "x1", value = 1.0 }')
RIG += """[channels]
x1 = { of = "x1", unit = "mm" }
x2 = { of = "x2", unit = "mm" }
u = { of = "u", unit = "mm" }
"""
CHANNELS = (
    Channel("x1", {"x1": 1}, unit="mm", scale=1e-3),
    Channel("x2", {"x2": 1}, unit="mm", scale=1e-3),
    Channel("u", {"u": 1}, unit="mm", scale=1e-3),
)
NAMES = tuple(channel.name for channel in CHANNELS)
RATE = 128.0


def recording(samples: int = 256) -> list[Record]:
    """Three dwells; numbers that single precision and text hold exactly, mm."""
    rng = np.random.default_rng(5)
    records = []
    for f in (2.0, 4.0, 8.0):
        t = np.arange(samples) / RATE
        X = _response(f)
        x = np.real(np.exp(2j * np.pi * f * t)[:, None] * X) + 0.01 * rng.normal(size=(samples, 3))
        x = np.round(x * 1024) / 1024
        records.append(Record(CHANNELS, t, x * 1e-3, f))
    return records


def _response(f: float) -> np.ndarray:
    """m1 = 1 kg on k1 = 1000 N/m, c1 = 4 N·s/m on m2 = 2 kg on k2 = 2000 N/m, c2 = 6 N·s/m on u = 3 mm."""
    s = 2j * np.pi * f
    z1, z2 = 1000 + 4 * s, 2000 + 6 * s
    Z = np.array([[s**2 + z1, -z1], [-z1, 2 * s**2 + z1 + z2]])
    return np.array([*np.linalg.solve(Z, [0, z2 * 3.0]), 3.0])


def long_table(records: list[Record]) -> dict[str, np.ndarray]:
    """All dwells below each other, in the channels' units."""
    millimetres = np.concatenate([np.round(record.values * 1e3 * 1024) / 1024 for record in records])
    lengths = [len(record.time) for record in records]
    table = {
        "frequency_hz": np.repeat([record.frequency_hz for record in records], lengths),
        "time_s": np.concatenate([record.time for record in records]),
    }
    return table | {name: millimetres[:, i] for i, name in enumerate(NAMES)}


def _csv(path: Path, records: list[Record]) -> None:
    write_records(records, path)


def _mat(path: Path, records: list[Record]) -> None:
    from scipy.io import savemat

    savemat(path, long_table(records), do_compression=True)


def _mat_dwells(path: Path, records: list[Record]) -> None:
    """Matrices with a column for each dwell, one time and a sampling rate in place of times."""
    from scipy.io import savemat

    table = long_table(records)
    shape = (len(records), -1)
    content = {name: table[name].reshape(shape).T for name in NAMES}
    savemat(path, {**content, "frequency_hz": [r.frequency_hz for r in records], "fs": RATE})


def _mat_structures(path: Path, records: list[Record]) -> None:
    """An array of structures, one for each dwell."""
    from scipy.io import savemat

    kinds = [("frequency_hz", object), ("time_s", object), *((name, object) for name in NAMES)]
    dwells = np.empty(len(records), dtype=kinds)
    for k, record in enumerate(records):
        columns = [np.round(x * 1e3 * 1024) / 1024 for x in record.values.T]
        dwells[k] = (record.frequency_hz, record.time, *columns)
    savemat(path, {"dwell": dwells})


def _hdf5(path: Path, records: list[Record]) -> None:
    """A group for each dwell, frequency and rate as attributes, units as attributes of the datasets."""
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["fs"] = RATE
        for k, record in enumerate(records):
            group = file.create_group(f"test/dwell{k}")
            group.attrs["frequency_hz"] = record.frequency_hz
            for name, x in zip(NAMES, record.values.T, strict=True):
                data = group.create_dataset(name, data=(np.round(x * 1e3 * 1024) / 1024).astype("f4"))
                data.attrs["unit"] = "mm"


def mat73(path: Path, columns: dict[str, np.ndarray]) -> None:
    """As MATLAB 7.3 does: a user block of 512 bytes, datasets transposed."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, column in columns.items():
            kind = "double" if column.dtype == float else str(column.dtype)
            file.create_dataset(name, data=column[None, :]).attrs["MATLAB_class"] = np.bytes_(kind)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def _mat73(path: Path, records: list[Record]) -> None:
    mat73(path, long_table(records))


def _npz(path: Path, records: list[Record]) -> None:
    table = long_table(records)
    np.savez_compressed(path, **table, x1_unit=np.array("mm"))


def _npy(path: Path, records: list[Record]) -> None:
    table = long_table(records)
    array = np.empty(len(table["time_s"]), dtype=[(name, "f8") for name in table])
    for name, column in table.items():
        array[name] = column
    np.save(path, array)


def _arrow(records: list[Record]):
    import pyarrow as pa

    table = long_table(records)
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": "mm"} if name in NAMES else None) for name in table
    ]
    return pa.table(list(table.values()), schema=pa.schema(fields))


def _parquet(path: Path, records: list[Record]) -> None:
    import pyarrow.parquet as pq

    pq.write_table(_arrow(records), path)


def _feather(path: Path, records: list[Record]) -> None:
    import pyarrow.feather as feather

    feather.write_feather(_arrow(records), str(path))


def _excel(path: Path, records: list[Record]) -> None:
    """A sheet of remarks, and one with a row of units."""
    from openpyxl import Workbook

    book = Workbook()
    book.active.append(["recorded by", "somebody"])
    sheet = book.create_sheet("data")
    table = long_table(records)
    sheet.append(list(table))
    sheet.append(["Hz", "s", "mm", "mm", "mm"])
    for row in zip(*(column.tolist() for column in table.values()), strict=True):
        sheet.append(row)
    book.save(path)


def _tdms(path: Path, records: list[Record]) -> None:
    from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

    with TdmsWriter(str(path)) as writer:
        for k, record in enumerate(records):
            group = GroupObject(f"dwell {k}", properties={"frequency_hz": record.frequency_hz})
            shape = {"wf_increment": 1 / RATE, "unit_string": "mm"}
            columns = [np.round(x * 1e3 * 1024) / 1024 for x in record.values.T]
            channels = [
                ChannelObject(group.group, name, x, properties=shape)
                for name, x in zip(NAMES, columns, strict=True)
            ]
            writer.write_segment([RootObject(), group, *channels])


def _mdf(path: Path, records: list[Record]) -> None:
    from asammdf import MDF, Signal

    table = long_table(records)
    time = np.arange(len(table["time_s"])) / RATE  # one clock through all dwells
    with MDF(version="4.10") as file:
        signals = [Signal(table["frequency_hz"], time, name="frequency_hz", unit="Hz")]
        signals += [Signal(table[name], time, name=name, unit="mm") for name in NAMES]
        file.append(signals)
        file.save(path, overwrite=True)


def _uff(
    path: Path, records: list[Record], *, binary: bool = True, double: bool = True, little: bool = True
) -> None:
    from dashpot.data.readers.uff_writer import write_uff_records

    write_uff_records(records, path, binary=binary, double=double, little=little)


WRITERS: dict[str, tuple[str, Callable[[Path, list[Record]], None]]] = {
    "CSV": (".csv", _csv),
    "MATLAB": (".mat", _mat),
    "MATLAB, dwells in columns": (".mat", _mat_dwells),
    "MATLAB, structures": (".mat", _mat_structures),
    "MATLAB 7.3": (".mat", _mat73),
    "HDF5": (".h5", _hdf5),
    "NumPy archive": (".npz", _npz),
    "NumPy array": (".npy", _npy),
    "Parquet": (".parquet", _parquet),
    "Feather": (".feather", _feather),
    "Excel": (".xlsx", _excel),
    "TDMS": (".tdms", _tdms),
    "MDF": (".mf4", _mdf),
    "UFF": (".uff", _uff),
    "UFF, single precision, high byte first": (".uff", partial(_uff, double=False, little=False)),
    "UFF as text": (".uff", partial(_uff, binary=False)),
}


def packed(path: Path) -> Path:
    """The same file packed by gzip."""
    target = path.with_name(path.name + ".gz")
    target.write_bytes(gzip.compress(path.read_bytes(), 1))
    return target


def wav(samples: np.ndarray, rate: int = 128) -> bytes:
    """A WAV file of single precision, (samples, channels)."""
    from scipy.io import wavfile

    out = io.BytesIO()
    wavfile.write(out, rate, samples.astype(np.float32))
    return out.getvalue()


def as_read(path: Path) -> list[Record]:
    """The records of a file."""
    return list(read(path, CHANNELS).records)


__all__ = ["CHANNELS", "NAMES", "RATE", "WRITERS", "as_read", "mat73", "packed", "recording", "wav"]
