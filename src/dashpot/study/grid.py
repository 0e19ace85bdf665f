"""What a study varies: grids over rigs, unknowns, frequencies, noise and samples, spread out into scenarios."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from types import MappingProxyType
from typing import Literal

import numpy as np

from dashpot.arrays import Ints
from dashpot.channel import Channel
from dashpot.errors import UsageError
from dashpot.io.words import listed
from dashpot.model.network import Model
from dashpot.model.observation import with_relative_noise
from dashpot.study.scenario import Scenario
from dashpot.study.simulate import Dwells, NoiseBasis, dwells, with_constant_noise

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

    Raises UsageError or ModelError where a combination is none.
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


def points(study: Study, grid: ScenarioGrid) -> list[Scenario]:
    """The points of one grid.  Raises UsageError or ModelError where a combination is none."""
    return list(_points(study, grid))


def _points(study: Study, grid: ScenarioGrid) -> Iterator[Scenario]:
    ranges = (grid.rigs, grid.unknowns, grid.frequencies, grid.noise, grid.samples, grid.covariance)
    for name, unknowns, frequencies, level, samples, basis in product(*ranges):
        rig = study.rigs[name]
        lines = study.frequencies[frequencies]
        counts = share_out(samples, len(lines)) if grid.in_all else np.full(len(lines), samples)
        model = rig.model
        if unknowns != ALL:
            model = with_unknowns(rig, study.unknowns[unknowns])
        factors: dict[str, str | float | int] = {
            "rig": name,
            "unknowns": unknowns,
            "frequencies": frequencies,
            "kind": grid.kind,
            "noise": float(level),
            ("in_all" if grid.in_all else "samples"): int(samples),
            "covariance": basis,
        }
        yield Scenario(
            factors,
            model,
            model.theta({u.name: truth(rig, u.name) for u in model.unknowns}),
            _channels(study, grid, rig, level),
            _test(study, rig, lines, counts),
            grid.methods,
            grid.draws,
            basis,
            study.drift,
            study.transients,
        )


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
                raise UsageError(
                    "no channel of the rig states its noise",
                    cure="add noise or relative_noise to its [channels]",
                )
            return tuple(
                replace(c, noise=level * c.noise, relative_noise=level * c.relative_noise)
                for c in rig.channels
            )
        case "constant":
            if grid.reference is None:
                raise UsageError(
                    "constant noise has no size", cure="name the frequencies of its reference amplitude"
                )
            model = rig.model
            theta = model.theta({u.name: truth(rig, u.name) for u in model.unknowns})
            reference = _test(study, rig, study.frequencies[grid.reference], 4)
            return with_constant_noise(model, model.parameters(theta), rig.channels, level, reference)


def share_out(samples: int, lines: int) -> Ints:
    """So many samples in all over the lines, the first ones taking what is left over; (lines,).

    Raises UsageError where there are fewer than two for each.
    """
    if samples < 2 * lines:
        raise UsageError(
            f"{samples} samples are too few for {lines} frequencies", cure=f"take {2 * lines} or more"
        )
    return np.full(lines, samples // lines) + (np.arange(lines) < samples % lines)


def truth(rig: TrueRig, name: str) -> float:
    """The true value of a parameter: as stated for the study, or the rig's own value or guess.

    Raises UsageError where there is neither.
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
