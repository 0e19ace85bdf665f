"""Data sets of a fleet: files by pattern, and tables that are read as a stream."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from dashpot.errors import DataError, UsageError
from dashpot.fleet import data_sets
from dashpot.fleet.data_sets import PackedRows, expanded, of_files, of_tables, packed


def test_patterns_in_natural_order(tmp_path: Path) -> None:
    for k, name in enumerate(("run10.csv", "run2.csv", "run1.csv", "other.txt")):
        (tmp_path / name).write_text(name)
        os.utime(tmp_path / name, (1000 + k, 1000 + k))
    pattern = str(tmp_path / "*.csv")
    assert [Path(path).name for path in expanded([pattern])] == ["run1.csv", "run2.csv", "run10.csv"]
    assert [Path(path).name for path in expanded([pattern], "time")] == ["run10.csv", "run2.csv", "run1.csv"]
    given = [str(tmp_path / "run2.csv"), pattern]
    assert [Path(path).name for path in expanded(given, "given")] == ["run2.csv", "run1.csv", "run10.csv"]
    with pytest.raises(UsageError, match="no file matches this pattern"):
        expanded([str(tmp_path / "*.parquet")])


def test_checksums_change_with_the_content(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("1")
    first = next(of_files([str(path)]).read()).checksum
    path.write_text("2")
    assert next(of_files([str(path)]).read()).checksum != first
    missing = next(of_files([str(tmp_path / "none")]).read())
    assert missing.checksum.startswith("unreadable")


def table_of(path: Path, names: list[str], rows: int = 3) -> None:
    count = rows * len(names)
    columns = {
        "rig": np.repeat(names, rows), "frequency_hz": np.arange(count) + 1.0, "x_re": np.arange(count, dtype=float),
    }  # fmt: skip
    table = pa.table(columns)
    if path.suffix == ".csv":
        import pyarrow.csv as text

        text.write_csv(table, path)
    else:
        parquet.write_table(table, path)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_rows_of_one_rig_stay_together_over_the_parts_of_a_table(
    tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(data_sets, "ROWS", 4)  # parts end in the middle of a rig
    path = tmp_path / f"all{ending}"
    table_of(path, ["007", "008", "010"])
    source = of_tables([str(path)], "rig")
    found = list(source.read())
    assert source.count == 3
    assert [one.name for one in found] == ["007", "008", "010"]
    assert [one.columns["x_re"].tolist() for one in found] == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    assert "rig" not in found[0].columns
    assert len({one.checksum for one in found}) == 3


def test_checksums_do_not_depend_on_how_a_table_is_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "all.parquet"
    table_of(path, ["a", "b"])
    whole = [one.checksum for one in of_tables([str(path)], "rig").read()]
    monkeypatch.setattr(data_sets, "ROWS", 2)
    assert [one.checksum for one in of_tables([str(path)], "rig").read()] == whole


def test_what_is_wrong_with_a_table_is_said(tmp_path: Path) -> None:
    path = tmp_path / "all.parquet"
    table_of(path, ["a", "b", "a"])
    with pytest.raises(DataError, match="the rows of a are not together in the file; sort the table by rig"):
        of_tables([str(path)], "rig")
    with pytest.raises(DataError, match="column serial: missing"):
        of_tables([str(path)], "serial")
    with pytest.raises(DataError, match="there is no such file"):
        of_tables([str(tmp_path / "none.parquet")], "rig")
    (tmp_path / "bad.parquet").write_bytes(path.read_bytes()[:200])
    with pytest.raises(DataError, match="the table cannot be read"):
        of_tables([str(tmp_path / "bad.parquet")], "rig")


def test_rows_are_sent_as_one_table_and_are_the_same_again(tmp_path: Path) -> None:
    path = tmp_path / "all.parquet"
    table_of(path, ["a", "b", "c"])
    sets = tuple(of_tables([str(path)], "rig").read())
    table = packed(sets)
    assert isinstance(table, PackedRows)
    for one, again in zip(sets, table.unpacked(), strict=True):
        assert (one.name, one.source, one.checksum, one.units) == (
            again.name, again.source, again.checksum, again.units,
        )  # fmt: skip
        assert all(np.array_equal(values, again.columns[key]) for key, values in one.columns.items())
    files = tuple(of_files([str(path)]).read())
    assert packed(files) == files
