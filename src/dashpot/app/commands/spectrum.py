"""dashpot spectrum: from time records to a table of complex amplitudes."""

from __future__ import annotations

from typing import Annotated

from dashpot.app.data_files import RecordOptions
from dashpot.app.options import NEEDED_FILES, OUTPUT, Option, OutputFile, Quiet, RigFile, dashpot_command
from dashpot.errors import printable


@dashpot_command(
    "dashpot spectrum rig.toml records.csv --out amplitudes.csv",
    "dashpot spectrum rig.toml run.csv --frequency 4.5 --orders 1,3 --settle auto -o amplitudes.csv",
)
def command(
    rig: RigFile,
    records: Annotated[tuple[str, ...], NEEDED_FILES, "Files of time records, of any format."],
    out: Annotated[
        str,
        Option("--out -o FILE.csv", OutputFile(), OUTPUT, required=True),
        "The table of amplitudes to write.",
    ],
    options: RecordOptions,
    quiet: Quiet,
) -> None:
    """Turn time RECORDS of the channels that RIG lists into a table of complex amplitudes with their noise.

    The table (frequency_hz, NAME_re, NAME_im, NAME_sd, …; x(t) = Re(X e^{jωt}), peak values) is read by
    `dashpot identify`.
    """
    from dashpot.data.readers import write_amplitudes
    from dashpot.model.observation import channel_unit
    from dashpot.model.rigfile import read_rig
    from dashpot.present.tables.layout import console
    from dashpot.present.tables.spectrum import show_spectrum

    read = read_rig(rig)
    spectrum = options.read(read, records)
    write_amplitudes(spectrum, out)
    if not quiet:
        units = [channel_unit(read.model, channel) for channel in spectrum.channels]
        show_spectrum(console(), spectrum, units, printable(out))
