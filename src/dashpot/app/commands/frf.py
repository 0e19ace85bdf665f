"""dashpot frf: frequency responses from test data, without a rig."""

from __future__ import annotations

from typing import Annotated

from dashpot.app import options as opt
from dashpot.app.data_files import reading_of, require_each_once, tell_notes
from dashpot.app.workers import progress
from dashpot.errors import printable
from dashpot.io.json_document import to_json


@opt.dashpot_command(
    "dashpot frf hits.csv --input f --output a1,a2 --figure frf.png",
    "dashpot frf run1.csv run2.csv --rig rig.toml --band 1:30 --out frf.csv",
)
def command(
    data: Annotated[tuple[str, ...], opt.NEEDED_FILES, opt.DATA],
    inputs: opt.InputColumns,
    outputs: opt.OutputColumns,
    rig: opt.ChannelsOfRig,
    band: opt.FreeBand,
    frequency: opt.FreeFrequency,
    json_out: Annotated[str | None, opt.JSON, "the responses"],
    out: Annotated[
        str | None,
        opt.Option(
            "--out -o FILE.csv|.parquet|.uff",
            opt.OutputFile(formats=("csv", "gz", "parquet", "uff", "unv")),
            opt.OUTPUT,
        ),
        "Write the responses for `identify` and other programs: a table with standard deviations (CSV), with "
        "the covariance of outputs too (Parquet), or a universal file.  Of neighbouring lines that share data, "
        "one is written.",
    ],
    figure: Annotated[str | None, opt.FIGURE, "Draw magnitude, phase, coherence and the complex plane."],
    quiet: opt.Quiet,
) -> None:
    """Frequency responses of outputs to inputs from DATA, with standard deviations; no rig is needed.

    Stepped sine, periodic tests (with distortion apart from noise) and records of any excitation, hammer hits too.
    """
    from dashpot.api import frf
    from dashpot.free.response import write_response
    from dashpot.model.rigfile import read_rig
    from dashpot.present.response import response_document

    require_each_once(data)
    driven, shown = (opt.names(*texts) if texts else None for texts in (inputs, outputs))
    with progress(reading_of(data), quiet):
        read = None if rig is None else read_rig(rig)
        found = frf(data, driven, shown, rig=read, band=band, frequency_hz=frequency)
    tell_notes(found.notes, quiet)
    if out is not None:
        write_response(found, out)
    if figure is not None:
        from dashpot.present.figures.spectra import measured_response_figure
        from dashpot.present.figures.style import write_figure

        write_figure(figure, measured_response_figure(found))
    written = "" if out is None else printable(out)
    opt.tell_result(json_out, to_json(found.to_dict()), lambda: response_document(found, written), quiet)
