"""Options that several commands share: the same name, type, words and meaning in each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import click

from dashpot.app.files import OutputFile
from dashpot.app.help import option
from dashpot.app.parameter_types import (
    AMOUNTS,
    BAND,
    FREQUENCY,
    HARMONICS,
    INPUT_FILE,
    LEVEL,
    MODAL_SD,
    ORDERS,
    SETTLING,
    SHARE_OR_ZERO,
    Count,
)
from dashpot.estimate.registry import METHODS
from dashpot.io.name_endings import PICTURES

NOT_CONVERGED = 3  # exit code
DOES_NOT_FIT = 4  # exit code of a verdict that was asked to count
OUTPUT = "Output"
CHOICES = ["auto", *METHODS]  # of --method
DATA_HELP = "Data files of any format, or a manifest (TOML): time records, amplitudes, frequency responses."
VALUES = "Values of the unknowns, in place of those of the rig file"
RECORDS = "Time records (tables of amplitudes are used as they are)"

Function = TypeVar("Function", bound=Callable[..., Any])


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
        *(names or ("--figure",)), type=OutputFile(formats=PICTURES), metavar="FILE.svg|png|pdf", group=OUTPUT,
        help=what,
    )  # fmt: skip


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
        "--positive", is_flag=True, group=group,
        help="Hold every unknown at or above 0 (but not the entries of free matrices); uses ml.",
    )  # fmt: skip


def set_option(group: str, name: str, help_text: str) -> Callable[[Function], Function]:
    """--set: values of unknowns."""
    return option(
        "--set", name, type=AMOUNTS, multiple=True, metavar="NAME=VALUE,…", group=group,
        help=f"{help_text}, such as m1=3,k1=4.6kN/m; a bare number is in SI units.  May be repeated.",
    )  # fmt: skip


def relative_noise_option(group: str) -> Callable[[Function], Function]:
    """--relative-noise: in place of what the channels state."""
    return option(
        "--relative-noise", type=SHARE_OR_ZERO, metavar="5%", group=group,
        help="Noise of a sample as a share of the amplitude, for every output, in place of the rig file's noise.",
    )  # fmt: skip


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
    "--dask", metavar="local|ADDRESS",
    help="Compute on a Dask cluster: the address of its scheduler, such as tcp://host:8786, or local for one on this "
    "machine.  Needs the extra dashpot[scale].",
)  # fmt: skip


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
