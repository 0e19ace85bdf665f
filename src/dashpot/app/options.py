"""Options that several commands share: the same name, type, words and meaning in each."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from dashpot import quantities
from dashpot.errors import DataError, UsageError
from dashpot.estimate.registry import METHODS
from dashpot.io import ledger
from dashpot.io.words import PICTURES, chosen_format
from dashpot.quantities import Amount

# Files and folders as parameters of commands: checked before the work starts.
#
# A parameter that names a file or folder has one of these types, by which no output of a call can be an
# input of it: each input and output is entered in the run's ledger, whichever comes first, and what clashes
# is refused.


STDOUT = "-"  # as the name of a file to write


class InputFile(click.ParamType[str]):
    """A file that is read.  Whether it is there, its reader says."""

    name = "file"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path.  Raises UsageError where it is an output of the same call."""
        return ledger.noted(str(value))

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Left to the shell."""
        return [CompletionItem(incomplete, type="file")]


class InputFileOr(InputFile):
    """A file that is read where there is one of that name; else a text with a meaning of its own."""

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path or the text.  Raises UsageError where it is an output of the same call."""
        text = str(value)
        return super().convert(text, param, ctx) if os.path.exists(text) else text


class OutputFile(click.ParamType[str]):
    """A file to write; with `stdout`, - is standard output; with `new`, one that is there already is not replaced.

    Where there are `formats`, its name ends in one of them.
    """

    name = "file"

    def __init__(self, stdout: bool = False, new: bool = False, formats: Sequence[str] = ()) -> None:
        self.stdout, self.new, self.formats = stdout, new, tuple(formats)

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path.  Raises UsageError where it could not be written after the work, or must not be."""
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

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Left to the shell."""
        return [CompletionItem(incomplete, type="file")]


class OutputFolder(click.ParamType[str]):
    """A folder that is made where it is missing.  What is written into it is checked when it is."""

    name = "folder"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The path.  Raises UsageError where the folder cannot be made."""
        target = str(value)
        check_folder(target)
        return target

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Left to the shell."""
        return [CompletionItem(incomplete, type="dir")]


def check_folder(target: str) -> None:
    """Refuse a folder for output that cannot be made: its parent must exist.  Raises UsageError."""
    if not target or "\0" in target:
        raise UsageError("this is not the name of a folder", target or '""', "name another folder")
    path = Path(target)
    if os.path.exists(target) and not os.path.isdir(target):
        raise UsageError("this is a file, not a folder", target, "name another folder")
    if not os.path.exists(target) and not os.path.isdir(path.absolute().parent):
        raise UsageError(f"the folder {path.parent} does not exist", target, "create it, or name another")


def write_result(target: str | None, text: str) -> None:
    """Write a result to a file, to stdout for "-", or nowhere for None.  Raises DataError."""
    from dashpot.io.atomic import write_text

    if target == STDOUT:
        click.echo(text, nl=False)
    elif target is not None:
        write_text(target, text)


def write_pictures(folder: str | Path, pictures: Mapping[str, bytes]) -> list[str]:
    """Write PNG files by name into a folder, which is made if missing; their paths.  Raises DataError."""
    from dashpot.io.atomic import write_bytes

    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or error
        raise DataError(f"the folder cannot be made ({reason})", str(target), "name another one") from None
    paths = [str(target / f"{name}.png") for name in pictures]
    for path, content in zip(paths, pictures.values(), strict=True):
        write_bytes(path, content)
    return paths


# What options and arguments take: one type for each kind of value, the same in every command.
#
# Quantities, shares and lists of frequencies are read by `dashpot.quantities`; what it refuses becomes a
# usage error that names the option.


MOST_ORDERS = 1000
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
        """The words that the type takes beside values."""
        return [CompletionItem(word) for word in self.words if word.startswith(incomplete)]


def _positive(kind: str) -> Callable[[str], float]:
    return lambda text: quantities.positive(quantities.quantity(text, kind), text)


