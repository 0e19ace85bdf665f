"""dashpot frf and dashpot modes from end to end, on a table that a rig has simulated."""

import json
from pathlib import Path

import pytest

from tests.two_masses import HELD
from tests.unit.app.conftest import Command

TWO = f"""
coordinates = ["x1", "x2"]
[inputs]
f = {{ kind = "force", at = "x1" }}
{HELD}[channels]
f = {{ of = "f", unit = "N", noise = 0.02 }}
a1 = {{ of = "x1", quantity = "acceleration", unit = "m/s²", noise = 0.02 }}
a2 = {{ of = "x2", quantity = "acceleration", unit = "m/s²", noise = 0.02 }}
"""


@pytest.fixture
def table(dashpot: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("two.toml").write_text(TWO, encoding="utf-8")
    done = dashpot(
        "simulate", "two.toml", "--frequencies", "2:20:0.5", "--amplitude", "5N", "--table", "-o", "t.csv"
    )
    assert done.code == 0, done.err
    return tmp_path / "t.csv"


@pytest.mark.slow
def test_responses_keep_to_the_contract(dashpot: Command, table: Path) -> None:
    done = dashpot(
        *("frf", "t.csv", "--input", "f", "--output", "a1", "--output", "a2"),
        *("--json", "r.json", "--figure", "r.png"),
    )
    assert done.code == 0, done.err
    assert "a2/f" in done.out
    content = json.loads(Path("r.json").read_text(encoding="utf-8"))
    lines = len(content["frequency_hz"])
    assert set(content["frf"]) == {"a1/f", "a2/f"}
    assert all(len(content["frf"]["a1/f"][part]) == lines == 37 for part in ("re", "im", "sd"))
    assert Path("r.png").stat().st_size > 1000


@pytest.mark.slow
def test_modes_become_data(dashpot: Command, table: Path) -> None:
    done = dashpot(
        "modes",
        "t.csv",
        "--rig",
        "two.toml",
        "--json",
        "m.json",
        "-o",
        "m.csv",
        "--figure",
        "m.svg",
        "--shapes",
        "shapes.svg",
    )
    assert done.code == 0, done.err
    assert done.out.startswith("2 modes from 2.00 to 20.0 Hz")
    assert Path("shapes.svg").read_text(encoding="utf-8").count("Mode 2: ") >= 1
    content = json.loads(Path("m.json").read_text(encoding="utf-8"))
    assert [set(mode["shape"]) for mode in content["modes"]] == [{"x1", "x2"}] * 2
    assert content["modes"][0]["frequency_hz"]["value"] == pytest.approx(6.7294, abs=1e-3)
    assert dashpot("modes", "t.csv", "--input", "f", "--output", "a1,a2", "--json", "free.json").code == 0
    assert dashpot("modes", "t.csv", "--rig", "two.toml", "-o", "m.uff", "-q").code == 0
    for path in ("m.json", "m.csv", "m.uff", "free.json"):
        read = dashpot("identify", "two.toml", path, "--json", "e.json")
        assert read.code == 0, read.err
        found = json.loads(Path("e.json").read_text(encoding="utf-8"))["parameters"]
        assert found["k2"]["value"] == pytest.approx(3000, rel=0.01)
    assert dashpot("compare", "two.toml", "--modal", "free.json").code == 0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["frf", "t.csv"], "no input is named"),
        (["frf", "t.csv", "--input", "q"], "no channel q"),
        (["frf", "t.csv", "--input", "f", "--band", "30:40"], "lies in the band"),
        (["modes", "t.csv", "--input", "f", "--output", "f"], "input and output"),
        (["modes", "t.csv", "--input", "f", "--shapes", "s.svg"], "give its file"),
    ],
)
def test_bad_input_is_one_line(dashpot: Command, table: Path, words: list[str], line: str) -> None:
    done = dashpot(*words)
    assert done.code == 2
    assert len(done.err) == 1
    assert line in done.err[0]
