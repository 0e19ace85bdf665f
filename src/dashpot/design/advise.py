"""From a question about the next test to its answer: what the command `dashpot design` asks for, in SI units."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import comb
from typing import Literal

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.design.allocation import optimise
from dashpot.design.criteria import (
    Criterion,
    ExpectedPrecision,
    Robustness,
    criterion_value,
    expected_precision,
)
from dashpot.design.plan import Plan, plan
from dashpot.design.robust import (
    GaussianPrior,
    Map,
    Robust,
    UniformBox,
    gaussian_prior_of,
    in_the_worst_case,
    on_average,
    shortest,
    shortest_in_the_worst_case,
    slowest_settling,
    uniform_box_of,
)
from dashpot.design.schedule import (
    NYQUIST,
    Budget,
    FrequencyGrid,
    Schedule,
    band_grid,
    even_schedule,
    natural_band,
)
from dashpot.design.stopping import (
    SequentialEstimates,
    Verdict,
    amplitude_from,
    enough,
    known_after,
    noise_from,
    sequential_estimates,
    values_after,
)
from dashpot.design.test_setup import ShakerLimits, TestSetup, drive_units, nominal_setup
from dashpot.design.transients import UnsettledTest, unsettled_test
from dashpot.errors import DashpotError, IdentifiabilityError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import calibration_names, measures_input, noise_sd, with_relative_noise
from dashpot.numerics.small_systems import scaled_inverse

# At which drive the nonlinear elements of a rig show in a planned test.


SHARES = np.geomspace(0.01, 1.0, 17)  # of the planned drive
CLEAR = 3.0  # standard deviations at which a law shows


def drives_that_show(setup: TestSetup, schedule: Schedule, known: Real) -> list[str]:
    """A sentence for each nonlinear element: from which share of the planned drive its parameter is clear of zero.

    known (scenarios, q, q): what is known before the test, in parts of the sizes.
    """
    model, names = setup.model, setup.names
    planned = setup.drive(schedule.frequency_hz, schedule.pattern)
    clear = np.zeros((len(SHARES), len(names)), dtype=bool)
    for row, share in enumerate(SHARES):
        each = setup.per_sample(schedule.frequency_hz, share * planned)
        M = known[0] + np.einsum("i,iab->ab", schedule.samples, each[0])
        with np.errstate(all="ignore"):
            relative = np.sqrt(np.diagonal(scaled_inverse(M)))
        clear[row] = CLEAR * relative < 1
    sentences = []
    unit = "/".join(dict.fromkeys(drive_units(model).values()))
    size = float(np.max(np.abs(planned)))
    for index in model.nonlinear:
        for j in np.flatnonzero(model.T[index]):
            rows = np.flatnonzero(clear[:, j])
            if not len(rows):
                sentences.append(f"{names[j]} does not show at this drive: drive further, or measure longer")
            elif rows[0]:
                share = float(SHARES[rows[0]])
                sentences.append(
                    f"{names[j]} shows (three standard deviations) from about {100 * share:.2g} % of the drive on, "
                    f"{share * size:.2g} {unit} at most"
                )
    return list(dict.fromkeys(sentences))


# Another test beside a plan: what it would give, and how many times the samples it takes.


def spread_of_iv(setup: TestSetup, schedule: Schedule) -> ExpectedPrecision | None:
    """What the paper's bootstrap instrumental variables would give from the same test (the sandwich of THEORY §5).

    None where they cannot be used: some coordinate is not seen, a calibration is unknown, or an element is nonlinear.
    """
    if calibration_names(setup.channels) or len(setup.model.nonlinear):
        return None
    seen = setup.seen(schedule.frequency_hz, schedule.pattern)
    sd = noise_sd(setup.channels, seen.Y)
    variance = 4 * sd**2 / schedule.samples[:, None]
    V = (variance[..., None] * np.eye(len(setup.channels))).astype(np.complex128)
    count = len(schedule.frequency_hz)
    spectrum = Spectrum(
        setup.channels, schedule.frequency_hz, seen.Y, V, np.maximum(schedule.samples, 1).astype(np.int64),
        np.full(count, np.inf), ("given",) * count, np.zeros(count, dtype=np.int64),
    )  # fmt: skip
    try:
        estimate = identify(setup.model, spectrum, InstrumentalVariables())
    except DashpotError:
        return None
    size = np.abs(np.where(estimate.values == 0, 1.0, estimate.values))
    C = estimate.noise_covariance
    rms = float(np.sqrt(np.mean(np.diagonal(C) / size**2)))
    return ExpectedPrecision(estimate.names, estimate.units, estimate.values, np.sqrt(np.diagonal(C)), C, rms)


def _beside(setup: TestSetup, found: ExpectedPrecision, known: Real) -> ExpectedPrecision:
    """An estimate weighed with what is known, (scenarios, q, q) in parts of the sizes, at the nominal values."""
    size = setup.sizes[0]
    outer = np.outer(size, size)
    C = np.linalg.inv(np.linalg.inv(found.covariance / outer) + known[0]) * outer
    rms = float(np.sqrt(np.mean(np.diagonal(C) / size**2)))
    return replace(found, sd=np.sqrt(np.diagonal(C)), covariance=C, figure=rms)


@dataclass(frozen=True)
class Alternative:
    """Another test beside the plan.

    predicted   what it would give with the optimal estimator, from as many samples as it has
    iv          the same with the paper's bootstrap; None where that cannot be used
    factor      how many times the plan's samples it takes to be as good as the plan; inf where it never is
    factor_iv   the same with the paper's bootstrap
    """

    schedule: Schedule
    predicted: ExpectedPrecision
    iv: ExpectedPrecision | None
    factor: float
    factor_iv: float | None


def compare_tests(
    setup: TestSetup,
    criterion: Criterion,
    plan: Plan,
    other: Schedule,
    *,
    known: Real | None = None,
    robustness: Robustness = "worst",
) -> Alternative:
    """Another test against a plan.

    Raises IdentifiabilityError where it does not determine the unknowns, whatever the number of its samples.
    known (unknowns, unknowns): information in SI units.
    """
    prior = setup.prior if known is None else known
    M = other.information(setup)
    predicted = expected_precision(setup, criterion, prior + M, robustness)
    terms = criterion.terms(setup, robustness)
    aim = criterion_value(terms, prior + plan.schedule.information(setup)).F
    times = _times_as_long(lambda t: criterion_value(terms, prior + t * M).F, aim)
    ratio = float(np.sum(other.samples)) / max(float(np.sum(plan.schedule.samples)), 1.0)
    iv = spread_of_iv(setup, other)
    factor_iv = None
    if iv is not None and known is None:
        names = [u.name for u in setup.model.unknowns]
        factor_iv = ratio * (iv.rms(names) / plan.predicted.rms(names)) ** 2
    if iv is not None and known is not None:
        iv = _beside(setup, iv, known)
    return Alternative(other, predicted, iv, ratio * times, factor_iv)


def _times_as_long(F: Callable[[float], float], aim: float) -> float:
    """The factor at which a falling F reaches `aim`, between e⁻²⁰ and e⁴⁰; inf beyond."""
    low, high = -20.0, 40.0
    if aim < F(float(np.exp(high))):
        return math.inf
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if aim < F(float(np.exp(middle))) else (low, middle)
    return float(np.exp(high))


# Which sensors to mount: the best few of those that could be.


EXACT = 300  # sets that are all tried
COARSE = 60  # points of the grid on which sets are ranked

Sensors = tuple[str, ...]  # names of channels


@dataclass(frozen=True)
class Choice:
    """Sets of sensors in order of merit: names and the criterion's figure at the best test with them.

    `complete` says whether all sets were tried; else a greedy choice was improved by exchanges.
    """

    ranking: tuple[tuple[tuple[str, ...], float], ...]
    complete: bool

    @property
    def best(self) -> tuple[str, ...]:
        """Names of the best set."""
        return self.ranking[0][0]


def choose(
    setup: TestSetup,
    criterion: Criterion,
    samples: float,
    grid: FrequencyGrid,
    count: int,
    among: Sequence[str] = (),
    *,
    known: Real | None = None,
    robustness: Robustness = "worst",
) -> Choice:
    """The best `count` of the channels `among` (by default all that see more than inputs); the others stay.

    Raises UsageError for names that are no channels, IdentifiabilityError where no set determines the unknowns.
    """
    pool = _pool(setup, count, among, after_data=known is not None)
    step = max(1, len(grid.frequency_hz) // COARSE)
    coarse = FrequencyGrid(grid.frequency_hz[::step], grid.pattern[::step], free=False)
    figures: dict[Sensors, float] = {}

    def figure(chosen: Sensors, grid: FrequencyGrid) -> float:
        kept = [c for c in setup.channels if c.name not in pool or c.name in chosen]
        try:
            chosen_setup = setup.with_channels(kept)
            prior = chosen_setup.prior if known is None else known
            terms = criterion.terms(chosen_setup, robustness)
            return criterion.figure(optimise(chosen_setup.information, terms, prior, samples, grid).F)
        except (IdentifiabilityError, UsageError):
            return np.inf

    def score(chosen: Sensors) -> float:
        if chosen not in figures:
            figures[chosen] = figure(chosen, coarse)
        return figures[chosen]

    complete = comb(len(pool), count) <= EXACT
    if complete:
        for chosen in combinations(pool, count):
            score(chosen)
    else:
        _exchange(pool, count, score)
    sets = sorted((chosen for chosen in figures if len(chosen) == count), key=figures.__getitem__)
    figures |= {chosen: figure(chosen, grid) for chosen in sets[:3]}
    ranking = sorted(((c, figures[c]) for c in sets if np.isfinite(figures[c])), key=lambda entry: entry[1])
    if not ranking or not np.isfinite(ranking[0][1]):
        raise IdentifiabilityError(
            f"no {count} of these sensors determine the unknowns",
            cure="mount more, or give a parameter its value",
        )
    return Choice(tuple(ranking), complete)


def _pool(setup: TestSetup, count: int, among: Sequence[str], after_data: bool) -> list[str]:
    """Names of the sensors to choose from."""
    names = [channel.name for channel in setup.channels]
    pool = list(among) if among else [c.name for c in setup.channels if not measures_input(setup.model, c)]
    for name in pool:
        if name not in names:
            raise UsageError(f"the rig has no channel {name}", cure=f"it has {', '.join(names)}")
    if not 0 < count <= len(pool):
        raise UsageError(f"{count} of {len(pool)} sensors", cure=f"pick between 1 and {len(pool)}")
    if after_data and len(setup.names) > len(setup.model.unknowns):
        raise UsageError(
            "sensors with unknown calibrations cannot be chosen after data", cure="calibrate them"
        )
    return pool


def _exchange(pool: Sequence[str], count: int, score: Callable[[Sensors], float]) -> None:
    """Leave out the least useful sensor until `count` are left, then exchange one by one while that helps."""
    order = {name: i for i, name in enumerate(pool)}

    def figure(names: set[str]) -> float:
        return score(tuple(sorted(names, key=order.__getitem__)))

    chosen = set(pool)
    while len(chosen) > count:
        chosen = min((chosen - {name} for name in chosen), key=figure)
    lowest = figure(chosen)
    for _ in range(10):
        swaps = [(chosen - {a}) | {b} for a in chosen for b in set(pool) - chosen]
        best = min(swaps, key=figure)
        if figure(best) >= lowest * (1 - 1e-9):
            return
        chosen, lowest = best, figure(best)


ASSUMED = 0.01  # relative noise where no channel states any
FIRST_SAMPLES, FIRST_TIME = 1000.0, 60.0  # where the search for the shortest test starts

Uncertainty = UniformBox | GaussianPrior


@dataclass(frozen=True, kw_only=True)
class Question:
    """What is asked.  Frequencies in Hz, times in s, limits and amplitude in SI units.

    values       of unknowns by name; they go before those of an estimate, before guesses of the rig
    estimate     what was found earlier; `after`, lines measured earlier, are identified to get it
    target       relative standard deviation to reach by the criterion's own figure; None: spend the budget
    samples, time   the budget; neither: the shortest test for the target
    settle       s before each dwell; None: from the modes
    most         at most that many dwells
    band, step   where to look for frequencies; None: about the resonances, and anywhere in the band
    uncertainty  None: the values are right; else over what the test is to be good: a part of every value (less where
                 the rig file knows it better), a UniformBox, a GaussianPrior, or "estimate", the covariance of
                 `estimate` or of what `after` tells
    pick         (count, names) of the sensors to choose; names () are all
    amplitude    of the drive where there is no limit; None: the median of the data's, else 1
    against      frequencies, or measured lines, to compare with
    """

    model: Model
    channels: tuple[Channel, ...]
    criterion: Criterion
    values: Mapping[str, float] = field(default_factory=dict)
    estimate: Estimate | None = None
    after: Spectrum | None = None
    target: float | None = None
    samples: float | None = None
    time: float | None = None
    rate: float | None = None
    settle: float | None = None
    min_dwell: float = 0.0
    most: int | None = None
    band: tuple[float, float] | None = None
    step: float | None = None
    limits: ShakerLimits = field(default_factory=ShakerLimits)
    amplitude: float | None = None
    drives: tuple[str, ...] = ()
    uncertainty: float | Uncertainty | Literal["estimate"] | None = None
    robustness: Robustness = "worst"
    pick: tuple[int, tuple[str, ...]] | None = None
    against: tuple[float, ...] | Spectrum | None = None


@dataclass(frozen=True)
class Answer:
    """What is advised; `plan` is None where the target is reached already.

    known (scenarios, q, q) is the information before the test, in parts of the setup's sizes; unsettled, what the same
    test tells from all samples, None where that cannot be said.
    """

    setup: TestSetup
    criterion: Criterion
    grid: FrequencyGrid
    known: Real
    plan: Plan | None
    comparison: Alternative | None
    choice: Choice | None
    robust: Robust | None
    estimate: Estimate | None
    so_far: SequentialEstimates | None
    verdict: Verdict | None
    robustness: Robustness
    notes: tuple[str, ...]
    unsettled: UnsettledTest | None = None


@dataclass(frozen=True)
class _Knowledge:
    """What earlier data say: an estimate, and its information (q, q) in SI units; None where there are none."""

    estimate: Estimate | None
    information: Real | None

    def of(self, setup: TestSetup) -> Real:
        """What is known before the test, (scenarios, q, q) in parts of the sizes."""
        return setup.prior if self.information is None else setup.known(self.information)

    def from_data(self, setup: TestSetup) -> Real | None:
        """The same; None where nothing but the rig's priors is known."""
        return None if self.information is None else setup.known(self.information)


