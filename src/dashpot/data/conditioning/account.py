"""What was done to settled dwells, in one line for the whole test."""

from __future__ import annotations

from collections.abc import Sequence

from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.notices import Notice

SETTLED = "settled_dwells"
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
