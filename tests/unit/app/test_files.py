"""No output of a call is an input of it, whatever the command and the option; and outputs that are full or closed."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from itertools import combinations
from pathlib import Path

import click
import pytest

from dashpot.app.commands import COMMANDS
from dashpot.app.options import InputFile, OutputFile, OutputFolder
from tests.unit.app.conftest import RIG, Command

PATHS = (InputFile, OutputFile, OutputFolder)
# What a call needs beside its files, by the name of the parameter.
NEEDED = {"window": "20s", "frequencies": "1,2,5", "paper": "yamane1989"}


def _command(name: str) -> click.Command:
    found = import_module(f"dashpot.app.commands.{name}").command
    assert isinstance(found, click.Command)
    return found


def _outputs(name: str) -> list[str]:
    return [str(one.name) for one in _command(name).params if isinstance(one.type, OutputFile)]


def _inputs(name: str) -> list[str]:
    return [str(one.name) for one in _command(name).params if isinstance(one.type, InputFile)]


def _arguments(command: click.Command, given: dict[str, str]) -> list[str]:
    """A command line with the given values and what it needs beside them."""
    words, last = [], []
    for parameter in command.params:
        value = given.get(parameter.name or "")
        if value is None and parameter.required:
            value = NEEDED.get(parameter.name or "", f"some_{parameter.name}.{_end(parameter)}")
        if value is None:
            continue
        if isinstance(parameter, click.Argument):
            last.append(value)
        else:
            words += [parameter.opts[0], value]
    return [*words, *last]


ANY = "pdf"  # an end that pictures and reports may have


def _end(parameter: click.Parameter) -> str:
    """An end of a file's name that an option takes."""
    formats: tuple[str, ...] = getattr(parameter.type, "formats", ())
    return formats[-1] if formats else ANY


def _parameter(command: str, name: str) -> click.Parameter:
    (parameter,) = [each for each in _command(command).params if each.name == name]
    return parameter


def _kept(dashpot: Command, name: str, output: str, source: str, kind: str = "same") -> None:
    """A call that would overwrite what it reads is refused, and the file is as it was."""
    end = _end(_parameter(name, output))
    precious, soft, hard = (f"{stem}.{end}" for stem in ("precious", "soft", "hard"))
    for path in (soft, hard):
        Path(path).unlink(missing_ok=True)
    Path(precious).write_text("measured", encoding="utf-8")
    os.symlink(precious, soft)
    os.link(precious, hard)
    spelling = f"../{Path.cwd().name}/./{precious}"
    other = {"same": precious, "spelling": spelling, "symlink": soft, "hard link": hard}[kind]
    ran = dashpot(name, *_arguments(_command(name), {output: other, source: precious}))
    assert (ran.code, len(ran.err)) == (2, 1), (output, source, ran.err)
    new = getattr(_parameter(name, output).type, "new", False)  # what never replaces a file says so
    assert ("a file of this name exists" if new else "this would overwrite an input file") in ran.err[0]
    assert Path(precious).read_text(encoding="utf-8") == "measured"


@pytest.mark.parametrize("kind", ["spelling", "symlink", "hard link"])
def test_no_output_is_an_input_by_another_name(dashpot: Command, kind: str) -> None:
    _kept(dashpot, "identify", "report", "data", kind)


@pytest.mark.parametrize("name", [name for name in COMMANDS if _outputs(name) and _inputs(name)])
def test_no_output_of_a_command_is_an_input(dashpot: Command, name: str) -> None:
    for output in _outputs(name):
        for source in _inputs(name):
            _kept(dashpot, name, output, source)


def test_two_outputs_are_two_files(dashpot: Command) -> None:
    for name in COMMANDS:
        for one, other in combinations(_outputs(name), 2):
            ends = [_end(_parameter(name, each)) for each in (one, other)]
            file = f"x.{next((end for end in ends if end != ANY), ANY)}"
            ran = dashpot(name, *_arguments(_command(name), {one: file, other: file, "rig": "r"}))
            assert ran.code == 2
            assert "two outputs have this name" in ran.err[0]


def _of_formats() -> Iterator[tuple[str, str]]:
    for name in COMMANDS:
        for parameter in _command(name).params:
            if isinstance(parameter.type, OutputFile) and parameter.type.formats and parameter.name:
                yield name, parameter.name


def test_figures_and_reports_have_formats() -> None:
    assert {name for name, parameter in _of_formats() if parameter == "report"} >= {
        "identify", "compare", "check", "design", "validate", "study", "reproduce",
    }  # fmt: skip
    assert {name for name, parameter in _of_formats() if parameter in ("figure", "out")} == {
        "compare", "design", "draw", "fleet", "frf", "identify", "modes", "response", "track", "validate",
    }  # fmt: skip


