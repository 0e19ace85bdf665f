"""Records of any excitation from the command line: whole by default, several, with noise from a record at rest."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from dashpot import identify, read
from dashpot.data.readers import write_records
from dashpot.data.record import Record
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.observation import observation_model
from dashpot.model.rigfile import read_rig
from tests import two_masses
from tests.two_masses import one_mass
from tests.unit.app.conftest import Command

RIG = two_masses.RIG.replace(", value = 4600", "").replace(", noise = 0.02", "")
TRUE = {"m1": 3.0, "k1": 4600.0, "k2": 4600.0, "c1": 20.0, "c2": 30.0}
NOISE = 3e-5  # m, of x1 and x2: a twentieth of their motion


def recorded(
    path: str, *, seed: int = 0, seconds: float = 10.0, driven: bool = True, skip: slice | None = None
) -> None:
    """A record at 100 Hz of a base in aperiodic motion, the rig moving when it starts."""
    rng = np.random.default_rng(seed)
    rig = read_rig("rig.toml")
    p = rig.model.parameters(np.array([TRUE[unknown.name] for unknown in rig.model.unknowns]))
    fine = np.arange(int(seconds * 100) * 8) / 800
    f = rng.uniform(0.3, 15, 80)
    base = 2e-4 * np.sum(np.cos(2 * np.pi * f[:, None] * fine + rng.uniform(0, 6, 80)[:, None]), axis=0)
    motion = integrator(rig.model, p, 1 / 800).motion(
        base[:, None], rng.normal(size=4) * [1e-3, 1e-3, 0.02, 0.02]
    )
    values = channel_samples(observation_model(rig.model, rig.channels, np.ones(1)), p, motion)[::8]
    noise = rng.normal(size=values.shape) * NOISE * [1, 1, 1e-3]
    values = values * driven + noise
    record = Record(rig.channels, fine[::8], values)
    if skip is not None:
        keep = np.delete(np.arange(len(values)), skip)
        record = Record(rig.channels, record.time[keep], values[keep])
    write_records([record], path)


@pytest.fixture
def rig(dashpot: Command) -> str:
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    return "rig.toml"


def away(path: str = "e.json") -> float:
    """The largest distance from the truth in standard deviations."""
    found = json.loads(Path(path).read_text(encoding="utf-8"))["parameters"]
    return max(abs(found[name]["value"] - true) / found[name]["sd"] for name, true in TRUE.items())


@pytest.mark.slow
def test_a_record_is_used_whole(dashpot: Command, rig: str) -> None:
    recorded("run.csv", seed=1)
    done = dashpot("identify", rig, "run.csv", "--json", "e.json", "--report", "e.html", "--verbose")
    assert done.code == 0
    assert len(done.err) == 1
    assert "1 continuous record" in done.err[0]
    assert away() < 3.7  # one in a thousand for five unknowns
    written = json.loads(Path("e.json").read_text(encoding="utf-8"))
    assert written["fit"]["verdict"] == "fits"
    (exact,) = [note for note in written["notes"] if "no noise detected in u" in note]
    said = f"{exact[0].upper()}{exact[1:]}"
    assert f"{said}." in " ".join(done.out.split())
    assert said in " ".join(Path("e.html").read_text(encoding="utf-8").split())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("missing", "gap"), [(50, "50 samples missing before 9.5 s"), (1, "1 sample missing before 9.01 s")]
)
def test_several_records_and_one_with_a_gap(dashpot: Command, rig: str, missing: int, gap: str) -> None:
    recorded("a.csv", seed=2)
    recorded("b.csv", seed=3, seconds=20, skip=slice(900, 900 + missing))
    done = dashpot("identify", rig, "a.csv", "b.csv", "--json", "e.json", "--band", "0.3:20")
    assert done.code == 0
    assert any(gap in line for line in done.err)
    assert any("2 continuous records" in line for line in done.err)
    assert json.loads(Path("e.json").read_text(encoding="utf-8"))["fit"]["verdict"] == "fits"
    assert away() < 3.7


def test_the_noise_of_a_record_at_rest_tests_the_fit(dashpot: Command, rig: str) -> None:
    recorded("run.csv", seed=4)
    recorded("still.csv", seed=5, driven=False)
    done = dashpot("identify", rig, "run.csv", "--noise-record", "still.csv", "--json", "e.json")
    assert done.code == 0
    assert "The model fits" in " ".join(done.out.split())
    assert away() < 3.7


def test_a_table_of_lines_carries_the_loads(dashpot: Command, rig: str) -> None:
    recorded("run.csv", seed=6)
    assert dashpot("spectrum", rig, "run.csv", "-o", "lines.csv").code == 0
    with Path("lines.csv").open(encoding="utf-8") as file:
        first = next(csv.DictReader(file))
    assert first["record_duration_s"] == "10.0"
    assert first["record_loads"] == "1"
    for source, target in (("run.csv", "e.json"), ("lines.csv", "again.json")):
        assert dashpot("identify", rig, source, "--json", target).code == 0
    values = [
        json.loads(Path(name).read_text(encoding="utf-8"))["parameters"] for name in ("e.json", "again.json")
    ]
    for name in TRUE:
        assert values[1][name]["value"] == pytest.approx(
            values[0][name]["value"], abs=0.03 * values[0][name]["sd"]
        )


def bad(dashpot: Command, rig: str, *arguments: str) -> str:
    done = dashpot("identify", rig, *arguments)
    assert done.code == 2
    assert done.out == ""
    assert sum(not line.startswith("note: ") for line in done.err) == 1
    return done.err[-1]


def test_what_cannot_be_used_is_named(dashpot: Command, rig: str) -> None:
    recorded("run.csv", seed=7)
    assert "no line of the record lies between" in bad(dashpot, rig, "run.csv", "--band", "60:70")
    assert "oiv needs settled dwells" in bad(dashpot, rig, "run.csv", "--method", "oiv")
    rows = Path("run.csv").read_text(encoding="utf-8").splitlines()
    slipped = [rows[0]]
    for k, row in enumerate(rows[1:]):
        time, rest = row.split(",", 1)
        slipped.append(f"{float(time) + 0.003 * (k > 700) + 0.002 * np.sin(k / 300):.6f},{rest}")
    Path("slipped.csv").write_text("\n".join(slipped) + "\n", encoding="utf-8")
    assert "not evenly spaced" in bad(dashpot, rig, "slipped.csv")
    still = [rows[0], *(row.rsplit(",", 1)[0] + ",0" for row in rows[1:])]
    Path("still_base.csv").write_text("\n".join(still) + "\n", encoding="utf-8")
    assert "u stays at 0 throughout" in bad(dashpot, rig, "still_base.csv")
    Path("short.csv").write_text("\n".join(rows[:12]) + "\n", encoding="utf-8")
    assert "a record of 11 samples" in bad(dashpot, rig, "short.csv")
    Path("brief.csv").write_text("\n".join(rows[:25]) + "\n", encoding="utf-8")
    assert "2 lines in the band: 8 real equations for 12 " in bad(dashpot, rig, "brief.csv", "--band", "4:9")


@pytest.mark.slow
def test_an_estimate_predicts_another_record(dashpot: Command, rig: str) -> None:
    recorded("run.csv", seed=8)
    recorded("other.csv", seed=9)
    assert dashpot("identify", rig, "run.csv", "--json", "e.json").code == 0
    recorded("still.csv", seed=13, driven=False)
    sent = ["--noise-record", "still.csv", "--json", "v.json", "--picture", "v.svg"]
    done = dashpot("validate", "e.json", "other.csv", *sent)
    assert done.code == 0
    assert "FIT, %" in done.out
    assert Path("v.svg").read_text(encoding="utf-8").startswith("<?xml")
    (record,) = json.loads(Path("v.json").read_text(encoding="utf-8"))["records"]
    values = np.loadtxt("other.csv", delimiter=",", skiprows=1)
    for c, name in enumerate(("x1", "x2"), start=1):
        # The noise of all samples is more than that of the lines in the band; no estimate predicts either.
        noise = NOISE * 1e3 / np.std(values[:, c])
        assert 100 * (1 - noise) < record["channels"][name]["fit_percent"] < 100 * (1 - 0.4 * noise)
        assert record["channels"][name]["chi2"] / record["channels"][name]["dof"] == pytest.approx(
            1, abs=0.25
        )


def test_a_wrong_rig_predicts_badly(dashpot: Command, rig: str) -> None:
    recorded("run.csv", seed=10)
    assert dashpot("identify", rig, "run.csv", "--json", "e.json").code == 0
    found = json.loads(Path("e.json").read_text(encoding="utf-8"))
    found["parameters"]["k1"]["value"] *= 1.05
    Path("wrong.json").write_text(json.dumps(found), encoding="utf-8")
    fits = []
    for name in ("e.json", "wrong.json"):
        assert dashpot("validate", name, "run.csv", "--json", "v.json").code == 0
        (record,) = json.loads(Path("v.json").read_text(encoding="utf-8"))["records"]
        fits.append(record["channels"]["x1"]["fit_percent"])
    assert fits[1] < fits[0] - 3


def test_the_end_of_a_record_is_held_out(dashpot: Command, rig: str) -> None:
    recorded("run.csv", seed=11)
    done = dashpot("identify", rig, "run.csv", "--hold-out", "25%", "--json", "e.json")
    assert done.code == 0
    assert "1 continuous record" in done.err[0]
    assert "1 (2.5 s)" in done.out
    assert away() < 3.7


def test_free_decay_of_a_rig_that_nothing_drives(dashpot: Command, tmp_path: Path) -> None:
    """All motion is that at the start; one known part fixes the scale, and without it that is said."""
    rig = tmp_path / "decay.toml"
    text = one_mass("", "value = 2", of={})
    rig.write_text(text, encoding="utf-8")
    t = np.arange(0, 6, 0.01)
    rate = np.sqrt(2000 / 2 - 0.75**2)
    x = 0.01 * np.exp(-0.75 * t) * np.cos(rate * t) + 2e-5 * np.random.default_rng(1).standard_normal(t.size)
    rows = "\n".join(f"{a:.6g},{b:.8g}" for a, b in zip(t, x, strict=True))
    (tmp_path / "decay.csv").write_text(f"time_s,x\n{rows}\n", encoding="utf-8")
    done = dashpot("identify", str(rig), str(tmp_path / "decay.csv"), "--json", str(tmp_path / "e.json"))
    assert done.code == 0
    found = json.loads((tmp_path / "e.json").read_text(encoding="utf-8"))["parameters"]
    for name, truth in {"k": 2000, "c": 3}.items():
        assert abs(found[name]["value"] - truth) < 4 * found[name]["sd"] < 0.02 * truth
    rig.write_text(text.replace(", value = 2", ""), encoding="utf-8")
    done = dashpot("identify", str(rig), str(tmp_path / "decay.csv"))
    assert done.code == 3
    assert "scale of the forces" in done.err[0]


@pytest.mark.slow
def test_a_response_that_something_unseen_drives_is_no_free_decay(dashpot: Command, rig: str) -> None:
    recorded("run.csv", seed=14)
    rows = [row.rsplit(",", 1)[0] for row in Path("run.csv").read_text(encoding="utf-8").splitlines()]
    Path("ambient.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    held = RIG.replace('u = { kind = "displacement" }\n', "").replace('u = { of = "u", unit = "mm" }\n', "")
    Path("held.toml").write_text(held.replace("[inputs]\n", "").replace('"u"', '"ground"'), encoding="utf-8")
    said = bad(dashpot, "held.toml", "ambient.csv")
    assert "no free decay" in said
    assert "record what drives it" in said


@pytest.mark.slow
def test_sensors_that_drift(dashpot: Command, rig: str) -> None:
    """A ramp ten times the motion in each output costs nothing, unless it is said that there is none."""
    recorded("run.csv", seed=16, seconds=6.0)
    with Path("run.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for k, row in enumerate(rows):
        row["x1"] = repr(float(row["x1"]) + 16e-3 * k)
        row["x2"] = repr(float(row["x2"]) - 10e-3 * k)
    with Path("drift.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    for name in ("run", "drift"):
        assert dashpot("identify", rig, f"{name}.csv", "--json", f"{name}.json").code == 0
    clean, drifting = (
        json.loads(Path(f"{name}.json").read_text(encoding="utf-8"))["parameters"]
        for name in ("run", "drift")
    )
    for name in TRUE:
        assert drifting[name]["value"] == pytest.approx(clean[name]["value"], abs=0.05 * clean[name]["sd"])
    assert away("drift.json") < 3.7
    assert dashpot("spectrum", rig, "drift.csv", "--drift", "0", "-o", "told.csv").code == 0
    given = read_rig(rig)
    told = identify(given.model, read("told.csv", given.channels).spectrum())
    assert max(abs(told[name].value - true) / told[name].sd for name, true in TRUE.items()) > 3.7
    assert dashpot("spectrum", rig, "drift.csv", "-o", "lines.csv").code == 0
    assert dashpot("identify", rig, "lines.csv", "--json", "again.json").code == 0
    assert away("again.json") < 3.7


@pytest.mark.slow
def test_what_an_estimate_predicts_carries_its_uncertainty(dashpot: Command, rig: str) -> None:
    """The band is the scatter of the predictions of parameters drawn from the estimate: 200 draws tell it to 5 %."""
    recorded("run.csv", seed=17)
    assert dashpot("identify", rig, "run.csv", "--json", "e.json").code == 0
    done = dashpot("simulate", rig, "--estimate", "e.json", "--input", "run.csv", "-o", "predicted.csv")
    assert done.code == 0
    with Path("predicted.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    band = np.array([[float(row["x1_sd"]), float(row["x2_sd"])] for row in rows])
    shown = np.array([[float(row["x1"]), float(row["x2"])] for row in rows])
    assert "u_sd" not in rows[0]
    found = json.loads(Path("e.json").read_text(encoding="utf-8"))
    model = read_rig("rig.toml").model
    mean = np.array([found["parameters"][name]["value"] for name in found["order"]])
    base = np.array([[1e-3 * float(row["u"])] for row in rows])
    rng = np.random.default_rng(3)
    theta = rng.multivariate_normal(mean, np.array(found["covariance"]), 200)
    drawn = np.stack([integrator(model, model.parameters(each), 0.01).motion(base).x for each in theta])
    late = slice(300, None)
    np.testing.assert_allclose(1e-3 * shown[late], np.mean(drawn, axis=0)[late], atol=2e-5)
    ratio = np.sqrt(
        np.mean(np.std(drawn, axis=0)[late] ** 2, axis=0) / np.mean((1e-3 * band[late]) ** 2, axis=0)
    )
    np.testing.assert_allclose(ratio, 1.0, rtol=0.2)
    alike = f"m1={found['parameters']['m1']['value']!r}"
    for name, change in (("same", alike), ("heavier", "m1=100kg")):
        what = ("simulate", rig, "--estimate", "e.json", "--set", change, "--input", "run.csv")
        assert dashpot(*what, "-o", f"{name}.csv").code == 0
    same, heavier = (np.genfromtxt(f"{name}.csv", delimiter=",", names=True) for name in ("same", "heavier"))
    np.testing.assert_allclose(same["x1"], shown[:, 0], rtol=1e-6, atol=1e-9)
    assert np.std(heavier["x1"]) < 0.5 * np.std(same["x1"])
    refused = dashpot(
        "simulate", rig, "--estimate", "e.json", "--set", "zeta=1", "--input", "run.csv", "-o", "no.csv"
    )
    assert refused.code == 2
    refused = dashpot("simulate", rig, "--estimate", "e.json", "--frequencies", "1,2", "-o", "no.csv")
    assert refused.code == 2
    assert "an estimate predicts the response to a record" in refused.err[-1]
