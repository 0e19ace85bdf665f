"""The result of an identification: complete, immutable, and without a way back to the data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real, frozen
from dashpot.errors import DataError
from dashpot.estimate.assessment import Assessment, assessment_from
from dashpot.estimate.soundness import require_sound
from dashpot.io.json_document import from_json, nullable, to_json
from dashpot.io.ledger import noted
from dashpot.io.words import shown
from dashpot.notices import Notice
from dashpot.shorthand import call

FORMAT = "0.1"
SHOWN = 8  # values in the one-line form
REMEDY = "write one with dashpot identify"


@dataclass(frozen=True)
class Value:
    """One parameter: its value, standard deviation, 95 % interval and Cramér-Rao bound, in `unit`."""

    name: str
    value: float
    sd: float
    interval95: tuple[float, float]
    bound_sd: float
    unit: str
    known: bool = False


@dataclass(frozen=True)
class ModeValues:
    """Modes of the estimated rig, in order of |λ|: eigenvalues in 1/s, shapes (modes, n) with largest entry 1."""

    eigenvalues: Complex
    frequency_hz: Real
    damping_ratio: Real
    frequency_sd: Real
    damping_sd: Real
    shapes: Complex

    def __post_init__(self) -> None:
        for name in ("eigenvalues", "shapes"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.complex128))
        for name in ("frequency_hz", "damping_ratio", "frequency_sd", "damping_sd"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float64))


@dataclass(frozen=True)
class Fit:
    """χ² of the residuals against the noise that was given or measured, (...,), and its p-value.

    `known_noise` is False where the noise was unknown: then χ² is dof by construction and p is NaN.
    """

    chi2: Real
    dof: int
    p: Real
    known_noise: bool = True

    @property
    def rejected(self) -> Bools:
        """Whether the residuals are larger than the noise allows: the model, not the sensors, limits the answer."""
        return np.asarray(self.p < 1e-3)

    @property
    def misfit(self) -> Real:
        """√(χ²/dof): how many times larger than the noise the residuals are."""
        return np.sqrt(self.chi2 / max(self.dof, 1))


@dataclass(frozen=True)
class Estimate:
    """Values of the unknowns with their full covariance; every array may have leading batch axes.

    names, units        of the unknowns, in order; gains and delays that were estimated follow as channel.gain …
    values (..., m)     estimates
    covariance          (..., m, m)
    noise_covariance    (..., m, m)  what the sensors' noise alone gives; the same unless `basis` says otherwise
    bound_sd (..., m)   standard deviations at the Cramér-Rao bound, at the estimate
    dof (..., m)        degrees of freedom of the t quantile that the intervals use
    lower, upper (m,)   bounds that the estimate was held to, ±inf where there is none
    free_values (..., m)  where it would lie without bounds, to first order; the same where none holds
    basis               what the intervals count: "sensor noise", "residuals" or "model misfit"
    known               (name, value, unit) of the exactly known parameters
    tied                (name, unknown, times, unit) of the parameters that are a multiple of an unknown
    signs               ±1 of the channels whose sign was found
    warnings, notes     notices of the estimate, and of the data it was made from
    assessment          verdict and diagnosis, where they were made
    rig                 name of the rig file, where it came from one
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

    def __post_init__(self) -> None:
        fields = ("values", "covariance", "noise_covariance", "bound_sd", "dof", "history", "lower", "upper")
        for name in (*fields, "free_values"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float64))

    def __repr__(self) -> str:
        """One line: method, status and values."""
        if self.values.ndim > 1:
            shape = " × ".join(map(str, self.values.shape[:-1]))
            return f"<{shape} estimates by {self.method} of {', '.join(self.names)}: {self.status}>"
        values = ", ".join(
            f"{name} = {value:.4g} ± {sd:.2g}{'' if unit == '1' else ' ' + unit}"
            for name, value, sd, unit in list(
                zip(self.names, self.values.tolist(), self.sd.tolist(), self.units, strict=True)
            )[:SHOWN]
        )
        more = f", … ({len(self.names)} in all)" if len(self.names) > SHOWN else ""
        return f"<Estimate by {self.method}, {self.status}: {values}{more}>"

    def __str__(self) -> str:
        """What the command prints."""
        return cast(str, call("text", self))

    def _repr_html_(self) -> str:
        """The same as HTML, for a notebook."""
        return cast(str, call("html", self))

    def plot(self, level: float = 0.95) -> Any:
        """A matplotlib Figure of the values with their intervals."""
        return call("plot", self, level)

    @property
    def status(self) -> str:
        """ "converged" or "not converged"; of a batch, how many did."""
        if self.converged.ndim == 0:
            return "converged" if bool(self.converged) else "not converged"
        return f"{int(np.sum(self.converged))} of {self.converged.size} converged"

    @property
    def sd(self) -> Real:
        """Standard deviations, (..., m)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def noise_sd(self) -> Real:
        """Standard deviations from the sensors' noise alone, (..., m)."""
        return np.sqrt(np.diagonal(self.noise_covariance, axis1=-2, axis2=-1))

    def interval(self, level: float = 0.95) -> tuple[Real, Real]:
        """Lower and upper ends of the intervals, each (..., m).

        Where an unknown has bounds, the interval is that of the free estimate, cut off at them: what it holds of the
        allowed values it held before, so its coverage is kept.  Where the free estimate lies beyond a bound, the cut
        interval would shrink to nothing; there its far end is that of the distribution truncated at the bound, which
        passes into the other one smoothly.  The interval always holds the value.
        """
        from scipy.special import stdtrit  # scipy.stats costs half a second of start-up

        half = stdtrit(self.dof, 0.5 + level / 2) * self.sd
        low, high = self.free_values - half, self.free_values + half
        if np.any(np.isfinite(self.lower) | np.isfinite(self.upper)):
            reach = self.sd * _truncated_reach((self.lower - self.free_values) / self.sd, self.dof, level)
            high = np.where(self.free_values < self.lower, self.free_values + reach, high)
            reach = self.sd * _truncated_reach((self.free_values - self.upper) / self.sd, self.dof, level)
            low = np.where(self.free_values > self.upper, self.free_values - reach, low)
            low, high = np.clip(low, self.lower, self.upper), np.clip(high, self.lower, self.upper)
            low, high = np.minimum(low, self.values), np.maximum(high, self.values)
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
        found = {value.name: value for value in self}
        everything = dict(found)
        for name, root, times, unit in self.tied:
            v = found[root]
            ends = sorted(times * end for end in v.interval95)
            everything[name] = Value(
                name, times * v.value, abs(times) * v.sd, (ends[0], ends[1]), abs(times) * v.bound_sd, unit
            )
        for name, number, unit in self.known:
            everything[name] = Value(name, number, 0.0, (number, number), 0.0, unit, known=True)
        return everything

    def to_json(self) -> str:
        """The estimate as JSON (no batch axes); `from_json` loads it again."""
        if self.values.ndim != 1:
            raise DataError("a batch of estimates is not written as JSON", cure="save its arrays instead")
        noise = dict(zip(self.names, self.noise_sd.tolist(), strict=True))
        dof = dict(zip(self.names, self.dof.tolist(), strict=True))
        limits = {
            name: {"min": float(low), "max": float(high), "without_limits": float(free)}
            for name, value, low, high, free in zip(
                self.names, self.values, self.lower, self.upper, self.free_values, strict=True
            )
            if np.isfinite(low) or np.isfinite(high) or free != value
        }
        parameters = {}
        for name, v in self.parameters().items():
            entry: dict[str, Any] = {
                "value": v.value, "sd": v.sd, "interval95": list(v.interval95), "unit": v.unit, "known": v.known,
                "bound_sd": v.bound_sd,
            }  # fmt: skip
            if name in noise:
                entry |= {"noise_sd": noise[name], "interval_dof": dof[name]}
            if name in limits:
                entry |= limits[name]
            parameters[name] = entry
        content = {
            "dashpot": FORMAT,
            "model": self.model,
            **({} if self.rig is None else {"rig": self.rig}),
            "method": self.method,
            "status": self.status,
            "iterations": int(self.iterations),
            "parameters": parameters,
            "order": list(self.names),
            "covariance": self.covariance.tolist(),
            "noise_covariance": self.noise_covariance.tolist(),
            "intervals_count": self.basis,
            "tied": [list(tie) for tie in self.tied],
            "signs": {name: float(sign) for name, sign in self.signs.items()},
            "modes": [] if self.modes is None else _mode_rows(self.modes),
            "fit": {
                "chi2": float(self.fit.chi2), "dof": self.fit.dof, "p": float(self.fit.p),
                "known_noise": self.fit.known_noise,
                **({} if self.assessment is None else self.assessment.fit_content()),
            },
            "diagnosis": [] if self.assessment is None else [f.content() for f in self.assessment.findings],
            "history": self.history.tolist(),
            "warnings": [str(notice) for notice in self.warnings],
            "codes": [notice.code for notice in self.warnings],
            "concerns": [list(notice.of) for notice in self.warnings],
            "notes": [str(notice) for notice in self.notes],
            "note_codes": [notice.code for notice in self.notes],
            "note_concerns": [list(notice.of) for notice in self.notes],
        }  # fmt: skip
        return to_json(content)

    @staticmethod
    def from_json(text: str, where: str = "estimate") -> Estimate:
        """The estimate that `to_json` wrote.  Raises DataError where the text is not one."""
        try:
            estimate = _loaded(from_json(text))
        except KeyError as error:
            raise DataError(f"this is no estimate of dashpot ({error} is missing)", where, REMEDY) from error
        except (TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
            cause = shown(str(error), 100)
            raise DataError(f"this is no estimate of dashpot ({cause})", where, REMEDY) from error
        require_sound(estimate, where)
        return estimate

    @staticmethod
    def load(path: str | Path) -> Estimate:
        """The estimate in a JSON file.  Raises DataError where there is none."""
        try:
            text = Path(noted(path)).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise DataError("the file cannot be read", str(path), REMEDY) from error
        return Estimate.from_json(text, str(path))


def _truncated_reach(beyond: Real, dof: Real, level: float) -> Real:
    """How far from its centre a standard t distribution cut off at `beyond` > 0 holds `level` of what is left."""
    from scipy.special import stdtr, stdtrit

    beyond = np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0)
    left = (1 - level) * stdtr(dof, -beyond)
    with np.errstate(all="ignore"):
        reach = -stdtrit(dof, left)
    return np.where(np.isfinite(reach), np.maximum(reach, beyond), beyond)


