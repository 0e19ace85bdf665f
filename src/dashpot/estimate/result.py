"""The result of an identification: complete, immutable, and without a way back to the data."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, freeze
from dashpot.errors import DataError
from dashpot.estimate.assessment import Assessment
from dashpot.estimate.exports import correlated_numbers, dataframe, dataset
from dashpot.estimate.inference.intervals import bounded_interval, profile_interval
from dashpot.estimate.soundness import require_sound
from dashpot.io.json_document import from_json, to_json
from dashpot.io.ledger import noted
from dashpot.io.words import shown
from dashpot.notices import Notice
from dashpot.shorthand import Printable, call

if TYPE_CHECKING:
    from dashpot.export.state_space import StateSpace
    from dashpot.export.transfer_functions import TransferFunctions

FORMAT = "0.1"
SENSOR_NOISE, RESIDUALS, MISFIT = "sensor noise", "residuals", "model misfit"  # what intervals may rest on
SHOWN = 8  # values in the one-line form
REMEDY = "write one with dashpot identify"


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
class ModeValues:
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

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class Fit:
    """How the residuals compare with the noise.

    chi2 (...,)  χ² of the residuals against the noise that was given or measured
    dof          its degrees of freedom: real measured numbers less everything that was estimated
    p (...,)     probability of a larger χ² if the model is right
    known_noise  False where the noise was unknown: then χ² is dof by construction and p is NaN
    """

    chi2: Real
    dof: int
    p: Real
    known_noise: bool = True

    @property
    def rejected(self) -> Bools:
        """Whether residuals exceed the noise, (...,): the model, not the sensors, limits the answer."""
        return np.asarray(self.p < 1e-3)

    @property
    def misfit(self) -> Real:
        """√(χ²/dof), (...,): how many times larger than the noise the residuals are."""
        return np.sqrt(self.chi2 / max(self.dof, 1))


@dataclass(frozen=True)
class Estimate(Printable):
    """Values of the unknowns with their full covariance; every array may have leading batch axes.

    model, method       names of the rig and of the estimator
    names, units        of the unknowns, in order; gains and delays that were estimated follow as channel.gain …
    values (..., m)     estimates
    covariance          (..., m, m)
    noise_covariance    (..., m, m)  what the sensors' noise alone gives; the same unless `basis` says otherwise
    bound_sd (..., m)   standard deviations at the Cramér-Rao bound, at the estimate
    dof (..., m)        degrees of freedom of the t quantile that the intervals use
    lower, upper (m,)   bounds that the estimate was held to, ±inf where there is none
    free_values (..., m)  where it would lie without bounds, to first order; the same where none holds
    basis               what the intervals count: "sensor noise", "residuals" or "model misfit"
    converged (...,)    whether the iterations ended; where they did not, values are those of the last one
    iterations (...,)   how many there were from all starts together, 0 for closed forms
    history             start, and unknowns after each iteration of the descent that ended in the values, of the first
                        repeat, (points, unknowns): at most iterations + 1
    fit                 χ² and its p-value
    known               (name, value, unit) of the exactly known parameters
    tied                (name, unknown, times, unit) of the parameters that are a multiple of an unknown
    modes               of the estimated rig; None for batches, and for rigs of more than 400 coordinates
    signs               ±1 (...,) of the channels whose sign was found, by name
    warnings, notes     notices of the estimate, and of the data it was made from
    assessment          verdict and diagnosis, where they were made
    rig                 name of the rig file, where it came from one
    profiles            profiles (`profile_interval`) of the unknowns along which χ² is no parabola, by name
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
    profiles: Mapping[str, tuple[tuple[float, ...], tuple[float, ...]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self)

    def __repr__(self) -> str:
        """One line: method, status and values."""
        if self.values.ndim > 1:
            shape = " × ".join(map(str, self.values.shape[:-1]))
            return f"<{shape} estimates by {self.method} of {', '.join(self.names)}: {self.status}>"
        each = zip(self.names, self.values.tolist(), self.sd.tolist(), self.units, strict=True)
        values = ", ".join(_with_sd(*one) for one in list(each)[:SHOWN])
        more = f", … ({len(self.names)} in all)" if len(self.names) > SHOWN else ""
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
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def noise_sd(self) -> Real:
        """Standard deviations from the sensors' noise alone, (..., m), SI units."""
        return np.sqrt(np.diagonal(self.noise_covariance, axis1=-2, axis2=-1))

    def interval(self, level: float = 0.95) -> tuple[Real, Real]:
        """Lower and upper ends of the intervals at `level`, each (..., m); cut off at bounds (`bounded_interval`).

        Those of `profiles` follow χ² (`profile_interval`).
        """
        low, high = bounded_interval(
            self.values, self.free_values, self.sd, self.dof, self.lower, self.upper, level
        )
        for name, curve in self.profiles.items():
            j = self.names.index(name)
            low[j], high[j] = profile_interval(curve, float(self.dof[j]), level)
        return low, high

    def __iter__(self) -> Iterator[Value]:
        """The unknowns one by one (no batch axes)."""
        low, high = self.interval()
        for j, name in enumerate(self.names):
            yield Value(
                name, float(self.values[j]), float(self.sd[j]), (float(low[j]), float(high[j])),
                float(self.bound_sd[j]), self.units[j],
            )  # fmt: skip

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
        """Raises DataError where its unknowns are not these, those of a rig file, in their order.

        Behind them may stand `others`, in any order; any, where None.
        """
        rest = self.names[len(names) :]
        if self.names[: len(names)] != tuple(names) or (others is not None and not set(rest) <= set(others)):
            raise DataError(
                f"the estimate is of another rig: its unknowns are {', '.join(self.names)}, "
                f"those of the rig file {', '.join(names)}",
                cure="give the rig file that the estimate was made with",
            )

    def to_json(self) -> str:
        """The estimate as JSON (no batch axes); `from_json` loads it again.  Raises DataError for a batch."""
        if self.values.ndim != 1:
            raise DataError("a batch of estimates is not written as JSON", cure="save its arrays instead")
        from dashpot.estimate.estimate_json import content_of

        return to_json(content_of(self))

    def to_dataframe(self, level: float = 0.95) -> Any:
        """A pandas DataFrame with a row for each parameter of the rig, SI units; ends of intervals at `level`.

        Raises UsageError without pandas (extra "analysis"), and for a batch.
        """
        return dataframe(self, level)

    def to_uncertainties(self) -> dict[str, Any]:
        """Numbers of the package uncertainties by name, SI units, correlations kept.

        Raises UsageError without it (extra "analysis"), and for a batch.
        """
        return correlated_numbers(self)

    def to_xarray(self) -> Any:
        """An xarray Dataset of values and covariance, SI units, batch axes kept.

        Raises UsageError without xarray (extra "analysis").
        """
        return dataset(self)

    def to_state_space(self, rig: Any = None, **options: Any) -> StateSpace:
        """The state space of its rig, the one given or that of the rig file it names: `dashpot.state_space`."""
        return cast("StateSpace", call("state_space", self, rig, **options))

    def to_transfer_functions(self, rig: Any = None, **options: Any) -> TransferFunctions:
        """The transfer functions of its rig: `dashpot.transfer_functions`."""
        return cast("TransferFunctions", call("transfer_functions", self, rig, **options))

    def export(self, path: Any, rig: Any = None, **options: Any) -> tuple[str, ...]:
        """Write it with its rig for another program, by the end of the file's name; the names of the files."""
        return cast("tuple[str, ...]", call("export", self, path, rig, **options))

    @staticmethod
    def from_json(text: str, where: str = "estimate") -> Estimate:
        """The estimate that `to_json` wrote.  Raises DataError where the text is not one."""
        from dashpot.estimate.estimate_json import estimate_from

        try:
            estimate = estimate_from(from_json(text))
        except KeyError as error:
            raise DataError(f"this is not a dashpot estimate ({error} is missing)", where, REMEDY) from error
        except (TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
            cause = shown(str(error), 100)
            raise DataError(f"this is not a dashpot estimate ({cause})", where, REMEDY) from error
        require_sound(estimate, where)
        return estimate

    @staticmethod
    def load(path: str | Path) -> Estimate:
        """The estimate in a JSON file.  Raises DataError where there is none."""
        try:
            text = Path(noted(path)).read_text(encoding="utf-8")
        except FileNotFoundError:
            raise DataError("there is no such file", str(path), REMEDY) from None
        except IsADirectoryError:
            raise DataError("this is a folder", str(path), "name a file in it") from None
        except (OSError, UnicodeDecodeError) as error:
            raise DataError("the file cannot be read", str(path), REMEDY) from error
        return Estimate.from_json(text, str(path))
