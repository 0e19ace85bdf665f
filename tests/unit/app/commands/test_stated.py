"""What was stated with an sd, through the commands: JSON, report, check --known, study, design."""

import json
from pathlib import Path

import pytest

from tests.unit.app.conftest import Command

RIG = """
coordinates = ["x"]
[inputs]
f = { kind = "force", at = "x" }
[masses]
m = { at = "x", value = 2 }
[springs]
k = { between = ["x", "ground"], guess = 800 }
[dampers]
c = { between = ["x", "ground"], guess = 6 }
[calibrations]
calibrator = { value = 1.02, sd = "1 %" }
[channels]
x = { of = "x", noise = 2e-4, gain = { of = "calibrator" } }
f = { of = "f", noise = 1e-3 }
"""


@pytest.fixture
def stated(dashpot: Command) -> Command:
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    assert (
        dashpot(
            "simulate", "rig.toml", "--frequencies", "1:6/12", "--samples", "100", "--out", "data.csv"
        ).code
        == 0
    )
    return dashpot


def test_json_report_and_check(stated: Command) -> None:
    done = stated("identify", "rig.toml", "data.csv", "--json", "out.json", "--report", "report.html")
    assert done.code == 0
    assert "calibrator" in done.out
    content = json.loads(Path("out.json").read_text(encoding="utf-8"))
    assert content["parameters"]["calibrator"]["unit"] == "1"
    assert content["stated"] == [["calibrator", 1.02, pytest.approx(0.0102)]]
    assert abs(content["pulls"]["calibrator"]) < 4
    assert {cost["on"] for cost in content["impacts"]} == {"k", "c"}
    page = Path("report.html").read_text(encoding="utf-8")
    assert "calibrator → k" in page
    assert "pull" in page
    done = stated("check", "rig.toml", "data.csv", "--known")
    assert done.code == 0
    assert "pull" in done.out


def test_design_and_study_know_the_calibration_as_well_as_it_is_stated(stated: Command) -> None:
    predicted = {}
    for gain in ("1.02", '{ of = "calibrator" }', '"unknown"'):
        text = RIG.replace('gain = { of = "calibrator" }', f"gain = {gain}")
        if "of" not in gain:
            text = text.replace('[calibrations]\ncalibrator = { value = 1.02, sd = "1 %" }\n', "")
        Path("one.toml").write_text(text, encoding="utf-8")
        done = stated("design", "one.toml", "--samples", "400", "--settle", "0s", "--json", "plan.json")
        assert done.code == 0, done.err
        predicted[gain] = json.loads(Path("plan.json").read_text(encoding="utf-8"))["predicted"]
    exact, known, unknown = (each["k"]["sd"] for each in predicted.values())
    assert exact < known < unknown
    assert predicted['{ of = "calibrator" }']["calibrator"]["sd"] < 0.0101
