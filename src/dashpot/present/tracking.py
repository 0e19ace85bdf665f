"""The unknowns of a rig over time, as a document."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from dashpot.fleet.tracking import Track, TrackedChange
from dashpot.io.words import counted
from dashpot.present.document import Document, columns_of, section
from dashpot.present.words import alike, percent, plain, probability, sentence, short, value_and_sd

CERTAIN = 1000.0  # odds from which on their size says no more


def track_document(track: Track, level: float = 0.95) -> Document:
    """Changes first, then each unknown in the first and the last window, with how fast it moves."""
    changed = [change_line(change) for change in track.changes]
    title = (
        changed[0] if len(changed) == 1 else f"{counted(len(changed), 'change')}" if changed else "No change"
    )
    rows = []
    for change in track.changes:
        size, spread = value_and_sd(change.size, change.sd)
        chance = f"≤ {probability(change.p)}"
        rows.append((change.name, change.kind, *_when(change), size, spread, _relative(change), chance))
    heads = ["parameter", "kind", "at s>", "95 % interval", "change>", "±>", "change, %>", "p>"]
    reach = float(ndtri((1 + level) / 2))
    values = []
    for j, name in enumerate(track.names):
        sd = max(float(track.sd[0, j]), float(track.sd[-1, j]))
        first, last, deviation = alike(
            [float(track.values[0, j]), float(track.values[-1, j]), reach * sd], sd
        )
        typical = float(np.median(track.values[:, j]))
        speed = percent(float(track.speed[j]), typical) if track.speed[j] else "0"
        most = percent(float(track.speed95[j, 1]), typical) if track.speed95[j, 1] else "0"
        values.append((name, first, last, deviation, track.units[j], speed, "" if track.given else most))
    how = "given" if track.given else "at most>"
    named = ["parameter", "first>", "last>", f"± ({100 * level:g} %)>", "unit", "speed, %/√h>", how]
    windows = f"{counted(len(track.start_s), 'window')} from {plain(float(track.start_s[0]))} to "
    said = f"{windows}{plain(float(track.end_s[-1]))} s."
    if len(track.start_s) < 3:
        said += " Fewer than 3 windows show no change: use shorter windows, or a longer record."
    else:
        share = 100 * track.false_alarms
        said += f" False alarms: at most {short(share)} % of records without a change."
    said += " ".join(["", *(sentence(note.text[:1].upper() + note.text[1:]) for note in track.notes)])
    return Document(
        title,
        (
            *([section("", columns_of(heads, rows))] if rows else []),
            section("First and last window:", columns_of(named, values)),
            section("", said.strip()),
        ),
    )


def change_line(change: TrackedChange) -> str:
    """One sentence without its full stop."""
    verb = "fell" if change.size < 0 else "rose"
    size, sd = (
        short(abs(100 * part), 3) for part in (change.relative, change.sd * change.relative / change.size)
    )
    if change.kind == "gradual":
        return f"{change.name} {verb} by {size} ± {sd} % gradually (p ≤ {probability(change.p)})"
    early, late = (plain(time) for time in change.time95_s)
    when = f"{early} to {late} s" if early != late else f"{early} s"
    certain = change.odds >= CERTAIN
    odds = "" if certain else f", odds {short(change.odds, 2)}:1 against gradually"
    told = f"{when}; p ≤ {probability(change.p)}{odds}"
    return f"{change.name} {verb} by {size} ± {sd} % at {plain(change.time_s)} s ({told})"


def _when(change: TrackedChange) -> tuple[str, str]:
    if change.kind == "gradual":
        return "", ""
    early, late = (plain(time) for time in change.time95_s)
    return plain(change.time_s), f"{early} … {late}"


def _relative(change: TrackedChange) -> str:
    return f"{'−' if change.relative < 0 else '+'}{short(abs(100 * change.relative))}"
