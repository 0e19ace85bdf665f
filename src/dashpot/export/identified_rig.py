"""A rig with values for all its unknowns and their covariance: what every export starts from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Frozen, Real
from dashpot.channel import Channel
from dashpot.errors import DataError, ModelError
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import calibration_names, measures_input
from dashpot.model.rigfile import Rig

INSTEAD = "export its parameters (.csv, .parquet or .m)"


@dataclass(frozen=True)
class IdentifiedRig(Frozen):
    """A model with its channels, values θ (unknowns,) and their covariance (unknowns, unknowns), SI units.

    `estimate` is what they come from, where they come from one.
    """

    model: Model
    channels: tuple[Channel, ...]
    theta: Real
    covariance: Real
    estimate: Estimate | None = None

    @property
    def p(self) -> Real:
        """Parameters of the elements, (elements,)."""
        return self.model.parameters(self.theta)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of θ."""
        return self.model.unknown_names

    @property
    def outputs(self) -> tuple[Channel, ...]:
        """Channels that show more than inputs."""
        return tuple(c for c in self.channels if not measures_input(self.model, c))

    def require_linear(self, what: str) -> None:
        """Raises ModelError if an element has a nonlinear law, which `what` cannot hold."""
        if len(self.model.nonlinear):
            names = ", ".join(self.model.elements[i].name for i in self.model.nonlinear)
            raise ModelError(f"{what} cannot represent the nonlinear law of {names}", cure=INSTEAD)

    def require_viscous(self, what: str) -> None:
        """Raises ModelError if a motion in time is not determined: hysteretic dampers, and as `require_linear`."""
        self.require_linear(what)
        hysteretic = self.model.by_matrix["H"]
        if len(hysteretic):
            names = ", ".join(self.model.elements[i].name for i in hysteretic)
            cause = f"{what} cannot represent the hysteretic damping of {names}, which is a law of steady vibration"
            raise ModelError(cause, cure="use viscous dampers, or export frequency responses")


def identified_rig(
    rig: Rig,
    estimate: Estimate | None = None,
    values: Mapping[str, float] | None = None,
    *,
    experiment: str | None = None,
) -> IdentifiedRig:
    """A rig with the values of an estimate; without one, with `values` by name (SI units), known values and guesses.

    As it is in one `experiment` of its own, None: in none.
    Raises DataError if the estimate is of another rig or a batch, ModelError if an unknown has no value.
    """
    here = rig.in_experiment(experiment)
    model, unknowns = here.model, rig.model.unknown_names
    if estimate is None:
        sd = [0.0 if unknown.sd is None else unknown.sd for unknown in model.unknowns]
        theta = model.theta({} if values is None else values)
        return IdentifiedRig(model, here.channels, theta, np.diag(np.square(sd)))
    if estimate.values.ndim != 1:
        raise DataError("a batch of estimates cannot be exported", cure="choose one of them")
    estimate.require_unknowns(unknowns, calibration_names(rig.all_channels))
    at = [unknowns.index(name) for name in model.unknown_names]
    V = estimate.covariance[np.ix_(at, at)]
    return IdentifiedRig(model, here.channels, estimate.values[at], V, estimate)
