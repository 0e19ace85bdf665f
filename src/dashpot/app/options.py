"""Options and arguments of commands: what their values may be, how they are declared, and those that several take.

An option is the type of a parameter: `level: Level`, or `Annotated[bool, Option("--strict"), "what it does"]` where one
command alone takes it.  Options that go together are the fields of a frozen dataclass, which a command takes as one.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import click
from click.shell_completion import CompletionItem

from dashpot import quantities
from dashpot.app.process import tell
from dashpot.errors import Problem, UsageError, printable
from dashpot.estimate.registry import METHODS
from dashpot.io import ledger
from dashpot.io.words import PICTURES, chosen_format, names_in
from dashpot.quantities import Amount, quantity_of_unit

if TYPE_CHECKING:
    from dashpot.model.network import Model
    from dashpot.model.rigfile import Rig
    from dashpot.present.document import Document

# Files and folders: checked before the work starts.
#
# A parameter that names a file or folder has one of these types, by which no output of a call can be an
# input of it: each input and output is entered in the run's ledger, whichever comes first, and what clashes
# is refused.


STDOUT = "-"  # as the name of a file to write


class PathType(click.ParamType[str]):
    """A file or a folder; its completion is left to the shell."""

    name = "file"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """What asks the shell to go on."""
        return [CompletionItem(incomplete, type="dir" if self.name == "folder" else "file")]


class InputFile(PathType):
    """A file that is read; with `or_text`, what names none is a text with a meaning of its own.

    Whether a file is there, its reader says.
    """

    def __init__(self, or_text: bool = False) -> None:
        self.or_text = or_text

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path or the text.  Raises UsageError if it is an output of the same call."""
        text = str(value)
        return text if self.or_text and not os.path.exists(text) else ledger.noted(text)


class OutputFile(PathType):
    """A file to write; with `stdout`, - is standard output; with `new`, one that is there already is not replaced.

    Where there are `formats`, its name ends in one of them.
    """

    def __init__(self, stdout: bool = False, new: bool = False, formats: Sequence[str] = ()) -> None:
        self.stdout, self.new, self.formats = stdout, new, tuple(formats)

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path.  Raises UsageError if it could not be written after the work, or must not be."""
        target = str(value)
        if self.stdout and target == STDOUT:
            return target
        if not target or os.path.isdir(target):
            raise UsageError("this is a folder", target or '""', "name a file in it")
        if "\0" in target:
            raise UsageError("a null character in a path", target, "name another file")
        there = os.path.exists(target)
        folder = Path(target).parent if there else Path(os.path.realpath(target)).parent
        if not os.path.isdir(folder):
            raise UsageError(f"the folder {folder} does not exist", target, "create it, or name another file")
        special = there and not os.path.isfile(target)
        writable = os.access(target if special else folder, os.W_OK)
        if not writable or (there and not os.access(target, os.W_OK)):
            raise UsageError(
                "no permission to write this file", target, "change its permissions, or name another file"
            )
        if self.new and os.path.isfile(target):
            raise UsageError("a file of this name exists", target, "name another file, or remove this one")
        entries = ledger.current()
        if entries is not None:
            entries.claim(target, id(self) if param is None else param.name)
        if self.formats:
            chosen_format(target, self.formats)
        return target


class OutputFolder(PathType):
    """A folder that is made where it is missing.  What is written into it is checked when it is."""

    name = "folder"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path.  Raises UsageError if the folder cannot be made: its parent must exist."""
        target = str(value)
        if not target or "\0" in target:
            raise UsageError("this is not the name of a folder", target or '""', "name another folder")
        path, there = Path(target), os.path.exists(target)
        if there and not os.path.isdir(target):
            raise UsageError("this is a file, not a folder", target, "name another folder")
        if not there and not os.path.isdir(path.absolute().parent):
            raise UsageError(f"the folder {path.parent} does not exist", target, "create it, or name another")
        return target


def write_result(target: str | None, text: str) -> None:
    """Write a result to a file, to stdout for "-", or nowhere for None.  Raises DataError."""
    from dashpot.io.atomic import write_text

    if target == STDOUT:
        click.echo(text, nl=False)
    elif target is not None:
        write_text(target, text)


