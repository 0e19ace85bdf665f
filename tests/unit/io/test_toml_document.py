"""TOML files: what cannot be read is told with its place, and problems come in the order of the lines."""

from pathlib import Path

import pytest

from dashpot.errors import DataError, ModelError, Problem
from dashpot.io.toml_document import Report, Wanted, dotted, parse_toml, read_toml

WANTED = Wanted("rig file", "describe a rig")


def test_problems_are_told_in_the_order_of_their_lines_and_once() -> None:
    document = parse_toml("[b]\nx = 1\n[a]\ny = [1, 2]\n", "f.toml", ModelError, WANTED)
    report = Report(document, DataError)
    report.raise_any()
    report.add(("a", "y", 1), "too large", "make it smaller")
    report.add(("b", "x"), "too small")
    report.add(("b", "x"), "too small")
    report.include(("b", "x"), [Problem("wrong too", "other.toml:9")])
    assert len(report) == 4
    with pytest.raises(DataError) as caught:
        report.raise_any()
    assert str(caught.value).splitlines() == [
        "f.toml:2: b.x: too small",
        "other.toml:9: wrong too",
        "f.toml:4: a.y[1]: too large; make it smaller",
    ]


def test_a_key_that_is_missing_is_placed_at_the_table_around_it_or_at_the_file() -> None:
    document = parse_toml("\n[b]\nx = 1\n", "f.toml", ModelError, WANTED)
    assert str(document.problem(("b", "z"), "missing")) == "f.toml:2: b.z: missing"
    assert str(document.problem(("c",), "missing")) == "f.toml: c: missing"
    assert str(document.problem((), "wrong")) == "f.toml: wrong"
    assert dotted(("a b", 3, "c")) == '"a b"[3].c'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("  \n", "f.toml: the file is empty; describe a rig"),
        ("a = 1\na = 2", "f.toml:2: a: given twice, first in line 1; remove one of them"),
        ("a = {\n b = 1 }", "a table in { } stands on one line"),
        ("a = [" * 5000, "f.toml"),
        ("a = " + "9" * 5000, "f.toml: a number has too many digits"),
    ],
)
def test_texts_that_are_no_toml(text: str, message: str) -> None:
    with pytest.raises(ModelError) as caught:
        parse_toml(text, "f.toml", ModelError, WANTED)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "f.toml"
    for content, message in (
        (None, "there is no such file"),
        (b"\xff\xfea\x00", "UTF-16"),
        (b"a = 1\n\xe9", ":2: byte 0xe9 is not UTF-8"),
    ):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(DataError, match=message):
            read_toml(path, DataError, WANTED)
    with pytest.raises(DataError, match="this is a folder; name the rig file in it"):
        read_toml(tmp_path, DataError, WANTED)
    path.write_bytes(b"\xef\xbb\xbfa = 1\r\nb = 2\r\n")
    document = read_toml(path, DataError, WANTED)
    assert document.table == {"a": 1, "b": 2}
    assert document.line(("b",)) == 2
