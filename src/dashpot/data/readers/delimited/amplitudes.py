"""Tables of complex amplitudes as CSV: `frequency_hz`, then `NAME_re`, `NAME_im` and optionally `NAME_sd`.

x(t) = Re(X e^{jωt}); `NAME_sd` is the standard deviation of the real and of the imaginary part, each.  Further
optional columns: `experiment`, `samples`, `dof`, `noise` and, for noise that channels share, `A&B_cov_re` and
`A&B_cov_im`, the covariance E[Δ_A conj(Δ_B)].  Numbers are raw, in the channels' own units, calibrations still in.
Lines of one whole record, which share its boundary loads, have one number in the column `record`,
with `record_duration_s`, `record_samples`, `record_loads` (0 or 1) and `record_polynomial` (0 to 6).  Lines of one
settled dwell have its number there and `fundamental_hz`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.channel import Channel
from dashpot.data.calibration import calibration
from dashpot.data.readers.delimited.stepped_sine import EXPERIMENT, FREQUENCY, check_frequency, whole_numbers
from dashpot.data.readers.delimited.table import LARGEST, Table, bare, write_rows
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import SettledDwell, Stretch, WholeRecord
from dashpot.errors import DataError
from dashpot.io.words import listed
from dashpot.notices import Notice

SAMPLES, DOF, NOISE = "samples", "dof", "noise"
RECORD, FUNDAMENTAL = "record", "fundamental_hz"
OF_RECORDS = ("record_duration_s", "record_samples", "record_loads", "record_polynomial")
KINDS = ("given", "white", "blocks", "periods", "rest", "floor", "residual", "unknown")


def is_amplitudes(table: Table) -> bool:
    """There is a pair NAME_re, NAME_im."""
    names = {bare(name)[0] for name in table.header}
    return any(name.endswith("_re") and name[:-3] + "_im" in names for name in names)


def read_amplitudes(
    table: Table, channels: Sequence[Channel], experiment: int = 0
) -> tuple[Spectrum, list[Notice]]:
    """The spectrum in SI units with known calibrations taken out, and notes.

    No sd column at all: the noise is unknown (covariance NaN).  Where some channels have one, those without are exact.
    A channel may be left empty throughout an experiment: not measured there (amplitude NaN).
    Raises DataError with file, row and column for what is missing or not a number.
    """
    f_at = table.need(FREQUENCY)
    real = [table.need(f"{channel.name}_re", " (the rig file lists the channel)") for channel in channels]
    imaginary = [
        table.need(f"{channel.name}_im", " (the rig file lists the channel)") for channel in channels
    ]
    sd = [table.find(f"{channel.name}_sd") for channel in channels]
    for at, channel in zip([*real, *imaginary, *sd], [*channels] * 3, strict=True):
        if at is not None:
            table.check_unit(at, channel)
    pairs = {}
    for i, a in enumerate(channels):
        for j, b in enumerate(channels):
            columns = [table.find(f"{a.name}&{b.name}_cov_{part}") for part in ("re", "im")]
            if i != j and columns[0] is not None:
                pairs[i, j] = (columns[0], table.need(f"{a.name}&{b.name}_cov_im"))
    stretch_columns = {name: table.find(name) for name in (RECORD, FUNDAMENTAL, *OF_RECORDS)}
    if stretch_columns[RECORD] is None:
        stretch_columns = {}
    found = {name: table.find(name) for name in (EXPERIMENT, SAMPLES, DOF, NOISE)} | stretch_columns
    more = {name: at for name, at in found.items() if at is not None}
    gaps = [
        *real,
        *imaginary,
        *(at for at in sd if at is not None),
        *(at for pair in pairs.values() for at in pair),
    ]
    plain = [f_at, *(at for name, at in more.items() if name != NOISE)]
    gaps += [more[name] for name in (FUNDAMENTAL, *OF_RECORDS) if name in more]
    wanted = list(dict.fromkeys([*plain, *gaps]))
    values = table.numbers(wanted, gaps, [more[DOF]] if DOF in more else [])
    read = {*wanted, *more.values()}
    extra = [bare(name)[0] for i, name in enumerate(table.header) if i not in read]
    notes = list(table.notes)
    if extra:
        text = f"{table.source}: not read, because the rig file does not list them: {listed(extra)}"
        notes.append(Notice("columns_not_read", text, tuple(extra)))
    frequency = values[f_at]
    check_frequency(table, f_at, frequency)
    lines = len(frequency)
    experiments = np.full(lines, experiment, dtype=np.int64)
    if EXPERIMENT in more:
        experiments = whole_numbers(table, more[EXPERIMENT], values[more[EXPERIMENT]])
    samples = np.ones(lines, dtype=np.int64)
    if SAMPLES in more:
        samples = whole_numbers(table, more[SAMPLES], values[more[SAMPLES]])
        _check_positive(table, more[SAMPLES], samples.astype(float))
    dof = np.full(lines, np.inf)
    if DOF in more:
        dof = values[more[DOF]]
        _check_positive(table, more[DOF], dof)
    noise = ["given" if any(at is not None for at in sd) else "unknown"] * lines
    if NOISE in more:
        noise = table.texts(more[NOISE])
        for i, kind in enumerate(noise):
            if kind not in KINDS:
                raise table.error(
                    i, more[NOISE], f'"{kind[:40]}" is not known', f"it may be {', '.join(KINDS)}"
                )
    unknown = np.array([kind == "unknown" for kind in noise]) | all(at is None for at in sd)
    noise = ["unknown" if missing else kind for kind, missing in zip(noise, unknown.tolist(), strict=True)]
    scale = np.array([channel.scale for channel in channels])
    X = np.stack([values[a] + 1j * values[b] for a, b in zip(real, imaginary, strict=True)], axis=-1) * scale
    absent = _absent(table, experiments, real, imaginary, values)
    X[absent] = np.nan
    V = np.zeros((lines, len(channels), len(channels)), dtype=complex)
    for c, column in enumerate(sd):
        if column is None:
            continue
        missing = np.isnan(values[column])
        wrong = (values[column] < 0) | (missing & ~absent[:, c] & ~unknown)
        if np.any(wrong):
            i = int(np.argmax(wrong))
            cause = "the cell is empty" if missing[i] else f"a standard deviation of {values[column][i]:g}"
            raise table.error(i, column, cause, "give a number that is not negative; 0 is exact")
        V[:, c, c] = 2 * (np.where(missing, 0.0, values[column]) * scale[c]) ** 2
    for (i, j), (re, im) in pairs.items():
        known = ~(np.isnan(values[re]) | np.isnan(values[im]))
        product = np.where(known, values[re] + 1j * values[im], 0) * scale[i] * scale[j]
        V[:, i, j], V[:, j, i] = product, np.conj(product)
    large = ~absent & ~(np.abs(np.where(absent, 0, X)) <= LARGEST)
    if np.any(large):
        i, c = (int(k) for k in np.argwhere(large)[0])
        raise table.error(
            i, real[c], f"{np.abs(X[i, c]):g} (SI) is too large", "check the unit and the number"
        )
    if pairs:
        _check_definite(table, V, min(pairs.values())[0])
    V[unknown] = np.nan
    h = calibration(channels, frequency)
    V = V * h[:, :, None] * np.conj(h)[:, None, :]
    stretch, stretches = _stretches(table, more, values, lines)
    spectrum = Spectrum(
        tuple(channels), frequency, X * h, V, samples, dof, tuple(noise), experiments,
        stretch=stretch, stretches=stretches,
    )  # fmt: skip
    return spectrum, notes


def _stretches(
    table: Table, more: dict[str, int], values: dict[int, Real], lines: int
) -> tuple[Ints, tuple[Stretch, ...]]:
    """Which record or dwell each line belongs to.  Raises DataError where lines of one record disagree about it."""
    if RECORD not in more:
        return np.zeros(lines, dtype=np.int64), (SettledDwell(),)
    numbers = whole_numbers(table, more[RECORD], values[more[RECORD]])
    absent = np.full(lines, np.nan)
    of_record = np.stack(
        [values[more[name]] if name in more else absent for name in (FUNDAMENTAL, *OF_RECORDS)], axis=-1
    )
    stretch = np.zeros(lines, dtype=np.int64)
    stretches: list[Stretch] = []
    for number in np.unique(numbers):
        rows = np.flatnonzero(numbers == number)
        first = of_record[rows[0]]
        differs = ~np.all((of_record[rows] == first) | (np.isnan(of_record[rows]) & np.isnan(first)), axis=-1)
        if np.any(differs):
            row = int(rows[int(np.argmax(differs))])
            raise table.error(
                row, more[RECORD], f"record {number} is described differently in row {table.row(int(rows[0]))}",
                "its duration, samples, loads and columns must be the same in all of its lines",
            )  # fmt: skip
        fundamental, duration, samples, loads, polynomial = first.tolist()
        stretch[rows] = len(stretches)
        try:
            if np.isfinite(duration) and np.isfinite(samples):
                terms = 4 if np.isnan(polynomial) else int(polynomial)
                stretches.append(WholeRecord(duration, int(samples), loads != 0, terms))
            else:
                stretches.append(SettledDwell(None if np.isnan(fundamental) else fundamental))
        except DataError as error:
            what = error.problems[0]
            raise table.error(int(rows[0]), more[RECORD], what.what, what.cure or "") from error
    return stretch, tuple(stretches)


def _check_positive(table: Table, column: int, values: Real) -> None:
    wrong = ~(values > 0)
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise table.error(i, column, f"{values[i]:g}", "it must be positive")


def _check_definite(table: Table, V: Complex, column: int) -> None:
    """Raises DataError where variances and covariances do not fit together."""
    size = np.sqrt(np.diagonal(V, axis1=1, axis2=2).real)
    size = np.where(size > 0, size, 1.0)
    wrong = (
        np.linalg.eigvalsh(V / size[:, :, None] / size[:, None, :])[:, 0] < -1e-9 if V.size else np.zeros(0)
    )
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise table.error(
            i, column, "the covariances are larger than the sd of the channels allow", "correct either"
        )


def _absent(
    table: Table,
    experiments: Ints,
    real: list[int],
    imaginary: list[int],
    values: dict[int, Real],
) -> Bools:
    """(lines, channels): not measured.  Raises DataError for a gap that does not span an experiment."""
    empty = np.stack(
        [np.isnan(values[a]) & np.isnan(values[b]) for a, b in zip(real, imaginary, strict=True)], axis=-1
    )
    for c, (a, b) in enumerate(zip(real, imaginary, strict=True)):
        half = np.isnan(values[a]) != np.isnan(values[b])
        for number in np.unique(experiments[empty[:, c] | half]):
            mine = experiments == number
            if np.all(empty[mine, c]) and not np.all(empty[:, c]):
                continue
            i = int(np.argmax(mine & (half | empty[:, c])))
            at = a if np.isnan(values[a][i]) else b
            raise table.error(
                i,
                at,
                "the cell is empty",
                "fill the gap; a channel may be left out of a whole experiment only",
            )
    return empty


def write_amplitudes(spectrum: Spectrum, path: str | os.PathLike[str]) -> None:
    """Write a spectrum as a table that reads back to the same spectrum (second moments excepted), to rounding.

    Raises DataError for repeats (leading axes), and where the file cannot be written.
    """
    if spectrum.batch or spectrum.covariance.ndim != 3:
        raise DataError("a table holds one spectrum, not repeats of it", cure="write one file each")
    channels = spectrum.channels
    raw = np.array([channel.scale for channel in channels]) * calibration(channels, spectrum.frequency_hz)
    X = spectrum.amplitudes / raw
    V = spectrum.covariance / raw[:, :, None] / np.conj(raw)[:, None, :]
    absent = np.isnan(X)
    known = np.array([kind != "unknown" for kind in spectrum.noise], dtype=bool)
    header: list[str] = [FREQUENCY]
    columns: list[Sequence[object] | Real] = [spectrum.frequency_hz]
    if np.any(spectrum.experiment):
        header.append(EXPERIMENT)
        columns.append(_cells(spectrum.experiment))
    for c, channel in enumerate(channels):
        header += [f"{channel.name}_re", f"{channel.name}_im"]
        columns += [_cells(X[:, c].real, ~absent[:, c]), _cells(X[:, c].imag, ~absent[:, c])]
        if np.any(known):
            header.append(f"{channel.name}_sd")
            sd = np.sqrt(np.maximum(V[:, c, c].real, 0) / 2)
            columns.append(_cells(sd, known & ~absent[:, c]))
    for i, a in enumerate(channels):
        for j in range(i + 1, len(channels)):
            if np.any(V[known, i, j] != 0):
                header += [f"{a.name}&{channels[j].name}_cov_{part}" for part in ("re", "im")]
                columns += [_cells(V[:, i, j].real, known), _cells(V[:, i, j].imag, known)]
    header += [SAMPLES, DOF, NOISE]
    columns += [_cells(spectrum.samples), _cells(spectrum.dof), list(spectrum.noise)]
    for name, cells in _stretch_cells(spectrum):
        header.append(name)
        columns.append(cells)
    write_rows(path, header, columns)


def _stretch_cells(spectrum: Spectrum) -> list[tuple[str, Sequence[object]]]:
    """Columns that say which record or dwell each line belongs to; none where all lines stand for themselves."""
    if spectrum.stretches == (SettledDwell(),):
        return []
    rows = []
    for number, value in enumerate(spectrum.stretches):
        if isinstance(value, WholeRecord):
            of_record = (value.duration_s, value.samples, int(value.loads), value.polynomial)
            rows.append((str(number), "", *(repr(part) for part in of_record)))
        else:
            fundamental = "" if value.fundamental_hz is None else repr(value.fundamental_hz)
            rows.append((str(number), fundamental, *[""] * len(OF_RECORDS)))
    return [
        (name, [rows[k][i] for k in spectrum.stretch.tolist()])
        for i, name in enumerate((RECORD, FUNDAMENTAL, *OF_RECORDS))
        if any(row[i] for row in rows)
    ]


def _cells(values: Real | Ints, there: Bools | None = None) -> Sequence[object]:
    """Numbers with all their digits, empty where there are none."""
    shown = np.ones(len(values), dtype=bool) if there is None else there
    return [repr(value) if yes else "" for value, yes in zip(values.tolist(), shown.tolist(), strict=True)]