def tell_written(*paths: str | None) -> None:
    """One line that names the files that were written; none where all are None."""
    if named := [printable(path) for path in paths if path is not None]:
        tell(f"Written: {', '.join(named)}", err=False)


def tell_result(
    json_out: str | None, text: str, document: Callable[[], Document], quiet: bool, *, apart: bool = False
) -> None:
    """Write a result as JSON where that is asked for, and print it in words unless `quiet` or JSON goes there."""
    write_result(json_out, text)
    if not quiet and json_out != STDOUT:
        from dashpot.present.document import say

        say(document(), apart=apart)


# What options and arguments take: one type for each kind of value, the same in every command.
#
# Quantities, shares and lists of frequencies are read by `dashpot.quantities`; what it refuses becomes a
# usage error that names the option.


_THOUSANDS = re.compile(r"\d{1,3}(,\d{3})+")

Value = TypeVar("Value")


class TextType(click.ParamType[Any]):
    """A value read from text by `parse`; a UsageError of it is one of the command line."""

    def __init__(self, name: str, parse: Callable[[str], Any], words: Sequence[str] = ()) -> None:
        self.name = name
        self._parse = parse
        self.words = tuple(words)

    def or_words(self, *words: str) -> TextType:
        """The same type that also takes some words."""
        return TextType(self.name, self._parse, words)

    def or_by_name(self, *words: str) -> TextType:
        """One value for all or NAME=VALUE,…, or some words."""

        def parsed(text: str) -> Any:
            return _pairs(self._parse, text) if "=" in text else self._parse(text)

        return TextType(self.name, parsed, words)

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The value, or one of `words` as it is; values that are not text were converted before."""
        if not isinstance(value, str):
            return value
        if value.strip() in self.words:
            return value.strip()
        try:
            return self._parse(value)
        except UsageError as error:
            problem = error.problems[0]
            cure = problem.cure or ""
            if self.words:
                cure = f"{cure}, or {' or '.join(self.words)}"
            self.fail(f"{problem.what}; {cure}", param, ctx)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The words that the type takes in addition to values."""
        return [CompletionItem(word) for word in self.words if word.startswith(incomplete)]


def _positive(parse: Callable[[str], Any], text: str) -> Any:
    """The number or Amount that `parse` reads, above 0."""
    value = parse(text)
    quantities.positive(value.number if isinstance(value, Amount) else value, text)
    return value


def _from_zero(parse: Callable[[str], float], zero: str, text: str) -> float:
    """What `parse` reads, `zero` or above."""
    value = parse(text)
    if value < 0:
        raise UsageError(f"{text.strip()!r} is negative", cure=f"give {zero} or more")
    return value


def _part(text: str) -> float:
    value: float = _positive(quantities.fraction, text)
    if value >= 1:
        raise UsageError(f"{text.strip()!r} is out of range", cure="give less than 100%")
    return value


def _number(text: str) -> float:
    given = quantities.amount(text)
    if given.unit is not None:
        raise UsageError(f"{text.strip()!r} is not a plain number", cure="write it without a unit")
    return quantities.positive(given.number, text)


def _level(text: str) -> float:
    """95, 95% and 0.95 are all 0.95: an interval of less than 1 % is nobody's wish."""
    value = quantities.fraction(text)
    value = value / 100 if not text.strip().endswith("%") and value >= 1 else value
    if not 0 < value < 1:
        raise UsageError(f"{text.strip()!r} is out of range", cure="write a level such as 95% or 0.95")
    return value


def _whole_numbers(text: str) -> tuple[int, ...]:
    """1,3,5 or a range 1:9:2."""
    try:
        found: list[int] = []
        for part in text.split(","):
            ends = [int(piece) for piece in part.split(":")]
            found += ends if len(ends) == 1 else range(ends[0], ends[1] + 1, *ends[2:])
    except (ValueError, TypeError, IndexError):
        found = []
    if not found or min(found) < 1 or max(len(found), *found) > 1000:  # no record shows so many
        raise UsageError(f"{text.strip()!r} is not a list of multiples", cure="write them as 1,3,5 or 1:9:2")
    return tuple(dict.fromkeys(found))


