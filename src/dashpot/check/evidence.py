"""What data say besides the values of an estimate: collinearity, profiles, what errors of known parameters do."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dashpot.arrays import Frozen, Real
from dashpot.channel import Channel
from dashpot.check.identifiability import structure
from dashpot.check.profile import Profile, Surface, chi2_surface, profile
from dashpot.check.residuals import (
    DwellHistory,
    FrequencyResponse,
    dwell_histories,
    residuals_of,
    responses_of_channels,
)
from dashpot.check.validation import RecordPrediction, validate
from dashpot.data.conditioning.lines import UsedDwell
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError, DataError, IdentifiabilityError, UsageError
from dashpot.estimate.assessment import Residuals
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.objective import local, measured
from dashpot.estimate.method import Method
from dashpot.estimate.preparation import prepare
from dashpot.estimate.result import Estimate
from dashpot.io.words import listed
from dashpot.model.network import Model
from dashpot.model.observation import observation_model
from dashpot.numerics.small_systems import solve_scaled

# Which parameters are in doubt: intervals tell little of them, or the channels cannot determine them.


def doubtful(estimate: Estimate, level: float = 0.95) -> tuple[str, ...]:
    """Names of the unknowns whose interval at `level` reaches further than half their value to a side.

    All of them where the iteration did not converge (no batch axes).
    """
    if not bool(estimate.converged):
        return estimate.names
    low, high = estimate.interval(level)
    half = np.maximum(high - estimate.values, estimate.values - low)
    with np.errstate(invalid="ignore"):
        good = half <= 0.5 * np.abs(estimate.values)  # half an interval over the value
    return tuple(name for name, kept in zip(estimate.names, good.tolist(), strict=True) if not kept)


def undetermined(model: Model, channels: Sequence[Channel]) -> tuple[str, ...]:
    """Names of the unknowns that no data of these channels can determine.

    None where the rig has no steady response, or is nonlinear: ranks contain no information on those.
    """
    if not model.unknowns or not channels or len(model.nonlinear):
        return ()
    try:
        judged = structure(model, channels)
    except IdentifiabilityError:
        return ()
    return tuple(dict.fromkeys(name for part in judged.deficiencies for name in part.names))


# Collinearity in the data at hand: combinations of unknowns that widen the intervals, and lines that carry
# nothing.
#
# The correlation-scaled information has eigenvalues; a small one belongs to a combination that is hardly
# seen, and adds 1/eigenvalue to the variance of what takes part in it (Belsley, Kuh and Welsch 1980,
# chapter 3).


WEAK = 10.0  # times the interval is wider, from which a combination is told


@dataclass(frozen=True)
class Combination(Frozen):
    """A combination of unknowns that the data hardly see.

    names: those that have at least half of their variance from it; direction (names,): relative changes (δθ/θ, s for
    delays), the largest 1; spread: relative standard deviation along it; widening (names,): factor by which the
    interval is wider than were all other unknowns known; best: the unknown whose value would help most, and
    narrowing: what remains of the intervals of `names` then (mean of the factors).
    """

    names: tuple[str, ...]
    direction: Real
    spread: float
    widening: Real
    best: str
    narrowing: float


@dataclass(frozen=True)
class Collinearity(Frozen):
    """Weak combinations, the weakest first, and what each line contributes.

    shares (lines, M): part of the information on each unknown (tr C I_l, unknown by unknown; a column sums to 1, less
    what priors tell); idle: lines that carry nothing for any unknown.
    """

    names: tuple[str, ...]
    combinations: tuple[Combination, ...]
    shares: Real
    idle: tuple[int, ...]


def collinearity(base: Surface, covariance: Real) -> Collinearity:
    """What the first repeat of a surface determines badly; `covariance` (M, M) is the estimate's.

    Combinations count that inflate an interval tenfold or more over what it were with all other unknowns known.
    Raises IdentifiabilityError if nothing is known of an unknown, or the information is not a finite number.
    """
    total = np.sum(base.information, axis=0) + np.diag(base.view.prior_precision)
    known = np.all(np.isfinite(total), axis=-1) & (np.diagonal(total) > 0)
    if not np.all(known):
        lost = [name for name, fine in zip(base.view.names, known, strict=True) if not fine]
        raise IdentifiabilityError(
            f"at the estimated values the data contain no information on {listed(lost)}",
            cure="check units and signs of the channels, or state values",
        )
    sd = np.sqrt(np.diagonal(total))
    values, vectors = np.linalg.eigh(total / np.outer(sd, sd))
    values = np.maximum(values, 1e-15)
    combinations = _combinations(base, covariance, sd, values, vectors)
    # Part of each line (lines, M, M) in the information on each unknown, (lines, M)
    scale = np.outer(sd, sd)
    C = np.diag(1 / sd**2) if values[0] <= 1e-14 else np.linalg.inv(total / scale) / scale
    shares = np.einsum("jk,lki,ij->lj", C, base.information, C) / np.diagonal(C)
    lines = len(shares)
    # 0.01 of an even share of the information below which a line carries nothing
    idle = tuple(int(line) for line in np.flatnonzero(np.all(shares < 0.01 / lines, axis=1)))
    return Collinearity(base.view.names, combinations, shares, idle)


def _combinations(
    base: Surface, covariance: Real, sd: Real, values: Real, vectors: Real
) -> tuple[Combination, ...]:
    """From eigenvalues (M,) and vectors (M, M) of the information scaled by `sd` (M,)."""
    names = base.view.names
    parts = vectors**2 / values  # of the variance of each unknown, (unknowns, combinations)
    inflation = np.sum(parts, axis=1)
    portion = parts / inflation[:, None]
    spread = np.sqrt(np.diagonal(covariance) / (inflation / sd**2))  # what the noise basis multiplies
    delays = np.arange(len(names)) >= len(names) - base.view.delays
    size = np.where(delays | (base.psi == 0), 1.0, np.abs(base.psi))
    combinations = []
    for k in np.argsort(values, kind="stable"):
        if values[k] * WEAK**2 > 1:
            break
        # 0.5 of a variance that a combination must make up for an unknown to be named with it
        members = np.flatnonzero((portion[:, k] > 0.5) & (inflation > WEAK**2))
        if not len(members):
            continue
        relative = (vectors[:, k] / sd / size * np.where(base.psi < 0, -1, 1))[members]
        peak = relative[np.argmax(np.abs(relative))]
        # The unknown whose value would narrow the intervals most, and the mean remaining factor of the others
        variance = np.diagonal(covariance)
        best, narrowing = int(members[0]), np.inf
        for i in members:
            left = variance[members] - covariance[members, i] ** 2 / variance[i]
            factor = np.sqrt(np.maximum(left, 0.0) / variance[members])
            others = factor[members != i]
            mean = float(np.mean(others)) if len(others) else 0.0
            if mean < narrowing:
                best, narrowing = int(i), mean
        along = float(abs(peak) / np.sqrt(values[k]) * np.mean(spread[members]))
        combinations.append(
            Combination(
                tuple(names[i] for i in members), relative / peak, along, np.sqrt(inflation[members]), names[best],
                narrowing,
            )
        )  # fmt: skip
    return tuple(combinations)


def shares_by_band(found: Collinearity, frequency_hz: Real, most: int = 120) -> tuple[Real, Real]:
    """Middles (bands,), Hz, and shares (bands, M) in the order of frequency; lines of one frequency are one band.

    Neighbouring frequencies are added up where there are more than `most`.
    """
    unique, place = np.unique(frequency_hz, return_inverse=True)
    each = max(1, -(-len(unique) // most))
    bands = np.zeros((-(-len(unique) // each), len(found.names)))
    np.add.at(bands, place // each, found.shares)
    middles = np.array([float(np.median(unique[k * each : (k + 1) * each])) for k in range(len(bands))])
    return middles, bands


# What a spectrum or a record holds, channel by channel.


@dataclass(frozen=True)
class ChannelSummary:
    """Amplitudes of one channel in `unit`: smallest, largest, and the median of the noise; NaN where not measured."""

    name: str
    low: float
    high: float
    noise: float
    typical: float
    unit: str

    @property
    def measured(self) -> bool:
        """Whether there is any amplitude of it."""
        return bool(np.isfinite(self.high))


def channel_summaries(spectrum: Spectrum, units: Sequence[str]) -> tuple[ChannelSummary, ...]:
    """Range of |X| over lines and repeats, median amplitude and median sd of each channel; SI units by channel."""
    magnitude, sd = np.abs(spectrum.amplitudes), np.broadcast_to(spectrum.sd(), spectrum.amplitudes.shape)
    summaries = []
    for i, channel in enumerate(spectrum.channels):
        size, noise = magnitude[..., i], sd[..., i]
        finite = np.isfinite(size)
        if not np.any(finite):
            numbers = (np.nan,) * 4
        else:
            shown = size[finite]
            numbers = (np.min(shown), np.max(shown), np.median(noise[finite]), np.median(shown))
        low, high, typical_noise, typical = map(float, numbers)
        summaries.append(ChannelSummary(channel.name, low, high, typical_noise, typical, units[i]))
    return tuple(summaries)


def span_of(record: Record) -> tuple[float, float]:
    """Duration, s, and mean sampling rate, Hz (NaN of a single sample)."""
    duration = float(record.time[-1] - record.time[0])
    return duration, (len(record.time) - 1) / duration if duration > 0 else np.nan


@dataclass(frozen=True)
class DataFindings:
    """An estimate and what was asked of the data; `known_errors` None where it was not asked."""

    estimate: Estimate
    collinearity: Collinearity
    profiles: tuple[Profile, ...]
    known_errors: KnownErrors | None


def data_findings(
    model: Model, spectrum: Spectrum, estimate: Estimate, profiled: Sequence[str], level: float, known: bool
) -> DataFindings:
    """Collinearity, the profiles of the unknowns `profiled` at `level` and, with `known`, what known errors do.

    Raises UsageError if there is no such unknown, IdentifiabilityError if nothing is known of one.
    """
    return DataFindings(
        estimate,
        collinearity(chi2_surface(model, spectrum, estimate), estimate.covariance),
        tuple(profile(model, spectrum, name, level, estimate) for name in profiled),
        known_errors(model, spectrum, estimate) if known else None,
    )


# The same as plain content for JSON: numbers, texts, lists and tables; None for what is not finite.


def findings_content(found: DataFindings, spectrum: Spectrum) -> dict[str, Any]:
    """What data say, each part that was asked for."""
    content: dict[str, Any] = {"data": collinearity_content(found.collinearity, spectrum)}
    if found.profiles:
        content["profiles"] = [profile_content(entry) for entry in found.profiles]
    if found.known_errors is not None:
        content["known_errors"] = known_content(found.known_errors)
    return content


def collinearity_content(found: Collinearity, spectrum: Spectrum) -> dict[str, Any]:
    """Weak combinations and what each line contributes."""
    return {
        "weak_combinations": [
            {
                "unknowns": dict(zip(entry.names, entry.direction.tolist(), strict=True)),
                "relative_sd": entry.spread,
                "widening": dict(zip(entry.names, entry.widening.tolist(), strict=True)),
                "best_to_know": entry.best,
                "intervals_then": entry.narrowing,
            }
            for entry in found.combinations
        ],
        "lines": [
            {
                "frequency_hz": float(f),
                "shares": dict(zip(found.names, row, strict=True)),
                "idle": line in found.idle,
            }
            for line, (f, row) in enumerate(zip(spectrum.frequency_hz, found.shares.tolist(), strict=True))
        ],
    }


def profile_content(found: Profile) -> dict[str, Any]:
    """Both intervals of one unknown and the curve; an end that does not exist is null (no batch axes)."""
    return {
        "name": found.name,
        "unit": found.unit,
        "level": found.level,
        "value": found.value,
        "interval": [found.lower, found.upper],
        "normal_interval": [found.normal_lower, found.normal_upper],
        "normal_misleads": found.misleads,
        "better_fit_met": found.improved,
        "curve": [[x, y] for x, y in zip(found.points.tolist(), found.rise.tolist(), strict=True)],
    }


def known_content(found: KnownErrors) -> dict[str, Any]:
    """Per cent of each unknown for one per cent of each known parameter, and the slopes themselves."""
    return {
        "percent_per_percent": {
            name: dict(zip(found.unknowns, row, strict=True))
            for name, row in zip(found.known, found.relative.tolist(), strict=True)
        },
        "slopes": {
            name: dict(zip(found.unknowns, row, strict=True))
            for name, row in zip(found.known, found.slopes.tolist(), strict=True)
        },
    }


@dataclass(frozen=True)
class Evidence:
    """What the data say of an estimate besides its values; None or empty where it cannot be said.

    responses   output over input, of the channels where such can be formed
    records     whole records as the estimate predicts them from their inputs
    dwells      some of the dwells behind the lines, in time
    profiles    of the unknowns whose intervals follow χ²
    """

    residuals: Residuals | None = None
    collinearity: Collinearity | None = None
    responses: tuple[FrequencyResponse, ...] = ()
    records: tuple[RecordPrediction, ...] = ()
    dwells: tuple[DwellHistory, ...] = ()
    profiles: tuple[Profile, ...] = ()


def evidence_of(
    model: Model,
    spectrum: Spectrum | None,
    estimate: Estimate,
    level: float = 0.95,
    dwells: Sequence[UsedDwell] = (),
    channels: Sequence[Channel] = (),
) -> Evidence:
    """The evidence of an estimate (no batch axes); `dwells` are those that the spectrum's lines come from.

    Without a spectrum it is what the estimate keeps of its lines, which are of some of the `channels`.
    """
    if spectrum is None:
        kept = None if estimate.assessment is None else estimate.assessment.residuals
        named = {channel.name: channel for channel in channels}
        if kept is None or not named.keys() >= {*kept.channels}:
            return Evidence()
        return Evidence(
            kept,
            responses=responses_of_channels(model, estimate, [named[name] for name in kept.channels], kept),
        )
    left, weak = residuals_of(model, spectrum, estimate), None
    records, profiles = tuple[RecordPrediction, ...](), tuple[Profile, ...]()
    with suppress(DashpotError):  # of some rigs nothing is said of single lines
        weak = collinearity(chi2_surface(model, spectrum, estimate), estimate.covariance)
    if spectrum.records and not len(model.nonlinear):
        with suppress(DataError):
            records = tuple(part for part in validate(model, estimate, spectrum) if part.samples)
    # Profiles of the unknowns whose intervals follow χ², so that a report shows one interval of each
    with suppress(DashpotError):
        profiles = tuple(profile(model, spectrum, name, level, estimate) for name in estimate.profiles)
    responses = responses_of_channels(model, estimate, spectrum.channels, left)
    return Evidence(left, weak, responses, records, tuple(dwell_histories(dwells, left)), profiles)


# What errors of the known parameters do to the estimates (the paper's complaint about its own method, answered).
#
# At the estimate the slope of χ² is zero, g(θ̂, p) = 0; a known parameter that is wrong by δp moves θ̂ by
# −(∂g/∂θ)⁻¹ (∂g/∂p) δp.  Both slopes are taken of g itself, not of its Gauss-Newton part: residuals count.

STEP = 1e-4  # of a parameter, in differences of the slope and between identifications


@dataclass(frozen=True)
class KnownErrors(Frozen):
    """dθ̂/dp of each unknown by each known parameter, (known, unknowns), in their units.

    Known exactly (`stated` NaN) or with a standard deviation (`stated`), whose value then counts as the prior's.
    """

    known: tuple[str, ...]
    known_values: Real
    stated: Real
    unknowns: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    slopes: Real

    @property
    def relative(self) -> Real:
        """Change of each unknown in per cent for 1 % of each known parameter, (known, unknowns)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            change: Real = self.slopes * self.known_values[:, None] / self.values
        return change


