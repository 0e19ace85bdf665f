"""Fits of many trials at once: the same rig and view, other amplitudes, from starts that each trial can use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.check.diagnosis.trials import Outcome, Trial, prepared
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.descent import Stage, descend_all, descend_in_repeats
from dashpot.estimate.likelihood.objective import directly_driven, measured, predict
from dashpot.estimate.likelihood.starting_values import candidates
from dashpot.estimate.linear.least_squares import compensated
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import states_if_seen
from dashpot.model.observation import ObservationModel, calibration_factors, observation_model, transfer

DRAWS = 1500  # rigs drawn at random as starts, ranked for every trial
FEWER_DRAWS = 200  # where all motion is seen, which gives a start of its own
FEW, MANY = 3, 12  # of them that are followed: where all is seen, and elsewhere
SOFTNESS = 0.05  # relative noise added in the stage between logarithms and the likelihood
SHORT = 8  # iterations after which only the best start of a trial goes on
GLANCE = 3  # iterations after which only the best trials go on
KEPT = 16  # of them
LONG = 30
ROUGHLY = 1e-2  # standard deviations at which a descent ends
LIMIT = 2.0  # nepers and radians beyond which a residual of logarithms counts no more
RATES, RATE_POINTS = (1 / 7, 7.0), 1500  # times all frequencies, in which the clock's own is looked for
REACH = (0.1, 10.0)  # times its stated frequency within which a dwell's own is looked for


@dataclass(frozen=True)
class Workbench:
    """What the trials of one data set share: the data of one repeat, the estimate ψ (M,) and signs.

    lines_are_runs: whether each line was measured at a time of its own, not all of them in one record.
    kept: what was drawn once.
    """

    data: Prepared
    psi: Real
    sign: Real
    lines_are_runs: bool = True
    kept: dict[tuple[int, int], tuple[Real, Complex]] = field(default_factory=dict)

    @property
    def view(self) -> ObservationModel:
        """What the channels show."""
        return self.data.view

    def searched(self, trials: Sequence[Trial], seed: int = 0, draws: int = DRAWS) -> list[Outcome]:
        """Each trial from the estimate, its own least squares and drawn rigs: thorough, for the few that need it."""
        if not trials:
            return []
        arranged = [self._arranged(trial) for trial in trials]
        by_equation = self._own(trials)
        drawn, G = self._drawn(seed, draws)
        followed = FEW if self.data.states is not None else MANY
        best = [
            drawn[np.argsort(_distance(G, one, trial))[:followed]]
            for trial, one in zip(trials, arranged, strict=True)
        ]
        if self.data.states is None:
            best = self._from_afar(trials, arranged, best)
        starts = [_finite([self.psi[None], *by_equation[t], best[t]]) for t in range(len(trials))]
        return self._followed(trials, arranged, starts)

    def _drawn(self, seed: int, draws: int) -> tuple[Real, Complex]:
        """Rigs drawn at random, ψ (k, M), and what their channels show of the inputs; once for all searches."""
        if (seed, draws) not in self.kept:
            drawn, _ = candidates(self.data, draws, np.random.default_rng(seed))
            drawn = drawn[np.all(np.isfinite(drawn), axis=1)]
            with np.errstate(all="ignore"):
                G = transfer(self.view, self.data.model.parameters(drawn[:, : self.view.m])).G
                signs = np.broadcast_to(self.sign, (len(drawn), len(self.sign)))
                G = calibration_factors(self.view, drawn, signs)[..., None] * G
            self.kept[seed, draws] = drawn, G
        return self.kept[seed, draws]

    def refitted(self, trials: Sequence[Trial], pool: Sequence[Real]) -> list[Outcome]:
        """Each trial from its own least squares or the best of a pool of ψ (M,); the hopeless a few steps only."""
        if not trials:
            return []
        arranged = [self._arranged(trial) for trial in trials]
        by_equation = self._own(trials)
        starts = [_finite([np.array(pool), *by_equation[t]]) for t in range(len(trials))]
        first = self._fitted(arranged, starts, 0)
        glance = self._fitted(arranged, [x[None] for x, _ in first], GLANCE)
        dof = np.array([max(one.rows - len(self.psi), 1) for one in arranged])
        hopeful = np.argsort(np.array([cost for _, cost in glance]) / dof)[:KEPT].tolist()
        long = self._fitted([arranged[t] for t in hopeful], [glance[t][0][None] for t in hopeful], LONG)
        ends = list(glance)
        for t, end in zip(hopeful, long, strict=True):
            ends[t] = end
        return self._outcomes(trials, arranged, ends)

    def inputs(self, outcome: Outcome) -> Complex:
        """Amplitudes of the inputs by a trial's fit, (lines, r + s)."""
        with np.errstate(all="ignore"):
            fitted = predict(self.view, self._arranged(outcome.trial), outcome.psi[None], self.sign[None])
        q: Complex = fitted.q[0]
        return q

    def expected(self, outcome: Outcome) -> Complex:
        """What the channels should show by a trial's fit, those that it left out as well, (lines, channels)."""
        data, q = self._arranged(outcome.trial), self.inputs(outcome)[None]
        with np.errstate(all="ignore"):
            # The inputs are those of the trial; the residual is of every channel.
            every = replace(data, y=outcome.trial.y[None], q=q)
            at = predict(self.view, every, outcome.psi[None], self.sign[None])
        shown: Complex = outcome.trial.y - at.r[0]
        return shown

    def judged(self, trials: Sequence[Trial]) -> list[Outcome]:
        """Each trial at the workbench's own ψ, as it is."""
        if not trials:
            return []
        arranged = [self._arranged(trial) for trial in trials]
        return self._outcomes(trials, arranged, self._fitted(arranged, [self.psi[None]] * len(trials), 0))

    def misfit(self, psi: Real, trial: Trial) -> Real:
        """χ² of each line at ψ (M,), (lines,)."""
        with np.errstate(all="ignore"):
            at = predict(self.view, self._arranged(trial), psi[None], self.sign[None])
        cost = at.cost_per_line[0]
        return np.where(np.isfinite(cost), cost, np.inf)

    def other_frequency(self, psi: Real, trial: Trial, line: int) -> tuple[float, float]:
        """The frequency (Hz) at which one line would fit best at ψ (M,), and its χ² there."""
        middle, left = float(self.data.spectrum.frequency_hz[line]), np.inf
        low, high = np.log(REACH[0]), np.log(REACH[1])
        for points in (3000, 400):
            grid = middle * np.exp(np.linspace(low, high, points))
            cost = self._as_if_at(psi, trial, np.full(points, line), grid)
            middle, left = float(grid[int(np.argmin(cost))]), float(np.min(cost))
            low, high = (edge * 4 / points for edge in (low, high))
        return middle, left

    def other_rate(self, trial: Trial) -> tuple[float, float]:
        """The factor of all frequencies with which the lines fit best at the workbench's own ψ, and what they leave."""
        lines, middle, left = np.arange(len(trial.y)), 1.0, np.inf
        low, high = np.log(RATES[0]), np.log(RATES[1])
        for points in (RATE_POINTS, 60):
            rates = middle * np.exp(np.linspace(low, high, points))
            at = (rates[:, None] * self.data.spectrum.frequency_hz).ravel()
            cost = self._as_if_at(self.psi, trial, np.tile(lines, points), at).reshape(points, -1).sum(axis=1)
            middle, left = float(rates[int(np.argmin(cost))]), float(np.min(cost))
            low, high = (2 * edge / points for edge in (low, high))
        return middle, left / max(self._arranged(trial).rows - len(self.psi), 1)

    def _as_if_at(self, psi: Real, trial: Trial, rows: Ints, at: Real) -> Real:
        """χ² of some lines (rows,), were they at other frequencies (rows,)."""
        spectrum = replace(self.data.spectrum.select(rows), frequency_hz=at)
        view = observation_model(self.data.model, spectrum.channels, spectrum.omega)
        there = replace(trial, y=trial.y[rows], V=trial.V[rows], kept=trial.kept[rows])
        data = measured(prepared(replace(self.data, view=view, spectrum=spectrum), there))
        with np.errstate(all="ignore"):
            cost = predict(view, data, psi[None], self.sign[None]).cost_per_line[0]
        return np.where(np.isfinite(cost), cost, np.inf)

    def _arranged(self, trial: Trial, softness: float = 0.0) -> Measured:
        return measured(prepared(self.data, trial), softness)

    def _own(self, trials: Sequence[Trial]) -> list[list[Real]]:
        """Noise-compensated least squares of each trial's own lines, (1, M), where all is seen there; else nothing."""
        by_equation: list[list[Real]] = [[] for _ in trials]
        if self.data.states is None:
            return by_equation
        whole = np.isfinite(self.data.spectrum.amplitudes[0])
        groups: dict[bytes, list[int]] = {}
        for t, trial in enumerate(trials):
            lines = np.any(trial.kept, axis=1)
            if np.array_equal(trial.kept, whole & lines[:, None]):
                groups.setdefault(lines.tobytes(), []).append(t)
        for rows in groups.values():
            lines = np.flatnonzero(np.any(trials[rows[0]].kept, axis=1))
            Y = np.stack([np.where(whole, trials[t].y, np.nan)[lines] for t in rows])
            V = np.stack([trials[t].V[lines] for t in rows])
            part = self.data.spectrum.select(lines)
            spectrum = replace(part, amplitudes=Y, covariance=np.nan_to_num(V), moments=None)
            view = observation_model(self.data.model, part.channels, part.omega)
            states = states_if_seen(view, spectrum, V)
            if states is None:
                continue
            with np.errstate(all="ignore"):
                theta = compensated(self.data.model, states)
            for t, values in zip(rows, theta, strict=True):
                by_equation[t] = [np.concatenate([values, self.psi[len(values) :]])[None]]
        return by_equation

    def _from_afar(
        self, trials: Sequence[Trial], arranged: Sequence[Measured], starts: Sequence[Real]
    ) -> list[Real]:
        """Where the starts lead by logarithms of the channels, then with softened weights; and the starts alone.

        Trials whose inputs no channel shows go through the second stage alone.
        """
        ends = list(starts)
        driven = [directly_driven(self.view, one) for one in arranged]
        shown = {t: one for t, one in enumerate(driven) if one is not None and one.q is not None}
        if shown:
            past = self._in_logarithms(list(shown.values()), [starts[t] for t in shown], by_logarithms=True)
            for t, psi in zip(shown, past, strict=True):
                ends[t] = psi
        soft = [self._arranged(trial, SOFTNESS) for trial in trials]
        both = [np.concatenate([ends[t], starts[t]]) for t in range(len(trials))]
        for group in _alike(soft):
            past = self._in_logarithms([soft[t] for t in group], [both[t] for t in group])
            for t, psi in zip(group, past, strict=True):
                ends[t] = psi
        return ends

    def _descended(self, data: Measured, start: Real, rows: Ints, limit: int) -> tuple[Real, Real]:
        sign = self._signs(start)
        if limit == 0:
            return start, Stage(self.view, data).cost(start, sign, rows)
        return descended(self.view, data, start, sign, rows, limit)

    def _in_logarithms(
        self, arranged: Sequence[Measured], starts: Sequence[Real], *, by_logarithms: bool = False
    ) -> list[Real]:
        """Where each trial's starts end that move in logarithms; the channels may be compared by theirs as well."""
        data, start = _stack(arranged), np.concatenate(starts)
        # What a trial leaves out is 0 in its amplitudes, which logarithms pass over.
        stage = Stage(self.view, data, np.ones(data.y.shape[1:]) if by_logarithms else None)
        trial = np.repeat(np.arange(len(starts)), [len(psi) for psi in starts])
        ends = descend_all(stage, start, self._signs(start), trial, limit=LONG, tolerance=ROUGHLY)
        return [ends[trial == t] for t in range(len(starts))]

    def _signs(self, psi: Real) -> Real:
        return np.broadcast_to(self.sign, (len(psi), len(self.sign)))

    def _followed(
        self, trials: Sequence[Trial], arranged: Sequence[Measured], starts: Sequence[Real]
    ) -> list[Outcome]:
        short = self._fitted(arranged, starts, SHORT)
        return self._outcomes(trials, arranged, self._fitted(arranged, [x[None] for x, _ in short], LONG))

    def _outcomes(
        self, trials: Sequence[Trial], arranged: Sequence[Measured], ends: Sequence[tuple[Real, float]]
    ) -> list[Outcome]:
        return [
            Outcome(trial, cost, one.rows - len(x), x)
            for trial, one, (x, cost) in zip(trials, arranged, ends, strict=True)
        ]

    def _fitted(
        self, arranged: Sequence[Measured], starts: Sequence[Real], limit: int
    ) -> list[tuple[Real, float]]:
        """The best end, ψ (M,) and χ², of each trial's starts, after `limit` iterations at most."""
        ends: list[tuple[Real, float]] = [(self.psi, np.inf)] * len(arranged)
        for group in _alike(arranged):
            origin = np.repeat(np.arange(len(group)), [len(starts[t]) for t in group])
            data = _stack([arranged[t] for t in group])
            x, cost = self._descended(data, np.concatenate([starts[t] for t in group]), origin, limit)
            for k, t in enumerate(group):
                mine = np.flatnonzero(origin == k)
                best = mine[int(np.argmin(cost[mine]))]
                ends[t] = (x[best], float(cost[best]))
        return ends


