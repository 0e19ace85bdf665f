"""dashpot inspect: what is in data files."""

from __future__ import annotations

from typing import Annotated

import click

from dashpot.app import options as opt
from dashpot.app.data_files import inspected
from dashpot.io.atomic import write_text


@opt.dashpot_command("dashpot inspect run.tdms", "dashpot inspect *.mat --channels channels.toml")
def command(
    files: Annotated[
        tuple[str, ...], opt.NEEDED_FILES, "Data files of any format, or a manifest (TOML) of them."
    ],
    channels: Annotated[
        str | None,
        opt.Option("--channels FILE.toml", opt.OutputFile(), opt.OUTPUT),
        "Write a [channels] table to start a rig file from.",
    ],
) -> None:
    """Show what is in FILES: columns, units, sampling, gaps, clipping, resolution and frequency content.

    A [channels] table for a rig file is suggested at the end; say in it what each column measures.
    """
    from dashpot.data.inspection import suggested_channels

    inspections = inspected(files)
    table = suggested_channels(inspections)
    if channels is not None:
        write_text(channels, table)
    else:
        click.echo("Suggested channels (replace each ? with the point that is measured):\n")
        click.echo(table, nl=False)
