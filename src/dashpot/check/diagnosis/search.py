"""Fits of many trials at once: the same rig and view, other amplitudes, from starts that each trial can use."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from types import MappingProxyType

import numpy as np
from scipy.special import stdtr

from dashpot.arrays import Complex, Ints, Real
from dashpot.check.diagnosis.trials import Outcome, Trial, prepared
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.descent import Stage, descend_all, descend_in_repeats
from dashpot.estimate.likelihood.global_search import candidates, seen_directly
from dashpot.estimate.likelihood.objective import bounds, directly_driven, local, measured, predict
from dashpot.estimate.linear.least_squares import compensated
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.estimate.preparation.state_reconstruction import states_if_seen
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, calibration_factors, observation_model, transfer

# Rao's score test: how far χ² would fall if something fixed were free, by the slopes at its present value.
#
# Source: THEORY §11. Many suppositions are judged by one evaluation of the likelihood, each by itself
# beside the rig's own unknowns.


PARTS = 40  # of records, each of which tells a parameter by itself


@dataclass(frozen=True)
class Promise:
    """What freeing one unknown promises: the fall of χ² from `chi2`, and the step of the unknown."""

    name: str
    fall: float
    chi2: float
    step: float


def promises(
    view: ObservationModel, data: Measured, psi: Real, sign: Real, added: Collection[str], apart: float,
    together: Mapping[str, Collection[str]] = MappingProxyType({}),
) -> list[Promise]:  # fmt: skip
    """What each of the unknowns `added` promises at ψ (M,), the best fit of the others.

    Left out is what the others can do as well: where less than `apart` of its column is its own.  Each name of
    `together` is one more unknown, by which some of the added move alike.
    """
    with np.errstate(all="ignore"):
        at = local(view, data, psi[None], sign[None])
    information, score = at.symmetric[0], at.gradient[0]
    names = (*view.names, *together)
    alike = [[float(name in members) for name in view.names] for members in together.values()]
    moves = np.concatenate([np.eye(len(psi)), np.reshape(alike, (-1, len(psi)))])
    fixed = [name in added or name in together for name in names]
    return promised(names, fixed, moves @ information @ moves.T, moves @ score, float(at.cost[0]), apart)


def promised(
    names: Sequence[str], fixed: Sequence[bool], information: Real, score: Real, chi2: float, apart: float
) -> list[Promise]:
    """What each of those that are `fixed` promises, by the information (N, N) and score (N,) of all `names`.

    chi2 and apart as in `promises`.
    """
    if not (np.all(np.isfinite(information)) and np.all(np.isfinite(score))):
        return []
    own = np.diag(information)
    scale = np.sqrt(np.where(own > np.finfo(float).tiny, own, 1.0))  # what moves nothing promises nothing
    information, score = information / np.outer(scale, scale), score / scale
    free = np.flatnonzero(~np.array(fixed))
    inverse = np.linalg.pinv(information[np.ix_(free, free)], rcond=1e-12)
    listed = []
    for j in np.flatnonzero(fixed).tolist():
        cross = information[free, j]
        left = information[j, j] - cross @ inverse @ cross
        if left > apart**2:
            push = score[j] - cross @ inverse @ score[free]
            listed.append(Promise(names[j], float(push**2 / left), chi2, float(push / left / scale[j])))
    return listed


def sums_of_parts(values: Real) -> Real:
    """Sums over PARTS equal parts of records, (PARTS, ...), of values (samples, ...)."""
    return np.add.reduceat(
        values, np.linspace(0, len(values), PARTS, endpoint=False).astype(np.int64), axis=0
    )


def steadiness(column: Real, residual: Real, value: float, *, uneven: bool = False) -> float:
    """p-value of the parameter `value` of a column in time by its scatter over parts of the records.

    That scatter is there whatever colour and course the noise has; what comes once is no element.
    Where noise is `uneven` in time, no more parts count than tell something of the parameter.
    column, residual: (samples of all records,), or with channels on a second axis.
    """
    rows = column.reshape(len(column), -1), (residual - value * column).reshape(len(column), -1)
    each = sums_of_parts(np.sum(rows[0] * rows[1], axis=1))
    spread = max(float(np.sqrt(np.sum(each**2))), np.finfo(float).tiny)
    tell = sums_of_parts(np.sum(rows[0] ** 2, axis=1))
    count = float(np.sum(tell) ** 2 / max(np.sum(tell**2), np.finfo(float).tiny)) if uneven else PARTS
    return 2 * float(stdtr(max(count - 1, 1.0), -abs(value) * float(np.sum(column * column)) / spread))


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
        return fitted.q[0]

    def expected(self, outcome: Outcome) -> Complex:
        """What the channels should show by a trial's fit, those that it left out as well, (lines, channels)."""
        data, q = self._arranged(outcome.trial), self.inputs(outcome)[None]
        with np.errstate(all="ignore"):
            # The inputs are those of the trial; the residual is of every channel.
            every = replace(data, y=outcome.trial.y[None], q=q)
            at = predict(self.view, every, outcome.psi[None], self.sign[None])
        return outcome.trial.y - at.r[0]

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
    return np.sum(np.where(used, away, 0.0), axis=(-2, -1))


