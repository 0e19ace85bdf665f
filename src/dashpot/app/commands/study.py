"""dashpot study: Monte Carlo over rigs, tests, noises and methods, from a file."""

from __future__ import annotations

from pathlib import Path

import click

from dashpot.app.cli import INTERRUPTED
from dashpot.app.files import InputFile, OutputFolder, check_folder

FEW = 2000  # identifications below which starting processes costs more than they save


@click.command(name="study")
@click.argument("study", type=InputFile())
@click.option(
    "--out",
    type=OutputFolder(),
    metavar="DIR",
    help="Where draws, summary and pictures go; else a folder here of the file's name.",
)
@click.option(
    "--draws",
    type=click.IntRange(2, 1_000_000_000),
    metavar="N",
    help="Of each point, in place of the file's.",
)
@click.option(
    "--processes", type=click.IntRange(1, 1024), metavar="N", help="At work; all processors unless given."
)
@click.option("--quiet", "-q", is_flag=True, help="Print nothing.")
@click.pass_context
def command(
    ctx: click.Context, study: str, out: str | None, draws: int | None, processes: int | None, quiet: bool
) -> None:
    """Run the Monte Carlo study that the file STUDY describes, or go on where it was interrupted.

    The folder gets every draw (draws/…, Parquet), summary.parquet with bias, spread, coverage and bound of each
    method, and pictures.  The result depends on the file alone, to the bit: not on processes or interruptions.
    """
    from dashpot.study.studyfile import read_study

    found = read_study(study)
    folder = out if out is not None else Path(study).stem
    check_folder(folder)

    from dataclasses import replace

    from dashpot.app.progress import progress
    from dashpot.app.workers import cores, mapping
    from dashpot.present.tables.estimate import console
    from dashpot.present.tables.study import show, write
    from dashpot.study.runner import run_study
    from dashpot.study.scenario import scenarios

    if draws is not None:
        found = replace(found, grids=tuple(replace(grid, draws=draws) for grid in found.grids))
    work = sum(point.draws * len(point.methods) for point in scenarios(found))
    count = processes if processes is not None else 1 if work < FEW else cores()
    try:
        with mapping(count) as mapper, progress(found.name, quiet) as moved:
            outcome = run_study(found, Path(folder), mapper=mapper, progress=moved)
    except KeyboardInterrupt:
        click.echo(f"dashpot: interrupted; what is done is kept in {folder}: run it again to go on", err=True)
        ctx.exit(INTERRUPTED)
    written = write(outcome, folder)
    if not quiet:
        show(outcome, console())
        for name in [str(Path(folder) / "summary.parquet"), *written]:
            click.echo(name)
