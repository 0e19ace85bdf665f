"""Releases of a rig that nothing drives: where to hold it, how far, how long to record, and which releases together.

A release from a hold at one coordinate begins with the static shape under a force there.  With white noise σ_c in every
sample the information on θ is Jᵀ W (1 − P) J: slopes J of the samples along θ, weighted by W = σ⁻², without what the
2 n unknown states at the start (columns S, P their projection) could make of them.  Informations of releases add.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from dashpot.arrays import Real, freeze
from dashpot.channel import Channel
from dashpot.errors import IdentifiabilityError, UsageError
from dashpot.model.dynamics import matrices
from dashpot.model.modes import modes
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, noise_sd, observation_model
from dashpot.numerics.small_systems import scaled_inverse

DEFLECTION = 0.01  # m or rad, of the point that moves most, where nothing is said
SAMPLES_A_PERIOD = 20  # of the fastest mode, where no sampling rate is said
MOST_SAMPLES = 40_000  # of one release
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
class ReleasePlan:
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

    def __post_init__(self) -> None:
        freeze(self)

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

    Raises UsageError for a nonlinear rig, one without unknowns and an unknown name, IdentifiabilityError where no
    release determines the unknowns, ModelError where the rig has no motion in time.
    """
    _require_plannable(model, names)
    notes: list[str] = []
    theta = model.theta(values)
    p = model.parameters(theta)
    found = modes(model, p).eigenvalues
    fastest = float(np.max(np.abs(found))) / (2 * np.pi)
    rates = [channel.rate for channel in channels if channel.rate is not None]
    rate = rate_hz or min(rates, default=0.0)
    if not rate:
        rate = float(f"{SAMPLES_A_PERIOD * fastest:.2g}")
        notes.append(
            f"no sampling rate is stated: {rate:g} Hz is assumed, {SAMPLES_A_PERIOD} samples a period"
        )
    size = DEFLECTION if deflection is None else deflection
    if deflection is None and target is None:
        unit = "rad" if set(model.coordinates) <= model.angles else "m"
        notes.append(
            f"no deflection is stated: {size:g} {unit} of the point that moves most is assumed (--stroke)"
        )
    held = _shapes(model, p)
    slowest = float(np.min(np.abs(found[np.abs(found) > 0]), initial=np.inf))
    decay = float(np.min(-found.real[found.real < -1e-9 * np.abs(found)], initial=np.inf))
    longest = min(_longest(slowest, decay), MOST_SAMPLES / rate)
    view = observation_model(model, channels, np.ones(1))
    stated = _with_noise(channels, notes)
    chosen = [model.unknown_names.index(name) for name in names or model.unknown_names]
    prior = np.diag(model.prior_precision)

    def informed(size: float) -> list[tuple[Real, Real]]:
        sd = _noise(model, p, stated, view, [shape * size for shape in held], rate)
        starts = zip(held, sd, strict=True)
        return [_information(model, theta, view, shape * size, each, rate, longest) for shape, each in starts]

    infos = informed(size)

    def figure_of(information: Real) -> float:
        relative = np.sqrt(np.diagonal(_covariance(information + prior)))[chosen] / np.abs(theta[chosen])
        return float(np.max(relative) if worst else np.sqrt(np.mean(relative**2)))

    def until(k: int, seconds: float) -> Real:
        times, each = infos[k]
        return np.asarray(each[min(int(np.searchsorted(times, seconds * (1 - 1e-9))), len(times) - 1)])

    def worth(group: Sequence[int]) -> float:
        """Shortest recording, s, of each of these releases after which more is hardly worth it."""
        times = infos[0][0]
        if time_s is not None:
            return min(time_s / len(group), float(times[-1]))
        figures = [figure_of(sum((until(k, t) for k in group), np.zeros_like(prior))) for t in times.tolist()]
        if not np.isfinite(figures[-1]):
            return float(times[-1])
        return float(times[next(i for i, figure in enumerate(figures) if figure <= ENOUGH * figures[-1])])

    def together(group: Sequence[int]) -> tuple[float, float]:
        seconds = worth(group)
        return figure_of(sum((until(k, seconds) for k in group), np.zeros_like(prior))), seconds

    singles = [together((k,)) for k in range(model.n)]
    best = min(singles)
    group: tuple[int, ...] = (singles.index(best),)
    for count in range(2, MOST_TOGETHER + 1):
        groups = combinations_with_replacement(range(min(model.n, 12)), count)
        trial, other = min((together(each), each) for each in groups)
        # As many releases more as they are worth: √(releases) alone brings that much from the same place
        fair = 1.0 if time_s is not None else np.sqrt((count - 1) / count)
        if not trial[0] * ENOUGH < best[0] * fair and np.isfinite(best[0]):
            break
        best, group = trial, other
    if not np.isfinite(best[0]):
        raise IdentifiabilityError(
            "no release determines the unknowns", cure="state one value (weigh a mass), or add channels"
        )
    if target is not None and deflection is None:
        size *= best[0] / target
        infos = [(times, each * (best[0] / target) ** 2) for times, each in infos]
        best = (figure_of(sum((until(k, best[1]) for k in group), np.zeros_like(prior))), best[1])
        notes.append(f"a deflection of {size:.3g} reaches the target of {100 * target:.3g} %")

    def release(k: int, figure: float, seconds: float) -> Release:
        return Release(model.coordinates[k], float(size * held[k][k]), size, float(f"{seconds:.3g}"), figure)

    covariance = _covariance(sum((until(k, best[1]) for k in group), np.zeros_like(prior)) + prior)
    alone = sorted((release(k, *single) for k, single in enumerate(singles)), key=lambda each: each.figure)
    return ReleasePlan(
        model,
        tuple(alone),
        tuple(release(k, *best) for k in group),
        model.unknown_names,
        model.unknown_units,
        theta,
        np.sqrt(np.diagonal(covariance)),
        best[0],
        rate,
        tuple(notes),
    )


