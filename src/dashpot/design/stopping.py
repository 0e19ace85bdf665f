"""After data: what is known now, whether that is enough, and how much more it takes (paper §3.3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Frozen, Ints, Real
from dashpot.channel import Channel
from dashpot.data.noise import constant_and_share
from dashpot.data.spectrum import Spectrum
from dashpot.design.allocation import Kind
from dashpot.design.robust import GaussianPrior
from dashpot.design.test_setup import TestSetup
from dashpot.errors import DashpotError, IdentifiabilityError, UsageError
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.method import Method
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import measures_input, observation_model


def after(setup: TestSetup, estimate: Estimate) -> TestSetup:
    """The setup with what an estimate tells: the inverse of its covariance is known before the next test.

    Priors were in the estimate already.  Calibrations that were entirely unknown are taken as unknown again.
    Raises UsageError if the estimate is of other unknowns.
    """
    stated = [u.name for u in setup.calibrations if u.sd is not None and u.name in estimate.names]
    names = (*setup.model.unknown_names, *stated)
    at = np.ix_(*[[setup.names.index(name) for name in names]] * 2)
    C = _covariance_of(estimate, names) / np.outer(setup.gains, setup.gains)[at]
    size = np.sqrt(np.diagonal(C))
    q = len(setup.names)
    information = np.zeros((q, q))
    # Rounding may make tiny eigenvalues negative; a little less information than there is does no harm.
    values, vectors = np.linalg.eigh(C / np.outer(size, size))
    root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1])) / size[:, None]
    information[at] = root @ root.T
    return replace(setup, earlier=information)


def gaussian_prior_of(model: Model, estimate: Estimate) -> GaussianPrior:
    """The uncertainty that an estimate leaves in the unknowns of the rig, by their names.

    Raises UsageError if it is of other unknowns, or has no finite covariance.
    """
    return GaussianPrior(_covariance_of(estimate, model.unknown_names))


def _covariance_of(estimate: Estimate, names: Sequence[str]) -> Real:
    missing = [name for name in names if name not in estimate.names]
    if missing:
        raise UsageError(
            f"the estimate contains nothing about {', '.join(missing)}",
            cure="give the estimate of this rig, or its data",
        )
    i = [estimate.names.index(name) for name in names]
    C = estimate.covariance[np.ix_(i, i)]
    if not np.all(np.isfinite(C)) or np.any(np.diagonal(C) <= 0):
        raise UsageError(
            "the estimate's covariance is not finite and positive",
            cure="state the values to design for, and their uncertainty, instead of an estimate",
        )
    return C


def values_after(
    model: Model, estimate: Estimate, guesses: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Values to design the next test for: the estimate's where it says something, else the guess.

    An estimate says something where its sd is below half its size.  Guesses are those given, then the rig's; where
    there is none, the estimate's size stands, or its sd where that is larger.
    """
    found = {
        n: (float(v), float(s)) for n, v, s in zip(estimate.names, estimate.values, estimate.sd, strict=True)
    }
    values = {}
    for unknown in model.unknowns:
        if unknown.name in found:
            value, sd = found[unknown.name]
            guess = (guesses or {}).get(unknown.name, unknown.guess)
            vague = max(abs(value), sd) if guess is None else guess
            values[unknown.name] = value if sd < 0.5 * abs(value) else vague
    return values


def noise_from(channels: Sequence[Channel], spectrum: Spectrum) -> tuple[Channel, ...]:
    """The channels with the noise that data show, floor² + (relative · amplitude)² fitted over the lines.

    Channels that state their noise, that the data have not, or that are exact there stay as they are.
    """
    index = {channel.name: i for i, channel in enumerate(spectrum.channels)}
    noisy = []
    for channel in channels:
        noisy.append(channel)
        i = index.get(channel.name)
        if channel.noise > 0 or channel.relative_noise > 0 or i is None:
            continue
        V = spectrum.covariance[..., i, i].real
        power = np.abs(spectrum.amplitudes[..., i]) ** 2
        variance = np.mean(V, axis=tuple(range(V.ndim - 1))) * spectrum.samples / 4
        power = np.mean(power, axis=tuple(range(power.ndim - 1)))
        usable = np.isfinite(variance) & (variance > 0) & np.isfinite(power) & (power > 0)
        if not np.any(usable):
            continue
        floor, relative = constant_and_share(variance[usable], power[usable])
        floor_sd = floor**0.5 * abs(channel.factor) / channel.scale
        noisy[-1] = replace(channel, noise=floor_sd, relative_noise=relative**0.5)
    return tuple(noisy)


