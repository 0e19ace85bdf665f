"""dashpot study: Monte Carlo over rigs, tests, noises and methods, from a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import click

from dashpot.app import options as opt
from dashpot.app.cli import resumable
from dashpot.app.data_files import tell_notes
from dashpot.app.report_files import ReportFile
from dashpot.app.workers import progress, shared_out


@opt.dashpot_command("dashpot study study.toml", "dashpot study study.toml --draws 200 --out quick")
def command(
    ctx: click.Context,
    study: Annotated[str, opt.Option("", opt.INPUT_FILE), "Study file (TOML)."],
    out: Annotated[
        str | None,
        opt.Option("--out -o FOLDER", opt.FOLDER, opt.OUTPUT),
        "Folder for draws, summary and pictures.  [default: a folder of the file's name]",
    ],
    draws: Annotated[
        int | None,
        opt.Option("--draws N", opt.Count(2), "The study"),
        "Draws of each scenario, in place of those in the file.",
    ],
    report: ReportFile,
    workers: opt.Workers,
    dask: opt.Dask,
    quiet: opt.Quiet,
) -> None:
    """Run the Monte Carlo study that the file STUDY describes, or continue one that was interrupted.

    The folder gets every draw (draws/…, Parquet), summary.parquet with bias, spread, coverage and bound of each
    method, and pictures.  The result depends on the file alone, to the bit: neither on the number of processes nor on
    interruptions.
    """
    from dashpot.present.document import say
    from dashpot.present.figures.style import write_pictures
    from dashpot.present.study import study_document, study_pictures
    from dashpot.study.montecarlo import run_study
    from dashpot.study.scenario import scenarios
    from dashpot.study.studyfile import read_study

    description = read_study(study)
    folder = opt.FOLDER.convert(Path(study).stem if out is None else out, None, None)
    if draws is not None:
        description = replace(
            description, grids=tuple(replace(grid, draws=draws) for grid in description.grids)
        )
    work = sum(point.draws * len(point.methods) for point in scenarios(description))
    with (
        resumable(ctx, f"finished draws are kept in {folder}"),
        # Identifications below which starting processes costs more than they save
        shared_out(dask, workers, work < 2000) as mapper,
        progress(description.name, quiet) as moved,
    ):
        outcome = run_study(description, Path(folder), mapper=mapper, progress=moved)
    tell_notes(outcome.notes, quiet)
    pictures = study_pictures(outcome)
    written = write_pictures(folder, pictures)
    if report.report is not None:
        from dashpot.present.study import study_report

        report.write(study_report(outcome, pictures, report.provenance))
        written.append(report.report)
    if not quiet:
        say(study_document(outcome))
        opt.tell_written(str(Path(folder) / "summary.parquet"), *written)
