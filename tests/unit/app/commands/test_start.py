"""start: from raw files to a rig file, asked and unasked; and the same in Python."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import dashpot
from dashpot.app.cli import cli
from dashpot.app.commands import new

T = np.arange(2000) / 500
DECAY = np.exp(-1.5 * T) * np.cos(20 * T)
STEADY = np.sin(20 * T) + 0.3 * np.sin(47 * T)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def data(header: str, *columns: np.ndarray, time: np.ndarray = T) -> None:
    first = [time] if header.lower().startswith("t") else []
    np.savetxt("data.csv", np.column_stack([*first, *columns]), delimiter=",", header=header, comments="")


def start(*options: str, answers: str | None = None) -> Result:
    return CliRunner().invoke(cli, ["start", "data.csv", *options], input=answers, catch_exceptions=False)


def written() -> dict:
    return tomllib.loads(Path("rig.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("header", "columns", "inputs", "points"),
    [
        ("t,laser [mm]", [DECAY], {}, {"laser": "x1"}),
        (
            "t,acc_top [g],acc_table [g]",
            [STEADY, STEADY],
            {"u": "displacement"},
            {"acc_top": "x1", "acc_table": "u"},
        ),
        (
            "t,x1 (mm),a1 (g),base (mm)",
            [STEADY] * 3,
            {"u": "displacement"},
            {"x1": "x1", "a1": "x1", "base": "u"},
        ),
        ("t,hammer [N],a [m/s^2]", [STEADY, STEADY], {"f": "force"}, {"hammer": "f", "a": "x1"}),
        (
            "t,u_mm,x1_mm,x2_mm",
            [STEADY] * 3,
            {"u": "displacement"},
            {"u_mm": "u", "x1_mm": "x1", "x2_mm": "x2"},
        ),
        (
            "t,u_mm,x1_mm,a1_mps2",
            [STEADY] * 3,
            {"u": "displacement"},
            {"u_mm": "u", "x1_mm": "x1", "a1_mps2": "x1"},
        ),
        ("t,frame,top_mm", [np.arange(2000), DECAY], {}, {"top_mm": "x1"}),
        ("t,hammer_N,a1/g", [STEADY, STEADY], {"f": "force"}, {"hammer_N": "f", "a1/g": "x1"}),
        ("t,Stroke [mm],Load [kN]", [STEADY, STEADY], {"u": "displacement"}, {"Stroke": "u", "Load": "u"}),
    ],
)
def test_units_names_and_decay_tell_what_is_measured(header, columns, inputs, points):
    data(header, *columns)
    result = start()
    assert result.exit_code == 0, result.output
    assert Path("rig.svg").exists()
    assert "Identifiable" in result.output
    rig = written()
    assert {name: entry["kind"] for name, entry in rig.get("inputs", {}).items()} == inputs
    assert {name: entry["of"] for name, entry in rig["channels"].items()} == points
    assert CliRunner().invoke(cli, ["check", "rig.toml"]).exit_code == 0


def test_names_mean_the_same_to_all_commands(tmp_path: Path) -> None:
    """Units in the names of columns, a counter, pixels and letters that are directions."""
    data("t,sample,a2_m_s2,cam_px,force_mV,level_N", np.arange(2000), *[STEADY] * 4)
    done = CliRunner().invoke(cli, ["inspect", "data.csv", "--channels", "c.toml"], catch_exceptions=False)
    assert done.exit_code == 0
    suggested = tomllib.loads(Path("c.toml").read_text())["channels"]
    assert start("--driven-by", "force").exit_code == 0
    rig = written()["channels"]
    assert {name: entry.get("unit", "?") for name, entry in suggested.items()} == {
        "a2_m_s2": "m/s2",
        "cam_px": "px",
        "force_mV": "mV",
        "level_N": "?",
    }
    for name, entry in suggested.items():
        assert rig[name]["unit"] == entry.get("unit", "?")
        assert rig[name]["quantity"] == entry.get("quantity", "?")
    given = dashpot.start({"time_s": T, "sample": np.arange(2000), "u_mm": STEADY, "x1_mm": STEADY})
    assert [(each.name, each.scale) for each in given.channels] == [("u_mm", 1e-3), ("x1_mm", 1e-3)]


def test_one_camera_needs_no_scale() -> None:
    data("t,top_px,mid_px", DECAY, 0.5 * DECAY)
    done = start()
    assert "Identifiable" in done.output
    assert [entry["gain"] for entry in written()["channels"].values()] == [1, 1]
    text = Path("rig.toml").read_text(encoding="utf-8")
    Path("rig.toml").write_text(text.replace("gain = 1", 'gain = "unknown"'), encoding="utf-8")
    with pytest.raises(dashpot.DashpotError, match="a value, such as 1"):
        CliRunner().invoke(cli, ["check", "rig.toml"], catch_exceptions=False)
    Path("rig.toml").write_text(text.replace(", gain = 1", ""), encoding="utf-8")
    with pytest.raises(dashpot.DashpotError, match="gain = 1 in every channel"):
        CliRunner().invoke(cli, ["check", "rig.toml"], catch_exceptions=False)


def test_what_nobody_says_is_a_placeholder_that_commands_name() -> None:
    data("t,ch1,ch2 [V]", STEADY, STEADY)
    result = start()
    assert result.exit_code == 0
    assert not Path("rig.svg").exists()
    with pytest.raises(dashpot.ModelError) as refused:
        CliRunner().invoke(cli, ["identify", "rig.toml", "data.csv"], catch_exceptions=False)
    places = [str(problem.where) for problem in refused.value.problems]
    assert [place.partition(": ")[2] for place in places] == [
        "channels.ch1.quantity",
        "channels.ch1.unit",
        "channels.ch2.of",
        "channels.ch2.quantity",
        "channels.ch2.gain",
    ]


def test_a_terminal_is_asked_where_it_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    """The unit of the one column that has none, what drives, and the mass; not the unit of the other column."""
    monkeypatch.setattr(new, "_usual", new._asked)
    data("t,ch1,ch2 [mm]", STEADY, STEADY)
    result = start(answers="m/s^2\nrelease\n2 kg\n")
    assert result.exit_code == 0, result.output
    assert "Unit of ch2" not in result.output
    rig = written()
    assert rig["channels"]["ch1"] == {"of": "x1", "quantity": "acceleration", "unit": "m/s^2"}
    assert rig["masses"]["m1"]["value"] == 2.0


def test_a_force_at_one_of_several_masses_and_samples_without_times(monkeypatch: pytest.MonkeyPatch) -> None:
    data("f [N],a1 [g],a2 [g]", STEADY, STEADY, STEADY)
    with pytest.raises(dashpot.UsageError, match="x3"):
        start("--force-at", "x3")
    assert start("--force-at", "x2", "--rate", "500").exit_code == 0
    assert written()["inputs"]["f"]["at"] == "x2"
    assert tomllib.loads(Path("rig-data.toml").read_text())["files"][0] == {
        "name": "data.csv",
        "rate_hz": 500.0,
    }
    Path("rigs").mkdir()
    assert start("--force-at", "x2", "--rate", "500", "-o", "rigs/rig.toml").exit_code == 0
    assert CliRunner().invoke(cli, ["inspect", "rigs/rig-data.toml"], catch_exceptions=False).exit_code == 0
    assert start("--out", "other.toml").exit_code == 0
    with pytest.raises(dashpot.DataError, match="rate_hz"):
        CliRunner().invoke(cli, ["inspect", "other-data.toml"], catch_exceptions=False)


def test_several_forces_are_inputs_of_their_own() -> None:
    data("t,F1 [N],F2 [N],a1 [g],a2 [g]", STEADY, STEADY, STEADY, STEADY)
    assert start("--force-at", "x1").exit_code == 0
    rig = written()
    assert {name: entry["at"] for name, entry in rig["inputs"].items()} == {"f": "x1", "f2": "?"}
    assert (rig["channels"]["F1"]["of"], rig["channels"]["F2"]["of"]) == ("f", "f2")


def test_a_file_of_modes_is_named_as_such() -> None:
    Path("data.csv").write_text(
        "frequency_hz,frequency_sd,damping_ratio,x1,x2\n1.2,0.01,0.01,1,0.5\n3.4,0.01,0.02,1,-0.5\n"
    )
    with pytest.raises(dashpot.UsageError, match="modes"):
        start()


def test_a_stand_needs_its_force() -> None:
    data("t,x [mm]", STEADY)
    with pytest.raises(dashpot.UsageError, match="no column is a force"):
        start("--driven-by", "stand")
    assert not Path("rig.toml").exists()


def test_one_column_with_its_unit_is_one_column() -> None:
    data("laser (mm)", DECAY)
    assert start("--rate", "500").exit_code == 0
    assert list(written()["channels"]) == ["laser"]


def test_frequency_responses_name_output_and_input() -> None:
    frequency = np.arange(1, 50.0)
    header = "frequency_hz,a1/f_re,a1/f_im"
    np.savetxt("data.csv", np.column_stack([frequency] * 3), delimiter=",", header=header, comments="")
    assert start("--unit", "m/s^2").exit_code == 0
    channels = written()["channels"]
    assert (channels["a1"]["of"], channels["f"]["of"]) == ("x1", "f")


def test_the_response_of_an_analysers_file_is_of_two_channels(tmp_path: Path) -> None:
    """Of 2 kg on 800 N/m, 6 N·s/m, acceleration over force; with the names come the units, and then the values."""
    s = 2j * np.pi * np.arange(1, 10, 0.25)
    H = s**2 / (2 * s**2 + 6 * s + 800)
    header = "Frequency [Hz],Real [(m/s^2)/N],Imag [(m/s^2)/N]"
    rows = np.column_stack([s.imag / 2 / np.pi, H.real, H.imag])
    np.savetxt("H_a1_f.csv", rows, delimiter=",", header=header, comments="")
    done = CliRunner().invoke(cli, ["start", "H_a1_f.csv"], catch_exceptions=False)
    assert "responses of a1 to f" in done.output
    channels = written()["channels"]
    assert {name: (entry["of"], entry["unit"]) for name, entry in channels.items()} == {
        "a1": ("x1", "m/s^2"),
        "f": ("f", "N"),
    }
    assert list(dashpot.start("H_a1_f.csv").model.force_inputs) == ["f"]
    assert dashpot.identify(dashpot.read_rig("rig.toml"), "H_a1_f.csv")["k1"].value == pytest.approx(800)
    found = dashpot.frf("H_a1_f.csv", "f")
    assert found.pairs == ("a1/f",)
    assert found.values[:, 0, 0] == pytest.approx(H)


def test_a_manifest_names_the_channels() -> None:
    data("t,Channel_1,Channel_2", STEADY, 2 * STEADY)
    columns = 'columns = { acc = "Channel_1", table = "Channel_2" }'
    units = 'units = { acc = "g", table = "mm" }'
    Path("test.toml").write_text(f'[[files]]\nname = "data.csv"\n{columns}\n{units}\n', encoding="utf-8")
    done = CliRunner().invoke(cli, ["start", "test.toml"], catch_exceptions=False)
    assert done.exit_code == 0
    channels = written()["channels"]
    assert {name: (entry["of"], entry["unit"]) for name, entry in channels.items()} == {
        "acc": ("x1", "g"),
        "table": ("u", "mm"),
    }
    rig = dashpot.start("test.toml")
    assert [channel.name for channel in rig.channels] == ["acc", "table"]
    assert len(dashpot.read("test.toml", rig.channels).records) == 1


def test_other_names_of_the_same_channels_are_put_into_a_manifest() -> None:
    data("t,Table disp [mm],Floor1 disp [mm],Floor2 acc [m/s^2]", *[STEADY] * 3)
    Path("data.csv").rename("low.csv")
    data("t,u_mm,x1_mm,a2_mps2", *[STEADY] * 3)
    done = CliRunner().invoke(cli, ["start", "low.csv", "data.csv"], catch_exceptions=False)
    assert list(written()["channels"]) == ["Table disp", "Floor1 disp", "Floor2 acc"]
    assert "rig-data.toml" in done.output
    first, second = tomllib.loads(Path("rig-data.toml").read_text(encoding="utf-8"))["files"]
    assert first == {"name": "low.csv"}
    assert second["columns"] == {"Table disp": "u_mm", "Floor1 disp": "x1_mm", "Floor2 acc": "a2_mps2"}
    rig = dashpot.read_rig("rig.toml")
    assert len(dashpot.read("rig-data.toml", rig.channels).records) == 2
    with pytest.raises(dashpot.DataError, match=r"manifest: columns = \{ \"Table disp\" = "):
        dashpot.read(["low.csv", "data.csv"], rig.channels)
    with pytest.raises(dashpot.UsageError, match="manifest"):
        dashpot.start(["low.csv", "data.csv"])
    data("t,hammer [N],a3 [g],a4 [g]", *[STEADY] * 3)  # the sensors were moved
    Path("data.csv").rename("b.csv")
    data("t,Kraft [N],a1 [g],a2 [g]", *[STEADY] * 3)
    assert CliRunner().invoke(cli, ["start", "data.csv", "b.csv", "-o", "moved.toml"]).exit_code == 0
    assert len(tomllib.loads(Path("moved.toml").read_text())["channels"]) == 6


def test_a_column_that_ends_early_is_told_without_a_warning() -> None:
    x = np.where(T < 2.8, DECAY, np.nan)
    rig = dashpot.start({"time_s": T, "x1": x, "x2": DECAY})
    assert not rig.model.inputs  # let go, as the other column tells


def test_the_first_two_commands_find_the_values() -> None:
    """ω² = k/m, 2ζω = c/m of a decay logged in µs without a word on its unit: 2 kg, 800 N/m, 6 N·s/m."""
    rng = np.random.default_rng(4)
    rate = np.sqrt(400 - 1.5**2)
    x = 5 * np.exp(-1.5 * T) * np.cos(rate * T) + 0.01 * rng.standard_normal(T.size)
    np.savetxt("data.csv", np.column_stack([1e6 * T, x]), delimiter=",", fmt=["%d", "%.4f"], header="time,x [mm]",
               comments="")  # fmt: skip
    assert start("--first-mass", "2kg").exit_code == 0
    done = CliRunner().invoke(cli, ["identify", "rig.toml", "data.csv", "--json", "e.json"])
    assert done.exit_code == 0, done.output
    estimate = dashpot.Estimate.load("e.json")
    for name, value in (("k1", 800.0), ("c1", 6.0)):
        assert abs(estimate[name].value - value) < 4 * estimate[name].sd


def test_python_suggests_the_same_rig() -> None:
    rig = dashpot.start({"time_s": T, "acc1": STEADY, "acc_table": STEADY}, first_mass=1.5)
    assert [channel.name for channel in rig.channels] == ["acc1", "acc_table"]
    assert rig.model.displacement_inputs == ("u",)
    with pytest.raises(dashpot.UsageError, match="units="):
        dashpot.start({"time_s": T, "ch": STEADY})
    rig = dashpot.start({"time_s": T, "ch": STEADY}, units={"ch": "mm"}, driven_by="release")
    assert rig.channels[0].scale == pytest.approx(1e-3)
    with pytest.raises(dashpot.UsageError, match="unit"):
        dashpot.start({"time_s": T, "ch": STEADY}, units={"ch": "bananas"})


def test_python_says_where_a_force_acts_and_which_column_is_the_base() -> None:
    pushed = {"time_s": T, "f": STEADY, "a1": STEADY, "a2": STEADY}
    with pytest.raises(dashpot.UsageError, match="force_at="):
        dashpot.start(pushed, driven_by="force")
    with pytest.raises(dashpot.UsageError, match="x3"):
        dashpot.start(pushed, force_at="x3")
    assert dashpot.start(pushed, force_at="x2").model.inputs[0].at == {"x2": 1.0}
    with pytest.raises(dashpot.UsageError, match="leave out"):
        dashpot.start({**pushed, "f2": STEADY}, force_at="x2")
    shaken = {"time_s": T, "a1": STEADY, "a2": STEADY}
    with pytest.raises(dashpot.UsageError, match="base="):
        dashpot.start(shaken, driven_by="base")
    with pytest.raises(dashpot.UsageError, match="a3"):
        dashpot.start(shaken, base="a3")
    assert dashpot.start(shaken, base="a1").channels[0].of == {"u": 1.0}
    data("t,a1 [g],a2 [g]", STEADY, STEADY)
    assert start("--base", "a1").exit_code == 0
    assert written()["channels"]["a1"]["of"] == "u"
