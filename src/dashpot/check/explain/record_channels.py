"""Plain channel mistakes in whole records of nonlinear rigs, found before any fit.

A wrong sign or unit, or two channels exchanged, keeps a search by integration busy for minutes, to no end.
Where the channels of displacement show all coordinates, the equation of motion in its weak form tells the mistake at
once: with the parts of the rig, and any smooth law at the places of its nonlinear elements, or their own hysteresis,
its terms cancel or they do not.  Elsewhere the motion that follows from the guesses is compared with the measured one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import log

import numpy as np

from dashpot.arrays import Bools, Ints, Real
from dashpot.check.explain.channels import conjugate, derivative, in_data, sign, swap, unit
from dashpot.check.explain.effect import Baseline, Effect, Effects, with_likely_causes
from dashpot.check.explain.problem import FitProblem, FittedProblem, LineProblem, TimeProblem
from dashpot.data.record import Record
from dashpot.errors import DashpotError, DataError, Problem
from dashpot.estimate.assessment import Finding
from dashpot.estimate.identify import identify
from dashpot.estimate.nonlinear.record_problem import begun_problem
from dashpot.estimate.nonlinear.record_regression import WeakForm, weak_form
from dashpot.estimate.nonlinear.records import RecordData, RecordedMotion, arranged, recorded_motion
from dashpot.estimate.nonlinear.search import harmonics_left
from dashpot.estimate.preparation import Prepared, states_if_seen
from dashpot.model.network import Model
from dashpot.model.observation import measures_input

# Plain mistakes of channels in settled dwells of nonlinear rigs, by the equation of motion where all motion
# is seen.
#
# A rig with laws of its own takes seconds to fit, and a wrong one minutes: each mistake is tried on the
# regression of the measured harmonics (Yasuda and Watanabe's, THEORY §9), which takes milliseconds, and the
# best are fitted in full.


PROMISED = 0.3  # of what the equation leaves as it is: as much as it may leave with a mistake put right
MENDED = 0.1  # of the misfit: as much as a mistake may leave
FOLLOWED = 3  # mistakes that are fitted in full


def mistakes_by_equation(data: Prepared, misfit: float) -> tuple[Finding, ...]:
    """What channels may measure instead of what is stated, the best first; for one repeat with all motion measured.

    misfit: χ² over its degrees of freedom as it is; ∞ where there is no fit.
    """
    base = LineProblem(data, np.ones(len(data.spectrum.channels)), (np.zeros(len(data.view.names)),))
    tried = list(_supposed(base, (sign, conjugate, unit, derivative, swap)))
    left = np.array([_left(problem) for _, _, problem in tried])
    mending = np.flatnonzero(left < PROMISED * _left(base))
    found = []
    for k in mending[np.argsort(left[mending], kind="stable")][:FOLLOWED].tolist():
        effect, size, problem = tried[k]
        try:
            assert isinstance(problem, LineProblem)
            spectrum = problem.data.spectrum
            alone = replace(spectrum, amplitudes=spectrum.amplitudes[0], covariance=problem.V)
            fitted = identify(data.model, alone, "ml")
        except DashpotError:
            continue
        remaining = float(fitted.fit.misfit) ** 2
        if remaining < MENDED * misfit:
            found.append(effect.finding(size, remaining))
    return tuple(sorted(found, key=lambda each: each.remaining or 0.0))


def _supposed(problem: FitProblem, kinds: Sequence[Effects]) -> Iterator[tuple[Effect, float, FitProblem]]:
    """Effects that need no fit, at each of their sizes, and the problem with each."""
    baseline = Baseline(problem, FittedProblem(problem, np.zeros(0), np.inf, 0), ())
    for kind in kinds:
        for effect in kind(baseline):
            for size in effect.values:
                yield effect, size, effect.act(problem, size)


def _left(problem: FitProblem) -> float:
    """Share of the known forces that the equation of motion leaves; ∞ where there is no regression."""
    assert isinstance(problem, LineProblem)
    data = problem.data
    try:
        states = states_if_seen(data.view, data.spectrum, data.covariance)
        return np.inf if states is None else harmonics_left(replace(data, states=states))
    except DashpotError:
        return np.inf


MOST, MOST_INTEGRATED = 4000, 1000  # samples that are looked at
CONTRADICTED = 0.05  # share of a channel's or an equation's power above which something is wrong
MENDED_RECORD_CHANNELS = 0.05  # share of what contradicts that a mistake put right may leave
# Share of a channel's power by which a motion from guesses may differ, for they are off themselves
CLOSE = 0.3
GROSS = 5.0  # factor of a unit beyond which guesses tell it from their own error
ALIKE = 3.0  # times what the best leaves: others are named, too
IN_ITS_LINE = "correct the channel named below, in the rig file or in the data"
IN_ITS_DATA = "correct the channel named below, in the data of this record"
KINDS = ("sign", "unit", "swap")
SHARES = (0.1, 0.3)  # of the largest speed or elongation, at which the smooth laws bend


def require_sound_channels(model: Model, records: Sequence[Record]) -> None:
    """Raises DataError where the channels of a record contradict the rig and one plain mistake explains it.

    What is wrong in all records alike is mended in the rig file; what is wrong in some of them, in their data.
    """
    found = [(record, channel_mistakes(model, record)) for record in records]
    wrong = [(record, findings) for record, findings in found if findings]
    if not wrong:
        return
    what = "the channels are inconsistent with this rig for any parameter values"
    mistakes = {(findings[0].kind, findings[0].of, findings[0].number) for _, findings in wrong}
    if len(wrong) == len(records) and len(mistakes) == 1:
        record, findings = wrong[0]
        raise with_likely_causes(DataError(what, record.source, IN_ITS_LINE), findings)
    problems = []
    for record, findings in wrong:
        problems.append(Problem(what, record.source, IN_ITS_DATA))
        for each in findings:
            cure = f"{in_data(each, record.source)}, or leave it out"
            problems.append(Problem(f"a likely cause: in this record, {each.text}", cure=cure))
    raise DataError(problems)


def channel_mistakes(model: Model, record: Record) -> tuple[Finding, ...]:
    """Mistakes of one channel, or two exchanged ones, which alone make a record contradict the rig; the best first.

    () where nothing is contradicted, or no one mistake explains it.
    """
    bench = _Bench(model, {})
    as_is = bench.contradiction(record)
    # Laws that take a hundred times as long to try come last: what they resolve is no mistake.
    if as_is is None or not as_is.there or not (bench.contradiction(record, own=True) or as_is).there:
        return ()
    recorded = TimeProblem(model, record, np.zeros(len(record.channels)), ())
    inputs = {channel.name for channel in record.channels if measures_input(model, channel)}
    outputs = len(record.channels) - len(inputs)
    tried = []
    for effect, size, mended in _supposed(recorded, (sign, unit, swap)):
        of_inputs = len(inputs.intersection(effect.of))
        if of_inputs == 1 < len(effect.of):
            continue
        # The size of one motion, or of the input, guesses do not tell.
        untold = of_inputs or outputs < 2 or abs(log(abs(size))) < log(GROSS)
        if as_is.guessed and effect.kind == "unit" and untold:
            continue
        assert isinstance(mended, TimeProblem)
        left = bench.contradiction(mended.record)
        if left is not None and left.much_less_than(as_is):
            tried.append((bool(of_inputs), KINDS.index(effect.kind), left.total, effect, size))
    least = min((each[2] for each in tried), default=0.0)
    near = [each for each in tried if each[2] <= ALIKE * least]
    # Of two motions either may be turned, and outputs are more than inputs; of like mistakes the commoner first.
    near.sort(key=lambda each: each[:3])
    return tuple(effect.finding(size) for *_, effect, size in near)


@dataclass(frozen=True)
class _Contradiction:
    """Shares of power, of equations and channels, that contradict the rest; guessed: by the motion of the guesses."""

    shares: Real
    guessed: bool = False

    @property
    def there(self) -> bool:
        """Whether something is wrong."""
        return bool(np.max(self.shares, initial=0.0) > CONTRADICTED)

    @property
    def total(self) -> float:
        """All of them together."""
        return float(np.sum(self.shares))

    def much_less_than(self, before: _Contradiction) -> bool:
        """Whether almost nothing of it is left."""
        if self.guessed:
            return bool(np.max(self.shares) < CLOSE) and self.total < before.total / 2
        return self.total < MENDED_RECORD_CHANNELS * before.total


@dataclass(frozen=True)
class _Bench:
    """Where records are tried; shown: channels by the guesses, for the inputs that were integrated already."""

    model: Model
    shown: dict[bytes, Real | None]

    def contradiction(self, record: Record, *, own: bool = False) -> _Contradiction | None:
        """What of a record contradicts the rig; None where that cannot be told.  own: laws with states are tried too.

        Without, hysteresis may seem to contradict: it is no function of the motion at the same instant.
        """
        model = self.model
        try:
            data = arranged(model, record.part(slice(0, MOST)))
            at = recorded_motion(model, data)
            if at is None:
                return self._beside_guesses(arranged(model, record.part(slice(0, MOST_INTEGRATED))))
            form = weak_form(model, data, at)
            with np.errstate(all="ignore"):
                return _Contradiction(
                    np.concatenate([_of_equations(form, own), _of_channels(form, data, at)])
                )
        except (DashpotError, np.linalg.LinAlgError):
            return None

    def _beside_guesses(self, data: RecordData) -> _Contradiction | None:
        """Shares of the channels' power by which the motion of the guesses differs; None where a guess is missing."""
        key = data.inputs.tobytes()
        if key not in self.shown:
            self.shown[key] = _by_guesses(self.model, data)
        shown = self.shown[key]
        if shown is None:
            return None
        y = data.outputs - np.where(data.drift, np.mean(data.outputs, axis=0), 0.0)
        known = [c for c, gain in enumerate(data.gain) if gain < 0]
        return _Contradiction(np.array([_apart(y[:, c], shown[:, c]) for c in known]), True)


