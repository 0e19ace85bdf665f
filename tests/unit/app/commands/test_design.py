"""The command `dashpot design` from the outside: contract of the JSON, files, one line for each fault."""

import importlib.util
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dashpot.app.cli import run
from tests.two_masses import one_mass

RIG = Path(__file__).parents[4] / "examples" / "06_design" / "rig.toml"


def printed(capsys: pytest.CaptureFixture[str]) -> str:
    """What the command prints, in 80 columns."""
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert sum("N·s/m" in line for line in shown.splitlines()) == 4
    return shown


@pytest.mark.slow
def test_contract_of_the_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
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
    assert csv.read_text().startswith("dwell,frequency_hz,u_amplitude_m,settle_s,")
    assert picture.read_bytes().startswith(b"\x89PNG")
    shown = printed(capsys)
    assert "0.890 %" in shown
    assert "duality gap" in shown


@pytest.mark.slow
def test_after_data_with_a_target(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The widest table: with what is known now and with another test beside."""
    monkeypatch.setenv("COLUMNS", "80")
    data = tmp_path / "data.csv"
    given = ["--frequencies", "2,3,4,5,6,8,10,12", "--quiet"]
    assert run(["simulate", str(RIG), *given, "--samples", "56", "--out", str(data)]) == 0
    out, picture = tmp_path / "plan.json", tmp_path / "progress.png"
    args = f"--after {data} --target 1% --for worst --band 0.25:25 --against 1:14:1".split()
    assert run(["design", str(RIG), *args, "--json", str(out), "--progress", str(picture)]) == 0
    told = json.loads(out.read_text())
    assert told["enough"]["reached"] is False
    assert sum(d["samples"] for d in told["dwells"]) < told["enough"]["more_samples"]
    assert max(p["relative_sd"] for p in told["predicted"].values()) <= 0.01
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "Target not reached" in printed(capsys)


def told(capsys: pytest.CaptureFixture[str], *args: str) -> dict[str, Any]:
    """The JSON that the command prints."""
    assert run(["design", str(RIG), *args, "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_test_of_so_much_time_within_limits(capsys: pytest.CaptureFixture[str]) -> None:
    limits = "--stroke 5mm --max-velocity 0.1m/s --max-acceleration 1gn --max-force 30N --max-frequencies 3"
    args = f"--time 1min --rate 200 --settling-time 1.5s --min-dwell 4s {limits}".split()
    found = told(capsys, *args, "--grid", "0.5", "--band", "0.5:25", "--for", "c2,m1")
    assert 55 < found["time_s"] <= 60
    assert len(found["dwells"]) <= 3
    for dwell in found["dwells"]:
        assert dwell["frequency_hz"] % 0.5 == 0
        assert dwell["settle_s"] == 1.5
        assert dwell["time_s"] >= 4
        assert dwell["periods"] == pytest.approx(dwell["time_s"] * dwell["frequency_hz"])
        w, u = 2 * np.pi * dwell["frequency_hz"], dwell["amplitudes"]["u"]
        assert max(u / 0.005, w * u / 0.1, w**2 * u / 9.80665) <= 1
    assert told(capsys, *args, "--grid", "0.5", "--band", "0.5:25")["figure"] > 0


@pytest.mark.slow
def test_targets_amplitudes_noise_and_values(capsys: pytest.CaptureFixture[str]) -> None:
    band = ["--band", "0.25:25"]
    both = told(capsys, "--target", "c2=2%,m1=1%", *band)["predicted"]
    assert both["c2"]["relative_sd"] <= 0.02
    assert both["m1"]["relative_sd"] <= 0.01
    assert max(both["c2"]["relative_sd"] / 0.02, both["m1"]["relative_sd"] / 0.01) > 0.99
    usual = told(capsys, "--samples", "1400", *band)
    half = told(capsys, "--samples", "1400", "--relative-noise", "5%", "--amplitude", "3mm", *band)
    assert half["figure"] == pytest.approx(usual["figure"] / 2)
    assert half["dwells"][0]["amplitudes"]["u"] == pytest.approx(0.003)
    other = told(capsys, "--samples", "1400", "--set", "m1=6", "--drive", "-u", *band)
    assert other["predicted"]["m1"]["value"] == 6
    assert other["dwells"][0]["amplitudes"]["u"] == pytest.approx(-0.01)  # of shakers, where nothing is said
    worst = told(capsys, "--samples", "1400", "--for", "worst", *band)
    assert max(p["relative_sd"] for p in worst["predicted"].values()) < max(
        p["relative_sd"] for p in usual["predicted"].values()
    )
    assert told(capsys, "--samples", "1400", "--for", "volume", *band)["gap"] < 1e-6


REACTION = one_mass(
    "u", "guess = 2.0", "guess = 3000", "guess = 12", {"x": "", "F": 'of = "u", quantity = "force"', "u": ""}
)


@pytest.mark.slow
def test_a_reaction_force_is_a_sensor_like_any_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It gets the noise of the outputs, stated or assumed, and may be chosen; the input's own channel stays exact."""
    rig = tmp_path / "rig.toml"
    rig.write_text(REACTION, encoding="utf-8")
    figures = []
    for more in (["--relative-noise", "5%"], [], ["--sensors", "pick 1"]):
        assert run(["design", str(rig), "--samples", "400", *more, "--json", "-"]) == 0
        figures.append(json.loads(capsys.readouterr().out))
    assert figures[0]["figure"] == pytest.approx(5 * figures[1]["figure"])
    ranking = [entry["sensors"] for entry in figures[2]["sensors"]["ranking"]]
    assert ranking == [["F"]]  # x alone knows the ratios of the parameters only


@pytest.mark.slow
def test_doubt_estimates_and_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A box; the covariance of --estimate (not counted), of --after EST.json and of --after DATA (both counted)."""
    data, estimate = str(tmp_path / "data.csv"), str(tmp_path / "estimate.json")
    given = ["--frequencies", "2,3,4,5,6,8,10,12", "--samples", "56", "--seed", "4", "--quiet"]
    assert run(["simulate", str(RIG), *given, "--out", data]) == 0
    assert run(["identify", str(RIG), data, "--json", estimate, "--quiet"]) == 0
    budget = ["--samples", "700", "--band", "0.25:25"]
    plain = told(capsys, *budget)
    box = told(capsys, *budget, "--doubt", "30%")
    assert box["worst_case"] > box["predicted"]["m1"]["relative_sd"]
    assert box["figure"] > plain["figure"]
    mean = told(capsys, *budget, "--doubt", "30%", "--robust", "average")
    assert plain["figure"] < mean["figure"] < box["figure"]
    beside = told(capsys, *budget, "--estimate", estimate, "--robust", "average")
    counted = told(capsys, *budget, "--after", estimate, "--robust", "worst")
    again = told(capsys, *budget, "--after", data, "--robust", "worst", "--target", "1%")
    assert counted["figure"] < 0.9 * beside["figure"]
    assert again["figure"] == pytest.approx(counted["figure"], rel=1e-3)
    assert again["enough"]["reached"] is False
    assert again["enough"]["more_samples"] > 700
    steps = again["so_far"]
    assert steps["samples"][-1] == 448
    assert steps["relative_sd"]["m1"][-1] < 0.05
    assert len(steps["relative_sd"]["m1"]) == len(steps["samples"])


@pytest.mark.slow
def test_data_with_unknown_calibrations_and_a_floor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A gain that is unknown is not a parameter to plan for; the drive is as in the data, which says so."""
    rig = tmp_path / "rig.toml"
    text = RIG.read_text().replace("relative_noise = 0.1 }", "noise = 1e-5 }")
    rig.write_text(text.replace('"velocity", noise = 1e-5', '"velocity", noise = 1e-4, gain = "unknown"'))
    data = str(tmp_path / "data.csv")
    given = ["--frequencies", "3,6,9,12", "--samples", "112", "--amplitude", "u=0.002", "--quiet"]
    assert run(["simulate", str(rig), *given, "--out", data]) == 0
    args = ["--samples", "700", "--band", "0.25:25", "--target", "0.01%", "--after", data, "--json", "-"]
    assert run(["design", str(rig), *args]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found["so_far"]["relative_sd"]) == {"m1", "m2", "c1", "c2", "c3", "c4"}
    assert found["so_far"]["relative_sd"]["m1"][-1] < 0.01
    assert "v1.gain" in found["predicted"]
    assert found["enough"]["more_samples"] > 0
    assert found["dwells"][0]["amplitudes"]["u"] == pytest.approx(0.002, rel=1e-3)
    assert any("0.002 m is the median of the data's" in note for note in found["notes"])
    assert run(["design", str(rig), "--samples", "700", "--amplitude", "2mm"]) == 0
    assert "Note: the noise" not in capsys.readouterr().out


@pytest.mark.slow
def test_a_model_that_does_not_fit_is_said_not_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "data.csv"
    given = ["--frequencies", "2,3,4,5,6,8,10,12", "--samples", "5000", "--quiet"]
    assert run(["simulate", str(RIG), *given, "--out", str(data)]) == 0
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.read_text().replace('"u"], value = 4600', '"u"], value = 3000'))
    args = ["--samples", "700", "--band", "0.25:25", "--target", "0.1%", "--after", str(data), "--json", "-"]
    assert run(["design", str(rig), *args]) == 0
    found = json.loads(capsys.readouterr().out)
    assert any("the model does not fit the earlier data" in note for note in found["notes"])
    assert found["enough"]["more_samples"] is None
    assert "does not fit" in found["enough"]["reason"]


