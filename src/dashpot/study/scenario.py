"""A scenario is one point of a study: a rig, a test, its noise and who identifies it; a study is grids of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from dashpot.arrays import Ints, Real, freeze
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.design.plan import lines_of_dwells, unsettled_dwells
from dashpot.errors import UsageError
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.registry import method_class
from dashpot.io.words import listed
from dashpot.model.network import Model
from dashpot.model.observation import nominal_calibrations, unknown_calibrations, with_relative_noise
from dashpot.study.blocks import fields_of, fingerprint_of
from dashpot.study.simulate import (
    Dwells,
    NoiseBasis,
    clean_spectrum,
    dwells,
    settled_motion,
    settled_spectrum,
    simulate_spectrum,
    with_constant_noise,
    with_noise_drawn,
)

AUTO = "auto"  # among the methods: what `identify` does where no method is named


@dataclass(frozen=True)
class Scenario:
    """One point of a study: a rig with its true parameters, a test, its noise, and who identifies it.

    factors    what the point stands for, in order: {"rig": "paper", "noise": 0.1, …}; its text names the scenario
    theta      true unknowns, (unknowns,)
    noise      whether the methods are given the covariance of the noise or estimate it from residuals
    drift      degree of the trend solved for with the fundamental; None is none
    transients whether dwells follow each other without settling, from rest, and are used whole
    """

    factors: Mapping[str, str | float | int]
    model: Model
    theta: Real
    channels: tuple[Channel, ...]
    test: Dwells
    methods: tuple[str, ...]
    draws: int
    noise: NoiseBasis = "given"
    drift: int | None = None
    transients: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "factors", MappingProxyType(dict(self.factors)))
        freeze(self)
        object.__setattr__(self, "channels", tuple(self.channels))
        object.__setattr__(self, "methods", tuple(self.methods))

    def __reduce__(self) -> tuple[Any, ...]:
        rest = [getattr(self, name) for name in self.__dataclass_fields__ if name != "factors"]
        return Scenario, (dict(self.factors), *rest)  # a view of a dictionary cannot be sent

    @cached_property
    def name(self) -> str:
        """Its factors as text: "rig=paper noise=0.1"."""
        return " ".join(
            f"{key}={value:g}" if isinstance(value, float) else f"{key}={value}"
            for key, value in self.factors.items()
        )

    @cached_property
    def key(self) -> str:
        """Sixteen hexadecimal digits that depend on the factors alone: the name of its files and of its randomness."""
        return hashlib.sha256(json.dumps(dict(self.factors)).encode()).hexdigest()[:16]

    @cached_property
    def fingerprint(self) -> str:
        """A digest of all that the repeats depend on but the names, the seed, the methods and the number of draws.

        Every field counts, those that are still to come as well, but for the rig's name, and of the channels the name
        of the unit, whose scale counts, and the rate: the test says when samples are taken.
        """
        model = {name: value for name, value in fields_of(self.model) if name != "name"}
        channels = [
            {name: value for name, value in fields_of(channel) if name not in ("unit", "rate")}
            for channel in self.channels
        ]
        parts = (model, self.theta, channels, self.test, self.noise, self.drift)
        return fingerprint_of((*parts, "transients") if self.transients else parts)

    @property
    def p(self) -> Real:
        """True parameters of all elements, (elements,)."""
        return self.model.parameters(self.theta)

    def bound_sd(self) -> Real:
        """Cramér-Rao bound at the truth, (unknowns,), for the true noise.

        Raises DashpotError if the test does not determine the unknowns.
        """
        if self.transients:
            calibrations = nominal_calibrations(unknown_calibrations(self.channels))
            start = MaximumLikelihood(start=(*self.theta.tolist(), *calibrations.tolist()))
            return identify(self.model, self._unsettled, start).bound_sd[: len(self.theta)]
        if len(self.model.nonlinear):
            clean = self._settled()
        else:
            clean = clean_spectrum(self.model, self.p, self.channels, self.test, drift=self.drift)
        return identify(self.model, clean, automatic(self.model, clean)).bound_sd[: len(self.theta)]

    def drawn(self, rng: np.random.Generator, draws: int) -> Spectrum:
        """Repeats of the test, drawn for all methods alike.

        Raises DataError if a dwell has too few samples, UsageError if a nonlinear rig is to be told noise by its
        residuals or sample moments, or a test with transients more than they know, ConvergenceError if a rig has no
        settled motion.
        """
        if self.transients:
            return with_noise_drawn(self._unsettled, rng, draws)
        if not len(self.model.nonlinear):
            moments = any(method_class(name).traits.moments for name in self.methods if name != AUTO)
            how: Any = {"noise": self.noise, "moments": moments, "drift": self.drift}
            return simulate_spectrum(self.model, self.p, self.channels, self.test, rng, draws=draws, **how)
        if self.noise != "given":
            raise UsageError(
                "studies of nonlinear rigs need the noise to be given", cure='write covariance = "given"'
            )
        return with_noise_drawn(self._settled(), rng, draws)

    @cached_property
    def _unsettled(self) -> Spectrum:
        """The lines of the dwells with their transients, without noise."""
        if len(self.model.nonlinear) or self.noise != "given" or self.drift is not None:
            raise UsageError(
                "studies with transients need linear rigs, given noise and no drift",
                cure='write covariance = "given" and no drift, or leave transients out',
            )
        if any(unknown.unit == "s" and unknown.nominal for unknown in unknown_calibrations(self.channels)):
            what = "studies with transients do not support delays stated with an sd"
            raise UsageError(what, cure="state their values only")
        test = self.test
        drive = np.concatenate([test.U, test.f], axis=-1)
        samples, steps = test.samples.tolist(), (test.periods / test.frequency_hz / test.samples).tolist()
        records = unsettled_dwells(
            self.model, self.p, self.channels, test.frequency_hz, drive, samples, steps
        )
        return lines_of_dwells(records, self.channels, joined=False)

    def _settled(self) -> Spectrum:
        """The lines of settled dwells of a nonlinear rig, without noise."""
        motion = settled_motion(self.model, self.theta, self.channels, self.test)
        return settled_spectrum(self.channels, motion, self.test)


# What a study varies, spread out into scenarios.


NoiseKind = Literal["relative", "constant", "channels"]
ALL = "all"  # the unknowns as the rig has them


@dataclass(frozen=True)
class TrueRig:
    """A rig to simulate: its model, what its unknowns truly are, and its channels."""

    model: Model
    values: Mapping[str, float]
    channels: tuple[Channel, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))
        object.__setattr__(self, "channels", tuple(self.channels))


@dataclass(frozen=True)
class ScenarioGrid:
    """Every combination of the entries; names refer to the tables of the Study.

    noise       levels, as `kind` takes them: "relative" ρ × the channel's amplitude at each frequency (paper eq. 21),
                "constant" ρ × its rms amplitude over the frequencies `reference`, the same at all frequencies, or
                "channels" ρ × the noise that the rig's channels state
    samples     per frequency, or in all where `in_all`
    covariance  "given" or "estimated" from the residuals
    """

    rigs: tuple[str, ...]
    frequencies: tuple[str, ...]
    noise: tuple[float, ...]
    samples: tuple[int, ...]
    methods: tuple[str, ...]
    draws: int
    unknowns: tuple[str, ...] = (ALL,)
    kind: NoiseKind = "relative"
    reference: str | None = None
    in_all: bool = False
    covariance: tuple[NoiseBasis, ...] = ("given",)


@dataclass(frozen=True)
class Study:
    """Tables that grids refer to, and the grids.

    unknowns    sets of parameters that are to be found; all others are known exactly
    amplitudes  of the inputs, SI units, 1 where not named;   periods  time of a dwell
    drift       degree of the trend that the harmonic regression solves for, None for none
    transients  whether dwells follow each other without settling, and are used whole
    """

    name: str
    seed: int
    rigs: Mapping[str, TrueRig]
    frequencies: Mapping[str, tuple[float, ...]]
    grids: tuple[ScenarioGrid, ...]
    unknowns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    amplitudes: Mapping[str, complex] = field(default_factory=dict)
    periods: float = 1.0
    drift: int | None = None
    transients: bool = False

    def __post_init__(self) -> None:
        for name in ("rigs", "frequencies", "unknowns", "amplitudes"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))


def scenarios(study: Study) -> tuple[Scenario, ...]:
    """All points of all grids, each once: what two grids share has the methods of both and the larger number of draws.

    Raises UsageError or ModelError if a combination is none.
    """
    by_name: dict[str, Scenario] = {}
    for grid in study.grids:
        for point in points(study, grid):
            earlier = by_name.get(point.name)
            if earlier is None:
                by_name[point.name] = point
                continue
            methods = tuple(dict.fromkeys((*earlier.methods, *point.methods)))
            by_name[point.name] = replace(point, methods=methods, draws=max(point.draws, earlier.draws))
    return tuple(by_name.values())


def points(study: Study, grid: ScenarioGrid) -> Iterator[Scenario]:
    """The points of one grid.  Raises UsageError or ModelError if a combination is none."""
    ranges = (grid.rigs, grid.unknowns, grid.frequencies, grid.noise, grid.samples, grid.covariance)
    for name, unknowns, frequencies, level, samples, basis in product(*ranges):
        rig = study.rigs[name]
        lines = study.frequencies[frequencies]
        counts = share_out(samples, len(lines)) if grid.in_all else samples
        model = rig.model if unknowns == ALL else with_unknowns(rig, study.unknowns[unknowns])
        factors: dict[str, str | float | int] = {
            "rig": name,
            "unknowns": unknowns,
            "frequencies": frequencies,
            "kind": grid.kind,
            "noise": float(level),
            ("in_all" if grid.in_all else "samples"): int(samples),
            "covariance": basis,
        }
        theta = model.theta({u.name: truth(rig, u.name) for u in model.unknowns})
        channels, test = _channels(study, grid, rig, level), _test(study, rig, lines, counts)
        how = (grid.methods, grid.draws, basis, study.drift, study.transients)
        yield Scenario(factors, model, theta, channels, test, *how)


def _test(study: Study, rig: TrueRig, lines: Sequence[float], counts: int | Ints) -> Dwells:
    inputs = {source.name for source in rig.model.inputs}
    amplitudes = {name: size for name, size in study.amplitudes.items() if name in inputs}
    return dwells(rig.model, lines, counts, amplitudes=amplitudes, periods=study.periods)


def _channels(study: Study, grid: ScenarioGrid, rig: TrueRig, level: float) -> tuple[Channel, ...]:
    match grid.kind:
        case "relative":
            return with_relative_noise(rig.model, rig.channels, level)
        case "channels":
            if not any(c.noise or c.relative_noise for c in rig.channels):
                cure = "add noise or relative_noise to its [channels]"
                raise UsageError("no channel of the rig states its noise", cure=cure)
            return tuple(
                replace(c, noise=level * c.noise, relative_noise=level * c.relative_noise)
                for c in rig.channels
            )
        case "constant":
            if grid.reference is None:
                cure = "name the frequencies at which it is taken"
                raise UsageError("constant noise needs a reference amplitude", cure=cure)
            model = rig.model
            theta = model.theta({u.name: truth(rig, u.name) for u in model.unknowns})
            reference = _test(study, rig, study.frequencies[grid.reference], 4)
            return with_constant_noise(model, model.parameters(theta), rig.channels, level, reference)


def share_out(samples: int, lines: int) -> Ints:
    """So many samples in all over the lines, the first ones taking the residual; (lines,).

    Raises UsageError if there are fewer than two for each.
    """
    if samples < 2 * lines:
        raise UsageError(
            f"{samples} samples are too few for {lines} frequencies", cure=f"use {2 * lines} or more"
        )
    return np.full(lines, samples // lines) + (np.arange(lines) < samples % lines)


def truth(rig: TrueRig, name: str) -> float:
    """The true value of a parameter: as stated for the study, or the rig's own value or guess.

    Raises UsageError if there is neither.
    """
    if name in rig.values:
        return float(rig.values[name])
    element = next(element for element in rig.model.elements if element.name == name)
    for number in (element.value, element.guess):
        if number is not None:
            return float(number)
    raise UsageError(f"the true value of {name} is not given", cure=f"add {name} to the values of the rig")


def with_unknowns(rig: TrueRig, names: Sequence[str]) -> Model:
    """The model with these parameters unknown and all others known exactly as they truly are.

    Raises UsageError for a name that is not a parameter of its own.
    """
    parameters = [element.name for element in rig.model.elements if element.same_as is None]
    for name in names:
        if name not in parameters:
            raise UsageError(f"{name} is not a parameter of the rig", cure=f"it has {listed(parameters)}")
    elements = []
    for element in rig.model.elements:
        if element.same_as is not None:
            elements.append(element)
        elif element.name in names:
            elements.append(replace(element, value=None, sd=None))
        else:
            value = truth(rig, element.name)
            elements.append(replace(element, value=value, sd=None, guess=None, lower=None, upper=None))
    return replace(rig.model, elements=tuple(elements))
