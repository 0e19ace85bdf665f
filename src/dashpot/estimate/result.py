"""The result of an identification: complete, immutable, and without a way back to the data."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from scipy.special import stdtr, stdtrit

from dashpot.arrays import Bools, Complex, Frozen, Ints, Real, frozen
from dashpot.errors import DataError, ModelError, Problem, UsageError
from dashpot.estimate.assessment import Assessment, assessment_from
from dashpot.estimate.method import HeldBounds, OtherMinima
from dashpot.io.json_document import from_json, nullable, numbers_of, optional_library, to_json
from dashpot.io.ledger import noted
from dashpot.io.words import listed, shown
from dashpot.notices import Notice
from dashpot.numerics.small_systems import standard_deviations
from dashpot.quantities import LARGEST
from dashpot.shorthand import Printable, call
from dashpot.unknowns import Unknown, pull

if TYPE_CHECKING:
    from dashpot.data.record import Record
    from dashpot.data.spectrum import Spectrum
    from dashpot.export.state_space import StateSpace
    from dashpot.export.transfer_functions import TransferFunctions
    from dashpot.model.network import Model
    from dashpot.model.rigfile import Rig


EXTRA = "analysis"  # what brings the libraries in whose terms an Estimate may be had


# Whether an estimate that was read from a file can be one: what a hand or a fault may have changed in it.


def _faults(estimate: Estimate) -> Iterator[str]:
    """Everything that no estimate can have."""
    names, count = estimate.names, len(estimate.names)
    texts = (*names, *estimate.units, estimate.model, estimate.method, estimate.basis)
    texts += tuple(text for text in (estimate.rig, estimate.rig_text) if text is not None)
    if not all(isinstance(text, str) for text in texts):
        yield "a name, a unit or the rig is not text"
        return
    if len(set(names)) < count:
        yield f"order: {next(name for name in names if names.count(name) > 1)} is named twice"
    if np.ndim(estimate.iterations) or np.ndim(estimate.converged):
        yield "iterations: not one number"
        return
    for name in ("covariance", "noise_covariance"):
        matrix = getattr(estimate, name)
        if matrix.shape != (count, count):
            yield f"{name}: {matrix.shape} numbers for {count} unknowns"
            return
        yield from _matrix_faults(name, matrix, names)
    for name, value, sd in estimate.stated:
        if name not in names or not (np.isfinite(value) and 0 < sd < np.inf):
            yield f"stated: {name} as {value} ± {sd}, which is not possible"
    yield from _value_faults(estimate)


def _value_faults(estimate: Estimate) -> Iterator[str]:
    """Values that are lost or refer to nothing, sizes below 0 and bounds that leave no room."""
    names = estimate.names
    values = list(zip(names, estimate.values, strict=True))
    for name, value in values:
        if np.isfinite(value) and abs(value) > LARGEST:
            yield f"{name}: {value:g} is out of range"
    lost = [name for name, value in values if not np.isfinite(value)]
    if lost and bool(estimate.converged):
        yield f"{listed(lost)}: no value"
    for label, array in (("bound_sd", estimate.bound_sd), ("interval_dof", estimate.dof)):
        wrong = [name for name, value in zip(names, array, strict=True) if value < 0]
        if wrong:
            yield f"{listed(wrong)}: {label} is negative"
    for name, low, high in zip(names, estimate.lower, estimate.upper, strict=True):
        if not low <= high:
            yield f"{name}: min is above max"
    for _, root, times, _ in estimate.tied:
        if root not in names:
            yield f"tied: {root} is not among the unknowns"
        if not np.isfinite(times):
            yield f"tied: {times} is not a finite number"
    for name, value, _ in estimate.known:
        if not abs(value) <= LARGEST:
            yield f"{name}: no value, or one that is out of range"


def _matrix_faults(label: str, matrix: np.ndarray, names: tuple[str, ...]) -> Iterator[str]:
    """Variances must not be negative, correlations not beyond 1, and the matrix symmetric; null is not known."""
    variances = np.diagonal(matrix)
    negative = [name for name, value in zip(names, variances, strict=True) if value < 0]
    if negative:
        yield f"{label}: the variance of {listed(negative)} is negative"
        return
    size = np.outer(np.sqrt(variances), np.sqrt(variances))
    rounding = 1e-9  # of an entry, in standard deviations
    with np.errstate(invalid="ignore", over="ignore"):
        skew = np.abs(matrix - matrix.T) > rounding * size
        beyond = np.abs(matrix) > (1 + rounding) * size
    if np.any(skew):
        yield f"{label}: not symmetric"
    elif np.any(beyond):
        i, j = np.argwhere(beyond)[0]
        yield f"{label}: the correlation of {names[i]} and {names[j]} is beyond 1"


# Intervals from an estimate and its standard deviation, cut off at bounds where there are some.


def bounded_interval(
    values: Real, free: Real, sd: Real, dof: Real, lower: Real, upper: Real, level: float
) -> tuple[Real, Real]:
    """Ends of the intervals at `level` around the free estimates, each (..., m), all arguments (..., m) or (m,).

    Where an unknown has bounds, the interval is that of the free estimate, cut off at them: what it holds of the
    allowed values it held before, so its coverage is kept.  Where the free estimate lies beyond a bound, the cut
    interval would shrink to nothing; there its far end is that of the distribution truncated at the bound, which
    passes into the other one smoothly.  The interval always holds the value.
    """
    half = stdtrit(dof, 0.5 + level / 2) * sd
    low, high = free - half, free + half
    if np.any(np.isfinite(lower) | np.isfinite(upper)):
        high = np.where(free < lower, free + sd * truncated_reach((lower - free) / sd, dof, level), high)
        low = np.where(free > upper, free - sd * truncated_reach((free - upper) / sd, dof, level), low)
        low, high = np.clip(low, lower, upper), np.clip(high, lower, upper)
        low, high = np.minimum(low, values), np.maximum(high, values)
    return low, high


def profile_interval(
    curve: tuple[Sequence[float], Sequence[float]], dof: float, level: float
) -> tuple[float, float]:
    """Ends at `level` of the interval from a profile: (values, roots), both ascending.

    A root is that of the rise of χ², with the side's sign, over the root at the ends of the 95 % interval, −1 and 1.
    Beyond what the profile has seen the ends grow as far as it did; where it saw no limit there is none.
    """
    values, roots = (np.asarray(part, dtype=float) for part in curve)
    reach = float(stdtrit(dof, 0.5 + level / 2) / stdtrit(dof, 0.975))
    seen = np.isfinite(values)
    middle = float(np.interp(0.0, roots[seen], values[seen]))
    ends = []
    for root in (-reach, reach):
        edge = -1 if root > 0 else 0
        last, at = float(values[seen][edge]), float(roots[seen][edge])
        if abs(root) <= abs(at):
            ends.append(float(np.interp(root, roots[seen], values[seen])))
        elif not seen[edge]:
            ends.append(float(values[edge]))
        else:
            ends.append(middle + (last - middle) * root / at if at else last)
    return ends[0], ends[1]


def truncated_reach(beyond: Real, dof: Real, level: float) -> Real:
    """How far from its centre a t distribution cut off at `beyond` > 0 holds `level` of what is left, (...,)."""
    beyond = np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0)
    left = (1 - level) * stdtr(dof, -beyond)
    with np.errstate(all="ignore"):
        reach = -stdtrit(dof, left)
    return np.where(np.isfinite(reach), np.maximum(reach, beyond), beyond)


FORMAT = "0.1"
SENSOR_NOISE, RESIDUALS, MISFIT = "sensor noise", "residuals", "model misfit"  # what intervals may rest on
REMEDY = "write one with dashpot identify --json"


def _with_sd(name: str, value: float, sd: float, unit: str) -> str:
    """ "m1 = 2.995 ± 0.012 kg"."""
    return f"{name} = {value:.4g} ± {sd:.2g}{'' if unit == '1' else ' ' + unit}"


@dataclass(frozen=True)
class Value:
    """One parameter, SI units.

    name, unit   of the parameter
    value, sd    estimate and standard deviation; 0 for what is exactly known
    interval95   ends of the 95 % interval
    bound_sd     standard deviation at the Cramér-Rao bound
    known        whether it was stated exactly
    """

    name: str
    value: float
    sd: float
    interval95: tuple[float, float]
    bound_sd: float
    unit: str
    known: bool = False

    def __repr__(self) -> str:
        """One line: name, value, standard deviation, interval."""
        low, high = self.interval95
        return f"<{_with_sd(self.name, self.value, self.sd, self.unit)}, 95 %: {low:.4g} … {high:.4g}>"


@dataclass(frozen=True)
class ModeValues(Frozen):
    """Modes of the estimated rig, in order of |λ|.

    eigenvalues     λ, 1/s, (modes,)
    frequency_hz    natural frequencies |λ|/2π, (modes,)
    damping_ratio   −Re λ/|λ|, (modes,)
    frequency_sd, damping_sd  standard deviations of both, (modes,)
    shapes          complex, (modes, n), largest entry 1
    """

    eigenvalues: Complex
    frequency_hz: Real
    damping_ratio: Real
    frequency_sd: Real
    damping_sd: Real
    shapes: Complex


@dataclass(frozen=True)
class Fit:
    """Size of the residuals relative to the noise.

    chi2 (...,)  χ² of the residuals against the noise that was given or measured
    dof          its degrees of freedom: real measured values minus estimated ones
    p (...,)     probability of a larger χ² if the model is right
    known_noise  False if the noise was unknown: then χ² equals dof by construction and p is NaN
    """

    chi2: Real
    dof: int
    p: Real
    known_noise: bool = True

    @property
    def rejected(self) -> Bools:
        """Whether residuals exceed the noise, (...,): then the model, not the sensors, limits the accuracy."""
        return np.asarray(self.p < 1e-3)

    @property
    def tested(self) -> bool:
        """Whether the noise was known apart from the residuals of the fit."""
        return bool(np.any(np.isfinite(self.p)))

    @property
    def misfit(self) -> Real:
        """√(χ²/dof), (...,): how many times larger than the noise the residuals are."""
        return np.sqrt(self.chi2 / max(self.dof, 1))


@dataclass(frozen=True)
class Origin:
    """What an estimate was made from: the rig, the amplitudes, None where there were none, and names of files."""

    rig: Rig
    spectrum: Spectrum | None = None
    files: tuple[str, ...] = ()


@dataclass(frozen=True)
class Cost:
    """What the uncertainty of a statement costs an interval.

    of, on  names of what was stated with an sd, and of the unknown whose interval it is
    impact  by which `on` moves with one standard deviation of `of` that the data leave, SI units
    share   of the variance of `on` that would go were `of` exact
    """

    of: str
    on: str
    impact: float
    share: float


@dataclass(frozen=True)
class Cycle:
    """A settled cycle of the elements that join two ends, with standard deviations; SI units (`estimate.cycles`).

    elements      their names
    between       the ends that are no ground
    frequency_hz  of the motion
    amplitude     of its fundamental, m, or rad between angles (`unit`)
    energy        that a cycle takes, J
    stiffness     equivalent: force in phase with the elongation, over its amplitude, N/m or N·m/rad
    damping       equivalent viscous: force in phase with the rate, over its amplitude, N·s/m or N·m·s/rad
    """

    elements: tuple[str, ...]
    between: tuple[str, ...]
    frequency_hz: float
    amplitude: float
    unit: str
    energy: float
    energy_sd: float
    stiffness: float
    stiffness_sd: float
    damping: float
    damping_sd: float


@dataclass(frozen=True)
class Estimate(Frozen, Printable):
    """Values of the unknowns with their full covariance; every array may have leading batch axes.

    model, method       names of the rig and of the estimator
    names, units        of the unknowns, in order; gains and delays that were estimated follow as channel.gain …
    values (..., m)     estimates
    covariance          (..., m, m)
    noise_covariance    (..., m, m)  from sensor noise alone; equal to `covariance` if `basis` is "sensor noise"
    bound_sd (..., m)   standard deviations at the Cramér-Rao bound, at the estimate
    dof (..., m)        degrees of freedom of the t quantile that the intervals use
    lower, upper (m,)   bounds that the estimate was held to, ±inf where there is none
    free_values (..., m)  estimate without bounds, to first order; equal to `values` if no bound is active
    basis               what the intervals include: "sensor noise", "residuals" or "model misfit"
    converged (...,)    whether the iterations converged; if not, values are those of the last one
    iterations (...,)   total over all starts, 0 for closed forms
    history             start, and unknowns after each iteration of the descent that led to the values, for the first
                        repeat, (points, unknowns): at most iterations + 1
    fit                 χ² and its p-value
    known               (name, value, unit) of the exactly known parameters
    tied                (name, unknown, times, unit) of the parameters that are a multiple of an unknown
    modes               of the estimated rig; None for batches, and for rigs of more than 400 coordinates
    signs               ±1 (...,) of the channels whose sign was found, by name
    warnings, notes     notices of the estimate, and of the data it was made from
    assessment          verdict and diagnosis, where they were made
    rig                 name of the rig file, if there is one
    rig_text            the rig as a rig file, of an estimate that was read from JSON
    profiles            profiles (`profile_interval`) of the unknowns along which χ² is not a parabola, by name
    origin              the Rig and data it was made from; not saved
    stated              (name, value, sd) of the unknowns that were known with a standard deviation
    cycles              for a test stand: energy, equivalent stiffness and damping of the measured cycles
    """

    model: str
    method: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    covariance: Real
    noise_covariance: Real
    bound_sd: Real
    dof: Real
    lower: Real
    upper: Real
    free_values: Real
    basis: str
    converged: Bools
    iterations: Ints
    history: Real
    fit: Fit
    known: tuple[tuple[str, float, str], ...]
    tied: tuple[tuple[str, str, float, str], ...]
    modes: ModeValues | None
    signs: Mapping[str, Real]
    warnings: tuple[Notice, ...]
    notes: tuple[Notice, ...] = ()
    assessment: Assessment | None = None
    rig: str | None = None
    rig_text: str | None = None
    profiles: Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]] = field(default_factory=dict)
    origin: Origin | None = field(default=None, repr=False, compare=False)
    stated: tuple[tuple[str, float, float], ...] = ()
    cycles: tuple[Cycle, ...] = ()

    def __repr__(self) -> str:
        """One line: method, status and values."""
        if self.values.ndim > 1:
            shape = " × ".join(map(str, self.values.shape[:-1]))
            return f"<{shape} estimates by {self.method} of {', '.join(self.names)}: {self.status}>"
        each = zip(self.names, self.values.tolist(), self.sd.tolist(), self.units, strict=True)
        values = ", ".join(_with_sd(*one) for one in list(each)[:8])
        more = f", … ({len(self.names)} in all)" if len(self.names) > 8 else ""
        return f"<Estimate by {self.method}, {self.status}: {values}{more}>"

    @property
    def status(self) -> str:
        """ "converged" or "not converged"; of a batch, how many did."""
        if self.converged.ndim == 0:
            return "converged" if bool(self.converged) else "not converged"
        return f"{int(np.sum(self.converged))} of {self.converged.size} converged"

    @property
    def sd(self) -> Real:
        """Standard deviations, (..., m), SI units."""
        return frozen(np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1)), np.float64)

    @property
    def noise_sd(self) -> Real:
        """Standard deviations from the sensors' noise alone, (..., m), SI units."""
        return frozen(np.sqrt(np.diagonal(self.noise_covariance, axis1=-2, axis2=-1)), np.float64)

    @property
    def priors(self) -> tuple[Real, Real]:
        """Stated values and standard deviations of the unknowns, (m,) each, SI units; NaN if not stated."""
        stated = {name: (value, sd) for name, value, sd in self.stated}
        values, sd = np.array([stated.get(name, (np.nan, np.nan)) for name in self.names]).reshape(-1, 2).T
        return frozen(values, np.float64), frozen(sd, np.float64)

    @property
    def pulls(self) -> Real:
        """Distance of each estimate from its stated value, in standard deviations of the latter (`unknowns.pull`).

        (..., m), NaN where nothing was stated.
        """
        return frozen(pull(self.values, self.noise_sd**2, *self.priors, self.fit.tested), np.float64)

    @property
    def impacts(self) -> Real:
        """Change of each unknown for one standard deviation of another, C_ij/√C_jj, (..., m of, m by), SI units."""
        with np.errstate(divide="ignore", invalid="ignore"):  # of what is exact
            return frozen(np.nan_to_num(self.covariance / self.sd[..., None, :]), np.float64)

    @property
    def costs(self) -> tuple[Cost, ...]:
        """What each statement with an sd costs each unknown that was not stated, the largest first (no batch axes)."""
        stated = [name for name, _, _ in self.stated]
        index = {name: j for j, name in enumerate(self.names)}
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.nan_to_num(self.impacts / self.sd[:, None])
        each = [
            Cost(of, on, float(self.impacts[index[on], index[of]]), float(shares[index[on], index[of]] ** 2))
            for of in stated
            for on in self.names
            if on not in stated
        ]
        return tuple(sorted(each, key=lambda cost: -cost.share))

    def interval(self, level: float = 0.95) -> tuple[Real, Real]:
        """Lower and upper ends of the intervals at `level`, each (..., m); cut off at bounds (`bounded_interval`).

        Those of `profiles` follow χ² (`profile_interval`).  Where other minima fit nearly as well, what they make of
        each unknown counts by its odds (`other_minima`).
        """
        low, high = bounded_interval(
            self.values, self.free_values, self.sd, self.dof, self.lower, self.upper, level
        )
        for name, curve in self.profiles.items():
            j = self.names.index(name)
            low[j], high[j] = profile_interval(curve, float(self.dof[j]), level)
        others = self.other_minima
        if others is None:
            return low, high
        least, most = others.ends(self.values, self.sd, self.dof, level)
        moved = np.any(np.abs(np.array(others.values) - self.values) > self.sd, axis=0)
        return np.where(moved, np.fmin(low, least), low), np.where(moved, np.fmax(high, most), high)

    @property
    def other_minima(self) -> OtherMinima | None:
        """The warning that other sets of values fit nearly as well, with these sets, where there is one."""
        told = (each for each in self.warnings if isinstance(each, OtherMinima) and any(each.odds))
        return next(told, None)

    def __iter__(self) -> Iterator[Value]:
        """The unknowns one by one (no batch axes)."""
        columns = zip(self.values, self.sd, *self.interval(), self.bound_sd, strict=True)
        for name, unit, row in zip(self.names, self.units, columns, strict=True):
            value, sd, low, high, bound = map(float, row)
            yield Value(name, value, sd, (low, high), bound, unit)

    def __getitem__(self, name: str) -> Value:
        for value in self:
            if value.name == name:
                return value
        raise KeyError(f"{name} is not among the unknowns {', '.join(self.names)}")

    def parameters(self) -> dict[str, Value]:
        """All parameters of the rig by name: unknown, tied and known."""
        by_name = {value.name: value for value in self}
        everything = dict(by_name)
        for name, root, times, unit in self.tied:
            v = by_name[root]
            ends = sorted(times * end for end in v.interval95)
            everything[name] = Value(
                name, times * v.value, abs(times) * v.sd, (ends[0], ends[1]), abs(times) * v.bound_sd, unit
            )
        for name, number, unit in self.known:
            everything[name] = Value(name, number, 0.0, (number, number), 0.0, unit, known=True)
        return everything

    def require_unknowns(self, names: Sequence[str], others: Collection[str] | None = None) -> None:
        """Raises DataError unless its unknowns are `names`, those of a rig file, in this order.

        They may be followed by `others` in any order; by any if that is None.
        """
        rest = self.names[len(names) :]
        if self.names[: len(names)] != tuple(names) or (others is not None and not set(rest) <= set(others)):
            raise DataError(
                f"the estimate belongs to another rig: its unknowns are {', '.join(self.names)}, those "
                f"of the rig file {', '.join(names)}",
                cure="give the rig file that the estimate was made with",
            )

    def to_json(self) -> str:
        """The estimate as JSON (no batch axes); `from_json` loads it again.  Raises DataError for a batch."""
        if self.values.ndim != 1:
            raise DataError("a batch of estimates cannot be written as JSON", cure="save its arrays instead")
        return to_json(content_of(self))

    def to_dataframe(self, level: float = 0.95) -> Any:
        """A pandas DataFrame with a row for each parameter of the rig, SI units; ends of intervals at `level`.

        Raises UsageError without pandas (extra "analysis"), and for a batch.
        """
        self._require_single()
        pandas = optional_library("pandas", EXTRA, "to_dataframe")
        ends = dict(zip(self.names, zip(*self.interval(level), strict=True), strict=True))
        for name, root, times, _ in self.tied:
            ends[name] = tuple(sorted(times * end for end in ends[root]))
        rows = [
            (v.name, v.value, v.sd, *ends.get(v.name, v.interval95), v.bound_sd, v.unit, v.known)
            for v in self.parameters().values()
        ]
        columns = ["parameter", "value", "sd", "low", "high", "bound_sd", "unit", "known"]
        return pandas.DataFrame(rows, columns=columns).set_index("parameter")

    def to_uncertainties(self) -> dict[str, Any]:
        """Numbers of the package uncertainties by name, SI units, correlations kept.

        Raises UsageError without it (extra "analysis"), and for a batch.
        """
        self._require_single()
        library = optional_library("uncertainties", EXTRA, "to_uncertainties")
        values = library.correlated_values(self.values.tolist(), self.covariance.tolist(), self.names)
        numbers = dict(zip(self.names, values, strict=True))
        numbers |= {name: times * numbers[root] for name, root, times, _ in self.tied}
        return numbers | {name: value for name, value, _ in self.known}

    def to_xarray(self) -> Any:
        """An xarray Dataset of values and covariance, SI units, batch axes kept.

        Raises UsageError without xarray (extra "analysis").
        """
        xarray = optional_library("xarray", EXTRA, "to_xarray")
        repeats = [f"repeat_{axis}" for axis in range(self.values.ndim - 1)]
        names, along = list(self.names), [*repeats, "parameter"]
        return xarray.Dataset(
            {
                "value": (along, self.values),
                "sd": (along, self.sd),
                "bound_sd": (along, self.bound_sd),
                "covariance": ([*along, "other"], self.covariance),
                "converged": (repeats, self.converged),
            },
            coords={"parameter": names, "other": names, "unit": ("parameter", list(self.units))},
            attrs={"model": self.model, "method": self.method, "intervals_count": self.basis},
        )

    def _require_single(self) -> None:
        if self.values.ndim != 1:
            raise UsageError("this is a batch of estimates", cure="use to_xarray, or choose one of them")

    def carried_rig(self) -> Rig | None:
        """The rig that it was made of, or that its JSON held; None where at most the name of a rig file is known.

        Raises ModelError if the text of that rig is damaged.
        """
        if self.origin is not None or self.rig_text is None:
            return None if self.origin is None else self.origin.rig
        from dashpot.model.rigfile import parse_rig

        return parse_rig(self.rig_text, self.rig or "rig.toml")

    def to_state_space(self, rig: Any = None, **options: Any) -> StateSpace:
        """State space of `rig`, or of the rig file that the estimate names: `dashpot.state_space`."""
        return cast("StateSpace", call("state_space", self, rig, **options))

    def to_transfer_functions(self, rig: Any = None, **options: Any) -> TransferFunctions:
        """The transfer functions of its rig: `dashpot.transfer_functions`."""
        return cast("TransferFunctions", call("transfer_functions", self, rig, **options))

    def frf(self, output: str, input: str, frequencies_hz: Any, rig: Any = None) -> tuple[Any, Any]:
        """Amplitude of a channel per unit of an input, and the standard deviation of its real and imaginary parts.

        SI units; both have the shape of the frequencies (Hz).  `rig` is required if the estimate names no rig file.
        Raises UsageError if the rig has no such channel or input, and ModelError for nonlinear elements.
        """
        return cast("tuple[Any, Any]", call("estimated_frf", self, output, input, frequencies_hz, rig))

    def simulate(self, inputs: Any, rig: Any = None, **changes: Any) -> tuple[Record, ...]:
        """Response of the channels from rest, without noise, with its standard deviation (`Record.sd`).

        inputs   a Record, columns by name with `time_s`, or the name of a file; returns one Record per stretch
        changes  values to be replaced, by name, SI units, as for `with_values`

        Raises DataError if an input is missing.
        """
        return cast("tuple[Record, ...]", call("predicted_motion", self, inputs, rig, **changes))

    def cycles_at(self, amplitudes: Any, frequencies_hz: Any, rig: Any = None) -> tuple[Cycle, ...]:
        """Energy per cycle, equivalent stiffness and damping of elements in sines of each amplitude and frequency.

        amplitudes (m, or rad between angles) and frequencies (Hz) are numbers or one-dimensional.  Returns a Cycle for
        each pair, for all elements between the same ends together.  Raises UsageError unless all are above 0.
        """
        return cast("tuple[Cycle, ...]", call("cycles", self, amplitudes, frequencies_hz, rig))

    def with_values(self, **changes: Any) -> Estimate:
        """The estimate with these values, in SI units or as "9 kN/m", taken as exact and all others unchanged.

        The modes are recomputed if the rig is known.  Raises UsageError for a name that is neither an unknown nor a
        known parameter, and for a value that is not finite.
        """
        return cast("Estimate", call("with_exact_values", self, changes))

    def plot(self, level: float = 0.95, values: bool = False) -> Any:
        """A matplotlib Figure: measured against model with its band where the estimate keeps its lines.

        Else, and with `values`, the values with their intervals at `level`.
        """
        return call("plot", self, level, values)

    def report(self, path: Any, level: float = 0.95) -> str:
        """Write the report as HTML, as the command does; the name of the file.

        Of an estimate that was read from JSON it has the lines that are kept there, not what more the data showed.
        Raises UsageError for any other ending, for a batch, and if the rig is not known.
        """
        return cast(str, call("report", self, path, level))

    def export(self, path: Any, rig: Any = None, **options: Any) -> tuple[str, ...]:
        """Write it with its rig for another program, chosen by the file's ending; returns the names of the files."""
        return cast("tuple[str, ...]", call("export", self, path, rig, **options))

    @staticmethod
    def from_json(text: str, where: str = "estimate") -> Estimate:
        """The estimate written by `to_json`.  Raises DataError if the text is not one."""

        try:
            estimate = estimate_from(from_json(text))
        except KeyError as error:
            raise DataError(f"this is not a dashpot estimate ({error} is missing)", where, REMEDY) from error
        except (TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
            what = "TOML, such as a rig file" if where.endswith(".toml") else shown(str(error), 100)
            raise DataError(f"this is not a dashpot estimate ({what})", where, REMEDY) from error
        cure = "write it again with dashpot, or correct it"
        if problems := [Problem(what, where, cure) for what in _faults(estimate)]:
            raise DataError(problems)
        return estimate

    @staticmethod
    def load(path: str | Path) -> Estimate:
        """The estimate in a JSON file.  Raises DataError if there is none."""
        try:
            text = Path(noted(path)).read_text(encoding="utf-8")
        except FileNotFoundError:
            raise DataError("there is no such file", str(path), REMEDY) from None
        except IsADirectoryError:
            raise DataError("this is a folder", str(path), "name a file in it") from None
        except (OSError, UnicodeDecodeError) as error:
            raise DataError("the file cannot be read", str(path), REMEDY) from error
        return Estimate.from_json(text, str(path))


def estimate_of(
    model: Model,
    method: str,
    unknowns: Sequence[Unknown],
    values: Real,
    covariance: Real,
    batch: tuple[int, ...] = (),
    *,
    noise: Real,
    bound: Real,
    dof: Real,
    fit: Fit,
    basis: str,
    converged: Bools,
    iterations: Ints,
    history: Real,
    bounds: HeldBounds | None = None,
    modes: ModeValues | None = None,
    signs: Mapping[str, Real] | None = None,
    warnings: Sequence[Notice] = (),
    notes: Sequence[Notice] = (),
) -> Estimate:
    """The Estimate of a model by any method, from arrays of K repeats whose axis becomes the axes `batch`.

    values, dof (K, m); covariance, noise, bound (K, m, m), `bound` at the Cramér-Rao bound; converged, iterations,
    signs (K,).  `fit` has the axes `batch` already.
    """

    def shaped(part: Any) -> Any:
        return part.reshape((*batch, *part.shape[1:]))

    endless = np.full(len(unknowns), np.inf)
    return Estimate(
        model=model.name,
        method=method,
        names=tuple(unknown.name for unknown in unknowns),
        units=tuple(unknown.unit for unknown in unknowns),
        values=shaped(values),
        covariance=shaped(covariance),
        noise_covariance=shaped(noise),
        bound_sd=shaped(standard_deviations(bound)),
        dof=shaped(dof),
        lower=-endless if bounds is None else np.full(len(unknowns), bounds.lower),
        upper=endless if bounds is None else np.full(len(unknowns), bounds.upper),
        free_values=shaped(values if bounds is None else bounds.free),
        basis=basis,
        converged=shaped(converged),
        iterations=shaped(iterations),
        history=history,
        fit=fit,
        known=model.known_parameters,
        tied=model.tied_parameters,
        stated=tuple((u.name, u.prior, u.sd) for u in unknowns if u.prior is not None and u.sd is not None),
        modes=modes,
        signs={name: shaped(sign) for name, sign in (signs or {}).items()},
        warnings=tuple(warnings),
        notes=tuple(notes),
    )


# An Estimate as the content of a JSON file, and back.


MOST_COVARIANCE = 1000  # unknowns, above which the covariance is null
MOST_AMPLITUDES = 10_000  # lines times channels, above which the lines are left out: some 1.5 MB


def content_of(estimate: Estimate) -> dict[str, Any]:
    """What `Estimate.to_json` writes (no batch axes): all parameters have values, the unknowns what belongs to their
    intervals as well."""
    assessment = estimate.assessment
    lines = None if assessment is None else assessment.residuals
    if lines is not None and lines.measured.size > MOST_AMPLITUDES:
        lines = None
    entries: dict[str, dict[str, Any]] = {
        name: {
            "value": v.value,
            "sd": v.sd,
            "interval95": list(v.interval95),
            "unit": v.unit,
            "known": v.known,
            "bound_sd": v.bound_sd,
        }
        for name, v in estimate.parameters().items()
    }
    others, minima = estimate.other_minima, {}
    if (
        others is not None
    ):  # sets of values that fit nearly as well, with their odds against those of the estimate
        named = [dict(zip(estimate.names, values, strict=True)) for values in others.values]
        sets = zip(others.odds, named, strict=True)
        minima = {"other_minima": [{"odds": odds, "values": values} for odds, values in sets]}
        parts = others.parts(estimate.values, estimate.sd, estimate.dof, 0.95)
        for name, intervals in zip(estimate.names, parts, strict=True):
            entries[name]["intervals95"] = intervals
    columns = (estimate.noise_sd, estimate.dof, estimate.lower, estimate.upper, estimate.free_values)
    for j, name in enumerate(estimate.names):
        noise, dof, low, high, free = (float(column[j]) for column in columns)
        entries[name] |= {"noise_sd": noise, "interval_dof": dof}
        if math.isfinite(low) or math.isfinite(high) or free != float(estimate.values[j]):
            entries[name] |= {"min": low, "max": high, "without_limits": free}
        if name in estimate.profiles:
            at, roots = estimate.profiles[name]
            entries[name]["profile"] = {"values": list(at), "roots": list(roots)}
    statements: dict[str, Any] = {}
    if estimate.stated:
        pulls = dict(zip(estimate.names, estimate.pulls.tolist(), strict=True))
        statements = {
            "stated": [list(statement) for statement in estimate.stated],
            "pulls": {name: pulls[name] for name, _, _ in estimate.stated},
            "impacts": [asdict(cost) for cost in estimate.costs],
        }
    return {
        "dashpot": FORMAT,
        "model": estimate.model,
        **{name: text for name, text in (("rig", estimate.rig), ("rig_text", _rig_text(estimate))) if text},
        "method": estimate.method,
        "status": estimate.status,
        "iterations": int(estimate.iterations),
        "parameters": entries,
        "order": list(estimate.names),
        "covariance": _covariance_rows(estimate.covariance),
        "noise_covariance": _covariance_rows(estimate.noise_covariance),
        "intervals_count": estimate.basis,
        "tied": [list(tie) for tie in estimate.tied],
        **statements,
        "signs": {name: float(sign) for name, sign in estimate.signs.items()},
        "modes": []
        if estimate.modes is None
        else [
            {
                "frequency_hz": float(estimate.modes.frequency_hz[k]),
                "damping_ratio": float(estimate.modes.damping_ratio[k]),
                "eigenvalue": [float(value.real), float(value.imag)],
                "frequency_sd": float(estimate.modes.frequency_sd[k]),
                "damping_sd": float(estimate.modes.damping_sd[k]),
                "shape": [[float(z.real), float(z.imag)] for z in estimate.modes.shapes[k]],
            }
            for k, value in enumerate(estimate.modes.eigenvalues)
        ],
        **minima,
        **({"cycles": [asdict(cycle) for cycle in estimate.cycles]} if estimate.cycles else {}),
        "fit": {
            "chi2": float(estimate.fit.chi2),
            "dof": estimate.fit.dof,
            "p": float(estimate.fit.p),
            "known_noise": estimate.fit.known_noise,
            **({} if assessment is None else assessment.fit_content()),
        },
        "diagnosis": [] if assessment is None else [finding.content() for finding in assessment.findings],
        **({} if lines is None else {"lines": lines.content()}),
        "history": estimate.history.tolist(),
        "warnings": [str(notice) for notice in estimate.warnings],
        "codes": [notice.code for notice in estimate.warnings],
        "concerns": [list(notice.of) for notice in estimate.warnings],
        "notes": [str(notice) for notice in estimate.notes],
        "note_codes": [notice.code for notice in estimate.notes],
        "note_concerns": [list(notice.of) for notice in estimate.notes],
    }


def _rig_text(estimate: Estimate) -> str | None:
    """The rig as a rig file; None where that would not be all of it."""
    if estimate.origin is None:
        return estimate.rig_text
    from dashpot.model.rigfile import write_rig

    with suppress(ModelError):
        return write_rig(estimate.origin.rig)
    return None


def estimate_from(content: Mapping[str, Any]) -> Estimate:
    """The Estimate of such a content.  Raises what Python raises where something is missing or of a wrong type."""
    names = tuple(content["order"])
    parameters, fit = content["parameters"], content["fit"]
    unknowns = [parameters[name] for name in names]
    profiles = {}
    for name, entry in zip(names, unknowns, strict=True):
        if "profile" in entry:  # an end that is null means no limit on that side
            roots = tuple(float(root) for root in entry["profile"]["roots"])
            both = zip(entry["profile"]["values"], roots, strict=True)
            at = tuple(nullable(value, math.copysign(math.inf, root)) for value, root in both)
            profiles[name] = at, roots
    rows = content["modes"]
    modes = ModeValues(
        np.array([complex(*row["eigenvalue"]) for row in rows]),
        np.array([row["frequency_hz"] for row in rows], dtype=float),
        np.array([row["damping_ratio"] for row in rows], dtype=float),
        numbers_of([row["frequency_sd"] for row in rows]),
        numbers_of([row["damping_sd"] for row in rows]),
        np.array([[complex(*z) for z in row["shape"]] for row in rows]),
    )
    warnings = _notices(content, "warnings", "codes", "concerns")
    sets = content.get("other_minima", ())
    values = tuple(tuple(nullable(each["values"][name]) for name in names) for each in sets)
    odds = tuple(float(each["odds"]) for each in sets)
    cycles = []
    for row in content.get("cycles", ()):
        numbers = {key: nullable(row[key]) for key in row.keys() - {"elements", "between", "unit"}}
        cycles.append(Cycle(tuple(row["elements"]), tuple(row["between"]), unit=str(row["unit"]), **numbers))
    return Estimate(
        model=content["model"],
        method=content["method"],
        names=names,
        units=tuple(entry["unit"] for entry in unknowns),
        values=numbers_of([entry["value"] for entry in unknowns]),
        covariance=_covariance(content["covariance"], [entry["sd"] for entry in unknowns]),
        noise_covariance=_covariance(content["noise_covariance"], [entry["noise_sd"] for entry in unknowns]),
        bound_sd=numbers_of([entry["bound_sd"] for entry in unknowns]),
        dof=numbers_of([entry["interval_dof"] for entry in unknowns], math.inf),
        lower=numbers_of([entry.get("min") for entry in unknowns], -math.inf),
        upper=numbers_of([entry.get("max") for entry in unknowns], math.inf),
        free_values=numbers_of([entry.get("without_limits", entry["value"]) for entry in unknowns]),
        basis=content["intervals_count"],
        converged=np.asarray(content["status"] == "converged"),
        iterations=np.asarray(content["iterations"], dtype=np.int64),
        history=_rows(content["history"]),
        assessment=assessment_from(content),
        fit=Fit(
            np.asarray(nullable(fit["chi2"])),
            int(fit["dof"]),
            np.asarray(nullable(fit["p"])),
            bool(fit["known_noise"]),
        ),
        known=tuple((n, float(e["value"]), str(e["unit"])) for n, e in parameters.items() if e["known"]),
        tied=tuple((str(a), str(b), float(c), str(d)) for a, b, c, d in content["tied"]),
        modes=modes if rows else None,
        signs={name: np.asarray(float(sign)) for name, sign in content["signs"].items()},
        warnings=tuple(
            OtherMinima(each.code, each.text, each.of, values, odds)
            if sets and each.code == "not_unique"
            else each
            for each in warnings
        ),
        notes=_notices(content, "notes", "note_codes", "note_concerns"),
        rig=content.get("rig"),
        rig_text=content.get("rig_text"),
        stated=tuple((str(a), float(b), float(c)) for a, b, c in content.get("stated", ())),
        profiles=profiles,
        cycles=tuple(cycles),
    )


def _rows(rows: Sequence[Sequence[Any]]) -> Real:
    return np.array([*map(numbers_of, rows)])


def _covariance_rows(covariance: Real) -> list[list[float]] | None:
    """The rows of a covariance; None of more than MOST_COVARIANCE unknowns, whose square nobody wants in a text."""
    if len(covariance) > MOST_COVARIANCE:
        return None
    return covariance.tolist()


def _covariance(rows: Sequence[Sequence[Any]] | None, sd: Sequence[Any]) -> Real:
    """A covariance of a file; where it was left out, the variances alone."""
    return np.diag(numbers_of(sd) ** 2) if rows is None else _rows(rows)


def _notices(content: Mapping[str, Any], texts: str, codes: str, concerns: str) -> tuple[Notice, ...]:
    """Notices of a file; those of older files have texts alone, and no code."""
    sentences = content.get(texts, [])
    return tuple(
        Notice(str(code), str(text), tuple(str(name) for name in of))
        for text, code, of in zip(
            sentences,
            content.get(codes, [""] * len(sentences)),
            content.get(concerns, [()] * len(sentences)),
            strict=True,
        )
    )
