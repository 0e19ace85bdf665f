"""Tables of many rigs: cut into blocks without being held, read by whoever identifies them."""

import pickle
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from dashpot.errors import DataError
from dashpot.fleet import data_sets as parquet_groups
from dashpot.fleet.data_sets import DataSet, HeldRows, ParquetRows, Source, of_tables

COUNT = 23


def write_table(
    path: Path, names: list[str], rows: int = 3, group: int = 1 << 20, first: float = 0.0
) -> None:
    """A table of `rows` for each name, in row groups of `group`."""
    count = rows * len(names)
    columns = {
        "rig": np.repeat(names, rows), "frequency_hz": np.arange(count) + 1.0,
        "x_re": first + np.arange(count, dtype=float), "place": np.repeat(names, rows),
    }  # fmt: skip
    table = pa.table(columns)
    if path.suffix == ".csv":
        import pyarrow.csv as text

        text.write_csv(table, path)
    else:
        parquet.write_table(table, path, row_group_size=group)


def data_sets(source: Source, size: int) -> list[DataSet]:
    """All, read as workers do: from what was sent to them."""
    parts = [part for block in source.blocks(size) for part in block]
    sent = [pickle.loads(pickle.dumps(part)) for part in parts]
    held = [part.loaded() if isinstance(part, ParquetRows) else part for part in sent]
    return [one for part in held for one in part.data_sets()]


def checksums(source: Source, size: int = 1) -> list[str]:
    return [part.checksum() for block in source.blocks(size) for part in block]


@pytest.mark.parametrize("group", [4, 7, 1000])
@pytest.mark.parametrize("ending", [".csv", ".parquet"])
@pytest.mark.parametrize("size", [1, 5, 100])
def test_every_rig_has_its_rows_however_the_table_is_cut(
    tmp_path: Path, ending: str, size: int, group: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parquet_groups, "ROWS", 4)  # batches end in the middle of a rig
    names = [f"{k:03d}" for k in range(COUNT)]  # texts, though they look like numbers
    path = tmp_path / f"all{ending}"
    write_table(path, names, group=group)
    source = of_tables([str(path)], "rig")
    assert source.count == COUNT
    read = data_sets(source, size)
    assert [one.name for one in read] == names
    assert [one.columns["x_re"].tolist() for one in read] == [
        [3 * k, 3 * k + 1, 3 * k + 2] for k in range(COUNT)
    ]
    assert all(set(map(float, one.columns["place"])) == {float(one.name)} for one in read)
    assert "rig" not in read[0].columns


def test_a_block_goes_on_in_the_next_table(tmp_path: Path) -> None:
    for name, rigs in (("a", ["r1", "r2", "r3"]), ("b", ["r4", "r5"])):
        write_table(tmp_path / f"{name}.parquet", rigs)
    source = of_tables([str(tmp_path / "a.parquet"), str(tmp_path / "b.parquet")], "rig")
    blocks = [[part.names for part in block] for block in source.blocks(2)]
    assert blocks == [[("r1", "r2")], [("r3",), ("r4",)], [("r5",)]]


def test_blocks_may_be_read_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "all.parquet"
    write_table(path, [f"r{k}" for k in range(COUNT)], group=10)
    parts = [part for block in of_tables([str(path)], "rig").blocks(2) for part in block]
    for part in [*parts[::-1], *parts[::3], *parts[1::3]]:
        first = int(part.names[0][1:])
        assert next(part.loaded().data_sets()).columns["x_re"][0] == 3 * first


def test_what_is_sent_of_a_parquet_table_are_places_and_not_numbers(tmp_path: Path) -> None:
    path = tmp_path / "all.parquet"
    write_table(path, ["a", "b"], rows=10_000)
    part = next(of_tables([str(path)], "rig").blocks(2))[0]
    assert isinstance(part, ParquetRows)
    assert len(pickle.dumps(part)) < 2000


def test_only_blocks_of_changed_row_groups_have_other_checksums(tmp_path: Path) -> None:
    names = [f"r{k}" for k in range(8)]
    before, after = tmp_path / "all.parquet", tmp_path / "more" / "all.parquet"
    after.parent.mkdir()
    write_table(before, names, group=12)
    first = checksums(of_tables([str(before)], "rig"))
    assert len(set(first)) == 8
    table = parquet.read_table(before)
    x = table["x_re"].to_numpy().copy()
    x[-1] += 1.0
    changed = table.set_column(2, "x_re", pa.array(x))
    parquet.write_table(changed, before, row_group_size=12)
    again = checksums(of_tables([str(before)], "rig"))
    assert [old == new for old, new in zip(first, again, strict=True)] == [True] * 4 + [False] * 4


