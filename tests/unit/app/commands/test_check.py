"""dashpot check from end to end."""

import json
from pathlib import Path

import pytest

from tests.two_masses import one_mass
from tests.unit.app.conftest import RIG, Command


def test_before_data(dashpot: Command, rig: Path) -> None:
    done = dashpot("check", "rig.toml")
    assert done.code == 0
    assert done.err == []
    assert done.out.startswith("Identifiable: the 3 unknowns (m1, c1, c2) can be found from x1, x2, u.")


def test_a_deficient_rig_is_told_in_physics_and_ends_with_3(dashpot: Command, rig: Path, data: Path) -> None:
    rig.write_text(RIG.replace("[channels]", 'c3 = { between = ["u", "x2"] }\n[channels]'), encoding="utf-8")
    done = dashpot("check", "rig.toml", "--json", "out.json")
    assert done.code == 3
    [line] = done.err
    assert line == (
        "dashpot: rig.toml: only c2 + c3 can be found, not c2, c3 separately: both join x2 to u; "
        "give c2 or c3 a value, or attach one elsewhere"
    )
    content = json.loads(Path("out.json").read_text(encoding="utf-8"))
    assert content["identifiable"] is False
    assert content["deficiencies"][0]["unknowns"] == ["c2", "c3"]
    [direction] = content["deficiencies"][0]["directions"]
    assert direction["c2"] == pytest.approx(-direction["c3"])
    # identify says the same, before it reads data.
    refused = dashpot("identify", "rig.toml", "missing.csv")
    assert refused.code == 3
    assert refused.err == done.err


def test_with_data(dashpot: Command, data: Path) -> None:
    done = dashpot("check", "rig.toml", "data.csv", "--profile", "c1", "--known", "--json", "out.json")
    assert done.code == 0
    assert "at these 8 frequencies" in " ".join(done.out.split())
    assert "c1 = " in done.out
    assert "1 % of" in done.out
    content = json.loads(Path("out.json").read_text(encoding="utf-8"))
    assert content["profiles"][0]["name"] == "c1"
    low, high = content["profiles"][0]["interval"]
    assert low < content["profiles"][0]["value"] < high
    moved = content["known_errors"]["percent_per_percent"]
    assert set(moved) == {"m2", "k1", "k2"}
    assert abs(sum(moved[name]["m1"] for name in moved) - 1) < 1e-3
    assert len(content["data"]["lines"]) == 8


def test_too_few_lines(dashpot: Command, data: Path) -> None:
    rows = data.read_text(encoding="utf-8").splitlines()
    first = rows[1].split(",")[0]
    data.write_text(
        "\n".join([rows[0], *(r for r in rows if r.split(",")[0] == first)]) + "\n", encoding="utf-8"
    )
    Path("rig.toml").write_text(RIG.replace(", value = 4600", ""), encoding="utf-8")
    for command in ("check", "identify"):
        done = dashpot(command, "rig.toml", "data.csv")
        assert done.code == 3
        assert "1 line at 1 frequency determine only 4 combinations of the 5 unknowns" in done.err[-1]
        assert "measure at 1 more frequency" in done.err[-1]


def test_bad_usage(dashpot: Command, rig: Path, data: Path) -> None:
    assert dashpot("check", "rig.toml", "--profile", "c1").code == 2
    done = dashpot("check", "rig.toml", "data.csv", "--profile", "k1")
    assert done.code == 2
    assert "k1 is not among the unknowns" in done.err[-1]
    assert dashpot("check", "nowhere.toml").code == 2


def test_a_nonlinear_rig_is_checked_and_drawn(dashpot: Command, tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(one_mass("f", k3='law = "cubic"', of={}), encoding="utf-8")
    done = dashpot("check", str(rig))
    assert done.code == 0, done.err
    assert "the 4 unknowns (m, k, k3, c) can be found" in done.out
    assert dashpot("draw", str(rig), "-o", str(tmp_path / "rig.svg")).code == 0
