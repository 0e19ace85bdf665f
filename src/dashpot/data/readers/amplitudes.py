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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot import units
from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.channel import Channel
from dashpot.data.calibration import calibration
from dashpot.data.readers.columns import LARGEST, Columns, bare
from dashpot.data.readers.records import EXPERIMENT, check_frequency, whole_numbers
from dashpot.data.readers.text import write_rows
from dashpot.data.readers.time_columns import FREQUENCY, frequency_column, frequency_scale
from dashpot.data.spectrum import SettledDwell, Spectrum, Stretch, WholeRecord, concatenate
from dashpot.errors import DashpotError, DataError
from dashpot.io.words import listed, shown
from dashpot.notices import Notice

# Tables of amplitude and phase, NAME_amplitude and NAME_phase, as tables of real and imaginary part.
#
# X = amplitude · e^{j phase}. The phase is in the unit in brackets behind its name, in degrees where there
# is none; NAME_phase_deg and NAME_phase_rad say it in the name. Amplitudes in dB, of 20 log10, say so in
# brackets: NAME_amplitude [dB]. Responses to inputs are OUT/IN_amplitude, OUT/IN_phase.


AMPLITUDES = ("_amplitude", "_amp", "_abs", "_magnitude", "_mag")
PHASES = ("_phase", "_phase_deg", "_phase_rad", "_ph", "_arg")
# Slightly more than π and 2π: what phases in rad do not exceed unless they are unwrapped.
HALF_TURN, TURN = 3.2, 6.5
LEAP = 5.0  # between neighbouring frequencies, in rad: more than unwrapped phases move
FEW = 4  # lines from which on phases are judged


@dataclass(frozen=True)
class _Polar:
    """A pair of columns, the factor from the phase's numbers to rad, and whether amplitudes are in dB."""

    amplitude: int
    phase: int
    to_radian: float
    decibel: bool = False


