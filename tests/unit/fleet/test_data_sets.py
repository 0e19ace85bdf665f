"""Data sets of a fleet: files by pattern."""

import os
from pathlib import Path

import pytest

from dashpot.data.readers import manifest
from dashpot.errors import DataError
from dashpot.fleet.data_sets import BlockPart, Files, expanded, of_files


def test_patterns_in_natural_order(tmp_path: Path) -> None:
    for k, name in enumerate(("run10.csv", "run2.csv", "run1.csv", "other.txt")):
        (tmp_path / name).write_text(name)
        os.utime(tmp_path / name, (1000 + k, 1000 + k))
    pattern = str(tmp_path / "*.csv")
    assert [Path(path).name for path in expanded([pattern])] == ["run1.csv", "run2.csv", "run10.csv"]
    assert [Path(path).name for path in expanded([pattern], "time")] == ["run10.csv", "run2.csv", "run1.csv"]
    given = [str(tmp_path / "run2.csv"), pattern]
    assert [Path(path).name for path in expanded(given, "given")] == ["run2.csv", "run1.csv", "run10.csv"]
    (tmp_path / "more" / "in").mkdir(parents=True)
    (tmp_path / "more" / "in" / "run3.csv").symlink_to(tmp_path / "run1.csv")
    assert expanded([str(tmp_path / "**/run3.csv")]) == [str(tmp_path / "more" / "in" / "run3.csv")]
    for pattern in (str(tmp_path / "*.parquet"), str(tmp_path / "mor*")):
        with pytest.raises(DataError, match="no file fits"):
            expanded([pattern])


def test_a_pattern_does_not_go_through_the_whole_file_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(DataError, match="whole file system"):
        expanded(["/**/none.csv"])
    (tmp_path / "a" / "b" / "c").mkdir(parents=True)
    monkeypatch.setattr(manifest, "DEEPEST", 1)
    with pytest.raises(DataError, match="name the folder"):
        expanded([str(tmp_path / "**/none.csv")])


def test_checksums_change_with_the_content(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("1")
    first = checksums([path])
    path.write_text("2")
    assert checksums([path]) != first
    missing = next(of_files([str(tmp_path / "none")]).blocks(1))[0]
    assert isinstance(missing, Files)
    assert missing.contents[0].startswith("unreadable")


def checksums(paths: list[Path]) -> list[str]:
    return [part.checksum() for block in of_files([str(path) for path in paths]).blocks(1) for part in block]


def test_blocks_hold_as_many_files_as_asked_for(tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}.csv" for k in range(5)]
    for path in paths:
        path.write_text(path.name)
    blocks: list[tuple[BlockPart, ...]] = list(of_files([str(path) for path in paths]).blocks(2))
    assert [part.names for block in blocks for part in block] == [
        tuple(map(str, paths[:2])), tuple(map(str, paths[2:4])), tuple(map(str, paths[4:])),
    ]  # fmt: skip
    assert [one.source for one in blocks[0][0].data_sets()] == [str(path) for path in paths[:2]]
