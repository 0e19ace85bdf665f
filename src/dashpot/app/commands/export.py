"""dashpot export: a rig with its estimate for other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from dashpot.app.options import (
    AMOUNTS,
    FREQUENCIES,
    INPUT_FILE,
    conditioning_options,
    dashpot_command,
    option,
    out_option,
    quiet_option,
    whole_record_options,
)
from dashpot.export.formats import contents

if TYPE_CHECKING:
    from dashpot.data.spectrum import Spectrum
    from dashpot.export.formats import Written
    from dashpot.export.identified_rig import IdentifiedRig
    from dashpot.model.rigfile import Rig
    from dashpot.quantities import Amount

WHAT = "What to write"
MOTIONS = ("displacement", "velocity", "acceleration")
RIG = "The rig"


@dashpot_command(
    "export",
    "dashpot export estimate.json -o rig.mat",
    "dashpot export rig.toml --set m1=3,c1=20,c2=30 -o rig.fmu",
    "dashpot export estimate.json data.csv -o rig.uff",
    "dashpot export estimate.json --to frequency-responses --frequencies 0.5:25/200log -o frf.csv",
)
@click.argument("source", type=INPUT_FILE, help="An estimate (JSON of identify), or a rig file (TOML).")
@click.argument(
    "data", type=INPUT_FILE, nargs=-1, help="Data files, for measured frequency responses (.uff)."
)
@option(
    "--rig", "rig_file", type=INPUT_FILE, metavar="RIG.toml", group=RIG,
    help="The rig file of the estimate.  [default: the one that the estimate names]",
)  # fmt: skip
@option(
    "--set", "values", type=AMOUNTS, multiple=True, metavar="NAME=VALUE,…", group=RIG,
    help="Values of unknowns where SOURCE is a rig file; others take their guess.  May be repeated.",
)  # fmt: skip
@option(
    "--to", "content", type=click.Choice(contents()), metavar="CONTENT", group=WHAT,
    help=f"What to write, where the extension allows several: {', '.join(contents())}.",
)  # fmt: skip
@option(
    "--input-quantity", "given", type=click.Choice(MOTIONS), metavar="QUANTITY", group=WHAT,
    help="How moved points are driven: by displacement, velocity or acceleration.  [default: as they are measured, "
    "differentiated as far as outputs need]",
)  # fmt: skip
@option(
    "--frequencies",
    type=FREQUENCIES,
    metavar="LIST|RANGE",
    group=WHAT,
    help="Frequencies of frequency responses, Hz: 1,2,5, or 1:10:0.5, or 1:10/25, or 1:10/25log.",
)
@option("--no-binary", is_flag=True, group=WHAT, help="Leave the compiled binary out of an FMU.")
@out_option(
    "FILE",
    "The file to write; its extension sets the format: .mat .json (state space), .fmu, .uff .unv (modes, "
    "frequency responses), .mtx (M, C, K: one file each), .xml (MuJoCo), .csv .parquet .m (parameters).",
)
@conditioning_options
@whole_record_options
@quiet_option
def command(
    source: str, data: tuple[str, ...], rig_file: str | None, values: Sequence[Mapping[str, Amount]],
    content: str | None, given: str | None, frequencies: tuple[float, ...] | None, no_binary: bool, out: str,
    quiet: bool, **conditioning: Any,
) -> None:  # fmt: skip
    """Write SOURCE, an estimate or a rig, as a file for another program.

    All numbers are in SI units, except in universal files and tables of frequency responses, in the units of the rig
    file.  Channels are written as ideal sensors would show them.
    """
    from dashpot.app.progress import progress
    from dashpot.export.formats import ExportOptions, export_rig, format_of

    format_of(out, content).require_use(out, ["data"] if data else [])
    rig, of_rig = _loaded(source, rig_file, values)
    spectrum = _spectrum(rig, data, conditioning, quiet) if data else None

    import numpy as np

    options = ExportOptions(
        given, None if frequencies is None else np.array(frequencies), spectrum, compiled=not no_binary
    )
    with progress("export", quiet):
        written = export_rig(of_rig, out, content, options)
    if not quiet:
        _tell(written, no_binary)


def _loaded(
    source: str, rig_file: str | None, values: Sequence[Mapping[str, Amount]]
) -> tuple[Rig, IdentifiedRig]:
    """The rig, and the rig with its values.  Raises UsageError where options contradict each other."""
    from dashpot.app.parameters import merged, parameter_values
    from dashpot.app.validating import estimate_and_rig
    from dashpot.errors import UsageError
    from dashpot.export.identified_rig import identified_rig
    from dashpot.model.rigfile import read_rig

    if source.lower().endswith(".toml"):
        if rig_file is not None:
            raise UsageError("--rig goes with an estimate, and this is a rig file", source, "leave it out")
        rig = read_rig(source)
        return rig, identified_rig(rig, None, parameter_values(rig, merged(values, "--set")))
    if values:
        raise UsageError("--set goes with a rig file, and this is an estimate", source, "leave it out")
    estimate, rig = estimate_and_rig(source, rig_file)
    return rig, identified_rig(rig, estimate)


def _spectrum(rig: Rig, data: tuple[str, ...], conditioning: dict[str, Any], quiet: bool) -> Spectrum:
    from dashpot.app.data_files import read_spectrum

    return read_spectrum(rig, data, conditioning, quiet)


def _tell(written: Written, no_binary: bool) -> None:
    from dashpot.errors import printable

    for path in written.paths:
        click.echo(printable(path))
    if written.compiled is False and not no_binary:
        click.echo(
            "note: no C compiler was found; the FMU holds its source alone, which most importers compile",
            err=True,
        )
