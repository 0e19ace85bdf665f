"""−2 ln(likelihood) as its searches see it, and the descent from given starts to the minima near them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Ints, Real
from dashpot.estimate.likelihood.measured import Measured, compiled_cost, compiled_output
from dashpot.estimate.likelihood.objective import bounds, local, measured
from dashpot.estimate.linear.gram import compiled_result
from dashpot.estimate.preparation import Prepared
from dashpot.model.observation import ObservationModel, observation_model
from dashpot.model.reduced import ReducedRig
from dashpot.numerics.kernel import threads
from dashpot.numerics.levenberg_marquardt import PATIENCE, OptimizeResult, QuadraticModel, minimise

# Fewer lines for a search from many starts: the loudest of each part of the band.
#
# A whole record has thousands of lines, and a valley of the likelihood is as wide in a few hundred of them.


PARTS = 30  # of the band, equal in the logarithm of frequency
EACH = 3  # lines of a part


def thinned(data: Prepared, each: int = EACH) -> Prepared:
    """The same data with `each` lines of every part of the band where there are many; itself where there are few or all
    are settled."""
    spectrum = data.spectrum
    if spectrum.lines <= 200 * each / EACH or not spectrum.records:
        return data
    # Power of all channels over their noise, mean over repeats; (lines,)
    power = np.abs(np.nan_to_num(spectrum.amplitudes)) ** 2
    noise = np.diagonal(data.covariance, axis1=-2, axis2=-1).real
    noise = np.maximum(np.maximum(noise, 1e-6 * np.mean(power, axis=-2, keepdims=True)), 1e-300)
    lines = loudest(spectrum.frequency_hz, np.mean(np.sum(power / noise, axis=-1), axis=0), each)
    fewer = replace(
        spectrum.select(lines),
        amplitudes=spectrum.amplitudes[:, lines],
        covariance=spectrum.covariance[:, lines],
    )
    states = None if data.states is None else data.states.lines(lines)
    view = observation_model(data.model, fewer.channels, fewer.omega, fewer.experiment)
    return replace(data, view=view, spectrum=fewer, covariance=data.covariance[:, lines], states=states)


def loudest(frequency_hz: Real, loudness: Real, each: int = EACH) -> Ints:
    """Indices of the loudest lines in each part of the band, ascending.  Both (lines,)."""
    position = np.log(frequency_hz / np.min(frequency_hz))
    part = np.minimum((PARTS * position / max(float(np.max(position)), 1e-12)).astype(int), PARTS - 1)
    order = np.lexsort((-loudness, part))
    before = np.searchsorted(part[order], np.arange(PARTS))
    rank = np.arange(len(order)) - before[part[order]]
    return np.sort(order[rank < each])


ROUGH = 60  # iterations of a descent that need not end
NEAR_END = 1e-2  # standard deviations from the end of such a descent; the best are followed further


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
    exact: Measured
    lower: Real
    upper: Real
    effort: Effort

    @staticmethod
    def of(data: Prepared, effort: Effort) -> Likelihood:
        """That of prepared data."""
        return Likelihood(data, measured(data), *bounds(data.view, effort.positive), effort)

    @property
    def view(self) -> ObservationModel:
        """What the channels show."""
        return self.data.view

    def on_basis(self, rig: ReducedRig) -> Likelihood:
        """That of a large rig on the span of few motions."""
        return replace(self, data=replace(self.data, view=replace(self.view, reduced=rig)))

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
        self,
        data: Measured,
        start: Real,
        sign: Real,
        limit: int | None = None,
        repeats: Ints | None = None,
        *,
        near: float | None = None,
    ) -> OptimizeResult:
        """As `descend`, from start (k, M), in other data of the same channels: softened, or with more harmonics.

        It ends within `near` standard deviations, where that is given: roughly, and without Newton's own matrix.
        """
        most = self.effort.max_iterations if limit is None else limit
        rows = data.rows_of(len(start)) if repeats is None or len(data.y) == 1 else repeats
        # What depends on what among a record's columns is decided anew at each step: no nearer than that.
        tolerance = self.effort.tolerance if near is None else near
        if data.ends is not None:
            tolerance = max(tolerance, 1e-4)
        if data.nonlinear is not None:  # responses that are iterated themselves
            tolerance = max(tolerance, 1e-6)
        return Stage(self.view, data).descend(
            start,
            sign,
            rows,
            limit=most,
            tolerance=tolerance,
            lower=self.lower,
            upper=self.upper,
            patience=PATIENCE if near is None else most,
        )


@dataclass(frozen=True)
class Stage:
    """What a descent minimises: the likelihood of repeats in some data, or logarithms with weights."""

    view: ObservationModel
    data: Measured
    weight: Real | None = None

    def model_at(self, psi: Real, sign: Real, rows: Ints | slice = slice(None)) -> QuadraticModel:
        """Cost, slope and curvature at ψ (K, M) with signs (K, channels), in all repeats or the given."""
        return local(self.view, self.data.pick(rows), psi, sign, self.weight)

    def cost(self, psi: Real, sign: Real, rows: Ints | None = None) -> Real:
        """The cost at ψ (K, M), each in its repeat of `rows` or its own, inf where there is none; (K,)."""
        output = compiled_output(self.view, self.data)
        rows = self.data.rows_of(len(psi)) if rows is None else rows
        with np.errstate(all="ignore"):
            if output is None:
                data = self.data.pick(rows)
                total = local(self.view, data, psi, sign, self.weight, slopes=False).cost
            else:
                total = compiled_cost(output, psi, sign, rows, self.weight)
        return np.where(np.isfinite(total), total, np.inf)

    def descend(
        self,
        start: Real,
        sign: Real,
        rows: Ints,
        *,
        limit: int,
        tolerance: float,
        lower: Real | float = -np.inf,
        upper: Real | float = np.inf,
        patience: int = PATIENCE,
        log: Bools | None = None,
    ) -> OptimizeResult:
        """Minimise from each `start`, (k, M), with `sign` (k, channels), in the repeat `rows` (k,) of the data.

        Unknowns that are `log` (M,) move in their logarithms, in which start and bounds then are, by 1 at once at most.
        """
        endless = np.full(start.shape[-1], np.inf)
        low: Real = np.maximum(lower, -endless)
        high: Real = np.minimum(upper, endless)
        longest = endless if log is None else np.where(log, 1.0, np.inf)
        output = compiled_output(self.view, self.data)
        if output is not None:
            start, sign = (np.ascontiguousarray(part, dtype=np.float64) for part in (start, sign))
            ended = output.descend(
                start, sign, rows, self.weight, low, high, longest, log, limit, tolerance, patience, threads()
            )
            return compiled_result(ended)

        def evaluate(x: Real, active: Ints) -> QuadraticModel:
            if log is None:
                return self.model_at(x, sign[active], rows[active])
            at = np.where(log, np.exp(np.where(log, x, 0.0)), x)
            around = self.model_at(at, sign[active], rows[active])
            chain = np.where(log, at, 1.0)
            both = chain[:, :, None] * chain[:, None, :]
            return QuadraticModel(
                around.cost, around.gradient * chain, around.symmetric * both, around.free * both
            )

        return minimise(
            evaluate,
            start,
            limit=limit,
            tolerance=tolerance,
            lower=low,
            upper=high,
            longest=longest,
            patience=patience,
        )


def descend_all(
    stage: Stage,
    psi: Real,
    sign: Real,
    rows: Ints | None = None,
    *,
    lower: Real | float = -np.inf,
    upper: Real | float = np.inf,
    limit: int = ROUGH,
) -> Real:
    """Where many starts end, each in its repeat of `rows` (k,); in logarithms of what is positive in all."""
    rows = stage.data.rows_of(len(psi)) if rows is None else rows
    log = (np.arange(psi.shape[-1]) < stage.view.m) & np.all(psi > 0, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = np.where(log, np.log(np.where(log, psi, 1.0)), psi)
        low = np.where(log, np.log(np.maximum(lower, 0.0)), lower)
        high = np.where(log, np.log(np.maximum(upper, 0.0)), upper)
    # No further than 20 decades from the starts: what is hardly seen must not run out of the range of numbers.
    low = np.where(log, np.maximum(low, np.min(x, axis=0) - 46), lower)
    high = np.where(log, np.minimum(high, np.max(x, axis=0) + 46), upper)
    ends = stage.descend(
        x, sign, rows, limit=limit, tolerance=NEAR_END, lower=low, upper=high, patience=limit, log=log
    )
    return np.where(log, np.exp(np.where(log, ends.x, 0.0)), ends.x)
