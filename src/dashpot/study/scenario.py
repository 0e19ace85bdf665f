"""A scenario: one point of a study."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from dashpot.arrays import Real, freeze
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.design.transients import lines_of_dwells, unsettled_dwells
from dashpot.errors import UsageError
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.registry import method_class
from dashpot.model.network import Model
from dashpot.study.simulate import (
    Dwells,
    NoiseBasis,
    SettledMotion,
    clean_spectrum,
    settled_motion,
    settled_spectrum,
    simulate_spectrum,
    with_noise_drawn,
)
from dashpot.study.store import fields_of, fingerprint_of


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

    def __getstate__(self) -> dict[str, object]:
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return values | {"factors": dict(self.factors)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "factors", MappingProxyType(dict(self.factors)))

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

        Raises DashpotError where the test does not determine the unknowns.
        """
        if self.transients:
            start = MaximumLikelihood(start=tuple(self.theta.tolist()))
            return identify(self.model, self._unsettled, start).bound_sd
        if len(self.model.nonlinear):
            clean = settled_spectrum(self._settled(), self.test, None)
        else:
            clean = clean_spectrum(self.model, self.p, self.channels, self.test, drift=self.drift)
        return identify(self.model, clean, automatic(self.model, clean)).bound_sd

    def drawn(self, rng: np.random.Generator, draws: int) -> Spectrum:
        """Repeats of the test, drawn for all methods alike.

        Raises DataError where a dwell has too few samples, UsageError where a nonlinear rig is to be told noise by its
        residuals or sample moments, or a test with transients more than they know, ConvergenceError where a rig has no
        settled motion.
        """
        if self.transients:
            return with_noise_drawn(self._unsettled, rng, draws)
        moments = any(method_class(name).traits.moments for name in self.methods)
        if not len(self.model.nonlinear):
            return simulate_spectrum(
                self.model, self.p, self.channels, self.test, rng,
                draws=draws, noise=self.noise, moments=moments, drift=self.drift,
            )  # fmt: skip
        if self.noise != "given":
            raise UsageError(
                "studies of nonlinear rigs need the noise to be given", cure='write covariance = "given"'
            )
        return settled_spectrum(self._settled(), self.test, rng, draws=draws)

    @cached_property
    def _unsettled(self) -> Spectrum:
        """The lines of the dwells with their transients, without noise."""
        if len(self.model.nonlinear) or self.noise != "given" or self.drift is not None:
            raise UsageError(
                "studies with transients know linear rigs, noise that is given, and no drift",
                cure='write covariance = "given" and no drift, or leave transients out',
            )
        test = self.test
        records = unsettled_dwells(
            self.model, self.p, self.channels, test.frequency_hz, np.concatenate([test.U, test.f], axis=-1),
            test.samples.tolist(), (test.periods / test.frequency_hz / test.samples).tolist(),
        )  # fmt: skip
        return lines_of_dwells(records, self.channels, joined=False)

    def _settled(self) -> SettledMotion:
        return settled_motion(self.model, self.theta, self.channels, self.test)