def amplitude_from(model: Model, spectrum: Spectrum) -> float | None:
    """Median amplitude of the inputs in data, m or N; None if no channel shows one, or inputs are of both kinds."""
    if model.displacement_inputs and model.force_inputs:
        return None
    per_unit = np.abs(
        observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment).direct_q
    ).sum(axis=-1)
    sizes: list[float] = []
    for i, channel in enumerate(spectrum.channels):
        if len(channel.of) == 1 and measures_input(model, channel):
            size = np.abs(spectrum.amplitudes[..., i]) / per_unit[:, i]
            sizes += size[np.isfinite(size) & (size > 0)].tolist()
    return float(np.median(sizes)) if sizes else None


@dataclass(frozen=True)
class SequentialEstimates(Frozen):
    """Estimates as data come in.

    samples  (steps,)           samples behind each estimate
    values   (steps, unknowns)  NaN where the data did not determine them yet
    sd       (steps, unknowns)
    """

    names: tuple[str, ...]
    samples: Ints
    values: Real
    sd: Real

    @property
    def relative(self) -> Real:
        """sd in parts of |value|, (steps, unknowns)."""
        return self.sd / np.where(self.values == 0, 1.0, np.abs(self.values))

    def extrapolated(self, times: float, points: int = 30) -> tuple[Real, Real]:
        """Relative sds if the same test went on: (samples (points,), relative sd (points, unknowns)).

        From the last step to `times` its samples, in proportion to 1/√samples.
        """
        last = float(self.samples[-1])
        ahead = last * np.geomspace(1, times, points)
        return ahead, self.relative[-1] * np.sqrt(last / ahead)[:, None]


def sequential_estimates(
    model: Model, spectrum: Spectrum, *, whole: Estimate | None = None, steps: int = 12
) -> SequentialEstimates:
    """Identify from the first lines, more lines, … all lines, in the order of the spectrum (no batch axes).

    With `whole`, the estimate from all lines, each search starts from it instead of from far.

    Raises UsageError for a batch, IdentifiabilityError if not even all lines determine the unknowns.
    """
    if spectrum.batch:
        raise UsageError("progress is of one test, not of a batch", cure="give one repeat")
    method: Method | None = None
    counts = np.unique(np.linspace(1, spectrum.lines, min(steps, spectrum.lines)).round().astype(int))
    if whole is not None:
        unknowns = {unknown.name for unknown in model.unknowns if unknown.prior is None}
        guesses = {n: float(v) for n, v in zip(whole.names, whole.values, strict=True) if n in unknowns}
        elements = tuple(replace(e, guess=guesses.get(e.name, e.guess)) for e in model.elements)
        model = replace(model, elements=elements)
        if isinstance(automatic(model, spectrum), MaximumLikelihood):
            method = MaximumLikelihood(starts=4, candidates=4, rounds=1)
    values, sd = (np.full((len(counts), len(model.unknowns)), np.nan) for _ in range(2))
    for k, count in enumerate(counts):
        try:
            estimate = identify(model, spectrum.select(np.arange(count)), method)
        except DashpotError:
            if count == spectrum.lines:
                raise
            continue
        if bool(estimate.converged):
            columns = [estimate.names.index(name) for name in model.unknown_names]  # not the calibrations
            values[k], sd[k] = estimate.values[columns], estimate.sd[columns]
    total = np.cumsum(spectrum.samples)[counts - 1]
    return SequentialEstimates(model.unknown_names, total, values, sd)