@dataclass(frozen=True)
class RectangularColumns(Columns):
    """Columns of `base`, and behind them the real and imaginary parts of its pairs of amplitude and phase."""

    base: Columns
    pairs: tuple[_Polar, ...]

    @property
    def heading(self) -> str:
        """That of the base."""
        return self.base.heading

    def place(self, index: int) -> str:
        """That of the base."""
        return self.base.place(index)

    def part_from(self, index: int) -> str:
        """That of the base."""
        return self.base.part_from(index)

    def numbers(
        self,
        columns: Sequence[int],
        optional: Sequence[int] = (),
        infinite: Sequence[int] = (),
        together: Sequence[int] = (),
    ) -> dict[int, Real]:
        """As of Columns."""
        del together  # what is computed is new
        plain = len(self.base.header)
        computed = [column for column in columns if column >= plain]
        sources = self.sources(computed)
        gaps = self.sources(column for column in computed if column in optional)
        wanted = list(dict.fromkeys([*(column for column in columns if column < plain), *sorted(sources)]))
        values = self.base.numbers(wanted, [*(c for c in optional if c < plain), *gaps], infinite)
        for column in computed:
            pair = self.pairs[(column - plain) // 2]
            wave = np.cos if (column - plain) % 2 == 0 else np.sin
            size = values[pair.amplitude]
            size = 10 ** (size / 20) if pair.decibel else size
            values[column] = size * wave(values[pair.phase] * pair.to_radian)
        return values

    def sources(self, columns: Iterable[int]) -> set[int]:
        """The columns of amplitude and phase behind those of these columns that are computed."""
        plain = len(self.base.header)
        pairs = [self.pairs[(column - plain) // 2] for column in columns if column >= plain]
        return {at for pair in pairs for at in (pair.amplitude, pair.phase)}

    def texts(self, column: int) -> list[str]:
        """As of Columns."""
        return self.base.texts(column)

    def first(self, column: int) -> str:
        """As of Columns."""
        return self.base.first(column)


def with_real_and_imaginary(columns: Columns) -> Columns:
    """The same with NAME_re and NAME_im for each pair NAME_amplitude, NAME_phase that stands without them.

    Raises DataError where the unit of a phase is none of angle.
    """
    names = [bare(name)[0] for name in columns.header]
    header, unit_of, pairs = list(columns.header), [columns.unit(i) for i in range(len(names))], []
    for ending in AMPLITUDES:
        for at, name in enumerate(names):
            stem = name.removesuffix(ending)
            if not name.endswith(ending) or not stem or f"{stem}_re" in names or f"{stem}_re" in header:
                continue
            phases = [i for i, other in enumerate(names) if other in [stem + phase for phase in PHASES]]
            if len(phases) != 1:
                continue
            unit = columns.unit(at)
            decibel = unit is not None and unit.lower() == "db"
            pairs.append(_Polar(at, phases[0], _to_radian(columns, phases[0]), decibel))
            header += [f"{stem}_re", f"{stem}_im"]
            unit_of += [None if decibel else unit] * 2
    if not pairs:
        return columns
    return RectangularColumns(
        columns.source, tuple(header), tuple(unit_of), columns.notes, columns, tuple(pairs)
    )


def polar_notices(columns: Columns, frequency_hz: Real) -> list[Notice]:
    """What is said of amplitudes and phases whose numbers look like another unit than theirs; [] where there are none.

    Amplitudes below zero are refused: they are most likely decibels.  Phases in rad beyond a turn are unwrapped,
    and so move by little from one frequency to the next: others are degrees, which is refused.  Degrees that never
    exceed π may be radians, or a rig far below its first mode.
    Raises DataError.
    """
    if not isinstance(columns, RectangularColumns) or len(frequency_hz) < FEW:
        return []
    _require_amplitudes(columns)
    places = [pair.phase for pair in columns.pairs]
    phases = columns.base.numbers(places, places)
    rows = len(phases[places[0]])
    order = np.argsort(frequency_hz[:rows], kind="stable")  # frequency responses repeat theirs for each input
    for pair in columns.pairs:
        numbers = phases[pair.phase][order]
        numbers = numbers[np.isfinite(numbers)]
        if pair.to_radian == 1.0 and np.max(np.abs(numbers), initial=0.0) > TURN:
            _require_unwrapped(columns, pair.phase, numbers)
    in_degrees = [pair.phase for pair in columns.pairs if pair.to_radian != 1.0]
    largest = max((float(np.nanmax(np.abs(phases[place]), initial=0.0)) for place in in_degrees), default=0.0)
    if not 0 < largest < HALF_TURN:
        return []
    text = f"phases are read as degrees, and none exceeds {largest:.3g}: they may be radians"
    return [Notice("phase_unit", text, tuple(columns.header[place] for place in in_degrees))]


def _require_amplitudes(columns: RectangularColumns) -> None:
    """Raises DataError where an amplitude of a column that is not in dB is below zero."""
    places = [pair.amplitude for pair in columns.pairs if not pair.decibel]
    amplitudes = columns.base.numbers(places, places)
    for place in places:
        numbers = amplitudes[place]
        if np.any(numbers < 0):
            name, least = shown(columns.header[place]), float(np.nanmin(numbers))
            raise DataError(
                f"column {name}: an amplitude of {least:.4g} is below zero, as decibels may be",
                columns.heading,
                f"name the column {bare(columns.header[place])[0]}[dB] if they are; else give amplitudes from 0",
            )


def _require_unwrapped(columns: Columns, place: int, numbers: Real) -> None:
    """Raises DataError for phases in rad, in order of frequency, that are neither wrapped nor unwrapped."""
    leap = float(np.max(np.abs(np.diff(numbers)), initial=0.0))
    if leap > LEAP:
        name, largest = shown(columns.header[place]), float(np.max(np.abs(numbers)))
        what = (
            f"column {name}: phases of up to {largest:.4g} rad that leap by {leap:.3g} rad look like degrees"
        )
        stem = bare(columns.header[place])[0].removesuffix("_rad").removesuffix("_deg")
        raise DataError(what, columns.heading, f"name the column {stem}_deg, or unwrap the phases")


def _to_radian(columns: Columns, column: int) -> float:
    """Factor from the numbers of a phase to rad."""
    unit = columns.unit(column)
    if unit is None:
        unit = "rad" if bare(columns.header[column])[0].endswith("_rad") else "deg"
    try:
        return units.scale(unit, "displacement", angular=True)
    except DashpotError:
        what = f"column {shown(columns.header[column])}: {shown(unit)} is not a unit of angle"
        raise DataError(what, columns.heading, "give the phase in deg or rad") from None


# Tables of frequency response functions as CSV: `frequency_hz`, then `OUT/IN_re`, `OUT/IN_im`, optionally
# `OUT/IN_sd`.
#
# OUT and IN are channels of the rig file, in their units; `OUT/IN_sd` is the standard deviation of the real
# and of the imaginary part, each. Every input makes an experiment of its own, driven with amplitude 1 at IN
# and 0 at the others, which are exact.


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


SAMPLES, DOF, NOISE = "samples", "dof", "noise"
RECORD, FUNDAMENTAL = "record", "fundamental_hz"
OF_RECORDS = ("record_duration_s", "record_samples", "record_loads", "record_polynomial", "record_ramp")
KINDS = ("given", "white", "blocks", "periods", "rest", "floor", "residual", "unknown")


def is_amplitudes(columns: Columns) -> bool:
    """There is a pair NAME_re, NAME_im."""
    names = {bare(name)[0] for name in columns.header}
    return any(name.endswith("_re") and name[:-3] + "_im" in names for name in names)


@dataclass(frozen=True)
class _Layout:
    """Where everything stands: columns of the frequency and, for each channel, of real and imaginary part and sd.

    scales     to SI units, one for each channel
    pairs      {(channel, channel): columns of the real and imaginary part of their covariance}
    more       {name: column} of what else there is
    """

    frequency: int
    real: list[int]
    imaginary: list[int]
    sd: list[int | None]
    scales: Real
    pairs: dict[tuple[int, int], tuple[int, int]]
    more: dict[str, int]

    @property
    def gaps(self) -> list[int]:
        """Columns that may have empty cells."""
        of_pairs = (at for pair in self.pairs.values() for at in pair)
        of_stretches = (self.more[name] for name in (FUNDAMENTAL, *OF_RECORDS) if name in self.more)
        sd = (at for at in self.sd if at is not None)
        return [*self.real, *self.imaginary, *sd, *of_pairs, *of_stretches]

    @property
    def numeric(self) -> list[int]:
        """All columns of numbers."""
        plain = [self.frequency, *(at for name, at in self.more.items() if name != NOISE)]
        return list(dict.fromkeys([*plain, *self.gaps]))


def read_amplitudes(
    columns: Columns, channels: Sequence[Channel], experiment: int = 0
) -> tuple[Spectrum, list[Notice]]:
    """The spectrum in SI units with known calibrations taken out, and notes.

    No sd column at all: the noise is unknown (covariance NaN).  Where some channels have one, those without are exact.
    A channel may be left empty throughout an experiment: not measured there (amplitude NaN).
    Raises DataError with file, row and column for what is missing or not a number.
    """
    layout = _layout(columns, channels)
    values = columns.numbers(layout.numeric, layout.gaps, [layout.more[DOF]] if DOF in layout.more else [])
    frequency = values[layout.frequency] * frequency_scale(columns, layout.frequency)
    check_frequency(columns, layout.frequency, frequency)
    lines = len(frequency)
    experiments, samples, dof = _counts(columns, layout, values, lines, experiment)
    noise = _kinds_of_noise(columns, layout, lines)
    unknown = np.array([kind == "unknown" for kind in noise], dtype=bool)
    X = (
        np.stack(
            [values[a] + 1j * values[b] for a, b in zip(layout.real, layout.imaginary, strict=True)], axis=-1
        )
        * layout.scales
    )
    absent = _absent(columns, experiments, layout.real, layout.imaginary, values)
    X[absent] = np.nan
    V = _covariance(columns, layout, values, absent, unknown)
    large = ~absent & ~(np.abs(np.where(absent, 0, X)) <= LARGEST)
    if np.any(large):
        i, c = (int(k) for k in np.argwhere(large)[0])
        what = f"{np.abs(X[i, c]):g} (SI) is too large"
        raise columns.error(i, layout.real[c], what, "check the unit and the number")
    h = calibration(channels, frequency)
    V = V * h[:, :, None] * np.conj(h)[:, None, :]
    stretch, stretches = _stretches(columns, layout.more, values, lines)
    spectrum = Spectrum(
        tuple(channels),
        frequency,
        X * h,
        V,
        samples,
        dof,
        noise,
        experiments,
        stretch=stretch,
        stretches=stretches,
    )
    return spectrum, _notes(columns, layout)


def _layout(columns: Columns, channels: Sequence[Channel]) -> _Layout:
    """Where everything stands.  Raises DataError for a column that is missing or of another unit."""
    f_at = frequency_column(columns, channels)
    f_at = columns.need(FREQUENCY) if f_at is None else f_at
    why = " (the rig file lists the channel)"
    real = [columns.need(f"{channel.name}_re", why) for channel in channels]
    imaginary = [columns.need(f"{channel.name}_im", why) for channel in channels]
    sd = [columns.find(f"{channel.name}_sd") for channel in channels]
    scales = [columns.scale(at, channel) for at, channel in zip(real, channels, strict=True)]
    for at, scale, channel in zip([*imaginary, *sd], [*scales] * 2, [*channels] * 2, strict=True):
        if (
            at is not None
            and columns.unit(at)
            and not np.isclose(columns.scale(at, channel), scale, rtol=1e-9)
        ):
            what = f"column {channel.name}: real part, imaginary part and sd are in different units"
            raise DataError(what, columns.heading, "give all three in one unit")
    pairs = {}
    for i, a in enumerate(channels):
        for j, b in enumerate(channels):
            re = columns.find(f"{a.name}&{b.name}_cov_re")
            if i != j and re is not None:
                pairs[i, j] = (re, columns.need(f"{a.name}&{b.name}_cov_im"))
    names = [EXPERIMENT, SAMPLES, DOF, NOISE]
    if columns.find(RECORD) is not None:
        names += [RECORD, FUNDAMENTAL, *OF_RECORDS]
    more = {name: at for name in names if (at := columns.find(name)) is not None}
    return _Layout(f_at, real, imaginary, sd, np.array(scales), pairs, more)


def _counts(
    columns: Columns, layout: _Layout, values: dict[int, Real], lines: int, experiment: int
) -> tuple[Ints, Ints, Real]:
    """Experiment, samples and degrees of freedom of each line."""
    experiments, samples = np.full(lines, experiment, dtype=np.int64), np.ones(lines, dtype=np.int64)
    dof = np.full(lines, np.inf)
    if EXPERIMENT in layout.more:
        at = layout.more[EXPERIMENT]
        experiments = whole_numbers(columns, at, values[at])
    if SAMPLES in layout.more:
        at = layout.more[SAMPLES]
        samples = whole_numbers(columns, at, values[at])
        _check_positive(columns, at, samples.astype(float))
    if DOF in layout.more:
        dof = values[layout.more[DOF]]
        _check_positive(columns, layout.more[DOF], dof)
    return experiments, samples, dof


def _kinds_of_noise(columns: Columns, layout: _Layout, lines: int) -> tuple[str, ...]:
    """How the noise of each line was found.  Raises DataError for a word that is not known."""
    given = any(at is not None for at in layout.sd)
    if NOISE not in layout.more:
        return ("given" if given else "unknown",) * lines
    kinds = columns.texts(layout.more[NOISE])
    for i, kind in enumerate(kinds):
        if kind not in KINDS:
            what = f'"{kind[:40]}" is not known'
            raise columns.error(i, layout.more[NOISE], what, f"it may be {', '.join(KINDS)}")
    return tuple(kinds) if given else ("unknown",) * lines


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
    for (i, j), (re, im) in layout.pairs.items():
        known = ~(np.isnan(values[re]) | np.isnan(values[im]))
        product = np.where(known, values[re] + 1j * values[im], 0) * layout.scales[i] * layout.scales[j]
        V[:, i, j], V[:, j, i] = product, np.conj(product)
    if layout.pairs:
        _check_definite(columns, V, min(layout.pairs.values())[0])
    V[unknown] = np.nan
    return V


def _notes(columns: Columns, layout: _Layout) -> list[Notice]:
    """The notes of the file, and what is not read of it."""
    read = {*layout.numeric, *layout.more.values()}
    if isinstance(columns, RectangularColumns):
        read |= columns.sources(read)
    extra = [bare(name)[0] for i, name in enumerate(columns.header) if name and i not in read]
    notes = list(columns.notes)
    if extra:
        text = f"{columns.source}: not read, because the rig file does not list them: {listed(extra)}"
        notes.append(Notice("columns_not_read", text, tuple(extra)))
    return notes


def _stretches(
    columns: Columns, more: dict[str, int], values: dict[int, Real], lines: int
) -> tuple[Ints, tuple[Stretch, ...]]:
    """Which record or dwell each line belongs to.  Raises DataError where lines of one record disagree about it."""
    if RECORD not in more:
        return np.zeros(lines, dtype=np.int64), (SettledDwell(),)
    numbers = whole_numbers(columns, more[RECORD], values[more[RECORD]])
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
            raise columns.error(
                row, more[RECORD], f"record {number} is described differently at {columns.place(int(rows[0]))}",
                "its duration, samples, loads and columns must be the same in all of its lines",
            )  # fmt: skip
        fundamental, duration, samples, loads, polynomial, ramp = first.tolist()
        stretch[rows] = len(stretches)
        try:
            if np.isfinite(duration) and np.isfinite(samples):
                terms = 3 if np.isnan(polynomial) else int(polynomial)
                stretches.append(WholeRecord(duration, int(samples), loads != 0, terms, ramp == 1))
            else:
                stretches.append(SettledDwell(None if np.isnan(fundamental) else fundamental))
        except DataError as error:
            what = error.problems[0]
            raise columns.error(int(rows[0]), more[RECORD], what.what, what.cure or "") from error
    return stretch, tuple(stretches)


def _check_positive(columns: Columns, column: int, values: Real) -> None:
    wrong = ~(values > 0)
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise columns.error(i, column, f"{values[i]:g}", "it must be positive")


def _check_definite(columns: Columns, V: Complex, column: int) -> None:
    """Raises DataError where variances and covariances do not fit together."""
    size = np.sqrt(np.diagonal(V, axis1=1, axis2=2).real)
    size = np.where(size > 0, size, 1.0)
    wrong = (
        np.linalg.eigvalsh(V / size[:, :, None] / size[:, None, :])[:, 0] < -1e-9 if V.size else np.zeros(0)
    )
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise columns.error(
            i, column, "the covariances are larger than the sd of the channels allow", "correct either"
        )


def _absent(
    columns: Columns,
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
            raise columns.error(
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
            of_record = (value.duration_s, value.samples, int(value.loads), value.polynomial, int(value.ramp))
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
