"""inspect, new, and commands with manifests and files of other formats."""

import tomllib

import pytest
from click.testing import CliRunner

from dashpot.app.cli import cli
from dashpot.app.commands import new
from tests.unit.data.readers.written import RIG, WRITERS, recording


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(RIG)
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(cli, list(arguments), catch_exceptions=False)


def test_inspect_shows_and_suggests(folder):
    WRITERS["MATLAB"][1](folder / "test.mat", recording())
    result = run("inspect", "test.mat")
    assert result.exit_code == 0
    assert "test.mat: MATLAB" in result.output
    assert "3 drive frequencies, 2 to 8 Hz" in " ".join(result.output.split())
    assert "[channels]" in result.output
    result = run("inspect", "test.mat", "--channels", "channels.toml")
    assert result.exit_code == 0
    table = tomllib.loads((folder / "channels.toml").read_text())["channels"]
    assert set(table) == {"x1", "x2", "u"}


def test_new_writes_a_rig_that_checks(folder):
    result = run("new", "mine.toml", "--masses", "2", "--driven-by", "force", "--unit", "g")
    assert result.exit_code == 0
    assert run("check", "mine.toml").exit_code == 0
    assert tomllib.loads((folder / "mine.toml").read_text())["coordinates"] == ["x1", "x2"]
    assert not (folder / "bad.toml").exists()


@pytest.mark.parametrize("drive", ["base", "force", "release"])
@pytest.mark.parametrize("masses", ["1", "2", "5"])
def test_a_rig_of_which_nothing_was_weighed_checks(folder, drive, masses):
    """Without a force nothing gives the scale: a mass of 1 kg stands in, which is said."""
    result = run("new", "mine.toml", "--masses", masses, "--driven-by", drive)
    assert result.exit_code == 0
    assert ("m1 = 1 kg is a PLACEHOLDER" in result.output) == (drive != "force")
    checked = run("check", "mine.toml")
    assert checked.exit_code == 0, checked.output


def test_new_takes_answers_as_they_are_typed(folder, monkeypatch):
    monkeypatch.setattr(new, "_usual", new._asked)
    answers = ["   ", " 3 ", " Force ", "VELOCITY", " mm/s ", " 1.5 kg "]
    result = CliRunner().invoke(cli, ["new", "mine.toml"], input="\n".join(answers) + "\n")
    assert (result.exit_code, result.output.count("Error: ")) == (0, 0)
    rig = tomllib.loads((folder / "mine.toml").read_text())
    assert (rig["name"], rig["masses"]["m1"]["value"]) == ("My rig", 1.5)
    assert rig["channels"]["x3"] == {"of": "x3", "quantity": "velocity", "unit": "mm/s"}


def test_new_asks_again_for_what_is_no_answer(folder, monkeypatch):
    """Each wrong answer is told, and what was said before is kept."""
    monkeypatch.setattr(new, "_usual", new._asked)  # as at a terminal
    answers = ["Mine", "three", "0", "3", "bas", "base", "", "bananas", "mm", "g", "-1", "1.25 kg"]
    result = CliRunner().invoke(cli, ["new", "mine.toml"], input="\n".join(answers) + "\n")
    assert result.exit_code == 0
    assert result.output.count("Error: ") == 6
    rig = tomllib.loads((folder / "mine.toml").read_text())
    assert rig["name"] == "Mine"
    assert rig["coordinates"] == ["x1", "x2", "x3"]
    assert rig["masses"]["m1"] == {"at": "x1", "value": 1.25}
    assert rig["channels"]["x3"] == {"of": "x3", "quantity": "acceleration", "unit": "g"}


@pytest.mark.slow
def test_identify_takes_a_manifest_and_its_conditioning(folder):
    WRITERS["TDMS"][1](folder / "test.tdms", recording())
    (folder / "test.toml").write_text('[conditioning]\norders = [1, 2]\n[[files]]\nname = "*.tdms"\n')
    for data in ("test.tdms", "test.toml"):
        result = run("identify", "rig.toml", data, "--json", f"{data}.json")
        assert result.exit_code == 0, result.output
    for options, rows in (([], 6), (["--orders", "1"], 3)):
        result = run("spectrum", "rig.toml", "test.toml", "-o", f"{rows}.csv", *options)
        assert result.exit_code == 0, result.output
        assert len((folder / f"{rows}.csv").read_text().splitlines()) == rows + 1
