"""No output of a call is an input of it, whatever the command and the option; and outputs that are full or closed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import click
import pytest

from dashpot.app.commands import COMMANDS
from dashpot.app.files import InputFile, OutputFile, OutputFolder
from tests.unit.app.conftest import RIG, Command

PATHS = (InputFile, OutputFile, OutputFolder)
# What a call needs beside its files, by the name of the parameter.
NEEDED = {"frequencies": "1,2,5", "paper": "yamane1989"}


def _command(name: str) -> click.Command:
    found = import_module(f"dashpot.app.commands.{name}").command
    assert isinstance(found, click.Command)
    return found


def _pairs() -> Iterator[tuple[str, str, str]]:
    for name in COMMANDS:
        parameters = _command(name).params
        for one in parameters:
            for other in parameters:
                if isinstance(one.type, OutputFile) and isinstance(other.type, InputFile):
                    assert one.name
                    assert other.name
                    yield name, one.name, other.name


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


@pytest.mark.parametrize("kind", ["same", "spelling", "symlink", "hard link"])
@pytest.mark.parametrize(("name", "output", "source"), list(_pairs()))
def test_no_output_is_an_input(dashpot: Command, name: str, output: str, source: str, kind: str) -> None:
    end = _end(_parameter(name, output))
    precious, soft, hard = (f"{stem}.{end}" for stem in ("precious", "soft", "hard"))
    Path(precious).write_text("measured", encoding="utf-8")
    other = {
        "same": precious,
        "spelling": f"../{Path.cwd().name}/./{precious}",
        "symlink": soft,
        "hard link": hard,
    }[kind]
    os.symlink(precious, soft)
    os.link(precious, hard)
    ran = dashpot(name, *_arguments(_command(name), {output: other, source: precious}))
    assert ran.code == 2, ran.err
    assert "this would overwrite a file that is read" in ran.err[0]
    assert len(ran.err) == 1
    assert Path(precious).read_text(encoding="utf-8") == "measured"


def test_two_outputs_are_two_files(dashpot: Command) -> None:
    for name in COMMANDS:
        outputs = [p.name for p in _command(name).params if isinstance(p.type, OutputFile) and p.name]
        for one in outputs:
            for other in outputs:
                if one != other:
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
        "compare", "design", "draw", "fleet", "identify", "response", "validate",
    }  # fmt: skip


@pytest.mark.parametrize(("name", "output"), list(_of_formats()))
def test_a_name_that_ends_in_no_format_is_refused_before_anything_is_read(
    dashpot: Command, name: str, output: str
) -> None:
    for target in ("out", "out.docx", "out.png.txt"):
        ran = dashpot(name, *_arguments(_command(name), {output: target}))  # of files that do not exist
        assert ran.code == 2
        assert len(ran.err) == 1
        assert f"{target}: the end of the name chooses the format; end it in ." in ran.err[0]
        assert not Path(target).exists()


def test_every_parameter_that_names_a_file_has_a_type_that_says_so() -> None:
    signs = ("FILE", "OUT", "DIR", "DATA", ".csv", ".json", ".png", ".html", ".toml")
    for name in COMMANDS:
        for parameter in _command(name).params:
            words = (str(parameter.metavar or ""), str(getattr(parameter, "help", "") or ""))
            looks = any(sign in words[0] for sign in signs) or parameter.name in ("rig", "data", "study")
            assert not looks or isinstance(parameter.type, PATHS), (name, parameter.name)
            assert isinstance(parameter, click.Option) or isinstance(
                parameter.type, InputFile | OutputFile | click.Choice
            ), (name, parameter.name)


def test_the_data_of_a_comparison_are_kept(dashpot: Command, rig: Path, data: Path) -> None:
    before = data.read_bytes()
    ran = dashpot("design", "rig.toml", "--samples", "500", "--against", "data.csv", "--csv", "data.csv")
    assert ran.code == 2
    assert data.read_bytes() == before


def _process(*args: str, **options: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(  # type: ignore[call-overload, no-any-return]
        [sys.executable, "-m", "dashpot", *args], stderr=subprocess.PIPE, timeout=120, **options
    )


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_full_standard_output_is_told(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    for args in (
        ["check", "rig.toml"],
        ["check", "rig.toml", "--json", "-"],
        ["--version"],
        ["check", "--help"],
    ):
        with open("/dev/full", "wb") as full:
            done = _process(*args, stdout=full, cwd=tmp_path)
        assert done.returncode == 2, args
        assert done.stderr.decode().splitlines() == [
            "dashpot: standard output: cannot be used (No space left on device); check the path and the space left"
        ]
    done = _process("check", "rig.toml", "--json", "/dev/full", stdout=subprocess.PIPE, cwd=tmp_path)
    assert done.returncode == 2
    assert b"/dev/full: cannot be written (No space left on device)" in done.stderr


def test_closed_standard_streams_do_no_harm(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    done = subprocess.run(
        ["sh", "-c", f'"{sys.executable}" -m dashpot check rig.toml --json out.json <&- >&- 2>&-'],
        cwd=tmp_path,
        timeout=120,
    )
    assert done.returncode == 0
    assert (tmp_path / "out.json").read_text(encoding="utf-8").startswith("{\n")
    done = subprocess.run(
        ["sh", "-c", f'"{sys.executable}" -m dashpot new other.toml <&-'], cwd=tmp_path, timeout=120
    )
    assert done.returncode == 0


def test_a_terminal_of_no_width(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    monkeypatch.setenv("COLUMNS", "0")
    done = _process("check", "rig.toml", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_pipe_gets_the_json(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    done = _process(
        "check", "rig.toml", "--json", "/dev/stdout", "--quiet", stdout=subprocess.PIPE, cwd=tmp_path
    )
    assert done.returncode == 0
    assert done.stdout.startswith(b"{\n")


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_a_signal_leaves_nothing_behind(tmp_path: Path, name: str) -> None:
    (tmp_path / "out").write_text("old", encoding="utf-8")
    code = f"""
import os, signal, sys, time
from dashpot.app import cli
from dashpot.io.atomic import write_bytes
def parts():
    yield b"half"
    assert len(os.listdir()) == 2, "no temporary file while writing"
    os.kill(os.getpid(), signal.{name})
    time.sleep(20)
    yield b"of it"
cli.cli.main = lambda *_, **__: write_bytes("out", parts())
cli.main()
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, timeout=60, capture_output=True)
    assert done.returncode == 128 + getattr(signal, name)
    assert b"no file is left half-written" in done.stderr
    assert os.listdir(tmp_path) == ["out"]
    assert (tmp_path / "out").read_text(encoding="utf-8") == "old"
