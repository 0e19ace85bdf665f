"""dashpot spectrum: from time records to a table of complex amplitudes."""

from __future__ import annotations

from typing import Any

from dashpot.app.options import (
    conditioning_options,
    dashpot_command,
    data_argument,
    out_option,
    quiet_option,
    rig_argument,
    whole_record_options,
)
from dashpot.errors import printable


@dashpot_command(
    "spectrum",
    "dashpot spectrum rig.toml records.csv --out amplitudes.csv",
    "dashpot spectrum rig.toml run.csv --frequency 4.5 --orders 1,3 --settle auto -o amplitudes.csv",
)
@rig_argument
@data_argument("Files of time records, of any format.", name="records", required=True)
@out_option("FILE.csv", "The table of amplitudes to write.")
@conditioning_options
@whole_record_options
@quiet_option
def command(rig: str, records: tuple[str, ...], out: str, quiet: bool, **conditioning: Any) -> None:
    """Turn time RECORDS of the channels that RIG lists into a table of complex amplitudes with their noise.

    The table (frequency_hz, NAME_re, NAME_im, NAME_sd, …; x(t) = Re(X e^{jωt}), peak values) is read by
    `dashpot identify`.
    """
    from dashpot.app.data_files import read_spectrum
    from dashpot.data.readers import write_amplitudes
    from dashpot.model.rigfile import read_rig

    rig_read = read_rig(rig)
    spectrum = read_spectrum(rig_read, records, conditioning, quiet)
    write_amplitudes(spectrum, out)
    if not quiet:
        from dashpot.model.observation import channel_unit
        from dashpot.present.tables.layout import console
        from dashpot.present.tables.spectrum import show_spectrum

        units = [channel_unit(rig_read.model, channel) for channel in spectrum.channels]
        show_spectrum(console(), spectrum, units, printable(out))