def _pairs(parse: Callable[[str], Value], text: str) -> dict[str, Value]:
    """NAME=VALUE,NAME=VALUE,… with each VALUE read by `parse`."""
    found: dict[str, Value] = {}
    for part in text.split(","):
        name, equals, written = part.partition("=")
        name = name.strip()
        if not name or not equals:
            raise UsageError(f"{part.strip()!r} is not NAME=VALUE", cure="write it as m1=3,c1=30")
        if name in found:
            raise UsageError(f"{name} is given twice", cure="give it once")
        found[name] = parse(written)
    return found


def _sensors(text: str) -> tuple[int, tuple[str, ...]]:
    """ "pick 3 of a,b,c": how many, and from which (none: from all)."""
    match = re.fullmatch(r"\s*(?:pick\s+)?(\d{1,6})(?:\s+of\s+(.+))?\s*", text)
    if match is None:
        raise UsageError(f"{text!r} is not a choice of sensors", cure='write it as "pick 3 of a,b,c,d"')
    return int(match[1]), names(match[2] or "")


def _three_shares(text: str) -> tuple[float, float, float]:
    shares = [_positive(quantities.fraction, part) for part in text.split(",")]
    if len(shares) != 3:
        raise UsageError(f"{text!r} is not three shares", cure="write them as 1%,20%,5%")
    return shares[0], shares[1], shares[2]


def names(*texts: str) -> tuple[str, ...]:
    """Names separated by commas, of an option that is given several times all."""
    return tuple(name for text in texts for name in names_in(text))


_time = partial(quantities.quantity, kind="time")
_mass = partial(quantities.quantity, kind="mass")

FREQUENCIES = TextType("frequencies", quantities.frequencies)
FREQUENCY = TextType("frequency", quantities.frequency)
BAND = TextType("lower:upper", quantities.band)
TIME = TextType("time", partial(_positive, _time))
MASS = TextType("mass", partial(_positive, _mass))
SETTLING = TextType("time", partial(_from_zero, _time, "0"), words=("auto", "none"))
AMOUNT = TextType("quantity", partial(_positive, quantities.amount))  # in SI only where the rig is known
AMOUNTS = TextType("name=value", partial(_pairs, quantities.amount))
AMPLITUDE = AMOUNT.or_by_name()
SHARE = TextType("share", partial(_positive, quantities.fraction))
SHARE_OR_ZERO = TextType("share", partial(_from_zero, quantities.fraction, "0%"))
PART = TextType("share", _part)
NUMBER = TextType("number", _number)
LEVEL = TextType("level", _level)
ORDERS = TextType("orders", _whole_numbers, words=("auto",))
HARMONICS = TextType("orders", _whole_numbers, words=("auto", "none"))
TARGET = SHARE.or_by_name()
SPEED = SHARE_OR_ZERO.or_by_name("auto")
MODAL_SD = TextType("shares", _three_shares)
SENSORS = TextType("choice", _sensors)
INPUT_FILE = InputFile()
INPUT_FILE_OR = InputFile(or_text=True)
FOLDER = OutputFolder()


class Count(click.ParamType[int]):
    """A whole number from `least` to `most`; 1e6 and 1,000,000 are read too."""

    name = "number"

    def __init__(self, least: int, most: int = 1_000_000_000) -> None:
        self.least, self.most = least, most

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """The number."""
        if isinstance(value, int):
            return value
        text = str(value).strip()
        try:
            number = float(text.replace(",", "") if _THOUSANDS.fullmatch(text) else text)
        except ValueError:
            number = float("nan")
        if not self.least <= number <= self.most or number != int(number):
            bounds = f"from {self.least:,} to {self.most:,}"
            self.fail(f"{text!r} is not a whole number {bounds}", param, ctx)
        return int(number)


# Commands made of functions: --help shows options in groups, in the order they are declared, and examples.