def _by_guesses(model: Model, data: RecordData) -> Real | None:
    """What the channels would show by the guesses, from rest; None where one is missing or no motion follows."""
    given = [u.prior if u.prior is not None else u.guess for u in model.unknowns]
    theta = np.array([value for value in given if value is not None], dtype=float)
    if len(theta) < len(given):
        return None
    problem, own = begun_problem(model, (data,), theta, np.ones(len(data.names)))
    gains = [1.0 if gain.nominal is None else gain.nominal for gain in data.gains]
    psi = np.concatenate([theta, gains, np.zeros(len(problem.constants.offsets)), own])
    residual = problem.residual(0, psi, slopes=False)[0]
    zero = np.where(data.drift, np.mean(data.outputs, axis=0), 0.0)
    return data.outputs - zero - residual if np.all(np.isfinite(residual)) else None


def _of_channels(form: WeakForm, data: RecordData, at: RecordedMotion) -> Real:
    """Shares of the channels' power that the motion of the channels of displacement does not show, (channels,)."""
    n, shares = form.model.n, []
    for c, power in enumerate(data.derivative):
        if data.gain[c] >= 0 or np.any(data.force[c]):
            continue
        shown = at.x @ data.on_x[c, :n] + at.u @ data.on_q[c, : at.u.shape[1]]
        measured = data.outputs[:, c] - (np.mean(data.outputs[:, c]) if data.drift[c] else 0.0)
        shown = shown - (np.mean(shown) if data.drift[c] else 0.0)
        shares.append(_apart(form.of(measured[:, None], 0), form.of(shown[:, None], power)))
    return np.array(shares)


