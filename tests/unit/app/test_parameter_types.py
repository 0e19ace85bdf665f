"""Values of options: the same syntax in every command, and extreme numbers refused in one line."""

from __future__ import annotations

import os
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import click
import pytest

from dashpot import quantities
from dashpot.app.commands import COMMANDS
from dashpot.app.files import InputFile, OutputFile, OutputFolder
from dashpot.app.parameter_types import Count, TextType
from dashpot.errors import UsageError
from tests.unit.app.conftest import Command

EXTREMES = ["1e200", "1e308", "-1e308", "nan", "-inf", "1e999", ""]
FORMS = ["{}", "m1={}", "1,{},5", "0.1:{}", "0.1:{}/5", "{}mm", "pick {} of x1,x2"]


def commands() -> dict[str, click.Command]:
    return {name: import_module(f"dashpot.app.commands.{name}").command for name in COMMANDS}


def numeric_options() -> list[tuple[str, str, str]]:
    """(command, option, form) for every option that takes a number or a quantity, in every form that it takes."""
    found = []
    for name, command in commands().items():
        for parameter in command.params:
            takes_value = isinstance(parameter, click.Option) and not parameter.is_flag
            if takes_value and not isinstance(
                parameter.type,
                InputFile | OutputFile | OutputFolder | click.Choice | click.types.StringParamType,
            ):
                found += [(name, parameter.opts[0], form) for form in FORMS if taken(parameter, form)]
    return found


def taken(parameter: click.Parameter, form: str) -> bool:
    """Whether a parameter takes numbers in a form: for 1, 2 or 10 of something."""
    for number in ("1", "2", "10", "10%"):
        with suppress(click.BadParameter):
            parameter.type.convert(form.format(number), parameter, None)
            return True
    return False


@pytest.mark.parametrize(("command", "option", "form"), numeric_options())
def test_extreme_numbers_are_refused_in_one_line(
    dashpot: Command, rig: Path, command: str, option: str, form: str
) -> None:
    for name in ("data.csv", "estimate.json"):  # never read
        Path(name).write_text("{}", encoding="utf-8")
    before = sorted(os.listdir())
    needed = {
        "identify": ["rig.toml", "data.csv"], "compare": ["rig.toml", "data.csv"], "check": ["rig.toml", "data.csv"],
        "simulate": ["rig.toml", "--out", "o.csv", "--frequencies", "3"], "design": ["rig.toml", "--samples", "100"],
        "spectrum": ["rig.toml", "data.csv", "--out", "o.csv"], "study": ["study.toml"], "reproduce": ["yamane1989"],
        "new": ["new.toml"], "validate": ["estimate.json", "data.csv"], "draw": ["rig.toml", "--out", "o.svg"],
        "export": ["rig.toml", "--out", "o.json"], "response": ["rig.toml", "--out", "o.svg"],
        "fleet": ["rig.toml", "data.csv", "--out", "o.parquet"],
    }  # fmt: skip
    for extreme in EXTREMES:
        value = form.format(extreme)
        done = dashpot(command, *needed[command], f"{option}={value}")
        assert done.code == 2, (option, value, done)
        assert done.out == ""
        assert len(done.err) == 1
        assert done.err[0].startswith("dashpot: ")
        assert "Traceback" not in done.err[0]
    assert sorted(os.listdir()) == before


def test_an_option_means_the_same_in_every_command() -> None:
    """Options of one name take the same type of value; those that differ are counted in different things on purpose."""
    kinds: dict[str, set[str]] = {}
    for command in commands().values():
        for parameter in command.params:
            for name in parameter.opts if isinstance(parameter, click.Option) else ():
                kinds.setdefault(name, set()).add(f"{parameter.type.name}, flag: {parameter.is_flag}")
    assert {name: found for name, found in kinds.items() if len(found) > 1} == {
        "--out": {"file, flag: False", "folder, flag: False"},
        "-o": {"file, flag: False", "folder, flag: False"},
    }


def test_per_cent_and_units_are_read_wherever_a_quantity_is(dashpot: Command, rig: Path) -> None:
    def written(*options: str) -> str:
        done = dashpot("simulate", "rig.toml", "-o", "out.csv", "--frequencies", "2,4", "-q", *options)
        assert done.code == 0, done.err
        return Path("out.csv").read_text(encoding="utf-8")

    plain = written(
        "--set", "m1=3", "--set", "c1=20", "--set", "c2=30", "--amplitude", "u=0.002", "--rate", "100"
    )
    assert plain == written(
        "--set", "m1=3 kg,c1=20 N·s/m,c2=0.03 N*s/mm", "--amplitude", "2 mm", "--rate", "0.1 kHz"
    )
    noisy = written("--set", "m1=3,c1=20,c2=30", "--relative-noise", "5%")
    assert noisy == written("--set", "m1=3,c1=20,c2=30", "--relative-noise", "0.05")


def test_levels_in_per_cent_or_as_shares(dashpot: Command, data: Path) -> None:
    texts = {
        dashpot("identify", "rig.toml", "data.csv", "--level", level).out for level in ("90", "90%", "0.9")
    }
    assert len(texts) == 1
    assert "90 % interval" in texts.pop()


def test_words_of_a_type_stand_beside_its_values() -> None:
    kind = TextType("time", float, words=("auto", "none"))
    assert kind.convert(" auto ", None, None) == "auto"
    assert kind.convert("2", None, None) == 2.0


def test_commas_of_whole_numbers_part_thousands() -> None:
    """A comma that is a decimal sign elsewhere made 15 of 1,5."""
    assert Count(0).convert("1,000,000", None, None) == 1_000_000
    for text in ("1,5", "1,,5", "12,34", "1,0000", ",1"):
        with pytest.raises(click.BadParameter, match="is not a whole number"):
            Count(0).convert(text, None, None)
        with pytest.raises(UsageError, match="is not a quantity"):
            quantities.amount(text)


@pytest.mark.parametrize(("option", "value"), [("--settle", "auto"), ("--refine", "always")])
def test_a_treatment_may_be_named_alone_anywhere(
    dashpot: Command, data: Path, option: str, value: str
) -> None:
    whole = dashpot("spectrum", "rig.toml", "data.csv", "-o", "a.csv", option, value)
    assert whole.code == 0, whole.err
    for args in (
        (option, "rig.toml", "data.csv"),
        ("rig.toml", "data.csv", option),
        ("rig.toml", option, "data.csv"),
    ):
        assert dashpot("spectrum", *args, "-o", "b.csv").code == 0
        assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()


def test_a_stated_settling_time_is_discarded(dashpot: Command, data: Path) -> None:
    kept = dashpot("spectrum", "rig.toml", "data.csv", "-o", "a.csv", "--settle", "none")
    cut = dashpot("spectrum", "rig.toml", "data.csv", "-o", "b.csv", "--settle", "100 ms")
    assert kept.code == cut.code == 0
    assert Path("a.csv").read_bytes() != Path("b.csv").read_bytes()