def answer(question: Question, *, mapper: Map = map) -> Answer:
    """The next test; `mapper` shares out the search for the worst case of uncertain values.

    Raises UsageError where the question lacks something, IdentifiabilityError where no test determines the unknowns.
    """
    notes: list[str] = []
    setup, knowledge = _start(question, notes)
    rate = question.rate if question.rate is not None else _rate(setup.channels)
    low, high = question.band if question.band is not None else natural_band(setup, rate)
    if question.band is None:
        notes.append(f"no band is given: {low:.4g} to {high:.4g} Hz, around the rig's resonances, is used")
    choice = None
    if question.pick is not None:
        choice = _pick(question, setup, band_grid(setup, low, high, question.step), knowledge, rate)
        dropped = set(question.pick[1] or _outputs(setup)) - set(choice.best)
        setup = setup.with_channels([c for c in setup.channels if c.name not in dropped])
    uncertainty = _uncertainty(question, setup, knowledge.estimate)
    budget = _budget(question, setup, rate, uncertainty)
    if rate is not None and question.band is None:
        high = min(high, NYQUIST * rate)

    def grid_of(setup: TestSetup) -> FrequencyGrid:
        return band_grid(setup, low, high, question.step)

    advised, robust = _test(question, setup, budget, grid_of, knowledge, uncertainty, mapper)
    setup = setup if robust is None else robust.setup
    robustness: Robustness = "worst" if robust is None else question.robustness
    comparison = _comparison(question, setup, advised, knowledge, robustness, notes)
    so_far, verdict = _stopping(question, knowledge.estimate)
    unsettled = None
    if advised is not None:
        notes += advised.notes
        unsettled = unsettled_test(setup, question.criterion, advised, rate, knowledge.of(setup))
    if advised is not None and len(setup.model.nonlinear):
        notes += drives_that_show(setup, advised.schedule, knowledge.of(setup))
    return Answer(
        setup, question.criterion, grid_of(setup), knowledge.of(setup), advised, comparison, choice, robust,
        knowledge.estimate, so_far, verdict, robustness, tuple(dict.fromkeys(notes)), unsettled,
    )  # fmt: skip


