"""−2 ln(likelihood) as its searches see it, and the descent from given starts to the minima near them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Ints, Real
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.compiled import compiled_cost, compiled_descent, compiled_output
from dashpot.estimate.likelihood.objective import bounds, local, logarithmic, measured
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.channel_transfer import Reduced
from dashpot.model.observation import ObservationModel, observation_model
from dashpot.numerics.levenberg_marquardt import PATIENCE, OptimizeResult, QuadraticModel, minimise

RECORD_TOLERANCE = 1e-4  # standard deviations, of whole records
HARMONIC_TOLERANCE = 1e-6  # standard deviations, of responses that are iterated themselves
ROUGH = 60  # iterations of a descent that need not end


@dataclass(frozen=True)
class Effort:
    """How far a search goes: the settings of MaximumLikelihood, whose fields these are."""

    starts: int
    candidates: int
    rounds: int
    positive: bool
    max_iterations: int
    tolerance: float
    seed: int


@dataclass(frozen=True)
class Likelihood:
    """The likelihood of K repeats, its bounds, and how hard it is searched."""

    data: Prepared
    view: ObservationModel
    exact: Measured
    lower: Real
    upper: Real
    effort: Effort

    @staticmethod
    def of(data: Prepared, effort: Effort, on_basis: Reduced | None = None) -> Likelihood:
        """That of prepared data, of the reduced rig where there is one.

        Raises DataError where a channel measures what the model has not.
        """
        view = observation_model(data.model, data.spectrum.channels, data.spectrum.omega)
        view = view if on_basis is None else replace(view, reduced=on_basis)
        return Likelihood(data, view, measured(data, view), *bounds(view, effort.positive), effort)

    @property
    def repeats(self) -> int:
        """K."""
        return len(self.exact.y)

    def only(self, repeat: int) -> Likelihood:
        """That of one of the repeats, weighed as with the others."""
        return replace(self, data=self.data.only(repeat), exact=self.exact.pick(np.array([repeat])))

    def model_at(self, psi: Real, sign: Real) -> QuadraticModel:
        """Cost, slope and curvature at ψ (K, M) with signs (K, channels)."""
        return local(self.view, self.exact, psi, sign)

    def descend(
        self, start: Real, sign: Real, *, repeats: Ints | None = None, limit: int | None = None
    ) -> OptimizeResult:
        """Minimise from `start`, (k, M), with `sign` (k, channels), for all or some of the repeats."""
        return self.descend_in(self.exact, start, sign, limit, repeats)

    def descend_in(
        self, data: Measured, start: Real, sign: Real, limit: int | None = None, repeats: Ints | None = None
    ) -> OptimizeResult:
        """As `descend`, in other data of the same channels: softened, or with more harmonics."""
        most = self.effort.max_iterations if limit is None else limit
        output = compiled_output(self.view, data)
        if output is not None:
            rows = data.rows_of(len(start)) if repeats is None or len(data.y) == 1 else repeats
            return compiled_descent(
                output, start, sign, rows, lower=self.lower, upper=self.upper, limit=most,
                tolerance=self.effort.tolerance, patience=PATIENCE,
            )  # fmt: skip
        data = data if repeats is None else data.pick(repeats)

        def evaluate(psi: Real, rows: Ints) -> QuadraticModel:
            return local(self.view, data.pick(rows), psi, sign[rows])

        # What depends on what among a record's columns is decided anew at each step: no nearer than that.
        tolerance = self.effort.tolerance
        near = tolerance if data.ends is None else max(tolerance, RECORD_TOLERANCE)
        near = near if data.nonlinear is None else max(tolerance, HARMONIC_TOLERANCE)
        return minimise(evaluate, start, limit=most, tolerance=near, lower=self.lower, upper=self.upper)


@dataclass(frozen=True)
class Stage:
    """What a search from afar minimises for one repeat: its likelihood in some data, or logarithms with weights."""

    view: ObservationModel
    data: Measured
    weight: Real | None = None

    def model_at(self, psi: Real, sign: Real) -> QuadraticModel:
        """Cost, slope and curvature at ψ (K, M) with signs (K, channels)."""
        if self.weight is None:
            return local(self.view, self.data, psi, sign)
        return logarithmic(self.view, self.data, self.weight, psi, sign)

    def cost(self, psi: Real, sign: Real) -> Real:
        """The cost at ψ (K, M), inf where there is none; (K,)."""
        output = compiled_output(self.view, self.data)
        with np.errstate(all="ignore"):
            if output is None:
                total = self.model_at(psi, sign).cost
            else:
                total = compiled_cost(output, psi, sign, self.data.rows_of(len(psi)), self.weight)
        return np.where(np.isfinite(total), total, np.inf)


def descend_all(likelihood: Likelihood, stage: Stage, psi: Real, sign: Real) -> Real:
    """Where many starts of one repeat end; in logarithms of the rig's parameters where they are all positive."""
    lower, upper = likelihood.lower, likelihood.upper
    log = (np.arange(psi.shape[-1]) < likelihood.view.m) & np.all(psi > 0, axis=0)

    def evaluate(x: Real, rows: Ints) -> QuadraticModel:
        at = np.where(log, np.exp(np.where(log, x, 0.0)), x)
        around = stage.model_at(at, sign[rows])
        chain = np.where(log, at, 1.0)
        both = chain[:, :, None] * chain[:, None, :]
        return QuadraticModel(
            around.cost, around.gradient * chain, around.symmetric * both, around.free * both
        )

    with np.errstate(divide="ignore", invalid="ignore"):
        x = np.where(log, np.log(np.where(log, psi, 1.0)), psi)
        low = np.where(log, np.log(np.maximum(lower, 0.0)), lower)
        high = np.where(log, np.log(np.maximum(upper, 0.0)), upper)
    # No further than 20 decades from the starts: what is hardly seen must not run out of the range of numbers.
    low = np.where(log, np.maximum(low, np.min(x, axis=0) - 46), lower)
    high = np.where(log, np.minimum(high, np.max(x, axis=0) + 46), upper)
    longest = np.where(log, 1.0, np.inf)
    output = compiled_output(stage.view, stage.data)
    if output is None:
        ends = minimise(
            evaluate, x, limit=ROUGH, tolerance=1e-6, lower=low, upper=high, longest=longest, patience=ROUGH
        )
    else:
        ends = compiled_descent(
            output, x, sign, stage.data.rows_of(len(x)), lower=low, upper=high, limit=ROUGH, tolerance=1e-6,
            patience=ROUGH, longest=longest, logarithmic=log, weight=stage.weight,
        )  # fmt: skip
    return np.where(log, np.exp(np.where(log, ends.x, 0.0)), ends.x)
