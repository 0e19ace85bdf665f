"""What a worker does with a block of data sets: read each, identify those alike as one batch, one row for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Ints
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.fleet.data_sets import BlockPart
from dashpot.fleet.spectra import Cut, PartReader, alike_cuts, stacked_cuts
from dashpot.fleet.treatment import Treatment
from dashpot.model.observation import calibration_names
from dashpot.model.rigfile import Rig

Columns = dict[str, np.ndarray]
WIDE = ("value", "sd", "lower", "upper")  # one column each for every unknown
PLAIN = ("name", "source", "status", "reason", "lines", "iterations", "chi2", "dof", "p")


@dataclass(frozen=True)
class FleetTask:
    """Some data sets of one rig; `key` names the block."""

    key: str
    rig: Rig
    treatment: Treatment
    parts: tuple[BlockPart, ...]


@dataclass(frozen=True)
class FleetBlock:
    """The rows of a block, by column."""

    key: str
    columns: Columns


def identify_block(task: FleetTask) -> FleetBlock:
    """Identify a block.  A function of the module, so that any process can be sent it.

    What is wrong with a data set stands in its row.  Raises DataError where a table cannot be read, or has changed.
    """
    columns = _empty(estimated_names(task.rig), task.parts)
    cuts: dict[int, Cut] = {}
    first = 0
    for part in task.parts:

        def failed(k: int, error: Exception, first: int = first) -> None:
            columns["reason"][first + k] = reason_of(error, columns["source"][first + k])

        read = PartReader(task.rig, task.treatment, failed).cuts(part.loaded())
        cuts |= {first + k: cut for k, cut in read.items()}
        first += len(part.names)
    for k, cut in cuts.items():
        columns["lines"][k] = cut.end - cut.first
    for places in alike_cuts(cuts):
        for k in _together(task, places, [cuts[k] for k in places], columns):
            _alone(task, k, cuts[k].spectrum(), columns)
    return FleetBlock(task.key, columns)


def reason_of(error: Exception, source: str) -> str:
    """Why a data set failed, in one line; the name of its file stands beside it anyway."""
    if not isinstance(error, DashpotError):
        return f"internal error ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
    first = error.problems[0]
    place = first.where.removeprefix(source).lstrip(": ") if first.where else None
    return str(replace(first, where=place or None))


def estimated_names(rig: Rig) -> tuple[str, ...]:
    """Names of all that may be estimated: the unknowns of the rig, gains and delays."""
    return (*rig.model.unknown_names, *calibration_names(rig.channels))


# Batches


def _together(task: FleetTask, places: Sequence[int], cuts: Sequence[Cut], columns: Columns) -> list[int]:
    """Enter the estimates of data sets that are alike; the places of those that need a look at them alone."""
    if len(cuts) == 1:
        return list(places)
    try:
        method = task.treatment.chosen(task.rig, cuts[0].spectrum())
        batch = identify(task.rig.model, stacked_cuts(cuts), method)
    except Exception:  # each is tried alone, and says itself what is wrong with it
        return list(places)
    usable = batch.converged & np.all(np.isfinite(batch.sd), axis=-1)
    _enter(columns, np.asarray(places), batch, usable)
    return [k for k, good in zip(places, usable, strict=True) if not good]


def _alone(task: FleetTask, k: int, spectrum: Spectrum, columns: Columns) -> None:
    try:
        estimate = identify(task.rig.model, spectrum, task.treatment.chosen(task.rig, spectrum))
    except Exception as error:
        columns["reason"][k] = reason_of(error, columns["source"][k])
    else:
        _enter(columns, np.array([k]), estimate, np.array([True]))


# Rows as columns


def _empty(names: Sequence[str], parts: Sequence[BlockPart]) -> Columns:
    """A row for each data set, failed so far: what PLAIN names, then NAME:value, NAME:sd … of every unknown."""
    count = sum(len(part.names) for part in parts)
    columns: Columns = {
        "name": np.array([name for part in parts for name in part.names], dtype=object),
        "source": np.array([source for part in parts for source in part.sources], dtype=object),
        "status": np.array(["failed"] * count, dtype=object),
        "reason": np.array([""] * count, dtype=object),
        "lines": np.zeros(count, dtype=np.int64),
        "iterations": np.zeros(count, dtype=np.int64),
    }
    columns |= {name: np.full(count, np.nan) for name in ("chi2", "dof", "p")}
    return columns | {f"{name}:{key}": np.full(count, np.nan) for name in names for key in WIDE}


def _enter(columns: Columns, places: Ints, estimate: Estimate, usable: Bools) -> None:
    """Write the usable estimates of a batch (or a single one) into their rows."""
    rows = places[usable]
    converged = np.atleast_1d(estimate.converged)[usable]
    columns["status"][rows] = np.where(converged, "converged", "not converged")
    columns["iterations"][rows] = np.atleast_1d(estimate.iterations)[usable]
    columns["chi2"][rows] = np.atleast_1d(estimate.fit.chi2)[usable]
    columns["p"][rows] = np.atleast_1d(estimate.fit.p)[usable]
    columns["dof"][rows] = estimate.fit.dof
    wide = (estimate.values, estimate.sd, *estimate.interval())
    for key, numbers in zip(WIDE, wide, strict=True):
        of_rows = np.atleast_2d(numbers)[usable]
        for j, name in enumerate(estimate.names):
            columns[f"{name}:{key}"][rows] = of_rows[:, j]
