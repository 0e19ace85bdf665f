"""From a question about the next test to its answer: what the command `dashpot design` asks for, in SI units."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.design.alternative import Alternative, compare_tests
from dashpot.design.budget import NYQUIST, Budget
from dashpot.design.criteria import Criterion, Robustness
from dashpot.design.drive_of_laws import drives_that_show
from dashpot.design.frequency_grid import FrequencyGrid, band_grid, natural_band
from dashpot.design.plan import Plan, plan
from dashpot.design.robust import (
    GaussianPrior,
    Map,
    Robust,
    UniformBox,
    gaussian_prior_of,
    in_the_worst_case,
    on_average,
    shortest_in_the_worst_case,
    slowest_settling,
    uniform_box_of,
)
from dashpot.design.schedule import Schedule, even_schedule
from dashpot.design.sensors import Choice, choose
from dashpot.design.shortest import shortest
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
from dashpot.errors import IdentifiabilityError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.model.channel_noise import with_relative_noise
from dashpot.model.network import Model
from dashpot.model.observation import measures_input

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