def _start(question: Question, notes: list[str]) -> tuple[TestSetup, _Knowledge]:
    """The setup at the values to design for, and what earlier data say."""
    model, estimate, channels = question.model, question.estimate, question.channels
    if question.after is not None:
        estimate = identify(model, question.after)
        channels = noise_from(channels, question.after)
    channels = _noisy(model, channels, notes)
    setup = nominal_setup(
        model, channels, _nominal(question, estimate), limits=question.limits,
        amplitude=_amplitude(question, channels, notes), drives=question.drives,
    )  # fmt: skip
    if estimate is not None and bool(np.any(estimate.fit.rejected)):
        notes.append(
            "the model does not fit the earlier data: expected intervals count the sensors' noise alone, and what the "
            "model lacks will make the true ones wider"
        )
    return setup, _Knowledge(estimate, None if estimate is None else known_after(setup, estimate))


def _comparison(
    question: Question,
    setup: TestSetup,
    advised: Plan | None,
    knowledge: _Knowledge,
    robustness: Robustness,
    notes: list[str],
) -> Alternative | None:
    if advised is None or question.against is None:
        return None
    other, known = _other(question.against, advised), knowledge.from_data(setup)
    try:
        return compare_tests(setup, question.criterion, advised, other, known=known, robustness=robustness)
    except IdentifiabilityError:
        notes.append("the other test does not determine the unknowns, however many samples it takes")
        return None