# Suppositions about the rig: a missing element between any two points, a stated value that is wrong.
#
# All candidates are added to the model at once, with no effect; one evaluation of the likelihood then gives
# the score of each, projected on what the rig's own unknowns can do, and by it how far χ² would fall (Rao's
# score test).


FOLLOWED = 6  # candidates that are fitted in full
APART = 0.01  # part of a column that the rig's own unknowns must leave for it to count as something else


@dataclass(frozen=True)
class Change:
    """A rig with one thing otherwise, fitted: the element as it would be, its parameter and what is left of χ²."""

    kind: str
    element: Element
    number: float
    chi2: float
    dof: int

    @property
    def reduced(self) -> float:
        """χ² over its degrees of freedom."""
        return self.chi2 / max(self.dof, 1)


def missing_elements(model: Model) -> list[Element]:
    """A spring and a damper between any two points, unless there is one, and a mass where there is none."""
    points = [*model.coordinates, *model.displacement_inputs, "ground"]
    there = {(element.kind, frozenset(element.along.items())) for element in model.elements}
    candidates = []
    for first, second in combinations(points, 2):
        if first not in model.coordinates:
            continue  # between inputs, or an input and the ground: it moves nothing
        for kind, letter in ((Kind.SPRING, "k"), (Kind.DAMPER, "c")):
            candidates.append(between(f"{letter}_{first}_{second}", kind, first, second))
    candidates += [mass(f"m_{x}", x) for x in model.coordinates]
    return [
        element
        for element in candidates
        if (element.kind, frozenset(element.along.items())) not in there
        and (element.kind, frozenset((point, -factor) for point, factor in element.along.items()))
        not in there
    ]


def stated_values(model: Model) -> list[Element]:
    """The elements whose value is stated as exact, each as if it were unknown."""
    return [
        replace(element, value=None, guess=element.value)
        for element in model.elements
        if element.value is not None and element.sd is None and element.same_as is None and element.value != 0
    ]


def changes(bench: Workbench, psi: Real, followed: int = FOLLOWED) -> list[Change]:
    """The candidates that the score says would help most, `followed` of them fitted in full from ψ (M,)."""
    model, stated = bench.data.model, stated_values(bench.data.model)
    scored = [
        *_scores(bench, psi, "element", missing_elements(model)),
        *_scores(bench, psi, "value", stated),
    ]
    scored.sort(key=lambda entry: -entry[0])
    chosen = [(kind, element) for fall, kind, element in scored[:followed] if fall > 0]
    if (
        bench.data.states is not None
    ):  # a value that is far off has a rig without slopes, yet is found by regression
        named = {element.name for _, element in chosen}
        chosen += [("value", element) for element in stated[:followed] if element.name not in named]
    return [_fitted(bench, psi, kind, element) for kind, element in chosen]


def extended(bench: Workbench, psi: Real, elements: Sequence[Element]) -> tuple[Prepared, Real]:
    """The bench's data of a rig with the candidates as unknowns, and the ψ there that means the same as ψ (M,).

    Candidates are elements of the bench's own rig or new ones.
    """
    model = bench.data.model
    candidates = {element.name: element for element in elements}
    start = dict.fromkeys(candidates, 0.0)
    start |= {e.name: float(e.value) for e in model.elements if e.name in candidates and e.value is not None}
    m = len(model.unknowns)
    start |= zip((unknown.name for unknown in model.unknowns), psi[:m].tolist(), strict=True)
    there = tuple(candidates.pop(e.name, e) for e in model.elements)
    larger = bench.data.of_rig(replace(model, elements=(*there, *candidates.values())))
    return larger, np.array([*(start[unknown.name] for unknown in larger.model.unknowns), *psi[m:]])


def _scores(
    bench: Workbench, psi: Real, kind: str, elements: list[Element]
) -> list[tuple[float, str, Element]]:
    """(fall of χ² that the score promises, kind, element) of each candidate."""
    if not elements:
        return []
    larger, start = extended(bench, psi, elements)
    by_name = {element.name: element for element in elements}
    listed = promises(larger.view, measured(larger), start, bench.sign, by_name.keys(), APART)
    return [(promise.fall, kind, by_name[promise.name]) for promise in listed]


def _fitted(bench: Workbench, psi: Real, kind: str, element: Element) -> Change:
    larger, start = extended(bench, psi, [element])
    view, data = larger.view, measured(larger)
    starts = start[None]
    if larger.states is not None and seen_directly(larger):
        # A rig that lacks a part may have ended among negative masses, from which nothing leads back.
        starts = np.concatenate([starts, compensated(larger.model, larger.states)])
        starts = starts[np.all(np.isfinite(starts), axis=1)]
    rows, signs = np.zeros(len(starts), dtype=np.int64), np.repeat(bench.sign[None], len(starts), axis=0)
    ends, chi2 = descended(view, data, starts, signs, rows, 2 * LONG)
    # A rig of other parts that are possible, not one that turns the given one round: exchanged channels would be that.
    possible = np.all(ends > bounds(view, positive=True)[0], axis=1)
    possible[0] = True
    best = int(np.argmin(np.where(possible, chi2, np.inf)))
    number = float(ends[best, view.names.index(element.name)])
    return Change(kind, element, number, float(chi2[best]), data.rows - len(start))
