"""dashpot spectrum: from time records to a table of complex amplitudes."""

from __future__ import annotations

from typing import Any

import click

from dashpot.app.files import InputFile, OutputFile
from dashpot.app.options import amplitudes, conditioning_from, conditioning_options, tell_notes


@click.command(name="spectrum")
@click.argument("rig", type=InputFile())
@click.argument("records", type=InputFile(), nargs=-1, required=True)
@click.option(
    "--out", type=OutputFile(), metavar="TABLE.csv", required=True, help="The table of amplitudes to write."
)
@conditioning_options
@click.option("--quiet", "-q", is_flag=True, help="Print nothing.")
def command(
    rig: str, records: tuple[str, ...], out: str, frequency: float | None, quiet: bool, **how: Any
) -> None:
    """Turn time RECORDS of the channels that RIG lists into a table of complex amplitudes with their noise.

    The table (frequency_hz, NAME_re, NAME_im, NAME_sd …, x(t) = Re(X e^{jωt})) is data for `dashpot identify`.
    """
    from dashpot.data.readers import read, write_amplitudes
    from dashpot.model.rigfile import read_rig

    found = read_rig(rig)
    reading = read(records, found.channels, frequency_hz=frequency)
    tell_notes(reading.notes, quiet)
    conditioning = conditioning_from(how)
    spectrum = amplitudes(reading, conditioning, quiet)
    write_amplitudes(spectrum, out)
    if not quiet:
        from dashpot.model.observation import channel_unit
        from dashpot.present.tables.estimate import console, show_spectrum

        units = [channel_unit(found.model, channel) for channel in spectrum.channels]
        show_spectrum(console(), spectrum, units, out)
