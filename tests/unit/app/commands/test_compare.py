"""dashpot compare: table, picture and JSON of several methods; bad input is one line, exit code 2, nothing written."""

import json
import os
from pathlib import Path

import pytest

from tests.unit.app.conftest import RIG, SET, Command, Ran

TRUTH = "m1=3,c1=20,c2=30"
MODES = "frequency_hz,frequency_sd,damping_ratio,damping_sd,x1_re,x1_im,x1_sd,x2_re,x2_im,x2_sd\n"


def refused(done: Ran, *parts: str, code: int = 2) -> None:
    """One line with a cure, notes on the data aside; all `parts` are in it; neither picture nor JSON was begun."""
    assert done.code == code, (done.out, done.err)
    assert done.out == ""
    errors = [line for line in done.err if not line.startswith("note: ")]
    assert len(errors) == 1, done.err
    (line,) = errors
    assert line.startswith("dashpot: ")
    assert "; " in line, f"no cure in: {line}"
    for part in parts:
        assert part in line, (part, line)
    assert not [name for name in os.listdir() if "out" in name]


def row(done: Ran, method: str) -> str:
    (found,) = [line for line in done.out.splitlines() if line.split(" ")[0] == method]
    return found


def test_table_picture_and_json(dashpot: Command, data: Path) -> None:
    asked = f"--methods hls,oiv,ml --truth {TRUTH}"
    done = dashpot(f"compare rig.toml data.csv {asked} --figure out.png --json out.json")
    assert done.code == 0, done.err
    assert max(map(len, done.out.splitlines())) <= 80
    assert "truth" in done.out
    assert row(done, "oiv").split()[1:] == row(done, "ml").split()[1:]
    assert Path("out.png").read_bytes().startswith(b"\x89PNG")
    content = json.loads(Path("out.json").read_text(encoding="utf-8"))
    assert list(content["methods"]) == ["hls", "oiv", "ml"]
    assert content["truth"] == {"m1": 3.0, "c1": 20.0, "c2": 30.0}
    one = dashpot("identify", "rig.toml", "data.csv", "--method", "oiv", "--json", "-")
    alone, beside = json.loads(one.out), content["methods"]["oiv"]
    assert alone.pop("fit").items() >= beside.pop("fit").items()  # identify adds the verdict
    assert alone.pop("rig") == "rig.toml"
    assert alone.pop("rig_text")
    assert alone.pop("lines")["channels"].keys() == {"x1", "x2", "u"}
    assert alone == beside


def test_all_methods_that_suit_and_why_others_do_not(dashpot: Command, data: Path) -> None:
    """ls reads dampers from velocities, which are not measured: it has no row, but a reason."""
    done = dashpot("compare", "rig.toml", "data.csv")
    assert done.code == 0, done.err
    for method in ("hls", "wls", "tls", "cls", "iv", "oiv", "ml"):
        row(done, method)
    assert "ls: needs the velocity" in done.out
    assert "oiv+" not in done.out  # of use for free matrices, and slower


def test_an_interval_that_misses_is_marked(dashpot: Command, data: Path) -> None:
    done = dashpot("compare", "rig.toml", "data.csv", "--methods", "oiv", "--truth", "m1=4")
    assert done.code == 0
    assert row(done, "oiv").count("*") == 1
    assert "misses the truth" in done.out
    worst = float(row(done, "oiv").split()[-1])
    assert worst == pytest.approx(25, abs=1)
    assert "*" not in dashpot("compare", "rig.toml", "data.csv", "--methods", "oiv", "--truth", TRUTH).out


