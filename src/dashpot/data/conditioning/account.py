"""What was done to settled dwells, in one line for the whole test."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from dashpot.data.conditioning.harmonic_fit import HarmonicFit
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.notices import Notice

SETTLED = "settled_dwells"
OTHER_MOTION = "other_motion"
COLOURED = 1e-3  # p-value of a white residual
LITTLE = 0.3  # part of a channel's power that the multiples of the drive explain
DRIFTS = {-1: "nothing", 0: "an offset", 1: "offset and slope"}


def account_of_dwells(given: Sequence[Record], lines: Sequence[Spectrum], settings: Conditioning) -> Notice:
    """How many dwells, how much of them, at which frequency and without which drift; `given` as they were recorded.

    lines: those of each dwell, in the same order.
    """
    samples = sum(len(record.time) for record in given)
    used = sum(int(each.samples[0]) for each in lines)
    moved = sum(
        settings.wanted[0] * record.frequency_hz != each.frequency_hz[0]
        for record, each in zip(given, lines, strict=True)
        if record.frequency_hz is not None
    )
    share = "all" if used == samples else f"{100 * used / samples:.3g} % of"
    frequency = "as stated" if not moved else f"refined in {moved}" if moved < len(given) else "refined"
    drift = DRIFTS.get(settings.degree, f"a polynomial of degree {settings.degree}")
    dwells = f"{len(given)} dwell{'' if len(given) == 1 else 's'}"
    text = f"{dwells} as steady sines: {share} {samples} samples used, frequency {frequency}, {drift} removed"
    return Notice(SETTLED, text)


def other_motion(record: Record, fit: HarmonicFit, wanted: Sequence[int]) -> list[Notice]:
    """That most channels of a dwell hardly move with its drive, but otherwise, and not as white noise does.

    wanted: which of the fit's orders are used.  An earthquake given as a dwell does; so does one of hum or drift alone.
    """
    p = fit.whiteness[np.isfinite(fit.whiteness)]
    if fit.noise == "white" and np.min(p, initial=1.0) > COLOURED:
        return []
    power = np.abs(fit.amplitudes) ** 2 / 2
    driven, of_all = np.sum(power[..., wanted, :], axis=-2), np.sum(power, axis=-2)
    rest = np.diagonal(fit.residual_covariance, axis1=-2, axis2=-1).real
    share = np.median(driven / np.maximum(of_all + rest, 1e-300))
    if share > LITTLE:
        return []
    text = (
        f"{record.source}: {100 * share:.2g} % of the motion (power) is at the multiples of {fit.frequency_hz:g} Hz "
        "that are used, and the rest is not white noise: no steady sine; given without a frequency, it is used whole"
    )
    return [Notice(OTHER_MOTION, text, (record.source,))]


def summed_up(notes: Iterable[Notice]) -> list[Notice]:
    """The notes with those on dwells that hardly move with their drive as one."""
    notes = list(notes)
    such = [note for note in notes if note.code == OTHER_MOTION]
    others = [note for note in notes if note.code != OTHER_MOTION]
    if len(such) > 1:
        text = f"{such[0].text}; so {len(such) - 1} dwell{'' if len(such) == 2 else 's'} more"
        such = [Notice(OTHER_MOTION, text, tuple(name for note in such for name in note.of))]
    return [*others, *such]
