"""Tables of frequency response functions as CSV: `frequency_hz`, then `OUT/IN_re`, `OUT/IN_im`, optionally `OUT/IN_sd`.

OUT and IN are channels of the rig file, in their units; `OUT/IN_sd` is the standard deviation of the real and of the
imaginary part, each.  Every input makes an experiment of its own, driven with amplitude 1 at IN and 0 at the others,
which are exact.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Complex
from dashpot.channel import Channel
from dashpot.data.calibration import calibration
from dashpot.data.readers.delimited.stepped_sine import FREQUENCY, check_frequency
from dashpot.data.readers.delimited.table import Table, bare
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DataError
from dashpot.io.words import listed
from dashpot.notices import Notice


def is_frf(table: Table) -> bool:
    """There is a pair OUT/IN_re, OUT/IN_im."""
    names = {bare(name)[0] for name in table.header}
    return any("/" in name and name.endswith("_re") and name[:-3] + "_im" in names for name in names)


def read_frf(table: Table, channels: Sequence[Channel], experiment: int = 0) -> tuple[Spectrum, list[Notice]]:
    """The spectrum in SI units, one experiment for each input from number `experiment` on, and notes.

    Without any sd column the noise is unknown.  Raises DataError with file and column for what is missing, not a
    number, or not in the rig file.
    """
    by_name = {channel.name: channel for channel in channels}
    pairs = []
    for name in (bare(column)[0] for column in table.header):
        out, slash, into = name.removesuffix("_re").partition("/")
        if slash and name.endswith("_re") and out in by_name and into in by_name:
            pairs.append((out, into))
    inputs = list(dict.fromkeys(into for _, into in pairs))
    outputs = [channel.name for channel in channels if channel.name not in inputs]
    if not pairs:
        raise DataError(
            f"no column OUT/IN_re names two channels of the rig file ({listed(by_name)})",
            table.source,
            "name the columns after its channels",
        )
    for into in inputs:
        for out in outputs:
            if (out, into) not in pairs:
                raise DataError(
                    f"there is no column {out}/{into}_re (the rig file lists the channels)",
                    table.source,
                    "add it, or take the channel out of the rig file",
                )
    columns = {
        pair: (table.need(f"{'/'.join(pair)}_re"), table.need(f"{'/'.join(pair)}_im")) for pair in pairs
    }
    sd = {pair: at for pair in pairs if (at := table.find(f"{'/'.join(pair)}_sd")) is not None}
    f_at = table.need(FREQUENCY)
    values = table.numbers([f_at, *(at for both in columns.values() for at in both), *sd.values()])
    frequency = values[f_at]
    check_frequency(table, f_at, frequency)
    for at in sd.values():
        if np.any(values[at] < 0):
            row = int(np.argmax(values[at] < 0))
            raise table.error(row, at, f"a standard deviation of {values[at][row]:g}", "0 is exact")
    scale = np.array([channel.scale for channel in channels])
    h = calibration(channels, frequency)
    lines, count = len(frequency), len(channels)
    spectra = []
    for number, into in enumerate(inputs):
        X = np.zeros((lines, count), dtype=np.complex128)
        V: Complex = np.zeros((lines, count, count), dtype=np.complex128)
        for c, channel in enumerate(channels):
            if channel.name == into:
                X[:, c] = 1.0
            elif (pair := (channel.name, into)) in columns:
                re, im = columns[pair]
                X[:, c] = values[re] + 1j * values[im]
                V[:, c, c] = 2 * values[sd[pair]] ** 2 if pair in sd else 0.0
        if not sd:
            V = np.full_like(V, np.nan)
        V = V * (scale * h)[:, :, None] * np.conj(scale * h)[:, None, :]
        whole = np.full(lines, experiment + number)
        noise = ("given" if sd else "unknown",) * lines
        ones, known = np.ones(lines, dtype=np.int64), np.full(lines, np.inf)
        spectra.append(Spectrum(tuple(channels), frequency, X * scale * h, V, ones, known, noise, whole))
    return concatenate(spectra), list(table.notes)
