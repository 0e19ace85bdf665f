"""Help, completion and the ways to start the command."""

import subprocess
from importlib import import_module
from pathlib import Path

import pytest

from dashpot.app import cli
from dashpot.app.commands import COMMANDS
from tests.unit.app.conftest import Command


@pytest.mark.parametrize("name", list(COMMANDS))
def test_help_groups_every_option_and_ends_with_examples(dashpot: Command, name: str) -> None:
    done = dashpot(f"{name} --help")
    out = done.out
    assert done.code == 0
    assert out.startswith(f"Usage: dashpot {name}")
    assert "\nExamples:\n" in out
    assert ("Exit codes:" in out) == ("5 not enough memory" in " ".join(out.split()))
    assert out.index("Positional arguments:") < out.index("General:") < out.index("Examples:")
    assert all(len(line) <= 80 for line in out[: out.index("Examples:")].splitlines())


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "completion"])
def test_options_of_examples_exist(name: str) -> None:
    command = import_module(f"dashpot.app.commands.{name}").command
    options = {text for parameter in command.params for text in parameter.opts}
    for example in command.examples:
        assert example.startswith(f"dashpot {name} ")
        assert {word for word in example.split() if word.startswith("-")} <= options


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_prints_a_script(dashpot: Command, shell: str) -> None:
    done = dashpot("completion", shell)
    assert done.code == 0
    assert f"{cli.COMPLETION}={shell}_complete" in done.out


def test_the_bash_script_is_bash(dashpot: Command, tmp_path: Path) -> None:
    script = tmp_path / "dashpot.bash"
    script.write_text(dashpot("completion", "bash").out, encoding="utf-8")
    done = subprocess.run(["bash", "-n", str(script)], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("dashpot id", ["identify"]),
        ("dashpot identify rig.toml d.csv --met", ["--method"]),
        ("dashpot identify rig.toml d.csv --method o", ["oiv", "oiv+"]),
        ("dashpot design rig.toml --settling-time a", ["auto"]),
    ],
)
def test_completion_of_commands_options_and_values(
    dashpot: Command, monkeypatch: pytest.MonkeyPatch, words: str, expected: list[str]
) -> None:
    monkeypatch.setenv(cli.COMPLETION, "bash_complete")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    done = dashpot()
    assert [line.partition(",")[2] for line in done.out.split()] == expected


def test_files_are_left_to_the_shell(dashpot: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(cli.COMPLETION, "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "dashpot identify ri")
    monkeypatch.setenv("COMP_CWORD", "2")
    assert dashpot().out.startswith("file,")


def test_the_help_of_identify_shows_what_people_use_and_all_of_it_on_request(dashpot: Command) -> None:
    usual, everything = dashpot("identify --help").out, dashpot("identify --help-all").out
    assert "--report" in usual
    assert "--orders" not in usual
    assert all(option in everything for option in ("--report", "--orders", "--in-parts"))