def _not_negative(kind: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        value = quantities.quantity(text, kind)
        if value < 0:
            raise UsageError(f"{text.strip()!r} is negative", cure="give 0 or more")
        return value

    return parse


def _positive_amount(text: str) -> Amount:
    given = quantities.amount(text)
    quantities.positive(given.number, text)
    return given


def _positive_share(text: str) -> float:
    return quantities.positive(quantities.share(text), text)


def _share_of_zero_or_more(text: str) -> float:
    value = quantities.share(text)
    if value < 0:
        raise UsageError(f"{text.strip()!r} is negative", cure="give 0% or more")
    return value


def _part(text: str) -> float:
    value = _positive_share(text)
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
    value = quantities.share(text)
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
    if not found or min(found) < 1 or max(found) > MOST_ORDERS or len(found) > MOST_ORDERS:
        raise UsageError(f"{text.strip()!r} is not a list of multiples", cure="write them as 1,3,5 or 1:9:2")
    return tuple(dict.fromkeys(found))


def pairs(text: str, parse: Callable[[str], Value]) -> dict[str, Value]:
    """NAME=VALUE,NAME=VALUE,… with each VALUE read by `parse`.  Raises UsageError."""
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


def _amounts(text: str) -> dict[str, Amount]:
    return pairs(text, quantities.amount)


def _amplitude(text: str) -> Amount | dict[str, Amount]:
    return _amounts(text) if "=" in text else _positive_amount(text)


def _target(text: str) -> float | dict[str, float]:
    return pairs(text, _positive_share) if "=" in text else _positive_share(text)


def _sensors(text: str) -> tuple[int, tuple[str, ...]]:
    """ "pick 3 of a,b,c": how many, and of which (none: of all)."""
    match = re.fullmatch(r"\s*(?:pick\s+)?(\d{1,6})(?:\s+of\s+(.+))?\s*", text)
    if match is None:
        raise UsageError(f"{text!r} is not a choice of sensors", cure='write it as "pick 3 of a,b,c,d"')
    return int(match[1]), names(match[2] or "")


def _three_shares(text: str) -> tuple[float, float, float]:
    shares = [_positive_share(part) for part in text.split(",")]
    if len(shares) != 3:
        raise UsageError(f"{text!r} is not three shares", cure="write them as 1%,20%,5%")
    return shares[0], shares[1], shares[2]


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


FREQUENCIES = TextType("frequencies", quantities.frequencies)
FREQUENCY = TextType("frequency", quantities.frequency)
BAND = TextType("lower:upper", quantities.band)
TIME = TextType("time", _positive("time"))
MASS = TextType("mass", _positive("mass"))
SETTLING = TextType("time", _not_negative("time"), words=("auto", "none"))
AMOUNT = TextType("quantity", _positive_amount)  # in SI only where the rig is known: an angle or a length
AMOUNTS = TextType("name=value", _amounts)
AMPLITUDE = TextType("quantity", _amplitude)
SHARE = TextType("share", _positive_share)
SHARE_OR_ZERO = TextType("share", _share_of_zero_or_more)
PART = TextType("share", _part)
NUMBER = TextType("number", _number)
LEVEL = TextType("level", _level)
ORDERS = TextType("orders", _whole_numbers, words=("auto",))
HARMONICS = TextType("orders", _whole_numbers, words=("auto", "none"))
TARGET = TextType("share", _target)
MODAL_SD = TextType("shares", _three_shares)
SENSORS = TextType("choice", _sensors)
INPUT_FILE = InputFile()
INPUT_FILE_OR = InputFileOr()
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


# Commands whose --help shows options in groups, in the order they are declared, and examples.


Function = TypeVar("Function", bound=Callable[..., Any])
GENERAL = "General"
WIDEST = 100  # columns of help text


class GroupedOption(click.Option):
    """An option that stands under the heading `group` in --help; without a value it means `alone`, if that is given."""

    def __init__(self, *args: Any, group: str = GENERAL, alone: str | None = None, **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self.group = group
        self.alone = alone


class GroupedCommand(click.Command):
    """A command with `examples`, printed below its options."""

    def __init__(self, *args: Any, examples: Sequence[str] = (), **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self.examples = tuple(examples)

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
            if record is not None:
                groups.setdefault(getattr(parameter, "group", GENERAL), []).append(record)
        groups[GENERAL] = groups.pop(GENERAL, [])
        for title, records in groups.items():
            with formatter.section(title):
                formatter.write_dl(records)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Examples; a long one goes on in the next line as a shell reads it, for they are to be copied."""
        if self.examples:
            with formatter.section("Examples"):
                indent = " " * formatter.current_indent
                for example in self.examples:
                    formatter.write(
                        indent + _folded(example, formatter.width - 2 * len(indent), indent) + "\n"
                    )


def _folded(example: str, width: int, indent: str) -> str:
    """The command in lines of at most `width`, broken before an option."""
    lines = [""]
    for part in re.split(r" (?=-)", example):
        if lines[-1] and len(lines[-1]) + len(part) + 3 > width:
            lines.append(part)
        else:
            lines[-1] = f"{lines[-1]} {part}".strip()
    return f" \\\n{indent}    ".join(lines)


def _complete(option: GroupedOption, ctx: click.Context, word: str, following: str) -> str:
    """The option with its value where it stands alone; every other word as it is."""
    if word not in option.opts:
        return word
    try:
        option.type.convert(following, option, ctx)
    except click.UsageError:
        return f"{word}={option.alone}"
    return word


def dashpot_command(name: str, *examples: str) -> Callable[[Callable[..., Any]], GroupedCommand]:
    """Decorator: a GroupedCommand of that name."""
    return click.command(name, cls=GroupedCommand, examples=examples)


def option(*declarations: str, group: str = GENERAL, **attributes: Any) -> Callable[[Function], Function]:
    """Decorator: an option under the heading `group`."""
    return click.option(*declarations, cls=GroupedOption, group=group, **attributes)


NOT_CONVERGED = 3  # exit code
DOES_NOT_FIT = 4  # exit code of a verdict that was asked to count
OUTPUT = "Output"
CHOICES = ["auto", *METHODS]  # of --method
DATA_HELP = "Data files of any format, or a manifest (TOML): time records, amplitudes, frequency responses."
VALUES = "Values of the unknowns, in place of those of the rig file"
RECORDS = "Time records (tables of amplitudes are used as they are)"


rig_argument = click.argument(
    "rig", type=INPUT_FILE, help="Rig file (TOML): coordinates, elements, channels."
)


def data_argument(
    help_text: str, *, name: str = "data", required: bool = False
) -> Callable[[Function], Function]:
    """Data files."""
    return click.argument(name, type=INPUT_FILE, nargs=-1, required=required, help=help_text)


def out_option(
    metavar: str, help_text: str, *, required: bool = True, formats: Sequence[str] = ()
) -> Callable[[Function], Function]:
    """--out, -o: what the command is there to write; `formats` as of OutputFile."""
    return option(
        "--out",
        "-o",
        "out",
        type=OutputFile(formats=formats),
        metavar=metavar,
        required=required,
        group=OUTPUT,
        help=help_text,
    )


def json_option(what: str) -> Callable[[Function], Function]:
    """--json: the result for other programs."""
    return option(
        "--json", "json_out", type=OutputFile(stdout=True), metavar="FILE", group=OUTPUT,
        help=f"Write {what} as JSON; - writes it to stdout, in place of the text.",
    )  # fmt: skip


def file_option(name: str, metavar: str, help_text: str) -> Callable[[Function], Function]:
    """An output file that is named by what it holds."""
    return option(name, type=OutputFile(), metavar=metavar, group=OUTPUT, help=help_text)


def figure_option(what: str, *names: str) -> Callable[[Function], Function]:
    """--figure, or an option of another name that draws."""
    return option(
        *(names or ("--figure",)),
        type=OutputFile(formats=PICTURES),
        metavar="FILE.svg|png|pdf",
        group=OUTPUT,
        help=what,
    )


level_option = option(
    "--level", type=LEVEL, default="95%", show_default=True, metavar="LEVEL", group=OUTPUT,
    help="Confidence level of the intervals.",
)  # fmt: skip

quiet_option = option("--quiet", "-q", is_flag=True, help="Print no results and no notes, only errors.")


def seed_option(of_what: str, default: int = 0) -> Callable[[Function], Function]:
    """--seed."""
    return option(
        "--seed", type=Count(0, 2**63 - 1), default=default, show_default=True, metavar="N",
        help=f"Seed of {of_what}; the same seed gives the same result.",
    )  # fmt: skip


def method_option(group: str) -> Callable[[Function], Function]:
    """--method: the estimator."""
    return option(
        "--method", "chosen", type=click.Choice(CHOICES), default="auto", show_default=True, group=group,
        help="Estimator.  auto takes oiv where every coordinate and input is measured and no unknown has bounds, ml "
        "elsewhere.",
    )  # fmt: skip


def positive_option(group: str) -> Callable[[Function], Function]:
    """--positive: bounds at 0."""
    return option(
        "--positive",
        is_flag=True,
        group=group,
        help="Hold every unknown at or above 0 (but not the entries of free matrices); uses ml.",
    )


def set_option(group: str, name: str, help_text: str) -> Callable[[Function], Function]:
    """--set: values of unknowns."""
    return option(
        "--set", name, type=AMOUNTS, multiple=True, metavar="NAME=VALUE,…", group=group,
        help=f"{help_text}, such as m1=3,k1=4.6kN/m; a bare number is in SI units.  May be repeated.",
    )  # fmt: skip


def relative_noise_option(group: str) -> Callable[[Function], Function]:
    """--relative-noise: in place of what the channels state."""
    return option(
        "--relative-noise",
        type=SHARE_OR_ZERO,
        metavar="5%",
        group=group,
        help="Noise of a sample as a share of the amplitude, for every output, in place of the rig file's noise.",
    )


def modal_sd_option(group: str) -> Callable[[Function], Function]:
    """--modal-sd: standard deviations of modes in files that have none."""
    return option(
        "--modal-sd", type=MODAL_SD, default="1%,20%,5%", show_default=True, metavar="FREQUENCY,DAMPING,SHAPE",
        group=group,
        help="Standard deviations of modes in universal files, which hold none: of frequencies, of damping ratios, and "
        "of shapes relative to their largest entry.",
    )  # fmt: skip


workers_option = option(
    "--workers", "--processes", "workers", type=Count(1, 1024), metavar="N",
    help="Worker processes.  [default: one per processor]",
)  # fmt: skip

dask_option = option(
    "--dask",
    metavar="local|ADDRESS",
    help="Compute on a Dask cluster: the address of its scheduler, such as tcp://host:8786, or local for one on this "
    "machine.  Needs the extra scale.",
)


record_band_option = option(
    "--band", "record_band", type=BAND, metavar="LOWER:UPPER", group=RECORDS,
    help="Frequencies of a whole record that are used, Hz.  [default: the band in which the rig moves]",
)  # fmt: skip


def transient_options(function: Function) -> Function:
    """What is done about transients, and what is known of the noise: --transients and --noise-record."""
    options = [
        option(
            "--transients", type=click.Choice(["auto", "estimate", "settle", "none"]), default="auto",
            show_default=True, group=RECORDS,
            help="Transients of dwells: estimate them where a test finds the dwells unsettled (auto), always "
            "(estimate) or never (none), or drop them where the test finds them (settle; auto does so for methods that "
            "cannot estimate them).  Records of other excitation always have theirs estimated.",
        ),
        option(
            "--noise-record", type=INPUT_FILE, multiple=True, metavar="FILE", group=RECORDS,
            help="A record at rest, which gives the noise of every channel.  May be repeated.",
        ),
    ]  # fmt: skip
    for decorate in reversed(options):
        function = decorate(function)
    return function


def whole_record_options(function: Function) -> Function:
    """How whole records are used: --band, --transients and --noise-record."""
    return record_band_option(transient_options(function))


def conditioning_options(function: Function) -> Function:
    """How time records become amplitudes: --frequency and the settings of conditioning."""
    options = [
        option(
            "--frequency", type=FREQUENCY, metavar="HZ", group=RECORDS,
            help="Drive frequency of records without a frequency_hz column.",
        ),
        option(
            "--orders", type=ORDERS, default="auto", show_default=True, metavar="auto|1,3,…", group=RECORDS,
            help="Multiples of the drive frequency whose amplitudes are used as data; auto is 1 and, in long dwells, "
            "the harmonics that show in every channel.",
        ),
        option(
            "--harmonics", type=HARMONICS, default="auto", show_default=True, metavar="auto|none|2,3,…",
            group=RECORDS, help="Further multiples, fitted so that they do not count as noise.",
        ),
        option(
            "--drift", type=click.Choice(["auto", "none", "0", "1", "2", "3"]), default="auto", show_default=True,
            group=RECORDS,
            help="Degree of the polynomial removed from each dwell: 0 removes the mean, 1 a straight line; auto is 1, "
            "and 0 where short dwells show no slope.",
        ),
        option(
            "--noise", type=click.Choice(["auto", "own", "white", "blocks"]), default="auto", show_default=True,
            group=RECORDS,
            help="How the noise of the amplitudes is estimated from the residuals: as white noise (white), from "
            "neighbouring frequencies (blocks), as a test of whiteness decides for each dwell (own), or likewise with "
            "short dwells pooled (auto).",
        ),
        option(
            "--refine", type=click.Choice(["auto", "always", "none"]), alone="always", default="auto",
            show_default=True, group=RECORDS,
            help="Estimate the true drive frequency near the stated one: where all dwells together show that it is off "
            "(auto; refused where a record moves elsewhere), always, or never; --refine alone is always.",
        ),
        option(
            "--settle", type=SETTLING, alone="auto", default="none", show_default=True,
            metavar="auto|none|2s", group=RECORDS,
            help="Discard the start of each dwell: as long as the transient lasts (auto), or the time given; --settle "
            "alone is auto.",
        ),
    ]  # fmt: skip
    for decorate in reversed(options):
        function = decorate(function)
    return function
