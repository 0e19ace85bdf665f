"""A test that is still running: a file that grows, or a folder that fills, identified whenever there is more."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dashpot.errors import DashpotError, DataError
from dashpot.io.words import counted

if TYPE_CHECKING:
    from dashpot.app.data_files import RecordOptions
    from dashpot.data.record import Record
    from dashpot.estimate.result import Estimate
    from dashpot.model.rigfile import Rig

STILL = 1.5  # s without a change, after which a file counts as written to its end: recorders write in bursts
TEXTS = (".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm")  # whose beginning can be read while they grow
# Notes and warnings of samples that are missing or wrong, which a test that is still mounted can record again.
LOST = (
    "gaps",
    "held_samples",
    "dropouts",
    "packets_lost",
    "clipped",
    "residual_jump",
    "spikes",
    "clock_step",
)


def lost_samples(records: Sequence[Record]) -> list[str]:
    """What dwells lack: rows that are missing between others, and a channel that holds one value too long.

    A regression takes such dwells as they are, and only while the rig is mounted can they be recorded again.  A channel
    that moves at the drive frequency holds no value for half a period.  Of continuous records conditioning says it,
    and of dwells where it marks those samples as missing; each channel is named once.
    """
    from dashpot.data.conditioning.clock import GAP
    from dashpot.data.conditioning.unmeasured import marked
    from dashpot.data.record import runs_of_one_value

    said: list[str] = []
    held: dict[str, list[str]] = {}
    for record in records:
        if record.frequency_hz is None or record.values.ndim != 2 or len(record.time) < 3:
            continue
        where = f"in the dwell at {record.frequency_hz:.4g} Hz"
        steps = np.diff(record.time) / np.median(np.diff(record.time))
        gaps = np.flatnonzero(steps > GAP)
        if len(gaps):
            missing = int(np.sum(np.rint(steps[gaps]) - 1))
            at = f"first after {record.time[gaps[0]]:.6g} s"
            said.append(f"{counted(max(missing, 1), 'sample')} missing {where}, {at}")
        half = len(record.time) / max(record.periods, 1e-9) / 2
        for c, channel in enumerate(record.channels):
            runs = [run for run in runs_of_one_value(record.values[:, c], 3) if run[1] - run[0] > half]
            if runs:
                missing = marked([record])[0][0].marks()[:, c] != 0
                lengths = [end - begin for begin, end in runs if not np.all(missing[begin:end])]
                if lengths:
                    held.setdefault(channel.name, []).append(f"for {max(lengths)} samples {where}")
    for name, places in held.items():
        more = f" and in {counted(len(places) - 1, 'other dwell')}" if len(places) > 1 else ""
        said.append(f"{name} holds one value {places[0]}{more}")
    return said


def watch(
    rig: Rig,
    source: Path,
    into: Path,
    records: RecordOptions,
    target: float,
    plan: Callable[[Sequence[str]], Mapping[str, Any]],
    tell: Callable[[dict[str, Any]], None],
) -> None:
    """Identify what is there, and again whenever there is more, until the process is ended.

    source  a file, or a folder whose files are data
    into    a folder for copies of what is still being written
    records how records are read: band, records at rest
    target  the relative standard deviation that is enough
    plan    the next test after data files, as `dashpot design --json` has it

    `tell` is called with all that is known at every step: `history` (samples, and the interval of each unknown),
    `rows`, `verdict`, `enough`, `next` (dwells), `bad` and `lost` (texts), `waiting` where nothing can be said yet, and
    `damaged` where a file holds what cannot be read.
    """
    from dashpot.api import read
    from dashpot.app.commands.identify import identified
    from dashpot.data.inspection import inspect_file

    history: list[dict[str, Any]] = []
    told: dict[str, Any] = {"history": history, "waiting": "Waiting for the first samples", "target": target}
    tell(told)
    before: object = None
    while True:
        time.sleep(0.4)  # s between two looks at the files
        paths = (
            sorted(path for path in source.iterdir() if not path.name.startswith("."))
            if source.is_dir()
            else [source]
        )
        now = [(str(path), path.stat().st_size) for path in paths if path.is_file() and path.stat().st_size]
        complete = all(time.time() - os.stat(path).st_mtime > STILL for path, _ in now)
        if not now or (now, complete) == before:
            continue
        before = (now, complete)  # looked at once more when all has come to rest
        files = [path for name, _ in now if (path := _readable(Path(name), into)) is not None]
        if not files:
            continue
        try:
            found = identified(rig, files, records, "auto", False, 0, 0.0, False, False)
            told = {"history": history, "target": target, **_words(found.estimate, target)}
            told["lost"] = list(dict.fromkeys([*told["lost"], *lost_samples(read([*files], rig).records)]))
            samples = sum(part.samples for name in files for part in inspect_file(name).parts)
            history[:] = [
                *(each for each in history if each["samples"] < samples),
                {"samples": samples, "rows": told["rows"]},
            ]
            from dashpot.present.figures.traces import bars_svg

            drawn = []  # the interval of an unknown against samples
            for i in range(min(len(told["rows"]), 12)):  # unknowns whose intervals are drawn against samples
                steps = [(step["samples"], step["rows"][i]) for step in history if len(step["rows"]) > i]
                drawn.append(
                    bars_svg(
                        steps[-1][1]["name"],
                        [samples for samples, _ in steps],
                        [row["low"] for _, row in steps],
                        [row["high"] for _, row in steps],
                    )
                )
            told["pictures"] = drawn
            tell(told)
        except DashpotError as error:
            first = error.problems[0]
            damaged = re.search(r":\d+$", first.where or "") is not None  # a line of a file cannot be read
            text = str(first).replace(f"{source.parent}{os.sep}", "")
            tell({**told, "damaged" if damaged else "waiting": text})
            continue
        try:
            told |= {"next": plan(files)["dwells"]}
        except DashpotError as error:
            told |= {"unplanned": str(error.problems[0])}
        tell(told)


def _readable(path: Path, into: Path) -> str | None:
    """The file where it has come to rest, else what a copy holds of whole rows and dwells; None: nothing yet."""
    from dashpot.io.atomic import write_bytes
    from dashpot.io.ledger import noted, opened

    if time.time() - path.stat().st_mtime > STILL and _ends_whole(path):
        return str(path)
    if path.suffix.lower() not in TEXTS:
        return None
    text = Path(noted(path)).read_bytes()
    text = text[: text.rfind(b"\n") + 1]
    head, _, rows = text.partition(b"\n")
    separator = next((mark for mark in (b",", b";", b"\t") if mark in head), b",")
    names = [name.strip(b' "').lower() for name in head.split(separator)]
    at = next((i for i, name in enumerate(names) if re.match(rb"frequency(_hz)?\b", name)), None)
    if at is not None:  # the last drive frequency, whose dwell may still go on, is left out
        lines = rows.splitlines(keepends=True)
        fields = [line.split(separator) for line in lines]
        last = fields[-1][at] if fields and len(fields[-1]) > at else b""
        kept = len(lines)
        while kept and len(fields[kept - 1]) > at and fields[kept - 1][at] == last:
            kept -= 1
        text = head + b"\n" + b"".join(lines[:kept])
    if text.count(b"\n") < 3:
        return None
    into.mkdir(exist_ok=True)
    with opened():  # written anew at every look
        write_bytes(into / path.name, text)
    return str(into / path.name)


def _ends_whole(path: Path) -> bool:
    """Whether the last row of a text has as many cells as the first: else its recorder is in the middle of one."""
    from dashpot.io.ledger import noted

    if path.suffix.lower() not in TEXTS:
        return True
    with open(noted(path), "rb") as file:
        head = file.readline()
        file.seek(max(len(head), file.seek(0, os.SEEK_END) - max(4 * len(head), 1 << 16)))
        last = file.read().rpartition(b"\n")[2]
    return not last or all(last.count(mark) >= head.count(mark) for mark in (b",", b";", b"\t"))


def _words(estimate: Estimate, target: float) -> dict[str, Any]:
    """What is known now, whether it is enough, and which dwells or samples are to be recorded again."""
    from dashpot.present.estimate import headline
    from dashpot.present.words import sentence, value_and_sd

    if estimate.assessment is None:
        raise DataError("the fit was not judged")
    rows: list[dict[str, Any]] = []
    for one in estimate:
        value, sd = value_and_sd(one.value, one.sd)
        share = abs(one.sd / one.value) if one.value else float("inf")
        low, high = one.interval95
        rows.append(
            {
                "name": one.name,
                "value": value,
                "sd": sd,
                "unit": one.unit,
                "share": share,
                "low": low,
                "high": high,
            }
        )
    findings = estimate.assessment.findings
    said = [*estimate.notes, *estimate.warnings]
    return {
        "rows": rows,
        "verdict": estimate.assessment.verdict,
        "headline": headline(estimate, ()),
        "enough": estimate.assessment.verdict != "does not fit"
        and all(row["share"] <= target for row in rows),
        "bad": [sentence(each.text) for each in findings if each.kind == "dwell"],
        "lost": [sentence(each.text) for each in said if each.code in LOST],
        "waiting": None,
        "next": None,
    }