def _apart(y: Real, p: Real) -> float:
    """Power of a difference over that of both."""
    return float(np.sum((y - p) ** 2) / max(np.sum(y**2) + np.sum(p**2), np.finfo(float).tiny))


@dataclass(frozen=True)
class _Terms:
    """Weak terms of the equation of motion, one a column: those of linear elements, and any law where one is nonlinear.

    columns (rows, k); along (k, equations): what a term pulls at; by (k, m): with which unknown it grows; known (k,):
    what is stated of it.  place (k,): terms of one place make one force; passive (k,): terms that a part below zero
    would have.
    """

    columns: Real
    along: Real
    by: Real
    known: Real
    place: Ints
    passive: Bools

    def slopes(self) -> Real:
        """What unknowns do to the equations, (equations, rows, m)."""
        return np.stack([(self.columns * pull) @ self.by for pull in self.along.T])

    def forces(self, theta: Real) -> Real:
        """All terms at θ (m,), (rows, k)."""
        return self.columns * (self.by @ theta + self.known)


def _terms(form: WeakForm, own: bool) -> _Terms:
    """Those of a rig in the measured motion.  Inertia is a place of its own, and so is what stands still.

    own: whether laws with states are among them, as the rig has them.
    """
    model, points = form.model, [frozenset(e.along.items()) for e in form.model.elements]
    bent = {points[int(index)] for index in model.nonlinear}
    linear = [i for i, element in enumerate(model.elements) if element.force_law is None]
    columns, along, places, passive = [], [], list[object](), list[bool]()
    for i in linear:
        power = model.elements[i].law.power
        columns.append(form.of(form.elongation[:, i : i + 1], power))
        along.append(form.balance[:, i])
        places.append((points[i], power == 2))
        passive.append(power == 2 or points[i] not in bent)
    for row, index in enumerate(model.nonlinear.tolist()):
        laws = _laws(form, row, own)
        columns.append(laws)
        along += [form.balance[:, index]] * laws.shape[1]
        places += [(points[index], False)] * laws.shape[1]
    columns += [form.of(np.ones((len(form.f), 1)), 0)] * len(form.still)  # zeros of sensors, weights
    along += list(np.eye(len(form.still)))
    places += [(i, "still") for i in range(len(form.still))]
    free = np.any(model.T[linear], axis=0)
    more = len(places) - len(linear)
    by = np.zeros((len(places), int(np.sum(free)) + more))
    by[: len(linear), : by.shape[1] - more] = model.T[linear][:, free]
    by[len(linear) :, by.shape[1] - more :] = np.eye(more)
    order = list(dict.fromkeys(places))
    return _Terms(
        np.concatenate(columns, axis=1), np.array(along), by, np.append(model.p0[linear], np.zeros(more)),
        np.array([order.index(place) for place in places]), np.array(passive + [False] * more),
    )  # fmt: skip