def test_against_a_file_and_against_too_little(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The lines of a file count with their own shares of the samples; what determines nothing is said to."""
    data = str(tmp_path / "data.csv")
    given = ["--frequencies", "2,4,6,8,10,12", "--samples", "40", "--quiet"]
    assert run(["simulate", str(RIG), *given, "--out", data]) == 0
    budget = ["--samples", "1400", "--band", "0.25:25"]
    file, listed = (told(capsys, *budget, "--against", what)["against"] for what in (data, "2:12:2"))
    assert file == listed
    assert file["sample_factor_iv"] > file["sample_factor"] > 1
    lonely = told(capsys, *budget, "--against", "5")
    assert "against" not in lonely
    assert any("does not determine" in note for note in lonely["notes"])


@pytest.mark.slow
def test_sensors_are_chosen(capsys: pytest.CaptureFixture[str]) -> None:
    found = told(capsys, "--samples", "1400", "--band", "0.25:25", "--sensors", "pick 2 of x1,v1,x2")
    assert "x2" in found["sensors"]["best"]
    assert len(found["sensors"]["best"]) == 2
    assert [entry["figure"] for entry in found["sensors"]["ranking"]] == sorted(
        entry["figure"] for entry in found["sensors"]["ranking"]
    )


@pytest.mark.parametrize(
    ("args", "says"),
    [
        ([], "neither a budget"),
        (["--samples", "1400", "--set", "m1=nan"], "'nan' is not a quantity"),
        (["--samples", "1400", "--set", "m1=-3"], "a mass of -3 kg"),
        (["--samples", "1400", "--band", "100:200", "--rate", "250"], "too near half"),
        (["--samples", "1400", "--doubt", "120%"], "between 0 and 100 %"),
        (["--samples", "1400", "--grid", "40", "--band", "1:25"], "no multiple of 40"),
        (["--time", "1min", "--rate", "200", "--settling-time", "2min"], "settling alone"),
        (["--target", "1e-12"], "more than 1e+09 samples"),
        (["--samples", "1400", "--against", "5,nan"], "'nan' is not a frequency"),
        (["--samples", "1400", "--max-force", "0N"], "'0N' is out"),
        (["--samples", "1400", "--progress", "p.png"], "--after DATA"),
        (["--target", "c2=2%", "--for", "worst"], "--for and a --target"),
        (["--samples", "100", "--time", "1min"], "both --samples and --time"),
        (["--time", "1min"], "sampling rate"),
        (["--time", "soon"], "'soon' is not a quantity"),
        (["--samples", "1400", "--band", "25:1"], "'25:1' is not a band"),
        (["--samples", "1400", "--for", "k9"], "'k9' is not an unknown"),
        (["--samples", "1400", "--set", "k9=1"], "'k9' is not an unknown"),
        (["--samples", "1400", "--sensors", "three"], "is not a choice"),
        (["--samples", "1400", "--sensors", "pick 1 of x9"], "no channel x9"),
        (["--samples", "1400", "--against", "a,b"], "or name a file"),
        (["--samples", "1400", "--stroke", "5 kg"], "kg"),
        (["--samples", "1400", "--robust", "worst"], "--robust needs"),
        (["--samples", "1400", "--dask", "local"], "--dask is for the search"),
        (
            ["--samples", "1400", "--doubt", "9%", "--robust", "average", "--workers", "2"],
            "--workers is for the search",
        ),
        (["--samples", "1400", "--after", "missing.csv"], "missing.csv"),
        (["--target", "soon"], "not a share"),
        (["--target", "c2=x"], "not a share"),
        (["--samples", "3"], "no test within"),
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


@pytest.mark.long
def test_a_robust_design_is_the_same_to_the_bit_on_workers_and_a_cluster(tmp_path: Path) -> None:
    args = ["design", str(RIG), "--samples", "1400", "--robust", "worst", "--doubt", "30%", "-q"]
    shared: dict[str, list[str]] = {"one": [], "two": ["--workers", "2"]}
    if importlib.util.find_spec("distributed") is not None:
        shared["cluster"] = ["--workers", "2", "--dask", "local"]
    for name, options in shared.items():
        assert run([*args, *options, "--json", str(tmp_path / f"{name}.json")]) == 0
        assert (tmp_path / f"{name}.json").read_bytes() == (tmp_path / "one.json").read_bytes()
