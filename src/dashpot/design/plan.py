"""A test that can be run: dwells of whole periods within a budget of samples or of time, and what it will tell.

Settled parts alone, or all samples with the transients of every dwell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.channel import Channel
from dashpot.data.conditioning.whole_record import continuous, dwells_with_transients, whole_records
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum, concatenate
from dashpot.design.allocation import (
    Allocation,
    Criterion,
    ExpectedPrecision,
    InformationTerms,
    clusters,
    expected_precision,
    information_gain,
    optimal_shares,
    optimise,
)
from dashpot.design.test_setup import FrequencyGrid, Schedule, TestSetup, band_grid
from dashpot.errors import DashpotError, UsageError
from dashpot.estimate.likelihood.objective import local, measured
from dashpot.estimate.preparation import prepare
from dashpot.io.words import joined
from dashpot.model.motion import channel_samples, integrator
from dashpot.model.network import Model
from dashpot.model.observation import noise_sd, observation_model, small

MIN_SAMPLES = 8  # of a dwell: offset, drift and a harmonic leave some residual
NYQUIST = 0.45  # highest frequency in parts of the sampling rate
ENOUGH = 1e9  # samples or seconds; more is a mistake


@dataclass(frozen=True)
class Budget:
    """How much test there is: `samples` in all, or `time` in s, settling included.

    rate        samples a second; None: each dwell spreads its samples over whole periods as it likes
    settle      s before each dwell
    min_dwell   s of measuring at least, in each dwell
    most        at most that many dwells

    Raises UsageError if both or neither are stated, or a number makes no sense.
    """

    samples: float | None = None
    time: float | None = None
    rate: float | None = None
    settle: float = 0.0
    min_dwell: float = 0.0
    most: int | None = None

    def __post_init__(self) -> None:
        if (self.samples is None) == (self.time is None):
            raise UsageError(
                "the budget is either samples or time", cure="state a number of samples or a time"
            )
        stated = "state the rate, here or for the channels in the rig file"
        if self.time is not None and self.rate is None:
            raise UsageError(
                "a budget of time needs the sampling rate", cure=f"{stated}, or a number of samples"
            )
        if self.min_dwell > 0 and self.rate is None:
            raise UsageError("a shortest dwell needs the sampling rate", cure=stated)
        for name in ("samples", "time", "rate"):
            number = getattr(self, name)
            if number is not None and not 0 < number <= ENOUGH:
                raise UsageError(f"{name} of {number:g}", cure=f"give a positive number up to {ENOUGH:g}")
        for name, number in (("settling time", self.settle), ("shortest dwell", self.min_dwell)):
            if not 0 <= number <= ENOUGH:
                raise UsageError(f"a {name} of {number:g} s", cure="give a time of 0 s or more")
        if self.most is not None and self.most < 1:
            raise UsageError(f"at most {self.most} frequencies", cure="allow at least one")

    @property
    def amount(self) -> float:
        """Samples, or s."""
        return float(self.samples or self.time or 0.0)

    def of(self, amount: float) -> Budget:
        """The same budget of another amount: samples, or s."""
        return replace(self, time=amount) if self.samples is None else replace(self, samples=amount)

    def measured(self, dwells: int) -> float:
        """Samples that are left for measuring with that many dwells; not positive where settling eats the time."""
        if self.samples is not None:
            return float(self.samples)
        return (self.amount - dwells * self.settle) * (self.rate or 0.0)


@dataclass(frozen=True)
class Dwell:
    """One line of the test: amplitudes of the inputs (SI), whole periods, samples, times in s (None: no rate)."""

    frequency_hz: float
    amplitudes: Mapping[str, complex]
    samples: int
    periods: int | None
    time_s: float | None
    settle_s: float


@dataclass(frozen=True)
class Plan:
    """The test: dwells, what they will tell, and how far from the best possible.

    ideal   the figure before rounding, for as much measuring (settling not counted), with shares of any size
    gap     the duality gap of that optimum (the equivalence theorem's certificate)
    loss    what rounding, smallest dwells and a limited number of them cost: figure / ideal − 1
    """

    criterion: Criterion
    dwells: tuple[Dwell, ...]
    schedule: Schedule
    predicted: ExpectedPrecision
    ideal: float
    gap: float
    loss: float
    allocation: Allocation
    notes: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """Samples in all."""
        return sum(dwell.samples for dwell in self.dwells)

    @property
    def time_s(self) -> float | None:
        """Time in all, settling included; None if there is no rate."""
        if any(dwell.time_s is None for dwell in self.dwells):
            return None
        return sum((dwell.time_s or 0.0) + dwell.settle_s for dwell in self.dwells)


def plan(setup: TestSetup, criterion: Criterion, budget: Budget, grid: FrequencyGrid) -> Plan:
    """The best test within a budget, given what is already known.

    Raises UsageError if the budget holds no test, IdentifiabilityError if no test determines the unknowns.
    """
    if budget.rate is not None and grid.high > NYQUIST * budget.rate:
        raise UsageError(
            f"the band ends at {grid.high:g} Hz, too near half the sampling rate of {budget.rate:g} Hz",
            cure=f"end the band at {NYQUIST * budget.rate:.4g} Hz, or sample faster",
        )
    problem = DesignProblem(setup, criterion.terms(setup), budget, grid)
    ideal = problem.ideal()
    if problem.terms.block is None and not np.isfinite(problem.F(ideal.schedule(budget.measured(1)))):
        # One parameter's best test may leave the others open; a test that identifies must not.
        every = np.mean(Criterion("A").terms(setup).weights, axis=0)
        problem = replace(problem, terms=InformationTerms(problem.terms.weights + 1e-3 * every))
        ideal = problem.ideal()
    schedule = _rounded(problem, ideal)
    samples = budget.measured(len(schedule.frequency_hz))
    if budget.time is not None and budget.settle > 0:
        # The bound is for as much time of measuring as the plan has.
        ideal = problem.optimum(samples)
    F = problem.F(schedule)
    if grid.free and ideal.F - 1e-9 * abs(ideal.F) > F:
        # Between the points of a coarse grid lies a better test than the search saw: let it see.
        f = np.concatenate([grid.frequency_hz, schedule.frequency_hz])
        k = np.concatenate([grid.pattern, schedule.pattern])
        _, first = np.unique(np.stack([k, f]), axis=1, return_index=True)
        ideal = replace(problem, grid=FrequencyGrid(f[first], k[first])).optimum(samples)
    predicted = expected_precision(setup, criterion, schedule.information(setup))
    bound = criterion.figure(ideal.F)
    loss = predicted.figure / bound - 1
    names = [*setup.model.displacement_inputs, *setup.model.force_inputs]
    drive = setup.drive(schedule.frequency_hz, schedule.pattern)
    dwells = []
    for f, count, q in zip(schedule.frequency_hz.tolist(), schedule.samples, drive, strict=True):
        amplitudes = {name: complex(z) for name, z in zip(names, q, strict=True)}
        periods = time = None
        if budget.rate is not None:
            exact = count * f / budget.rate
            periods = round((count + 0.5) * f / budget.rate) if exact >= 1 else 1
            periods = max(periods, math.ceil(exact - 1e-9))
            time = periods / f
        dwells.append(Dwell(f, amplitudes, int(count), periods, time, budget.settle))
    return Plan(
        criterion,
        tuple(dwells),
        schedule,
        predicted,
        bound,
        ideal.gap,
        loss,
        ideal,
        _remarks(setup, schedule),
    )


def shortest(
    setup: TestSetup, criterion: Criterion, figure: float, budget: Budget, grid: FrequencyGrid
) -> Plan | None:
    """The shortest test whose criterion's figure is at most `figure`; None if what is known suffices already.

    `budget` says what is short (samples or time) and is a first guess of how much.  Raises UsageError if more than
    1e9 would be needed.
    """
    if not (np.isfinite(figure) and figure > 0):
        raise UsageError(
            f"a target of {figure:g}", cure="state a positive fraction of the value, such as 1 %"
        )
    already = criterion.figure(criterion.at(setup).F)
    if already <= figure:
        return None
    known = already**-2 if np.isfinite(already) else 0.0
    counted, amount, best = budget.samples is not None, budget.amount, None
    low, high = 0.0, math.inf  # the largest amount that was too little, the smallest that sufficed
    for _ in range(40):
        tried = budget.of(min(amount, ENOUGH))
        try:
            trial = plan(setup, criterion, tried, grid)
        except UsageError:  # too little for a test
            if tried.settle == 0 and tried.min_dwell == 0 and tried.amount > 1e6:
                raise
            trial = None
        reached = math.inf if trial is None else trial.predicted.figure
        if trial is not None and reached <= figure:
            best = trial if best is None or _cost(trial) <= _cost(best) else best
            high = amount
            if reached > 0.997 * figure or high - low <= max(1.0 if counted else 0.0, 2e-3 * high):
                break
        else:
            low = amount
        if low >= ENOUGH:
            unit = "samples" if counted else "s"
            raise UsageError(f"the target takes more than {ENOUGH:g} {unit}", cure="ask for less precision")
        guess = 4 * amount
        if trial is not None:
            # Information, 1 / variance, grows from what is known about evenly with the test.
            gained = max(reached**-2 - known, 1e-300)
            guess = amount * (1.001 * figure**-2 - known) / gained
        if not low < guess < high:
            guess = (low + high) / 2 if np.isfinite(high) else 2 * low
        amount = math.ceil(guess) if counted else guess
        if counted and amount >= high:
            break
    if best is None:
        raise UsageError("no test in this band reaches the target", cure="ask for less precision")
    return best


def _cost(trial: Plan) -> float:
    return float(trial.samples) if trial.time_s is None else trial.time_s


@dataclass(frozen=True)
class DesignProblem:
    """What a test is to be good for, on what setup, within which budget and band."""

    setup: TestSetup
    terms: InformationTerms
    budget: Budget
    grid: FrequencyGrid

    def F(self, schedule: Schedule) -> float:
        """The criterion of a test together with what is already known."""
        return self.terms.at(self.setup.prior + schedule.information(self.setup)).F

    def optimum(self, samples: float) -> Allocation:
        """The best shares of so many samples.  Raises IdentifiabilityError if none determine the unknowns."""
        return optimise(self.setup, self.terms, samples, self.grid)

    def ideal(self) -> Allocation:
        """The optimum without rounding; settling is counted for as many dwells as it has."""
        budget = self.budget
        most = 10**6 if budget.most is None else budget.most
        dwells = max(1, min((len(self.setup.names) + 1) // 2, most))
        for _ in range(4):
            samples = budget.measured(dwells)
            while samples <= 0 and dwells > 1:
                dwells -= 1
                samples = budget.measured(dwells)
            if samples <= 0:
                raise UsageError(
                    f"settling alone takes {budget.settle:.3g} s, the whole test",
                    cure="allow more time, or state a shorter settling time",
                )
            ideal = self.optimum(samples)
            count = min(len(ideal.share), most)
            if budget.time is None or budget.settle == 0 or count >= dwells:
                break
            dwells = count
        return ideal


def _rounded(problem: DesignProblem, ideal: Allocation) -> Schedule:
    """The best of the roundings to fewer and fewer dwells; stops when fewer stop being better."""
    budget = problem.budget
    best, lowest, worse = None, np.inf, 0
    shares = DwellShares(problem, ideal)
    shares.join()
    for count in range(shares.count, 0, -1):
        shares.thin(count)
        if budget.most is not None and count > budget.most:
            continue
        schedule = shares.rounded()
        F = np.inf if schedule is None else problem.F(schedule)
        if schedule is not None and (best is None or lowest > F):
            best, lowest, worse = schedule, F, 0
        elif best is not None:
            worse += 1
        if best is not None and (worse > 1 or not shares.may_gain(schedule)):
            break
    if best is None or not np.isfinite(lowest):
        raise UsageError(
            "no test within this budget can determine the unknowns",
            cure="allow more samples, time or frequencies",
        )
    return best


class DwellShares:
    """Shares of a test that lose frequencies one by one, and their rounding to whole periods."""

    def __init__(self, problem: DesignProblem, ideal: Allocation) -> None:
        self.problem = problem
        start = ideal.schedule(1.0)
        self.f, self.k = start.frequency_hz.copy(), start.pattern.copy()
        self.w = start.samples / np.sum(start.samples)

    @property
    def count(self) -> int:
        """Number of dwells."""
        return len(self.f)

    def _each(self) -> Real:
        return self.problem.setup.information(self.f, self.k)

    def _F(self, w: Real, M: Real) -> float:
        return self.problem.terms.of(self.problem.setup.prior, w, M).F

    def may_gain(self, schedule: Schedule | None) -> bool:
        """Whether fewer dwells could be better: settling costs time, or some dwell is shorter than is allowed."""
        budget = self.problem.budget
        if schedule is None or (budget.time is not None and budget.settle > 0):
            return True
        least, unit = self._least()
        shortest = least if budget.rate is None else np.floor(least * unit + 1e-9)
        return bool(np.any(self.w * max(budget.measured(self.count), 1.0) < shortest))

    def _least(self) -> tuple[Real, Real]:
        """Fewest periods of each dwell and the samples of a period; samples and 1 where there is no rate."""
        rate = self.problem.budget.rate
        if rate is None:
            return np.full(self.count, float(MIN_SAMPLES)), np.ones(self.count)
        long = np.maximum(self.problem.budget.min_dwell, MIN_SAMPLES / rate)
        return np.maximum(np.ceil(long * self.f - 1e-9), 1.0), rate / self.f

    def join(self) -> None:
        """One dwell for those that crowd around a frequency, where that costs less than 1e-4 of the variance.

        The optimum is flat there, and what finds it spreads the time over neighbours.
        """
        budget, unit = self.problem.budget, self.problem.terms.unit
        samples = max(budget.measured(self.count), budget.measured(0) / 2)
        before = self.f, self.k, self.w
        now = self._F(samples * self.w, self._each())
        for width in (0.1, 0.03, 0.01, 0.003):  # in ln f
            self.f, self.k, self.w = clusters(*before, width, self.problem.grid.free)
            if self.count == len(before[0]):
                return
            self._improve(samples)
            if self._F(samples * self.w, self._each()) <= now + 1e-4 * unit(now):
                return
        self.f, self.k, self.w = before

    def thin(self, count: int) -> None:
        """Down to `count` frequencies: drop those that cost least, then shift the others."""
        if count >= self.count:
            return
        budget = self.problem.budget
        samples = budget.measured(count)
        if samples <= 0:
            samples = budget.measured(0)
        while self.count > count:
            M = samples * self._each()
            tries = []
            for out in range(self.count):
                w = np.delete(self.w, out)
                tries.append(self._F(w / np.sum(w), np.delete(M, out, axis=1)))
            out = int(np.argmin(tries))
            kept = np.arange(self.count) != out
            self.f, self.k, self.w = self.f[kept], self.k[kept], self.w[kept] / np.sum(self.w[kept])
        self._improve(samples)

    def _improve(self, samples: float) -> None:
        """Shares and frequencies in turn, each frequency by zooming in on the best of several places."""
        terms, prior, grid = self.problem.terms, self.problem.setup.prior, self.problem.grid
        last = np.inf
        for _ in range(8):
            M = samples * self._each()
            if not np.isfinite(terms.at(prior + np.mean(M, axis=1)).F):
                return
            self.w = optimal_shares(terms, prior, M).w
            # With many dwells left each matters little: their shares make up for the one that went.
            if grid.free and grid.high > grid.low and self.count <= 8:
                for i in range(self.count):
                    self._shift(i, M, samples)
            F = self._F(self.w, M)
            if (last - F) / terms.unit(F) < 1e-6:
                return
            last = F

    def _shift(self, i: int, M: Real, samples: float) -> None:
        """Move dwell i to where F is least, and what it tells in M (scenarios, lines, q, q) with it."""
        terms, setup, grid = self.problem.terms, self.problem.setup, self.problem.grid
        others = np.delete(np.arange(self.count), i)
        rest = setup.prior + np.einsum("i,siab->sab", self.w[others], M[:, others])
        low, high, places = grid.low, grid.high, 33
        lowest = terms.at(rest + self.w[i] * M[:, i]).F
        for _ in range(4):
            f = np.geomspace(low, high, places)
            moved = samples * setup.information(f, np.full(places, self.k[i]))
            F = [terms.at(rest + self.w[i] * moved[:, j]).F for j in range(places)]
            top = int(np.argmin(F))
            if F[top] < lowest:
                self.f[i], M[:, i], lowest = f[top], moved[:, top], F[top]
            low, high, places = f[max(top - 1, 0)], f[min(top + 1, places - 1)], 9

    def rounded(self) -> Schedule | None:
        """Whole periods (samples where there is no rate) within the budget; None if they do not fit."""
        grid = self.problem.grid
        if grid.free:
            f = np.array([float(f"{f:.6g}") for f in self.f])  # what a controller can be told
            self.f = np.clip(f, grid.low, grid.high)
        order = np.lexsort((self.f, self.k))
        self.f, self.k, self.w = self.f[order], self.k[order], self.w[order]
        # In samples of measuring time; a dwell's own samples are the whole ones among them.
        total = self.problem.budget.measured(self.count)
        least, unit = self._least()
        units = self._cut(total, unit, least)
        if units is None:
            return None
        units = self._filled(total, unit, units)
        return Schedule(self.f, self.k, np.floor(units * unit + 1e-9))

    def _cut(self, total: float, unit: Real, least: Real) -> Real | None:
        """Whole units of each dwell, at most its share and at least `least`; None if these do not fit."""
        ideal = self.w * total
        units = np.maximum(np.floor(ideal / unit + 1e-9), least)
        while np.sum(units * unit) > total * (1 + 1e-12):
            spare = units > least
            if not np.any(spare):
                return None
            over = np.where(spare, units * unit / np.maximum(ideal, 1e-300), -np.inf)
            i = int(np.argmax(over))
            units[i] -= max(1.0, min(units[i] - least[i], np.floor((np.sum(units * unit) - total) / unit[i])))
        return units

    def _filled(self, total: float, unit: Real, units: Real) -> Real:
        """What the rounding left over, given to the dwells that gain most from it."""
        terms, each = self.problem.terms, self._each()
        for _ in range(4 * self.count):
            left = total * (1 + 1e-12) - np.sum(units * unit)
            fits = np.flatnonzero(unit <= left)
            if len(fits) == 0:
                break
            M = self.problem.setup.prior + np.einsum("i,siab->sab", np.floor(units * unit + 1e-9), each)
            now = terms.at(M).F
            F = [terms.at(M + unit[i] * each[:, i]).F for i in fits]
            # What is won for what it takes.
            gain = [(now - F[j]) / unit[i] if np.isfinite(now) else -F[j] for j, i in enumerate(fits)]
            units[fits[int(np.argmax(gain))]] += 1
        return units


def _remarks(setup: TestSetup, schedule: Schedule) -> tuple[str, ...]:
    """What the user should know of the sensors at the chosen frequencies of a linear rig."""
    if len(setup.model.nonlinear):
        return ()
    size = np.abs(setup.seen(schedule.frequency_hz, schedule.pattern).Y)
    faint = (size > 0) & (size < 1e-3 * np.max(size, axis=0, initial=0.0))
    still: dict[float, list[str]] = {}
    for i, channel in enumerate(setup.channels):
        if channel.noise == 0 and channel.relative_noise > 0 and np.any(faint[:, i]):
            first = float(schedule.frequency_hz[int(np.argmax(faint[:, i]))])
            still.setdefault(first, []).append(channel.name)
    return tuple(
        f"{joined(names)} barely {'moves' if len(names) == 1 else 'move'} at {f:.4g} Hz, where noise stated in "
        "per cent only is almost zero: state a noise floor as well"
        for f, names in still.items()
    )


@dataclass(frozen=True)
class PlanCurves:
    """What a plan rests on over the band.

    frequency_hz  (points,)
    patterns      (curves,)              pattern of the drive of each curve
    derivative    (curves, points)       directional derivative over its mean: 1 where time is spent
    gain          (points, parameters)   what a sample adds to each parameter, best of the plan's patterns; 1 is what
                                         its average sample adds
    """

    frequency_hz: Real
    patterns: Ints
    derivative: Real
    gain: Real


def plan_curves(setup: TestSetup, criterion: Criterion, plan: Plan, low: float, high: float) -> PlanCurves:
    """Curves between `low` and `high` (Hz)."""
    grid = band_grid(setup, low, high)
    f = grid.frequency_hz[grid.pattern == 0]
    f = f[:: math.ceil(len(f) / 400)]  # points that a figure can show
    at, pattern, derivative = plan.allocation.curve
    patterns = np.unique(pattern)[:4]
    curves = [np.interp(f, at[pattern == k], derivative[pattern == k]) for k in patterns]
    driven = [
        information_gain(setup, criterion, plan.schedule, f, np.full(len(f), k, dtype=np.int64))
        for k in np.unique(plan.schedule.pattern).tolist()
    ]
    return PlanCurves(f, patterns, np.array(curves), np.max(driven, axis=0))


# What dwells tell that wait for nothing: all samples count, transients included (THEORY §8).
#
# A stepped sine runs from dwell to dwell, from rest.  Its motion is carried through all of it; its lines have the loads
# of their records' ends, which the information projects out as `identify` does.


@dataclass(frozen=True)
class UnsettledTest:
    """A planned test whose samples are all used, from its start on.

    predicted   what it will tell
    thrown_away share of that information that the settled parts of the dwells leave out, by the criterion
    samples     of the whole test
    joined      whether the dwells are one record; else, where noise goes with amplitude, each is one of its own
    """

    predicted: ExpectedPrecision
    thrown_away: float
    samples: int
    joined: bool


def unsettled_test(
    setup: TestSetup, criterion: Criterion, plan: Plan, rate: float | None
) -> UnsettledTest | None:
    """The test of a plan, used whole at the nominal values, with what is already known.

    None where nothing can be said: no sampling rate, a rig with nonlinear elements, hysteretic dampers or coordinates
    without mass, delays that are stated, a test too long to compute, a large rig (its 2 n loads at the ends of a record
    cost lines × channels × n²: the plan itself takes less).
    """
    if rate is None or len(setup.model.nonlinear) or not plan.dwells or not small(setup.model):
        return None
    if any(unknown.unit == "s" and unknown.nominal for unknown in setup.calibrations):
        return None
    counts = [round((dwell.settle_s + (dwell.time_s or 0.0)) * rate) for dwell in plan.dwells]
    if sum(counts) * len(setup.channels) * (2 * setup.model.n + len(setup.channels)) > 50_000_000:
        return None  # 400 MB of slopes by the loads at the ends, and of noise
    frequency = np.array([dwell.frequency_hz for dwell in plan.dwells])
    drive = setup.drive(frequency, plan.schedule.pattern)
    joined = not any(channel.relative_noise > 0 for channel in setup.channels)
    nominal = replace(setup, theta=setup.theta[:1])
    try:
        records = unsettled_dwells(
            setup.model, setup.p[0], setup.channels, frequency, drive, counts, [1 / rate] * len(counts)
        )
        lines = lines_of_dwells(records, setup.channels, joined=joined)
        # Information of lines without noise at the true θ, (q, q) in SI units of ψ, loads projected out
        data = prepare(setup.model, lines, states=False)
        psi = np.concatenate([setup.theta[0], data.view.nominal_calibrations])
        at = local(data.view, measured(data), psi[None], np.ones((1, len(lines.channels))))
        information = at.symmetric[0] - np.diag(data.view.prior_precision)  # which the lines do not tell
        information = information * np.outer(setup.gains, setup.gains)
        predicted = expected_precision(nominal, criterion, nominal.relative(information))
        settled = expected_precision(nominal, criterion, plan.schedule.information(nominal))
    except DashpotError:
        return None
    thrown_away = 1 - (predicted.figure / settled.figure) ** 2
    return UnsettledTest(predicted, thrown_away, sum(counts), joined)


def unsettled_dwells(
    model: Model,
    p: Real,
    channels: Sequence[Channel],
    frequency_hz: Real,
    drive: Complex,
    samples: Sequence[int],
    step_s: Sequence[float],
) -> list[Record]:
    """A stepped sine from rest without noise, a record for each dwell, each beginning as the last one ended.

    p (elements,); drive (dwells, r + s) amplitudes of the inputs, which pass over from dwell to dwell within a period;
    known calibrations are left out.  Raises ModelError as `integrator`.
    """
    # The channel with what is known of its calibration taken out
    calibrated = tuple(
        replace(
            channel,
            gain=None if channel.gain is None else 1.0,
            delay=None if channel.delay is None else 0.0,
            sign=None if channel.sign is None else 1,
        )
        for channel in channels
    )
    view = observation_model(model, calibrated, np.ones(1))
    gain = np.append(view.nominal_calibrations[: view.gains], 1.0)[view.gain]
    state, begin, records = np.zeros(2 * model.n), 0.0, []
    before = (0.0, np.zeros(drive.shape[1], dtype=complex))
    for f, q, count, step in zip(frequency_hz.tolist(), drive, samples, step_s, strict=True):
        finer = max(1, int(np.ceil(20 * f * step)))  # so that a spline through the drive is the drive
        time = np.arange(count * finer + 1, dtype=float) * (step / finer)
        share = (1 - np.cos(np.pi * np.minimum(time * f, 1.0)))[:, None] / 2
        inputs = share * _waves(time, f, q) + (1 - share) * _waves(time, *before)
        motion = integrator(model, p, step / finer).motion(inputs, state)
        values = gain * channel_samples(view, p, motion)[:-1:finer]
        stamps = np.arange(count, dtype=float) * step + begin
        records.append(Record(calibrated, stamps, values, f, source=f"dwell at {f:g} Hz"))
        state = np.concatenate([motion.x[-1], motion.v[-1]])
        before = (f, q * np.exp(2j * np.pi * f * time[-1]))
        begin += count * step
    return records


def _waves(time: Real, frequency_hz: float, q: Complex) -> Real:
    """Re(q e^{jωt}), (samples, r + s)."""
    return (q * np.exp(2j * np.pi * frequency_hz * time)[:, None]).real


def lines_of_dwells(records: Sequence[Record], channels: Sequence[Channel], *, joined: bool) -> Spectrum:
    """The lines of dwells with their transients, with the noise that `channels` state.

    One record of all that follow each other where `joined`, which asks for noise of one size; else one for each, with
    noise in proportion to what moves in it.  Raises DataError if a dwell is too short.
    """
    if joined:
        whole = [replace(record, frequency_hz=None) for record in continuous(records)]
        lines = _with_noise(whole_records(whole, ramp=True), sample_noise(whole[0], channels))
    else:
        parts = [
            _with_noise(dwells_with_transients([record]), sample_noise(record, channels))
            for record in records
        ]
        lines = concatenate(parts)
    return replace(lines, channels=tuple(channels), notes=())


def sample_noise(record: Record, channels: Sequence[Channel]) -> Real:
    """Standard deviation of a sample's noise, (channels,), a relative part being of √2 times the rms motion."""
    return noise_sd(channels, 2**0.5 * np.std(record.values, axis=0).astype(np.complex128))


def _with_noise(lines: Spectrum, sd: Real) -> Spectrum:
    """The lines of one record with white noise of sd (channels,) of a sample: E|Δ|² = 4 σ² / N."""
    V = (4 * sd**2 / lines.samples[:, None])[:, :, None] * np.eye(len(sd))
    count = lines.lines
    return replace(
        lines, covariance=V.astype(np.complex128), noise=("given",) * count, dof=np.full(count, np.inf)
    )
