"""A fleet as a document: what is usual of each parameter, which rigs are unlike the others; the unknowns of one over
time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from dashpot.fleet.pooling import Population, Usual
from dashpot.fleet.runner import FleetOutcome
from dashpot.fleet.tracking import Track, TrackedChange
from dashpot.io.words import counted, shown
from dashpot.present.document import Document, Paragraph, TableColumn, columns_of, section
from dashpot.present.words import alike, percent, plain, probability, sentence, short, value_and_sd

PATH = 200  # characters of the name of a data set, which may be a path: its end says which it is
NOTHING = "–"
LEGEND = (
    "Spread: of the rigs themselves (median absolute deviation, noise removed). Noise: rms standard deviation "
    "of the estimates. Drift: change from the first to the last data set, where it is significant."
)
POPULATION_LEGEND = (
    "Population by restricted maximum likelihood, outliers left out: its mean, and the standard deviation of "
    "the rigs around it with its 95 % interval."
)


def fleet_document(outcome: FleetOutcome) -> Document:
    """What is printed: the summary, and what stands out."""
    title = shown(outcome.rig) if outcome.rig else "Fleet"
    answered = outcome.count - len(outcome.failed)
    # Median, spread, noise, drift and the number of outliers of every parameter
    rows = (
        (
            shown(row.name),
            "" if row.unit == "1" else row.unit,
            short(row.median, 4),
            short(row.spread, 2),
            short(row.noise, 2),
            _drift(row),
            str(int(np.sum(row.outlier))) if np.any(row.outlier) else NOTHING,
        )
        for row in outcome.usual
    )
    parts = [
        section(
            "", columns_of(["parameter", "unit", "median>", "spread>", "noise>", "drift>", "outliers>"], rows)
        ),
        section("", Paragraph(LEGEND, "dim")),
    ]
    if outcome.populations:
        parts.append(section("", population_columns(outcome.populations)))
        parts.append(section("", Paragraph(POPULATION_LEGEND, "dim")))
    return Document(
        f"{title}: {counted(outcome.count, 'data set')}, {answered} identified",
        (section(""), *parts, *(section("", line) for line in fleet_remarks(outcome))),
    )


def population_columns(populations: Sequence[Population]) -> list[TableColumn]:
    """Mean and spread of every parameter's population."""
    rows = (
        (
            shown(row.name),
            "" if row.unit == "1" else row.unit,
            short(row.mean, 4),
            short(row.mean_sd, 2),
            short(row.spread, 2),
            " – ".join(short(end, 2) for end in row.spread_interval),
        )
        for row in populations
    )
    return columns_of(["parameter", "unit", "mean>", "±>", "spread>", "95 %>"], rows)


def fleet_remarks(outcome: FleetOutcome) -> list[str]:
    """Outliers with what is unusual of them, failed data sets with their reasons, misfits, drift."""
    columns = outcome.columns
    lines = []
    order = sorted(
        outcome.outliers, key=lambda k: -max(float(np.nan_to_num(abs(u.z[k]))) for u in outcome.usual)
    )
    unlike = []
    for k in order:
        why = ", ".join(f"{shown(row.name)} {row.z[k]:+.1f} sd" for row in outcome.usual if row.outlier[k])
        unlike.append(f"{shown(str(columns['name'][k]))} ({why})")
    if unlike:
        lines.append(f"Outliers: {_first(unlike, ', ')}.")
    drifting = [
        f"{shown(row.name)} by {_drift(row)}{'' if row.unit == '1' else f' {row.unit}'} (p = {row.drift_p:.1g})"
        for row in outcome.usual
        if row.drifts
    ]
    if drifting:
        lines.append(f"Drift over the fleet: {', '.join(drifting)}.")
    misfits = [shown(str(columns["name"][k]), PATH) for k in outcome.misfits]
    if misfits:
        lines.append(f"The model does not fit {counted(len(misfits), 'data set')}: {_first(misfits, ', ')}.")
    if len(outcome.failed):
        by_reason: dict[str, list[str]] = {}
        for k in outcome.failed:
            by_reason.setdefault(str(columns["reason"][k]), []).append(shown(str(columns["name"][k]), PATH))
        failed = [f"{_first(names, ', ')}: {reason}" for reason, names in by_reason.items()]
        lines.append(f"Failed: {counted(len(outcome.failed), 'data set')}. {_first(failed, '; ')}")
    stalled = [shown(str(name), PATH) for name in columns["name"][columns["status"] == "not converged"]]
    if stalled:
        lines.append(f"Not converged: {_first(stalled, ', ')}.")
    return lines


def _first(texts: Sequence[str], between: str) -> str:
    """The first ten, and how many there are more."""
    more = len(texts) - 10
    return between.join(texts[:10]) + (f" and {more} more" if more > 0 else "")


def _drift(one: Usual) -> str:
    return short(one.slope, 2) if one.drifts else NOTHING


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
        if change.kind == "gradual":
            when = "", ""
        else:
            early, late = (plain(time) for time in change.time95_s)
            when = plain(change.time_s), early if early == late else f"{early} … {late}"
        rows.append(
            (
                change.name,
                change.kind,
                *when,
                size,
                spread,
                f"{'−' if change.relative < 0 else '+'}{short(abs(100 * change.relative))}",
                chance,
            )
        )
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
    share = 100 * abs(change.relative)
    size, sd = value_and_sd(share, share * change.sd / abs(change.size))
    if change.kind == "gradual":
        return f"{change.name} {verb} by {size} ± {sd} % gradually (p ≤ {probability(change.p)})"
    early, late = (plain(time) for time in change.time95_s)
    when = f"{early} to {late} s" if early != late else f"{early} s"
    certain = change.odds >= CERTAIN
    odds = "" if certain else f", odds {short(change.odds, 2)}:1 against gradually"
    told = f"{when}; p ≤ {probability(change.p)}{odds}"
    return f"{change.name} {verb} by {size} ± {sd} % at {plain(change.time_s)} s ({told})"
