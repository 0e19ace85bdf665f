"""What a worker does with a block of data sets: read each, identify those alike as one batch, one row for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dashpot.arrays import Bools, Ints
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.readers import Reading, read
from dashpot.data.readers.array_columns import array_columns
from dashpot.data.readers.delimited.stepped_sine import Circumstances
from dashpot.data.readers.interpretation import interpret
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.errors import DashpotError
from dashpot.estimate.amplitudes import amplitudes_for
from dashpot.estimate.automatic import suited_method
from dashpot.estimate.identify import identify
from dashpot.estimate.method import Method
from dashpot.estimate.registry import method_class
from dashpot.estimate.result import Estimate
from dashpot.fleet.data_sets import DataSet, PackedRows, packed
from dashpot.model.observation import calibration_names
from dashpot.model.rigfile import Rig

Columns = dict[str, np.ndarray]
WIDE = ("value", "sd", "lower", "upper")  # one column each for every unknown
PLAIN = ("name", "source", "status", "reason", "lines", "iterations", "chi2", "dof", "p")


@dataclass(frozen=True)
class Treatment:
    """How every data set of a fleet is treated: method (None: the one that suits), conditioning of time records."""

    method: str | None = None
    conditioning: Conditioning = field(default_factory=Conditioning)
    frequency_hz: float | None = None
    positive: bool = False
    seed: int = 0

    def chosen(self, rig: Rig, spectrum: Spectrum) -> Method:
        """The method that one data set is identified by.

        Raises UsageError where there is no such method, DataError where a channel measures what the rig has not.
        """
        return suited_method(self.method, rig.model, spectrum, seed=self.seed, positive=self.positive)

    def spectrum(self, rig: Rig, reading: Reading) -> Spectrum:
        """The amplitudes of a data set; what its manifest says of conditioning counts first.

        Raises DataError where its samples cannot be used, UsageError where there is no such method.
        """
        methods = [] if self.method is None else [method_class(self.method).traits]
        return amplitudes_for(rig.model, reading, self.conditioning.changed(**reading.conditioning), methods)


@dataclass(frozen=True)
class FleetTask:
    """Some data sets of one rig; `key` names the block."""

    key: str
    rig: Rig
    treatment: Treatment
    data_sets: tuple[DataSet, ...]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "data_sets": packed(self.data_sets)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        content = state["data_sets"]
        whole = content.unpacked() if isinstance(content, PackedRows) else content
        for name, value in {**state, "data_sets": whole}.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class FleetBlock:
    """The rows of a block, by column."""

    key: str
    columns: Columns


def identify_block(task: FleetTask) -> FleetBlock:
    """Identify a block.  A function of the module, so that any process can be sent it; raises nothing of the data."""
    columns = _empty(estimated_names(task.rig), task.data_sets)
    spectra: dict[int, Spectrum] = {}
    for k, data_set in enumerate(task.data_sets):
        try:
            spectra[k] = spectrum_of(task.rig, data_set, task.treatment)
        except Exception as error:  # a reader that fails on one file of a million must not stop the rest
            columns["reason"][k] = reason_of(error, data_set)
        else:
            columns["lines"][k] = spectra[k].lines
    for alike in alike_spectra(spectra):
        for k in _together(task, alike, [spectra[k] for k in alike], columns):
            _alone(task, k, spectra[k], columns)
    return FleetBlock(task.key, columns)


def reason_of(error: Exception, data_set: DataSet) -> str:
    """Why a data set failed, in one line; the name of its file stands beside it anyway."""
    if not isinstance(error, DashpotError):
        return f"internal error ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
    first = error.problems[0]
    place = first.where.removeprefix(data_set.source).lstrip(": ") if first.where else None
    return str(replace(first, where=place or None))


def spectrum_of(rig: Rig, data_set: DataSet, treatment: Treatment) -> Spectrum:
    """The amplitudes of one data set.  Raises DataError."""
    if data_set.columns:
        columns = array_columns(data_set.source, dict(data_set.columns), dict(data_set.units))
        content = interpret(columns, rig.channels, Circumstances(treatment.frequency_hz, 0))
        lines = None
        if content.spectra:
            lines = content.spectra[0] if len(content.spectra) == 1 else concatenate(content.spectra)
        reading = Reading(content.records, lines, content.notes, content.joint)
    else:
        reading = read(data_set.source, rig.channels, frequency_hz=treatment.frequency_hz)
    return treatment.spectrum(rig, reading)


def estimated_names(rig: Rig) -> tuple[str, ...]:
    """Names of all that may be estimated: the unknowns of the rig, gains and delays."""
    return (*rig.model.unknown_names, *calibration_names(rig.channels))


# Batches


def alike_spectra(spectra: Mapping[int, Spectrum]) -> list[list[int]]:
    """Which spectra can be repeats of one test: the same lines, measured alike."""
    groups: dict[object, list[int]] = {}
    for k, spectrum in spectra.items():
        groups.setdefault(k if spectrum.records else _signature(spectrum), []).append(k)
    return list(groups.values())


def _signature(spectrum: Spectrum) -> tuple[object, ...]:
    """All that a batch has in common, bit by bit."""
    silent = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1) == 0
    arrays = (
        spectrum.frequency_hz, spectrum.samples, spectrum.dof, spectrum.experiment, spectrum.stretch,
        np.isfinite(spectrum.amplitudes), np.isnan(spectrum.covariance), silent,
    )  # fmt: skip
    shared = (spectrum.channels, spectrum.noise, spectrum.stretches, spectrum.moments is None)
    return (*(array.tobytes() for array in arrays), repr(shared))


def _stacked(spectra: Sequence[Spectrum]) -> Spectrum:
    """Spectra of one signature as one with a leading axis."""
    first = spectra[0]
    moments = None
    if first.moments is not None:
        products = np.stack([s.moments.products for s in spectra if s.moments is not None])
        moments = replace(first.moments, products=products)
    return replace(
        first,
        amplitudes=np.stack([spectrum.amplitudes for spectrum in spectra]),
        covariance=np.stack([spectrum.covariance for spectrum in spectra]),
        moments=moments,
    )


def _together(
    task: FleetTask, places: Sequence[int], spectra: Sequence[Spectrum], columns: Columns
) -> list[int]:
    """Enter the estimates of alike spectra; the places of those that need a look at them alone."""
    if len(spectra) == 1:
        return list(places)
    try:
        batch = identify(task.rig.model, _stacked(spectra), task.treatment.chosen(task.rig, spectra[0]))
    except Exception:  # each is tried alone, and says itself what is wrong with it
        return list(places)
    usable = batch.converged & np.all(np.isfinite(batch.sd), axis=-1)
    _enter(columns, np.asarray(places), batch, usable)
    return [k for k, good in zip(places, usable, strict=True) if not good]


def _alone(task: FleetTask, k: int, spectrum: Spectrum, columns: Columns) -> None:
    try:
        estimate = identify(task.rig.model, spectrum, task.treatment.chosen(task.rig, spectrum))
    except Exception as error:
        columns["reason"][k] = reason_of(error, task.data_sets[k])
    else:
        _enter(columns, np.array([k]), estimate, np.array([True]))


# Rows as columns


def _empty(names: Sequence[str], data_sets: Sequence[DataSet]) -> Columns:
    """A row for each data set, failed so far: what PLAIN names, then NAME:value, NAME:sd … of every unknown."""
    count = len(data_sets)
    columns: Columns = {
        "name": np.array([data_set.name for data_set in data_sets], dtype=object),
        "source": np.array([data_set.source for data_set in data_sets], dtype=object),
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
