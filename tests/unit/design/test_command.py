"""The command `dashpot design` from the outside: contract of the JSON, files, one line for each fault."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dashpot.app.cli import run

RIG = Path(__file__).parents[3] / "examples" / "design" / "rig.toml"


def test_contract_of_the_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, csv, picture = tmp_path / "plan.json", tmp_path / "plan.csv", tmp_path / "plan.png"
    args = ["--samples", "1400", "--band", "0.25:25", "--against", "1:14:0.5"]
    code = run(["design", str(RIG), *args, "--json", str(out), "--csv", str(csv), "--figure", str(picture)])
    assert code == 0
    told = json.loads(out.read_text())
    assert sum(dwell["samples"] for dwell in told["dwells"]) == 1400
    assert set(told["dwells"][0]) >= {"frequency_hz", "samples", "amplitudes", "time_s"}
    assert set(told["predicted"]) == {"m1", "m2", "c1", "c2", "c3", "c4"}
    assert told["gap"] < 1e-6
    assert told["figure"] <= 0.0090
    assert told["against"]["sample_factor"] > 1
    assert csv.read_text().count("\n") == 1 + len(told["dwells"])
    assert picture.read_bytes().startswith(b"\x89PNG")
    shown = capsys.readouterr().out
    assert "0.890 %" in shown
    assert "duality gap" in shown


def test_after_data_with_a_target(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "data.csv"
    given = ["--frequencies", "2,3,4,5,6,8,10,12", "--quiet"]
    assert run(["simulate", str(RIG), *given, "--samples", "56", "--out", str(data)]) == 0
    out, picture = tmp_path / "plan.json", tmp_path / "progress.png"
    args = ["--after", str(data), "--target", "1%", "--for", "worst", "--band", "0.25:25"]
    assert run(["design", str(RIG), *args, "--json", str(out), "--progress", str(picture)]) == 0
    told = json.loads(out.read_text())
    assert told["enough"]["reached"] is False
    assert sum(d["samples"] for d in told["dwells"]) < told["enough"]["more_samples"]
    assert max(p["relative_sd"] for p in told["predicted"].values()) <= 0.01
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "Not enough yet" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("args", "says"),
    [
        ([], "how much test there is"),
        (["--samples", "100", "--time", "1min"], "both --samples and --time"),
        (["--time", "1min"], "sampling rate"),
        (["--time", "soon"], "no time"),
        (["--samples", "1400", "--band", "25:1"], "no band"),
        (["--samples", "1400", "--for", "k9"], "k9 is no unknown"),
        (["--samples", "1400", "--set", "k9=1"], "k9: no unknown"),
        (["--samples", "1400", "--sensors", "three"], "chooses no sensors"),
        (["--samples", "1400", "--sensors", "pick 1 of x9"], "x9 is no channel"),
        (["--samples", "1400", "--against", "a,b"], "neither a frequency nor a file"),
        (["--samples", "1400", "--stroke", "5 kg"], "kg"),
        (["--samples", "1400", "--robust", "worst"], "without a doubt"),
        (["--samples", "1400", "--after", "missing.csv"], "missing.csv"),
        (["--target", "soon"], "no target"),
        (["--target", "c2=x"], "no target"),
        (["--samples", "3"], "holds no test"),
        (["--samples", "1400", "--drive", "v"], "no input"),
    ],
)
def test_faults_are_told_in_one_line(args: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["design", str(RIG), *args]) in (2, 3)
    told = capsys.readouterr()
    assert told.out == ""
    lines = told.err.strip().splitlines()
    assert len(lines) == 1
    assert says in lines[0]
