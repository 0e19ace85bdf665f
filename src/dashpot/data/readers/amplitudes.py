"""Tables of complex amplitudes as CSV: `frequency_hz`, then `NAME_re`, `NAME_im` and optionally `NAME_sd`.

x(t) = Re(X e^{jωt}); `NAME_sd` is the standard deviation of the real and of the imaginary part, each.  Further
optional columns: `experiment`, `samples`, `dof`, `noise` and, for noise that channels share, `A&B_cov_re` and
`A&B_cov_im`, the covariance E[Δ_A conj(Δ_B)].  Numbers are raw, in the channels' own units, calibrations still in.
Lines of one whole record, which share its boundary loads, have one number in the column `record`,
with `record_duration_s`, `record_samples`, `record_loads` (0 or 1), `record_polynomial` (0 to 6) and `record_ramp` (0
or 1).  Lines of one settled dwell have its number there and `fundamental_hz`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot import units
from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.channel import Channel
from dashpot.data.readers.columns import FREQUENCY, LARGEST, Columns, bare, frequency_column, frequency_scale
from dashpot.data.readers.records import EXPERIMENT, check_frequency, experiment_column, whole_numbers
from dashpot.data.readers.text import write_rows
from dashpot.data.record import calibrated, calibration
from dashpot.data.spectrum import SettledDwell, Spectrum, Stretch, WholeRecord
from dashpot.errors import DashpotError, DataError
from dashpot.io.words import shown
from dashpot.notices import Notice

# Complex amplitudes as pairs of columns: NAME_re and NAME_im, or NAME_amplitude and NAME_phase.
#
# X = amplitude · e^{j phase}. The phase is in the unit in brackets behind its name, in degrees where there
# is none; NAME_phase_deg and NAME_phase_rad say it in the name. Amplitudes in dB, of 20 log10, say so in
# brackets: NAME_amplitude [dB]. Responses to inputs are OUT/IN_re, OUT/IN_amplitude, ….


AMPLITUDES = ("_amplitude", "_amp", "_abs", "_magnitude", "_mag")
PHASES = ("_phase", "_phase_deg", "_phase_rad", "_ph", "_arg")


@dataclass(frozen=True)
class AmplitudeColumns:
    """Two columns of one complex amplitude: real and imaginary part, or amplitude and phase.

    to_radian  factor from the numbers of the phase to rad; None if there is none
    decibel    whether the amplitude is in dB
    """

    first: int
    second: int
    to_radian: float | None = None
    decibel: bool = False

    def of(self, values: Mapping[int, Real]) -> Complex:
        """The amplitude from the numbers of the columns."""
        first, second = values[self.first], values[self.second]
        if self.to_radian is None:
            return first + 1j * second
        size = 10 ** (first / 20) if self.decibel else first
        return size * np.cos(second * self.to_radian) + 1j * (size * np.sin(second * self.to_radian))


def amplitude_columns(columns: Columns) -> dict[str, AmplitudeColumns]:
    """Columns of amplitudes by the names in front of _re, or of _amplitude where there is no _re.

    Raises DataError if the unit of a phase is none of angle.
    """
    at = {bare(name)[0]: i for i, name in reversed(list(enumerate(columns.header)))}
    names = list(reversed(at))
    found = {
        name[:-3]: AmplitudeColumns(at[name], at[f"{name[:-3]}_im"])
        for name in names
        if name.endswith("_re") and f"{name[:-3]}_im" in at
    }
    for ending in AMPLITUDES:
        for name in names:
            stem = name.removesuffix(ending)
            if not name.endswith(ending) or not stem or f"{stem}_re" in at or stem in found:
                continue
            phases = [at[stem + phase] for phase in PHASES if stem + phase in at]
            if len(phases) == 1:
                decibel = (columns.unit(at[name]) or "").lower() == "db"
                to_radian = phase_factor(columns, phases[0])
                found[stem] = AmplitudeColumns(at[name], phases[0], to_radian, decibel)
    return found


def phase_factor(columns: Columns, column: int) -> float:
    """Factor from the numbers of a phase to rad."""
    unit = columns.unit(column)
    if unit is None:
        unit = "rad" if bare(columns.header[column])[0].endswith("_rad") else "deg"
    try:
        return units.scale(unit, "displacement", angular=True)
    except DashpotError:
        what = f"column {shown(columns.header[column])}: {shown(unit)} is not a unit of angle"
        raise DataError(what, columns.heading, "give the phase in deg or rad") from None


def required(
    columns: Columns, found: Mapping[str, AmplitudeColumns], stem: str, why: str = ""
) -> AmplitudeColumns:
    """The columns of one amplitude.  Raises DataError if one is missing or named twice."""
    if stem in found and found[stem].to_radian is not None:
        return found[stem]
    return AmplitudeColumns(columns.need(f"{stem}_re", why), columns.need(f"{stem}_im", why))


def phase_notices(
    columns: Columns, found: Mapping[str, AmplitudeColumns], frequency_hz: Real
) -> list[Notice]:
    """What is said of amplitudes and phases whose numbers look like another unit than theirs; [] where there are none.

    Amplitudes below zero are refused: they are most likely decibels.  Phases in rad beyond a turn are unwrapped,
    and so move by little from one frequency to the next: others are degrees, which is refused.  Degrees that never
    exceed π may be radians, or a rig far below its first mode.  Fewer than 4 lines are not judged.
    Raises DataError.
    """
    polar = [pair for pair in found.values() if pair.to_radian is not None]
    if not polar or len(frequency_hz) < 4:
        return []
    every = [at for pair in polar for at in (pair.first, pair.second)]
    values = columns.numbers(every, every)
    largest = 0.0  # of those in degrees
    for pair in polar:
        name, size = shown(columns.header[pair.first]), values[pair.first]
        if not pair.decibel and np.any(size < 0):
            what = f"column {name}: an amplitude of {float(np.nanmin(size)):.4g} is below zero, as decibels may be"
            plain = bare(columns.header[pair.first])[0]
            cure = f"name the column {plain}[dB] if they are; else give amplitudes from 0"
            raise DataError(what, columns.heading, cure)
        phase = values[pair.second]
        if pair.to_radian != 1.0:
            largest = max(largest, float(np.nanmax(np.abs(phase), initial=0.0)))
            continue
        order = np.argsort(
            frequency_hz[: len(phase)], kind="stable"
        )  # responses repeat theirs for each input
        phase = phase[order][np.isfinite(phase[order])]
        most, leap = (float(np.max(np.abs(x), initial=0.0)) for x in (phase, np.diff(phase)))
        if most > 6.5 and leap > 5.0:  # more than a turn, and than unwrapped phases move
            name = shown(columns.header[pair.second])
            what = (
                f"column {name}: phases of up to {most:.4g} rad that leap by {leap:.3g} rad look like degrees"
            )
            stem = bare(columns.header[pair.second])[0].removesuffix("_rad").removesuffix("_deg")
            raise DataError(what, columns.heading, f"name the column {stem}_deg, or unwrap the phases")
    if not 0 < largest < 3.2:  # slightly more than π
        return []
    text = f"phases are taken to be in degrees, but none exceeds {largest:.3g}: are they in radians?"
    of = tuple(columns.header[pair.second] for pair in polar if pair.to_radian != 1.0)
    return [Notice("phase_unit", text, of)]


def frequency_at(columns: Columns, channels: Sequence[Channel]) -> int:
    at = frequency_column(columns, channels)
    return columns.need(FREQUENCY) if at is None else at


SAMPLES, DOF, NOISE = "samples", "dof", "noise"
RECORD, FUNDAMENTAL, PER_UNIT = "record", "fundamental_hz", "per_unit"
OF_RECORDS = ("record_duration_s", "record_samples", "record_loads", "record_polynomial", "record_ramp")
KINDS = ("given", "white", "blocks", "periods", "rest", "floor", "residual", "unknown")


@dataclass(frozen=True)
class _Layout:
    """Where everything stands: columns of the frequency and, for each channel, of its amplitude and sd.

    scales     to SI units, one for each channel
    pairs      {(channel, channel): columns of their covariance}
    more       {name: column} of what else there is
    named      whether experiments may have names, so that their column is text
    """

    frequency: int
    amplitudes: list[AmplitudeColumns]
    sd: list[int | None]
    scales: Real
    pairs: dict[tuple[int, int], AmplitudeColumns]
    more: dict[str, int]
    named: bool = False

    @property
    def gaps(self) -> list[int]:
        """Columns that may have empty cells."""
        complexes = [*self.amplitudes, *self.pairs.values()]
        of_stretches = (self.more[name] for name in (FUNDAMENTAL, PER_UNIT, *OF_RECORDS) if name in self.more)
        sd = (at for at in self.sd if at is not None)
        return [*(at for pair in complexes for at in (pair.first, pair.second)), *sd, *of_stretches]

    @property
    def numeric(self) -> list[int]:
        """All columns of numbers."""
        texts = (NOISE, EXPERIMENT) if self.named else (NOISE,)
        plain = [self.frequency, *(at for name, at in self.more.items() if name not in texts)]
        return list(dict.fromkeys([*plain, *self.gaps]))


def read_amplitudes(
    columns: Columns,
    found: Mapping[str, AmplitudeColumns],
    channels: Sequence[Channel],
    experiment: int = 0,
    named: Sequence[str] = (),
) -> tuple[Spectrum, list[Notice]]:
    """The spectrum in SI units with known calibrations taken out, and notes.  `found` are the amplitude columns.

    No sd column at all: the noise is unknown (covariance NaN).  Where some channels have one, those without are exact.
    A channel may be left empty throughout an experiment: not measured there (amplitude NaN).  A column `experiment` may
    hold the names of those that are `named`.
    Raises DataError with file, row and column for what is missing or not a number.
    """
    layout = _layout(columns, found, channels, named)
    values = columns.numbers(layout.numeric, layout.gaps, [layout.more[DOF]] if DOF in layout.more else [])
    frequency = values[layout.frequency] * frequency_scale(columns, layout.frequency)
    check_frequency(columns, layout.frequency, frequency)
    lines = len(frequency)
    # Experiment, samples and degrees of freedom of each line
    experiments, samples = np.full(lines, experiment, dtype=np.int64), np.ones(lines, dtype=np.int64)
    dof = np.full(lines, np.inf)
    if EXPERIMENT in layout.more:
        at = layout.more[EXPERIMENT]
        experiments = experiment_column(columns, at, values.get(at), named)
    if SAMPLES in layout.more:
        at = layout.more[SAMPLES]
        samples = whole_numbers(columns, at, values[at])
        columns.refuse(at, samples <= 0, "{:g}", "it must be positive", values[at])
    if DOF in layout.more:
        dof = values[layout.more[DOF]]
        columns.refuse(layout.more[DOF], ~(dof > 0), "{:g}", "it must be positive", dof)
    # How the noise of each line was found
    given = any(at is not None for at in layout.sd)
    if NOISE not in layout.more:
        noise = ("given" if given else "unknown",) * lines
    else:
        kinds = columns.texts(layout.more[NOISE])
        for i, kind in enumerate(kinds):
            if kind not in KINDS:
                what = f'"{kind[:40]}" is not known'
                raise columns.error(i, layout.more[NOISE], what, f"it may be {', '.join(KINDS)}")
        noise = tuple(kinds) if given else ("unknown",) * lines
    unknown = np.array([kind == "unknown" for kind in noise], dtype=bool)
    X = np.stack([pair.of(values) for pair in layout.amplitudes], axis=-1) * layout.scales
    absent = _absent(columns, experiments, layout.amplitudes, values)
    X[absent] = np.nan
    V = _covariance(columns, layout, values, absent, unknown)
    large = ~absent & ~(np.abs(np.where(absent, 0, X)) <= LARGEST)
    if np.any(large):
        i, c = (int(k) for k in np.argwhere(large)[0])
        what = f"{np.abs(X[i, c]):g} (SI) is too large"
        raise columns.error(i, layout.amplitudes[c].first, what, "check the unit and the number")
    stretch, stretches = _stretches(columns, layout.more, values, lines)
    firsts = (pair.first for pair in layout.amplitudes)
    spectrum = Spectrum(
        tuple(map(columns.described, firsts, channels)),
        frequency,
        *calibrated(channels, frequency, X, V),
        samples,
        dof,
        noise,
        experiments,
        stretch=stretch,
        stretches=stretches,
    )
    unread = columns.not_read({*layout.numeric, *layout.more.values()})
    return spectrum, [*columns.notes, *unread]


def _layout(
    columns: Columns, found: Mapping[str, AmplitudeColumns], channels: Sequence[Channel], named: Sequence[str]
) -> _Layout:
    """Where everything stands.  Raises DataError for a column that is missing or of another unit."""
    why = " (the rig file lists the channel)"
    at_frequency = frequency_at(columns, channels)
    amplitudes = [required(columns, found, channel.name, why) for channel in channels]
    sd = [columns.find(f"{channel.name}_sd") for channel in channels]
    scales = []
    for pair, at, channel in zip(amplitudes, sd, channels, strict=True):
        scale = channel.scale if pair.decibel else columns.scale(pair.first, channel)
        scales.append(scale)
        for other in (at, pair.second if pair.to_radian is None else None):
            if other is None or not columns.unit(other):
                continue
            if not np.isclose(columns.scale(other, channel), scale, rtol=1e-9):
                what = f"column {channel.name}: real part, imaginary part and sd are in different units"
                raise DataError(what, columns.heading, "give all three in one unit")
    pairs = {}
    for i, a in enumerate(channels):
        for j, b in enumerate(channels):
            name = f"{a.name}&{b.name}_cov"
            if i != j and columns.find(f"{name}_re") is not None:
                pairs[i, j] = required(columns, found, name)
    names = [EXPERIMENT, SAMPLES, DOF, NOISE]
    if columns.find(RECORD) is not None:
        names += [RECORD, FUNDAMENTAL, PER_UNIT, *OF_RECORDS]
    more = {name: at for name in names if (at := columns.find(name)) is not None}
    return _Layout(at_frequency, amplitudes, sd, np.array(scales), pairs, more, bool(named))


def _covariance(
    columns: Columns, layout: _Layout, values: dict[int, Real], absent: Bools, unknown: Bools
) -> Complex:
    """E[Δ Δᴴ] in SI units, (lines, channels, channels); NaN where it is unknown.  Raises DataError."""
    lines, channels = absent.shape
    V = np.zeros((lines, channels, channels), dtype=complex)
    for c, column in enumerate(layout.sd):
        if column is None:
            continue
        missing = np.isnan(values[column])
        wrong = (values[column] < 0) | (missing & ~absent[:, c] & ~unknown)
        if np.any(wrong):
            i = int(np.argmax(wrong))
            cause = "the cell is empty" if missing[i] else f"a standard deviation of {values[column][i]:g}"
            raise columns.error(i, column, cause, "give a number that is not negative; 0 is exact")
        V[:, c, c] = 2 * (np.where(missing, 0.0, values[column]) * layout.scales[c]) ** 2
    for (i, j), pair in layout.pairs.items():
        product = pair.of(values)
        product = np.where(np.isnan(product), 0, product) * layout.scales[i] * layout.scales[j]
        V[:, i, j], V[:, j, i] = product, np.conj(product)
    if layout.pairs:
        size = np.sqrt(np.diagonal(V, axis1=1, axis2=2).real)
        size = np.where(size > 0, size, 1.0)
        if V.size:
            wrong = np.linalg.eigvalsh(V / size[:, :, None] / size[:, None, :])[:, 0] < -1e-9
            what = "the covariances are larger than the sd of the channels allow"
            columns.refuse(min(pair.first for pair in layout.pairs.values()), wrong, what, "correct either")
    V[unknown] = np.nan
    return V


def _stretches(
    columns: Columns, more: dict[str, int], values: dict[int, Real], lines: int
) -> tuple[Ints, tuple[Stretch, ...]]:
    """Which record or dwell each line belongs to.  Raises DataError if lines of one record disagree about it."""
    if RECORD not in more:
        return np.zeros(lines, dtype=np.int64), (SettledDwell(),)
    numbers = whole_numbers(columns, more[RECORD], values[more[RECORD]])
    absent = np.full(lines, np.nan)
    of_record = np.stack(
        [values[more[name]] if name in more else absent for name in (FUNDAMENTAL, PER_UNIT, *OF_RECORDS)],
        axis=-1,
    )
    stretch = np.zeros(lines, dtype=np.int64)
    stretches: list[Stretch] = []
    for number in np.unique(numbers):
        rows = np.flatnonzero(numbers == number)
        first = of_record[rows[0]]
        differs = ~np.all((of_record[rows] == first) | (np.isnan(of_record[rows]) & np.isnan(first)), axis=-1)
        if np.any(differs):
            row = int(rows[int(np.argmax(differs))])
            raise columns.error(
                row,
                more[RECORD],
                f"record {number} is described differently at {columns.place(int(rows[0]))}",
                "its duration, samples, loads and columns must be the same in all of its lines",
            )
        fundamental, per_unit, duration, samples, loads, polynomial, ramp = first.tolist()
        stretch[rows] = len(stretches)
        try:
            if np.isfinite(duration) and np.isfinite(samples):
                terms = 3 if np.isnan(polynomial) else int(polynomial)
                stretches.append(WholeRecord(duration, int(samples), loads != 0, terms, ramp == 1))
            else:
                stretches.append(SettledDwell(None if np.isnan(fundamental) else fundamental, per_unit == 1))
        except DataError as error:
            what = error.problems[0]
            raise columns.error(int(rows[0]), more[RECORD], what.what, what.cure or "") from error
    return stretch, tuple(stretches)


def _absent(
    columns: Columns, experiments: Ints, amplitudes: Sequence[AmplitudeColumns], values: Mapping[int, Real]
) -> Bools:
    """(lines, channels): not measured.  Raises DataError for a gap that does not span an experiment."""
    empty = np.zeros((len(experiments), len(amplitudes)), dtype=bool)
    for c, pair in enumerate(amplitudes):
        first, second = np.isnan(values[pair.first]), np.isnan(values[pair.second])
        empty[:, c] = first & second
        gap = first | second
        for number in np.unique(experiments[gap]):
            mine = experiments == number
            if np.all(empty[mine, c]) and not np.all(empty[:, c]):
                continue
            row = int(np.argmax(mine & gap))
            at = pair.first if first[row] else pair.second
            cure = "fill the gap; a channel may be left out of a whole experiment only"
            raise columns.error(row, at, "the cell is empty", cure)
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
            of_record = (value.duration_s, value.samples, int(value.loads), value.polynomial, int(value.ramp))
            rows.append((str(number), "", "", *(repr(part) for part in of_record)))
        else:
            fundamental = "" if value.fundamental_hz is None else repr(value.fundamental_hz)
            rows.append((str(number), fundamental, "1" if value.per_unit else "", *[""] * len(OF_RECORDS)))
    return [
        (name, [rows[k][i] for k in spectrum.stretch.tolist()])
        for i, name in enumerate((RECORD, FUNDAMENTAL, PER_UNIT, *OF_RECORDS))
        if any(row[i] for row in rows)
    ]


def _cells(values: Real | Ints, there: Bools | None = None) -> Sequence[object]:
    """Numbers with all their digits, empty where there are none."""
    shown = np.ones(len(values), dtype=bool) if there is None else there
    return [repr(value) if yes else "" for value, yes in zip(values.tolist(), shown.tolist(), strict=True)]