def known_errors(
    model: Model, spectrum: Spectrum, estimate: Estimate, method: Method | None = None
) -> KnownErrors:
    """How errors of the known parameters move the estimate of one spectrum (no batch axes).

    For methods that do not sit on the bound (`method`, as given to `identify`) the slopes are differences between two
    identifications for each known parameter.  Raises UsageError if nothing is known.
    """
    exact = [e for e in model.elements if e.value is not None and e.sd is None and e.value != 0]
    view = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment)
    uncertain = [u for u in view.unknowns if u.sd is not None]
    if not exact and not uncertain:
        raise UsageError(
            "no parameter of the rig is known", cure="errors of known parameters cannot be propagated"
        )
    rows: list[tuple[str, float | None, float | None]] = [
        *((e.name, e.value, np.nan) for e in exact),
        *((u.name, u.prior, u.sd) for u in uncertain),
    ]
    known, values, stated = zip(*rows, strict=True)
    chosen = automatic(model, spectrum) if method is None else method
    if chosen.traits.maximum_likelihood:
        slopes = _from_slopes(model, spectrum, estimate, known[: len(exact)], known[len(exact) :])
    else:
        repeated = []
        for name in known:  # from two identifications
            ends, value = [], next(e.value for e in model.elements if e.name == name)
            assert value is not None
            for sign in (1.0, -1.0):
                elements = tuple(
                    replace(e, value=value * (1 + sign * STEP)) if e.name == name else e
                    for e in model.elements
                )
                ends.append(identify(replace(model, elements=elements), spectrum, chosen).values)
            repeated.append((ends[0] - ends[1]) / (2 * STEP * value))
        slopes = np.array(repeated)
    sizes, spread = np.array(values, dtype=float), np.array(stated, dtype=float)
    return KnownErrors(known, sizes, spread, estimate.names, estimate.units, estimate.values, slopes)