EVERYTHING = "dashpot.help_all"  # in the context's meta, where all options are asked for
GENERAL = "General"
OUTPUT = "Output"
RECORDS = "Time records (tables of amplitudes are used as they are)"


class Option:
    """How a parameter is written: an option under the heading `group` in --help or, without names, an argument.

    words       names, then what stands for the value: "--out -o FILE.csv"
    kind        type of the value; a parameter of type bool is a flag
    says        the help, around what is said of it where a command takes it
    alone       what the option means without a value, where that may be left out
    attributes  as of click
    """

    def __init__(
        self,
        words: str = "",
        kind: click.ParamType[Any] | None = None,
        group: str = GENERAL,
        *,
        says: str = "{}",
        alone: str | None = None,
        **attributes: Any,
    ) -> None:
        given = words.split()
        self.names = [word for word in given if word.startswith("-")]
        self.attributes = {"type": kind, **attributes}
        if len(self.names) < len(given):
            self.attributes["metavar"] = words.partition(f"{self.names[-1]} ")[2]
        self.group, self.says, self.alone = group, says, alone

    def parameter(self, name: str, value: object, text: str, group: str | None = None) -> click.Parameter:
        """The parameter of click, called `name` in the function, under another heading where one is given."""
        attributes = {"help": self.says.format(text), **self.attributes}
        if not self.names:
            return click.Argument([name], **attributes)
        if value is bool:
            attributes["is_flag"] = True
        shown = "default" in attributes
        given = [*self.names, name]
        return GroupedOption(given, group or self.group, self.alone, show_default=shown, **attributes)


class GroupedOption(click.Option):
    """An option that stands under the heading `group` in --help; without a value it means `alone`, if that is given."""

    def __init__(self, names: Sequence[str], group: str, alone: str | None, **attributes: Any) -> None:
        super().__init__(names, **attributes)
        self.group, self.alone = group, alone


def _declared(hints: Mapping[str, Any]) -> Iterator[click.Parameter]:
    """The parameters of click among the annotations of a function or a dataclass, and in dataclasses among them."""
    for name, hint in hints.items():
        if is_dataclass(hint):
            yield from _declared(get_type_hints(hint, include_extras=True))
        elif hasattr(hint, "__metadata__"):
            option, text, *group = hint.__metadata__
            yield option.parameter(name, hint.__origin__, text, *group)


