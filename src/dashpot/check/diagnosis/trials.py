"""Trials: the data as they would be had one thing been otherwise, and what the rig then makes of them.

Every remedy that leaves the rig as it is becomes one row of a batch: the same model fitted to other amplitudes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Complex, Ints, Real
from dashpot.estimate.likelihood.maximum_likelihood import local
from dashpot.estimate.likelihood.objective import Measured, ObservationModel, measured, observation_model, predict
from dashpot.estimate.likelihood.starting_values import candidates
from dashpot.estimate.linear.least_squares import compensated
from dashpot.estimate.method import Prepared
from dashpot.estimate.preparation.state_reconstruction import states_if_seen
from dashpot.numerics.levenberg_marquardt import QuadraticModel, minimise

DRAWS = 600  # rigs drawn at random as starts, ranked for every trial
STARTS = 3  # of them that are followed, beside the estimate's own
SHORT = 10  # iterations after which only the best start of a trial goes on
LONG = 25
REACH = (0.1, 10.0)  # times its stated frequency within which a dwell's own is looked for
LIMIT = 2.0  # nepers and radians beyond which a residual of logarithms counts no more


@dataclass(frozen=True)
class Trial:
    """The data under one supposition.

    y (lines, channels) and V (lines, channels, channels) as they would be; kept (lines, channels): what is used.
    """

    kind: str
    of: tuple[str, ...]
    value: float
    y: Complex
    V: Complex
    kept: Bools


@dataclass(frozen=True)
class Outcome:
    """What a trial's fit left: χ² at ψ (M,), with `dof` degrees of freedom."""

    trial: Trial
    chi2: float
    dof: int
    psi: Real

    @property
    def reduced(self) -> float:
        """χ² over its degrees of freedom."""
        return self.chi2 / max(self.dof, 1)


def untouched(data: Prepared) -> Trial:
    """The data of one repeat as they are."""
    y = data.spectrum.amplitudes[0]
    return Trial("", (), 1.0, np.nan_to_num(y), data.covariance[0], np.isfinite(y))


def scaled(base: Trial, kind: str, channel: str, index: int, factor: Complex | complex, value: float) -> Trial:
    """One channel times `factor`, a number or (lines,)."""
    turn = np.ones(base.y.shape, dtype=np.complex128)
    turn[:, index] = factor
    V = turn[:, :, None] * base.V * np.conj(turn)[:, None, :]
    return Trial(kind, (channel,), value, base.y * turn, V, base.kept)


def swapped(base: Trial, names: tuple[str, str], first: int, second: int) -> Trial:
    """Two channels exchanged."""
    order = np.arange(base.y.shape[1])
    order[[first, second]] = order[[second, first]]
    V = base.V[:, order][:, :, order]
    return Trial("swap", names, 1.0, base.y[:, order], V, base.kept[:, order])


def conjugated(base: Trial, kind: str, of: tuple[str, ...], chosen: Bools) -> Trial:
    """The phases of the chosen channels (channels,) count the other way; correlations between the two kinds are lost."""
    y = np.where(chosen, np.conj(base.y), base.y)
    both, neither = chosen[:, None] & chosen[None, :], ~chosen[:, None] & ~chosen[None, :]
    V = np.where(both, np.conj(base.V), np.where(neither, base.V, 0.0))
    return Trial(kind, of, 1.0, y, V, base.kept)


def without(base: Trial, kind: str, of: tuple[str, ...], dropped: Bools) -> Trial:
    """Some amplitudes left out, (lines, channels)."""
    return Trial(kind, of, 1.0, base.y, base.V, base.kept & ~dropped)


