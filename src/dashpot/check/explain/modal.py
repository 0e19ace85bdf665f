"""What would make a rig have the modes that were measured: remedies on data and rig, tried, the best first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import log

import numpy as np
from scipy.special import logsumexp

from dashpot.arrays import Real
from dashpot.check.explain.channels import GAIN_WIDTH, RATIOS, rounded
from dashpot.check.explain.dwells import RATES
from dashpot.check.explain.effect import Phrase
from dashpot.check.explain.engine import LARGEST, LIKELY, LISTED, MOST, UNLISTED
from dashpot.check.explain.rigs import (
    FOLLOWED,
    missing_elements,
    missing_in_words,
    other_value,
    points_of,
    stated_values,
)
from dashpot.check.explain.score import score_tests
from dashpot.data.modal_data import ModalData
from dashpot.errors import DashpotError
from dashpot.estimate.assessment import Finding
from dashpot.estimate.modal import (
    ModeProblem,
    like_parts,
    mode_residuals,
    random_rigs,
    searched_from,
)
from dashpot.estimate.result import Estimate
from dashpot.model.elements import Element
from dashpot.model.network import Model

DAMPINGS = (2.0, 100.0)  # loss factors, per cent
NEAR = 0.25  # nepers within which a usual ratio of units is tried in the place of what was found
LOST = log(
    100
)  # for each number that a cause leaves out, which may be in error by its own size, some 100 deviations
# The probability of each kind before the data.
PRIORS = {
    "sign": 0.1, "swap": 0.08, "conjugate": 0.04, "unit": 0.05, "gain": 0.08, "frequency": 0.04, "damping": 0.1,
    "mode": 0.1, "channel": 0.05, "element": 0.15, "value": 0.15,
}  # fmt: skip
DRAWS = 4  # rigs drawn at random from which each trial starts as well, where the points do not show all


@dataclass(frozen=True)
class _Trial:
    """Modes as they would be with one mistake mended; spared: numbers in the data that count for nothing."""

    kind: str
    of: tuple[str, ...]
    data: ModalData
    number: float | None = None
    spared: int = 0


@dataclass(frozen=True)
class _Bench:
    """A rig, what was measured of it, and where trials start (K, unknowns)."""

    model: Model
    data: ModalData
    starts: Real

    def tried(self, trial: _Trial) -> tuple[_Cause, Real]:
        """What a trial leaves of χ², and the rig (unknowns,) that it leads to."""
        try:
            end = searched_from(self.model, trial.data, self.starts)
        except DashpotError:  # too little is left of the data
            return _Cause(trial, np.inf, 0), self.starts[0]
        chi2 = float(end.cost[0]) if np.isfinite(end.cost[0]) else np.inf
        return _Cause(trial, chi2, _dof(self.model, trial.data) - trial.spared), end.x[0]


@dataclass(frozen=True)
class _Cause:
    """A trial, χ² and the degrees of freedom that its fit leaves; the element that it adds or frees."""

    trial: _Trial
    chi2: float
    dof: int
    element: Element | None = None

    @property
    def reduced(self) -> float:
        """χ² over its degrees of freedom; infinite where there are none."""
        return self.chi2 / self.dof if self.dof > 0 else np.inf

    def evidence(self, dof: int, alike: int) -> float:
        """ln of the evidence, of a fit to all modes with `dof`; alike: causes of this kind that were tried."""
        prior = log(PRIORS[self.trial.kind] / alike) - LOST * max(
            dof - self.dof - (self.element is not None), 0
        )
        if not np.isfinite(self.reduced):
            return -np.inf
        more = 0.5 * log(max(dof, 2)) if self.element is not None or self.trial.kind == "gain" else 0.0
        if self.trial.kind == "gain" and self.trial.number is not None:  # large ones are rare: Cauchy's prior
            more += log(1 + (log(self.trial.number) / GAIN_WIDTH) ** 2)
        return prior - more - 0.5 * self.dof * (log(max(self.reduced, 1.0)) + min(self.reduced, 1.0))


def diagnose_modes(
    model: Model, data: ModalData, estimate: Estimate, *, seed: int = 0
) -> tuple[Finding, ...]:
    """Causes that would explain most of a misfit of measured modes (no batch axes), the best first.

    Tried are a point with its sign, its gain or its place in the shapes mended, phases that count the other way,
    frequencies or damping in another unit and, where none of these is it, a mode or a point left out, a stated value
    that is wrong, and missing parts.
    """
    if model.n > LARGEST or not np.all(np.isfinite(estimate.values)):
        return ()
    seen = set(data.points) == set(model.coordinates) and bool(np.all(np.isfinite(data.shapes)))
    drawn = random_rigs(model, data, 0 if seen else DRAWS, np.random.default_rng(seed))
    bench = _Bench(model, data, np.concatenate([estimate.values[None], like_parts(model, data)[None], drawn]))
    # Frequencies per second or minute for radians and the like; loss factors or per cent for damping ratios
    trials = [_Trial("frequency", (), _times(data, rate, 1.0), rate) for rate in RATES]
    if np.any(np.isfinite(data.damping_ratio)):
        trials += [_Trial("damping", (), _times(data, 1.0, 1 / number), number) for number in DAMPINGS]
    candidates = [
        bench.tried(trial)[0] for trial in (*_shapes_mended(data), *trials, *_without_one_mode(data))
    ]
    candidates += [cause for name in data.points for cause in _of_point(bench, name)]
    candidates += _other_rigs(bench, estimate.values)
    dof = _dof(model, data)
    as_is = float(estimate.fit.chi2)
    count = Counter(cause.trial.kind for cause in candidates)
    floor = log(UNLISTED) - 0.5 * dof * (log(max(as_is / max(dof, 1), 1.0)) + 1)
    weights = np.array([*(cause.evidence(dof, count[cause.trial.kind]) for cause in candidates), floor])
    odds = np.exp(weights - logsumexp(weights))[:-1]
    excess = max(as_is / max(dof, 1) - 1, np.finfo(float).tiny)
    found: list[Finding] = []
    total = 0.0
    for k in np.argsort(-odds, kind="stable").tolist():
        cause = candidates[k]
        explains = 1 - min(max(cause.reduced - 1, 0.0) / excess, 1.0)
        if explains < LIKELY or any(
            (each.kind, each.of) == (cause.trial.kind, cause.trial.of) for each in found
        ):
            continue
        said = _said(model, cause)
        found.append(
            Finding(
                cause.trial.kind, cause.trial.of, said.text, said.change, cause.reduced, cause.trial.number,
                elements=said.elements, odds=float(odds[k]), explains=explains,
            )
        )  # fmt: skip
        total += float(odds[k])
        if total > LISTED or len(found) == MOST:
            break
    return tuple(found)


def _dof(model: Model, data: ModalData) -> int:
    return ModeProblem.of(model, data).dof


def _said(model: Model, cause: _Cause) -> Phrase:
    """A cause in words."""
    kind, of = cause.trial.kind, cause.trial.of
    size = 1.0 if cause.trial.number is None else cause.trial.number
    if cause.element is not None:
        words = missing_in_words if kind == "element" else other_value
        return words(model, cause.element, size)
    match kind:
        case "sign":
            text = f"{of[0]} has the opposite sign in all mode shapes. Sensor reversed?"
            return Phrase(text, f"change the sign of {of[0]} in the shapes")
        case "swap":
            return Phrase(f"{of[0]} and {of[1]} are exchanged", f"exchange {of[0]} and {of[1]} in the shapes")
        case "unit" | "gain":
            text = f"{of[0]} is {rounded(size)} × what the model predicts in all mode shapes"
            return Phrase(text, f"divide {of[0]} by {rounded(size)} in the shapes")
        case "damping":
            word = "loss factors" if size == 2.0 else "per cent"
            return Phrase(
                f"the damping ratios are {size:g} × what the model gives: {word}?", f"divide them by {size:g}"
            )
        case "frequency":
            text = f"the modes are at {rounded(size)} × the stated frequencies. Are they in another unit?"
            return Phrase(text, f"multiply the frequencies by {size:.6g}")
        case "conjugate":
            text = "all phases have the opposite sign: the data use e^(−jωt)"
            return Phrase(text, "change the sign of the imaginary parts")
        case "mode":
            text = f"the mode at {of[0]} disagrees with all others"
            return Phrase(text, f"leave out the mode at {of[0]}, or measure it again")
        case _:
            text = f"{of[0]} disagrees with the other points, and no common error explains it"
            return Phrase(text, f"leave {of[0]} out, or check its sensor and where it is mounted")


# Mistakes in the data


def _shapes_mended(data: ModalData) -> list[_Trial]:
    """A point that counts the other way, two points exchanged, all phases the other way."""
    count, shapes = len(data.points), data.shapes
    if count < 2:
        return []
    trials = [_Trial("conjugate", (), replace(data, shapes=np.conj(shapes)))]
    trials += [_Trial("sign", (name,), _divided(data, name, -1.0)) for name in data.points]
    for p, q in combinations(range(count), 2):
        order = np.arange(count)
        order[[p, q]] = q, p
        covariance = data.shape_covariance[:, order][:, :, order]
        exchanged = replace(data, shapes=shapes[:, order], shape_covariance=covariance)
        trials.append(_Trial("swap", (data.points[p], data.points[q]), exchanged))
    return trials


def _divided(data: ModalData, name: str, number: float) -> ModalData:
    """The shapes with what one point shows divided by a number."""
    factor = np.where([point == name for point in data.points], 1 / number, 1.0)
    covariance = data.shape_covariance * np.outer(factor, factor)
    return replace(data, shapes=data.shapes * factor, shape_covariance=covariance)


def _times(data: ModalData, rate: float, damping: float) -> ModalData:
    """Frequencies and damping ratios times a factor each."""
    factor = np.array([rate, damping])
    return replace(
        data,
        frequency_hz=data.frequency_hz * rate,
        damping_ratio=data.damping_ratio * damping,
        covariance=data.covariance * np.outer(factor, factor),
    )


def _without_one_mode(data: ModalData) -> list[_Trial]:
    """Each mode left out, or its frequency or its damping alone."""
    trials = []
    for k, frequency in enumerate(data.frequency_hz):
        of, kept = (f"{frequency:.4g} Hz",), np.arange(data.modes) != k
        if data.modes > 1:
            rest = ModalData(
                data.points, data.frequency_hz[kept], data.damping_ratio[kept], data.covariance[kept],
                data.shapes[kept], data.shape_covariance[kept],
            )  # fmt: skip
            trials.append(_Trial("mode", of, rest))
        undamped = np.where(kept, data.damping_ratio, np.nan)
        if np.isfinite(data.damping_ratio[k]):
            trials.append(_Trial("mode", of, replace(data, damping_ratio=undamped)))
        unknown = np.where(kept[:, None, None], 0.0, np.diag([frequency**2, 0.0]))
        trials.append(_Trial("mode", of, replace(data, covariance=data.covariance + unknown), spared=1))
    return trials


def _of_point(bench: _Bench, name: str) -> list[_Cause]:
    """A point left out, and its gain against what the others make of it."""
    data = bench.data
    if len(data.points) < 2:
        return []
    kept = np.array([point != name for point in data.points])
    rest = replace(
        data,
        points=tuple(np.array(data.points)[kept]),
        shapes=data.shapes[:, kept],
        shape_covariance=data.shape_covariance[:, kept][:, :, kept],
    )
    alone, theta = bench.tried(_Trial("channel", (name,), rest))
    # What a point shows over what the rig at `theta` (unknowns,) has there; 0 where that cannot be told
    ignored = np.where([point == name for point in data.points], 1e12, 1.0)  # so it does not scale the shapes
    left = mode_residuals(
        bench.model, replace(data, shape_covariance=data.shape_covariance * np.outer(ignored, ignored)), theta
    )
    at = data.points.index(name)
    shown, expected = left.measured[:, at], left.measured[:, at] - left.shape[:, at]
    there = np.isfinite(shown) & np.isfinite(expected)
    power = float(np.sum(np.abs(expected[there]) ** 2))
    gain = float(np.sum((np.conj(expected) * shown)[there].real)) / power if power > 0 else 0.0
    if gain <= 0:
        return [alone]
    forms = [("unit", ratio) for ratio in RATIOS if abs(np.log(gain / ratio)) < NEAR] + [("gain", gain)]
    trials = [_Trial(kind, (name,), _divided(data, name, size), size) for kind, size in forms]
    return [alone, *(bench.tried(trial)[0] for trial in trials)]


# Another rig


def _other_rigs(bench: _Bench, theta: Real) -> list[_Cause]:
    """Missing parts and stated values that are wrong: those that the score at `theta` promises most of, fitted."""
    model = bench.model
    candidates = {"element": _parts_of_modes(model), "value": stated_values(model)}
    scored = [
        (fall, kind, element)
        for kind, elements in candidates.items()
        for fall, element in _promised(model, bench.data, theta, elements)
    ]
    scored.sort(key=lambda entry: -entry[0])
    return [_fitted(bench, kind, element) for fall, kind, element in scored[:FOLLOWED] if fall > 0]


def _parts_of_modes(model: Model) -> list[Element]:
    """Those that modes can tell: displacement inputs stand still, so a part that leads to one leads to the ground."""
    inputs = set(model.displacement_inputs)
    return [element for element in missing_elements(model) if not inputs & set(element.along)]


def _promised(
    model: Model, data: ModalData, theta: Real, elements: Sequence[Element]
) -> list[tuple[float, Element]]:
    """By how much χ² would fall with each of the elements unknown, by its score."""
    if not elements:
        return []
    larger, start = _extended(model, theta[None], elements)
    at = ModeProblem.of(larger, data).evaluate(start, np.zeros(1, dtype=np.int64))
    by_name = {element.name: element for element in elements}
    names = larger.unknown_names
    listed = score_tests(
        names, [name in by_name for name in names], at.symmetric[0], at.gradient[0], float(at.cost[0])
    )
    return [(promise.fall, by_name[promise.name]) for promise in listed]


def _extended(model: Model, starts: Real, elements: Sequence[Element]) -> tuple[Model, Real]:
    """The rig with the elements unknown, and starts (K, its unknowns) that mean the same as those given."""
    new = {element.name: element for element in elements}
    values = {element.name: element.guess or 0.0 for element in elements}
    there = tuple(new.pop(element.name, element) for element in model.elements)
    larger = replace(model, elements=(*there, *new.values()))
    columns = dict(zip(model.unknown_names, starts.T, strict=True))
    return larger, np.stack(
        [columns.get(name, np.full(len(starts), values.get(name, 0.0))) for name in larger.unknown_names],
        axis=1,
    )


def _fitted(bench: _Bench, kind: str, element: Element) -> _Cause:
    larger, starts = _extended(bench.model, bench.starts, [element])
    of = points_of(element, bench.model)
    cause, theta = _Bench(larger, bench.data, starts).tried(_Trial(kind, of, bench.data))
    size = float(theta[larger.unknown_names.index(element.name)])
    return replace(cause, trial=replace(cause.trial, number=size), element=element)
