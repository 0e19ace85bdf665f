"""Releases of a rig that nothing drives: where to hold it, how far, how long to record, and which releases together.

A release from a hold at one coordinate begins with the static shape under a force there.  With white noise σ_c in every
sample the information on θ is Jᵀ W (1 − P) J: slopes J of the samples along θ, weighted by W = σ⁻², without what the
2 n unknown states at the start (columns S, P their projection) could make of them.  Informations of releases add.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from dashpot.arrays import Bools, Frozen, Ints, Real
from dashpot.channel import Channel
from dashpot.errors import IdentifiabilityError, UsageError
from dashpot.model.dynamics import matrices
from dashpot.model.modes import eigenmodes
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, noise_sd, observation_model
from dashpot.numerics.small_systems import scaled_inverse

DEFLECTION = 0.01  # m or rad, of the point that moves most, where nothing is said
MOST_TOGETHER = 3  # releases that are planned together
ENOUGH = 1.02  # times the least uncertainty: a longer record, or one more release, is not worth less


@dataclass(frozen=True)
class Release:
    """A release: the coordinate that is held, its deflection and the largest of all (m or rad), s to record."""

    hold: str
    deflection: float
    largest: float
    record_s: float
    figure: float


@dataclass(frozen=True)
class ReleasePlan(Frozen):
    """What is advised.

    releases   one from each coordinate by itself, the best first
    together   the releases to make, by name of the coordinate
    names, units, values, sd  of the unknowns, from these together
    figure     what was made small: the rms (or largest) relative standard deviation of the unknowns that were asked for
    rate_hz    of the samples; notes: what was assumed
    """

    model: Model
    releases: tuple[Release, ...]
    together: tuple[Release, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    sd: Real
    figure: float
    rate_hz: float
    notes: tuple[str, ...]

    def content(self) -> dict[str, object]:
        """As plain content for JSON."""
        entries = zip(self.names, self.units, self.values.tolist(), self.sd.tolist(), strict=True)
        return {
            "releases": [vars(each) for each in self.releases],
            "together": [vars(each) for each in self.together],
            "predicted": {
                name: {
                    "value": value,
                    "sd": sd,
                    "relative_sd": abs(sd / value) if value else None,
                    "unit": unit,
                }
                for name, unit, value, sd in entries
            },
            "figure": self.figure,
            "rate_hz": self.rate_hz,
            "notes": list(self.notes),
        }


def plan_releases(
    model: Model,
    channels: Sequence[Channel],
    values: Mapping[str, float],
    *,
    names: Sequence[str] = (),
    worst: bool = False,
    deflection: float | None = None,
    rate_hz: float | None = None,
    time_s: float | None = None,
    target: float | None = None,
) -> ReleasePlan:
    """The releases to make, at values of the unknowns by name (else guesses of the rig).

    names       of the unknowns that should be precise; all where there are none; `worst`: the worst of them
    deflection  of the point that moves most; without one DEFLECTION, or for a `target` (rms relative sd) what it takes
    time_s      of all recordings together; without one, as long as recording is worth it

    Raises UsageError for a nonlinear rig, one without unknowns and an unknown name, IdentifiabilityError if no
    release determines the unknowns, ModelError if the rig has no motion in time.
    """
    _require_plannable(model, names)
    notes: list[str] = []
    theta = model.theta(values)
    p = model.parameters(theta)
    found = eigenmodes(model, p).eigenvalues
    fastest = float(np.max(np.abs(found))) / (2 * np.pi)
    rates = [channel.rate for channel in channels if channel.rate is not None]
    rate = rate_hz or min(rates, default=0.0)
    if not rate:
        rate = float(f"{20 * fastest:.2g}")  # of the fastest mode
        notes.append(f"no sampling rate is stated: {rate:g} Hz, 20 samples per period, is assumed")
    unit = "rad" if set(model.coordinates) <= model.angles else "m"
    if deflection is None and target is None:
        notes.append(
            f"no deflection is stated: {DEFLECTION:g} {unit} at the point that moves most is assumed (--stroke)"
        )
    slowest = float(np.min(np.abs(found[np.abs(found) > 0]), initial=np.inf))
    decay = float(np.min(-found.real[found.real < -1e-9 * np.abs(found)], initial=np.inf))
    # Until the slowest decay is at 1e-4, two hundred periods where it barely decays, or not at all
    longest = min(np.log(1e4) / decay if np.isfinite(decay) else np.inf, 200 * 2 * np.pi / slowest)
    samples = max(int(min(longest * rate, 40_000)), 4 * model.n + 4)
    ends = np.geomspace(min(4 * model.n + 4, samples), samples, 24).astype(int)
    if time_s is not None:
        shared = (rate * time_s / np.arange(1, MOST_TOGETHER + 1)).astype(int)
        ends = np.concatenate([ends, np.clip(shared, 1, samples)])
    asked = np.isin(model.unknown_names, names or model.unknown_names)
    silent = [channel.name for channel in channels if not channel.noise and not channel.relative_noise]
    if silent:
        which = "no channel" if len(silent) == len(channels) else f"{', '.join(silent)} nowhere"
        notes.append(f"{which} states its noise: 1 % of the largest value is assumed")
    noisy = [replace(c, relative_noise=0.01) if c.name in silent else c for c in channels]
    bench = Bench(model, theta, tuple(noisy), rate, np.unique(ends), time_s, asked, worst)
    info = bench.at_size(DEFLECTION if deflection is None else deflection)
    if not np.isfinite(info.best.figure):
        raise IdentifiabilityError(
            "no release determines the unknowns", cure="state one value (weigh a mass), or add channels"
        )
    if target is not None and deflection is None:
        info = _reaching(bench, info, target)
        notes.append(
            f"a deflection of {info.size:.3g} {unit} reaches the target of {100 * target:.3g} %"
            if info.best.figure <= target
            else (
                f"the target of {100 * target:.3g} % is not reached: a deflection of {info.size:.3g} {unit} "
                f"gives {100 * info.best.figure:.3g} %, because the noise grows with the motion"
            )
        )
    best = info.best
    alone = sorted((info.recorded((k,)) for k in range(model.n)), key=lambda each: each.figure)
    return ReleasePlan(
        model,
        tuple(info.release(each.group[0], each) for each in alone),
        tuple(info.release(k, best) for k in best.group),
        model.unknown_names,
        model.unknown_units,
        theta,
        np.sqrt(np.diagonal(_covariance(info.total(best.group, best.seconds)))),
        best.figure,
        rate,
        tuple(notes),
    )


@dataclass(frozen=True)
class Bench:
    """A rig whose releases are planned.

    theta   of the unknowns, and which of them are asked for (`worst`: the worst of these)
    ends    numbers of samples of the recordings that are compared
    time_s  of all recordings together, None where that is open
    """

    model: Model
    theta: Real
    channels: tuple[Channel, ...]
    rate: float
    ends: Ints
    time_s: float | None
    asked: Bools
    worst: bool

    @cached_property
    def held(self) -> list[Real]:
        """Static shapes from which the rig is let go, (n,) each, the largest entry 1 in size.

        Each is the one under a force at a coordinate; what nothing holds moves by itself.
        """
        p = self.model.parameters(self.theta)
        K = matrices(self.model, p).K
        shapes = []
        for k in range(self.model.n):
            force = np.zeros(self.model.n)
            force[k] = 1.0
            x = np.linalg.lstsq(K, force, rcond=1e-12)[0]
            if not np.allclose(K @ x, force, atol=1e-9) or x[k] <= 0:
                x = force
            shapes.append(x / np.max(np.abs(x)))
        return shapes

    def at_size(self, size: float) -> ReleaseInformation:
        """The information of releases whose largest deflection is `size`, m or rad."""
        p, starts = self.model.parameters(self.theta), [shape * size for shape in self.held]
        view = observation_model(self.model, self.channels, np.ones(1))
        machine, nothing = integrator(self.model, p, 1 / self.rate), np.zeros((max(int(self.rate), 64), 0))
        motions = [
            machine.motion(nothing, np.concatenate([start, np.zeros(self.model.n)])) for start in starts
        ]
        largest = np.array([np.max(np.abs(channel_samples(view, p, motion)), axis=0) for motion in motions])
        moves = largest > 1e-9 * np.max(largest, axis=0)  # rounding
        sd = noise_sd(self.channels, (largest * moves).astype(np.complex128))
        each_sd = np.where(sd > 0, sd, np.inf)
        infos = [
            _information(self.model, self.theta, view, start, sd, self.rate, self.ends)
            for start, sd in zip(starts, each_sd, strict=True)
        ]
        return ReleaseInformation(self, size, np.array(infos))


class Recorded(NamedTuple):
    """Releases that are recorded for so long each, and their figure; the smallest is the best."""

    figure: float
    seconds: float
    group: tuple[int, ...]


@dataclass(frozen=True)
class ReleaseInformation:
    """Of releases of one size (m or rad): the information of each after each recording, (n, ends, m, m)."""

    bench: Bench
    size: float
    infos: Real

    def total(self, group: Sequence[int], seconds: float) -> Real:
        """Of releases from these coordinates, `seconds` each, and of what is known beforehand, (m, m)."""
        samples = self.bench.rate * seconds * (1 + 1e-9)
        at = max(int(np.searchsorted(self.bench.ends, samples, side="right")) - 1, 0)
        return np.asarray(
            np.sum(self.infos[list(group), at], axis=0) + np.diag(self.bench.model.prior_precision)
        )

    def figure(self, group: Sequence[int], seconds: float) -> float:
        """Rms (or largest) relative standard deviation of what is asked for, inf where it is not determined."""
        sd = np.sqrt(np.diagonal(_covariance(self.total(group, seconds))))
        relative = (sd / np.abs(self.bench.theta))[self.bench.asked]
        return float(np.max(relative) if self.bench.worst else np.sqrt(np.mean(relative**2)))

    def recorded(self, group: tuple[int, ...]) -> Recorded:
        """Recorded until more no longer pays, or for an equal part of the time there is."""
        times = (self.bench.ends / self.bench.rate).tolist()
        if self.bench.time_s is not None:
            seconds = min(self.bench.time_s / len(group), times[-1])
            return Recorded(self.figure(group, seconds), seconds, group)
        figures = [self.figure(group, seconds) for seconds in times]
        i = next(i for i, figure in enumerate(figures) if figure <= ENOUGH * figures[-1])
        i = i if np.isfinite(figures[-1]) else len(figures) - 1
        return Recorded(figures[i], times[i], group)

    @cached_property
    def best(self) -> Recorded:
        """The releases to make."""
        n = self.bench.model.n
        best = min(self.recorded((k,)) for k in range(n))
        for count in range(2, MOST_TOGETHER + 1):
            # Of twelve coordinates: their triples are 364 already
            trial = min(
                self.recorded(group) for group in combinations_with_replacement(range(min(n, 12)), count)
            )
            # As many releases more as they are worth: √(releases) alone brings that much from the same place
            fair = 1.0 if self.bench.time_s is not None else np.sqrt((count - 1) / count)
            if not trial.figure * ENOUGH < best.figure * fair and np.isfinite(best.figure):
                break
            best = trial
        return best

    def release(self, k: int, recorded: Recorded) -> Release:
        """The one from coordinate k."""
        deflection, seconds = float(self.size * self.bench.held[k][k]), float(f"{recorded.seconds:.3g}")
        return Release(self.bench.model.coordinates[k], deflection, self.size, seconds, recorded.figure)


def _reaching(bench: Bench, info: ReleaseInformation, target: float) -> ReleaseInformation:
    """Releases of a size that reaches a target, in three digits; as `info` where none does.

    figure² = a²/size² + b² of noise of its own size and of noise that is a share of the motion, by the last two sizes.
    """
    first, share = info, 0.0
    for _ in range(8):
        part = info.best.figure**2 - share
        if not 0 < part < np.inf or not share < target**2:
            break
        exact = info.size * float(np.sqrt(part / (target**2 - share)))
        digit = 10 ** (np.floor(np.log10(exact)) - 2)
        before, info = info, bench.at_size(float(f"{np.ceil(exact / digit * (1 - 1e-9)) * digit:.3g}"))
        if info.best.figure <= target:
            return info
        if info.size == before.size:
            break
        inverse = np.array([before.size, info.size]) ** -2.0
        square = np.array([before.best.figure, info.best.figure]) ** 2
        share = float(square[1] - inverse[1] * np.diff(square)[0] / np.diff(inverse)[0])
    return first


def _require_plannable(model: Model, names: Sequence[str]) -> None:
    """Raises UsageError for a nonlinear rig, one without unknowns, and for names that are no unknowns."""
    if not model.unknown_names:
        raise UsageError("every value of the rig is known", cure="leave out the values to be found")
    if len(model.nonlinear):
        raise UsageError(
            "releases are planned for linear rigs", cure="leave out the nonlinear elements for the plan"
        )
    if wrong := [name for name in names if name not in model.unknown_names]:
        raise UsageError(
            f"{wrong[0]} is not an unknown", cure=f"the unknowns are {', '.join(model.unknown_names)}"
        )


def _information(
    model: Model, theta: Real, view: ObservationModel, start: Real, sd: Real, rate: float, ends: Ints
) -> Real:
    """The information on θ of recordings of so many samples, (ends, m, m), the states at the start projected out.

    Slopes along θ by central differences, exact along the states.
    """
    samples = int(ends[-1])
    nothing, state = np.zeros((samples, 0)), np.concatenate([start, np.zeros(model.n)])

    def shown(at: Real, begin: Real) -> Real:
        p = model.parameters(at)
        motion = integrator(model, p, 1 / rate).motion(nothing, begin)
        return (channel_samples(view, p, motion) / sd).ravel()

    size = 1e-4 * np.where(theta == 0, 1.0, np.abs(theta))
    steps = zip(np.diag(size), size, strict=True)
    along = [(shown(theta + step, state) - shown(theta - step, state)) / (2 * h) for step, h in steps]
    J = np.stack([*along, *(shown(theta, unit) for unit in np.eye(2 * model.n))], axis=1)
    each = J.reshape(samples, -1, J.shape[1])
    m, infos, total, begin = len(theta), [], np.zeros((J.shape[1], J.shape[1])), 0
    for end in ends.tolist():
        part = each[begin:end].reshape(-1, J.shape[1])
        total, begin = total + part.T @ part, end
        # States of modes that no channel shows carry nothing, 1e-12 of the others
        scale = np.sqrt(np.maximum(np.diagonal(total)[m:], 1e-300))
        outer = np.outer(scale, scale)
        of_states = np.linalg.pinv(total[m:, m:] / outer, rcond=1e-12, hermitian=True) / outer
        infos.append(total[:m, :m] - total[:m, m:] @ of_states @ total[m:, :m])
    return np.array(infos)


def _covariance(information: Real) -> Real:
    """The inverse of an information (m, m), inf where it is singular."""
    size = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    if not np.all(size > 0):
        return np.full_like(information, np.inf)
    scaled = information / np.outer(size, size)
    values = np.linalg.eigvalsh(scaled)
    # 1e-10: of central differences, and of states of modes that do not show
    if values[0] < 1e-10:
        return np.full_like(information, np.inf)
    return np.asarray(scaled_inverse(information))
