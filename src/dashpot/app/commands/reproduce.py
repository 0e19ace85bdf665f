"""dashpot reproduce: the tables and figures of a published paper again, by Monte Carlo."""

from __future__ import annotations

import click

from dashpot.app.options import (
    FOLDER,
    Count,
    dashpot_command,
    option,
    quiet_option,
    seed_option,
    workers_option,
)
from dashpot.app.report_files import report_option
from dashpot.errors import printable

PAPERS = ["yamane1989"]
FEW = 200  # draws below which starting processes costs more than they save


@dashpot_command("reproduce", "dashpot reproduce yamane1989 --draws 200 --report yamane1989.html")
@click.argument("paper", type=click.Choice(PAPERS), help="Which paper.")
@option(
    "--draws", type=Count(2, 1_000_000), default=1000, show_default=True, metavar="N", group="Monte Carlo",
    help="Draws of the noise in each scenario.",
)  # fmt: skip
@report_option
@option("--figures", type=FOLDER, metavar="FOLDER", group="Output", help="Write the figures there, as PNG.")
@seed_option("the noise", 1989)
@workers_option
@quiet_option
def command(
    paper: str,
    draws: int,
    report: str | None,
    figures: str | None,
    seed: int,
    workers: int | None,
    quiet: bool,
) -> None:
    """Reproduce the tables and figures of PAPER (yamane1989), beside what it printed and what it left open.

    The same seed gives the same numbers, whatever the number of processes.
    """
    from dashpot.app.progress import progress
    from dashpot.app.report_files import provenance, write_report
    from dashpot.app.workers import cores, mapping
    from dashpot.present.pages.yamane1989.page import show_reproduction, write_reproduction
    from dashpot.present.tables.layout import console
    from dashpot.reproduce.yamane1989.reproduction import reproduce

    count = workers if workers is not None else 1 if draws < FEW else cores()
    with mapping(count) as mapper, progress(paper, quiet) as moved:
        reproduction = reproduce(draws, seed, moved, mapper=mapper)
    how = None if report is None else provenance()
    written = write_reproduction(reproduction, report, figures, provenance=how, write=write_report)
    if not quiet:
        show_reproduction(reproduction, console())
        for name in written:
            click.echo(printable(name))