@dataclass(frozen=True)
class Workbench:
    """What the trials of one data set share: the data of one repeat, the view of it, the estimate ψ (M,) and signs."""

    data: Prepared
    view: ObservationModel
    psi: Real
    sign: Real

    def searched(self, trials: Sequence[Trial], seed: int = 0) -> list[Outcome]:
        """Each trial from the estimate, from drawn rigs and from its own least squares: for the few that need it."""
        prepared = [_prepared(self.data, trial) for trial in trials]
        arranged = [measured(one, self.view) for one in prepared]
        starts = _starts(
            self.data, self.view, trials, prepared, arranged, self.psi, self.sign, seed
        )
        return self._fitted(trials, arranged, starts)

    def refitted(self, trials: Sequence[Trial], pool: Sequence[Real]) -> list[Outcome]:
        """Each trial from the best of a pool of ψ, each (M,)."""
        if not trials:
            return []
        arranged = [measured(_prepared(self.data, trial), self.view) for trial in trials]
        return self._fitted(trials, arranged, [np.array(pool)] * len(trials), short=0)

    def expected(self, outcome: Outcome) -> Complex:
        """What the channels should show by a trial's fit, those that it left out as well, (lines, channels)."""
        data = measured(_prepared(self.data, outcome.trial), self.view)
        whole = replace(data, y=outcome.trial.y[None])
        with np.errstate(all="ignore"):
            fitted = predict(self.view, data, outcome.psi[None], self.sign[None])
            # The inputs are those of the trial; the residual is of every channel.
            at = predict(self.view, replace(whole, q=fitted.q), outcome.psi[None], self.sign[None])
        return outcome.trial.y - at.r[0]

    def misfit(self, psi: Real, trial: Trial) -> Real:
        """χ² of each line at ψ (M,), (lines,)."""
        data = measured(_prepared(self.data, trial), self.view)
        with np.errstate(all="ignore"):
            cost = predict(self.view, data, psi[None], self.sign[None]).cost_per_line[0]
        return np.where(np.isfinite(cost), cost, np.inf)

    def other_frequency(self, psi: Real, trial: Trial, line: int) -> tuple[float, float]:
        """The frequency (Hz) at which one line would fit best at ψ (M,), and its χ² there."""
        spectrum = self.data.spectrum
        low, high = np.log(REACH[0]), np.log(REACH[1])
        middle, left = float(spectrum.frequency_hz[line]), np.inf
        for points in (3000, 400):
            grid = middle * np.exp(np.linspace(low, high, points))
            cost = self._as_if_at(psi, trial, line, grid)
            middle, left = float(grid[int(np.argmin(cost))]), float(np.min(cost))
            low, high = (edge * 4 / points for edge in (low, high))
        return middle, left

    def _as_if_at(self, psi: Real, trial: Trial, line: int, grid: Real) -> Real:
        rows = [line] * len(grid)
        spectrum = replace(self.data.spectrum.select(rows), frequency_hz=grid)
        view = observation_model(self.data.model, spectrum.channels, spectrum.omega)
        there = replace(trial, y=trial.y[rows], V=trial.V[rows], kept=trial.kept[rows])
        data = measured(_prepared(replace(self.data, spectrum=spectrum), there), view)
        with np.errstate(all="ignore"):
            cost = predict(view, data, psi[None], self.sign[None]).cost_per_line[0]
        return np.where(np.isfinite(cost), cost, np.inf)

    def _fitted(
        self, trials: Sequence[Trial], arranged: Sequence[Measured], starts: Sequence[Real], short: int = SHORT
    ) -> list[Outcome]:
        ended: dict[int, Outcome] = {}
        for exact in (True, False):
            group = [t for t, one in enumerate(arranged) if (one.q is not None) == exact]
            if group:
                chosen = ([trials[t] for t in group], [arranged[t] for t in group], [starts[t] for t in group])
                ended |= dict(zip(group, _fits(self.view, *chosen, self.sign, short), strict=True))
        return [ended[t] for t in range(len(trials))]


def _prepared(data: Prepared, trial: Trial) -> Prepared:
    spectrum = replace(
        data.spectrum,
        amplitudes=np.where(trial.kept, trial.y, np.nan)[None],
        covariance=np.nan_to_num(trial.V)[None],
        moments=None,
    )
    return Prepared(data.model, spectrum, trial.V[None], None)


def _stack(arranged: Sequence[Measured], rows: Ints) -> Measured:
    q = None if arranged[0].q is None else np.concatenate([arranged[r].q for r in rows])  # type: ignore[misc]
    return Measured(
        np.concatenate([arranged[r].y for r in rows]),
        np.concatenate([np.broadcast_to(arranged[r].W, (1, *arranged[r].W.shape[1:])) for r in rows]),
        q,
        arranged[0].rows,
    )


def _fits(
    view: ObservationModel,
    trials: Sequence[Trial],
    arranged: Sequence[Measured],
    starts: Sequence[Real],
    sign: Real,
    short: int,
) -> list[Outcome]:
    """`short` steps from every start, then the best start of each trial to its end."""
    origin = np.repeat(np.arange(len(trials)), [len(start) for start in starts])
    x, cost = _descend(view, _stack(arranged, origin), np.concatenate(starts), sign, short)
    best = [np.flatnonzero(origin == t)[np.argmin(cost[origin == t])] for t in range(len(trials))]
    x, cost = _descend(view, _stack(arranged, np.arange(len(trials))), x[best], sign, LONG)
    unknowns = x.shape[1]
    return [
        Outcome(trial, float(cost[t]), arranged[t].rows - unknowns, x[t]) for t, trial in enumerate(trials)
    ]


