"""A vector that walks at random and sometimes steps, from what each of many windows of time shows of it.

θₖ = θₖ₋₁ + wₖ, wₖ ~ N(0, Δtₖ diag(v)), and window k shows yₖ = θₖ + eₖ, eₖ ~ N(0, s² Λₖ⁻¹), where its information Λₖ
need not determine θ.  Filter and smoother as of Durbin and Koopman (Time Series Analysis by State Space Methods, 2012,
chapter 4); the variances v and the scatter s² ≥ 1 by maximum likelihood of the innovations.  A step at any place in any
component is tested by the smoothed disturbances of the same pass (de Jong and Penzer, Journal of the American
Statistical Association 93, 1998); what chance makes the largest of these tests, simulation says.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize
from scipy.special import chdtri, logsumexp

from dashpot.arrays import Bools, Real

SIMULATIONS = 499  # of records without a step
AT_ONCE = 2e6  # numbers of simulated records that are held at once
PARTS = np.arange(20) / 20  # of a window, in which a step is placed
WITHIN = float(chdtri(1, 0.05))  # fall of twice the log likelihood at the ends of a 95 % interval

Step = tuple[int, int]  # the window before which there is a step, and the component that steps


@dataclass(frozen=True)
class Windows:
    """What each of K windows shows of p numbers by itself.

    start, end   (K,) of each window, in any unit of time
    values       (K, p), estimates by each window alone
    information  (K, p, p), inverse covariances of their noise, without what was known before
    precision, mean  (p,), of what is known of the numbers before the first window
    """

    start: Real
    end: Real
    values: Real
    information: Real
    precision: Real
    mean: Real

    @cached_property
    def gaps(self) -> Real:
        """(K − 1,), time from the middle of each window to that of the next."""
        gaps: Real = np.diff((self.start + self.end) / 2)
        return gaps

    @cached_property
    def ranks(self) -> Real:
        """(K,), of how many numbers each window tells."""
        size = np.sqrt(np.maximum(np.diagonal(self.information, axis1=-2, axis2=-1), np.finfo(float).tiny))
        even = self.information / (size[:, :, None] * size[:, None, :])
        return np.linalg.matrix_rank(even, hermitian=True).astype(np.float64)

    @cached_property
    def scale(self) -> Real:
        """(p,), the standard deviation that a typical window gives, with what is known before."""
        total = np.mean(self.information, axis=0) + np.diag(self.precision)
        size = np.sqrt(np.diagonal(total))
        deviation: Real = np.sqrt(np.diagonal(np.linalg.inv(total / np.outer(size, size)))) / size
        return deviation

    def scaled(self) -> Windows:
        """The same in units of `scale`."""
        units = np.outer(self.scale, self.scale)
        return replace(
            self,
            values=self.values / self.scale,
            information=self.information * units,
            precision=self.precision * self.scale**2,
            mean=self.mean / self.scale,
        )

    def pooled_speed(self) -> float:
        """Of a walk that over all the time goes as far as all windows together leave uncertain, in scaled windows."""
        return float((len(self.start) * np.sum(self.gaps)) ** -0.5) if len(self.gaps) else 0.0


@dataclass(frozen=True)
class RandomWalk:
    """How the numbers move: variances per time (p,), scatter s², and steps."""

    variance: Real
    scatter: float = 1.0
    steps: tuple[Step, ...] = ()


@dataclass(frozen=True)
class Smoothed:
    """A pass forward and back, with S walks, of B series of the same information.

    likelihood  (S, B), its logarithm but for a constant
    values      (S, B, K, p), of each window by all of them; covariance (S, K, p, p)
    pull        (S, B, K, p), what all windows from k on say against no step before k, over its variance: that is the
                diagonal `weight` (S, K, p), `across` (S, K, p) its covariance with the next window's
    """

    likelihood: Real
    values: Real
    covariance: Real
    pull: Real
    weight: Real
    across: Real
    gaps: Real

    @property
    def shock(self) -> Real:
        """(S, B, K, p), of a step before each window: standard normal where there is none; 0 before the first."""
        return _over(self.pull, np.sqrt(self.weight)[:, None])

    @property
    def slope(self) -> Real:
        """(S, B, p), of the likelihood by the variances of the walk."""
        excess = self.pull[..., 1:, :] ** 2 - self.weight[:, None, 1:]
        slope: Real = 0.5 * np.einsum("k,sbkp->sbp", self.gaps, excess)
        return slope


def _over(above: Real, below: Real) -> Real:
    """A quotient, 0 where it has no denominator."""
    some = below > 0
    return np.where(some, above / np.where(some, below, 1.0), 0.0)


def smoothed_walks(windows: Windows, walks: Sequence[RandomWalk], values: Real | None = None) -> Smoothed:
    """Filter and smooth scaled windows by each of the walks; `values` (B, K, p) in the place of their own."""
    y = windows.values[None] if values is None else values
    (B, K, p), S = y.shape, len(walks)
    scatter = np.array([walk.scatter for walk in walks])[:, None, None]
    Q = np.array([walk.variance for walk in walks])[:, None] * windows.gaps[:, None]  # (S, K − 1, p)
    for s, walk in enumerate(walks):
        for k, j in walk.steps:
            Q[s, k - 1, j] += 1e8  # variances that a window gives: a step of any size
    eye, logs = np.eye(p), windows.ranks * np.log(scatter[:, 0])
    steps, information = Q[..., None] * eye, windows.information / scatter[:, None]
    P = np.linalg.inv(information[:, 0] + np.diag(windows.precision))
    a = (y[:, 0] @ windows.information[0] / scatter + windows.precision * windows.mean) @ P
    predicted, ahead = np.empty((S, B, K, p)), np.empty((S, K, p, p))
    off, innovation = np.zeros((S, B, K, p)), np.zeros((S, B, K, p))
    inverse, gain, told = (np.zeros((S, K, p, p)) for _ in range(3))
    predicted[:, :, 0], ahead[:, 0] = a, P
    for k in range(1, K):
        P = P + steps[:, k - 1]
        inverse[:, k] = np.linalg.inv(eye + information[:, k] @ P)
        told[:, k] = inverse[:, k] @ information[:, k]
        off[:, :, k] = y[:, k] - a
        innovation[:, :, k] = off[:, :, k] @ told[:, k]
        predicted[:, :, k], ahead[:, k], gain[:, k] = a, P, P @ told[:, k]
        a = a + innovation[:, :, k] @ P
        P = P - gain[:, k] @ P
        P = (P + np.swapaxes(P, -1, -2)) / 2
    sizes = np.linalg.slogdet(inverse[:, 1:])[1] - logs[:, 1:]
    likelihood = 0.5 * np.sum(sizes[:, None] - np.sum(off * innovation, axis=-1)[..., 1:], axis=-1)
    r, N, onward = np.zeros((S, B, K + 1, p)), np.zeros((S, K + 1, p, p)), np.zeros((S, K, p, p))
    kept = eye - gain
    for k in range(K - 1, 0, -1):
        onward[:, k] = np.swapaxes(kept[:, k], -1, -2) @ N[:, k + 1]
        r[:, :, k] = innovation[:, :, k] + r[:, :, k + 1] @ kept[:, k]
        N[:, k] = told[:, k] + onward[:, k] @ kept[:, k]
    across = np.diagonal(onward, axis1=-2, axis2=-1)
    behind = np.maximum(np.arange(K), 1)  # the first window begins the filter and is not predicted
    back = np.einsum("sbkp,skpq->sbkq", r[:, :, behind], ahead)
    covariance = ahead - ahead @ N[:, behind] @ ahead
    weight = np.maximum(np.diagonal(N[:, :K], axis1=-2, axis2=-1), 0.0)
    return Smoothed(likelihood, predicted + back, covariance, r[:, :, :K], weight, across, windows.gaps)


def likeliest_walk(
    windows: Windows, steps: tuple[Step, ...] = (), moving: Bools | None = None, variance: Real | None = None
) -> RandomWalk:
    """The walk of scaled windows that has these steps, by maximum likelihood.

    moving    (p,), the components that may walk: all, where it is not given
    variance  (p,), where that is given the scatter alone is sought
    """
    K, p = windows.values.shape
    may = np.ones(p, dtype=bool) if moving is None else moving
    if variance is not None:
        may = np.zeros(p, dtype=bool)
    usual = np.zeros(p) if variance is None else variance
    if K < 3 or np.sum(windows.ranks[1:]) <= len(steps) + p:
        return RandomWalk(usual, 1.0, steps)
    # A walk of a thousandth of the standard deviation that all windows give together counts as none.
    slowest = (1e-3 * windows.pooled_speed()) ** 2

    def walk_at(x: Real) -> RandomWalk:
        found = usual.copy()
        found[may] = np.exp(x[:-1])
        return RandomWalk(found, float(np.exp(x[-1])), steps)

    def cost(x: Real) -> tuple[float, Real]:
        walks = [walk_at(x), walk_at(np.append(x[:-1], x[-1] + 1e-4))]
        at = smoothed_walks(windows, walks)
        by_scatter = (at.likelihood[1, 0] - at.likelihood[0, 0]) / 1e-4
        by_walk = (at.slope[0, 0] * walks[0].variance)[may]
        return -float(at.likelihood[0, 0]), -np.append(by_walk, by_scatter)

    apart = np.mean(np.diff(windows.values, axis=0) ** 2, axis=0) / np.mean(windows.gaps)
    slow = np.full(p, 4 * windows.pooled_speed() ** 2)
    starts = [np.append(np.log(v[may]), 0.0) for v in (slow, np.maximum(apart / 2, slow))]
    limits = [(np.log(slowest), np.log(1e6 * np.max(apart) + 1e6 * slowest))] * int(np.sum(may))
    ends = [
        minimize(cost, start, jac=True, method="L-BFGS-B", bounds=[*limits, (0.0, np.log(1e6))])
        for start in starts[: 1 + bool(np.any(may))]
    ]
    walk = walk_at(min(ends, key=lambda end: float(end.fun)).x)
    still = may & (walk.variance <= 1e2 * slowest)  # where the likelihood is level
    return replace(walk, variance=np.where(still, 0.0, walk.variance))


def alternatives(
    windows: Windows, walk: RandomWalk, given: bool = False
) -> tuple[list[RandomWalk], list[list[int]]]:
    """`walk`, and walks with one speed changed; and the places of those of each component, `walk` with them.

    Speeds that are `given` have no alternatives.
    """
    walks, places = [walk], list[list[int]]()
    slow = windows.pooled_speed() * np.append(0.0, 2.0 ** np.arange(np.log2(len(windows.start)) + 1))
    for j, variance in enumerate(walk.variance):
        speed = float(np.sqrt(variance))
        its: list[int] = []
        for each in (speed * np.append(0.0, 2.0 ** np.arange(-2, 4)) if speed else slow).tolist():
            if given or each == speed:
                its.append(0)
                continue
            other = walk.variance.copy()
            other[j] = each**2
            its.append(len(walks))
            walks.append(replace(walk, variance=other))
        places.append(list(dict.fromkeys(its)))
    return walks, places


def speed_weights(walks: Sequence[RandomWalk], its: Sequence[int], likelihood: Real, component: int) -> Real:
    """How likely each speed of a component is, alike beforehand; the walks `its`, of S with likelihoods (S,)."""
    speeds = np.sqrt([walks[s].variance[component] for s in its])
    if len(its) == 1:
        return np.ones(1)
    edges = np.concatenate([speeds[:1], (speeds[1:] + speeds[:-1]) / 2, speeds[-1:]])
    weights = np.exp(likelihood[list(its)] - np.max(likelihood[list(its)])) * np.diff(edges)
    return np.asarray(weights / np.sum(weights))


@dataclass(frozen=True)
class Search:
    """What is tried against walks of some components: a walk of another, or a step of any.

    walks   `null` of them first: those that are tried against; of the others walk s lets component walker[s] walk
    allowed (K, p), where a step may be
    """

    walks: tuple[RandomWalk, ...]
    null: int
    walker: tuple[int, ...]
    allowed: Bools

    @staticmethod
    def of(windows: Windows, walk: RandomWalk, moving: Bools, given: bool) -> Search:
        """Against a walk of the components that are `moving`."""
        walks, places = alternatives(windows, walk, given)
        of = {s: j for j, its in enumerate(places) for s in its if s}
        order = sorted(range(len(walks)), key=lambda s: s > 0 and not moving[of[s]])
        null = sum(s == 0 or bool(moving[of[s]]) for s in order)
        allowed = np.ones(windows.values.shape, dtype=bool)
        allowed[0] = False
        for k, j in walk.steps:
            allowed[k, j] = False
        return Search(tuple(walks[s] for s in order), null, tuple(of.get(s, -1) for s in order), allowed)

    def statistic(self, at: Smoothed) -> Real:
        """Twice the logarithm by which the most probable change is likelier than none, (B,)."""
        B, K, p = at.pull.shape[1:]
        squared = np.where(self.allowed, at.shock[: self.null] ** 2, 0.0).reshape(self.null, B, K * p)
        stepped = np.max(at.likelihood[: self.null] + 0.5 * np.max(squared, axis=-1), axis=0)
        walked = np.max(at.likelihood[self.null :], axis=0, initial=-np.inf)
        none = np.max(at.likelihood[: self.null], axis=0)
        return np.asarray(2 * (np.maximum(stepped, walked) - none))

    def likeliest(self, at: Smoothed) -> tuple[int, int, float]:
        """Window and component of the most probable change of the first series, the window 0 where it walks; and the
        logarithm of the odds of a step against a walk of that component.

        Both with a normal prior about no change of the most probable size; a step may be before any window alike.
        """
        none = np.max(at.likelihood[: self.null, 0])
        squared = np.where(self.allowed, at.shock[: self.null, 0] ** 2, 0.0)
        stepped = at.likelihood[: self.null, 0, None, None] + squared / 2
        s, k, j = (int(i) for i in np.unravel_index(np.argmax(stepped), squared.shape))
        walks = at.likelihood[self.null :, 0] - none
        if len(walks) and np.max(walks) > stepped[s, k, j] - none:
            j = self.walker[self.null + int(np.argmax(walks))]
        # The likeliest size of a step of a test z has the evidence exp((z² − 1) / 2) / |z|
        z2 = np.maximum(squared[s, :, j], 1.0)
        share = self.allowed[:, j] / max(int(np.sum(self.allowed[:, j])), 1)
        of_step = float(logsumexp((z2 - 1 - np.log(z2)) / 2, b=share))
        its = np.array(self.walker[self.null :]) == j
        of_walk = float(np.max(walks[its])) if np.any(its) else -np.inf
        odds = float(at.likelihood[s, 0] - none) + of_step - of_walk
        return (int(np.argmax(squared[s, :, j])) if odds > 0 else 0), j, odds

    def chance(self, windows: Windows, statistic: float, enough: float, rng: np.random.Generator) -> float:
        """How often series without a change have as large a statistic; what is not below `enough` by far is rough."""
        larger = done = 0
        for values in self._simulated(windows, rng):
            found = self.statistic(smoothed_walks(windows, self.walks, values))
            larger, done = larger + int(np.sum(found >= statistic)), done + len(values)
            if (1 + larger) / (1 + SIMULATIONS) > 2 * enough:  # whatever the others show
                break
        return (1 + larger) / (1 + done)

    def _simulated(self, windows: Windows, rng: np.random.Generator) -> Iterator[Real]:
        """Series (B, K, p) that walk as `walks[0]` without its steps, some at a time."""
        K, p = windows.values.shape
        walk = self.walks[0]
        size, vectors = np.linalg.eigh(windows.information)
        kept = size > 1e-12 * np.max(size, axis=-1, keepdims=True)
        root = vectors * np.where(kept, np.where(kept, size, 1.0) ** -0.5, 0.0)[:, None]
        known = windows.precision > 0
        at_once = max(1, int(AT_ONCE / (len(self.walks) * K * p)))
        for first in range(0, SIMULATIONS, at_once):
            B = min(at_once, SIMULATIONS - first)
            begin = rng.standard_normal((B, p)) / np.sqrt(np.where(known, windows.precision, np.inf))
            moves = rng.standard_normal((B, K - 1, p)) * np.sqrt(windows.gaps[:, None] * walk.variance)
            path = np.concatenate([np.zeros((B, 1, p)), np.cumsum(moves, axis=1)], axis=1)
            noise = np.einsum("kij,bkj->bki", root, rng.standard_normal((B, K, p)))
            yield windows.mean * known + begin[:, None] + path + walk.scatter**0.5 * noise


@dataclass(frozen=True)
class Change:
    """That one component changes: in a step, or gradually.

    window  before which it steps, and, for a part > 0, that far into the one before; 0 where it changes gradually
    size, sd      of the change, in units of the component: from the first window to the last where it is gradual
    time, time95  of the step, with the ends of the 95 % interval; of a gradual change the middle and the ends of all
    p       of a change as likely in any component at any time where there is none
    odds    of a step against a gradual change
    """

    component: int
    window: int
    part: float
    size: float
    sd: float
    time: float
    time95: tuple[float, float]
    p: float
    odds: float


@dataclass(frozen=True)
class Trajectory:
    """The numbers over time, (K, p), with standard deviations that allow for the speeds; speeds (p,) and their scatter.

    covariance  (p, p), of the last window's, with the most probable walk
    speed       (p,), standard deviation of the walk after a unit of time; speed95 (p, 2) of it
    """

    values: Real
    sd: Real
    covariance: Real
    speed: Real
    speed95: Real
    scatter: float
    changes: tuple[Change, ...]


def trajectory(
    windows: Windows, *, false_alarms: float = 0.01, variance: Real | None = None, seed: int = 0
) -> Trajectory:
    """The numbers over time, their speeds, and the abrupt changes that chance does not make.

    false_alarms  the share of series without a step in which one is found
    variance      (p,) per time, of the walk; without it by maximum likelihood
    """
    scale, scaled = windows.scale, windows.scaled()
    given = None if variance is None else variance / scale**2
    steps: list[Step] = []
    found: list[tuple[int, int, float, float, float]] = []
    moving = np.zeros(len(scale), dtype=bool)
    rng = np.random.default_rng(seed)
    while True:
        walk = likeliest_walk(scaled, tuple(steps), None, given)
        if len(windows.start) < 3 or len(found) > len(windows.start) // 2:
            break
        null = replace(likeliest_walk(scaled, tuple(steps), moving, given), scatter=walk.scatter)
        search = Search.of(scaled, null, moving, given is not None)
        at = smoothed_walks(scaled, search.walks)
        p = search.chance(scaled, float(search.statistic(at)[0]), false_alarms, rng)
        if p > false_alarms:
            break
        k, j, odds = search.likeliest(at)
        if k == 0:
            found.append((0, j, 0.0, p, odds))
            moving[j] = True
            continue
        k, part = _place(smoothed_walks(scaled, [null]), k, j)
        if part > 0:  # a window in which one of the numbers steps says nothing that is linear in them
            told = scaled.information.copy()
            told[k] = 0.0
            scaled, k = replace(scaled, information=told), k + 1
        found.append((k, j, part, p, odds))
        steps.append((k, j))
    walks, places = alternatives(scaled, walk, given is not None)
    at = smoothed_walks(scaled, walks)
    weights = [speed_weights(walks, its, at.likelihood[:, 0], j) for j, its in enumerate(places)]
    values, sd = np.empty(windows.values.shape), np.empty(windows.values.shape)
    speeds, interval = np.sqrt(walk.variance), np.empty((len(scale), 2))
    for j, its in enumerate(places):
        mean = np.einsum("s,sk->k", weights[j], at.values[its, 0, :, j])
        spread = at.covariance[its, :, j, j] + (at.values[its, 0, :, j] - mean) ** 2
        values[:, j], sd[:, j] = mean * scale[j], np.sqrt(np.maximum(weights[j] @ spread, 0.0)) * scale[j]
        candidates = np.sqrt([walks[s].variance[j] for s in its])
        near = at.likelihood[its, 0] >= np.max(at.likelihood[its, 0]) - WITHIN / 2
        interval[j] = np.min(candidates[near]), np.max(candidates[near])
    changes = []
    for k, j, part, p, odds in found:
        if k:
            size, deviation, time, ends = _step(windows, scaled, walk, found, (k, j, part))
        else:
            size, deviation = values[-1, j] - values[0, j], float(np.hypot(sd[0, j], sd[-1, j]))
            ends = float(windows.start[0]), float(windows.end[-1])
            time = sum(ends) / 2
        changes.append(
            Change(j, k, part, float(size), deviation, time, ends, p, float(np.exp(min(odds, 700.0))))
        )
    last = at.covariance[0, -1] * np.outer(scale, scale)
    return Trajectory(
        values, sd, last, speeds * scale, interval * scale[:, None], walk.scatter, tuple(changes)
    )


def _tests(at: Smoothed, j: int) -> tuple[Real, Real]:
    """Pull and weight (K, PARTS) of a step of component j that lies some part of the way through each window."""
    pull, weight, across = at.pull[0, 0, :, j], at.weight[0, :, j], at.across[0, :, j]
    here, there = 1 - PARTS, PARTS
    next_pull, next_weight = np.append(pull[1:], 0.0), np.append(weight[1:], 0.0)
    pulls = np.outer(pull, here) + np.outer(next_pull, there)
    weights = np.outer(weight, here**2) + np.outer(next_weight, there**2) + 2 * np.outer(across, here * there)
    weights[0], weights[-1, 1:] = 0.0, 0.0  # nothing is before the first window, nor behind the last
    return pulls, weights


def _place(at: Smoothed, k: int, j: int) -> tuple[int, float]:
    """Where near window k a step is likeliest: within a window only where that is likelier than at its begin."""
    pulls, weights = _tests(at, j)
    squared = _over(pulls**2, weights)
    near = slice(max(k - 1, 1), k + 2)
    begin = int(np.argmax(squared[near, 0])) + near.start
    row, part = divmod(int(np.argmax(squared[near])), len(PARTS))
    inside = squared[near][row, part] - squared[begin, 0] > WITHIN
    return (row + near.start, float(PARTS[part])) if inside else (begin, 0.0)


def _step(
    windows: Windows,
    scaled: Windows,
    walk: RandomWalk,
    found: Sequence[tuple[int, int, float, float, float]],
    one: tuple[int, int, float],
) -> tuple[float, float, float, tuple[float, float]]:
    """Size, standard deviation and time of a step, given all others; and the ends of an interval of the time."""
    k, j, part = one
    others = [(at, of) for at, of, *_ in found if at and (at, of) != (k, j)]
    pulls, weights = _tests(smoothed_walks(scaled, [replace(walk, steps=tuple(others))]), j)
    sd, unit = float(weights[k, 0]) ** -0.5, float(windows.scale[j])
    size = float(pulls[k, 0]) * sd**2 * unit
    length = windows.end - windows.start
    if part > 0:
        time = float(windows.start[k - 1] + part * length[k - 1])
        return size, sd * unit, time, (float(windows.start[k - 1]), float(windows.end[k - 1]))
    squared = _over(pulls**2, weights)
    before = max((at for at, of in others if of == j and at < k), default=0)
    behind = min((at for at, of in others if of == j and at > k), default=len(squared))
    squared[: before + 1], squared[behind:] = 0.0, 0.0
    times = windows.start[:, None] + PARTS * length[:, None]
    likely = (squared >= squared[k, 0] - WITHIN) & (squared > 0)
    silent = k - 1  # the last window before the step that says something
    while silent > 0 and not np.any(scaled.information[silent]):
        silent -= 1
    time = float(times[k, 0])
    early = min(float(np.min(times[likely])), float(windows.end[silent]), time)
    return size, sd * unit, time, (early, max(float(np.max(times[likely])), time))
