"""The unknowns of a rig over time: each window of a record tells what it can, and a random walk holds them together.

A window is a whole record of its own, with the loads of its ends (THEORY §8): its lines give a score and an information
matrix, taken at what the windows before it say, whose noise it does not share; these add up, and nothing else is kept.
How fast the unknowns walk, and whether one of them steps, `numerics/random_walk.py` finds from all windows together.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Frozen, Real
from dashpot.check.deficiencies import require_identifiable
from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.readers import Reading
from dashpot.data.readers.in_memory import records_of
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import ConvergenceError, DashpotError, DataError, IdentifiabilityError, UsageError
from dashpot.estimate.automatic import identify_with_noise
from dashpot.estimate.identify import amplitudes_for, estimate_by_plan
from dashpot.estimate.likelihood.descent import Likelihood
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.estimate.preparation import prepare
from dashpot.estimate.result import MISFIT, Estimate
from dashpot.io.json_document import data_frame, to_json
from dashpot.io.words import choose_from, counted
from dashpot.model.observation import observation_model
from dashpot.model.rigfile import Rig
from dashpot.notices import Notice
from dashpot.numerics.random_walk import Trajectory, Windows, trajectory
from dashpot.shorthand import Printable
from dashpot.study.blocks import write_table

FALSE_ALARMS = 0.01  # of records without a change, in which one is announced
HOUR = 3600.0  # s; a speed is the standard deviation of a change in one hour


@dataclass(frozen=True)
class TrackedChange:
    """A change of one unknown.

    kind    "abrupt", at one time, or "gradual"
    time_s, time95_s  of an abrupt change, with its 95 % interval; of a gradual one middle and ends of the record
    size, sd  in the unit of the unknown; relative, of its value before
    p       probability of a change as likely, of any unknown at any time, where nothing changes
    odds    of an abrupt change against a gradual one
    """

    name: str
    kind: str
    time_s: float
    time95_s: tuple[float, float]
    size: float
    sd: float
    relative: float
    p: float
    odds: float


@dataclass(frozen=True)
class Track(Frozen, Printable):
    """The unknowns of a rig over time.

    names, units     of the unknowns, SI
    start_s, end_s   (windows,)
    values, sd       (windows, unknowns), from all windows together, with standard deviations
    alone, alone_sd  (windows, unknowns), from each window alone
    speed, speed95   (unknowns,), (unknowns, 2): standard deviation of the walk after one hour, and its 95 % interval
    scatter          of the windows beyond their noise, as a factor on standard deviations; included in sd
    changes          in order of time
    false_alarms     share of records without a change in which one is reported
    given            whether the speed was given
    notes            windows that were left out, do not fit, or scatter
    """

    rig: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    start_s: Real
    end_s: Real
    values: Real
    sd: Real
    alone: Real
    alone_sd: Real
    speed: Real
    speed95: Real
    scatter: float
    changes: tuple[TrackedChange, ...]
    false_alarms: float
    given: bool = False
    notes: tuple[Notice, ...] = ()

    def __repr__(self) -> str:
        changed = ", ".join(f"{c.name} {c.relative:+.2%} at {c.time_s:.5g} s" for c in self.changes)
        windows = counted(len(self.start_s), "window")
        return f"<Track of {', '.join(self.names)}: {windows}; {changed or 'no change'}>"

    def to_dict(self) -> dict[str, Any]:
        """The track for JSON: lists over windows, SI units."""
        parameters = {
            name: {
                "unit": self.units[j],
                "value": self.values[:, j].tolist(),
                "sd": self.sd[:, j].tolist(),
                "alone": {"value": self.alone[:, j].tolist(), "sd": self.alone_sd[:, j].tolist()},
                "speed": {"value": float(self.speed[j]), "interval95": self.speed95[j].tolist()},
            }
            for j, name in enumerate(self.names)
        }
        changes = [
            {
                "parameter": c.name,
                "kind": c.kind,
                "time_s": c.time_s,
                "time95_s": list(c.time95_s),
                "size": c.size,
                "sd": c.sd,
                "relative": c.relative,
                "p": c.p,
                "odds_abrupt": c.odds,
            }
            for c in self.changes
        ]
        return {
            "model": self.rig,
            "windows": {"start_s": self.start_s.tolist(), "end_s": self.end_s.tolist()},
            "parameters": parameters,
            "changes": changes,
            "false_alarms": self.false_alarms,
            "scatter": self.scatter,
            "speed_given": self.given,
            "notes": [{"code": note.code, "text": note.text} for note in self.notes],
        }

    def save(self, path: str) -> None:
        """A Parquet table with a row for each window; changes are in its metadata.  Raises DataError."""
        told = self.to_dict()
        kept = {key: told[key] for key in ("changes", "false_alarms", "scatter")}
        write_table(Path(path), self._columns(), to_json(kept).encode())

    def to_dataframe(self) -> Any:
        """A pandas DataFrame with a row for each window, as `save` writes it.

        Raises UsageError without pandas (extra "analysis").
        """
        return data_frame(self._columns(), "start_s")

    def _columns(self) -> dict[str, Real]:
        columns: dict[str, Real] = {"start_s": self.start_s, "end_s": self.end_s}
        for j, name in enumerate(self.names):
            columns |= {name: self.values[:, j], f"{name}_sd": self.sd[:, j]}
            columns |= {f"{name}_alone": self.alone[:, j], f"{name}_alone_sd": self.alone_sd[:, j]}
        return columns


class Tracker:
    """Tracks the unknowns of a rig window by window; keeps unknowns² + unknowns numbers per window and no samples.

    rig           with its channels; its unknowns are tracked
    conditioning  how windows are turned into amplitudes
    seed          of ml's random starts for the first window, and of the simulations that set thresholds
    skipped       windows that do not determine the unknowns, with the reason
    """

    def __init__(self, rig: Rig, conditioning: Conditioning | None = None, seed: int = 0) -> None:
        self.rig, self.seed = rig, seed
        self.conditioning = Conditioning() if conditioning is None else conditioning
        self.skipped: list[str] = []
        self._kept: list[_Window] = []
        self._since = 0  # the window with which the present run of like ones begins
        self.rig.require_alike("tracking")
        self.rig.model.require_unknowns(self.rig.path or None)
        require_identifiable(self.rig.model, self.rig.channels, self.rig.path or None)

    def add(self, data: Any) -> bool:
        """Take a window: a Record, or columns by name with time_s.  False where it does not determine the unknowns.

        Raises DataError if the columns are not those of the rig, or the window begins before the previous one ends.
        """
        if isinstance(data, Record):
            record = data
        else:
            records = records_of(data, self.rig)
            if len(records) != 1:
                raise DataError(
                    f"the data are {counted(len(records), 'record')}", "window", "give one at a time"
                )
            record = records[0]
        if record.frequency_hz is not None:
            raise DataError(
                "a window needs a continuous record, and this is stepped sine",
                record.source,
                "leave frequency_hz out",
            )
        if self._kept and (record.time[0] + record.time[1]) / 2 < self._kept[-1].end:
            raise DataError("the window begins before the last one ends", record.source, "give them in order")
        try:
            window = self._window(record)
            if self._kept and window.names != self._kept[-1].names:
                what = f"the window estimates {', '.join(window.names)}, those before others"
                raise DataError(what, record.source, "leave the same unknowns open in every window")
        except (ConvergenceError, DataError, IdentifiabilityError) as error:
            if not self._kept and len(self.skipped) >= 2:  # three in a row: nothing to track here
                raise
            self.skipped.append(f"{record.time[0]:.6g} to {record.time[-1]:.6g} s: {error}")
            return False
        self._kept.append(window)
        return True

    @property
    def windows(self) -> int:
        """Number of windows taken."""
        return len(self._kept)

    def track(
        self, *, speed: float | Mapping[str, float] | None = None, false_alarms: float = FALSE_ALARMS
    ) -> Track:
        """The unknowns over time from all windows together.

        speed         standard deviation of the change in one hour, as a share of the value: for all unknowns, or by
                      name (the others are then constant); by default estimated
        false_alarms  share of records without a change in which one is reported

        Raises DataError if no window was taken, and UsageError for an invalid speed or share.
        """
        if not self._kept:
            first = f": {self.skipped[0]}" if self.skipped else ""
            raise DataError(
                f"no window determines the unknowns{first}", cure="use longer windows, or increase the drive"
            )
        if not 0 < false_alarms < 0.5:
            raise UsageError(f"a share of {false_alarms:g} false alarms", cure="give one from 0.2 % to 49 %")
        some = self._kept[-1]
        names = some.names
        windows = Windows(
            np.array([each.start for each in self._kept]) / HOUR,
            np.array([each.end for each in self._kept]) / HOUR,
            np.array([each.values for each in self._kept]),
            np.array([each.information for each in self._kept]),
            some.precision,
            some.mean,
        )
        self.require_speed(speed)
        variance: Real | None = None
        if speed is not None:
            each = speed if isinstance(speed, Mapping) else dict.fromkeys(names, speed)
            share = np.array([each.get(name, 0.0) for name in names])
            variance = (share * np.median(windows.values, axis=0)) ** 2
        found = trajectory(windows, false_alarms=false_alarms, variance=variance, seed=self.seed)
        alone_sd = np.array(
            [
                np.sqrt(np.diagonal(_inverse(each.information + np.diag(some.precision))))
                for each in self._kept
            ]
        )
        changes = []
        for one in sorted(found.changes, key=lambda change: change.time):
            before = float(found.values[max(one.window - 1, 0), one.component])
            kind = "abrupt" if one.window else "gradual"
            span = (one.time95[0] * HOUR, one.time95[1] * HOUR)
            relative = one.size / before if before else math.nan
            name, at = names[one.component], one.time * HOUR
            changes.append(TrackedChange(name, kind, at, span, one.size, one.sd, relative, one.p, one.odds))
        return Track(
            rig=self.rig.model.name,
            names=names,
            units=some.units,
            start_s=windows.start * HOUR,
            end_s=windows.end * HOUR,
            values=found.values,
            sd=found.sd,
            alone=windows.values,
            alone_sd=alone_sd,
            speed=found.speed,
            speed95=found.speed95,
            scatter=math.sqrt(found.scatter),
            changes=tuple(changes),
            false_alarms=false_alarms,
            given=speed is not None,
            notes=self._notes(found),
        )

    def require_speed(self, speed: float | Mapping[str, float] | None) -> None:
        """Raises UsageError for a speed of no unknown, or one that is none."""
        model = self.rig.model
        view = observation_model(model, self.rig.channels, np.ones(1), np.zeros(1, dtype=np.int64))
        each = dict(speed) if isinstance(speed, Mapping) else {} if speed is None else {view.names[0]: speed}
        for name, share in each.items():
            if name not in view.names:
                raise UsageError(f"there is no unknown {name}", cure=choose_from(view.names))
            if not (math.isfinite(share) and share >= 0):
                raise UsageError(f"the speed of {name} is {share:g}", cure="give a share, 0 or more")

    def _notes(self, found: Trajectory) -> tuple[Notice, ...]:
        notes = []
        if self.skipped:
            text = f"{counted(len(self.skipped), 'window')} left out, the first from {self.skipped[0]}"
            notes.append(Notice("windows_left_out", text))
        stepped = [HOUR * change.time for change in found.changes if change.window]
        misfit = sum(
            each.misfit and not any(each.start <= time <= each.end for time in stepped) for each in self._kept
        )
        if misfit:
            text = (
                f"in {misfit} of {counted(len(self._kept), 'window')} the model misses more than the noise "
                "explains: changes are still comparable, but errors of the values may exceed their intervals"
            )
            notes.append(Notice("windows_misfit", text))
        if found.scatter > 1.2**2:
            text = (
                f"the windows scatter {math.sqrt(found.scatter):.3g} times as much as their noise explains; all "
                "intervals and tests account for it"
            )
            notes.append(Notice("windows_scatter", text))
        return tuple(notes)

    def _window(self, record: Record) -> _Window:
        """What one window says."""
        model = self.rig.model
        if len(model.nonlinear):
            estimate = fit_records(model, [record], None, still=self.conditioning.still).estimate()
            return _Window.of(record, estimate, *_alone(estimate))
        reading = Reading((record,), None, ())
        spectrum = amplitudes_for(model, reading, self.conditioning, [MaximumLikelihood.traits])
        if not spectrum.records:
            raise DataError(
                "the window contains no lines of a continuous record", record.source, "use longer windows"
            )
        estimate, known = identify_with_noise(model, spectrum, "ml" if self._kept else None, seed=self.seed)
        if not bool(estimate.converged):
            raise ConvergenceError("the search did not converge", record.source, "use longer windows")
        values, information = _alone(estimate)
        before = self._before()
        sign = known.signs(estimate.signs)
        if before is not None and not _alike(before, estimate.free_values, information):
            nearer = self._from(before[0], known, estimate)
            if nearer is not None:
                estimate, sign = nearer, known.signs(nearer.signs)
                values, information = _alone(estimate)
            if not _alike(before, estimate.free_values, information):
                self._since, before = len(self._kept), None
        if before is not None and not np.any(np.isfinite(model.bounds)):
            # By its score at what was known before, which its own noise has no part in
            data = prepare(model, known, states=False)
            around = Likelihood.of(data, MaximumLikelihood().effort).model_at(before[0][None], sign)
            precision, mean = _priors(estimate)
            information = around.symmetric[0] - np.diag(precision)
            score = around.gradient[0] - precision * (mean - before[0])
            values, information = before[0] + _inverse(information) @ score, information
        return _Window.of(record, estimate, values, information)

    def _before(self) -> tuple[Real, Real] | None:
        """What the windows of the present run say together: the unknowns and their information, priors counted."""
        run = self._kept[self._since :]
        if not run:
            return None
        precision = np.diag(run[-1].precision)
        information = np.sum([each.information for each in run], axis=0) + precision
        right = sum((each.information @ each.values for each in run), run[-1].precision * run[-1].mean)
        return _inverse(information) @ right, information

    def _from(self, start: Real, spectrum: Spectrum, other: Estimate) -> Estimate | None:
        """Where the fit of a window leads from what those before it say, if that is likelier than what it found."""
        sign = spectrum.signs(other.signs)[0]
        method = MaximumLikelihood(start=tuple(start.tolist()), start_sign=tuple(sign.tolist()))
        try:
            nearer = estimate_by_plan(self.rig.model, spectrum, method)
        except DashpotError:
            return None
        return nearer if bool(nearer.converged) and nearer.fit.chi2 < other.fit.chi2 else None


@dataclass(frozen=True)
class _Window:
    """What is kept of a window: its estimate and information, without what was stated before."""

    start: float
    end: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    information: Real
    precision: Real
    mean: Real
    misfit: bool

    @staticmethod
    def of(record: Record, estimate: Estimate, values: Real, information: Real) -> _Window:
        precision, mean = _priors(estimate)
        step = record.step_s
        start, end = float(record.time[0]), float(record.time[-1]) + step
        known = estimate.names, estimate.units
        return _Window(start, end, *known, values, information, precision, mean, estimate.basis == MISFIT)


def _priors(estimate: Estimate) -> tuple[Real, Real]:
    """Precisions and means of what was stated, 0 of what was not."""
    mean, sd = estimate.priors
    return np.nan_to_num(sd**-2.0), np.nan_to_num(mean)


def _alone(estimate: Estimate) -> tuple[Real, Real]:
    """Values and information of an estimate without what was stated before."""
    precision, mean = _priors(estimate)
    total = _inverse(estimate.noise_covariance)
    information = total - np.diag(precision)
    right = total @ estimate.free_values - precision * mean
    return (_inverse(information) @ right if np.any(precision) else estimate.free_values), information


def _alike(before: tuple[Real, Real], values: Real, information: Real) -> bool:
    """Whether a window is no further from those before it than noise makes it."""
    apart = values - before[0]
    spread = _inverse(before[1]) + _inverse(information)
    # A window begins anew that is as far from those before it once in a thousand.
    return float(chdtrc(len(apart), apart @ _inverse(spread) @ apart)) >= 1e-3


def _inverse(matrix: Real) -> Real:
    """Of a covariance or an information, as far as it is one: the shortest in units of its diagonal."""
    size = np.sqrt(np.maximum(np.abs(np.diagonal(matrix)), np.finfo(float).tiny))
    unit = np.outer(size, size)
    inverse: Real = np.linalg.pinv(matrix / unit, rcond=1e-13, hermitian=True) / unit
    return inverse
