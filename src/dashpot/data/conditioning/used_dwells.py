"""Which part of each dwell stands behind its lines, for pictures of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Ints
from dashpot.data.conditioning.clock import with_even_stamps
from dashpot.data.conditioning.lines import driven_parts, long_enough
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum

NEAR = 0.02  # of the drive frequency: how far a line may lie from a multiple of it


@dataclass(frozen=True)
class UsedDwell:
    """A dwell as recorded, the stamps of the first and the last sample that were used, s, and its lines (k,)."""

    record: Record
    begin: float
    end: float
    lines: Ints

    @property
    def discarded(self) -> float:
        """The share of its length that was not used."""
        time = self.record.time
        return 1.0 - (self.end - self.begin) / float(time[-1] - time[0])


def used_dwells(
    records: Sequence[Record], spectrum: Spectrum, settings: Conditioning
) -> tuple[UsedDwell, ...]:
    """Each dwell with its lines in the spectrum that `settings` made of the records.

    Nothing where lines do not stand for one settled dwell each: whole records, averaged periods, tables beside them.
    """
    records, _, _ = long_enough(records, settings)
    # The lines of one dwell after another: of a stretch with a fundamental all, else each line alone
    groups: list[list[int]] = []
    for line, number in enumerate(spectrum.stretch.tolist()):
        alone = getattr(spectrum.stretches[number], "fundamental_hz", None) is None
        if groups and not alone and spectrum.stretch[groups[-1][-1]] == number:
            groups[-1].append(line)
        else:
            groups.append([line])
    lines = [np.array(group, dtype=np.int64) for group in groups]
    if len(lines) != len(records) or not all(
        _fits(record, spectrum, numbers) for record, numbers in zip(records, lines, strict=True)
    ):
        return ()
    if settings.refine != "none":
        records = [with_even_stamps(record)[0] for record in records]
    parts, _, _ = driven_parts(records, settings)
    return tuple(
        UsedDwell(record, float(part.time[0]), float(part.time[-1]), numbers)
        for record, part, numbers in zip(records, parts, lines, strict=True)
    )


def _fits(record: Record, spectrum: Spectrum, lines: Ints) -> bool:
    """Whether the lines are multiples of the record's frequency, of its experiment."""
    if record.frequency_hz is None or record.values.ndim != 2:
        return False
    order = spectrum.frequency_hz[lines] / record.frequency_hz
    near = np.all(np.abs(order - np.rint(order)) <= NEAR * np.maximum(order, 1.0)) and np.all(order > 0.5)
    settled = spectrum.noise[int(lines[0])] in ("white", "blocks")
    return bool(near and settled and np.all(spectrum.experiment[lines] == record.experiment))
