"""Long records in pieces: the same samples as read whole, windows beside gaps, a file that grows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from dashpot.channel import Channel
from dashpot.data.readers import pieces, read
from dashpot.data.readers.pieces import records_in_pieces, windows_of
from dashpot.data.record import Record
from dashpot.errors import DataError

CHANNELS = (Channel("x1", {"x1": 1.0}), Channel("f", {"f": 1.0}))
HEADER = "time_s,f,x1\n"


def rows(first: int, last: int) -> str:
    return "".join(f"{k / 100:.2f},{np.sin(k):.6f},{np.cos(k):.6f}\n" for k in range(first, last))


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "long.csv"
    path.write_text(HEADER + rows(0, 4000), encoding="utf-8")
    return path


def test_pieces_are_the_whole(table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "PIECE", 20_000)
    (whole,) = read(table, CHANNELS).records
    some = list(records_in_pieces(table, CHANNELS))
    assert len(some) > 3
    assert np.array_equal(np.concatenate([each.values for each in some]), whole.values)
    assert np.array_equal(np.concatenate([each.time for each in some]), whole.time)
    columns = {"time_s": whole.time, "f": whole.values[:, 1], "x1": whole.values[:, 0]}
    parquet.write_table(pa.table(columns), tmp_path / "long.parquet", row_group_size=1000)
    again = list(records_in_pieces(tmp_path / "long.parquet", CHANNELS))
    assert np.concatenate([each.values for each in again]) == pytest.approx(whole.values, abs=1e-12)


def test_a_wrong_row_is_named_by_its_number_in_the_file(table: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "PIECE", 20_000)
    lines = table.read_text(encoding="utf-8").splitlines()
    lines[3000] = "30,none,0"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(DataError, match=":3001: column f"):
        list(records_in_pieces(table, CHANNELS))


def test_windows_leave_gaps_and_short_rests_out(table: Path) -> None:
    (whole,) = read(table, CHANNELS).records
    gap = [whole.part(slice(0, 700)), whole.part(slice(730, 1250))]
    found = [(round(each.time[0], 6), len(each.time)) for each in windows_of(gap, 3.0)]
    assert found == [(0.0, 300), (3.0, 300), (7.3, 300), (10.3, 220)]
    joined = list(windows_of((whole.part(slice(k, k + 77)) for k in range(0, 3927, 77)), 4.0))
    assert len(joined) == 10
    assert np.array_equal(joined[3].values, whole.values[1200:1600])
    with pytest.raises(DataError, match="too short"):
        list(windows_of([whole], 0.1))
    with pytest.raises(DataError, match="does not increase"):
        list(windows_of([whole, whole], 20.0))


def test_a_file_is_followed_as_it_grows(tmp_path: Path) -> None:
    path = tmp_path / "grows.csv"
    whole = rows(0, 900)
    path.write_text(HEADER + whole[:9000], encoding="utf-8")  # in the middle of a row
    waits: list[float] = []

    def wait(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 2:
            with path.open("a", encoding="utf-8") as stream:
                stream.write(whole[9000:])

    some: list[Record] = list(records_in_pieces(path, CHANNELS, follow=3.0, wait=wait))
    assert len(some) == 2
    assert sum(len(each.time) for each in some) == 900
    assert len(waits) == 2 + 3


def test_what_is_no_record_in_time_is_refused(tmp_path: Path) -> None:
    dwells = tmp_path / "dwells.csv"
    dwells.write_text(
        "frequency_hz," + HEADER + "".join("5," + r + "\n" for r in rows(0, 50).split()), "utf-8"
    )
    with pytest.raises(DataError, match="stepped sine"):
        list(records_in_pieces(dwells, CHANNELS))
    dated = tmp_path / "dated.csv"
    stamps = [f"2025-03-06 12:21:{k / 100:05.2f},{k},{k}\n" for k in range(50)]
    dated.write_text(HEADER.replace("time_s", "time") + "".join(stamps), encoding="utf-8")
    assert len(list(records_in_pieces(dated, CHANNELS))) == 1
    with pytest.raises(DataError, match="cannot be followed"):
        list(records_in_pieces(dated, CHANNELS, follow=1.0))
