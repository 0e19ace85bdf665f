"""A test that can be run: dwells of whole periods within a budget of samples or of time, and what it will tell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dashpot.arrays import Complex, Ints, Real, frozen
from dashpot.data.spectrum import Spectrum
from dashpot.design.allocation import Allocation, Grid, clusters, optimise, value, weigh
from dashpot.design.criteria import Doubt, Goal, MeanError, Terms
from dashpot.design.test_setup import Bench
from dashpot.errors import DashpotError, IdentifiabilityError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables
from dashpot.io.json_document import to_json as encoded
from dashpot.model.observation import calibration_names, noise_sd

MIN_SAMPLES = 8  # of a dwell: offset, drift and a harmonic leave some residual
SIMPLER = 1e-4  # of the variance: what it may cost to join dwells that crowd around one frequency
CROWDS = (0.1, 0.03, 0.01, 0.003)  # distances in ln f within which they are joined
FEW = 8  # dwells up to which frequencies shift when one is dropped
NYQUIST = 0.45  # highest frequency in parts of the sampling rate
ENOUGH = 1e9  # samples or seconds; more is a mistake


@dataclass(frozen=True)
class Budget:
    """How much test there is: `samples` in all, or `time` in s, settling included.

    rate        samples a second; None: each dwell spreads its samples over whole periods as it likes
    settle      s before each dwell
    min_dwell   s of measuring at least, in each dwell
    most        at most that many dwells
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
                "say how many samples or how much time there is", cure="one of --samples and --time"
            )
        if self.time is not None and self.rate is None:
            raise UsageError(
                "a test of some time needs the sampling rate",
                cure="give --rate, state rate in the channels of the rig file, or ask for --samples",
            )
        if self.min_dwell > 0 and self.rate is None:
            raise UsageError("a smallest dwell needs the sampling rate", cure="give --rate")
        for name, number in (("samples", self.samples), ("time", self.time), ("rate", self.rate)):
            if number is not None and not 0 < number <= ENOUGH:
                raise UsageError(f"{name} of {number:g}", cure=f"give a positive number up to {ENOUGH:g}")
        for name, number in (("settling time", self.settle), ("smallest dwell", self.min_dwell)):
            if not 0 <= number <= ENOUGH:
                raise UsageError(f"a {name} of {number:g} s", cure="give a time of 0 s or more")
        if self.most is not None and self.most < 1:
            raise UsageError(f"at most {self.most} frequencies", cure="allow one at least")

    def measured(self, dwells: int) -> float:
        """Samples that are left for measuring with that many dwells; not positive where settling eats the time."""
        if self.samples is not None:
            return float(self.samples)
        assert self.time is not None
        assert self.rate is not None
        return (self.time - dwells * self.settle) * self.rate

    def scaled(self, factor: float) -> Budget:
        """The same budget with more or less of it."""
        samples = None if self.samples is None else self.samples * factor
        time = None if self.time is None else self.time * factor
        return Budget(samples, time, self.rate, self.settle, self.min_dwell, self.most)


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
class Lines:
    """A test as the information sees it: frequency, pattern of the drive and samples of each line."""

    frequency_hz: Real
    pattern: Ints
    samples: Real

    def __post_init__(self) -> None:
        object.__setattr__(self, "frequency_hz", frozen(self.frequency_hz, np.float64))
        object.__setattr__(self, "pattern", frozen(self.pattern, np.int64))
        object.__setattr__(self, "samples", frozen(self.samples, np.float64))

    def information(self, bench: Bench) -> Real:
        """Of all lines together, (scenarios, q, q)."""
        if len(self.frequency_hz) == 0:
            return np.zeros_like(bench.prior)
        each = bench.information(self.frequency_hz, self.pattern)
        total: Real = np.einsum("i,siab->sab", self.samples, each)
        return total