class GroupedCommand(click.Command):
    """A command made of a function, whose parameters say how they are typed; `examples` are printed below its options.

    `usual`: the options that --help shows, where they are many; --help-all then shows them all.  A parameter that is a
    dataclass holds options that go together; its other fields are parameters of the function.
    Of options of the same name the one that is declared first is the command's; the other is never given.
    """

    def __init__(
        self, function: Callable[..., Any], examples: Sequence[str] = (), usual: Sequence[str] = ()
    ) -> None:
        self.examples, self.usual = tuple(examples), tuple(usual)
        self.function, self.hints = function, get_type_hints(function, include_extras=True)
        self.hints.pop("return", None)
        params: list[click.Parameter] = []
        taken: set[str] = set()
        for each in _declared(self.hints):
            if taken.isdisjoint(each.opts):
                params.append(each)
                taken.update(each.opts)
        if self.usual:

            def show(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
                if wanted and not ctx.resilient_parsing:
                    ctx.meta[EVERYTHING] = True
                    click.echo(ctx.get_help(), color=ctx.color)
                    ctx.exit()

            help_text = "Show all options and exit."
            params.append(
                click.Option(
                    ["--help-all"],
                    is_flag=True,
                    is_eager=True,
                    expose_value=False,
                    callback=show,
                    help=help_text,
                )
            )
        name = function.__module__.rpartition(".")[2]
        super().__init__(name, callback=self.called, params=params, help=function.__doc__)

    def called(self, **given: Any) -> Any:
        """Call the function, with options that go together as one value, and the context where it asks for it."""
        for name, hint in self.hints.items():
            if isinstance(hint, type) and is_dataclass(hint):
                given[name] = hint(**{each.name: given.get(each.name) for each in fields(hint)})
            elif hint is click.Context:
                given[name] = click.get_current_context()
        json = given.get("json_out")
        if json not in (None, STDOUT):
            from dashpot.io.atomic import require_json_or_nothing

            require_json_or_nothing(json)
        return self.function(**{name: given[name] for name in self.hints})

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As click does; an option whose value may be left out takes the next word only if it is such a value."""
        for parameter in self.get_params(ctx):
            if isinstance(parameter, GroupedOption) and parameter.alone is not None:
                following = [*args[1:], ""]
                args = [_complete(parameter, ctx, word, following[k]) for k, word in enumerate(args)]
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            error.ctx = error.ctx or ctx  # click names none where a value is missing
            raise

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Options by group: in the order of their first option, the general ones last."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None and self._shows(ctx, parameter):
                groups.setdefault(getattr(parameter, "group", GENERAL), []).append(record)
        groups[GENERAL] = groups.pop(GENERAL, [])
        for title, records in groups.items():
            with formatter.section(title):
                formatter.write_dl(records)

    def _shows(self, ctx: click.Context, parameter: click.Parameter) -> bool:
        """Whether an option stands in this help: all do but where the usual ones of many are shown."""
        general = getattr(parameter, "group", GENERAL) == GENERAL and len(parameter.opts) > 0
        chosen = general and not isinstance(parameter, GroupedOption)  # --help, --help-all
        return (
            not self.usual
            or EVERYTHING in ctx.meta
            or chosen
            or not set(self.usual).isdisjoint(parameter.opts)
        )

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Examples; a long one goes on in the next line as a shell reads it, for they are to be copied."""
        with formatter.section("Examples"):
            indent = " " * formatter.current_indent
            for example in self.examples:
                lines = [""]  # each at most as wide as the terminal, broken before an option
                for part in re.split(r" (?=-)", example):
                    if lines[-1] and len(lines[-1]) + len(part) + 3 > formatter.width - 2 * len(indent):
                        lines.append(part)
                    else:
                        lines[-1] = f"{lines[-1]} {part}".strip()
                formatter.write(indent + f" \\\n{indent}    ".join(lines) + "\n")


def _complete(option: GroupedOption, ctx: click.Context, word: str, following: str) -> str:
    """The option with its value where it stands alone; every other word as it is."""
    if word not in option.opts:
        return word
    try:
        option.type.convert(following, option, ctx)
    except click.UsageError:
        return f"{word}={option.alone}"
    return word


def dashpot_command(
    *examples: str, usual: Sequence[str] = ()
) -> Callable[[Callable[..., Any]], GroupedCommand]:
    """Decorator: the function as a command of its module's name; of many options --help shows the `usual` ones."""
    return partial(GroupedCommand, examples=examples, usual=usual)


# Options that several commands take: the same name, type, words and meaning in each.


NOT_CONVERGED = 3  # exit code
DOES_NOT_FIT = 4  # exit code of a verdict that was asked to count

# Several commands say in their own words what these are for.
FILES, NEEDED_FILES = (Option("", INPUT_FILE, nargs=-1, required=needed) for needed in (False, True))
DATA = "Data files of any format, or a manifest (TOML): time records, amplitudes, frequency responses."
JSON = Option(
    "--json FILE",
    OutputFile(stdout=True),
    OUTPUT,
    says="Write {} as JSON; - writes it to stdout instead of the text.",
)
FIGURE = Option("--figure FILE.svg|png|pdf", OutputFile(formats=PICTURES), OUTPUT)
SEED = Option(
    "--seed N", Count(0, 2**63 - 1), default=0, says="Seed of {}; the same seed gives the same result."
)
SET = Option(
    "--set NAME=VALUE,…",
    AMOUNTS,
    "The rig",
    multiple=True,
    says="{}, such as m1=3,k1=4.6kN/m; a bare number is in SI units.  May be repeated.",
)
VALUES = "Values of the unknowns, instead of those of the rig file"  # of SET

RigFile = Annotated[str, Option("", INPUT_FILE), "Rig file (TOML): coordinates, elements, channels."]
Experiment = Annotated[
    str | None,
    Option("--experiment NAME", None, "The rig"),
    "The rig as it is in this experiment of the rig file.  [default: outside all experiments]",
]
Method = Annotated[
    str,
    Option("--method", click.Choice(["auto", *METHODS]), "Estimation", default="auto"),
    "Estimator.  auto takes oiv if every coordinate and input is measured and no unknown has bounds, else ml.",
]
Positive = Annotated[
    bool,
    Option("--positive", None, "Estimation"),
    "Keep every unknown at or above 0 (except entries of free matrices); uses ml.",
]
RelativeNoise = Annotated[
    float | None,
    Option("--relative-noise 5%", SHARE_OR_ZERO, "Noise"),
    "Noise of a sample as a share of the amplitude, for every output, instead of the rig file's noise.",
]
ModalSd = Annotated[
    tuple[float, float, float],
    Option("--modal-sd FREQUENCY,DAMPING,SHAPE", MODAL_SD, "Measured modes", default="1%,20%,5%"),
    "Standard deviations of modes in universal files, which state none: of frequencies, of damping ratios, and "
    "of shapes relative to their largest entry.",
]
Workers = Annotated[
    int | None,
    Option("--workers --processes N", Count(1, 1024)),
    "Worker processes.  [default: one per processor]",
]
Dask = Annotated[
    str | None,
    Option("--dask local|ADDRESS"),
    "Compute on a Dask cluster: the address of its scheduler, such as tcp://host:8786, or local for one on this "
    "machine.  Needs the extra scale.",
]
CHANNELS = "Channels"
InputColumns = Annotated[
    tuple[str, ...],
    Option("--input NAME,…", None, CHANNELS, multiple=True),
    "Columns that drive the rig.  [default: those of --rig]",
]
OutputColumns = Annotated[
    tuple[str, ...],
    Option("--output NAME,…", None, CHANNELS, multiple=True),
    "Columns that show its motion.  [default: those of --rig, else all others]",
]
ChannelsOfRig = Annotated[
    str | None,
    Option("--rig RIG.toml", INPUT_FILE, CHANNELS),
    "A rig file, used only for its channels: names, units, calibrations.",
]
FreeBand = Annotated[
    tuple[float, float] | None, Option("--band LOWER:UPPER", BAND), "Frequencies that are used, Hz."
]
FreeFrequency = Annotated[
    float | None,
    Option("--frequency HZ", FREQUENCY),
    "Drive frequency of stepped-sine records without a frequency_hz column.",
]
Level = Annotated[
    float, Option("--level LEVEL", LEVEL, OUTPUT, default="95%"), "Confidence level of the intervals."
]
Quiet = Annotated[bool, Option("--quiet -q"), "Print no results and no notes, only errors."]
Verbose = Annotated[
    bool,
    Option("--verbose"),
    "Print more: the bound, χ² and p, method and iterations, the largest residuals, what ± means.",
]


def merged(settings: Sequence[Mapping[str, Amount]], option: str) -> dict[str, Amount]:
    """The settings of an option that may be repeated, each name given once.  Raises UsageError."""
    everything: dict[str, Amount] = {}
    for setting in settings:
        for name, value in setting.items():
            if name in everything:
                raise UsageError(f"{option} gives {name} twice", cure="give it once")
            everything[name] = value
    return everything


def parameter_values(
    rig: Rig, settings: Sequence[Mapping[str, Amount]], *, whole: bool = False
) -> dict[str, float]:
    """Values of unknowns from --set, in SI units; with `whole`, each has one there or in the rig file.

    Raises UsageError with every name or unit that is wrong, or every unknown without a value.
    """
    unknown = {unknown.name: unknown for unknown in rig.model.unknowns}
    elements = {element.name for element in rig.model.elements}
    problems, values = [], {}
    for name, amount in merged(settings, "--set").items():
        if name in unknown:
            values[name] = _in_si(name, amount, unknown[name].unit, "--set")
        elif name in elements:
            cure = "change it there, or leave it out here"
            problems.append(Problem(f"--set {name}: the rig file gives its value", rig.path, cure))
        else:
            what = f"--set: {name!r} is not an unknown of this rig"
            problems.append(Problem(what, rig.path, f"its unknowns are {', '.join(unknown)}"))
    if whole and not problems:
        problems = [
            Problem(f"{name} has no value", rig.path, f"add --set {name}=1.0, or a guess in the rig file")
            for name, one in unknown.items()
            if name not in values and one.prior is None and one.guess is None
        ]
    if problems:
        raise UsageError(problems)
    return values


def true_values(rig: Rig, settings: Mapping[str, Amount]) -> dict[str, float]:
    """True values of --truth in SI units; those of gains and delays are taken as they are.  Raises UsageError."""
    unit = {unknown.name: unknown.unit for unknown in rig.model.unknowns}
    return {name: _in_si(name, amount, unit.get(name, "1"), "--truth") for name, amount in settings.items()}


def changed_values(units: Mapping[str, str], settings: Sequence[Mapping[str, Amount]]) -> dict[str, float]:
    """Values of --set on top of an estimate, in SI units, by the units of its parameters.  Raises UsageError."""
    return {
        name: _in_si(name, amount, units.get(name, "1"), "--set")
        for name, amount in merged(settings, "--set").items()
    }


def _in_si(name: str, amount: Amount, unit: str, option: str) -> float:
    kind = quantity_of_unit(unit)
    if amount.unit is None:
        return amount.number
    if kind is None:
        raise UsageError(f"{option} {name}={amount}: {name} has no unit", cure="write the number alone")
    try:
        return amount.si(*kind)
    except UsageError as error:
        raise UsageError(
            f"{option} {name}={amount}: {error.problems[0].what}", cure=error.problems[0].cure
        ) from None


def drive_amplitude(model: Model, given: Amount | Mapping[str, Amount]) -> float:
    """One amplitude for the drive, in m or rad where the rig is moved, in N or N·m where it is pushed.

    Raises UsageError if inputs are named and their amplitudes differ, for what is designed is one drive.
    """
    from dashpot.model.rigfile.rig import drive_is_angular

    if isinstance(given, Mapping):
        sizes = set(input_amplitudes(model, [given]).values())
        if len(sizes) > 1:
            raise UsageError(
                "--amplitude gives the inputs different amplitudes", cure="give one for the drive"
            )
        return sizes.pop()
    kind = "displacement" if model.displacement_inputs else "force"
    return given.si(kind, drive_is_angular(model, kind))


def coordinate_amounts(model: Model, settings: Sequence[Mapping[str, Amount]]) -> dict[str, float]:
    """Displacements of --release by coordinate, m or rad: "x1=5mm".  Raises UsageError for a unit of something else."""
    named = merged(settings, "--release")
    return {name: amount.si("displacement", name in model.angles) for name, amount in named.items()}


def input_amplitudes(model: Model, settings: Sequence[Amount | Mapping[str, Amount]]) -> dict[str, float]:
    """Amplitudes by input, SI units: "5 mm" is that of every input, "u=5 mm" that of one.  Raises UsageError."""
    inputs = [*model.displacement_inputs, *model.force_inputs]
    named = merged([source for source in settings if isinstance(source, Mapping)], "--amplitude")
    common = [source for source in settings if not isinstance(source, Mapping)]
    if len(common) > 1:
        raise UsageError("--amplitude is given twice for all inputs", cure="give it once")
    for name in named:
        if name not in inputs:
            raise UsageError(
                f"--amplitude: {name!r} is not an input of this rig",
                cure=f"its inputs are {', '.join(inputs)}",
            )
    amplitudes = {}
    for source in model.inputs:
        given = named.get(source.name, common[0] if common else None)
        if given is not None:
            moved = source.kind == "displacement"
            turned = {source.name} if moved else set(source.at)
            kind = "displacement" if moved else "force"
            amplitudes[source.name] = given.si(kind, turned <= set(model.angles))
    return amplitudes