def _of_equations(form: WeakForm, own: bool) -> Real:
    """Share of each equation's power that its terms leave, and of all what negative parts have, (equations + 1,)."""
    terms = _terms(form, own)
    n, tiny = len(form.still), np.finfo(float).tiny
    push = np.stack([form.of(form.f[:, i : i + 1], 0)[:, 0] for i in range(n)])
    A = terms.slopes()
    b = push - np.stack([(terms.columns * pull) @ terms.known for pull in terms.along.T])
    first = [int(np.flatnonzero(terms.place == place)[0]) for place in range(int(np.max(terms.place)) + 1)]
    weight = np.ones(n)
    for _ in range(4):  # rounds of the weights of the equations
        whole = (A * weight[:, None, None]).reshape(-1, A.shape[2])
        size = np.maximum(np.linalg.norm(whole, axis=0), tiny)
        theta = np.linalg.lstsq(whole / size, (b * weight[:, None]).ravel(), rcond=1e-9)[0] / size
        forces = terms.forces(theta)
        joined = np.stack([np.sum(forces[:, terms.place == k], axis=1) for k in range(len(first))], axis=1)
        power = np.maximum(
            np.sum(joined**2, axis=0) @ terms.along[first] ** 2 + np.sum(push**2, axis=1), tiny
        )
        weight = 1 / np.sqrt(power)
    left = np.sum((b - A @ theta) ** 2, axis=1) / power
    negative = terms.passive & (terms.by @ theta + terms.known < 0)
    against = np.sum(forces[:, negative] ** 2, axis=0) @ terms.along[negative] ** 2
    return np.append(left, np.sum(against / power))


def _laws(form: WeakForm, row: int, own: bool) -> Real:
    """Weak terms of laws that bend as most do, at the place of a nonlinear element, (rows, laws).

    own: also of its own law, if that has a state, at all constants that a search tries.
    """
    model, index = form.model, int(form.model.nonlinear[row])
    d, v = form.elongation[:, index], form.rate[:, index]
    far, fast = (max(float(np.max(np.abs(motion))), np.finfo(float).tiny) for motion in (d, v))
    laws = [d, v, d**2, d * np.abs(d), d**3, d**5, v * np.abs(v), v**3]
    for share in SHARES:
        laws += [np.tanh(v / (share * fast)), np.maximum(d - share * far, 0), np.minimum(d + share * far, 0)]
    if own and model.laws[row].has_state:
        grid = np.array(form.constants_to_try())[:, model.constant_slices[row]]
        tried = [form.unit_force(row, constants) for constants in np.unique(grid, axis=0)]
        laws += [unit for unit in tried if np.all(np.isfinite(unit))]
    return form.of(np.stack(laws, axis=1), 0)
