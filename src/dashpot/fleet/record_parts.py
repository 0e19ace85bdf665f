"""Data of one rig beyond memory: every file identified by itself, long records in pieces, and the estimates merged."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from dashpot.check.diagnosis.diagnose import examined
from dashpot.check.merged_parts import merged_parts
from dashpot.data.conditioning.clock import cut
from dashpot.data.conditioning.transients import continuous
from dashpot.data.readers import Reading, read
from dashpot.data.spectrum import Spectrum
from dashpot.errors import ConvergenceError, DashpotError
from dashpot.estimate.automatic import identify_with_noise
from dashpot.estimate.result import Estimate
from dashpot.fleet.treatment import Treatment
from dashpot.io.words import counted
from dashpot.model.rigfile import Rig
from dashpot.notices import Notice

MOST_LINES = 250_000  # of a part: some 2 kB each are held while it is identified


@dataclass(frozen=True)
class FileTask:
    """A file of data of a rig."""

    rig: Rig
    treatment: Treatment
    path: str


@dataclass(frozen=True)
class FileParts:
    """What the parts of a file give: estimates with the parts' names, why others give none, and what was noticed."""

    path: str
    names: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    failures: tuple[DashpotError, ...]
    notes: tuple[Notice, ...]


def identify_in_parts(
    rig: Rig,
    paths: Sequence[str],
    treatment: Treatment,
    *,
    mapper: Callable[[Callable[[FileTask], FileParts], Iterable[FileTask]], Iterable[FileParts]] = map,
    progress: Callable[[int, int], None] | None = None,
) -> Estimate:
    """Identify every file by itself, by any `mapper`, and merge what they say; parts without an answer are named.

    The result is the same to the bit with any mapper.  Raises what the first file raises where none gives an estimate,
    DataError where the parts cannot be merged.
    """
    results: dict[str, FileParts] = {}
    for done in mapper(identify_file, (FileTask(rig, treatment, path) for path in paths)):
        results[done.path] = done
        if progress is not None:
            progress(len(results), len(paths))
    each = [results[path] for path in paths]
    failures = [failure for parts in each for failure in parts.failures]
    estimates = [estimate for parts in each for estimate in parts.estimates]
    if not estimates:
        raise failures[0]
    estimate = merged_parts(rig.model, [name for parts in each for name in parts.names], estimates)
    notes = [note for parts in each for note in parts.notes]
    if failures:
        text = f"{counted(len(failures), 'part')} left out, the first because {failures[0]}"
        estimate = replace(estimate, warnings=(*estimate.warnings, Notice("parts_left_out", text)))
    return replace(estimate, notes=tuple(dict.fromkeys((*estimate.notes, *notes))))


def identify_file(task: FileTask) -> FileParts:
    """Identify the parts of a file.  A function of the module, so that any process can be sent it."""
    names: list[str] = []
    estimates: list[Estimate] = []
    failures: list[DashpotError] = []
    notes: tuple[Notice, ...] = ()
    try:
        reading = read([task.path], task.rig.channels, frequency_hz=task.treatment.frequency_hz)
        notes = reading.notes
        for name, part in parts_of(task, reading):
            try:
                estimates.append(_identified(task, part, name))
                names.append(name)
            except DashpotError as error:
                failures.append(error)
    except DashpotError as error:
        failures.append(error)
    return FileParts(task.path, tuple(names), tuple(estimates), tuple(failures), notes)


def parts_of(task: FileTask, reading: Reading) -> Iterator[tuple[str, Spectrum]]:
    """The lines of a file with their name; of continuous records that have very many, those of pieces, one at a time.

    How many lines the band has of a long record is asked of a piece of it.  Raises DataError where the samples cannot
    be used.
    """
    samples = sum(len(record.time) for record in reading.records)
    if not reading.continuous or samples <= 2 * MOST_LINES:
        yield task.path, task.treatment.spectrum(task.rig, reading)
        return
    records = continuous(reading.records)
    long = max(records, key=lambda record: len(record.time))
    begin = cut(long, 0.0, min(2 * MOST_LINES / len(long.time), 1.0))
    lines_per_sample = task.treatment.spectrum(task.rig, replace(reading, records=(begin,))).lines / len(
        begin.time
    )
    if lines_per_sample * samples <= MOST_LINES:
        yield task.path, task.treatment.spectrum(task.rig, reading)
        return
    for number, record in enumerate(records):
        name = task.path if len(records) == 1 else f"{task.path}, record {number + 1}"
        count = math.ceil(lines_per_sample * len(record.time) / MOST_LINES)
        for k in range(count):
            piece = replace(reading, records=(cut(record, k / count, (k + 1) / count),))
            yield f"{name} ({k + 1} of {count})", task.treatment.spectrum(task.rig, piece)


def _identified(task: FileTask, spectrum: Spectrum, name: str) -> Estimate:
    """The estimate of a part, examined.  Raises ConvergenceError where the iteration does not come to an end."""
    model, treatment = task.rig.model, task.treatment
    method = treatment.chosen(task.rig, spectrum)
    estimate, spectrum = identify_with_noise(
        model, spectrum, method, chosen=treatment.method is not None, seed=treatment.seed
    )
    if not bool(estimate.converged):
        raise ConvergenceError(
            f"{method.name} did not converge in {int(estimate.iterations)} iterations", name, "leave it out"
        )
    return examined(model, spectrum, estimate, seed=treatment.seed)
