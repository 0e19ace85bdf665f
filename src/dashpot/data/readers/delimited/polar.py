"""Tables of amplitude and phase, NAME_amplitude and NAME_phase, as tables of real and imaginary part.

X = amplitude · e^{j phase}.  The phase is in the unit in brackets behind its name, in degrees where there is none;
NAME_phase_deg and NAME_phase_rad say it in the name.  Amplitudes in dB, of 20 log10, say so in brackets: NAME_amplitude
[dB].  Responses to inputs are OUT/IN_amplitude, OUT/IN_phase.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot import units
from dashpot.arrays import Real
from dashpot.data.readers.columns import Columns, bare
from dashpot.errors import DashpotError, DataError
from dashpot.io.words import shown
from dashpot.notices import Notice

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
