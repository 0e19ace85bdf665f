"""identify and validate with whole records of nonlinear rigs."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from dashpot import read_rig
from tests.two_masses import one_mass
from tests.unit.app.conftest import Command

RIG = one_mass("f", of={"f": 'quantity = "force"', "x": ""}, q='law = "cubic"')
NOISE = 2e-5  # m


def recorded(path: str, seed: int) -> None:
    """180 samples of a mass on a hardening spring, pushed, by SciPy's integrator."""
    rng = np.random.default_rng(seed)
    time = np.arange(180) / 60
    tones, phases = rng.uniform(0.5, 4, 20), rng.uniform(0, 6.3, 20)
    force = CubicSpline(time, 3 * np.sum(np.cos(2 * np.pi * tones * time[:, None] + phases), axis=1))

    def rates(t: float, s: list[float]) -> list[float]:
        return [s[1], (force(t) - 800 * s[0] - 4 * s[1] - 2e6 * s[0] ** 3) / 2]

    x = solve_ivp(rates, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, atol=1e-10).y[0]
    x += NOISE * rng.standard_normal(len(time))
    np.savetxt(path, np.column_stack([time, force(time), x]), "%.9g", ",", header="time_s,f,x", comments="")


def turn(path: str, channel: str) -> None:
    """Write the file with one channel times −1."""
    header, *rows = Path(path).read_text(encoding="utf-8").splitlines()
    place = header.split(",").index(channel)
    cells = [row.split(",") for row in rows]
    turned = [",".join([*c[:place], str(-float(c[place])), *c[place + 1 :]]) for c in cells]
    Path(path).write_text("\n".join([header, *turned]) + "\n", encoding="utf-8")


@pytest.mark.slow
def test_an_estimate_predicts_another_record_or_the_end_of_its_own_to_the_noise(dashpot: Command) -> None:
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    recorded("run.csv", 1)
    recorded("other.csv", 2)
    done = dashpot("identify", "rig.toml", "run.csv", "--json", "whole.json", "--figure", "fit.svg")
    assert done.code == 0
    assert "predicted" in Path("fit.svg").read_text(encoding="utf-8")
    sent = ["--json", "v.json", "--figure", "v.svg"]  # the estimate names its rig file
    done = dashpot("validate", "whole.json", "other.csv", *sent)
    assert done.code == 0
    assert "rms error" in done.out
    assert Path("v.svg").stat().st_size > 0
    (record,) = json.loads(Path("v.json").read_text(encoding="utf-8"))["records"]
    assert record["samples"] == 180
    assert record["channels"]["x"]["rms_error"] == pytest.approx(NOISE, rel=0.2)
    fit = json.loads(Path("whole.json").read_text(encoding="utf-8"))["fit"]
    assert fit["verdict"] == "cannot tell"  # the noise is that of the residuals
    assert fit["relative_residual"]["x"] == pytest.approx(
        1 - record["channels"]["x"]["fit_percent"] / 100, rel=0.1
    )
    assert [line["channel"] for line in fit["worst"]] == ["x"]
    held = dashpot("identify", "rig.toml", "run.csv", "--hold-out", "40%", "--json", "part.json")
    assert held.code == 0
    assert "(1.2 s)" in held.out
    whole, part = (json.loads(Path(name).read_text(encoding="utf-8")) for name in ("whole.json", "part.json"))
    assert part["parameters"]["k"]["value"] != whole["parameters"]["k"]["value"]


def test_apply_writes_the_rig_that_contradicting_channels_ask_for(dashpot: Command) -> None:
    """Where one mistake of a channel stops the identification, its line is written all the same."""
    recorded("run.csv", 1)
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    turn("run.csv", "x")
    done = dashpot("identify", "rig.toml", "run.csv", "-q", "--apply", "new.toml")
    assert done.code == 2
    assert done.err[-1].endswith("new.toml was written with the first cause corrected; identify with it")
    assert [channel.sign for channel in read_rig("new.toml").channels] == [1.0, -1.0]


@pytest.mark.slow
def test_validate_names_a_channel_that_is_turned(dashpot: Command) -> None:
    recorded("run.csv", 1)
    recorded("other.csv", 2)
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    assert dashpot("identify", "rig.toml", "run.csv", "-q", "--json", "e.json").code == 0
    turn("other.csv", "f")
    done = dashpot("validate", "e.json", "other.csv", "--json", "v.json", "--report", "v.html")
    causes = json.loads(Path("v.json").read_text(encoding="utf-8"))["diagnosis"]
    assert ["sign", ["f"]] in [[cause["kind"], cause["of"]] for cause in causes[:2]]
    assert "multiply f by −1 in the data" in " ".join(done.out.split())
    assert "multiply f by −1 in the data" in Path("v.html").read_text(encoding="utf-8")
