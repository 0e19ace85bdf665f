"""What was stated with an sd, through the commands: JSON, report, check --known, study, design."""

import json
from pathlib import Path

import pytest

from tests.two_masses import OPEN, one_mass
from tests.unit.app.conftest import Command

RIG = one_mass(
    "f", "value = 2", "guess = 800", "guess = 6",
    {"x": 'noise = 2e-4, gain = { of = "calibrator" }', "f": "noise = 1e-3"},
) + '[calibrations]\ncalibrator = { value = 1.02, sd = "1 %" }\n'  # fmt: skip


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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("true", "kind", "line"), [(1.12, "gain", "value = 1.1"), (-1.02, "sign", "sign = -1")]
)
def test_a_wrong_statement_is_explained_and_its_line_keeps_the_sd(
    dashpot: Command, true: float, kind: str, line: str
) -> None:
    rig = OPEN.replace('m1 = { at = "x1" }', 'm1 = { at = "x1", value = 3 }')
    rig += """[channels]
x1 = { of = "x1", noise = 1e-5, gain = GAIN }
x2 = { of = "x2", noise = 1e-5 }
u = { of = "u", noise = 1e-6 }
F = { of = "u", quantity = "force", noise = 0.1 }
"""
    Path("true.toml").write_text(rig.replace("GAIN", str(true)), encoding="utf-8")
    Path("rig.toml").write_text(rig.replace("GAIN", '{ value = 1.02, sd = "1 %" }'), encoding="utf-8")
    values = ("m2=2.7", "k1=4600", "k2=5000", "c1=20", "c2=30")
    sets = [part for value in values for part in ("--set", value)]
    how = ("--frequencies", "2:12/14", "--samples", "250", "--amplitude", "u=5mm")
    assert dashpot("simulate", "true.toml", *sets, *how, "--out", "data.csv").code == 0
    assert dashpot("identify", "rig.toml", "data.csv", "--json", "out.json").code == 0
    content = json.loads(Path("out.json").read_text(encoding="utf-8"))
    assert content["codes"].count("prior_conflict") == 1
    assert abs(content["pulls"]["x1.gain"]) > 3
    first = content["diagnosis"][0]
    assert (first["kind"], first["of"]) == (kind, ["x1"])
    assert line in first["change"]
    assert "sd = 0.01" in first["change"]
