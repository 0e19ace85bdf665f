"""A fleet in blocks of data sets: what is there already is kept, the rest computed by any map, then looked at whole.

A block's key says what it follows from: rig, treatment, names and checksums of its data sets, version, machine.  It
names the block's file, so that no block is ever taken for another, and data that have changed are computed again.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Ints, Real
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.fleet.data_sets import BlockPart, Source, Treatment
from dashpot.fleet.pooling import LEVEL, Population, Usual, pooled, survey
from dashpot.fleet.tables import Cut, PartReader, alike_cuts, stacked_cuts
from dashpot.io.atomic import locked, remove_parts
from dashpot.model.observation import calibration_names, observation_model
from dashpot.model.rigfile import Rig
from dashpot.numerics.kernel import description
from dashpot.study.store import (
    METADATA,
    digest_of_columns,
    fields_of,
    fingerprint_of,
    read_table,
    write_table,
)

# What a worker does with a block of data sets: read each, identify those alike as one batch, one row for
# each.


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


FORMAT = 2
# Data sets up to which blocks have that size, which is part of what the last bits depend on.
SIZES = ((20, 1), (500, 10), (50_000, 100))
LARGEST = 1000  # data sets in a block of the largest fleets

Map = Callable[[Callable[[FleetTask], FleetBlock], Iterable[FleetTask]], Iterable[FleetBlock]]


@dataclass(frozen=True)
class FleetOutcome:
    """A finished fleet: a row for each data set, what is usual of each parameter, and the population where asked for.

    columns     as `identification.columns`, in the order of the fleet
    kept        how many data sets were taken from an earlier run
    """

    rig: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: Columns
    usual: tuple[Usual, ...]
    populations: tuple[Population, ...] | None = None
    kept: int = 0

    @property
    def count(self) -> int:
        """Number of data sets."""
        return len(self.columns["name"])

    @property
    def failed(self) -> list[int]:
        """Rows without an estimate."""
        return [int(k) for k in np.flatnonzero(self.columns["status"] == "failed")]

    @property
    def misfits(self) -> list[int]:
        """Rows whose residuals are larger than the noise allows, at LEVEL for the whole fleet (Bonferroni)."""
        return [int(k) for k in np.flatnonzero(self.columns["p"] < LEVEL / self.count)]

    @property
    def outliers(self) -> list[int]:
        """Rows in which some parameter is unlike the rest of the fleet."""
        if not self.usual:
            return []
        return [int(k) for k in np.flatnonzero(np.any([row.outlier for row in self.usual], axis=0))]

    def table(self) -> dict[str, Any]:
        """The columns of the result file: rows as they are, z and outliers, pooled values where there are any."""
        table: dict[str, Any] = {}
        for name, values in self.columns.items():
            parameter, _, kind = name.rpartition(":")
            table[name if not parameter else parameter if kind == "value" else f"{parameter}_{kind}"] = values
        for row in self.usual:
            table[f"{row.name}_z"] = row.z
        marked = np.zeros(self.count, dtype=bool)
        marked[self.outliers] = True
        table["outlier"] = marked
        for population in self.populations or ():
            for key in ("values", "sd", "lower", "upper"):
                ending = "" if key == "values" else f"_{key}"
                table[f"{population.name}_pooled{ending}"] = getattr(population, key)
        return table

    def summary(self) -> dict[str, Any]:
        """What is said of the fleet as a whole, for other programs."""
        populations = {row.name: row for row in self.populations or ()}
        parameters: dict[str, Any] = {}
        for row in self.usual:
            parameters[row.name] = {
                "unit": row.unit, "count": row.count, "median": row.median, "spread": row.spread, "noise": row.noise,
                "drift": row.slope, "drift_sd": row.slope_sd, "drift_p": row.drift_p,
                "outliers": [str(self.columns["name"][k]) for k in np.flatnonzero(row.outlier)],
            }  # fmt: skip
            if (of := populations.get(row.name)) is not None:
                parameters[row.name]["population"] = {
                    "mean": of.mean,
                    "mean_sd": of.mean_sd,
                    "spread": of.spread,
                    "spread_interval95": list(of.spread_interval),
                }
        return {
            "dashpot": version("dashpot"), "rig": self.rig, "data_sets": self.count, "failed": len(self.failed),
            "misfits": len(self.misfits), "parameters": parameters,
        }  # fmt: skip


def run_fleet(
    rig: Rig,
    source: Source,
    folder: Path | None = None,
    treatment: Treatment | None = None,
    *,
    pool: bool = False,
    mapper: Map = map,
    progress: Callable[[int, int], None] | None = None,
) -> FleetOutcome:
    """Identify every data set, by any `mapper`, keeping finished blocks in `folder`; what is there is not computed.

    The result depends on rig, data and treatment alone.  `progress(done, all)` counts data sets.  Raises UsageError
    where the folder cannot be used or holds something else, DataError where a table of data sets is damaged.
    """
    rig.model.require_unknowns()
    settings = Treatment() if treatment is None else treatment
    if folder is None:
        blocks, kept = _run(rig, source, settings, None, mapper, progress)
    else:
        _make(folder)
        with locked(folder):
            remove_parts(folder)
            blocks, kept = _run(rig, source, settings, folder, mapper, progress)
    return outcome_of(rig, blocks, pool, kept)


def outcome_of(rig: Rig, blocks: Sequence[Columns], pool: bool, kept: int = 0) -> FleetOutcome:
    """The blocks put together, with what stands out and, where asked for, the populations.

    Raises UsageError where there are no data sets.
    """
    if not blocks:
        raise UsageError("there are no data sets", cure="name at least one file")
    columns = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    view = observation_model(rig.model, rig.channels, np.ones(1))
    names = estimated_names(rig)
    values = {name: _of_answers(columns, f"{name}:value") for name in names}
    sds = {name: _of_answers(columns, f"{name}:sd") for name in names}
    usual = survey(names, view.units, values, sds)
    populations = None
    if pool:
        pools = (pooled(row.name, row.unit, values[row.name], sds[row.name], ~row.outlier) for row in usual)
        populations = tuple(population for population in pools if population is not None)
    return FleetOutcome(rig.model.name, names, view.units, columns, usual, populations, kept)


def _of_answers(columns: Columns, name: str) -> Real:
    """A column with NaN where the iteration has not converged."""
    return np.where(columns["status"] == "converged", columns[name], np.nan)


def machine() -> str:
    """What the last bits of results depend on beside the data: version, libraries, instruction set."""
    import scipy

    core = getattr(np, "_core", None)
    features = getattr(getattr(core, "_multiarray_umath", None), "__cpu_features__", {})
    chosen = ",".join(sorted(name for name, there in features.items() if there))
    parts = (version("dashpot"), description(), np.__version__, scipy.__version__, platform.machine(), chosen)
    return " ".join(parts)


# Blocks


def block_size(count: int) -> int:
    """Data sets in a block: few in small fleets, so that there is work for several processes."""
    return next((size for most, size in SIZES if count <= most), LARGEST)


def _run(
    rig: Rig, source: Source, treatment: Treatment, folder: Path | None, mapper: Map,
    progress: Callable[[int, int], None] | None,
) -> tuple[list[Columns], int]:  # fmt: skip
    """All blocks in order, and how many data sets were there already."""
    order: list[str] = []
    finished: dict[str, Columns] = {}
    kept = 0
    model = {name: value for name, value in fields_of(rig.model) if name != "name"}
    basis = fingerprint_of(((model, rig.channels), treatment, estimated_names(rig), machine(), FORMAT))

    def work() -> Iterator[FleetTask]:
        nonlocal kept
        for parts in source.blocks(block_size(source.count)):
            key = fingerprint_of((basis, [part.checksum() for part in parts]))[:32]
            order.append(key)
            whole = None if folder is None else _read(folder, key, estimated_names(rig))
            if whole is None:
                yield FleetTask(key, rig, treatment, parts)
                continue
            finished[key] = whole
            kept += len(whole["name"])

    def tell() -> None:
        if progress is not None:
            progress(sum(len(block["name"]) for block in finished.values()), source.count)

    tell()
    for block in mapper(identify_block, work()):
        if folder is not None:
            label = {"key": block.key, "sha256": digest_of_columns(block.columns)}
            write_table(folder / f"{block.key}.parquet", block.columns, json.dumps(label).encode())
        finished[block.key] = block.columns
        tell()
    return [finished[key] for key in order], kept


def _read(folder: Path, key: str, names: Sequence[str]) -> Columns | None:
    """The columns of a block; None where it is absent, damaged or another's."""
    try:
        columns, metadata = read_table(folder / f"{key}.parquet")
        label: Mapping[str, Any] = json.loads(metadata[METADATA])
        if label["key"] != key or label["sha256"] != digest_of_columns(columns):
            return None
        if any(f"{name}:{kind}" not in columns for name in names for kind in WIDE):
            return None
    except Exception:  # damage may show anywhere between the file's first byte and the last key
        return None
    return columns


def _make(folder: Path) -> None:
    """Make the folder, or see that nothing else lies in it.  Raises UsageError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        foreign = [
            path for path in folder.iterdir() if path.suffix != ".parquet" and not path.name.startswith(".")
        ]
    except OSError as error:
        raise UsageError(
            f"the folder cannot be used ({error.strerror or error})",
            str(folder),
            "name another file for the result",
        ) from None
    if foreign:
        raise UsageError(
            f"the folder for finished blocks holds {foreign[0].name}",
            str(folder),
            "name another file for the result",
        )
