"""[shaker]: what a drive can do at most, kept by simulate and design, and said where nothing is stated."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import dashpot
from dashpot.app.cli import cli
from dashpot.model.rigfile.rig import usual_limits
from tests.two_masses import one_mass

LIMITS = '[shaker]\nstroke = "5 mm"\nvelocity = "0.1 m/s"\nacceleration = "1 gn"'
FREQUENCIES = (1.0, 4.0, 30.0)


def rig_text(shaker: str = "", force: bool = False) -> str:
    drive = "f" if force else "u"
    return (
        one_mass(drive, "value = 2", "guess = 8000", "guess = 10", {"x": "noise = 1e-6", drive: ""}) + shaker
    )


def amplitudes(records: tuple[dashpot.Record, ...], channel: str) -> np.ndarray:
    index = [each.name for each in records[0].channels].index(channel)
    return np.array([np.max(np.abs(record.values[:, index])) for record in records])


def test_the_drive_meets_stroke_velocity_and_acceleration_by_frequency() -> None:
    rig = dashpot.parse_rig(rig_text(LIMITS))
    drive = amplitudes(rig.simulate({}, FREQUENCIES, samples=2000), "u")
    omega = 2 * np.pi * np.array(FREQUENCIES)
    np.testing.assert_allclose(drive, [5e-3, 0.1 / omega[1], 9.80665 / omega[2] ** 2], rtol=1e-4)
    assert dashpot.parse_rig(dashpot.write_rig(rig)).shaker == rig.shaker
    stated = rig.simulate({}, FREQUENCIES, samples=2000, amplitudes={"u": 1e-3})
    np.testing.assert_allclose(amplitudes(stated, "u"), 1e-3, rtol=1e-4)


def test_limits_of_motion_at_a_force_hold_for_the_point_that_it_drives() -> None:
    rig = dashpot.parse_rig(rig_text('[shaker]\nstroke = "1 mm"\nforce = "100 N"', force=True))
    records = rig.simulate({}, FREQUENCIES, samples=2000)
    x, f = amplitudes(records, "x"), amplitudes(records, "f")
    assert np.all(
        (np.isclose(x, 1e-3, rtol=1e-2) & (f < 100)) | (np.isclose(f, 100, rtol=1e-3) & (x < 1.01e-3))
    )


TWO_BASES = """
coordinates = ["x"]
inputs = { a = { kind = "displacement" }, b = { kind = "displacement" }, f = { kind = "force", at = "x" } }
masses = { m = { at = "x", value = 2 } }
springs = { k = { between = ["x", "a"], guess = 8000 }, k2 = { between = ["x", "b"], guess = 900 } }
dampers = { c = { between = ["x", "a"], guess = 10 } }
channels = { x = { of = "x" }, a = { of = "a" }, b = { of = "b" }, f = { of = "f" } }
"""


def test_without_limits_moved_bases_and_forces_have_a_size_each(tmp_path: Path) -> None:
    """10 mm and 1 g of the bases, 10 N of the force: one factor for both had left 10 mN."""
    rig, out = tmp_path / "rig.toml", str(tmp_path / "a.csv")
    rig.write_text(TWO_BASES)
    simulate = ["simulate", str(rig), "--frequencies", "1,30", "--samples", "2000", "-o", out]
    done = CliRunner().invoke(cli, simulate, catch_exceptions=False)
    assert "10 mm, 1 g, 10 N at most" in " ".join(done.output.split())
    records = dashpot.read(out, dashpot.read_rig(rig)).records
    moved = [1e-2, 9.80665 / (60 * np.pi) ** 2]
    for base in "ab":
        np.testing.assert_allclose(amplitudes(records, base), moved, rtol=1e-4)
    np.testing.assert_allclose(amplitudes(records, "f"), 10.0, rtol=1e-4)
    plan = ["design", str(rig), "--samples", "500", "--band", "1:40", "--json", str(tmp_path / "plan.json")]
    CliRunner().invoke(cli, plan, catch_exceptions=False)
    dwells = json.loads((tmp_path / "plan.json").read_text())["dwells"]
    forces = [abs(dwell["amplitudes"]["f"]) for dwell in dwells]
    assert all(force == pytest.approx(10, rel=1e-6) for force in forces if force)


def test_each_limit_has_the_unit_of_the_inputs_that_it_holds_for() -> None:
    """A base that turns and a force along a line: rad and N, stated, assumed and said."""
    rig = dashpot.parse_rig(
        """
        coordinates = ["x", "w"]
        angles = ["u", "w"]
        inputs = { u = { kind = "displacement" }, f = { kind = "force", at = "x" } }
        masses = { m = { at = "x", value = 2 }, J = { at = "w", value = 0.1 } }
        springs = { k = { between = ["x", "ground"], value = 8000 }, q = { between = ["w", "u"], value = 50 } }
        channels = { x = { of = "x" }, w = { of = "w" } }
        shaker = { stroke = "2 deg", force = "20 N" }
        """
    )
    assert rig.shaker is not None
    assert (rig.shaker.force, rig.shaker.stroke) == (20.0, pytest.approx(np.deg2rad(2)))
    assert rig.shaker.text(rig.model) == "0.0349 rad, 20 N"
    assert usual_limits(rig.model).text(rig.model) == "0.1 rad, 10 rad/s², 10 N"
    assert dashpot.parse_rig(dashpot.write_rig(rig)).shaker == rig.shaker


def test_the_input_beyond_the_shaker_is_named_in_the_order_of_the_rig(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(TWO_BASES + '[shaker]\nstroke = "5 mm"\n')
    far = ["--amplitude", "b=20mm", "--amplitude", "a=10mm", "--amplitude", "f=1N"]
    simulate = ["simulate", str(rig), "--frequencies", "2", *far, "-o", str(tmp_path / "a.csv")]
    done = CliRunner().invoke(cli, simulate, catch_exceptions=False)
    assert "a is 2 ×" in " ".join(done.output.split())


def test_commands_say_what_they_take_where_nothing_is_stated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text(rig_text())
    simulate = ["simulate", "rig.toml", "--frequencies", "1,30", "-o"]
    done = CliRunner().invoke(cli, [*simulate, "a.csv"], catch_exceptions=False)
    assert "10 mm, 1 g at most" in " ".join(done.output.split())
    plan = ["design", "rig.toml", "--samples", "500", "--band", "1:40", "--json", "plan.json"]
    done = CliRunner().invoke(cli, plan, catch_exceptions=False)
    assert "10 mm, 1 g at most" in " ".join(done.output.split())
    Path("rig.toml").write_text(rig_text(LIMITS))
    done = CliRunner().invoke(cli, [*simulate, "b.csv", "--amplitude", "5mm"], catch_exceptions=False)
    assert "× the shaker limit at 30 Hz" in done.output
    CliRunner().invoke(cli, plan, catch_exceptions=False)
    for dwell in json.loads(Path("plan.json").read_text())["dwells"]:
        u, turn = abs(dwell["amplitudes"]["u"]), 2 * np.pi * dwell["frequency_hz"]
        assert max(u / 5e-3, u * turn / 0.1, u * turn**2 / 9.80665) == pytest.approx(1, rel=1e-6)


@pytest.mark.parametrize(
    ("wrong", "place"),
    [
        ("[shaker]\nstroke = 0", "shaker.stroke"),
        ('[shaker]\nstroke = "5 kg"', "shaker.stroke"),
        ("[shaker]\nstorke = 1", "shaker.storke"),
        ("[[shaker]]\nstroke = 1", "shaker"),
    ],
)
def test_what_no_shaker_has_is_refused_with_its_key(wrong: str, place: str) -> None:
    with pytest.raises(dashpot.ModelError) as refused:
        dashpot.parse_rig(rig_text(wrong))
    (problem,) = refused.value.problems
    assert str(problem.where).endswith(place)