def _mode_rows(modes: ModeValues) -> list[dict[str, Any]]:
    rows = []
    for k in range(len(modes.eigenvalues)):
        rows.append(
            {
                "frequency_hz": float(modes.frequency_hz[k]),
                "damping_ratio": float(modes.damping_ratio[k]),
                "eigenvalue": [float(modes.eigenvalues[k].real), float(modes.eigenvalues[k].imag)],
                "frequency_sd": float(modes.frequency_sd[k]),
                "damping_sd": float(modes.damping_sd[k]),
                "shape": [[float(z.real), float(z.imag)] for z in modes.shapes[k]],
            }
        )
    return rows


def _loaded(content: Mapping[str, Any]) -> Estimate:
    order = tuple(content["order"])
    parameters = content["parameters"]
    rows = content["modes"]
    tied = tuple((str(a), str(b), float(c), str(d)) for a, b, c, d in content["tied"])
    modes = ModeValues(
        np.array([complex(*row["eigenvalue"]) for row in rows]),
        np.array([row["frequency_hz"] for row in rows], dtype=float),
        np.array([row["damping_ratio"] for row in rows], dtype=float),
        np.array([nullable(row["frequency_sd"]) for row in rows]),
        np.array([nullable(row["damping_sd"]) for row in rows]),
        np.array([[complex(*z) for z in row["shape"]] for row in rows]),
    )
    fit = content["fit"]
    return Estimate(
        model=content["model"],
        method=content["method"],
        names=order,
        units=tuple(parameters[name]["unit"] for name in order),
        values=np.array([nullable(parameters[name]["value"]) for name in order]),
        covariance=np.array([[nullable(v) for v in row] for row in content["covariance"]]),
        noise_covariance=np.array([[nullable(v) for v in row] for row in content["noise_covariance"]]),
        bound_sd=np.array([nullable(parameters[name]["bound_sd"]) for name in order]),
        dof=np.array([nullable(parameters[name]["interval_dof"], math.inf) for name in order]),
        lower=np.array([nullable(parameters[name].get("min"), -math.inf) for name in order]),
        upper=np.array([nullable(parameters[name].get("max"), math.inf) for name in order]),
        free_values=np.array(
            [nullable(parameters[name].get("without_limits", parameters[name]["value"])) for name in order]
        ),
        basis=content["intervals_count"],
        converged=np.asarray(content["status"] == "converged"),
        iterations=np.asarray(content["iterations"], dtype=np.int64),
        history=np.array([[nullable(v) for v in row] for row in content["history"]]),
        assessment=assessment_from(fit, content.get("diagnosis", [])),
        rig=content.get("rig"),
        fit=Fit(
            np.asarray(nullable(fit["chi2"])),
            int(fit["dof"]),
            np.asarray(nullable(fit["p"])),
            bool(fit["known_noise"]),
        ),
        known=tuple((n, float(e["value"]), str(e["unit"])) for n, e in parameters.items() if e["known"]),
        tied=tied,
        modes=modes if rows else None,
        signs={name: np.asarray(float(sign)) for name, sign in content["signs"].items()},
        warnings=_notices(content, "warnings", "codes", "concerns"),
        notes=_notices(content, "notes", "note_codes", "note_concerns"),
    )


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