def _descend(
    view: ObservationModel, data: Measured, start: Real, sign: Real, limit: int
) -> tuple[Real, Real]:
    signs = np.broadcast_to(sign, (len(start), len(sign)))
    if limit == 0:
        with np.errstate(all="ignore"):
            cost = local(view, data, start, signs).cost
        return start, np.where(np.isfinite(cost), cost, np.inf)

    def evaluate(psi: Real, rows: Ints) -> QuadraticModel:
        return local(view, data.pick(rows), psi, signs[rows])

    ended = minimise(evaluate, start, limit=limit, tolerance=1e-2)
    return ended.x, np.where(np.isfinite(ended.cost), ended.cost, np.inf)


def _starts(
    data: Prepared,
    view: ObservationModel,
    trials: Sequence[Trial],
    prepared: Sequence[Prepared],
    arranged: Sequence[Measured],
    psi: Real,
    sign: Real,
    seed: int,
) -> list[Real]:
    """For each trial the estimate, the rigs drawn that suit it best and, where all is seen, its own least squares."""
    drawn, _ = candidates(data, view, DRAWS, np.random.default_rng(seed))
    usable = np.all(np.isfinite(drawn), axis=1)
    drawn = drawn[usable]
    G = _transfers(view, arranged[0], drawn, sign)
    seen = data.states is not None
    starts = []
    for trial, one, exact in zip(trials, prepared, arranged, strict=True):
        chosen = drawn[np.argsort(_distance(G, exact, trial))[:STARTS]]
        rows = [psi[None], chosen]
        if seen and np.all(trial.kept == np.isfinite(data.spectrum.amplitudes[0])):
            states = states_if_seen(data.model, one.spectrum, one.covariance)
            if states is not None:
                own = compensated(data.model, states)
                rows.append(np.concatenate([own, np.broadcast_to(psi[own.shape[1] :], (1, len(psi) - own.shape[1]))], 1))
        starts.append(np.concatenate([row for row in rows if np.all(np.isfinite(row))]))
    return starts


def _transfers(view: ObservationModel, like: Measured, drawn: Real, sign: Real) -> Complex:
    """What each drawn rig's channels show per unit of each input, (draws, lines, channels, inputs)."""
    inputs = view.direct_q.shape[-1]
    lines, channels = like.y.shape[-2:]
    signs = np.broadcast_to(sign, (len(drawn), channels))
    columns = []
    with np.errstate(all="ignore"):
        for j in range(inputs):
            q = np.zeros((1, lines, inputs), dtype=np.complex128)
            q[..., j] = 1.0
            unit = Measured(np.zeros((1, lines, channels), dtype=complex), like.W[:1], q, like.rows)
            columns.append(-predict(view, unit, drawn, signs).r)
    return np.stack(columns, axis=-1)


def _distance(G: Complex, exact: Measured, trial: Trial) -> Real:
    """How far each drawn rig is from a trial's data, (draws,): robust logarithms of the channels, even weights."""
    used = trial.kept & (trial.y != 0)
    with np.errstate(all="ignore"):
        if exact.q is not None:
            shown = (G @ exact.q[0][..., None])[..., 0]
        else:
            size = np.where(used, 1 / np.maximum(np.abs(trial.y), 1e-300), 0.0)
            g, y = G * size[..., None], trial.y * size
            normal = np.conj(np.swapaxes(g, -1, -2)) @ g
            eye = 1e-9 * np.trace(normal, axis1=-2, axis2=-1)[..., None, None] * np.eye(G.shape[-1])
            v = np.linalg.solve(np.nan_to_num(normal + eye + 1e-300 * np.eye(G.shape[-1])),
                                np.nan_to_num(np.conj(np.swapaxes(g, -1, -2)) @ y[..., None]))  # fmt: skip
            shown = (G @ v)[..., 0]
        away = np.abs(np.log(np.where(used, trial.y / shown, 1.0))) ** 2
    away = np.where(np.isfinite(away), np.minimum(away, LIMIT**2), LIMIT**2)
    total: Real = np.sum(np.where(used, away, 0.0), axis=(-2, -1))
    return total
