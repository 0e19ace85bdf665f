"""dashpot export: a rig with its estimate for other programs."""

from __future__ import annotations

from typing import Annotated

import click
import numpy as np

from dashpot.app import options as opt
from dashpot.app.data_files import RecordOptions, estimate_and_rig
from dashpot.app.options import parameter_values
from dashpot.app.process import tell
from dashpot.app.workers import progress
from dashpot.errors import UsageError
from dashpot.export.formats import ExportOptions, contents, export_rig, format_of
from dashpot.quantities import Amount

WHAT = "What to write"
RIG = "The rig"


@opt.dashpot_command(
    "dashpot export estimate.json -o rig.mat",
    "dashpot export rig.toml --set m1=3,c1=20,c2=30 -o rig.fmu",
    "dashpot export estimate.json data.csv -o rig.uff",
    "dashpot export estimate.json --to frequency-responses --frequencies 0.5:25/200log -o frf.csv",
)
def command(
    source: Annotated[
        str, opt.Option("", opt.INPUT_FILE), "An estimate (JSON of identify), or a rig file (TOML)."
    ],
    data: Annotated[tuple[str, ...], opt.FILES, "Data files, for measured frequency responses (.uff)."],
    rig_file: Annotated[
        str | None,
        opt.Option("--rig RIG.toml", opt.INPUT_FILE, RIG),
        "The rig file of the estimate.  [default: the one that the estimate names]",
    ],
    values: Annotated[
        tuple[dict[str, Amount], ...],
        opt.Option("--set NAME=VALUE,…", opt.AMOUNTS, RIG, multiple=True),
        "Values of unknowns where SOURCE is a rig file; others take their guess.  May be repeated.",
    ],
    content: Annotated[
        str | None,
        opt.Option("--to CONTENT", click.Choice(contents()), WHAT),
        f"What to write, where the extension allows several: {', '.join(contents())}.",
    ],
    given: Annotated[
        str | None,
        opt.Option(
            "--input-quantity QUANTITY", click.Choice(["displacement", "velocity", "acceleration"]), WHAT
        ),
        "How moved points are driven: by displacement, velocity or acceleration.  [default: as they are measured, "
        "differentiated as far as outputs need]",
    ],
    frequencies: Annotated[
        tuple[float, ...] | None,
        opt.Option("--frequencies LIST|RANGE", opt.FREQUENCIES, WHAT),
        "Frequencies of frequency responses, Hz: 1,2,5, or 1:10:0.5, or 1:10/25, or 1:10/25log.",
    ],
    no_binary: Annotated[
        bool, opt.Option("--no-binary", None, WHAT), "Leave the compiled binary out of an FMU."
    ],
    out: Annotated[
        str,
        opt.Option("--out -o FILE", opt.OutputFile(), opt.OUTPUT, required=True),
        "The file to write; its extension sets the format: .mat .json (state space), .fmu, .uff .unv (modes, "
        "frequency responses), .mtx (M, C, K: one file each), .xml (MuJoCo), .csv .parquet .m (parameters).",
    ],
    records: RecordOptions,
    experiment: opt.Experiment,
    quiet: opt.Quiet,
) -> None:
    """Write SOURCE, an estimate or a rig, as a file for another program.

    All numbers are in SI units, except in universal files and tables of frequency responses, in the units of the rig
    file.  Channels are written as ideal sensors would show them.
    """
    from dashpot.export.identified_rig import identified_rig
    from dashpot.model.rigfile import read_rig

    format_of(out, content).require_use(out, ["data"] if data else [])
    if source.lower().endswith(".toml"):
        if rig_file is not None:
            raise UsageError("--rig is for estimates; this is a rig file", source, "leave it out")
        rig = read_rig(source).in_experiment(experiment)
        of_rig = identified_rig(rig, None, parameter_values(rig, values))
    else:
        if values:
            raise UsageError("--set is for rig files; this is an estimate", source, "leave it out")
        estimate, rig = estimate_and_rig(source, rig_file)
        of_rig = identified_rig(rig, estimate, experiment=experiment)
    spectrum = records.read(rig, data) if data else None
    at = None if frequencies is None else np.array(frequencies)
    with progress("export", quiet):
        options = ExportOptions(given, at, spectrum, compiled=not no_binary)
        written = export_rig(of_rig, out, content, options)
    if quiet:
        return
    opt.tell_written(*written.paths)
    if written.compiled is False and not no_binary:
        tell("note: no C compiler was found; the FMU contains the source only, which most importers compile")
