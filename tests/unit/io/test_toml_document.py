"""TOML files: what cannot be read is told with its place, and problems come in the order of the lines."""

import pytest

from dashpot.errors import DataError, ModelError, Problem
from dashpot.io.toml_document import Report, Wanted, dotted, parse_toml

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


def test_data_in_the_place_of_a_rig_file_are_told_so() -> None:
    for text in ("time_s,x1\n0,1\n", "Frequency\tReal\n"):
        with pytest.raises(ModelError) as caught:
            parse_toml(text, "run.csv", ModelError, WANTED)
        assert str(caught.value) == "run.csv: this is not a rig file; name the rig file (TOML) here"
