"""dashpot fleet: one rig, very many data sets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import click

from dashpot.app import options as opt
from dashpot.app.cli import resumable
from dashpot.app.data_files import RecordOptions
from dashpot.app.process import tell
from dashpot.app.workers import progress, shared_out
from dashpot.io.json_document import to_json
from dashpot.io.ledger import noted

FLEET = "The fleet"


@opt.dashpot_command(
    "dashpot fleet rig.toml 'data/*.parquet' --out fleet.parquet",
    "dashpot fleet rig.toml all.parquet --rig-column serial --out fleet.parquet --pool",
)
def command(
    ctx: click.Context,
    rig: opt.RigFile,
    data: Annotated[
        tuple[str, ...],
        opt.Option("", opt.INPUT_FILE_OR, nargs=-1, required=True),
        "Data files, one for each rig, or patterns in quotes such as 'data/**/*.csv'.",
    ],
    out: Annotated[
        str,
        opt.Option("--out -o FILE.parquet", opt.OutputFile(formats=("parquet",)), opt.OUTPUT, required=True),
        "Write a row for each data set; finished blocks are kept next to it, in FILE.blocks.",
    ],
    rig_column: Annotated[
        str | None,
        opt.Option("--rig-column NAME", None, FLEET),
        "The files are tables (Parquet, CSV) of many rigs; this column names the rig.",
    ],
    order: Annotated[
        Any,
        opt.Option("--order", click.Choice(["name", "time", "given"]), FLEET, default="name"),
        "Order of the files, in which drift is looked for: by name, by time of change, or as given.",
    ],
    pool: Annotated[
        bool,
        opt.Option("--pool", None, FLEET),
        "Estimate the population that the rigs come from, and shrink each rig's estimate towards it.",
    ],
    chosen: Annotated[opt.Method, FLEET],
    positive: Annotated[opt.Positive, FLEET],
    json_out: Annotated[str | None, opt.JSON, "the summary of the fleet"],
    workers: opt.Workers,
    dask: opt.Dask,
    records: RecordOptions,
    seed: Annotated[int, opt.SEED, "the starting values that ml draws"],
    quiet: opt.Quiet,
) -> None:
    """Identify the data sets of many rigs of one kind, all described by the rig file RIG.

    The result has one row for each data set: every unknown with its standard deviation and 95 % interval, χ², and how
    far the rig is from the others. A data set that fails is listed with the reason and does not stop the others. Rigs
    unlike the others, and drift along the fleet, are reported.

    Exit codes: 0 done; 2 bad usage, model or data; 3 no data set can be identified; 5 not enough memory.

    When run again, only new and changed data sets are computed. The result is the same to the bit with any number of
    workers.
    """
    from dashpot.check.deficiencies import require_identifiable
    from dashpot.fleet.data_sets import expanded, of_files, of_tables
    from dashpot.fleet.runner import run_fleet
    from dashpot.model.rigfile import read_rig
    from dashpot.present.document import say
    from dashpot.present.fleet import fleet_document
    from dashpot.study.blocks import write_table

    read = read_rig(rig)
    read.require_alike("a fleet")
    read.model.require_unknowns(rig)
    require_identifiable(read.model, read.channels, rig)
    paths = [noted(path) for path in expanded(data, order)]
    source = of_files(paths) if rig_column is None else of_tables(paths, rig_column)
    if source.count == 1 and rig_column is None and not quiet:
        tell(
            "note: each file counts as one rig; for a table of many rigs, name the column that identifies "
            "them: --rig-column"
        )
    treatment = records.treatment(read, chosen, positive, seed)
    kept = f"{out}.blocks"  # the folder of finished blocks
    with (
        resumable(ctx, f"finished data sets are kept in {kept}"),
        # Data sets below which starting processes costs more than they save
        shared_out(dask, workers, source.count < 40) as mapper,
        progress("fleet", quiet) as moved,
    ):
        outcome = run_fleet(read, source, Path(kept), treatment, pool=pool, mapper=mapper, progress=moved)
    summary = outcome.summary()
    write_table(Path(out), outcome.table(), json.dumps(summary).encode())
    opt.write_result(json_out, to_json(summary))
    if not quiet and json_out != opt.STDOUT:
        say(fleet_document(outcome))
        opt.tell_written(out)
    if len(outcome.failed) == len(outcome.columns["name"]):
        ctx.exit(opt.NOT_CONVERGED)