def modes_file() -> None:
    """The modes of the rig with m1 = 3, c1 = 20, c2 = 30, to 0.1 %."""
    import numpy as np

    M, C = np.diag([3.0, 2.7]), np.array([[20.0, -20.0], [-20.0, 50.0]])
    K = np.array([[4600.0, -4600.0], [-4600.0, 9200.0]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    values, vectors = np.linalg.eig(A)
    text = MODES
    for k in np.flatnonzero(values.imag > 0):
        f, zeta = abs(values[k]) / 2 / np.pi, -values[k].real / abs(values[k])
        a, b = vectors[0, k] / vectors[1, k], 1.0
        text += f"{f},{1e-3 * f},{zeta},{1e-2 * zeta},{a.real},{a.imag},0.002,{b},0,0\n"
    Path("modes.csv").write_text(text, encoding="utf-8")


def test_measured_modes_beside_data_and_alone(dashpot: Command, data: Path) -> None:
    modes_file()
    done = dashpot("compare rig.toml data.csv --modal modes.csv --methods oiv --truth", TRUTH)
    assert done.code == 0, done.err
    assert "*" not in row(done, "modal")
    alone = dashpot("compare", "rig.toml", "--modal", "modes.csv", "--json", "-")
    assert alone.code == 0, alone.err
    found = json.loads(alone.out)["methods"]
    assert list(found) == ["modal"]
    # Exact modes: the truth to what the file says of them.
    for name, value in (("m1", 3.0), ("c1", 20.0), ("c2", 30.0)):
        assert found["modal"]["parameters"][name]["value"] == pytest.approx(value, rel=1e-6)


def test_a_method_that_does_not_settle_is_named(dashpot: Command, rig: Path) -> None:
    """The paper's iteration under noise of three times the signal: exit code 3; the others are there all the same."""
    rig.write_text(RIG.replace("noise = 0.02", "noise = 30"), encoding="utf-8")
    sent = "--frequencies 1:15/8log --samples 20 --periods 3 --amplitude u=0.01 --table"
    assert dashpot(f"simulate rig.toml --out n.csv {sent} {SET}").code == 0
    done = dashpot("compare", "rig.toml", "n.csv", "--methods", "iv,oiv", "--json", "out.json")
    assert done.code == 3
    assert "iv did not converge." in done.out
    (line,) = done.err
    assert line.startswith("dashpot: iv did not converge; ")
    found = json.loads(Path("out.json").read_text(encoding="utf-8"))["methods"]
    assert [found[name]["status"] for name in ("iv", "oiv")] == ["not converged", "converged"]


def test_quiet_prints_nothing(dashpot: Command, data: Path) -> None:
    done = dashpot("compare", "rig.toml", "data.csv", "--methods", "oiv", "-q", "--json", "out.json")
    assert (done.code, done.out, done.err) == (0, "", [])
    assert Path("out.json").exists()


BAD = {
    "no data": (["rig.toml"], ["there are no data", "--modal"]),
    "no such method": (["rig.toml", "data.csv", "--methods", "oiv,best"], ["best", "oiv"]),
    "empty method": (["rig.toml", "data.csv", "--methods", "oiv,"], ["there is no method"]),
    "method twice": (["rig.toml", "data.csv", "--methods", "oiv,oiv"], ["oiv", "twice"]),
    "methods without data": (["rig.toml", "--modal", "m.csv", "--methods", "oiv"], ["--methods", "DATA"]),
    "truth of nothing": (["rig.toml", "data.csv", "--truth", "m7=3"], ["m7", "m1, c1, c2"]),
    "truth of the known": (["rig.toml", "data.csv", "--truth", "k1=3"], ["k1"]),
    "truth without value": (["rig.toml", "data.csv", "--truth", "m1"], ["m1", "NAME=VALUE"]),
    "truth no number": (["rig.toml", "data.csv", "--truth", "m1=three"], ["three"]),
    "truth infinite": (["rig.toml", "data.csv", "--truth", "m1=inf"], ["inf"]),
    "truth twice": (["rig.toml", "data.csv", "--truth", "m1=3,m1=4"], ["twice"]),
    "no such data": (["rig.toml", "none.csv"], ["none.csv"]),
    "no such modes": (["rig.toml", "data.csv", "--modal", "none.csv"], ["none.csv"]),
    "modes that are data": (["rig.toml", "data.csv", "--modal", "data.csv"], ["data.csv", "time_s"]),
    "two outputs in one": (
        ["rig.toml", "data.csv", "--figure", "out.svg", "--json", "out.svg"],
        ["two outputs have this name"],
    ),
    "no folder": (["rig.toml", "data.csv", "--figure", "no/out.png"], ["no", "does not exist"]),
    "level": (["rig.toml", "data.csv", "--level", "100"], ["100"]),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input(dashpot: Command, data: Path, case: str) -> None:
    args, parts = BAD[case]
    full = [*args, "--json", "out.json"] if "--json" not in args else args
    before = data.read_bytes()
    refused(dashpot("compare", *full), *parts)
    assert data.read_bytes() == before


def test_no_method_that_suits(dashpot: Command, data: Path) -> None:
    """The reason of the first; nothing is written."""
    done = dashpot("compare", "rig.toml", "data.csv", "--methods", "ls", "--figure", "out.png")
    refused(done, "velocity")


def test_methods_that_miss_the_scale_are_refused_as_by_identify(dashpot: Command, data: Path) -> None:
    """Nothing is known, and a reaction force is measured, which ml alone uses."""
    text = RIG.replace(", value = 4600", "").replace(", value = 2.7", "")
    text += 'R = { of = "u", quantity = "force", noise = 0.5 }\n'
    Path("rig.toml").write_text(text, encoding="utf-8")
    values = "m1=3,m2=2.7,k1=4600,k2=4600,c1=20,c2=30"
    sent = f"--frequencies 1:15/8log --amplitude u=0.01 --set {values}"
    simulated = dashpot(f"simulate rig.toml --out r.csv {sent}")
    assert simulated.code == 0, simulated.err
    done = dashpot("compare", "rig.toml", "r.csv", "--truth", values)
    assert done.code == 0, done.err
    row_of_ml = [line for line in done.out.splitlines() if line.startswith("ml ")]
    assert row_of_ml
    assert not [line for line in done.out.splitlines() if line.startswith("oiv ")]
    assert "oiv: does not use the channel that fixes the scale" in " ".join(done.out.split())
    refused(
        dashpot("compare", "rig.toml", "r.csv", "--methods", "tls,oiv", "--json", "out.json"),
        "tls",
        "scale",
        code=3,
    )


def test_a_method_gives_the_same_alone_and_in_company(dashpot: Command, rig: Path) -> None:
    """Each method gets the data it declares to need, whatever else is asked for: iv works on the samples' moments.

    Velocities are measured, so that the unit forces of the dampers can be read from samples at all.
    """
    text = RIG + 'v1 = { of = "x1", quantity = "velocity", noise = 0.3 }\n'
    text += 'v2 = { of = "x2", quantity = "velocity", noise = 0.3 }\n'
    rig.write_text(text, encoding="utf-8")
    done = dashpot(f"simulate rig.toml --out v.csv --amplitude u=0.01 --frequencies 2,5,9 {SET}")
    assert done.code == 0
    found = {}
    for methods in ("iv", "ls,iv", "iv,oiv"):
        done = dashpot("compare", "rig.toml", "v.csv", "--methods", methods, "--json", "out.json", "-q")
        assert done.code == 0, done.err
        found[methods] = json.loads(Path("out.json").read_text(encoding="utf-8"))["methods"]["iv"]
    assert found["iv"] == found["ls,iv"] == found["iv,oiv"]
    one = dashpot("identify", "rig.toml", "v.csv", "--method", "iv", "--json", "-")
    assert json.loads(one.out)["parameters"] == found["iv"]["parameters"]