@pytest.mark.parametrize(("name", "output"), list(_of_formats()))
def test_a_name_that_ends_in_no_format_is_refused_before_anything_is_read(
    dashpot: Command, name: str, output: str
) -> None:
    for target in ("out", "out.docx", "out.png.txt"):
        ran = dashpot(name, *_arguments(_command(name), {output: target}))  # of files that do not exist
        assert ran.code == 2
        assert len(ran.err) == 1
        assert f"{target}: unknown format; use ." in ran.err[0]
        assert not Path(target).exists()


def test_every_parameter_that_names_a_file_has_a_type_that_says_so() -> None:
    signs = ("FILE", "OUT", "DIR", "DATA", ".csv", ".json", ".png", ".html", ".toml")
    for name in COMMANDS:
        for parameter in _command(name).params:
            words = (str(parameter.metavar or ""), str(getattr(parameter, "help", "") or ""))
            looks = any(sign in words[0] for sign in signs) or parameter.name in ("rig", "data", "study")
            assert not looks or isinstance(parameter.type, PATHS), (name, parameter.name)
            assert isinstance(parameter, click.Option) or isinstance(
                parameter.type, InputFile | OutputFile | click.Choice | click.Path
            ), (name, parameter.name)


def _process(*args: str, **options: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(  # type: ignore[call-overload, no-any-return]
        [sys.executable, "-m", "dashpot", *args], stderr=subprocess.PIPE, timeout=300, **options
    )


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_full_standard_output_is_told(dashpot: Command, tmp_path: Path) -> None:
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    for args in (["check", "rig.toml", "--json", "-"], ["--version"]):
        with open("/dev/full", "wb") as full:
            done = _process(*args, stdout=full, cwd=tmp_path)
        assert done.returncode == 2, args
        assert done.stderr.decode().splitlines() == [
            "dashpot: standard output: cannot be used (No space left on device); check the path and the space left"
        ]
    done = dashpot("check rig.toml --json /dev/full")
    assert done.code == 2
    assert "/dev/full: cannot be written (No space left on device)" in done.err[0]


@pytest.mark.slow
def test_closed_standard_streams_do_no_harm(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    done = subprocess.run(
        ["sh", "-c", f'"{sys.executable}" -m dashpot new other.toml <&- >&-'],
        cwd=tmp_path,
        timeout=300,
        stderr=subprocess.PIPE,
    )
    assert done.returncode == 2
    assert b"standard output" in done.stderr
    done = subprocess.run(
        ["sh", "-c", f'"{sys.executable}" -m dashpot check rig.toml --json out.json --quiet <&- 2>&-'],
        cwd=tmp_path,
        timeout=300,
    )
    assert done.returncode == 0
    assert (tmp_path / "out.json").read_text(encoding="utf-8").startswith("{\n")


def test_a_terminal_of_no_width(dashpot: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    monkeypatch.setenv("COLUMNS", "0")
    done = dashpot("check rig.toml")
    assert (done.code, done.err) == (0, [])


@pytest.mark.slow
def test_a_terminal_of_nonsense_sizes(data: Path) -> None:
    around = os.environ | {"COLUMNS": "²", "LINES": "9" * 5000}
    words = [sys.executable, "-m", "dashpot", "check", "rig.toml"]
    done = subprocess.run(words, capture_output=True, text=True, env=around, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_control_characters_of_names_labels_and_files_are_shown_escaped(dashpot: Command, data: Path) -> None:
    evil = "\u202eevil\x1b[31m\ufffe"
    rig = Path("rig.toml")
    named = json.dumps(f"T{evil}\n    -1\n")
    rig.write_text(re.sub("^name = .*", lambda _: f"name = {named}", rig.read_text("utf-8")), "utf-8")
    data.rename(f"{evil}.csv")
    told = dashpot("identify rig.toml --json out.json --report out.html --label", evil, f"{evil}.csv").out
    assert "T\\u202eevil\\x1b[31m\\ufffe -1\n" in told
    for to in ("out.uff", "out.m"):
        assert dashpot("export out.json -o", to).code == 0
    stored = json.loads(Path("out.json").read_text("utf-8")) | {"model": evil}  # not as dashpot writes it
    Path("out.json").write_text(json.dumps(stored), encoding="utf-8")
    told += dashpot("validate out.json --report valid.html", f"{evil}.csv").out
    for text in (told, *(Path(n).read_text("utf-8") for n in ("out.uff", "out.m", "out.html", "valid.html"))):
        assert "u202eevil" in text
        assert not set(evil) & set(text) - set("evil[31m")
