"""dashpot reproduce: the tables and figures of a published paper again, by Monte Carlo."""

from __future__ import annotations

import click

from dashpot.app.files import OutputFile, OutputFolder

PAPERS = ["yamane1989"]
FEW = 200  # draws below which starting processes costs more than they save


@click.command(name="reproduce")
@click.argument("paper", type=click.Choice(PAPERS))
@click.option(
    "--draws", type=click.IntRange(2, 1_000_000), default=1000, show_default=True, metavar="N",
    help="Noise draws of each point.",
)  # fmt: skip
@click.option(
    "--report",
    type=OutputFile(),
    metavar="OUT.html",
    help="Write tables, figures and findings, one HTML file.",
)
@click.option("--figures", type=OutputFolder(), metavar="DIR", help="Write the figures there, as PNG.")
@click.option(
    "--seed", type=click.IntRange(0), default=1989, show_default=True, metavar="N", help="Of the noise."
)
@click.option(
    "--processes", type=click.IntRange(1, 1024), metavar="N", help="At work; all processors unless given."
)
@click.option("--quiet", "-q", is_flag=True, help="Print nothing.")
def command(
    paper: str,
    draws: int,
    report: str | None,
    figures: str | None,
    seed: int,
    processes: int | None,
    quiet: bool,
) -> None:
    """Redo the tables and figures of PAPER (yamane1989), beside what it printed and what it left open.

    The same seed gives the same numbers, whatever the number of processes.
    """
    from dashpot.app.progress import progress
    from dashpot.app.workers import cores, mapping
    from dashpot.present.pages.yamane1989 import show, write
    from dashpot.present.tables.estimate import console
    from dashpot.reproduce.yamane1989.findings import reproduce

    count = processes if processes is not None else 1 if draws < FEW else cores()
    with mapping(count) as mapper, progress(paper, quiet) as moved:
        found = reproduce(draws, seed, moved, mapper=mapper)
    written = write(found, report, figures)
    if not quiet:
        show(found, console())
        for name in written:
            click.echo(name)
