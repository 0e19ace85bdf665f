"""dashpot reproduce: the tables and figures of a published paper again, by Monte Carlo."""

from __future__ import annotations

from typing import Annotated

import click

from dashpot.app import options as opt
from dashpot.app.report_files import ReportFile, write_report
from dashpot.app.workers import cores, mapping, progress


@opt.dashpot_command("dashpot reproduce yamane1989 --draws 200 --report yamane1989.html")
def command(
    paper: Annotated[str, opt.Option("", click.Choice(["yamane1989"])), "Which paper."],
    draws: Annotated[
        int,
        opt.Option("--draws N", opt.Count(2, 1_000_000), "Monte Carlo", default=1000),
        "Draws of the noise in each scenario.",
    ],
    report: ReportFile,
    figures: Annotated[
        str | None, opt.Option("--figures FOLDER", opt.FOLDER, opt.OUTPUT), "Write the figures there, as PNG."
    ],
    seed: Annotated[
        int,
        opt.Option("--seed N", opt.Count(0, 2**63 - 1), default=1989),
        "Seed of the noise; the same seed gives the same result.",
    ],
    workers: opt.Workers,
    quiet: opt.Quiet,
) -> None:
    """Reproduce the tables and figures of PAPER (yamane1989), next to the printed ones, and answer what it left open.

    The same seed gives the same numbers, whatever the number of processes.
    """
    from dashpot.present.document import say
    from dashpot.present.reproduction import reproduction_document, write_reproduction
    from dashpot.reproduce.yamane1989 import reproduce

    # Draws below which starting processes costs more than they save
    count = workers if workers is not None else 1 if draws < 200 else cores()
    with mapping(count) as mapper, progress(paper, quiet) as moved:
        reproduction = reproduce(draws, seed, moved, mapper=mapper)
    how = report.provenance if report else None
    written = write_reproduction(reproduction, report.report, figures, provenance=how, write=write_report)
    if not quiet:
        say(reproduction_document(reproduction))
        opt.tell_written(*written)
