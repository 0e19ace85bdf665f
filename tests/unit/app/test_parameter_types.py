"""Values of options: the same syntax in every command, and extreme numbers refused in one line."""

import json
import os
from contextlib import suppress
from importlib import import_module
from itertools import product
from pathlib import Path

import click
import pytest

from dashpot import quantities
from dashpot.app import options as types
from dashpot.app.commands import COMMANDS
from dashpot.app.options import Count, InputFile, OutputFile, OutputFolder, TextType
from dashpot.errors import UsageError
from dashpot.model.rigfile import read_rig
from tests.unit.app.conftest import Command

EXTREMES = ["1e200", "1e308", "-1e308", "nan", "-inf", "1e999", ""]
FORMS = ["{}", "m1={}", "1,{},5", "0.1:{}", "0.1:{}/5", "{}mm", "pick {} of x1,x2"]


def commands() -> dict[str, click.Command]:
    return {name: import_module(f"dashpot.app.commands.{name}").command for name in COMMANDS}


def numeric_options() -> dict[str, tuple[str, str, list[str]]]:
    """(command, option, forms that it takes) for every type of option that takes a number or a quantity."""
    found = {}
    others = InputFile | OutputFile | OutputFolder | click.Choice | click.types.StringParamType
    for name, command in commands().items():
        for parameter in command.params:
            takes_value = isinstance(parameter, click.Option) and not parameter.is_flag
            if takes_value and not isinstance(parameter.type, others):
                forms = [form for form in FORMS if taken(parameter, form)]
                found.setdefault(repr(vars(parameter.type)), (name, parameter.opts[0], forms))
    return {f"{command} {option}": (command, option, forms) for command, option, forms in found.values()}


def taken(parameter: click.Parameter, form: str) -> bool:
    """Whether a parameter takes numbers in a form: for 1, 2 or 10 of something."""
    for number in ("1", "2", "10", "10%"):
        with suppress(click.BadParameter):
            parameter.type.convert(form.format(number), parameter, None)
            return True
    return False


@pytest.mark.parametrize("case", numeric_options())
def test_extreme_numbers_are_refused_in_one_line(dashpot: Command, rig: Path, case: str) -> None:
    command, option, forms = numeric_options()[case]
    for name in ("data.csv", "estimate.json"):  # never read
        Path(name).write_text("{}", encoding="utf-8")
    before = sorted(os.listdir())
    needed = {
        "identify": ["rig.toml", "data.csv"], "compare": ["rig.toml", "data.csv"], "check": ["rig.toml", "data.csv"],
        "simulate": ["rig.toml", "--out", "o.csv", "--frequencies", "3"], "design": ["rig.toml", "--samples", "100"],
        "spectrum": ["rig.toml", "data.csv", "--out", "o.csv"], "study": ["study.toml"], "reproduce": ["yamane1989"],
        "new": ["new.toml"], "validate": ["estimate.json", "data.csv"], "draw": ["rig.toml", "--out", "o.svg"],
        "export": ["rig.toml", "--out", "o.json"], "response": ["rig.toml", "--out", "o.svg"],
        "fleet": ["rig.toml", "data.csv", "--out", "o.parquet"], "start": ["data.csv", "--out", "n.toml"],
        "frf": ["data.csv"], "modes": ["data.csv"], "track": ["rig.toml", "data.csv", "--window", "1s"],
        "serve": [],
    }  # fmt: skip
    for form, extreme in product(forms, EXTREMES):
        value = form.format(extreme)
        done = dashpot(command, *needed[command], f"{option}={value}")
        assert done.code == 2, (option, value, done)
        assert done.out == ""
        assert len(done.err) == 1
        assert f"'{option}'" in done.err[0], done.err  # not what the files say
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
        "--input": {"file, flag: False", "text, flag: False"},  # a file, or a channel
    }


# What each type of a quantity takes, the same value in other words.
IN_OTHER_WORDS = {
    types.FREQUENCIES: ("1000,1500,2000", "1:2:0.5 kHz", "1:2 kHz/3", "1000, 1.5 kHz, 2e3"),
    types.FREQUENCY: ("2500", "2.5 kHz", "2500 Hz", "0.0025 MHz"),
    types.BAND: ("500:2500", "0.5:2.5 kHz"),
    types.TIME: ("0.09", "90 ms", "0.0015 min"),
    types.SETTLING: ("0.09", "90 ms"),
    types.MASS: ("0.25", "250 g"),
    types.SHARE: ("0.05", "5%", "5 %"),
    types.SHARE_OR_ZERO: ("0", "0%"),
    types.PART: ("0.2", "20%"),
    types.LEVEL: ("0.95", "95%", "95"),
    types.TARGET: ("m1=0.01,c1=0.05", "m1=1%,c1=5%"),
    types.SPEED: ("k=0.01,c=0", "k=1%,c=0%"),
    types.MODAL_SD: ("0.01,0.2,0.05", "1%,20%,5%"),
}
IN_UNITS_OF_THE_RIG = {  # an angle or a length: only the rig tells
    types.AMOUNT: lambda text: types.AMOUNT.convert(text, None, None).si("displacement"),
    types.AMPLITUDE: lambda text: types.AMPLITUDE.convert(f"u={text}", None, None)["u"].si("displacement"),
    types.AMOUNTS: lambda text: types.AMOUNTS.convert(f"m1={text}", None, None)["m1"].si("displacement"),
}
COUNTED = (types.NUMBER, types.ORDERS, types.HARMONICS, types.SENSORS)  # periods, multiples, sensors