def _require_plannable(model: Model, names: Sequence[str]) -> None:
    """Raises UsageError for a nonlinear rig, one without unknowns, and for names that are no unknowns."""
    if not model.unknown_names:
        raise UsageError(
            "every value of the rig is known", cure="leave out the values that releases are to tell"
        )
    if len(model.nonlinear):
        raise UsageError(
            "releases are planned for linear rigs", cure="leave out the nonlinear elements for the plan"
        )
    if wrong := [name for name in names if name not in model.unknown_names]:
        raise UsageError(
            f"{wrong[0]} is no unknown", cure=f"the unknowns are {', '.join(model.unknown_names)}"
        )


def _longest(slowest: float, decay: float) -> float:
    """s that are looked at: until the slowest decay is at 1e-4, two hundred periods where it hardly decays."""
    periods = 200 * 2 * np.pi / slowest
    return float(min(np.log(1e4) / decay, periods) if np.isfinite(decay) else periods)


def _shapes(model: Model, p: Real) -> list[Real]:
    """Static shapes under a force at each coordinate, the largest entry 1 in size, (n,) each.

    What nothing holds moves by itself.
    """
    K = matrices(model, p).K
    shapes = []
    for k in range(model.n):
        force = np.zeros(model.n)
        force[k] = 1.0
        x = np.linalg.lstsq(K, force, rcond=1e-12)[0]
        if not np.allclose(K @ x, force, atol=1e-9) or x[k] <= 0:
            x = force
        shapes.append(x / np.max(np.abs(x)))
    return shapes


def _with_noise(channels: Sequence[Channel], notes: list[str]) -> list[Channel]:
    """The channels, with a noise that is assumed where they state none."""
    silent = [channel.name for channel in channels if not channel.noise and not channel.relative_noise]
    if silent:
        which = "no channel" if len(silent) == len(channels) else f"{', '.join(silent)} nowhere"
        notes.append(f"{which} states its noise: 1 % of the largest value is assumed")
    return [replace(c, relative_noise=0.01) if c.name in silent else c for c in channels]


def _noise(
    model: Model,
    p: Real,
    channels: Sequence[Channel],
    view: ObservationModel,
    starts: Sequence[Real],
    rate: float,
) -> Real:
    """Standard deviation of a sample of each channel after each release, (releases, channels), SI units.

    A relative part is of the channel's largest value; inf where a channel without another stays still: that tells
    nothing.
    """
    machine, nothing = integrator(model, p, 1 / rate), np.zeros((max(int(rate), 64), 0))
    motions = [machine.motion(nothing, np.concatenate([start, np.zeros(model.n)])) for start in starts]
    largest = np.array([np.max(np.abs(channel_samples(view, p, motion)), axis=0) for motion in motions])
    moves = largest > 1e-9 * np.max(largest, axis=0)  # rounding
    sd = noise_sd(channels, (largest * moves).astype(np.complex128))
    return np.where(sd > 0, sd, np.inf)


def _information(
    model: Model, theta: Real, view: ObservationModel, start: Real, sd: Real, rate: float, longest: float
) -> tuple[Real, Real]:
    """Recording times (T,), s, and the information of each on θ, (T, m, m), the states at the start projected out.

    Slopes along θ by central differences, exact along the states.
    """
    samples = max(int(longest * rate), 4 * model.n + 4)
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
    ends = np.unique(np.geomspace(min(4 * model.n + 4, samples), samples, 24).astype(int))
    m, infos, total, begin = len(theta), [], np.zeros((J.shape[1], J.shape[1])), 0
    for end in ends.tolist():
        part = each[begin:end].reshape(-1, J.shape[1])
        total, begin = total + part.T @ part, end
        # States of modes that no channel shows carry nothing, 1e-12 of the others
        scale = np.sqrt(np.maximum(np.diagonal(total)[m:], 1e-300))
        outer = np.outer(scale, scale)
        of_states = np.linalg.pinv(total[m:, m:] / outer, rcond=1e-12, hermitian=True) / outer
        infos.append(total[:m, :m] - total[:m, m:] @ of_states @ total[m:, :m])
    return ends / rate, np.array(infos)


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