def _from_slopes(
    model: Model, spectrum: Spectrum, estimate: Estimate, exact: tuple[str, ...], uncertain: tuple[str, ...]
) -> Real:
    base = chi2_surface(model, spectrum, estimate)
    freed = replace(
        model, elements=tuple(replace(e, value=None) if e.name in exact else e for e in model.elements)
    )
    prepared = prepare(freed, spectrum)
    view = prepared.view
    # What whole records and nonlinear elements add follows the freed rig; the weights are those of the fit.
    data = replace(measured(prepared), W=base.data.W, root=base.data.root)
    values = {e.name: e.value for e in model.elements} | dict(zip(base.view.names, base.psi, strict=True))
    psi = np.array([values[name] for name in view.names], dtype=float)
    size = np.where(psi == 0, 1.0, np.abs(psi))
    delays = np.arange(len(psi)) >= len(psi) - view.delays
    step = STEP * np.where(delays, 1 / np.max(view.omega), size)
    moved = np.concatenate([psi + np.diag(step), psi - np.diag(step)])
    sign = np.repeat(base.sign[None], len(moved), axis=0)
    gradient = local(view, data, moved, sign).gradient
    curvature = -(gradient[: len(psi)] - gradient[len(psi) :]) / (2 * step[:, None])  # [by, of]
    index = {name: i for i, name in enumerate(view.names)}
    columns = [index[name] for name in base.view.names]
    H = curvature[columns][:, columns]
    H = (H + H.T) / 2
    sides = [-curvature[index[name]][columns] for name in exact]
    for name in uncertain:
        j = base.view.names.index(name)
        side = np.zeros(len(columns))
        side[j] = base.view.prior_precision[j]
        sides.append(side)
    return np.array([solve_scaled(H, side) for side in sides])
