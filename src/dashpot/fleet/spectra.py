"""The amplitudes of a block's data sets: tables of many rigs read at once, and those measured alike as one batch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.data.readers import Reading, read
from dashpot.data.readers.array_columns import array_columns
from dashpot.data.readers.delimited.polar import with_real_and_imaginary
from dashpot.data.readers.delimited.stepped_sine import Circumstances
from dashpot.data.readers.interpretation import interpret
from dashpot.data.spectrum import Moments, Spectrum, concatenate
from dashpot.fleet.data_sets import BlockPart, DataSet
from dashpot.fleet.tables import HeldRows
from dashpot.fleet.treatment import Treatment
from dashpot.model.rigfile import Rig

AT_ONCE = 100  # rigs of a table, whose numbers stay in the cache


@dataclass(frozen=True)
class Cut:
    """The lines of one data set: some of the `whole` that was read, which `signature` describes."""

    whole: Spectrum
    first: int
    end: int
    signature: tuple[object, ...]

    def spectrum(self) -> Spectrum:
        """By itself."""
        if self.end - self.first == self.whole.lines:
            return self.whole
        return self.whole.select(np.arange(self.first, self.end))


@dataclass(frozen=True)
class PartReader:
    """Reads the data sets of a rig; `failed` is told of those that cannot be used, by their place in the part."""

    rig: Rig
    treatment: Treatment
    failed: Callable[[int, Exception], None]

    def cuts(self, part: BlockPart) -> dict[int, Cut]:
        """The lines of each data set by its place; rows of tables are read many at once."""
        if not isinstance(part, HeldRows):
            return self._one_by_one(part, 0)
        cuts: dict[int, Cut] = {}
        for first in range(0, len(part.names), AT_ONCE):
            cuts |= self._at_once(part, first, min(first + AT_ONCE, len(part.names)))
        return cuts

    def _at_once(self, rows: HeldRows, first: int, end: int) -> dict[int, Cut]:
        """Of some rigs of a table; where they cannot be read together, of each half of them."""
        some = rows.some(first, end)
        if end - first > 1:
            try:
                whole = self._lines_of_all(some)
            except Exception:  # of one of them, which is found and says so itself
                middle = (first + end) // 2
                return self._at_once(rows, first, middle) | self._at_once(rows, middle, end)
            if whole is not None:
                return dict(
                    zip(range(first, end), _cuts(whole, (0, *some.ends[:-1]), some.ends), strict=True)
                )
        return self._one_by_one(some, first)

    def _lines_of_all(self, rows: HeldRows) -> Spectrum | None:
        """The lines of all rigs one after the other; None where a rig's lines are not what each of them is alone."""
        columns = array_columns(rows.source, dict(rows.columns), dict(rows.units))
        if with_real_and_imaginary(columns) is not columns:  # phases are looked at from line to line
            return None
        content = interpret(columns, self.rig.channels, self._circumstances)
        if content.records or len(content.spectra) != 1:
            return None
        lines = content.spectra[0]
        if lines.lines != rows.ends[-1] or len(lines.stretches) > 1 or lines.records or not lines.complete:
            return None
        if "unknown" in lines.noise:  # it is sought in neighbouring lines
            return None
        return (
            lines if self.treatment.spectrum(self.rig, Reading((), lines, content.notes)) is lines else None
        )

    def _one_by_one(self, part: BlockPart, first: int) -> dict[int, Cut]:
        """Of data sets each read by itself, counted from `first`."""
        cuts: dict[int, Cut] = {}
        for k, data_set in enumerate(part.data_sets(), first):
            try:
                spectrum = self.treatment.spectrum(self.rig, self._reading(data_set))
            except Exception as error:  # a reader that fails on one file of a million must not stop the rest
                self.failed(k, error)
            else:
                cuts[k] = _cuts(spectrum, (0,), (spectrum.lines,))[0]
        return cuts

    def _reading(self, data_set: DataSet) -> Reading:
        """What one data set holds.  Raises DataError."""
        if not data_set.columns:
            return read(data_set.source, self.rig.channels, frequency_hz=self.treatment.frequency_hz)
        columns = array_columns(data_set.source, dict(data_set.columns), dict(data_set.units))
        content = interpret(columns, self.rig.channels, self._circumstances)
        lines = concatenate(content.spectra) if content.spectra else None
        return Reading(content.records, lines, content.notes, content.joint)

    @property
    def _circumstances(self) -> Circumstances:
        return Circumstances(self.treatment.frequency_hz, 0)


# Repeats of one test


def _cuts(whole: Spectrum, starts: Sequence[int], ends: Sequence[int]) -> list[Cut]:
    """The lines between these places, with all that those of a batch have in common, bit by bit."""
    silent = np.diagonal(whole.covariance, axis1=-2, axis2=-1) == 0
    arrays = (
        whole.frequency_hz, whole.samples, whole.dof, whole.experiment, whole.stretch,
        np.isfinite(whole.amplitudes), np.isnan(whole.covariance), silent,
    )  # fmt: skip
    shared = repr((whole.channels, whole.stretches, whole.moments is None))
    return [
        Cut(
            whole,
            start,
            end,
            (shared, whole.noise[start:end], *(array[start:end].tobytes() for array in arrays)),
        )
        for start, end in zip(starts, ends, strict=True)
    ]


def alike_cuts(cuts: Mapping[int, Cut]) -> list[list[int]]:
    """Which data sets can be repeats of one test: the same lines, measured alike.  Whole records never are."""
    groups: dict[object, list[int]] = {}
    for k, cut in cuts.items():
        groups.setdefault(k if cut.whole.records else cut.signature, []).append(k)
    return list(groups.values())


def stacked_cuts(cuts: Sequence[Cut]) -> Spectrum:
    """Cuts of one signature as one spectrum with a leading axis."""
    first = cuts[0].spectrum()
    moments = None
    if first.moments is not None:
        products = [(cut, cut.whole.moments.products) for cut in cuts if cut.whole.moments is not None]
        moments = Moments(np.stack([product[cut.first : cut.end] for cut, product in products]))
    amplitudes = np.stack([cut.whole.amplitudes[cut.first : cut.end] for cut in cuts])
    covariance = np.stack([cut.whole.covariance[cut.first : cut.end] for cut in cuts])
    amplitudes.setflags(write=False)
    covariance.setflags(write=False)
    return first.derived(amplitudes=amplitudes, covariance=covariance, moments=moments)
