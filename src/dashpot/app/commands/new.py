"""dashpot new: a rig file to start from."""

from __future__ import annotations

import click

from dashpot.app.files import OutputFile
from dashpot.app.help import dashpot_command, option
from dashpot.app.parameter_types import MASS, Count
from dashpot.errors import UsageError

HEAVIEST = 1e9  # kg
CHAIN = "The rig"
MOTIONS = ("displacement", "velocity", "acceleration")


@dashpot_command(
    "new",
    "dashpot new rig.toml",
    "dashpot new rig.toml --masses 3 --driven-by base --motion acceleration --unit g --first-mass 1.25kg",
)
@click.argument("rig", type=OutputFile(new=True), help="Rig file to write.")
@option("--name", default=None, metavar="TEXT", group=CHAIN, help="Name of the rig.")
@option("--masses", type=Count(1, 50), default=None, metavar="N", group=CHAIN, help="Masses in a row.")
@option(
    "--driven-by",
    "drive",
    type=click.Choice(["base", "force"]),
    default=None,
    group=CHAIN,
    help="The base moves, or a force acts.",
)
@option("--motion", type=click.Choice(MOTIONS), default=None, group=CHAIN, help="What the sensors measure.")
@option(
    "--unit", default=None, metavar="UNIT", group=CHAIN, help="Unit of the sensors, such as mm, m/s or g."
)
@option(
    "--first-mass",
    "known",
    type=MASS,
    default=None,
    metavar="KG",
    help="The first mass, where it has been weighed.",
)
def command(
    rig: str,
    name: str | None,
    masses: int | None,
    drive: str | None,
    motion: str | None,
    unit: str | None,
    known: float | None,
) -> None:
    """Write a rig file to start from: RIG, a row of masses with springs and dampers between them.

    Asks for whatever no option gives.
    """
    if known is not None and not known < HEAVIEST:
        raise UsageError(f"a mass of {known:g} kg", "--first-mass", "give one below 1e9 kg")
    import sys
    from typing import Any, cast

    from dashpot.io.atomic import write_text
    from dashpot.model.rigfile import parse_rig
    from dashpot.model.rigfile.starter import Chain, starter_text
    from dashpot.units import scale

    ask = sys.stdin.isatty()
    usual = Chain()
    name = name if name is not None else _answer(ask, "Name of the rig", usual.name)
    masses = (
        masses if masses is not None else int(_answer(ask, "How many masses in a row", str(usual.masses)))
    )
    drive = drive or _answer(ask, "What drives it: base or force", usual.drive, ("base", "force"))
    motion = motion or _answer(ask, "What the sensors measure", usual.motion, MOTIONS)
    si = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s²"}[motion]
    unit = unit or _answer(ask, "Unit of the sensors", si)
    scale(unit, motion, uncalibrated=True)  # refused here, before a rig file has it in three places
    text = starter_text(
        Chain(name, masses, cast(Any, drive), cast(Any, motion), unit, usual.force_unit, known)
    )
    parse_rig(text, rig)
    write_text(rig, text)
    click.echo(f"Written: {rig}. Next: dashpot check {rig}")


def _answer(ask: bool, question: str, usual: str, allowed: tuple[str, ...] = ()) -> str:
    """The answer to a question; the usual one where nobody can be asked."""
    if not ask:
        return usual
    if allowed:
        return str(click.prompt(question, default=usual, type=click.Choice(allowed)))
    return str(click.prompt(question, default=usual))