def test_every_quantity_of_every_command_takes_units_or_per_cent() -> None:
    """A new type of option has to be added above; no option takes a quantity as bare text."""
    texts = set[str]()
    for command in commands().values():
        for parameter in command.params:
            kind = parameter.type
            if isinstance(kind, TextType):
                assert kind in {*IN_OTHER_WORDS, *IN_UNITS_OF_THE_RIG, *COUNTED}, parameter.name
            elif isinstance(kind, click.types.StringParamType):
                texts.add(parameter.opts[0])
    assert texts == {
        "--methods", "--profile", "--for",  # names of methods, parameters and criteria
        "--name", "--unit", "--rig-column", "--dask", "--drive", "--label", "--experiment",
        "--force-at", "--base", "--input", "--output", "--host",
    }  # fmt: skip


@pytest.mark.parametrize("kind", IN_OTHER_WORDS, ids=lambda kind: str(kind.name))
def test_the_same_quantity_in_other_words(kind: TextType) -> None:
    plain, *others = (kind.convert(text, None, None) for text in IN_OTHER_WORDS[kind])
    for other in others:
        assert other == pytest.approx(plain, rel=1e-12)


@pytest.mark.parametrize("kind", IN_UNITS_OF_THE_RIG, ids=lambda kind: str(kind.name))
def test_the_same_quantity_of_a_rig_in_other_words(kind: TextType) -> None:
    read = IN_UNITS_OF_THE_RIG[kind]
    assert read("2 mm") == pytest.approx(read("0.002"), rel=1e-12)


def test_a_range_is_by_its_step_in_every_command(dashpot: Command, rig: Path) -> None:
    """1:10:3 was three points in one command and a step of 3 in another."""
    assert types.FREQUENCIES.convert("1:10:3", None, None) == (1.0, 4.0, 7.0, 10.0)
    by_command = {
        "simulate": ("-q", "-o", "out.csv", "--frequencies"),
        "export": ("-q", "-o", "out.csv", "--to", "frequency-responses", "--frequencies"),
        "design": ("--samples", "400", "--json", "out.csv", "--against"),
    }
    for command, words in by_command.items():
        outputs = []
        for text in ("1:10:3", "1,4,7,10", "1:10/4"):
            done = dashpot(command, "rig.toml", "--set", "m1=3,c1=20,c2=30", *words, text)
            assert done.code == 0, (command, done.err)
            outputs.append(Path("out.csv").read_text(encoding="utf-8"))
            Path("out.csv").unlink()
        assert len(set(outputs)) == 1, command


def test_records_are_conditioned_alike_in_every_command() -> None:
    """Whoever reads records has all options that `identify` has for them, and those mean the same (above)."""
    own = {"--hold-out", "--modal-sd", "--experiment"}
    parameters = {name: command.params for name, command in commands().items()}
    conditioning = {
        parameter.opts[0]
        for parameter in parameters["spectrum"]
        if isinstance(parameter, click.Option) and parameter.opts[0].startswith("--")
    } - {"--out", "--quiet", "--help", *own}
    assert conditioning >= {"--settle", "--refine", "--drift", "--noise", "--orders", "--frequency", "--band"}
    for name in ("identify", "compare", "check", "validate", "export", "fleet", "design"):
        taken = {option for parameter in parameters[name] for option in parameter.opts}
        assert conditioning <= taken, name


@pytest.mark.slow
def test_design_after_records_conditions_them_as_identify_does(dashpot: Command, data: Path) -> None:
    """What --settle discards counts as measured in neither."""
    counted = {}
    for settle in ("none", "200 ms"):
        told = dashpot("design rig.toml --samples 400 --after data.csv --target 1% --json - --settle", settle)
        assert told.code == 0, told.err
        assert dashpot("spectrum", "rig.toml", "data.csv", "-o", "a.csv", "--settle", settle).code == 0
        spectrum = read_rig("rig.toml").read("a.csv").spectrum()
        counted[settle] = (json.loads(told.out)["so_far"]["samples"][-1], int(spectrum.samples.sum()))
    for design, identify in counted.values():
        assert design == identify
    assert counted["200 ms"][0] < counted["none"][0]


def test_commas_of_whole_numbers_part_thousands() -> None:
    """A comma that is a decimal sign elsewhere made 15 of 1,5."""
    assert Count(0).convert("1,000,000", None, None) == 1_000_000
    for text in ("1,5", "1,,5", "12,34", "1,0000", ",1"):
        with pytest.raises(click.BadParameter, match="is not a whole"):
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
