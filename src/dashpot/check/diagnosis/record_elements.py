"""Nonlinear elements that whole records call for beside a linear rig, by the score of each alone (THEORY §9).

Under the motion of the record a candidate pushes with a force that is known in time; its lines, carried to the channels
by the linear rig, are one column, the inputs and the ends of the records taken out.  What a linear spring or damper at
the same place does as well counts for nothing: a missing linear element must not pass for a nonlinear one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import next_fast_len

from dashpot.arrays import Complex, Ints, Real
from dashpot.check.diagnosis.candidate_elements import (
    ScoredElement,
    at_each_scale,
    candidate_elements,
    feeds_motion,
    has_clearance,
    moving_pairs,
)
from dashpot.check.diagnosis.nonlinear_elements import APART, CERTAIN
from dashpot.check.diagnosis.score_test import steadiness
from dashpot.data.conditioning.still import HALF_WINDOW, smoothed
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord, history_of_lines
from dashpot.errors import DashpotError
from dashpot.estimate.inference.noise_in_time import UNEVEN
from dashpot.estimate.likelihood.chunks import Measured
from dashpot.estimate.likelihood.objective import RecordFit, measured, predict, record_fit
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.elements import Element, Kind, between
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import operated_states
from dashpot.model.observation import (
    ObservationModel,
    Transfer,
    calibrated_transfer,
    calibration_factors,
    observation_model,
)
from dashpot.numerics.projection import orthonormal, real_rows

MOST_AMPLITUDES = 100_000  # complex numbers of all channels
STEADY = 1e-3  # p-value below which all parts of the records agree that there is one
OVERSAMPLED = 2  # times the samples of a record: kinks of a law reach beyond its lines
LEAST = 0.02  # of what is left over, that a candidate must explain: mistakes of other kinds leave it less by chance
NEARLY = 0.5  # of what the best explains: others that explain as much are named, too
MOST = 3  # candidates that are named
HANDICAP = 0.85  # of what a law explains by such a choice, beside laws without one
QUIET = 0.05  # share of the lines that have nothing but noise at the least
STILL = 1e-9  # of the largest elongation: points that move no further do not move


def called_for_in_records(model: Model, spectrum: Spectrum, estimate: Estimate) -> list[ScoredElement]:
    """Candidates of which the whole records leave no doubt, the best first; [] where there is none.

    spectrum: without batch axes, with the noise that the estimate of a linear rig rests on.
    """
    whole = bool(spectrum.records) and len(spectrum.records) == len(spectrum.stretches)
    if not whole or spectrum.amplitudes.size > MOST_AMPLITUDES or not np.all(np.isfinite(estimate.values)):
        return []
    try:
        data = prepare(model, spectrum, states=False)
        exact = measured(data)
    except DashpotError:
        return []
    if exact.ends is None:
        return []
    psi, sign = estimate.values[None], spectrum.signs(estimate.signs)
    with np.errstate(all="ignore"):
        fit = record_fit(data.view, exact, psi, sign)
        slopes = predict(data.view, exact, psi, sign).J
    if not np.all(np.isfinite(slopes)):
        return []
    places = _places(data.view, spectrum, fit, exact, psi, sign)
    uneven = any(notice.code == UNEVEN for notice in estimate.warnings)
    return _scored(model, exact, spectrum, fit, slopes, places, uneven)


@dataclass(frozen=True)
class _Times:
    """The samples of whole records, and which of their lines are in the band."""

    lines: tuple[Ints, ...]
    order: tuple[Ints, ...]
    samples: tuple[int, ...]

    @staticmethod
    def of(spectrum: Spectrum) -> _Times:
        """Those of a spectrum's whole records."""
        lines, order, samples = [], [], []
        for number in spectrum.records:
            record = spectrum.stretches[number]
            assert isinstance(record, WholeRecord)
            lines.append(np.flatnonzero(spectrum.stretch == number))
            order.append(record.orders(spectrum.frequency_hz[lines[-1]]))
            samples.append(int(next_fast_len(OVERSAMPLED * record.samples, real=True)))
        return _Times(tuple(lines), tuple(order), tuple(samples))

    def history(self, amplitudes: Complex) -> Real:
        """Motion in time of amplitudes (lines, ...), one record after the other, (samples of all, ...)."""
        return np.concatenate(
            [
                history_of_lines(amplitudes[lines], order, samples)
                for lines, order, samples in zip(self.lines, self.order, self.samples, strict=True)
            ]
        )

    def amplitudes(self, history: Real) -> Complex:
        """Lines (lines,) of a history (samples of all,)."""
        out = np.zeros(sum(map(len, self.lines)), dtype=np.complex128)
        pieces = np.split(history, np.cumsum(self.samples)[:-1])
        for lines, order, piece in zip(self.lines, self.order, pieces, strict=True):
            out[lines] = np.fft.rfft(piece)[order] * (2 / len(piece))
        return out