@dataclass(frozen=True)
class Verdict:
    """Whether there are enough samples.

    reached   whether the target is reached
    worst     name of the unknown that is farthest from it
    excess    what is read (an sd, an rms, a mean radius) over its target
    more      samples that the same kind of test still needs; inf where no number helps
    reason    in words
    """

    reached: bool
    worst: str
    excess: float
    more: float
    reason: str


def enough(
    estimate: Estimate,
    targets: Mapping[str, float],
    samples: int,
    known: Real | None = None,
    kind: Kind = "minimax",
) -> Verdict:
    """The stopping rule: sd ∝ 1/√samples for more of the same (paper §3.3), from the estimate so far.

    `targets` are relative standard deviations by name, to be reached as the criterion of that kind is read.  `known`
    is information (q, q), SI, on the first q unknowns that did not come from these samples (priors) and does not grow.
    Where the model does not fit, the intervals count its misfit, which no number of samples lowers.  Raises
    IdentifiabilityError if an unknown is not determined.
    """
    size = np.where(estimate.values == 0, 1.0, np.abs(estimate.values))
    j = [estimate.names.index(name) for name in targets]
    unit = np.array(list(targets.values())) * size[j]  # errors in parts of their targets
    each = np.sqrt(np.diagonal(estimate.covariance)[j]) / unit
    worst = estimate.names[j[int(np.argmax(np.where(np.isfinite(each), each, np.inf)))]]
    if not np.all(np.isfinite(each)):
        raise IdentifiabilityError(f"the data do not determine {worst}", cure="add frequencies or sensors")

    def excess_of(C: Real) -> float:
        """Largest sd, rms of the sds, or mean radius, in units of the targets."""
        relative = C[np.ix_(j, j)] / np.outer(unit, unit)
        if kind == "D":
            return float(np.exp(np.linalg.slogdet(relative)[1] / 2 / len(relative)))
        variance = np.diagonal(relative)
        return float(np.sqrt(np.max(variance) if kind == "minimax" else np.mean(variance)))

    excess = excess_of(estimate.covariance)
    what = {"A": "the rms of the relative standard deviations", "D": "the confidence region"}.get(kind, worst)
    if excess <= 1:
        narrow = "every interval is" if kind == "minimax" else f"{what} is"
        return Verdict(True, worst, excess, 0.0, f"{narrow} below the target")
    if bool(np.any(estimate.fit.rejected)):
        reason = "the model does not fit: more samples will not narrow what the misfit leaves open"
        return Verdict(False, worst, excess, np.inf, reason)
    covariance_with = _with_more_samples(estimate, known, size)
    times = least_factor(lambda factor: excess_of(covariance_with(factor)) <= 1)
    if not np.isfinite(times):
        return Verdict(False, worst, excess, np.inf, "more of the same test does not reach the target")
    more = float(np.ceil((times - 1) * samples))
    return Verdict(False, worst, excess, more, f"{what} is {excess:.3g} times its target")


def _with_more_samples(estimate: Estimate, known: Real | None, size: Real) -> Callable[[float], Real]:
    """The covariance with so many times the samples: what an estimated noise costs falls with them as well."""
    scale = np.outer(size, size)
    total = np.linalg.inv(estimate.covariance / scale)
    fixed = np.zeros_like(total)
    if known is not None:
        fixed[: len(known), : len(known)] = known * scale[: len(known), : len(known)]
    widened = np.maximum(np.sqrt(np.diagonal(estimate.covariance)) / estimate.bound_sd, 1.0) ** 2

    def covariance(times: float) -> Real:
        left = np.sqrt((1 + (widened - 1) / times) / widened)
        return np.linalg.inv(fixed + times * (total - fixed)) * scale * np.outer(left, left)

    return covariance


def least_factor(met: Callable[[float], bool]) -> float:
    """The smallest factor of a number of samples from which `met` holds, of 1e-9 to 1e12; inf where it is beyond."""
    low, high = np.log(1e-9), np.log(1e12)
    if not met(float(np.exp(high))):
        return np.inf
    for _ in range(64):
        middle = (low + high) / 2
        low, high = (low, middle) if met(float(np.exp(middle))) else (middle, high)
    return float(np.exp(high))
