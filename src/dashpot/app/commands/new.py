"""dashpot new: a rig file to start from."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, cast

import click

from dashpot.app import options as opt
from dashpot.errors import DashpotError, UsageError
from dashpot.units import scale

CHAIN = "The rig"
UNKNOWN = "unknown"
WEIGHED = opt.MASS.or_words(UNKNOWN)
MASSES = opt.Count(1, 50)
DRIVES = ("base", "force", "release")
DRIVEN = click.Choice(DRIVES, case_sensitive=False)
MEASURED = click.Choice(("displacement", "velocity", "acceleration"), case_sensitive=False)


@opt.dashpot_command(
    "dashpot new rig.toml",
    "dashpot new rig.toml --masses 3 --driven-by base --motion acceleration --unit g --first-mass 1.25kg",
)
def command(
    rig: Annotated[str, opt.Option("", opt.OutputFile(new=True)), "Rig file to write."],
    name: Annotated[str | None, opt.Option("--name TEXT", None, CHAIN), "Name of the rig."],
    masses: Annotated[int | None, opt.Option("--masses N", MASSES, CHAIN), "Masses in a row."],
    drive: Annotated[
        str | None,
        opt.Option("--driven-by", DRIVEN, CHAIN),
        "The base moves, a force acts, or the masses are let go.",
    ],
    motion: Annotated[str | None, opt.Option("--motion", MEASURED, CHAIN), "What the sensors measure."],
    unit: Annotated[
        str | None, opt.Option("--unit UNIT", None, CHAIN), "Unit of the sensors, such as mm, m/s or g."
    ],
    known: Annotated[
        float | None, opt.Option("--first-mass KG", opt.MASS), "The first mass, if it was weighed."
    ],
) -> None:
    """Write a rig file to start from: RIG, a row of masses with springs and dampers between them.

    Prompts for whatever the options leave open.
    """
    if known is not None and not known < 1e9:  # kg
        raise UsageError(f"a mass of {known:g} kg", "--first-mass", "give one below 1e9 kg")
    from dashpot.io.atomic import write_text
    from dashpot.model.rigfile import parse_rig
    from dashpot.model.rigfile.writer import STAND_IN, Chain, starter_text

    ask = ask_for()
    usual = Chain()
    name = name if name is not None else ask("Name of the rig", usual.name)
    masses = masses if masses is not None else ask("How many masses in a row", usual.masses, MASSES)
    drive = drive or ask("What drives it", usual.drive, DRIVEN)
    motion = motion or ask("What the sensors measure", usual.motion, MEASURED)
    si = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s²"}[motion]
    unit = unit or ask("Unit of the sensors", si, opt.TextType("unit", partial(_unit, motion)))
    if known is None and (first := ask("Mass of x1, if it was weighed", UNKNOWN, WEIGHED)) != UNKNOWN:
        known = first
    scale(unit, motion, uncalibrated=True)  # refused here, before a rig file has it in three places
    chain = Chain(name, masses, cast(Any, drive), cast(Any, motion), unit, usual.force_unit, known)
    text = starter_text(chain)
    parse_rig(text, rig)
    write_text(rig, text)
    if chain.lacks_scale:
        click.echo(
            f"No force is measured, so one mass must be known. m1 = {STAND_IN:g} kg is a PLACEHOLDER: replace "
            "it with the weighed mass."
        )
    click.echo(f"Written: {rig}. Next: dashpot check {rig}")


def _unit(motion: str, text: str) -> str:
    """A unit of the motion.  Raises UsageError if it is none."""
    try:
        scale(text, motion)
    except DashpotError as error:
        raise UsageError(error.problems[0].what, cure=error.problems[0].cure) from None
    return text


def ask_for() -> Callable[..., Any]:
    """What asks a question, with its usual answer and kind, on a terminal; what gives the usual answer without one."""
    return _asked if sys.stdin.isatty() else _usual


def _asked(question: str, usual: Any, kind: click.ParamType[Any] = click.STRING) -> Any:
    """The answer to a question, which is asked again until it is one."""

    def answer(text: Any) -> Any:
        return kind((text.strip() or usual) if isinstance(text, str) else text)

    try:
        return click.prompt(question, default=usual, type=kind, value_proc=answer)
    except click.Abort:
        click.echo(err=True)  # what is said next gets a line of its own
        raise


def _usual(question: str, usual: Any, kind: click.ParamType[Any] = click.STRING) -> Any:
    """The usual answer, where nobody can be asked."""
    return usual
