"""From a question about the next test to its answer: what the command `dashpot design` asks for, in SI units."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import comb
from typing import Any, Literal

import numpy as np

from dashpot.channel import Channel
from dashpot.data.spectrum import Spectrum
from dashpot.design.allocation import Criterion, ExpectedPrecision, expected_precision, optimise
from dashpot.design.plan import NYQUIST, Budget, Dwell, Plan, UnsettledTest, unsettled_test
from dashpot.design.robust import Map, Uncertainty, best_test, slowest_settling, uniform_box_of
from dashpot.design.stopping import (
    SequentialEstimates,
    Verdict,
    after,
    amplitude_from,
    enough,
    gaussian_prior_of,
    least_factor,
    noise_from,
    sequential_estimates,
    values_after,
)
from dashpot.design.test_setup import (
    FrequencyGrid,
    Robustness,
    Schedule,
    TestSetup,
    band_grid,
    drive_units,
    even_schedule,
    natural_band,
    nominal_setup,
)
from dashpot.errors import DashpotError, IdentifiabilityError, UsageError
from dashpot.estimate.identify import identify
from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables
from dashpot.estimate.result import Estimate
from dashpot.io.json_document import to_json
from dashpot.model.network import Model
from dashpot.model.observation import calibration_names, measures_input, noise_sd, with_relative_noise
from dashpot.model.rigfile.rig import ShakerLimits, usual_limits
from dashpot.numerics.small_systems import scaled_inverse


def drives_that_show(setup: TestSetup, schedule: Schedule) -> list[str]:
    """A sentence for each nonlinear element: from which share of the planned drive its parameter is clear of zero."""
    model, names = setup.model, setup.names
    planned = setup.drive(schedule.frequency_hz, schedule.pattern)
    shares = np.geomspace(0.01, 1.0, 17)
    clear = np.zeros((len(shares), len(names)), dtype=bool)
    for row, share in enumerate(shares):
        each = setup.per_sample(schedule.frequency_hz, share * planned)
        M = setup.prior[0] + np.einsum("i,iab->ab", schedule.samples, each[0])
        with np.errstate(all="ignore"):
            clear[row] = 3 * np.sqrt(np.diagonal(scaled_inverse(M))) < 1  # three standard deviations
    sentences = []
    unit = "/".join(dict.fromkeys(drive_units(model).values()))
    size = float(np.max(np.abs(planned)))
    for j in np.flatnonzero(np.any(model.T[model.nonlinear], axis=0)):
        rows = np.flatnonzero(clear[:, j])
        if not len(rows):
            sentences.append(
                f"{names[j]} is not visible at this drive level: increase the drive, or measure longer"
            )
        elif rows[0]:
            share = float(shares[rows[0]])
            sentences.append(
                f"{names[j]} becomes visible (three standard deviations) from about {100 * share:.2g} % of the "
                f"drive on, {share * size:.2g} {unit} at most"
            )
    return sentences


# Another test to compare with a plan: what it would give, and how many times the samples it takes.


def spread_of_iv(setup: TestSetup, schedule: Schedule) -> ExpectedPrecision | None:
    """What the paper's bootstrap instrumental variables would give from the same test (the sandwich of THEORY §5).

    In addition to earlier data, where there are some.  None where they cannot be used: some coordinate is not seen, a
    calibration is unknown, or an element is nonlinear.
    """
    if calibration_names(setup.channels) or len(setup.model.nonlinear):
        return None
    seen = setup.seen(schedule.frequency_hz, schedule.pattern)
    variance = 4 * noise_sd(setup.channels, seen.Y) ** 2 / schedule.samples[:, None]
    count = len(schedule.frequency_hz)
    spectrum = Spectrum(
        setup.channels,
        schedule.frequency_hz,
        seen.Y,
        (variance[..., None] * np.eye(len(setup.channels))).astype(np.complex128),
        np.maximum(schedule.samples, 1).astype(np.int64),
        np.full(count, np.inf),
        ("given",) * count,
        np.zeros(count, dtype=np.int64),
    )
    try:
        estimate = identify(setup.model, spectrum, InstrumentalVariables())
    except DashpotError:
        return None
    size, C = setup.sizes[0], estimate.noise_covariance
    if setup.earlier is None:
        size = np.abs(np.where(estimate.values == 0, 1.0, estimate.values))
    else:
        outer = np.outer(size, size)
        C = np.linalg.inv(np.linalg.inv(C / outer) + setup.prior[0]) * outer
    rms = float(np.sqrt(np.mean(np.diagonal(C) / size**2)))
    return ExpectedPrecision(estimate.names, estimate.units, estimate.values, np.sqrt(np.diagonal(C)), C, rms)


@dataclass(frozen=True)
class Alternative:
    """Another test, compared with the plan.

    predicted   what it would give with the optimal estimator, from as many samples as it has
    iv          the same with the paper's bootstrap; None if that cannot be used
    factor      how many times the plan's samples it takes to be as good as the plan; inf where it never is
    factor_iv   the same with the paper's bootstrap; None after data
    """

    schedule: Schedule
    predicted: ExpectedPrecision
    iv: ExpectedPrecision | None
    factor: float
    factor_iv: float | None


def compare_tests(setup: TestSetup, criterion: Criterion, plan: Plan, other: Schedule) -> Alternative:
    """Another test against a plan.

    Raises IdentifiabilityError if it does not determine the unknowns, whatever the number of its samples.
    """
    M = other.information(setup)
    predicted = expected_precision(setup, criterion, M)
    aim = criterion.at(setup, plan.schedule.information(setup)).F
    times = least_factor(lambda factor: aim >= criterion.at(setup, factor * M).F)
    ratio = float(np.sum(other.samples)) / max(float(np.sum(plan.schedule.samples)), 1.0)
    iv, factor_iv = spread_of_iv(setup, other), None
    if iv is not None and setup.earlier is None:
        names = [u.name for u in setup.model.unknowns]
        factor_iv = ratio * (iv.rms(names) / plan.predicted.rms(names)) ** 2
    return Alternative(other, predicted, iv, ratio * times, factor_iv)


# Which sensors to mount: the best few of those that could be.


EXACT = 300  # sets that are all tried

Sensors = tuple[str, ...]  # names of channels


@dataclass(frozen=True)
class Choice:
    """Sets of sensors in order of merit: names and the criterion's figure at the best test with them.

    `complete` says whether all sets were tried; else a greedy choice was improved by exchanges.
    """

    ranking: tuple[tuple[Sensors, float], ...]
    complete: bool

    @property
    def best(self) -> Sensors:
        """Names of the best set."""
        return self.ranking[0][0]


def choose(
    setup: TestSetup,
    criterion: Criterion,
    samples: float,
    grid: FrequencyGrid,
    count: int,
    among: Sequence[str] = (),
) -> Choice:
    """The best `count` of the channels `among` (by default all that see more than inputs); the others stay.

    Raises UsageError for names that are no channels, IdentifiabilityError if no set determines the unknowns.
    """
    names = [channel.name for channel in setup.channels]
    pool = list(among) or output_names(setup)
    for name in pool:
        if name not in names:
            raise UsageError(f"the rig has no channel {name}", cure=f"it has {', '.join(names)}")
    if not 0 < count <= len(pool):
        raise UsageError(f"{count} of {len(pool)} sensors", cure=f"pick between 1 and {len(pool)}")
    if setup.earlier is not None and len(setup.names) > len(setup.model.unknowns):
        raise UsageError(
            "sensors with unknown calibrations cannot be chosen after data", cure="calibrate them"
        )
    step = max(1, len(grid.frequency_hz) // 60)  # points of the grid on which sets are ranked
    coarse = FrequencyGrid(grid.frequency_hz[::step], grid.pattern[::step], free=False)
    figures: dict[Sensors, float] = {}

    def figure(chosen: Sensors, grid: FrequencyGrid) -> float:
        kept = [c for c in setup.channels if c.name not in pool or c.name in chosen]
        try:
            mounted = replace(setup, channels=tuple(kept))
            return criterion.figure(optimise(mounted, criterion.terms(mounted), samples, grid).F)
        except (IdentifiabilityError, UsageError):
            return np.inf

    def score(chosen: frozenset[str]) -> float:
        ordered = tuple(name for name in pool if name in chosen)
        if ordered not in figures:
            figures[ordered] = figure(ordered, coarse)
        return figures[ordered]

    complete = comb(len(pool), count) <= EXACT
    if complete:
        for chosen in combinations(pool, count):
            score(frozenset(chosen))
    else:
        _exchange(frozenset(pool), count, score)
    sets = sorted((chosen for chosen in figures if len(chosen) == count), key=figures.__getitem__)
    figures |= {chosen: figure(chosen, grid) for chosen in sets[:3]}
    ranking = sorted(((c, figures[c]) for c in sets if np.isfinite(figures[c])), key=lambda entry: entry[1])
    if not ranking:
        raise IdentifiabilityError(
            f"no {count} of these sensors determine the unknowns", cure="add sensors, or state a parameter"
        )
    return Choice(tuple(ranking), complete)


def output_names(setup: TestSetup) -> list[str]:
    """Names of the channels that see more than inputs."""
    return [c.name for c in setup.channels if not measures_input(setup.model, c)]


def _exchange(pool: frozenset[str], count: int, score: Callable[[frozenset[str]], float]) -> None:
    """Leave out the least useful sensor until `count` are left, then exchange one by one while that helps."""
    chosen = pool
    while len(chosen) > count:
        chosen = min((chosen - {name} for name in sorted(chosen)), key=score)
    lowest = score(chosen)
    for _ in range(10):
        swaps = [(chosen - {a}) | {b} for a in sorted(chosen) for b in sorted(pool - chosen)]
        best = min(swaps, key=score)
        if score(best) >= lowest * (1 - 1e-9):
            return
        chosen, lowest = best, score(best)


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
    amplitude    of the drive at most; None: what the limits allow, without any the median of the data's, else what
                 shakers usually can
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
    pick: tuple[int, Sensors] | None = None
    against: tuple[float, ...] | Spectrum | None = None


@dataclass(frozen=True)
class Answer:
    """What is advised; `plan` is None where the target is reached already.

    The setup holds the scenarios and what was known before the test.  `worst` is the figure in the worst of uncertain
    scenarios; `unsettled` is what the same test tells from all samples, None where that cannot be said.
    """

    setup: TestSetup
    criterion: Criterion
    grid: FrequencyGrid
    plan: Plan | None
    comparison: Alternative | None
    choice: Choice | None
    worst: float | None
    estimate: Estimate | None
    so_far: SequentialEstimates | None
    verdict: Verdict | None
    notes: tuple[str, ...]
    unsettled: UnsettledTest | None = None


def answer(question: Question, *, mapper: Map = map) -> Answer:
    """The next test; `mapper` shares out the search for the worst case of uncertain values.

    Raises UsageError if the question lacks something, IdentifiabilityError if no test determines the unknowns.
    """
    notes: list[str] = []
    criterion = question.criterion
    setup, estimate = _start(question, notes)
    rates = [c.rate for c in setup.channels if c.rate is not None]
    rate = min(rates, default=None) if question.rate is None else question.rate
    low, high = natural_band(setup, rate) if question.band is None else question.band
    if question.band is None:
        notes.append(f"no band is given: {low:.4g} to {high:.4g} Hz, around the rig's resonances, is used")
    choice = None
    if question.pick is not None:
        count, among = question.pick
        samples = 1000.0 if question.samples is None else question.samples
        if question.time is not None and rate is not None:
            samples = question.time * rate
        grid = band_grid(setup, low, high, question.step)
        choice = choose(setup, criterion, samples, grid, count, among)
        dropped = set(among or output_names(setup)) - set(choice.best)
        setup = replace(setup, channels=tuple(c for c in setup.channels if c.name not in dropped))
    uncertainty = _uncertainty(question, setup, estimate)
    budget = _budget(question, setup, rate, uncertainty)
    if rate is not None and question.band is None:
        high = min(high, NYQUIST * rate)

    def grid_of(setup: TestSetup) -> FrequencyGrid:
        return band_grid(setup, low, high, question.step)

    target = question.target if question.samples is None and question.time is None else None
    setup = replace(setup, over=question.robustness)
    best = best_test(setup, criterion, budget, uncertainty, grid_of, target=target, mapper=mapper)
    advised, setup = best.plan, best.setup
    comparison = unsettled = None
    if advised is not None and question.against is not None:
        try:
            # The test to compare with, of as many samples as the plan
            if isinstance(question.against, Spectrum):
                other = even_schedule(
                    question.against.frequency_hz.tolist(), advised.samples, question.against.samples.tolist()
                )
            else:
                other = even_schedule(question.against, advised.samples)
            comparison = compare_tests(setup, criterion, advised, other)
        except IdentifiabilityError:
            notes.append("the other test does not determine the unknowns, with any number of samples")
    so_far, verdict = _stopping(question, estimate)
    if advised is not None:
        notes += advised.notes
        unsettled = unsettled_test(setup, criterion, advised, rate)
        if len(setup.model.nonlinear):
            notes += drives_that_show(setup, advised.schedule)
    return Answer(
        setup,
        criterion,
        grid_of(setup),
        advised,
        comparison,
        choice,
        best.worst,
        estimate,
        so_far,
        verdict,
        tuple(dict.fromkeys(notes)),
        unsettled,
    )


def _start(question: Question, notes: list[str]) -> tuple[TestSetup, Estimate | None]:
    """The setup at the values to design for, with what earlier data say, and their estimate."""
    model, estimate, channels = question.model, question.estimate, question.channels
    if question.after is not None:
        estimate = identify(model, question.after)
        channels = noise_from(channels, question.after)
    if not any(c.noise > 0 or c.relative_noise > 0 for c in channels):
        notes.append(
            "no channel states its noise: 1 % of each output's amplitude is assumed; intervals scale with it, "
            "the frequencies do not depend on it"
        )
        channels = with_relative_noise(model, channels, 0.01)
    # Values of the unknowns by name: as stated, else as estimated
    values = {} if estimate is None else values_after(question.model, estimate)
    values |= question.values
    missing = [
        u.name
        for u in question.model.unknowns
        if u.name not in values and u.prior is None and u.guess is None
    ]
    if missing:
        raise UsageError(
            f"{', '.join(missing)}: no value to design the test for",
            cure=f"state a rough value of {missing[0]}, write guess = … in the rig file, or give an estimate",
        )
    limits, amplitude = _size_of_drive(question, channels, notes)
    setup = nominal_setup(model, channels, values, limits=limits, amplitude=amplitude, drives=question.drives)
    if estimate is None:
        return setup, None
    if bool(np.any(estimate.fit.rejected)):
        notes.append(
            "the model does not fit the earlier data: expected intervals cover sensor noise only; the misfit "
            "will make the true ones wider"
        )
    return after(setup, estimate), estimate


def _size_of_drive(
    question: Question, channels: tuple[Channel, ...], notes: list[str]
) -> tuple[ShakerLimits, float]:
    """Limits of the drive, and its amplitude where there are none: as stated, as in the data, or usual limits."""
    of_drive = "stroke" if question.model.displacement_inputs else "force"
    limits, amplitude = question.limits, question.amplitude
    if amplitude is not None:
        least: dict[str, Any] = {of_drive: min(amplitude, limits.given.get(of_drive, amplitude))}
        return (replace(limits, **least) if limits.given else limits), amplitude
    if limits.given or not question.model.inputs:
        return limits, 1.0
    floors = [c.name for c in channels if c.noise > 0]
    matters = "so the drive level matters: " if floors else ""
    noisy = f"the noise of {', '.join(floors[:4])} has a floor, " if floors else ""
    measured = None if question.after is None else amplitude_from(question.model, question.after)
    if measured is not None:
        unit = "/".join(dict.fromkeys(drive_units(question.model).values()))
        if floors or len(question.model.nonlinear):
            notes.append(
                f"{noisy}{matters}{measured:.3g} {unit} is the median of the data's; state the shaker's limits"
            )
        return limits, measured
    if len(question.model.nonlinear):
        raise UsageError(
            "the response of a rig with nonlinear elements depends on the drive level",
            cure="state the drive amplitude or the shaker's limits",
        )
    usual = usual_limits(question.model)
    notes.append(
        f"{noisy}{matters}{usual.text(question.model)} at most are assumed; state [shaker] in the rig file"
    )
    return usual, 1.0


def _uncertainty(question: Question, setup: TestSetup, estimate: Estimate | None) -> Uncertainty | None:
    given = question.uncertainty
    if given == "estimate":
        if estimate is None:
            raise UsageError(
                "there is no estimate to take the uncertainty from", cure="state it, for example 30 %"
            )
        return gaussian_prior_of(setup.model, estimate)
    if isinstance(given, float | int):
        return uniform_box_of(setup.model, setup.theta[0], given)
    return given


def _budget(
    question: Question, setup: TestSetup, rate: float | None, uncertainty: Uncertainty | None
) -> Budget:
    samples, time, settle = question.samples, question.time, question.settle
    if samples is None and time is None:
        if question.target is None:
            raise UsageError(
                "there is neither a budget nor a target",
                cure="state a number of samples, a time, or the precision to reach",
            )
        # Samples or s from which the search for the shortest test starts
        samples, time = (1000.0, None) if rate is None else (None, 60.0)
    if settle is None and samples is not None and rate is None:
        settle = 0.0
    if settle is None:
        try:
            settle = setup.settling() if uncertainty is None else slowest_settling(setup, uncertainty)
        except UsageError:
            if samples is None:
                raise
            settle = 0.0  # of a test that is counted in samples it is told alone
    return Budget(samples, time, rate, settle, question.min_dwell, question.most)


def _stopping(
    question: Question, estimate: Estimate | None
) -> tuple[SequentialEstimates | None, Verdict | None]:
    if question.after is None or estimate is None:
        return None, None
    so_far = sequential_estimates(question.model, question.after, whole=estimate)
    if question.target is None:
        return so_far, None
    targets = question.criterion.targets_for(question.model, question.target)
    kind = "minimax" if len(targets) == 1 else question.criterion.kind
    known = np.diag(np.nan_to_num(estimate.priors[1] ** -2.0))
    return so_far, enough(estimate, targets, int(np.sum(question.after.samples)), known, kind)


def answer_to_json(answer: Answer) -> str:
    """An answer as JSON: the plan's contract, together with what was asked; amplitudes in SI units.

    Phases in degrees stand there where inputs move out of step.  Where the target is reached already, a plan of no
    dwell.
    """
    plan = answer.plan
    p = expected_precision(answer.setup, answer.criterion, 0.0) if plan is None else plan.predicted
    content: dict[str, Any] = {
        "dwells": [] if plan is None else [_dwell(dwell) for dwell in plan.dwells],
        "predicted": {
            name: {
                "value": value,
                "sd": sd,
                "relative_sd": relative,
                "interval95": [value - 1.96 * sd, value + 1.96 * sd],
                "unit": unit,
            }
            for name, unit, value, sd, relative in zip(
                p.names, p.units, p.values.tolist(), p.sd.tolist(), p.relative.tolist(), strict=True
            )
        },
        "criterion": answer.criterion.name,
        "figure": p.figure,
        "ideal": p.figure if plan is None else plan.ideal,
        "gap": 0.0 if plan is None else plan.gap,
        "loss": 0.0 if plan is None else plan.loss,
        "samples": 0 if plan is None else plan.samples,
        "time_s": 0 if plan is None else plan.time_s,
        "notes": list(answer.notes),
    }
    if answer.comparison is not None:
        other = answer.comparison
        content["against"] = {
            "frequencies_hz": other.schedule.frequency_hz.tolist(),
            "predicted": _spreads(other.predicted),
            "figure": other.predicted.figure,
            "iv": None if other.iv is None else _spreads(other.iv),
            "sample_factor": other.factor,
            "sample_factor_iv": other.factor_iv,
        }
    if answer.unsettled is not None:
        whole = answer.unsettled
        content["used_whole"] = {
            "predicted": _spreads(whole.predicted),
            "figure": whole.predicted.figure,
            "samples": whole.samples,
            "thrown_away": whole.thrown_away,
            "one_record": whole.joined,
        }
    if answer.choice is not None:
        ranking = answer.choice.ranking[:20]
        content["sensors"] = {
            "best": list(answer.choice.best),
            "complete": answer.choice.complete,
            "ranking": [{"sensors": list(names), "figure": figure} for names, figure in ranking],
        }
    if answer.worst is not None:
        content["worst_case"] = answer.worst
    if answer.so_far is not None:
        s = answer.so_far
        content["so_far"] = {
            "samples": s.samples.tolist(),
            "relative_sd": dict(zip(s.names, s.relative.T.tolist(), strict=True)),
        }
    if answer.verdict is not None:
        v = answer.verdict
        content["enough"] = {
            "reached": v.reached,
            "worst": v.worst,
            "over_target": v.excess,
            "more_samples": v.more,
            "reason": v.reason,
        }
    return to_json(content)


def _spreads(p: ExpectedPrecision) -> dict[str, Any]:
    return {name: {"sd": sd} for name, sd in zip(p.names, p.sd.tolist(), strict=True)}


def _dwell(dwell: Dwell) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "frequency_hz": dwell.frequency_hz,
        "samples": dwell.samples,
        "amplitudes": {name: _size(z) for name, z in dwell.amplitudes.items()},
        "time_s": dwell.time_s,
        "settle_s": dwell.settle_s,
        "periods": dwell.periods,
    }
    phases = {name: phase_deg(z) for name, z in dwell.amplitudes.items()}
    return entry | ({"phases_deg": phases} if any(phases.values()) else {})


def _size(z: complex) -> float:
    """Signed where the drive is in or against phase, else its size."""
    return z.real if abs(z.imag) <= 1e-12 * abs(z) else abs(z)


def phase_deg(z: complex) -> float:
    """Phase of an amplitude in degrees, 0 where it is in or against phase."""
    return 0.0 if abs(z.imag) <= 1e-12 * abs(z) else float(np.rad2deg(np.angle(z)))


def plan_to_csv(plan: Plan, units: Mapping[str, str]) -> str:
    """A table for the shaker's controller: one dwell a row, in the order in which to run them.

    `units` of the inputs by name stand in the header: u_amplitude_m.
    """
    turned = any(phase_deg(z) for dwell in plan.dwells for z in dwell.amplitudes.values())
    head = ["dwell", "frequency_hz"]
    for name in plan.dwells[0].amplitudes:
        head += [
            f"{name}_amplitude_{units[name].replace('·', '')}",
            *([f"{name}_phase_deg"] if turned else []),
        ]
    rows = [",".join([*head, "settle_s", "periods", "time_s", "samples"])]
    for i, dwell in enumerate(plan.dwells):
        cells = [str(i + 1), f"{dwell.frequency_hz:.9g}"]
        for z in dwell.amplitudes.values():
            cells += [f"{_size(z):.9g}", *([f"{phase_deg(z):.6g}"] if turned else [])]
        timed = ["" if number is None else f"{number:.9g}" for number in (dwell.periods, dwell.time_s)]
        rows.append(",".join([*cells, f"{dwell.settle_s:.6g}", *timed, str(dwell.samples)]))
    return "\n".join(rows) + "\n"
