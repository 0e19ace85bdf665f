"""Whatever is wrong with a file: one line with place, cause and cure, exit code 2, no traceback, no output."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.unit.app.conftest import RIG, Command, Ran


def refused(done: Ran, *parts: str, code: int = 2, lines: int = 1) -> None:
    """One line for each problem, each with a cure after a semicolon; all `parts` are named; no file was written.

    But for the report of an identification that has failed (code 3), which says why.
    """
    assert done.code == code, (done.out, done.err)
    assert done.out == ""
    assert len(done.err) == lines, done.err
    for line in done.err:
        assert line.startswith("dashpot: ")
        assert "; " in line, f"no cure in: {line}"
        assert "Traceback" not in line
    for part in parts:
        assert any(part in line for line in done.err), (part, done.err)
    assert not {"out.json", *(() if code == 3 else ("out.html",))} & set(os.listdir())


def identify(dashpot: Command, *data: str) -> Ran:
    return dashpot("identify", "rig.toml", *data, "--json", "out.json", "--report", "out.html")


# Rig files


def test_all_problems_of_a_rig_at_once(dashpot: Command, data: Path) -> None:
    text = RIG.replace("value = 2.7", "value = -2.7").replace(
        'c1 = { between = ["x1", "x2"] }', 'c1 = { at = "x7" }'
    )
    Path("rig.toml").write_text(text + "mystery = 3\n", encoding="utf-8")
    done = identify(dashpot, "data.csv")
    refused(done, "m2", "x7", "mystery", lines=3)


def test_missing_files(dashpot: Command, data: Path) -> None:
    refused(dashpot("identify", "none.toml", "data.csv"), "none.toml")
    refused(identify(dashpot, "none.csv"), "none.csv")
    refused(identify(dashpot, "."), "directory")


def test_all_known_leaves_nothing_to_find(dashpot: Command, data: Path) -> None:
    known = RIG.replace('m1 = { at = "x1" }', 'm1 = { at = "x1", value = 3 }')
    known = known.replace('"x2"] }', '"x2"], value = 20 }').replace('"u"] }', '"u"], value = 30 }')
    Path("rig.toml").write_text(known, encoding="utf-8")
    refused(identify(dashpot, "not_there.csv"), "rig.toml", "known")


def test_a_massless_coordinate_between_spring_and_damper_is_legitimate(dashpot: Command, rig: Path) -> None:
    rig.write_text(
        'coordinates = ["x1", "joint"]\n[inputs]\nu = {}\n[masses]\nm1 = { at = "x1", value = 2.0 }\n'
        '[springs]\nk1 = { between = ["x1", "joint"] }\nk2 = { between = ["x1", "u"] }\n'
        '[dampers]\nc1 = { between = ["joint", "u"] }\n[channels]\nx1 = { of = "x1", noise = 1e-3 }\n'
        'joint = { of = "joint", noise = 1e-3 }\nu = { of = "u" }\n',
        encoding="utf-8",
    )
    settings = ["--set", "k1=300", "--set", "k2=500", "--set", "c1=9"]
    assert (
        dashpot("simulate", "rig.toml", "--out", "d.csv", "--frequencies", "0.5:9/12log", *settings).code == 0
    )
    assert dashpot("identify rig.toml d.csv -q").code == 0


# Data files


def without(column: int) -> Callable[[list[list[str]]], None]:
    def change(rows: list[list[str]]) -> None:
        for row in rows:
            del row[column]

    return change


def test_a_file_cut_in_half(dashpot: Command, data: Path) -> None:
    content = data.read_bytes()
    middle = len(content) // 2
    end = content.rindex(b"\n", 0, middle) + 3  # three characters into a row
    data.write_bytes(content[:end])
    refused(identify(dashpot, "data.csv"), "data.csv:")


@pytest.mark.parametrize("again", ["./data.csv", "link.csv"])
def test_a_file_named_twice_is_one_test(dashpot: Command, data: Path, again: str) -> None:
    """Its noise would count as that of two tests, and the intervals be too narrow by the root of two."""
    os.symlink("data.csv", "link.csv")
    refused(identify(dashpot, "data.csv", again), "2 times")


# Usage

BAD_USAGE = {
    "no command": (["identfy"], "did you mean identify"),
    "no rig": (["identify"], "RIG"),
    "no data": (["identify", "rig.toml"], "DATA"),
    "no such option": (["identify", "rig.toml", "data.csv", "--jsn", "o"], "--json"),
    "no such method": (["identify", "rig.toml", "data.csv", "--method", "magic"], "magic"),
    "level": (["identify", "rig.toml", "data.csv", "--level", "0"], "see dashpot identify --help"),
    "no level": (["identify", "rig.toml", "data.csv", "--level"], "see dashpot identify --help"),
    "orders": (["identify", "rig.toml", "data.csv", "--orders", "1,x"], "1,x"),
    "frequencies": (["simulate", "rig.toml", "--out", "o.csv", "--frequencies", "5:1:3"], "5:1:3"),
    "setting": (["simulate", "rig.toml", "--out", "o.csv", "--frequencies", "1", "--set", "m1"], "m1"),
    "unset": (["simulate", "rig.toml", "--out", "o.csv", "--frequencies", "1", "--set", "m1=1", "--set", "c1=1"], "c2"),
    "stranger": (
        ["simulate", "rig.toml", "--out", "o.csv", "--frequencies", "1", "--set", "m1=1", "--set", "c1=1",
         "--set", "c2=1", "--set", "zz=1"],
        "zz",
    ),
    "no such input": (
        ["simulate", "rig.toml", "--out", "o.csv", "--frequencies", "1", "--set", "m1=1", "--set", "c1=1",
         "--set", "c2=1", "--amplitude", "w=1"],
        "w",
    ),
    "paper": (["reproduce", "newton1687"], "yamane1989"),
    "all held out": (["identify", "rig.toml", "data.csv", "--hold-out", "200%"], "'200%' is out of range"),
    "band of dwells": (["identify", "rig.toml", "data.csv", "--band", "2:9"], "--band applies to continuous records"),
    "frequency twice": (["spectrum", "rig.toml", "data.csv", "-o", "t.csv", "--frequency", "3"], "is not needed"),
    "far frequency": (["simulate", "rig.toml", "-o", "o.csv", "--frequencies", "1e200"], "'1e200' is out of range"),
    "rig as data": (["identify", "rig.toml", "rig.toml"], "this is a rig file, not a manifest of data"),
    "no file of a fleet": (["fleet", "rig.toml", "none.csv", "-o", "f.parquet"], "none.csv: there is no such file"),
    "inspect a rig": (["inspect", "rig.toml"], "rig.toml: this is a rig file, not a manifest of data"),
    "start over old": (["start", "data.csv", "-o", "rig.toml"], "rig.toml: a file of this name exists"),
    "start from a rig": (["start", "rig.toml", "-o", "n.toml"], "rig.toml: this is a rig file, not a manifest of data"),
    "new over old": (["new", "rig.toml", "--masses", "2"], "rig.toml: a file of this name exists"),
    "new in bananas": (["new", "new.toml", "--unit", "bananas"], '"bananas" is not a unit'),
    "no curve": (["response", "rig.toml"], "--band 1:10 to follow the frequency"),
    "two curves": (["response", "rig.toml", "--band", "1:9", "--at", "3"], "--band and --at exclude each other"),
    "draws": (["reproduce", "yamane1989", "--draws", "0"], "0"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_USAGE)
def test_bad_usage(dashpot: Command, data: Path, case: str) -> None:
    args, part = BAD_USAGE[case]
    before = sorted(os.listdir())
    refused(dashpot(*args), part)
    assert sorted(os.listdir()) == before


OF_AN_ESTIMATE = {
    "drawn on another rig": (["draw", "other.toml", "-o", "o.svg", "--estimate", "e.json"], "another rig"),
    "exported with another rig": (["export", "e.json", "--rig", "other.toml", "-o", "o.mat"], "another rig"),
    "taken for data": (["identify", "rig.toml", "e.json"], "e.json: this is an estimate, not data"),
    "exported with data": (["export", "e.json", "data.csv", "-o", "o.json"], "does not use measured data"),
    "validated by nothing": (["validate", "e.json"], "no record to predict"),
}  # fmt: skip


@pytest.mark.parametrize("case", OF_AN_ESTIMATE)
def test_bad_use_of_an_estimate(dashpot: Command, data: Path, case: str) -> None:
    assert dashpot("identify", "rig.toml", "data.csv", "--json", "e.json", "-q").code == 0
    Path("other.toml").write_text(RIG.replace("m1", "mass"), encoding="utf-8")
    args, part = OF_AN_ESTIMATE[case]
    before = sorted(os.listdir())
    refused(dashpot(*args), part)
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize(
    ("target", "part"),
    [
        ("missing/out.json", "missing"),
        (".", "folder"),
        ("data.csv", "overwrite"),
        ("rig.toml", "overwrite"),
        ("", "folder"),
    ],
)
def test_outputs_are_checked_before_the_work(dashpot: Command, data: Path, target: str, part: str) -> None:
    content = data.read_bytes()
    Path("rig.toml").write_text("broken", encoding="utf-8")  # never read
    refused(dashpot("identify", "rig.toml", "data.csv", "--json", target), part)
    assert data.read_bytes() == content


@pytest.mark.slow
def test_many_problems_are_summed_up(dashpot: Command, rig: Path) -> None:
    wrong = "".join(f'q{i} = {{ at = "z" }}\n' for i in range(10_000))
    rig.write_text(RIG.replace("[springs]", wrong + "[springs]"), encoding="utf-8")
    ran = dashpot("check", "rig.toml")
    assert ran.code == 2
    assert len(ran.err) == 21
    assert ran.err[-1] == "dashpot: 9980 more problems; correct these first"