@dataclass(frozen=True)
class Prediction:
    """What a test will tell, at the nominal values.

    sd, relative  (q,)    standard deviations of ψ in SI units, and in parts of the values
    covariance    (q, q)  SI units
    figure        the goal, as a relative standard deviation
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Real
    sd: Real
    covariance: Real
    figure: float

    def __post_init__(self) -> None:
        for name in ("values", "sd", "covariance"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float64))

    @property
    def relative(self) -> Real:
        """sd in parts of |value| (of 1 where the value is 0)."""
        return self.sd / np.where(self.values == 0, 1.0, np.abs(self.values))

    def rms(self, names: Sequence[str] = ()) -> float:
        """Root mean square of the relative standard deviations of all (or some) of the parameters."""
        chosen = [self.names.index(name) for name in names] if names else list(range(len(self.names)))
        return float(np.sqrt(np.mean(self.relative[chosen] ** 2)))


@dataclass(frozen=True)
class Plan:
    """The test: dwells, what they will tell, and how far from the best possible.

    ideal   the goal's figure before rounding, for as much measuring (settling not counted), with shares of any size
    gap     the duality gap of that optimum (the equivalence theorem's certificate)
    loss    what rounding, smallest dwells and a limited number of them cost: figure / ideal − 1
    """

    goal: str
    dwells: tuple[Dwell, ...]
    lines: Lines
    predicted: Prediction
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
        """Time in all, settling included; None where there is no rate."""
        if any(dwell.time_s is None for dwell in self.dwells):
            return None
        return sum((dwell.time_s or 0.0) + dwell.settle_s for dwell in self.dwells)


def predict(bench: Bench, goal: Goal, information: Real, doubt: Doubt = "worst") -> Prediction:
    """What information (scenarios, q, q), prior included, will give.

    Raises IdentifiabilityError where it leaves some parameter open.
    """
    at = value(goal.terms(bench, doubt), information)
    if not np.isfinite(at.F):
        raise IdentifiabilityError(
            "this test does not determine the unknowns", cure="give it more frequencies, or another sensor"
        )
    size = bench.sizes[0]
    C = at.C[0] * size[:, None] * size
    units = tuple(u.unit for u in bench.model.unknowns) + tuple(
        "s" if name.endswith(".delay") else "1" for name in calibration_names(bench.channels)
    )
    # Calibrations are errors of ln gain and of delay; their value is 1 and 0.
    extra = [0.0 if name.endswith(".delay") else 1.0 for name in calibration_names(bench.channels)]
    values = np.concatenate([bench.theta[0], extra])
    return Prediction(bench.names, units, values, np.sqrt(np.diagonal(C)), C, goal.figure(at.F))


def plan(
    bench: Bench,
    goal: Goal,
    budget: Budget,
    grid: Grid,
    *,
    known: Real | None = None,
    doubt: Doubt = "worst",
) -> Plan:
    """The best test within a budget.

    `known` (scenarios, q, q) is information from earlier data, in parts of the bench's sizes, the rig's priors
    included; without it, those priors alone.

    Raises UsageError where the budget holds no test, IdentifiabilityError where no test determines the unknowns.
    """
    _check_rate(grid, budget)
    prior = bench.prior if known is None else known
    terms = goal.terms(bench, doubt)
    found = _continuous(bench, terms, prior, budget, grid)
    if not np.isfinite(_F(bench, terms, prior, found, budget.measured(1))):
        # One parameter's best test may leave the others open; a test that identifies must not.
        goal_terms = MeanError().terms(bench, doubt)
        if terms.block is None:
            terms = Terms(terms.weights + 1e-3 * np.mean(goal_terms.weights, axis=0))
            found = _continuous(bench, terms, prior, budget, grid)
    best: tuple[float, Lines] | None = None
    worse = 0
    shares = _Shares(bench, terms, prior, budget, grid, found)
    shares.join()
    for count in range(shares.count, 0, -1):
        shares.thin(count)
        if budget.most is not None and count > budget.most:
            continue
        lines = shares.rounded()
        F = np.inf if lines is None else value(terms, prior + lines.information(bench)).F
        if lines is not None and (best is None or best[0] > F):
            best, worse = (F, lines), 0
        elif best is not None:
            worse += 1
        if best is not None and (worse > 1 or not shares.may_gain(lines)):
            break
    if best is None or not np.isfinite(best[0]):
        raise UsageError(
            "the budget holds no test that determines the unknowns",
            cure="allow more samples, time or frequencies",
        )
    count = len(best[1].frequency_hz)
    if budget.time is not None and budget.settle > 0:
        # The bound is for as much time of measuring as the plan has.
        found = optimise(bench.information, terms, prior, budget.measured(count), grid)
    if grid.free and best[0] < found.F - 1e-9 * abs(found.F):
        # Between the points of a coarse grid lies a better test than the search saw: let it see.
        found = optimise(bench.information, terms, prior, budget.measured(count), _with(grid, best[1]))
    return _assembled(bench, goal, budget, prior, doubt, found, best[1])


def shortest(
    bench: Bench,
    goal: Goal,
    figure: float,
    budget: Budget,
    grid: Grid,
    *,
    known: Real | None = None,
    doubt: Doubt = "worst",
) -> Plan | None:
    """The shortest test whose goal's figure is at most `figure`; None where what is known suffices already.

    `budget` says what is short (samples or time) and is a first guess of how much.  Raises UsageError where more than
    1e9 would be needed.
    """
    if not (np.isfinite(figure) and figure > 0):
        raise UsageError(f"a target of {figure:g}", cure="write it as 1% or c2=2%")
    prior = bench.prior if known is None else known
    terms = goal.terms(bench, doubt)
    already = goal.figure(value(terms, prior).F)
    if already <= figure:
        return None
    start = already**-2 if np.isfinite(already) else 0.0
    low, high = 0.0, math.inf
    amount = budget.samples if budget.samples is not None else budget.time
    assert amount is not None
    best: Plan | None = None
    for _ in range(40):
        trial = budget.scaled(min(amount, ENOUGH) / (budget.samples or budget.time or 1.0))
        try:
            found = plan(bench, goal, trial, grid, known=known, doubt=doubt)
        except UsageError:
            if trial.settle == 0 and trial.min_dwell == 0 and amount > 1e6:
                raise
            found = None
        if found is not None and found.predicted.figure <= figure:
            high = amount
            if best is None or _cost(found) <= _cost(best):
                best = found
            if found.predicted.figure > 0.997 * figure or high - low <= max(
                1.0 if budget.samples else 0.0, 2e-3 * high
            ):
                break
        else:
            low = amount
        if low >= ENOUGH:
            unit = "s" if budget.samples is None else "samples"
            raise UsageError(f"the target takes more than {ENOUGH:g} {unit}", cure="ask for less precision")
        guess = 4 * amount
        if found is not None:
            # Information, 1 / variance, grows from what is known about evenly with the test.
            now = found.predicted.figure**-2
            guess = amount * (1.001 * figure**-2 - start) / max(now - start, 1e-300)
        inside = low < guess < high
        amount = guess if inside else ((low + high) / 2 if np.isfinite(high) else 2 * low)
        if budget.samples is not None:
            amount = math.ceil(amount)
            if amount >= high:
                break
    if best is None:
        raise UsageError("no test in this band reaches the target", cure="ask for less precision")
    return best


def _cost(found: Plan) -> float:
    time = found.time_s
    return float(found.samples) if time is None else time


def _check_rate(grid: Grid, budget: Budget) -> None:
    if budget.rate is not None and grid.high > NYQUIST * budget.rate:
        raise UsageError(
            f"the band ends at {grid.high:g} Hz, too near half the sampling rate of {budget.rate:g} Hz",
            cure=f"end the band at {NYQUIST * budget.rate:.4g} Hz, or sample faster",
        )


def _continuous(bench: Bench, terms: Terms, prior: Real, budget: Budget, grid: Grid) -> Allocation:
    """The optimum without rounding; settling is counted for as many dwells as it has."""
    dwells = max(1, min((len(bench.names) + 1) // 2, budget.most or 10**6))
    for _ in range(4):
        samples = budget.measured(dwells)
        while samples <= 0 and dwells > 1:
            dwells -= 1
            samples = budget.measured(dwells)
        if samples <= 0:
            raise UsageError(
                f"settling alone takes {budget.settle:.3g} s, the whole test",
                cure="allow more time, or --settle",
            )
        found = optimise(bench.information, terms, prior, samples, grid)
        count = min(len(found.share), budget.most or len(found.share))
        if budget.time is None or budget.settle == 0 or count >= dwells:
            return found
        dwells = count
    return found


def _with(grid: Grid, lines: Lines) -> Grid:
    """The grid with the frequencies of a test."""
    f, k = (
        np.concatenate([grid.frequency_hz, lines.frequency_hz]),
        np.concatenate([grid.pattern, lines.pattern]),
    )
    _, first = np.unique(np.stack([k, f]), axis=1, return_index=True)
    return Grid(f[first], k[first], grid.free)


def _F(bench: Bench, terms: Terms, prior: Real, found: Allocation, samples: float) -> float:
    kept = found.share > 1e-6
    lines = Lines(found.frequency_hz[kept], found.pattern[kept], samples * found.share[kept])
    return value(terms, prior + lines.information(bench)).F


class _Shares:
    """Shares of a test that lose frequencies one by one, and their rounding to whole periods."""

    def __init__(
        self, bench: Bench, terms: Terms, prior: Real, budget: Budget, grid: Grid, found: Allocation
    ) -> None:
        self.bench, self.terms, self.prior, self.budget, self.grid = bench, terms, prior, budget, grid
        kept = found.share > 1e-6
        self.f, self.k = found.frequency_hz[kept].copy(), found.pattern[kept].copy()
        self.w = found.share[kept] / np.sum(found.share[kept])

    @property
    def count(self) -> int:
        return len(self.f)

    def may_gain(self, lines: Lines | None) -> bool:
        """Whether fewer dwells could be better: settling costs time, or some dwell is shorter than is allowed."""
        if lines is None or (self.budget.time is not None and self.budget.settle > 0):
            return True
        samples = max(self.budget.measured(self.count), 1.0)
        return bool(np.any(self.w * samples < self._least()))

    def join(self) -> None:
        """One dwell for those that crowd around a frequency, where that costs next to nothing.

        The optimum is flat there, and what finds it spreads the time over neighbours.
        """
        samples = max(self.budget.measured(self.count), self.budget.measured(0) / 2)
        before = self.f, self.k, self.w
        now = self._F(samples)
        for width in CROWDS:
            self.f, self.k, self.w = clusters(*before, width, self.grid.free)
            if self.count == len(before[0]):
                return
            self._improve(samples)
            slack = SIMPLER * (1.0 if self.terms.block is not None else now)
            if self._F(samples) <= now + slack:
                return
        self.f, self.k, self.w = before

    def _F(self, samples: float) -> float:
        M = self.bench.information(self.f, self.k)
        return value(self.terms, self.prior + samples * np.einsum("i,siab->sab", self.w, M)).F

    def _least(self) -> Real:
        """Fewest samples of each dwell."""
        least = np.full(self.count, float(MIN_SAMPLES))
        if self.budget.rate is not None:
            least = np.floor(self._least_periods() * self.budget.rate / self.f + 1e-9)
        return least

    def _least_periods(self) -> Real:
        rate = self.budget.rate
        assert rate is not None
        long = np.maximum(self.budget.min_dwell, MIN_SAMPLES / rate)
        periods: Real = np.maximum(np.ceil(long * self.f - 1e-9), 1.0)
        return periods

    def thin(self, count: int) -> None:
        """Down to `count` frequencies: drop those that cost least, then shift the others."""
        if count >= self.count:
            return
        samples = self.budget.measured(count)
        if samples <= 0:
            samples = self.budget.measured(0)
        while self.count > count:
            M = samples * self.bench.information(self.f, self.k)
            tries = []
            for out in range(self.count):
                rest = np.delete(np.arange(self.count), out)
                w = self.w[rest] / np.sum(self.w[rest])
                tries.append(value(self.terms, self.prior + np.einsum("i,siab->sab", w, M[:, rest])).F)
            rest = np.delete(np.arange(self.count), int(np.argmin(tries)))
            self.f, self.k, self.w = self.f[rest], self.k[rest], self.w[rest] / np.sum(self.w[rest])
        self._improve(samples)

    def _improve(self, samples: float) -> None:
        """Shares and frequencies in turn, each frequency by zooming in on the best of several places."""
        last = np.inf
        for _ in range(8):
            M = samples * self.bench.information(self.f, self.k)
            if not np.isfinite(value(self.terms, self.prior + np.mean(M, axis=1)).F):
                return
            self.w = weigh(self.terms, self.prior, M).w
            # With many dwells left each matters little: their shares make up for the one that went.
            if self.grid.free and self.grid.high > self.grid.low and self.count <= FEW:
                for i in range(self.count):
                    M = self._shift(i, M, samples)
            F = value(self.terms, self.prior + np.einsum("i,siab->sab", self.w, M)).F
            gain = last - F if self.terms.block is not None else (last - F) / F
            if gain < 1e-6:
                return
            last = F

    def _shift(self, i: int, M: Real, samples: float) -> Real:
        rest = self.prior + np.einsum("i,siab->sab", np.delete(self.w, i), np.delete(M, i, axis=1))
        low, high, places = self.grid.low, self.grid.high, 33
        best, here = M[:, i], value(self.terms, rest + self.w[i] * M[:, i]).F
        for _ in range(4):
            f = np.geomspace(low, high, places)
            own = samples * self.bench.information(f, np.full(places, self.k[i]))
            F = np.array([value(self.terms, rest + self.w[i] * own[:, j]).F for j in range(places)])
            top = int(np.argmin(F))
            if F[top] < here:
                self.f[i], best, here = f[top], own[:, top], F[top]
            low, high, places = f[max(top - 1, 0)], f[min(top + 1, places - 1)], 9
        M = M.copy()
        M[:, i] = best
        return M

    def rounded(self) -> Lines | None:
        """Whole periods (samples where there is no rate) within the budget; None where they do not fit."""
        rate = self.budget.rate
        if self.grid.free:
            f = np.array([float(f"{own:.6g}") for own in self.f])  # what a controller can be told
            self.f = np.clip(f, self.grid.low, self.grid.high)
        order = np.lexsort((self.f, self.k))
        self.f, self.k, self.w = self.f[order], self.k[order], self.w[order]
        total = self.budget.measured(self.count)
        ideal = self.w * total
        if rate is None:
            unit, least = np.ones(self.count), self._least()
        else:
            unit, least = rate / self.f, self._least_periods()
        units = np.maximum(np.floor(ideal / unit + 1e-9), least)
        # In samples of measuring time; a dwell's own samples are the whole ones among them.
        while np.sum(units * unit) > total * (1 + 1e-12):
            spare = units > least
            if not np.any(spare):
                return None
            over = np.where(spare, units * unit / np.maximum(ideal, 1e-300), -np.inf)
            i = int(np.argmax(over))
            units[i] -= max(1.0, min(units[i] - least[i], np.floor((np.sum(units * unit) - total) / unit[i])))
        each = self.bench.information(self.f, self.k)
        for _ in range(4 * self.count):
            left = total * (1 + 1e-12) - np.sum(units * unit)
            fits = np.flatnonzero(unit <= left)
            if len(fits) == 0:
                break
            M = self.prior + np.einsum("i,siab->sab", np.floor(units * unit + 1e-9), each)
            F = [value(self.terms, M + unit[i] * each[:, i]).F for i in fits]
            now = value(self.terms, M).F
            # What is won for what it takes.
            gain = [(now - F[j]) / unit[i] if np.isfinite(now) else -F[j] for j, i in enumerate(fits)]
            units[fits[int(np.argmax(gain))]] += 1
        return Lines(self.f, self.k, np.floor(units * unit + 1e-9))


def _assembled(
    bench: Bench, goal: Goal, budget: Budget, prior: Real, doubt: Doubt, found: Allocation, lines: Lines
) -> Plan:
    drive = bench.drive(lines.frequency_hz, lines.pattern)
    names = [*bench.model.displacement_inputs, *bench.model.force_inputs]
    dwells = []
    for f, count, own in zip(lines.frequency_hz, lines.samples, drive, strict=True):
        amplitudes = {name: complex(z) for name, z in zip(names, own, strict=True)}
        periods = time = None
        if budget.rate is not None:
            periods = round((count + 0.5) * f / budget.rate) if count * f / budget.rate >= 1 else 1
            periods = max(periods, math.ceil(count * f / budget.rate - 1e-9))
            time = float(periods / f)
        dwells.append(Dwell(float(f), amplitudes, int(count), periods, time, budget.settle))
    predicted = predict(bench, goal, prior + lines.information(bench), doubt)
    ideal = goal.figure(found.F)
    loss = predicted.figure / ideal - 1
    return Plan(
        goal.name, tuple(dwells), lines, predicted, ideal, found.gap, loss, found, _remarks(bench, lines)
    )


def _remarks(bench: Bench, lines: Lines) -> tuple[str, ...]:
    """What the user should know of the sensors at the chosen frequencies."""
    seen = bench.seen(lines.frequency_hz, lines.pattern)
    size = np.abs(seen.Y)
    largest = np.max(size, axis=0, initial=0.0)
    remarks = []
    for i, channel in enumerate(bench.channels):
        faint = (size[:, i] > 0) & (size[:, i] < 1e-3 * largest[i])
        if channel.noise == 0 and channel.relative_noise > 0 and np.any(faint):
            f = lines.frequency_hz[int(np.argmax(faint))]
            remarks.append(
                f"{channel.name} hardly moves at {f:.4g} Hz, where purely relative noise makes it look perfect: "
                "state its noise floor too"
            )
    return tuple(remarks)


# Comparison


def spread_of_iv(bench: Bench, lines: Lines) -> Prediction | None:
    """What the paper's bootstrap instrumental variables would give from the same test (the sandwich of THEORY §5).

    None where they cannot be used: some coordinate is not seen, or a calibration is unknown.
    """
    if calibration_names(bench.channels):
        return None
    seen = bench.seen(lines.frequency_hz, lines.pattern)
    sd = noise_sd(bench.channels, seen.Y)
    variance = 4 * sd**2 / lines.samples[:, None]
    V = (variance[..., None] * np.eye(len(bench.channels))).astype(np.complex128)
    count = len(lines.frequency_hz)
    spectrum = Spectrum(
        bench.channels, lines.frequency_hz, seen.Y, V, np.maximum(lines.samples, 1).astype(np.int64),
        np.full(count, np.inf), ("given",) * count, np.zeros(count, dtype=np.int64),
    )  # fmt: skip
    try:
        found = identify(bench.model, spectrum, InstrumentalVariables())
    except DashpotError:
        return None
    size = np.abs(np.where(found.values == 0, 1.0, found.values))
    C = found.noise_covariance
    rms = float(np.sqrt(np.mean(np.diagonal(C) / size**2)))
    return Prediction(found.names, found.units, found.values, np.sqrt(np.diagonal(C)), C, rms)


def _beside(bench: Bench, found: Prediction, known: Real) -> Prediction:
    """An estimate weighed with what is known, (scenarios, q, q) in parts of the sizes, at the nominal values."""
    size = bench.sizes[0]
    outer = np.outer(size, size)
    C = np.linalg.inv(np.linalg.inv(found.covariance / outer) + known[0]) * outer
    rms = float(np.sqrt(np.mean(np.diagonal(C) / size**2)))
    return replace(found, sd=np.sqrt(np.diagonal(C)), covariance=C, figure=rms)


@dataclass(frozen=True)
class Comparison:
    """Another test beside the plan.

    predicted   what it would give with the optimal estimator, from as many samples as it has
    iv          the same with the paper's bootstrap; None where that cannot be used
    factor      how many times the plan's samples it takes to be as good as the plan; inf where it never is
    factor_iv   the same with the paper's bootstrap
    """

    lines: Lines
    predicted: Prediction
    iv: Prediction | None
    factor: float
    factor_iv: float | None


def compare(
    bench: Bench, goal: Goal, found: Plan, other: Lines, *, known: Real | None = None, doubt: Doubt = "worst"
) -> Comparison:
    """Another test against a plan.

    Raises IdentifiabilityError where it does not determine the unknowns, whatever the number of its samples.
    """
    prior = bench.prior if known is None else known
    M = other.information(bench)
    predicted = predict(bench, goal, prior + M, doubt)
    terms = goal.terms(bench, doubt)
    aim = value(terms, prior + found.lines.information(bench)).F
    low, high = -20.0, 40.0
    if aim < value(terms, prior + np.exp(high) * M).F:
        times = math.inf
    else:
        for _ in range(80):
            middle = (low + high) / 2
            low, high = (middle, high) if aim < value(terms, prior + np.exp(middle) * M).F else (low, middle)
        times = float(np.exp(high))
    ratio = float(np.sum(other.samples)) / max(float(np.sum(found.lines.samples)), 1.0)
    iv = spread_of_iv(bench, other)
    factor_iv = None
    if iv is not None and known is None:
        names = [u.name for u in bench.model.unknowns]
        factor_iv = ratio * (iv.rms(names) / found.predicted.rms(names)) ** 2
    if iv is not None and known is not None:
        iv = _beside(bench, iv, known)
    return Comparison(other, predicted, iv, ratio * times, factor_iv)


def even_lines(frequencies: Sequence[float], samples: float, weights: Sequence[float] | None = None) -> Lines:
    """A test of given frequencies that share the samples evenly, or as `weights` say."""
    f = np.asarray(frequencies, dtype=float)
    if len(f) == 0:
        raise UsageError(
            "the test to compare with has no frequencies", cure="write them as 1,1.5,2 or 0.5:25:0.5"
        )
    if np.any(~np.isfinite(f) | (f <= 0)):
        raise UsageError("a frequency that is not positive", cure="write frequencies in Hz, such as 1,1.5,2")
    w = np.ones(len(f)) if weights is None else np.asarray(weights, dtype=float)
    return Lines(f, np.zeros(len(f), dtype=np.int64), samples * w / np.sum(w))


# Files


def to_json(found: Plan, extra: Mapping[str, Any] | None = None) -> str:
    """The plan as JSON; amplitudes in SI units, with phases in degrees where inputs move out of step."""
    predicted = {}
    p = found.predicted
    for j, name in enumerate(p.names):
        sd, v = float(p.sd[j]), float(p.values[j])
        predicted[name] = {
            "value": v, "sd": sd, "relative_sd": float(p.relative[j]), "interval95": [v - 1.96 * sd, v + 1.96 * sd],
            "unit": p.units[j],
        }  # fmt: skip
    content: dict[str, Any] = {
        "dwells": [_dwell(dwell) for dwell in found.dwells],
        "predicted": predicted,
        "criterion": found.goal,
        "figure": p.figure,
        "ideal": found.ideal,
        "gap": found.gap,
        "loss": found.loss,
        "samples": found.samples,
        "time_s": found.time_s,
        "notes": list(found.notes),
    }
    content |= {} if extra is None else dict(extra)
    return encoded(content)


def _dwell(dwell: Dwell) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "frequency_hz": dwell.frequency_hz,
        "samples": dwell.samples,
        "amplitudes": {name: _amplitude(z) for name, z in dwell.amplitudes.items()},
        "time_s": dwell.time_s,
        "settle_s": dwell.settle_s,
        "periods": dwell.periods,
    }
    phases = {name: _phase(z) for name, z in dwell.amplitudes.items()}
    if any(phases.values()):
        entry["phases_deg"] = phases
    return entry


def _amplitude(z: complex) -> float:
    """Signed where the drive is in or against phase, else its size."""
    return z.real if abs(z.imag) <= 1e-12 * abs(z) else abs(z)


def _phase(z: complex) -> float:
    return 0.0 if abs(z.imag) <= 1e-12 * abs(z) else float(np.rad2deg(np.angle(z)))


def to_csv(found: Plan, units: Mapping[str, str] | None = None) -> str:
    """A table for the shaker's controller: one dwell a row, in the order in which to run them.

    `units` of the inputs by name stand in the header: u_amplitude_m.
    """
    inputs = list(found.dwells[0].amplitudes) if found.dwells else []
    turned = any(_phase(z) for dwell in found.dwells for z in dwell.amplitudes.values())
    head = ["dwell", "frequency_hz"]
    for name in inputs:
        unit = "" if units is None else f"_{units[name].replace('·', '')}"
        head += [f"{name}_amplitude{unit}"] + ([f"{name}_phase_deg"] if turned else [])
    rows = [",".join([*head, "settle_s", "periods", "time_s", "samples"])]
    for i, dwell in enumerate(found.dwells):
        cells = [str(i + 1), f"{dwell.frequency_hz:.9g}"]
        for name in inputs:
            z = dwell.amplitudes[name]
            cells.append(f"{_amplitude(z):.9g}")
            if turned:
                cells.append(f"{_phase(z):.6g}")
        cells += [f"{dwell.settle_s:.6g}", _cell(dwell.periods), _cell(dwell.time_s), str(dwell.samples)]
        rows.append(",".join(cells))
    return "\n".join(rows) + "\n"


def _cell(number: float | None) -> str:
    return "" if number is None else f"{number:.9g}"


def shares(bench: Bench, goal: Goal, lines: Lines, prior: Real, frequency_hz: Real, pattern: Ints) -> Real:
    """How much a sample at each frequency adds to what is known of each parameter, (frequencies, q).

    (C M(f) C)_jj / C_jj at the nominal values, times the test's samples: 1 is what its average sample adds.
    """
    C = value(goal.terms(bench, "worst"), prior + lines.information(bench)).C[0]
    own = bench.information(frequency_hz, pattern)[0]
    gain = np.einsum("ja,iab,bj->ij", C, own, C)
    total: Real = float(np.sum(lines.samples)) * gain / np.diagonal(C)
    return total


def drive_names(model_inputs: Sequence[str], drive: Complex) -> list[str]:
    """Patterns of a drive in words: "u", "u + v", "u − v"."""
    words = []
    for row in drive:
        text = ""
        for name, z in zip(model_inputs, row, strict=True):
            if z == 0:
                continue
            sign = "−" if abs(z.imag) < 1e-12 and z.real < 0 else "+"
            turn = "" if abs(z.imag) < 1e-12 else f"∠{_phase(complex(z)):.0f}°"
            text += f"{f' {sign} ' if text else ('−' if sign == '−' else '')}{name}{turn}"
        words.append(text)
    return words
