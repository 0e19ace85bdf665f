"""Narrow terminals lose nothing, odd names of files and parts do no harm, whatever way Python is started."""

import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import click
import pytest

from dashpot.app import cli, process
from tests.unit.app.conftest import RIG, Command

CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


@pytest.mark.parametrize(
    "words",
    [
        ("identify", "rig.toml", "data.csv"),
        ("check", "rig.toml", "data.csv"),
        ("compare", "rig.toml", "data.csv"),
        ("inspect", "data.csv"),
        ("design", "rig.toml", "--set", "m1=3,c1=20,c2=30", "--samples", "500"),
    ],
    ids=lambda words: words[0],
)
def test_forty_columns(
    dashpot: Command, data: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    """Tables are stacked: the numbers of a wide terminal are all there, none is cut."""
    monkeypatch.setenv("COLUMNS", "200")
    wide = dashpot(*words)
    monkeypatch.setenv("COLUMNS", "40")
    narrow = dashpot(*words)
    assert (wide.code, narrow.code) == (0, 0)
    numbers = re.compile(r"(?<![\w.])\d+\.\d+(?![\w.])")
    assert set(numbers.findall(wide.out)) <= set(numbers.findall(narrow.out))
    if words[0] != "inspect":  # its table of channels is a file to copy
        assert max(len(line) for line in narrow.out.splitlines()) <= 40


@pytest.mark.parametrize("name", ["a\nb.csv", "a\x1b[31mb.csv", "a\x07.csv"])
def test_control_characters_of_names_are_shown_escaped(dashpot: Command, data: Path, name: str) -> None:
    Path(name).write_text("frequency_hz,time_s\n1,2\n", encoding="utf-8")
    for words in (("identify", "rig.toml", name), ("inspect", f"none{name}"), ("draw", name, "-o", "a.svg")):
        done = dashpot(*words)
        assert done.code == 2
        assert len(done.err) == 1
        assert not CONTROL.search(done.err[0])


@pytest.mark.slow
def test_names_of_three_hundred_characters_and_with_dollar_signs(dashpot: Command, data: Path) -> None:
    """What matplotlib would take for broken mathematics is a name as any other."""
    long = "a_part_of_" * 30
    text = (
        RIG.replace("m1", long).replace("x1 = { of", '"$x_{1$" = { of').replace("c1 = ", '"$\\\\frac{$" = ')
    )
    Path("long.toml").write_text(text, encoding="utf-8")
    data.write_text(data.read_text(encoding="utf-8").replace("x1", "$x_{1$", 1), encoding="utf-8")
    done = dashpot("identify", "long.toml", "data.csv", "--report", "out.html")
    assert done.code == 0, done.err
    assert done.out.count("a_part_of_") >= 29  # folded, not cut
    page = Path("out.html").read_text(encoding="utf-8")
    assert all(name in page for name in (long, "$x_{1$", "$\\frac{$"))
    assert dashpot("draw", "long.toml", "-o", "out.svg").code == 0
    refused = dashpot("identify", "rig.toml", "n" * 300)
    assert refused.code == 2
    assert len(refused.err) == 1


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_a_name_that_is_not_utf_8(dashpot: Command, data: Path) -> None:
    name = os.fsdecode(b"data\xff.csv")
    Path(name).write_bytes(data.read_bytes())
    assert dashpot("identify", "rig.toml", name, "--json", os.fsdecode(b"\xfe.json")).code == 0
    assert os.path.exists(b"\xfe.json")
    assert dashpot("identify", "rig.toml", os.fsdecode(b"none\xff.csv")).code == 2


@pytest.mark.slow
def test_python_without_docstrings_and_asserts(data: Path, tmp_path: Path) -> None:
    words = [sys.executable, "-OO", "-m", "dashpot", "identify", "rig.toml", "data.csv"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "The model fits" in done.stdout


def test_a_new_command_is_a_module_and_a_line(dashpot: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("dashpot.app.commands.greet")
    module.command = click.Command("greet", callback=lambda: click.echo("hello"))  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(cli, "COMMANDS", {**cli.COMMANDS, "greet": "Say hello."})
    assert dashpot("greet").out == "hello\n"
    assert "Say hello." in dashpot("--help").out
    assert "did you mean greet?" in dashpot("gret").err[0]


@pytest.mark.slow
@pytest.mark.parametrize("epoch", ["9" * 20])
def test_settings_of_other_programs_do_not_reach_figures(data: Path, tmp_path: Path, epoch: str) -> None:
    words = [sys.executable, "-m", "dashpot", "draw", "rig.toml", "--out", "rig.pdf"]
    around = os.environ | {"MPLBACKEND": "nonsense", "SOURCE_DATE_EPOCH": epoch}
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, env=around, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_line_on_stderr_is_broken_between_words_on_a_terminal_alone(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    line = "note: 13 stepped-sine dwells: all 2,600 samples used, stated frequencies kept [settled_dwells]"
    process.tell(line)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "50")
    process.tell(line)
    whole, *parts = capsys.readouterr().err.splitlines()
    assert whole == line
    assert " ".join(parts) == line
    assert max(map(len, parts)) <= 50
