"""dashpot modes: natural frequencies, damping and shapes from test data, without a rig."""

from __future__ import annotations

from typing import Annotated

from dashpot.app import options as opt
from dashpot.app.data_files import reading_of, require_each_once, tell_notes
from dashpot.app.workers import progress
from dashpot.errors import UsageError, printable
from dashpot.io.json_document import to_json
from dashpot.io.words import PICTURES


@opt.dashpot_command(
    "dashpot modes run.csv --input f --output a1,a2 --figure modes.png",
    "dashpot modes release.csv --output x1,x2,x3",
    "dashpot modes hit*.csv --rig rig.toml --band 5:80 --shapes modes.svg",
)
def command(
    data: Annotated[tuple[str, ...], opt.NEEDED_FILES, opt.DATA],
    inputs: opt.InputColumns,
    outputs: opt.OutputColumns,
    rig: opt.ChannelsOfRig,
    band: opt.FreeBand,
    frequency: opt.FreeFrequency,
    real: Annotated[bool, opt.Option("--real"), "Real shapes, up to one complex factor each."],
    most: Annotated[
        int,
        opt.Option("--most N", opt.Count(1, 200), default=40),
        "Largest number of modes; fewer are used if the evidence says so.",
    ],
    json_out: Annotated[str | None, opt.JSON, "the modes, which `identify` and `compare --modal` read,"],
    out: Annotated[
        str | None,
        opt.Option("--out -o FILE.csv|uff", opt.OutputFile(formats=("csv", "gz", "uff", "unv")), opt.OUTPUT),
        "Write the modes as a table, or as a universal file (dataset 55, without standard deviations), for "
        "`identify` and `compare --modal`.",
    ],
    figure: Annotated[str | None, opt.FIGURE, "Draw the fit and the stabilisation diagram."],
    shapes: Annotated[
        str | None,
        opt.Option("--shapes FILE.svg|png|pdf", opt.OutputFile(formats=PICTURES), opt.OUTPUT),
        "Draw the mode shapes on the rig of --rig, animated in SVG.",
    ],
    quiet: opt.Quiet,
) -> None:
    """Natural frequencies, damping ratios and mode shapes from DATA, with standard deviations; no rig is needed.

    Records of any excitation, several at once; free decays, where no input is named; stepped sine, periodic tests,
    tables of amplitudes and of frequency responses.  The number of modes is chosen by evidence.
    """
    from dashpot.api import draw, modes
    from dashpot.data.readers.modes import write_mode_table
    from dashpot.model.rigfile import read_rig
    from dashpot.present.response import modes_document

    require_each_once(data)
    if shapes is not None and rig is None:
        raise UsageError("mode shapes are drawn on a rig", "--shapes", "give its file with --rig")
    driven, shown = (opt.names(*texts) if texts else None for texts in (inputs, outputs))
    with progress(reading_of(data), quiet):
        read = None if rig is None else read_rig(rig)
        found = modes(data, driven, shown, rig=read, band=band, frequency_hz=frequency, most=most, real=real)
    tell_notes(found.notes, quiet)
    if shapes is not None and read is not None:
        draw(read, found).save(shapes)
    if out is not None:
        write_mode_table(found.modal_data, out)
    if figure is not None:
        from dashpot.present.figures.spectra import modes_figure
        from dashpot.present.figures.style import write_figure

        write_figure(figure, modes_figure(found))
    written = "" if out is None else printable(out)
    opt.tell_result(json_out, to_json(found.to_dict()), lambda: modes_document(found, written), quiet)
