"""Dwells too brief to hold an amplitude: left out where most dwells are longer."""

from __future__ import annotations

from collections.abc import Sequence

from dashpot.data.conditioning.regression import duration, holds_a_period
from dashpot.data.record import Record
from dashpot.io.words import counted
from dashpot.notices import Notice

FEWEST_SAMPLES = 5  # of a dwell: more than its offset, slope and fundamental have terms


def long_enough(dwells: Sequence[Record]) -> tuple[Sequence[Record], list[Notice]]:
    """The dwells without those that end before their first period, where most are longer, and what was left out.

    A recording that was stopped within a dwell, or one dwell that failed, is no reason to refuse the others.
    """
    brief = {k: text for k, record in enumerate(dwells) if (text := _too_brief(record))}
    if not brief or 2 * len(brief) >= len(dwells):
        return dwells, []
    kept = [record for k, record in enumerate(dwells) if k not in brief]
    notes = [
        Notice("dwell_left_out", f"{dwells[k].source}: left out: {text}", (dwells[k].source,))
        for k, text in brief.items()
    ]
    return kept, notes


def _too_brief(record: Record) -> str:
    """Why a dwell holds no amplitude at its frequency, if it holds none."""
    f, time = record.frequency_hz, record.time
    if f is None:
        return ""
    if len(time) < FEWEST_SAMPLES:
        return f"{counted(len(time), 'sample')} at {f:g} Hz"
    return "" if holds_a_period(time, f) else f"{f * duration(time):.2g} of a period at {f:g} Hz"