def _finite(rows: Sequence[Real]) -> Real:
    stacked = np.concatenate(rows)
    return stacked[np.all(np.isfinite(stacked), axis=1)]


def descended(
    view: ObservationModel, data: Measured, start: Real, sign: Real, rows: Ints, limit: int
) -> tuple[Real, Real]:
    """Ends ψ (k, M) and χ² (k,), inf where there is none, of starts in the repeats `rows`, near enough to compare."""
    with np.errstate(all="ignore"):
        ended = descend_in_repeats(view, data, start, sign, rows, limit=limit, tolerance=ROUGHLY)
    return ended.x, np.where(np.isfinite(ended.cost), ended.cost, np.inf)


def _alike(arranged: Sequence[Measured]) -> list[list[int]]:
    """Which trials give the inputs exactly and which do not: only like ones go into one batch."""
    exact = [t for t, one in enumerate(arranged) if one.q is not None]
    return [group for group in (exact, [t for t in range(len(arranged)) if t not in exact]) if group]


def _stack(arranged: Sequence[Measured]) -> Measured:
    """One batch with a repeat for each trial; all give the inputs exactly, or none does."""
    inputs = [one.q for one in arranged if one.q is not None]
    return Measured(
        np.concatenate([one.y for one in arranged]),
        np.concatenate([one.W[:1] for one in arranged]),
        np.concatenate(inputs) if inputs else None,
        arranged[0].rows,
    )


def _distance(G: Complex, exact: Measured, trial: Trial) -> Real:
    """How far each drawn rig is from a trial's data, (draws,): bounded logarithms of the channels, even weights."""
    used = trial.kept & (trial.y != 0)
    with np.errstate(all="ignore"):
        if exact.q is not None:
            shown = (G @ exact.q[0][..., None])[..., 0]
        else:
            size = np.where(used, 1 / np.maximum(np.abs(trial.y), 1e-300), 0.0)
            g, y = G * size[..., None], trial.y * size
            gh = np.conj(np.swapaxes(g, -1, -2))
            normal = np.nan_to_num(gh @ g)
            small = 1e-9 * np.trace(normal, axis1=-2, axis2=-1).real + 1e-300
            v = np.linalg.solve(
                normal + small[..., None, None] * np.eye(G.shape[-1]), np.nan_to_num(gh @ y[..., None])
            )
            shown = (G @ v)[..., 0]
        away = np.abs(np.log(np.where(used, trial.y / shown, 1.0))) ** 2
    away = np.where(np.isfinite(away), np.minimum(away, LIMIT**2), LIMIT**2)
    total: Real = np.sum(np.where(used, away, 0.0), axis=(-2, -1))
    return total
