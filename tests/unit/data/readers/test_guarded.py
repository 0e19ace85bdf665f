"""Formats that native code reads: what aborts, hangs or unpacks without end costs its own file, in one line."""

from __future__ import annotations

import gzip
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from dashpot.app.cli import run
from dashpot.data.inspection import inspect_file
from dashpot.data.readers import guarded
from dashpot.data.readers.datafile import UNPACKED
from dashpot.data.readers.guarded import Child
from dashpot.errors import DashpotError, DataError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="a process is forked on Linux alone")


class Answer:
    """What a child is asked for."""

    def __call__(self, request: Any, /) -> Any:
        match request:
            case "abort":
                os.abort()
            case "hang":
                time.sleep(60)
            case "spin" | "work":
                end = time.process_time() + (60 if request == "spin" else 0.5)
                while time.process_time() < end:
                    pass
                return "done"
            case "memory":
                return len(bytearray(1 << 34))
        return request

    def close(self) -> None:
        """Nothing is open."""


def refused(path: Path, monkeypatch: pytest.MonkeyPatch, unpacked: str) -> str:
    """The one line in which a file is refused whose reader has a process of its own."""
    monkeypatch.setenv(UNPACKED, unpacked)
    with pytest.raises(DashpotError) as error:
        inspect_file(path)
    assert "\n" not in str(error.value)
    return str(error.value)


def workbook(path: Path, cells: dict[str, float]) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["time_s", "x1"])
    for k in range(32):
        book.active.append([k / 128, float(np.sin(k))])
    for cell, value in cells.items():
        book.active[cell] = value
    book.save(path)
    return path


def test_a_process_ends_by_itself_while_later_ones_live() -> None:
    """A later one had held its pipe open, so that it was killed after a second: of forty damaged files one each."""
    first, later = Child(Answer(), "a.bin", 1 << 30, 0), Child(Answer(), "b.bin", 1 << 30, 0)
    assert (first.ask(1), later.ask(2)) == (1, 2)
    status = first.end()
    assert status is not None
    assert os.WIFEXITED(status)
    assert later.ask(3) == 3


def test_a_process_that_answers_goes_on_answering() -> None:
    child = Child(Answer(), "a.bin", 1 << 30, 0)
    assert [child.ask(k) for k in range(3)] == [0, 1, 2]


@pytest.mark.parametrize(("request_", "word"), [("abort", "SIGABRT"), ("memory", "memory")])
def test_a_process_that_ends_costs_one_answer(request_: str, word: str) -> None:
    child = Child(Answer(), "a.bin", 1 << 30, 0)
    with pytest.raises(DataError, match=word) as lost:
        child.ask(request_)
    assert "a.bin" in str(lost.value)


@pytest.mark.parametrize(
    ("request_", "limit", "words"), [("hang", "ASLEEP", "hangs"), ("spin", "SECONDS", "took over")]
)
def test_a_process_that_comes_to_no_end_is_ended(
    request_: str, limit: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guarded, limit, 0.2)
    child = Child(Answer(), "a.bin", 1 << 30, 0)
    process = child.process
    with pytest.raises(DataError, match=words):
        child.ask(request_)
    with pytest.raises(ProcessLookupError):
        os.kill(process, signal.SIGCONT)


def test_a_process_that_waits_for_others_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time on the clock says nothing on a busy machine: half a second of work is all right, however long it takes."""
    monkeypatch.setattr(guarded, "ASLEEP", 0.2)
    assert Child(Answer(), "a.bin", 1 << 30, 0).ask("work") == "done"


def test_a_workbook_whose_reader_aborts_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cell in the last corner makes the library ask for 549 GB, and abort."""
    path = workbook(tmp_path / "corner.xlsx", {"XFD1048576": 1.0})
    assert "corner.xlsx" in refused(path, monkeypatch, "")


def test_a_fleet_loses_that_file_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(
        'name = "one"\ncoordinates = ["x1"]\n[inputs]\nf = { kind = "force", at = "x1" }\n'
        '[masses]\nm1 = { at = "x1", value = 1.0 }\n'
        '[springs]\nk1 = { between = ["x1", "ground"] }\n[dampers]\nc1 = { between = ["x1", "ground"] }\n'
        '[channels]\nx1 = { of = "x1", quantity = "displacement" }\nf = { of = "f" }\n',
        encoding="utf-8",
    )
    openpyxl = pytest.importorskip("openpyxl")
    frequencies = np.array([0.8, 1.0, 1.2, 1.5, 1.8, 2.2])
    omega = 2 * np.pi * frequencies
    for number in range(3):
        response = 1 / (100.0 + number - omega**2 + 1j * omega)
        book = openpyxl.Workbook()
        book.active.append(["frequency_hz", "x1_re", "x1_im", "f_re", "f_im"])
        for hz, y in zip(frequencies, response, strict=True):
            book.active.append([hz, y.real, y.imag, 1.0, 0.0])
        if number == 1:
            book.active["XFD1048576"] = 1.0
        book.save(tmp_path / f"rig{number}.xlsx")
    files = [tmp_path / f"rig{number}.xlsx" for number in range(3)]
    words = ["fleet", str(rig), *map(str, files), "--out", str(tmp_path / "fleet.parquet")]
    assert run(words) == 0
    told = capsys.readouterr().out
    assert "rig1.xlsx" in "".join(told.split())  # lines end at the width of the terminal
    assert "2 identified" in told


def test_what_unpacks_without_end_is_refused_while_it_unpacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bomb.csv.gz"
    with gzip.open(path, "wb") as file:
        file.write(b"time_s,x1\n")
        for _ in range(64):
            file.write(b"0.000000,0.0\n" * 8192)
    line = refused(path, monkeypatch, "0.001")
    assert "bomb.csv.gz" in line
    assert UNPACKED in line


def test_chunks_that_unpack_to_more_than_there_may_be_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "bomb.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x1", (1 << 20,), "f8", chunks=(1 << 16,), compression="gzip")
    assert UNPACKED in refused(path, monkeypatch, "0.001")


def test_room_for_unpacked_data_is_a_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv.gz"
    with gzip.open(path, "wb") as file:
        file.write(b"time_s,x1\n0,1\n1,2\n")
    assert UNPACKED in refused(path, monkeypatch, "much")


@pytest.mark.parametrize("kind", ["npz", "mat", "parquet", "feather"])
def test_zeros_of_every_packed_format_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    path, zeros = tmp_path / f"bomb.{kind}", np.zeros(1 << 20)
    match kind:
        case "npz":
            np.savez_compressed(path, time_s=zeros, x1=zeros)
        case "mat":
            savemat(path, {"time_s": zeros, "x1": zeros}, do_compression=True)
        case "parquet":
            pq.write_table(pa.table({"time_s": zeros, "x1": zeros}), path)
        case "feather":
            feather.write_feather(pa.table({"time_s": zeros, "x1": zeros}), str(path), compression="zstd")
    assert UNPACKED in refused(path, monkeypatch, "0.01")


@pytest.mark.slow
def test_texts_that_unpack_to_more_than_there_may_be_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, count = tmp_path / "bomb.parquet", 1 << 12
    names = pa.chunked_array([pa.array(["a" * (1 << 16)] * 2048)] * (count // 2048))
    pq.write_table(pa.table({"time_s": np.arange(count) / 100, "x1": np.zeros(count), "name": names}), path)
    assert "more memory" in refused(path, monkeypatch, "0.001")