def _amplitude(question: Question, channels: tuple[Channel, ...], notes: list[str]) -> float:
    if question.amplitude is not None:
        return question.amplitude
    floors = [c.name for c in channels if c.noise > 0]
    if question.limits.given or not (floors or len(question.model.nonlinear)):
        return 1.0
    measured = None if question.after is None else amplitude_from(question.model, question.after)
    if measured is None and len(question.model.nonlinear):
        raise UsageError(
            "the motion of a rig with nonlinear elements depends on the size of its drive",
            cure="state the drive's amplitude or the shaker's limits",
        )
    whence = "is assumed" if measured is None else "is the median of the data's"
    size = 1.0 if measured is None else measured
    unit = "/".join(dict.fromkeys(drive_units(question.model).values()))
    notes.append(
        f"the noise of {', '.join(floors[:4])} has a floor, so the drive's size matters: {size:.3g} {unit} {whence}; "
        "state the drive's amplitude or the shaker's limits"
    )
    return size


def _uncertainty(question: Question, setup: TestSetup, estimate: Estimate | None) -> Uncertainty | None:
    if question.uncertainty is None or isinstance(question.uncertainty, UniformBox | GaussianPrior):
        return question.uncertainty
    if isinstance(question.uncertainty, float | int):
        return uniform_box_of(setup.model, setup.theta[0], question.uncertainty)
    if estimate is None:
        raise UsageError(
            "there is no estimate to take the uncertainty from", cure="state it, for example 30 %"
        )
    return gaussian_prior_of(setup.model, estimate)


