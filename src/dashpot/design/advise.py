"""From a question about the next test to its answer: what the command `dashpot design` asks for, in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.design.allocation import Grid, band_grid, natural_band
from dashpot.design.criteria import Doubt, Goal, MeanError, Volume
from dashpot.design.plan import (
    NYQUIST,
    Budget,
    Comparison,
    Lines,
    Plan,
    compare,
    even_lines,
    plan,
    predict,
    shortest,
    to_json,
)
from dashpot.design.robust import (
    GaussianPrior,
    Robust,
    UniformBox,
    gaussian_prior_of,
    in_the_worst_case,
    on_average,
    shortest_in_the_worst_case,
    slowest_settling,
    uniform_box_of,
)
from dashpot.design.sensors import Choice, choose
from dashpot.design.sequential import (
    Progress,
    Reading,
    Verdict,
    amplitude_from,
    enough,
    known_after,
    noise_from,
    progress,
    values_after,
)
from dashpot.design.test_setup import Bench, Limits, bench, drive_units
from dashpot.errors import IdentifiabilityError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import measures_input, with_relative_noise

ASSUMED = 0.01  # relative noise where no channel states any
FIRST_SAMPLES, FIRST_TIME = 1000.0, 60.0  # where the search for the shortest test starts


@dataclass(frozen=True)
class Question:
    """What is asked.  Frequencies in Hz, times in s, limits and amplitude in SI units.

    values     of unknowns by name; they go before those of an estimate, before guesses of the rig
    estimate   what was found earlier; `after`, lines measured earlier, are identified to get it
    target     relative standard deviation to reach by the goal's own figure; None: spend the budget
    samples, time   the budget; neither: the shortest test for the target
    doubt      None: the values are right; else over what the test is to be good: a part of every value (less where
               the rig file knows it better), a Box, a Cloud, or "estimate", the cloud of `estimate` or of what `after`
               tells
    pick       (count, names) of the sensors to choose; names () are all
    amplitude  of the drive where there is no limit; None: the median of the data's, else 1
    against    frequencies, or measured lines, to compare with
    """

    model: Model
    channels: tuple[Channel, ...]
    goal: Goal
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
    limits: Limits = field(default_factory=Limits)
    amplitude: float | None = None
    drives: tuple[str, ...] = ()
    doubt: float | UniformBox | GaussianPrior | Literal["estimate"] | None = None
    doubt_by: Doubt = "worst"
    pick: tuple[int, tuple[str, ...]] | None = None
    against: tuple[float, ...] | Spectrum | None = None


@dataclass(frozen=True)
class Answer:
    """What is advised; `plan` is None where the target is reached already."""

    bench: Bench
    goal: Goal
    grid: Grid
    known: Real
    plan: Plan | None
    comparison: Comparison | None
    choice: Choice | None
    robust: Robust | None
    estimate: Estimate | None
    so_far: Progress | None
    verdict: Verdict | None
    doubt: Doubt
    notes: tuple[str, ...]


def answer(question: Question) -> Answer:
    """The next test.

    Raises UsageError where the question lacks something, IdentifiabilityError where no test determines the unknowns.
    """
    model = question.model
    notes: list[str] = []
    estimate = question.estimate
    channels = question.channels
    if question.after is not None:
        estimate = identify(model, question.after)
        channels = noise_from(channels, question.after)
    channels = _noisy(model, channels, notes)
    amplitude = _amplitude(question, channels, notes)
    base = bench(
        model, channels, _nominal(question, estimate), limits=question.limits, amplitude=amplitude,
        drives=question.drives,
    )  # fmt: skip
    if estimate is not None and bool(np.any(estimate.fit.rejected)):
        notes.append(
            "the model does not fit the earlier data: intervals to expect count the sensors' noise alone, and what the "
            "model lacks will make the true ones wider"
        )
    information = None if estimate is None else known_after(base, estimate)
    rate = question.rate if question.rate is not None else _rate(channels)
    low, high = question.band if question.band is not None else natural_band(base, rate)
    if question.band is None:
        notes.append(f"the band is {low:.4g} to {high:.4g} Hz, about the rig's resonances; --band changes it")
    choice = None
    if question.pick is not None:
        choice = _pick(question, base, band_grid(base, low, high, question.step), information, rate)
        dropped = set(question.pick[1] or _outputs(base)) - set(choice.best)
        base = base.with_channels([c for c in base.channels if c.name not in dropped])
    about = _doubt(question, base, estimate)
    budget = _budget(question, base, rate, about)
    if rate is not None and high > NYQUIST * rate and question.band is None:
        high = NYQUIST * rate

    def grid_of(own: Bench) -> Grid:
        return band_grid(own, low, high, question.step)

    known = base.prior if information is None else base.known(information)
    found, wide, robust, doubt = _test(question, base, budget, grid_of, information, about)
    if wide is not base:
        known = wide.prior if information is None else wide.known(information)
    grid = grid_of(wide)
    comparison = None
    if found is not None and question.against is not None:
        other = _other(question.against, found)
        try:
            comparison = compare(
                wide, question.goal, found, other, known=None if information is None else known, doubt=doubt
            )
        except IdentifiabilityError:
            notes.append("the other test does not determine the unknowns, however many samples it takes")
    so_far, verdict = _stopping(question, estimate)
    if found is not None:
        notes += found.notes
    return Answer(
        wide, question.goal, grid, known, found, comparison, choice, robust, estimate, so_far, verdict, doubt,
        tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def _amplitude(question: Question, channels: tuple[Channel, ...], notes: list[str]) -> float:
    if question.amplitude is not None:
        return question.amplitude
    floors = [c.name for c in channels if c.noise > 0]
    if question.limits.given or not floors:
        return 1.0
    found = None if question.after is None else amplitude_from(question.model, question.after)
    whence = "is assumed" if found is None else "is the median of the data's"
    size = 1.0 if found is None else found
    unit = "/".join(dict.fromkeys(drive_units(question.model).values()))
    notes.append(
        f"the noise of {', '.join(floors[:4])} has a floor, so the drive's size matters: {size:.3g} {unit} {whence}; "
        "state --amplitude or the shaker's limits"
    )
    return size


def _doubt(question: Question, base: Bench, estimate: Estimate | None) -> UniformBox | GaussianPrior | None:
    if question.doubt is None or isinstance(question.doubt, UniformBox | GaussianPrior):
        return question.doubt
    if isinstance(question.doubt, float | int):
        return uniform_box_of(base.model, base.theta[0], question.doubt)
    if estimate is None:
        raise UsageError("a doubt of an estimate that is not there", cure="say the doubt with --doubt 30%")
    return gaussian_prior_of(base.model, estimate)


def _outputs(base: Bench) -> list[str]:
    return [c.name for c in base.channels if not measures_input(base.model, c)]


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
            cure=f"say roughly, such as --set {missing[0]}=1.5, put guess = … into the rig file, or give --estimate",
        )
    return values


def _rate(channels: tuple[Channel, ...]) -> float | None:
    rates = [c.rate for c in channels if c.rate is not None]
    return min(rates) if rates else None


def _budget(
    question: Question, base: Bench, rate: float | None, about: UniformBox | GaussianPrior | None
) -> Budget:
    samples, time = question.samples, question.time
    if samples is None and time is None:
        if question.target is None:
            raise UsageError(
                "say how much test there is", cure="--samples, --time, or --target for the shortest"
            )
        samples, time = (FIRST_SAMPLES, None) if rate is None else (None, FIRST_TIME)
    settle = question.settle
    if settle is None:
        settle = _settling(base, about) if time is not None else 0.0
    if samples is not None and question.settle is None and rate is not None:
        settle = _settling_or_none(base, about)
    return Budget(samples, time, rate, settle, question.min_dwell, question.most)


def _settling(base: Bench, about: UniformBox | GaussianPrior | None) -> float:
    """Settling time, s; with a doubt, of the slowest rig that it allows."""
    return base.settling() if about is None else slowest_settling(base, about)


def _settling_or_none(base: Bench, about: UniformBox | GaussianPrior | None) -> float:
    """Settling for a test that is counted in samples: told where it is known, 0 where nothing damps the rig."""
    try:
        return _settling(base, about)
    except UsageError:
        return 0.0


def _test(
    question: Question,
    base: Bench,
    budget: Budget,
    grid_of: Any,
    information: Real | None,
    about: UniformBox | GaussianPrior | None,
) -> tuple[Plan | None, Bench, Robust | None, Doubt]:
    shortest_one = question.samples is None and question.time is None
    if about is not None:
        goal = question.goal
        target = question.target if shortest_one else None
        if question.doubt_by == "average":
            robust = on_average(base, goal, budget, about, grid_of, target=target, known=information)
        elif target is not None:
            robust = shortest_in_the_worst_case(base, goal, target, budget, about, grid_of, known=information)
        else:
            robust = in_the_worst_case(base, goal, budget, about, grid_of, known=information)
        return robust.plan, robust.bench, robust, question.doubt_by
    known = None if information is None else base.known(information)
    if shortest_one:
        assert question.target is not None
        return (
            shortest(base, question.goal, question.target, budget, grid_of(base), known=known),
            base,
            None,
            "worst",
        )
    return plan(base, question.goal, budget, grid_of(base), known=known), base, None, "worst"


def _pick(
    question: Question, base: Bench, grid: Grid, information: Real | None, rate: float | None
) -> Choice:
    assert question.pick is not None
    count, names = question.pick
    known = None if information is None else base.known(information)
    samples = question.samples if question.samples is not None else FIRST_SAMPLES
    if question.time is not None and rate is not None:
        samples = question.time * rate
    return choose(base, question.goal, samples, grid, count, names, known=known)


def _other(against: tuple[float, ...] | Spectrum, found: Plan) -> Lines:
    """The test to compare with, of as many samples as the plan."""
    if isinstance(against, Spectrum):
        return even_lines(against.frequency_hz.tolist(), found.samples, against.samples.tolist())
    return even_lines(against, found.samples)


def _stopping(question: Question, estimate: Estimate | None) -> tuple[Progress | None, Verdict | None]:
    if question.after is None or estimate is None:
        return None, None
    so_far = progress(question.model, question.after, whole=estimate)
    if question.target is None:
        return so_far, None
    goal = question.goal
    targets = getattr(goal, "targets", {})
    if not targets:
        every = [u.name for u in question.model.unknowns]
        own = [u.name for u in question.model.unknowns if u.sd is None]
        targets = dict.fromkeys(getattr(goal, "names", ()) or own or every, question.target)
    reading: Reading = (
        "volume" if isinstance(goal, Volume) else "rms" if isinstance(goal, MeanError) else "each"
    )
    if len(targets) == 1:
        reading = "each"
    known = np.diag(question.model.prior_precision)
    verdict = enough(estimate, dict(targets), int(np.sum(question.after.samples)), known, reading)
    return so_far, verdict


def json_of(found: Answer) -> str:
    """The answer as JSON; the plan's contract with what was asked beside it."""
    extra: dict[str, Any] = {"notes": list(found.notes)}
    if found.comparison is not None:
        c = found.comparison
        extra["against"] = {
            "frequencies_hz": c.lines.frequency_hz.tolist(),
            "predicted": {
                n: {"sd": float(s)} for n, s in zip(c.predicted.names, c.predicted.sd, strict=True)
            },
            "figure": c.predicted.figure,
            "iv": None
            if c.iv is None
            else {n: {"sd": float(s)} for n, s in zip(c.iv.names, c.iv.sd, strict=True)},
            "sample_factor": c.factor,
            "sample_factor_iv": c.factor_iv,
        }
    if found.choice is not None:
        extra["sensors"] = {
            "best": list(found.choice.best), "complete": found.choice.complete,
            "ranking": [{"sensors": list(names), "figure": figure} for names, figure in found.choice.ranking[:20]],
        }  # fmt: skip
    if found.robust is not None:
        extra["worst_case"] = found.robust.worst
    if found.so_far is not None:
        s = found.so_far
        extra["so_far"] = {
            "samples": s.samples.tolist(),
            "relative_sd": {name: s.relative[:, j].tolist() for j, name in enumerate(s.names)},
        }
    if found.verdict is not None:
        v = found.verdict
        extra["enough"] = {
            "reached": v.reached, "worst": v.worst, "over_target": v.excess, "more_samples": v.more, "reason": v.reason,
        }  # fmt: skip
    if found.plan is None:
        predicted = predict(found.bench, found.goal, found.known)
        return to_json(nothing_to_do(found, predicted.figure), extra)
    return to_json(found.plan, extra)


def nothing_to_do(found: Answer, figure: float) -> Plan:
    """A plan without dwells: the target is reached already."""
    from dashpot.design.allocation import Allocation

    none, index = np.zeros(0), np.zeros(0, dtype=np.int64)
    predicted = predict(found.bench, found.goal, found.known)
    allocation = Allocation(none, index, none, 0.0, 0.0, (none, index, none))
    return Plan(found.goal.name, (), Lines(none, index, none), predicted, figure, 0.0, 0.0, allocation)
