"""A fleet in blocks of data sets: what is there already is kept, the rest computed by any map, then looked at whole.

A block's key says what it follows from: rig, treatment, names and checksums of its data sets, version, machine.  It
names the block's file, so that no block is ever taken for another, and data that have changed are computed again.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from dashpot.arrays import Real
from dashpot.data.readers import Reading, read
from dashpot.data.readers.amplitudes import amplitude_columns
from dashpot.data.readers.arrays import array_columns
from dashpot.data.readers.interpretation import interpret
from dashpot.data.readers.records import Circumstances
from dashpot.data.spectrum import Moments, Spectrum, concatenate
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.automatic import identify_each
from dashpot.estimate.result import Estimate
from dashpot.fleet.data_sets import BlockPart, DataSet, Files, HeldRows, ParquetRows, Source, Treatment
from dashpot.fleet.pooling import LEVEL, Population, Usual, pooled, survey
from dashpot.model.observation import calibration_names, observation_model
from dashpot.model.rigfile import Rig
from dashpot.numerics.kernel import description
from dashpot.study.blocks import BlockStore, Columns, Key, Map, fields_of, fingerprint_of, opened_store

# What a worker does with a block of data sets: read each, identify those alike as one batch, one row for each.


WIDE = ("value", "sd", "lower", "upper")  # one column each for every unknown


@dataclass(frozen=True)
class FleetTask:
    """Some data sets of one rig; `number` is the block's in the fleet."""

    number: int
    rig: Rig
    treatment: Treatment
    parts: tuple[BlockPart, ...]


def identify_block(task: FleetTask) -> Columns:
    """A row for each data set: name, source, status …, and NAME:value, NAME:sd … of every unknown.

    A function of the module, so that any process can be sent it.  What is wrong with a data set stands in its row.
    Raises DataError if a table cannot be read, or has changed.
    """
    names = [name for part in task.parts for name in part.names]
    sources = [name if isinstance(of, Files) else of.source for of in task.parts for name in of.names]
    columns: Columns = {"name": np.array(names, dtype=object), "source": np.array(sources, dtype=object)}
    columns |= {
        name: np.full(len(names), text, object) for name, text in (("status", "failed"), ("reason", ""))
    }
    columns |= {name: np.zeros(len(names), dtype=np.int64) for name in ("lines", "iterations")}
    unknowns = [f"{name}:{kind}" for name in estimated_names(task.rig) for kind in WIDE]
    columns |= {name: np.full(len(names), np.nan) for name in ("chi2", "dof", "p", *unknowns)}

    def failed(first: int, k: int, error: Exception) -> None:
        columns["reason"][first + k] = reason_of(error, sources[first + k])

    cuts: dict[int, Cut] = {}
    first = 0
    for part in task.parts:
        reader = PartReader(task.rig, task.treatment, partial(failed, first))
        held = part.loaded() if isinstance(part, ParquetRows) else part
        cuts |= {first + k: cut for k, cut in reader.cuts(held).items()}
        first += len(part.names)
    how: Any = {"seed": task.treatment.seed, "positive": task.treatment.positive}
    for alike in alike_cuts(cuts):
        places = np.array(alike)
        columns["lines"][places] = cuts[alike[0]].end - cuts[alike[0]].first
        spectrum = stacked_cuts([cuts[k] for k in alike])
        for some, estimate in identify_each(task.rig.model, spectrum, task.treatment.method, **how):
            if isinstance(estimate, Estimate):
                rows = places[some]
                if estimate.values.ndim == 1:
                    some = np.zeros(1, dtype=np.int64)
                converged, iterations, chi2, p = (
                    np.atleast_1d(each)[some]
                    for each in (estimate.converged, estimate.iterations, estimate.fit.chi2, estimate.fit.p)
                )
                columns["status"][rows] = np.where(converged, "converged", "not converged")
                columns["iterations"][rows], columns["dof"][rows] = iterations, estimate.fit.dof
                columns["chi2"][rows], columns["p"][rows] = chi2, p
                wide = (estimate.values, estimate.sd, *estimate.interval())
                for kind, numbers in zip(WIDE, wide, strict=True):
                    for name, column in zip(estimate.names, np.atleast_2d(numbers)[some].T, strict=True):
                        columns[f"{name}:{kind}"][rows] = column
            else:
                failed(0, alike[some[0]], estimate)
    return columns


def reason_of(error: Exception, source: str) -> str:
    """Why a data set failed, in one line; the name of its file stands next to it anyway."""
    if not isinstance(error, DashpotError):
        return f"internal error ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
    first = error.problems[0]
    place = first.where.removeprefix(source).lstrip(": ") if first.where else None
    return str(replace(first, where=place or None))


def estimated_names(rig: Rig) -> tuple[str, ...]:
    """Names of all that may be estimated: the unknowns of the rig, gains and delays."""
    return (*rig.model.unknown_names, *calibration_names(rig.channels))