def _outputs(setup: TestSetup) -> list[str]:
    return [c.name for c in setup.channels if not measures_input(setup.model, c)]


def _noisy(model: Model, channels: tuple[Channel, ...], notes: list[str]) -> tuple[Channel, ...]:
    """Channels with noise; 1 % of the amplitude where none states any."""
    if any(c.noise > 0 or c.relative_noise > 0 for c in channels):
        return channels
    notes.append(
        "no channel states its noise: 1 % of each output's amplitude is assumed; intervals are proportional to it, "
        "the frequencies do not depend on its size"
    )
    return with_relative_noise(model, channels, ASSUMED)


def _nominal(question: Question, estimate: Estimate | None) -> dict[str, float]:
    """Values of the unknowns by name: as stated, else as estimated."""
    values = dict(question.values)
    if estimate is not None:
        for name, value in values_after(question.model, estimate).items():
            values.setdefault(name, value)
    missing = [
        u.name
        for u in question.model.unknowns
        if u.name not in values and u.prior is None and u.guess is None
    ]
    if missing:
        raise UsageError(
            f"{', '.join(missing)}: no value to design the test for",
            cure=f"state a rough value of {missing[0]}, put guess = … into the rig file, or give an estimate",
        )
    return values


def _rate(channels: tuple[Channel, ...]) -> float | None:
    rates = [c.rate for c in channels if c.rate is not None]
    return min(rates) if rates else None