@dataclass(frozen=True)
class _Place:
    """Two points between which an element may be: how they move, and what a unit force between them does.

    along: the points with their signs; motion (lines,); effect (lines, channels); elongation, rate (samples of all,), m
    and m/s
    """

    along: Mapping[str, float]
    motion: Complex
    effect: Complex
    elongation: Real
    rate: Real

    @property
    def size(self) -> float:
        """The largest elongation, m."""
        return float(np.max(np.abs(self.elongation)))

    def force(self, element: Element) -> Real:
        """Unit force of an element here, (samples of all,), along the place, whichever way round the element is."""
        law = element.force_law
        assert law is not None
        constants = np.array([constant.value for constant in law.constants], dtype=float)
        way = next(element.along[point] * factor for point, factor in self.along.items())
        d, v = way * self.elongation, way * self.rate
        z = operated_states(law, d, constants[0]) if law.operator else d
        unit: Real = way * np.broadcast_to(law(d, v, z, constants).value, v.shape)
        return unit


def _places(
    view: ObservationModel, spectrum: Spectrum, fit: RecordFit, exact: Measured, psi: Real, sign: Real
) -> dict[tuple[str, str], _Place]:
    """The places by their points, of those that move.

    The motion is that of the linear rig, and what the residuals of the channels add to it beyond noise (Wiener).
    """
    model, pairs = view.model, moving_pairs(view.model)
    probes = [between(f"place {a} {b}", Kind.SPRING, a, b, value=0.0) for a, b in pairs]
    larger = replace(model, elements=(*model.elements, *probes))
    rig = calibrated_transfer(observation_model(larger, view.channels, view.omega), psi, sign)
    assert isinstance(rig, Transfer)
    assert isinstance(fit.rig, Transfer)
    effect = rig.E[0][..., len(model.elements) :]
    X = np.einsum("lnq,lq->ln", fit.rig.X[0], fit.motion[0])
    r = fit.r[0]
    share = _beyond_noise(spectrum, r)
    moving = np.any(view.on_x, axis=1) & ~np.any(view.force, axis=1)
    rates = (1j * view.omega[:, None]) ** view.derivative * calibration_factors(view, psi, sign)[0]
    X = X + (share * r / rates)[:, moving] @ np.linalg.pinv(view.on_x[moving]).T
    U = fit.motion[0, :, : model.D.shape[1]]
    motion = X @ larger.B[len(model.elements) :].T + U @ larger.D[len(model.elements) :].T
    times = _Times.of(spectrum)
    elongation = times.history(motion)
    rate = times.history(1j * view.omega[:, None] * motion)
    reach = np.max(np.abs(elongation), axis=0)
    return {
        pair: _Place(probes[j].along, motion[:, j], effect[..., j], elongation[:, j], rate[:, j])
        for j, pair in enumerate(pairs)
        if reach[j] > STILL * np.max(reach)
    }


def _beyond_noise(spectrum: Spectrum, residual: Complex) -> Real:
    """Share of the residuals that is no noise, (lines, channels): white noise is as low as where they are quietest."""
    power = np.empty(residual.shape)
    for number in spectrum.records:
        lines = np.flatnonzero(spectrum.stretch == number)
        power[lines] = smoothed((np.abs(residual[lines]) ** 2).astype(np.complex128), HALF_WINDOW).real
    noise = np.quantile(power, QUIET, axis=0)
    share: Real = np.maximum(1 - noise / np.maximum(power, np.finfo(float).tiny), 0.0)
    return share


