"""Files above the sizes from which they are streamed: the same samples, by thresholds that are lowered for the test."""

from __future__ import annotations

import contextlib
import gc
import gzip
import os
import struct
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.readers import (
    arrays,
    arrow_files,
    datafile,
    hdf5,
    mdf,
    numpy_files,
    read,
    tdms,
    text,
    uff,
    wav,
)
from dashpot.data.readers import matlab as matlab_vectors
from dashpot.data.readers.uff import TIME_RESPONSE, NodalFunction, NodePoint, functions_of
from dashpot.data.readers.uff_writer import write_universal_file
from dashpot.errors import DataError
from dashpot.io.atomic import Scratch
from tests.unit.data.readers import written
from tests.unit.data.readers.written import CHANNELS, WRITERS, as_read, recording


@pytest.fixture
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything is large: pieces of 100 numbers, text in blocks of 4 kB."""
    for module in (arrays, arrow_files, hdf5, matlab_vectors, mdf, numpy_files, tdms, uff, wav):
        for name, value in (("PIECE", 100), ("LONG", 200)):
            if hasattr(module, name):
                monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(arrays, "LARGE", 1)
    monkeypatch.setattr(datafile, "LARGE", 1)
    monkeypatch.setattr(text, "BLOCK", 4096)
    monkeypatch.setattr(text, "COUNTED", 1000)


@contextlib.contextmanager
def piped(path: Path) -> Iterator[Path]:
    """A pipe, of the same ending, through which the file comes once."""
    pipe = path.with_name(f"pipe{path.suffix}")
    os.mkfifo(pipe)
    filling = threading.Thread(target=lambda: pipe.write_bytes(path.read_bytes()))
    filling.start()
    yield pipe
    filling.join()


@pytest.mark.usefixtures("_small")
@pytest.mark.parametrize("name", WRITERS)
def test_streamed_files_hold_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """From the scratch file of what is packed (every other format) or comes through a pipe, which then goes."""
    way = ("packed", "pipe")[list(WRITERS).index(name) % 2]
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    suffix, write = WRITERS[name]
    expected = recording()
    path = tmp_path / f"a{suffix}"
    write(path, expected)
    if way == "packed":
        path = written.packed(path)
    with piped(path) if way == "pipe" else contextlib.nullcontext(path) as source:
        records = as_read(source)
    gc.collect()
    assert list(scratch.iterdir()) == []
    assert len(records) == len(expected)
    for record, wanted in zip(records, expected, strict=True):
        assert record.values == pytest.approx(wanted.values, rel=1e-15)
        assert record.time - record.time[0] == pytest.approx(wanted.time, abs=1e-12)


def test_what_finds_no_room_to_be_unpacked_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(b"time_s,x1,x2,u\n" + b"0,0,0,0\n" * 1000))
    scratch = Scratch(tmp_path)
    (tmp_path / "data").symlink_to("/dev/full")
    monkeypatch.setattr(datafile, "lasting_scratch", lambda: scratch)
    with pytest.raises(DataError, match=r"no space for a temporary file"):
        as_read(path)


@pytest.mark.usefixtures("_small")
@pytest.mark.parametrize("blanks", ["", "\n", "\r\n", "\n\n\n"])
def test_text_with_blank_rows_and_without_a_last_line_end(tmp_path: Path, blanks: str) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{k / 10},{k % 7},{k % 5},{k % 3}" for k in range(1000)]
    path.write_text("time_s,x1,x2,u\n" + blanks + f"\n{blanks}".join(rows))
    (record,) = as_read(path)
    assert record.values.shape == (1000, 3)
    assert record.values[:, 1] == pytest.approx(1e-3 * (np.arange(1000) % 5))
    path.write_text("time_s,x1,x2,u\n" + "\n".join([*rows[:700], "70,1,2", *rows[700:]]) + "\n")
    with pytest.raises(DataError, match=r"a\.csv:702: the row has 3"):
        as_read(path)
    path.write_text("time_s,x1,x2,u\n" + "\n".join([*rows[:700], "70,1,,2", *rows[701:]]) + "\n")
    with pytest.raises(DataError, match=r"a\.csv:702: column x2: the cell is empty"):
        as_read(path)


@pytest.mark.usefixtures("_small")
def test_channels_that_are_read_twice_are_not_changed_in_place(tmp_path: Path) -> None:
    """A column that is a channel and the frequency as well keeps its numbers."""
    path = tmp_path / "a.csv"
    path.write_text("time_s,frequency_hz,x1\n" + "".join(f"{k / 10},2,{k % 7}\n" for k in range(500)))
    twice = (Channel("frequency_hz", {"u": 1}, unit="mm", scale=1e-3), CHANNELS[0])
    (record,) = read(path, twice).records
    assert record.frequency_hz == 2.0
    assert record.values[3] == pytest.approx([2e-3, 3e-3])


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("binary", [True, False])
def test_long_functions_of_universal_files_are_not_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, binary: bool, even: bool
) -> None:
    rng = np.random.default_rng(4)
    count, path = 4000, tmp_path / "a.uff"
    times = np.arange(count) / 100 if even else (np.arange(count) / 100 + 0.003 * (np.arange(count) % 2))
    written = [
        NodalFunction(
            TIME_RESPONSE,
            NodePoint("", k, 1),
            NodePoint(),
            times,
            rng.normal(size=count),
            ids=(name,),
            even=even,
        )
        for k, name in enumerate(("x1", "x2", "u"))
    ]
    write_universal_file(path, written, binary=binary)
    (held,) = as_read(path)
    monkeypatch.setattr(uff, "LONG", 200)
    monkeypatch.setattr(uff, "PIECE", 900)
    assert all(read_back.long is not None for read_back in functions_of(datafile.open_file(path)))
    (record,) = as_read(path)
    assert np.array_equal(record.values, held.values)
    assert np.array_equal(record.time, held.time)
    path.write_bytes(path.read_bytes()[:-4000])
    with pytest.raises(DataError, match="cut off"):
        as_read(path)


@pytest.mark.usefixtures("_small")
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("kind", ["u1", "i2", "i4", "f4"])
def test_long_sound_is_mapped(tmp_path: Path, packed: bool, kind: str) -> None:
    from scipy.io import wavfile

    path = tmp_path / "a.wav"
    numbers = (np.arange(2000).reshape(1000, 2) % 100).astype(kind)
    wavfile.write(path, 100, numbers)
    path = written.packed(path) if packed else path
    (record,) = read(path, tuple(Channel(f"channel_{k}", {"x": 1}, unit="FS") for k in (1, 2))).records
    offset, scale = {"u1": (128, 128), "i2": (0, 2**15), "i4": (0, 2**31), "f4": (0, 1)}[kind]
    assert np.array_equal(record.values, (numbers.astype(float) - offset) / scale)


@pytest.mark.usefixtures("_small")
@pytest.mark.parametrize("tag", ["RIFF", "RIFX", "RF64"])
def test_sound_of_24_bits_is_as_scipy_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tag: str
) -> None:
    path = tmp_path / "a.wav"
    order = ">" if tag == "RIFX" else "<"
    numbers = np.random.default_rng(1).integers(-(2**23), 2**23, size=(500, 2))
    numbers[:2] = [[-(2**23), 2**23 - 1], [-1, 0]]
    wide = numbers.astype(f"{order}i4").view(np.uint8).reshape(500, 2, 4)
    data = (wide[..., 1:] if order == ">" else wide[..., :3]).tobytes()
    size = 2**32 - 1 if tag == "RF64" else len(data)
    chunks = b"WAVE" + b"LIST" + struct.pack(f"{order}I", 3) + b"abc\0"
    if tag == "RF64":
        chunks = (
            b"WAVE" + b"ds64" + struct.pack("<IQQQI", 28, len(data) + 100, len(data), 500, 0) + chunks[4:]
        )
    chunks += b"fmt " + struct.pack(f"{order}IHHIIHH", 16, 1, 2, 100, 600, 6, 24)
    chunks += b"data" + struct.pack(f"{order}I", size) + data
    path.write_bytes(tag.encode() + struct.pack(f"{order}I", len(chunks)) + chunks)
    channels = tuple(Channel(f"channel_{k}", {"x": 1}, unit="FS") for k in (1, 2))
    (record,) = read(path, channels).records
    assert np.array_equal(record.values, numbers / 2**23)
    if tag != "RF64":  # which older versions of SciPy do not know
        with monkeypatch.context() as small:
            small.setattr(datafile, "LARGE", 1 << 28)
            (held,) = read(path, channels).records
        assert np.array_equal(record.values, held.values)
        assert np.array_equal(record.time, held.time)
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(DataError, match="WAV file is damaged"):
        read(path, channels)


@pytest.mark.usefixtures("_small")
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i2", "u1", ">f8"])
def test_long_vectors_of_matlab_are_not_held(tmp_path: Path, packed: bool, kind: str) -> None:
    """Whatever the numbers, and beside scalars, texts and complex vectors, which SciPy reads."""
    from scipy.io import savemat

    path = tmp_path / "a.mat"
    numbers = (np.arange(1000) % 100).astype(kind)
    savemat(
        path,
        {"x": numbers, "fs": 10.0, "remark": "a text", "z": np.arange(7) * 1j, "y": numbers[:, None] * 2},
        do_compression=packed,
    )
    long = dict(matlab_vectors.variables_of(datafile.open_file(path)))
    assert {name for name, numbers in long.items() if numbers is not None} == {"x", "y"}
    assert set(long) == {"x", "y", "fs", "remark", "z"}
    (record,) = read(path, (Channel("x", {"x": 1}), Channel("y", {"x": 1}))).records
    assert np.array_equal(record.values, np.stack([numbers, numbers * 2], axis=1).astype(float))
    assert record.time == pytest.approx(np.arange(1000) / 10)
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(DataError, match="cut off"):
        read(path, (Channel("x", {"x": 1}),))