# The amplitudes of a block's data sets: tables of many rigs read at once, and those measured alike as one batch.


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

    def cuts(self, part: Files | HeldRows) -> dict[int, Cut]:
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
                return dict(enumerate(_cuts(whole, (0, *some.ends[:-1]), some.ends), first))
        return self._one_by_one(some, first)

    def _lines_of_all(self, rows: HeldRows) -> Spectrum | None:
        """The lines of all rigs one after the other; None if a rig's lines are not what each of them is alone."""
        columns = array_columns(rows.source, dict(rows.columns), dict(rows.units))
        # Phases are looked at from line to line
        if any(pair.to_radian is not None for pair in amplitude_columns(columns).values()):
            return None
        content = interpret(columns, self.rig.channels, self._circumstances)
        if content.records or len(content.spectra) != 1:
            return None
        lines = content.spectra[0]
        if lines.lines != rows.ends[-1] or len(lines.stretches) > 1 or lines.records or not lines.complete:
            return None
        if "unknown" in lines.noise:  # it is sought in neighbouring lines
            return None
        treated = self.treatment.spectrum(self.rig, Reading((), lines, content.notes))
        return lines if treated is lines else None

    def _one_by_one(self, part: Files | HeldRows, first: int) -> dict[int, Cut]:
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


def _cuts(whole: Spectrum, starts: Sequence[int], ends: Sequence[int]) -> list[Cut]:
    """The lines between these places, with all that those of a batch have in common, bit by bit."""
    silent = np.diagonal(whole.covariance, axis1=-2, axis2=-1) == 0
    gaps = (np.isfinite(whole.amplitudes), np.isnan(whole.covariance), silent)
    arrays = (whole.frequency_hz, whole.samples, whole.dof, whole.experiment, whole.stretch, *gaps)
    shared = repr((whole.channels, whole.stretches, whole.moments is None))
    cuts = []
    for start, end in zip(starts, ends, strict=True):
        own = (array[start:end].tobytes() for array in arrays)
        cuts.append(Cut(whole, start, end, (shared, whole.noise[start:end], *own)))
    return cuts


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


# Fleets.


# Data sets up to which blocks have that size, which is part of what the last bits depend on.
SIZES = ((20, 1), (500, 10), (50_000, 100))


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
        return np.flatnonzero(self.columns["status"] == "failed").tolist()

    @property
    def misfits(self) -> list[int]:
        """Rows whose residuals are larger than the noise allows, at LEVEL for the whole fleet (Bonferroni)."""
        return np.flatnonzero(self.columns["p"] < LEVEL / self.count).tolist()

    @property
    def outliers(self) -> list[int]:
        """Rows in which some parameter is unlike the rest of the fleet."""
        unlike = [row.outlier for row in self.usual]
        return np.flatnonzero(np.any(unlike, axis=0)).tolist() if unlike else []

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
            own = {name: getattr(row, name) for name in ("unit", "count", "median", "spread", "noise")}
            own |= {"drift": row.slope, "drift_sd": row.slope_sd, "drift_p": row.drift_p}
            own["outliers"] = [str(self.columns["name"][k]) for k in np.flatnonzero(row.outlier)]
            if (of := populations.get(row.name)) is not None:
                interval = {"spread_interval95": list(of.spread_interval)}
                own["population"] = {"mean": of.mean, "mean_sd": of.mean_sd, "spread": of.spread, **interval}
            parameters[row.name] = own
        counts = {"data_sets": self.count, "failed": len(self.failed), "misfits": len(self.misfits)}
        return {"dashpot": version("dashpot"), "rig": self.rig, **counts, "parameters": parameters}


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
    where the folder cannot be used or holds something else, DataError if a table of data sets is damaged.
    """
    rig.model.require_unknowns()
    how = Treatment() if treatment is None else treatment
    model = {name: value for name, value in fields_of(rig.model) if name != "name"}
    # 3 is the version of what blocks hold
    basis = fingerprint_of(((model, rig.channels), how, estimated_names(rig), machine(), 3))

    def key(task: FleetTask) -> Key:
        name = fingerprint_of((basis, [part.checksum() for part in task.parts]))[:32]
        return Key(name, {"key": name})

    blocks: dict[int, Columns] = {}
    done = kept = 0
    if progress is not None:
        progress(0, source.count)
    opened: AbstractContextManager[BlockStore] = nullcontext(BlockStore())
    if folder is not None:
        cure = "name another file for the result"
        opened = opened_store(folder, lambda path: path.suffix == ".parquet", cure)
    with opened as store:
        parts = enumerate(source.blocks(block_size(source.count)))
        work = (FleetTask(number, rig, how, each) for number, each in parts)
        for block in store.map(identify_block, work, key=key, mapper=mapper):
            blocks[block.task.number] = columns = block.columns()
            done += len(columns["name"])
            kept += len(columns["name"]) if block.kept else 0
            if progress is not None:
                progress(done, source.count)
    return outcome_of(rig, [blocks[number] for number in sorted(blocks)], pool, kept)


def outcome_of(rig: Rig, blocks: Sequence[Columns], pool: bool, kept: int = 0) -> FleetOutcome:
    """The blocks put together, with what stands out and, where asked for, the populations.

    Raises UsageError if there are no data sets.
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
    """What the last bits of results depend on apart from the data: version, libraries, instruction set."""
    core = getattr(np, "_core", None)
    features = getattr(getattr(core, "_multiarray_umath", None), "__cpu_features__", {})
    chosen = ",".join(sorted(name for name, there in features.items() if there))
    parts = (version("dashpot"), description(), np.__version__, scipy.__version__, platform.machine(), chosen)
    return " ".join(parts)


def block_size(count: int) -> int:
    """Data sets in a block: few in small fleets, so that there is work for several processes."""
    # 1000: data sets in a block of the largest fleets
    return next((size for most, size in SIZES if count <= most), 1000)