def test_checksums_of_held_rows_change_with_any_number_text_or_unit() -> None:
    columns = {"x_re": np.array([1.0, 2.0]), "place": np.array(["a", "b"], dtype=object)}
    rows = HeldRows(("r1", "r2"), "all.csv", (1, 2), columns, {"x_re": None})
    others = [
        HeldRows(("r1", "r3"), "all.csv", (1, 2), columns, {"x_re": None}),
        HeldRows(("r1", "r2"), "all.csv", (2, 2), columns, {"x_re": None}),
        HeldRows(("r1", "r2"), "all.csv", (1, 2), columns, {"x_re": "mm"}),
        HeldRows(("r1", "r2"), "all.csv", (1, 2), {**columns, "x_re": np.array([1.0, 2.5])}, {"x_re": None}),
        HeldRows(("r1", "r2"), "all.csv", (1, 2), {**columns, "place": np.array(["a", "c"])}, {"x_re": None}),
    ]
    assert len({rows.checksum(), *(other.checksum() for other in others)}) == 6


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_table_that_changes_while_the_fleet_runs_ends_it(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"all{ending}"
    write_table(path, ["a", "b", "c"])
    source = of_tables([str(path)], "rig")
    part = next(source.blocks(3))[0]
    write_table(path, ["a", "c", "b"], first=1.0)
    with pytest.raises(DataError, match="the table has changed"):
        list(source.blocks(3))
    if isinstance(part, ParquetRows):
        with pytest.raises(DataError, match="the table has changed"):
            part.loaded()


def test_what_is_wrong_with_a_table_is_said(tmp_path: Path) -> None:
    path = tmp_path / "all.parquet"
    write_table(path, ["a", "b", "a"])
    with pytest.raises(DataError, match=r"a begins in row"):
        of_tables([str(path)], "rig")
    with pytest.raises(DataError, match="column serial: missing"):
        of_tables([str(path)], "serial")
    with pytest.raises(DataError, match="there is no such"):
        of_tables([str(tmp_path / "none.parquet")], "rig")
    (tmp_path / "bad.parquet").write_bytes(path.read_bytes()[:200])
    with pytest.raises(DataError, match="the table cannot"):
        of_tables([str(tmp_path / "bad.parquet")], "rig")


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_row_without_a_name_is_refused_with_its_number(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"all{ending}"
    names = ["a", "a", None, "b"]
    if ending == ".csv":
        path.write_text("rig,x_re\n" + "".join(f"{name or ''},1.5\n" for name in names))
    else:
        parquet.write_table(pa.table({"rig": names, "x_re": [1.5] * 4}), path)
    with pytest.raises(DataError, match="column rig: row 3 names no rig"):
        of_tables([str(path)], "rig")


WRONG = {
    "rig,x_re\na,1\na,2,3\n": r"all.csv:3: the row has 3 cells, the header 2; numbers with decimal commas",
    'rig,x_re\na,1\n"a,2\nb,3\n': r"all.csv:3: a quote is not closed on its line",
    "rig,x_re\n": "the file has a header and no rows",
    "": "the file is empty",
    "rig,x_re,x_re\na,1,2\n": "column x_re: named twice",
    "rig,x_re\nb,1\na,2\nb,3\n": "b begins in row 1 and again in row 3",
}


@pytest.mark.parametrize("text", WRONG)
def test_what_is_wrong_with_a_csv_table_is_told_with_its_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "all.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=WRONG[text]) as error:
        of_tables([str(path)], "rig")
    assert "\n" not in str(error.value)


def test_a_cell_that_is_no_number_concerns_its_rig_alone(tmp_path: Path) -> None:
    """One word made a text of the whole column, and no rig was identified."""
    path = tmp_path / "all.csv"
    path.write_text("rig,x_re\n" + "".join(f"r{k},{'abc' if k == 2 else k}\n" for k in range(5)))
    kinds = [one.columns["x_re"].dtype.kind for one in data_sets(of_tables([str(path)], "rig"), 100)]
    assert kinds == ["f", "f", "O", "f", "f"]


def test_a_column_that_begins_with_whole_numbers_may_go_on_with_others(tmp_path: Path) -> None:
    """Behind the first megabyte they were refused."""
    path = tmp_path / "all.csv"
    path.write_text("rig,x_re\n" + "a,1\n" * 300_000 + "b,0.5\n")
    (last,) = data_sets(of_tables([str(path)], "rig"), 100)[1:]
    assert last.columns["x_re"].tolist() == [0.5]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "cp1252", "utf-16"])
def test_tables_may_begin_with_comments_and_units_and_have_any_encoding(
    tmp_path: Path, encoding: str
) -> None:
    path = tmp_path / "all.csv"
    path.write_text("# shaker 2\n\nrig,x_re,place\n,mm,\na1,1.5,Prüfstand\n7,NA,b\n", encoding=encoding)
    first, second = data_sets(of_tables([str(path)], "rig"), 100)
    assert (first.name, second.name) == ("a1", "7")
    assert first.columns["place"].tolist() == ["Prüfstand"]
    assert first.columns["x_re"].tolist() == [1.5]
    assert first.units == {"rig": None, "x_re": "mm", "place": None}
    assert np.isnan(second.columns["x_re"]).all()


def test_tables_with_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    path = tmp_path / "all.csv"
    path.write_text("rig;x_re;note\na;1,5;x\nb;-2,5e-3;y\n")
    read = data_sets(of_tables([str(path)], "rig"), 100)
    assert [one.columns["x_re"].tolist() for one in read] == [[1.5], [-2.5e-3]]
