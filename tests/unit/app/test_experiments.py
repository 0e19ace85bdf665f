"""Commands on a rig file whose experiments differ."""

import json
from pathlib import Path

import pytest

from tests.two_masses import OPEN
from tests.unit.app.conftest import Command

RIG = (
    OPEN
    + """\
[channels]
x1 = { of = "x1", unit = "mm" }
x2 = { of = "x2", unit = "mm" }
u = { of = "u", unit = "mm" }
[experiments.added]
data = "added*.csv"
masses.extra = { at = "x1", value = 0.5 }
c1 = "own"
x1.gain = { value = 1, sd = "1 %" }
"""
)
VALUES = "m1=2,m2=3,k1=4000,k2=9000,c2=20"
TEST = "--frequencies 2:16:1 --samples 100 --relative-noise 1%"


@pytest.fixture
def measured(dashpot: Command) -> Command:
    """The command line where bare.csv and added.csv are data of the rig."""
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    bare = dashpot(f"simulate rig.toml --set {VALUES},c1=12 {TEST} --seed 1 -o bare.csv")
    added = dashpot(
        f"simulate rig.toml --experiment added --set {VALUES},c1@added=15 {TEST} --seed 2 -o added.csv"
    )
    assert (bare.code, added.code) == (0, 0), (bare.err, added.err)
    return dashpot


@pytest.mark.slow
def test_data_of_all_give_one_estimate(measured: Command) -> None:
    told = measured("identify rig.toml bare.csv added.csv --json e.json --report r.html -q")
    assert told.code == 0, told.err
    found = json.loads(Path("e.json").read_text())
    assert found["fit"]["verdict"] == "fits"
    truth = {"m1": 2, "k1": 4000, "c1": 12, "c1@added": 15}
    for name, value in truth.items():
        assert abs(found["parameters"][name]["value"] - value) < 5 * found["parameters"][name]["sd"], name
    assert found["parameters"]["extra"]["known"]
    page = Path("r.html").read_text()
    assert "x1@added" in page
    assert "x2@added" in page  # its response in that experiment, with a curve of its own
    for rest in ("bare.csv added.csv --known", ""):
        assert measured(f"check rig.toml {rest}").code == 0
    assert measured("validate e.json added.csv").code == 0
    for experiment in ("", "--experiment added"):
        assert measured(f"export e.json {experiment} -o out.json -q").code == 0
        assert measured(f"draw rig.toml {experiment} -o rig.svg").code == 0
        assert ("c1@added" in Path("rig.svg").read_text()) == bool(experiment)
    plan = measured(
        "design rig.toml --experiment added --after bare.csv --after added.csv --band 2:16 --samples 500"
    )
    assert plan.code == 0, plan.err


@pytest.mark.long
def test_a_mistake_in_one_of_them_is_mended_in_its_section(measured: Command) -> None:
    text = Path("added.csv").read_text().splitlines()
    head, rows = text[0], [row.split(",") for row in text[1:]]
    at = head.split(",").index("x1")
    turned = [",".join([*row[:at], str(-float(row[at])), *row[at + 1 :]]) for row in rows]
    Path("added.csv").write_text("\n".join([head, *turned]) + "\n")
    told = measured("identify rig.toml bare.csv added.csv --apply new.toml --json e.json -q")
    assert told.code == 0, told.err
    (first, *_) = json.loads(Path("e.json").read_text())["diagnosis"]
    assert (first["kind"], first["of"]) == ("sign", ["x1@added"])
    assert first["change"].startswith("[experiments.added] x1 = ")
    again = measured("identify new.toml bare.csv added.csv --json again.json -q")
    assert again.code == 0
    assert json.loads(Path("again.json").read_text())["fit"]["verdict"] == "fits"


def test_what_knows_no_experiments_says_so(measured: Command) -> None:
    for line in (
        "identify rig.toml bare.csv added.csv --in-parts",
        "compare rig.toml bare.csv added.csv --elements",
        "fleet rig.toml bare.csv -o f.parquet",
    ):
        told = measured(line)
        assert (told.code, len(told.err)) == (2, 1), line
        assert "experiments" in told.err[0]
    assert "did you mean" in measured("draw rig.toml --experiment addde -o rig.svg").err[0]
    missing = measured("identify rig.toml bare.csv")
    assert missing.code == 2
    assert "added*.csv" in missing.err[-1]


@pytest.mark.slow
def test_a_spring_changed_between_two_runs_is_mended_by_what_is_said(dashpot: Command) -> None:
    alone = RIG.partition("[experiments")[0].replace('m1 = { at = "x1" }', 'm1 = { at = "x1", value = 2 }')
    Path("rig.toml").write_text(alone, encoding="utf-8")
    for name, k1 in (("first", 4000), ("second", 4400)):
        values = f"m2=3,k1={k1},k2=9000,c1=12,c2=20"
        assert dashpot(f"simulate rig.toml --set {values} {TEST} --seed {k1} -o {name}.csv").code == 0
    assert dashpot("identify rig.toml first.csv second.csv --json e.json -q").code == 0
    (cause, *_) = json.loads(Path("e.json").read_text())["diagnosis"]
    assert cause["kind"] == "changed"
    assert 'k1 = "own"' in cause["change"]
    told = '[experiments.other]\ndata = "second.csv"\nk1 = "own"\n'
    Path("rig.toml").write_text(alone + told, encoding="utf-8")
    assert dashpot("identify rig.toml first.csv second.csv --json e.json -q").code == 0
    found = json.loads(Path("e.json").read_text())
    assert found["fit"]["verdict"] == "fits"
    assert abs(found["parameters"]["k1@other"]["value"] - 4400) < 5 * found["parameters"]["k1@other"]["sd"]