def _budget(
    question: Question, setup: TestSetup, rate: float | None, uncertainty: Uncertainty | None
) -> Budget:
    samples, time = question.samples, question.time
    if samples is None and time is None:
        if question.target is None:
            raise UsageError(
                "there is neither a budget nor a target",
                cure="state a number of samples, a time, or the precision to reach",
            )
        samples, time = (FIRST_SAMPLES, None) if rate is None else (None, FIRST_TIME)
    settle = question.settle
    if settle is None and samples is None:
        settle = _settling(setup, uncertainty)
    if settle is None:
        settle = 0.0 if rate is None else _settling_or_none(setup, uncertainty)
    return Budget(samples, time, rate, settle, question.min_dwell, question.most)


def _settling(setup: TestSetup, uncertainty: Uncertainty | None) -> float:
    """Settling time, s; of uncertain values, that of the slowest rig."""
    return setup.settling() if uncertainty is None else slowest_settling(setup, uncertainty)


def _settling_or_none(setup: TestSetup, uncertainty: Uncertainty | None) -> float:
    """Settling for a test that is counted in samples: told where it is known, 0 where nothing damps the rig."""
    try:
        return _settling(setup, uncertainty)
    except UsageError:
        return 0.0


def _test(
    question: Question,
    setup: TestSetup,
    budget: Budget,
    grid_of: Callable[[TestSetup], FrequencyGrid],
    knowledge: _Knowledge,
    uncertainty: Uncertainty | None,
    mapper: Map,
) -> tuple[Plan | None, Robust | None]:
    """The plan (None: nothing is needed) and, of uncertain values, what it rests on."""
    criterion, information = question.criterion, knowledge.information
    target = question.target if question.samples is None and question.time is None else None
    if uncertainty is None:
        known, grid = knowledge.from_data(setup), grid_of(setup)
        if target is None:
            return plan(setup, criterion, budget, grid, known=known), None
        return shortest(setup, criterion, target, budget, grid, known=known), None
    if question.robustness == "average":
        robust = on_average(setup, criterion, budget, uncertainty, grid_of, target=target, known=information)
    elif target is not None:
        robust = shortest_in_the_worst_case(
            setup, criterion, target, budget, uncertainty, grid_of, known=information, mapper=mapper
        )
    else:
        robust = in_the_worst_case(
            setup, criterion, budget, uncertainty, grid_of, known=information, mapper=mapper
        )
    return robust.plan, robust


def _pick(
    question: Question, setup: TestSetup, grid: FrequencyGrid, knowledge: _Knowledge, rate: float | None
) -> Choice:
    assert question.pick is not None
    count, names = question.pick
    samples = question.samples if question.samples is not None else FIRST_SAMPLES
    if question.time is not None and rate is not None:
        samples = question.time * rate
    return choose(setup, question.criterion, samples, grid, count, names, known=knowledge.from_data(setup))


def _other(against: tuple[float, ...] | Spectrum, advised: Plan) -> Schedule:
    """The test to compare with, of as many samples as the plan."""
    if isinstance(against, Spectrum):
        return even_schedule(against.frequency_hz.tolist(), advised.samples, against.samples.tolist())
    return even_schedule(against, advised.samples)


def _stopping(
    question: Question, estimate: Estimate | None
) -> tuple[SequentialEstimates | None, Verdict | None]:
    if question.after is None or estimate is None:
        return None, None
    so_far = sequential_estimates(question.model, question.after, whole=estimate)
    if question.target is None:
        return so_far, None
    targets = question.criterion.targets_for(question.model, question.target)
    reading = "each" if len(targets) == 1 else question.criterion.reading
    known = np.diag(question.model.prior_precision)
    return so_far, enough(estimate, targets, int(np.sum(question.after.samples)), known, reading)
