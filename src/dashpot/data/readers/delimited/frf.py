"""Tables of frequency response functions as CSV: `frequency_hz`, then `OUT/IN_re`, `OUT/IN_im`, optionally `OUT/IN_sd`.

OUT and IN are channels of the rig file, in their units; `OUT/IN_sd` is the standard deviation of the real and of the
imaginary part, each.  Every input makes an experiment of its own, driven with amplitude 1 at IN and 0 at the others,
which are exact.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.data.calibration import calibration
from dashpot.data.readers.columns import Columns, bare
from dashpot.data.readers.delimited.stepped_sine import check_frequency
from dashpot.data.readers.sampling import FREQUENCY, frequency_column, frequency_scale
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DataError
from dashpot.io.words import listed
from dashpot.notices import Notice

Pair = tuple[str, str]  # names of a response and of an input


def is_frf(columns: Columns) -> bool:
    """There is a pair OUT/IN_re, OUT/IN_im."""
    names = {bare(name)[0] for name in columns.header}
    return any("/" in name and name.endswith("_re") and name[:-3] + "_im" in names for name in names)


def read_frf(
    columns: Columns, channels: Sequence[Channel], experiment: int = 0
) -> tuple[Spectrum, list[Notice]]:
    """The spectrum in SI units, one experiment for each input from number `experiment` on, and notes.

    Without any sd column the noise is unknown.  Raises DataError with file and column for what is missing, not a
    number, or not in the rig file.
    """
    pairs = _pairs(columns, channels)
    frequency, functions, sd = _functions(columns, channels, pairs)
    scale = np.array([channel.scale for channel in channels]) * calibration(channels, frequency)
    spectra = []
    for number, into in enumerate(dict.fromkeys(into for _, into in pairs)):
        X = np.zeros((len(frequency), len(channels)), dtype=np.complex128)
        V: Complex = np.zeros((len(frequency), len(channels), len(channels)), dtype=np.complex128)
        for c, channel in enumerate(channels):
            if channel.name == into:
                X[:, c] = 1.0
            elif (pair := (channel.name, into)) in functions:
                X[:, c] = functions[pair]
                V[:, c, c] = 2 * sd[pair] ** 2 if pair in sd else 0.0
        if not sd:
            V = np.full_like(V, np.nan)
        lines = len(frequency)
        spectra.append(
            Spectrum(
                tuple(channels),
                frequency,
                X * scale,
                V * scale[:, :, None] * np.conj(scale)[:, None, :],
                np.ones(lines, dtype=np.int64),
                np.full(lines, np.inf),
                ("given" if sd else "unknown",) * lines,
                np.full(lines, experiment + number),
            )
        )
    return concatenate(spectra), list(columns.notes)


def _pairs(columns: Columns, channels: Sequence[Channel]) -> list[Pair]:
    """Which response to which input there is.  Raises DataError where there is none, or one is missing."""
    names = {channel.name for channel in channels}
    pairs = []
    for name in (bare(column)[0] for column in columns.header):
        out, slash, into = name.removesuffix("_re").partition("/")
        if slash and name.endswith("_re") and out in names and into in names:
            pairs.append((out, into))
    if not pairs:
        raise DataError(
            f"no column OUT/IN_re names two channels of the rig file ({listed(c.name for c in channels)})",
            columns.source,
            "name the columns after its channels",
        )
    inputs = {into for _, into in pairs}
    for into in inputs:
        for out in names - inputs:
            if (out, into) not in pairs:
                raise DataError(
                    f"there is no column {out}/{into}_re (the rig file lists the channels)",
                    columns.source,
                    "add it, or take the channel out of the rig file",
                )
    return pairs


def _functions(
    columns: Columns, channels: Sequence[Channel], pairs: Sequence[Pair]
) -> tuple[Real, dict[Pair, Complex], dict[Pair, Real]]:
    """Frequency in Hz, the functions and their standard deviations, each (lines,)."""
    at = {
        pair: (columns.need(f"{'/'.join(pair)}_re"), columns.need(f"{'/'.join(pair)}_im")) for pair in pairs
    }
    sd_at = {pair: i for pair in pairs if (i := columns.find(f"{'/'.join(pair)}_sd")) is not None}
    f_at = frequency_column(columns, channels)
    f_at = columns.need(FREQUENCY) if f_at is None else f_at
    values = columns.numbers([f_at, *(i for both in at.values() for i in both), *sd_at.values()])
    frequency = values[f_at] * frequency_scale(columns, f_at)
    check_frequency(columns, f_at, frequency)
    for i in sd_at.values():
        if np.any(values[i] < 0):
            row = int(np.argmax(values[i] < 0))
            raise columns.error(row, i, f"a standard deviation of {values[i][row]:g}", "0 is exact")
    functions = {pair: values[re] + 1j * values[im] for pair, (re, im) in at.items()}
    return frequency, functions, {pair: values[i] for pair, i in sd_at.items()}
