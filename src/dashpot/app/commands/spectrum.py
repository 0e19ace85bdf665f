"""dashpot spectrum: from time records to a table of complex amplitudes."""

from __future__ import annotations

from typing import Annotated

from dashpot.app import options as opt
from dashpot.app.data_files import RecordOptions
from dashpot.errors import printable


@opt.dashpot_command(
    "dashpot spectrum rig.toml records.csv --out amplitudes.csv",
    "dashpot spectrum rig.toml run.csv --frequency 4.5 --orders 1,3 --settle auto -o amplitudes.csv",
)
def command(
    rig: opt.RigFile,
    records: Annotated[tuple[str, ...], opt.NEEDED_FILES, "Files of time records, of any format."],
    out: Annotated[
        str,
        opt.Option("--out -o FILE.csv", opt.OutputFile(), opt.OUTPUT, required=True),
        "The table of amplitudes to write.",
    ],
    options: RecordOptions,
    experiment: opt.Experiment,
    quiet: opt.Quiet,
) -> None:
    """Turn time RECORDS of the channels that RIG lists into a table of complex amplitudes with their noise.

    The table (frequency_hz, NAME_re, NAME_im, NAME_sd, …; x(t) = Re(X e^{jωt}), peak values) is read by
    `dashpot identify`.
    """
    from dashpot.data.readers import write_amplitudes
    from dashpot.model.observation import channel_unit
    from dashpot.model.rigfile import read_rig
    from dashpot.present.data import spectrum_document
    from dashpot.present.document import say

    read = read_rig(rig).in_experiment(experiment)
    spectrum = options.read(read, records)
    write_amplitudes(spectrum, out)
    if not quiet:
        units = [channel_unit(read.model, channel) for channel in spectrum.channels]
        say(spectrum_document(spectrum, units, printable(out)))