def _scored(
    model: Model,
    exact: Measured,
    spectrum: Spectrum,
    fit: RecordFit,
    slopes: Complex,
    places: dict[tuple[str, str], _Place],
    uneven: bool,
) -> list[ScoredElement]:
    """The candidates that pass, the best first; slopes (1, lines, channels, M).

    Of noise that is `uneven` in time no test holds but that of all parts of the records.
    """

    def rows(columns: Complex) -> Real:
        """Columns (lines, channels, k) with unit noise, inputs and ends taken out, (rows, k)."""
        both: Real = real_rows(fit.root @ fit.left_of(columns[None]))[0]
        return both

    times, rate = _Times.of(spectrum), 1j * spectrum.omega
    linear = [
        place.effect * (factor * place.motion)[:, None] for place in places.values() for factor in (1.0, rate)
    ]
    own = real_rows(fit.root @ slopes)
    beside = np.concatenate([own[0], rows(np.stack(linear, axis=-1))], axis=-1)
    test = _Test(
        times, orthonormal(own)[0][0], orthonormal(beside[None])[0][0], real_rows(fit.root @ fit.r[..., None])[0, :, 0],
        max(exact.rows - int(fit.of_ends.rank[0]) - beside.shape[-1] - 1, 1), uneven,
    )  # fmt: skip
    scored = []
    motions = {pair: (place.size, float(np.max(np.abs(place.rate)))) for pair, place in places.items()}
    for element in at_each_scale(candidate_elements(model, motions)):
        place = next(place for place in places.values() if set(place.along) == set(element.along))
        column = place.effect * times.amplitudes(place.force(element))[:, None]
        candidate = test.of(element, rows(column[..., None])[:, 0])
        if (
            candidate is not None
            and candidate.fall > LEAST * candidate.chi2
            and not feeds_motion(candidate.element, candidate.value)
        ):
            scored.append(candidate)
    return _named(scored)


def _named(scored: Sequence[ScoredElement]) -> list[ScoredElement]:
    """The best of each place and law, the best first, as far as they explain nearly as much as the best of all."""

    def explains(candidate: ScoredElement) -> float:
        return candidate.fall * (HANDICAP if has_clearance(candidate.element) else 1.0)

    best: dict[str, ScoredElement] = {}
    for candidate in sorted(scored, key=explains, reverse=True):
        best.setdefault(candidate.element.name, candidate)
    named = list(best.values())
    return [candidate for candidate in named if explains(candidate) >= NEARLY * explains(named[0])][:MOST]


@dataclass(frozen=True)
class _Test:
    """What a candidate explains of the residual beside others; orthonormal columns and sides with unit noise.

    own (rows, M): of the rig's own unknowns; beside (rows, M + 2 places): with the linear elements; residual (rows,);
    rows: real parts of lines by channels, then imaginary ones
    """

    times: _Times
    own: Real
    beside: Real
    residual: Real
    dof: int
    uneven: bool

    def of(self, element: Element, column: Real) -> ScoredElement | None:
        """The candidate with its column (rows,); None where it is in doubt."""
        nonlinear = _left(self.beside, column)
        if not _size(nonlinear) > APART * _size(column):
            return None
        beyond = _left(self.beside, self.residual)
        value = float(nonlinear @ beyond) / float(nonlinear @ nonlinear)
        # The cost is −2 ln L: twice the square of what has unit noise.
        chi2, fall = 2 * float(beyond @ beyond), 2 * value * float(nonlinear @ beyond)
        test = ScoredElement(element, fall, chi2, self.dof, value)
        if not (test.p_value < CERTAIN and self._steady(nonlinear, beyond, value)):
            return None
        alone = _left(self.own, column)
        value = float(alone @ self.residual) / float(alone @ alone)
        chi2 = 2 * float(self.residual @ self.residual)
        return ScoredElement(element, 2 * value * float(alone @ self.residual), chi2, self.dof, value)

    def _steady(self, column: Real, residual: Real, value: float) -> bool:
        """Whether the parameter is beyond doubt by its scatter over parts of the records in time."""
        histories = self._history(column), self._history(residual)
        return steadiness(*histories, value, uneven=self.uneven) < (CERTAIN if self.uneven else STEADY)

    def _history(self, rows: Real) -> Real:
        """Rows in time, (samples of all, channels)."""
        real, imaginary = np.split(rows, 2)
        lines = sum(map(len, self.times.lines))
        return self.times.history((real + 1j * imaginary).reshape(lines, -1))


def _left(basis: Real, column: Real) -> Real:
    left: Real = column - basis @ (basis.T @ column)
    return left


def _size(column: Real) -> float:
    return float(np.sqrt(column @ column))
