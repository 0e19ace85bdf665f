"""Minima of the likelihood from many starts: found, told apart, and named where others fit nearly as well."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from dashpot.arrays import Complex, Ints, Real
from dashpot.channel import Quantity
from dashpot.data.modal_data import ModalData, of_eigenvalues
from dashpot.data.spectrum import LinesInTime, Spectrum, WholeRecord
from dashpot.errors import ConvergenceError, DashpotError
from dashpot.estimate.likelihood.descent import (
    NEAR_END,
    ROUGH,
    Effort,
    Likelihood,
    Stage,
    descend_all,
    thinned,
)
from dashpot.estimate.likelihood.measured import Measured, Sums, pieces
from dashpot.estimate.likelihood.objective import directly_driven, measured, predict
from dashpot.estimate.linear.least_squares import starts as equation_starts
from dashpot.estimate.linear.least_squares import where_finite
from dashpot.estimate.method import OtherMinima
from dashpot.estimate.preparation import Prepared, states_if_seen
from dashpot.model.dynamics import amplitudes, unit_forces
from dashpot.model.elements import Kind
from dashpot.model.matrix_elements import free_names
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, calibration_factors, channel_amplitudes, small
from dashpot.notices import Notice
from dashpot.numerics.levenberg_marquardt import PATIENCE, OptimizeResult
from dashpot.numerics.small_systems import SPARSE_FROM
from dashpot.unknowns import Unknown

# Where searches of the likelihood ended: told apart, in order, and those that compete.


# χ² by which a minimum may lie above the lowest one of one repeat and be the lowest of another
COMPETING = 60.0


@dataclass(frozen=True)
class LocalMinima:
    """Where searches ended, the lowest first: psi (V, M), signs of the channels (V, channels), cost (V,)."""

    psi: Real
    sign: Real
    cost: Real

    @staticmethod
    def none(unknowns: int, channels: int) -> LocalMinima:
        """No minima yet."""
        return LocalMinima(np.empty((0, unknowns)), np.empty((0, channels)), np.empty(0))

    def with_ends(self, psi: Real, sign: Real, cost: Real) -> LocalMinima:
        """With more ends, (k, M), (k, channels) and (k,).

        Those within 2 % of a lower one in every unknown are left out.
        """
        psi, sign = np.concatenate([self.psi, psi]), np.concatenate([self.sign, sign])
        cost = np.concatenate([self.cost, cost])
        kept: list[int] = []
        for k in np.argsort(cost, kind="stable"):
            size = np.maximum(np.abs(psi[k]), np.abs(psi[kept]))
            near = np.abs(psi[k] - psi[kept]) <= 0.02 * size
            if np.isfinite(cost[k]) and not np.any(
                np.all(near, axis=-1) & np.all(sign[k] == sign[kept], axis=-1)
            ):
                kept.append(int(k))
            if (
                len(kept) == 128
            ):  # dozens lie along a flat valley, and the right one must not be lost among them
                break
        return self if not kept else LocalMinima(psi[kept], sign[kept], cost[kept])

    def led_by(self, psi: Real, sign: Real) -> LocalMinima:
        """With ψ (1, M) and signs (1, channels) in the place of the first."""
        return LocalMinima(
            np.concatenate([psi, self.psi[1:]]), np.concatenate([sign, self.sign[1:]]), self.cost
        )

    def competing(self, rows: int) -> LocalMinima:
        """Those that may be as likely as the lowest one, if noise is what that leaves of so many `rows`."""
        return self.within(float(np.min(self.cost, initial=np.inf)) * COMPETING / max(rows, 1))

    def within(self, margin: float) -> LocalMinima:
        """Those that lie no more than `margin` above the lowest one."""
        near = self.cost <= self.cost[:1] + margin
        return LocalMinima(self.psi[near], self.sign[near], self.cost[near])


# Where to start a search when nobody guesses: rigs of sensible size, drawn at random (THEORY §4, ml).


SCATTER = (0.03, 0.1, 0.2, 0.35, 0.6)  # decades by which the elements of one candidate differ


def candidates(data: Prepared, count: int, rng: np.random.Generator) -> tuple[Real, Real]:
    """`count` draws of ψ, (count, M), and of the channels' signs, (count, channels).

    Each candidate has a mass, a natural frequency and a damping ratio of its own, around which its elements scatter
    by little or much: rigs are mostly built of parts alike, and among rigs of like parts a search finds its way.  The
    mass is drawn around what known parameters or measured forces imply, the frequency from the band of the data.
    Guesses and priors of the model narrow the draw; the first candidate is the middle of every range.
    """
    view = data.view
    low, high = np.min(view.omega), 1.5 * np.max(view.omega)
    middle = _typical_mass(data)
    masses = middle * 10 ** (0.3 * rng.standard_normal(count))
    rates = low * (high / low) ** rng.random(count)
    ratios = 10 ** rng.uniform(-2.3, 0.0, count)
    decades = rng.choice(SCATTER, count)[:, None] * rng.standard_normal((count, len(view.names)))
    masses[0], rates[0], ratios[0], decades[0] = middle, np.sqrt(low * high), 0.05, 0.0
    size = {kind: kind.law.typical_size(masses, rates, ratios) for kind in Kind}
    kinds = {element.name: element.kind for element in data.model.elements}
    psi = np.ones((count, len(view.names)))
    for j, unknown in enumerate(data.model.unknowns):
        if unknown.prior is not None and unknown.sd is not None:
            psi[:, j] = unknown.prior + unknown.sd * np.clip(decades[:, j], -1, 1)
        elif unknown.guess is not None:
            psi[:, j] = unknown.guess * 10 ** (GUESSED * decades[:, j])
        else:
            psi[:, j] = size[kinds[unknown.name]] * 10 ** decades[:, j]
        if unknown.lower is not None or unknown.upper is not None:
            psi[:, j] = np.clip(psi[:, j], unknown.lower, unknown.upper)
    if view.delays:
        psi[:, view.m + view.gains :] = view.nominal_calibrations[view.gains :]
    return _calibrated(data, psi, np.ones((count, len(view.channels))), rng)


def neighbours(
    psi: Real, sign: Real, view: ObservationModel, count: int, rng: np.random.Generator
) -> tuple[Real, Real]:
    """`count` draws around the rigs already found, near which the right minimum may lie.

    Some scatter all parameters, some exchange two of a kind (chains seen at few points are nearly the same with two
    of their parts exchanged), some change two parameters by much.
    """
    origin = rng.integers(0, len(psi), count)
    moved = psi[origin].copy()
    kinds = {element.name: element.kind for element in view.model.elements}
    alike = np.array(
        [[kinds[a.name] == kinds[b.name] for b in view.model.unknowns] for a in view.model.unknowns]
    )
    pairs = np.argwhere(np.triu(alike, 1))
    for row in moved:
        move = rng.integers(0, 3)
        if move == 0 and len(pairs):
            i, j = pairs[rng.integers(0, len(pairs))]
            row[[i, j]] = row[[j, i]]
            row[: view.m] *= 10 ** (0.03 * rng.standard_normal(view.m))
        elif move == 1 and view.m > 1:
            row[rng.choice(view.m, 2, replace=False)] *= 10 ** (0.4 * rng.standard_normal(2))
        else:
            row[: view.m] *= 10 ** (rng.choice(SCATTER[1:3]) * rng.standard_normal(view.m))
    return moved, sign[origin]


def _typical_mass(data: Prepared) -> float:
    """The mass that known parameters imply at the middle of the band, else measured force over acceleration."""
    view = data.view
    omega = float(np.exp(np.mean(np.log(view.omega))))
    known = []
    for element in data.model.elements:
        number = element.value if element.value is not None else element.guess
        if number is not None and number > 0:
            # Which share of critical damping a damper has is not known: it counts as an impedance.
            known.append(number / element.law.typical_size(1.0, omega, 0.5))
    masses = [
        e.value for e in data.model.elements if e.kind is Kind.MASS and e.value is not None and e.value > 0
    ]
    if masses:
        return float(np.exp(np.mean(np.log(masses))))
    size = np.mean(np.abs(np.nan_to_num(data.spectrum.amplitudes)), axis=0)
    force = [i for i, c in enumerate(view.channels) if c.quantity is Quantity.FORCE]
    motion = [i for i, c in enumerate(view.channels) if c.quantity is not Quantity.FORCE]
    if force and motion and np.any(size[:, force]) and not known:
        rate = np.array([2 - view.channels[i].quantity.derivative for i in motion])
        acceleration = np.max(size[:, motion] * view.omega[:, None] ** rate, axis=-1)
        pushed = np.max(size[:, force], axis=-1)
        usable = (acceleration > 0) & (pushed > 0)
        if np.any(usable):
            return float(np.exp(np.median(np.log(pushed[usable] / acceleration[usable]))))
    return float(np.exp(np.mean(np.log(known)))) if known else 1.0


def _calibrated(data: Prepared, psi: Real, sign: Real, rng: np.random.Generator) -> tuple[Real, Real]:
    """Gains and signs that suit each candidate: by regression on what it predicts, where the inputs are known."""
    view = data.view
    if not view.gains and not np.any(view.flips):
        return psi, sign
    soft, gains = measured(data, 1.0), slice(view.m, view.m + view.gains)
    # Where nothing is known of a gain that is worth a start, the data tell one.
    given = [(unknown.nominal, unknown.sd or 0.0) for unknown in view.unknowns[gains]]
    free = np.array([value is None or sd > abs(value) for value, sd in given], dtype=bool)
    if view.gains:
        drawn = 10 ** (0.5 * rng.standard_normal((len(psi), view.gains)))
        psi[:, gains] = np.where(free, drawn, view.nominal_calibrations[: view.gains])
    if np.any(view.flips):
        sign[:, view.flips] = rng.choice([-1.0, 1.0], size=(len(psi), int(np.sum(view.flips))))
    if soft.q is None:
        if view.gains:
            turned = rng.choice([-1.0, 1.0], size=(len(psi), view.gains))
            psi[:, gains] *= np.where(free, turned, 1.0)
        return psi, sign
    with np.errstate(all="ignore"):
        sums = Sums(len(psi))
        for piece in pieces(view, soft, len(psi)):
            some = psi[piece.rows]
            signs = sign[piece.rows]
            y = piece.data.y
            if piece.data.ends is None and piece.data.nonlinear is None and small(piece.view.model):
                # The channels under known inputs without their slopes, which many candidates would spend most time on
                model, q = piece.view.model, piece.data.q
                assert q is not None
                r = len(model.displacement_inputs)
                p, U, f = model.parameters(some[..., : piece.view.m]), q[..., :r], q[..., r:]
                X = amplitudes(model, p, piece.view.omega, U, f, piece.view.experiment)
                forces = np.zeros(len(model.elements), dtype=complex)
                if piece.view.has_forces:
                    forces = p[..., None, :] * unit_forces(
                        model, piece.view.omega, X, U, piece.view.experiment
                    )
                predicted = calibration_factors(piece.view, some, signs) * channel_amplitudes(
                    piece.view, X, q, forces
                )
            else:
                predicted = y - predict(piece.view, piece.data, some, signs).r
            weight = 1.0 / np.maximum(np.abs(y) ** 2, 1e-300) * (np.abs(y) > 0)
            along = np.sum((np.conj(predicted) * y).real * weight, axis=-2)
            sums.add(piece.rows, (along, np.sum(np.abs(predicted) ** 2 * weight, axis=-2)))
        along, power = sums.totals
    flip = view.flips & (along < 0)
    sign = np.where(flip, -sign, sign)
    for k in np.flatnonzero(free):
        with_gain = view.gain == k
        ratio = np.sum(along[:, with_gain], axis=-1) / np.maximum(
            np.sum(power[:, with_gain], axis=-1), 1e-300
        )
        usable = np.isfinite(ratio) & (ratio != 0)
        psi[:, view.m + k] *= np.where(usable, ratio, 1.0)
    return psi, sign


# Where a search in free decays begins: with rigs whose modes are those that the motion shows.
#
# The lines of a sampled free decay are those of a state space without input, all that sampling folds back
# included: X = C (1 − A/z)⁻¹ b with z = e^{jωh}. So z^i X is a row of the observability matrix, C Aⁱ, times
# the states, and a real polynomial in z. That is projected out; what is left spans the observability
# matrix, whose shift is A. It needs no start and no order of frequencies, and sees modes in the noise of
# single lines. Source: McKelvey, Akçay and Ljung, "Subspace-based multivariable system identification from
# frequency response data", IEEE Transactions on Automatic Control 41 (1996).


# What is taken for the uncertainty of modes, which only ranks rigs before the likelihood does.
SD_FREQUENCY, SD_DAMPING, SD_SHAPE = 1e-4, 0.05, 0.01


def moves_freely(model: Model, spectrum: Spectrum) -> bool:
    """Whether all that is seen of a small linear rig is whole records of free motion."""
    if model.inputs or len(model.nonlinear) or not small(model):
        return False
    return all(isinstance(stretch, WholeRecord) and stretch.loads for stretch in spectrum.stretches)


def decay_minima(data: Prepared, effort: Effort) -> LocalMinima:
    """Where rigs with the modes of free decays lead in one repeat, the lowest first; none of other data."""
    from dashpot.estimate.modal import rigs_with  # loads scipy.optimize

    view = data.view
    minima = LocalMinima.none(len(view.names), len(view.channels))
    if view.gains or view.delays or np.any(view.flips) or not moves_freely(view.model, data.spectrum):
        return minima
    few = thinned(data, 80)  # lines of each part of the band
    # Rigs with the modes that free decays show, none where channels tell too little of shapes
    rigs = np.empty((0, len(view.names)))
    poles, shown = free_modes(few)
    with suppress(DashpotError, np.linalg.LinAlgError):
        if len(poles):
            rigs = rigs_with(view.model, _modal_data(few.view, poles, shown), seed=effort.seed)
    near = _by_equation(data)
    # Many rigs are one: a few lines tell which.  What is near already is taken no further by few lines.
    for each, limit in ((12, PATIENCE), (80, ROUGH)):
        if limit == ROUGH:
            rigs = np.concatenate([rigs, near])
        if not len(rigs):
            continue
        signs = np.ones((len(rigs), len(view.channels)))
        likelihood = Likelihood.of(thinned(few, each), effort)
        with np.errstate(all="ignore"):
            ends = likelihood.descend_in(likelihood.exact, rigs, signs, limit, near=NEAR_END)
        minima = LocalMinima.none(*minima.psi.shape[1:], *minima.sign.shape[1:])
        minima = minima.with_ends(ends.x, signs, ends.cost).competing(likelihood.exact.rows)
        rigs = minima.psi
    return minima


def _by_equation(data: Prepared) -> Real:
    """The rig by the equation of motion in windows of the first record, (rigs, unknowns); none if not all is seen."""
    from dashpot.estimate.nonlinear.record_regression import decay_start  # loads scipy.optimize

    spectrum, states = data.spectrum, states_if_seen(data.view, data.spectrum, data.covariance)
    first, lines = spectrum.stretches[0], np.flatnonzero(spectrum.stretch == 0)
    none = np.empty((0, len(data.view.names)))
    if states is None or data.model.differs or not isinstance(first, WholeRecord):
        return none
    order = first.orders(spectrum.frequency_hz[lines])
    # No more samples than the lines ask for: windows of as many should last for some cycles
    samples = min(first.samples, 4 * (int(np.max(order)) + 1))
    try:
        rig = decay_start(data.model, states, LinesInTime(lines, order, first.duration_s, samples))
    except (DashpotError, ValueError, np.linalg.LinAlgError):  # no number
        return none
    return rig[None] if np.all(np.isfinite(rig)) else none


def free_modes(data: Prepared) -> tuple[Complex, Complex]:
    """Eigenvalues with Im > 0, (modes,) 1/s, by magnitude, and what channels show of them, (channels, modes).

    No more than the rig has; of the records that are sampled like the first one, in one repeat.
    """
    n, spectrum = data.model.n, data.spectrum
    whole = np.all(np.isfinite(spectrum.amplitudes[0]), axis=-1)
    stretches = list(enumerate(spectrum.stretches))
    records = [
        (value, np.flatnonzero((spectrum.stretch == number) & whole))
        for number, value in stretches
        if isinstance(value, WholeRecord)
    ]
    step = records[0][0].step_s
    records = [(value, each) for value, each in records if abs(value.step_s / step - 1) < 1e-9]
    channels = len(spectrum.channels)
    lines = sum(len(each) for _, each in records)
    # Powers of z: eight for each coordinate, more where fewer channels than that see it
    blocks = min(max(8 * n * n // channels, 8 * n), lines // channels)
    if (blocks - 1) * channels < 2 * n:
        return np.empty(0, dtype=complex), np.empty((channels, 0), dtype=complex)
    noise = np.sqrt(np.median(np.diagonal(data.covariance[0], axis1=-2, axis2=-1).real, axis=0))
    size = np.sqrt(np.mean(np.abs(spectrum.amplitudes[0]) ** 2, axis=0))
    unit = np.where(noise > 0, noise, np.where(size > 0, size, 1.0))
    left = list[Real]()
    for _, each in records:
        # z^i X of one record, (2 lines, blocks · channels), without the polynomials that its ends add
        powers = np.exp(1j * spectrum.omega[each] * step)[:, None] ** np.arange(blocks)
        products = powers[:, :, None] * (spectrum.amplitudes[0, each] / unit)[:, None, :]
        both = products.reshape(len(each), -1)
        moved = np.concatenate([both.real, both.imag])
        basis, _ = np.linalg.qr(np.concatenate([powers[:, 1:].real, powers[:, 1:].imag]))
        left.append(moved - basis @ (basis.T @ moved))
    _, _, rows = np.linalg.svd(np.linalg.qr(np.concatenate(left), mode="r"))
    observability = rows[: 2 * n].T
    A = np.linalg.lstsq(observability[:-channels], observability[channels:], rcond=None)[0]
    z, states = np.linalg.eig(A)
    with np.errstate(all="ignore"):
        poles = np.log(z.astype(complex)) / step
    # A pole of more than 0.7 of critical damping is noise.
    swings = (poles.imag > 0) & np.isfinite(poles) & (np.abs(poles.real) < 0.7 * np.abs(poles))
    poles, states = poles[swings], states[:, swings]
    order = np.argsort(np.abs(poles), kind="stable")
    return poles[order], (unit[:, None] * (observability[:channels] @ states))[:, order]


def _modal_data(view: ObservationModel, poles: Complex, shown: Complex) -> ModalData:
    """The modes at the coordinates that channels tell: all of them, or those that have a channel to themselves."""
    motion = ~np.any(view.force, axis=-1) & np.any(view.on_x, axis=-1)
    if np.linalg.matrix_rank(view.on_x[motion]) < view.model.n:
        motion &= np.count_nonzero(view.on_x, axis=-1) == 1
    seen = np.flatnonzero(np.any(view.on_x[motion], axis=0))
    derivative = view.derivative[motion]
    shapes = np.empty((len(poles), len(seen)), dtype=np.complex128)
    for number, pole in enumerate(poles):
        # In units of the motion at this mode: an acceleration is as large as its displacement there.
        rate = np.abs(pole) ** derivative
        reading = view.on_x[motion][:, seen] * (pole**derivative / rate)[:, None]
        shapes[number] = np.linalg.lstsq(reading, shown[motion, number] / rate, rcond=None)[0]
    shapes /= np.max(np.abs(shapes), axis=1, keepdims=True)
    size = np.abs(poles)
    poles = np.where(poles.real < 0, poles, -SD_FREQUENCY * size + 1j * poles.imag)
    covariance = np.zeros((len(poles), 2, 2))
    covariance[:, 0, 0] = (SD_FREQUENCY * size) ** 2 + (SD_DAMPING * poles.real) ** 2
    covariance[:, 1, 1] = covariance[:, 0, 0]
    spread: Complex = np.broadcast_to(SD_SHAPE**2 * np.eye(len(seen)), (len(poles), len(seen), len(seen)))
    points = tuple(view.model.coordinates[int(i)] for i in seen)
    return of_eigenvalues(points, poles, covariance, shapes, spread)


POOR = 1e-6  # p-value below which a repeat is searched again from its own starts
SOFTNESS = 0.03  # relative noise added to every channel in the middle stage of a search from afar
FAR = 20.0  # times the χ² of a fit: no rig of this kind comes near the data
DEEPEST = 8  # minima that are followed to the bottom
TIE = 0.01  # of χ²: what fits alike
GUESSED = 0.3  # decades within which guesses are right
DECIDES = "add a sensor at another point, state a value, or give an initial guess"
DOUBT = 9.2  # χ² by which another minimum may lie above and be told to the user: odds of 100 to 1


# From minima to the answer of each repeat


def from_minima(
    likelihood: Likelihood, minima: LocalMinima
) -> tuple[OptimizeResult, Real, tuple[Notice, ...]]:
    """Each repeat from the lowest minimum and those competing with it: its end, signs (K, channels), and a warning.

    The warning is of another minimum that fits nearly as well; of repeats it says in how many there is one.
    """
    scale = _scale(likelihood, minima)
    competing = followed_minima(likelihood, minima)
    repeats = likelihood.repeats
    sign = np.repeat(competing.sign[:1], repeats, axis=0)
    best = likelihood.descend(np.repeat(competing.psi[:1], repeats, axis=0), sign)
    ends = [(np.arange(repeats), best, competing.sign[0])]
    for psi, flips in zip(competing.psi[1:], competing.sign[1:], strict=True):
        start, signs = (np.repeat(part[None], repeats, axis=0) for part in (psi, flips))
        # A few steps tell for which repeats this minimum is not out of the question.
        short = likelihood.descend(start, signs, limit=PATIENCE)
        rows = np.flatnonzero(short.cost < best.cost + DOUBT * scale)
        if not len(rows):
            continue
        end = likelihood.descend(short.x[rows], signs[rows], repeats=rows)
        ends.append((rows, end, flips))
        sign = sign.copy()
        sign[rows[best.worse(rows, end)]] = flips
        best = best.improved(rows, end)
    if repeats == 1:
        unknowns = likelihood.view.unknowns
        equal = [
            each for each in ends if each[1].converged[0] and each[1].cost[0] <= best.cost[0] + TIE * scale
        ]
        if len(equal) > 1:  # the guesses decide
            _, end, flips = max(equal, key=lambda each: guessed(unknowns, each[1].x[0]))
            best, sign = replace(end, iterations=best.iterations), flips[None]
        sd = likelihood.model_at(best.x, sign).sd
        others = zip(competing.psi, (competing.cost - best.cost[0]).tolist(), strict=True)
        return best, sign, rival_notice(unknowns, best.x[0], sd[0], others, scale)
    sd = likelihood.model_at(best.x, sign).sd
    rival = np.zeros(repeats, dtype=bool)
    for rows, end, _ in ends:
        alike = end.converged & (end.cost - best.cost[rows] <= DOUBT * scale)
        rival[rows] |= alike & np.any(np.abs(end.x - best.x[rows]) > 3 * sd[rows], axis=-1)
    text = f"not unique in {np.sum(rival)} of {repeats} repeats: another minimum fits nearly as well there"
    return best, sign, (Notice("not_unique", text),) if np.any(rival) else ()


def _scale(likelihood: Likelihood, minima: LocalMinima) -> float:
    """What a difference of χ² is counted in: the lowest one's χ² for each row, where noise is not known or no fit."""
    ratio = float(minima.cost[0] / likelihood.exact.rows)
    return max(1.0, ratio) if likelihood.data.noise_known else ratio


def followed_minima(likelihood: Likelihood, minima: LocalMinima) -> LocalMinima:
    """The minima that compete with the lowest one, followed further down in the first repeat.

    They may have been found in fewer lines: where they are many, some steps of all of them tell which are low here.
    """
    first = np.array([0])
    acceptable = _acceptable(likelihood.data, likelihood.exact, minima.psi.shape[-1])
    most = 2 * DEEPEST if minima.cost[0] <= FAR * acceptable else DEEPEST // 2
    minima = minima.within(COMPETING * _scale(likelihood, minima))
    none = LocalMinima.none(minima.psi.shape[1], minima.sign.shape[1])
    for limit in (PATIENCE, ROUGH) if len(minima.cost) > most else ():
        rows = np.zeros(len(minima.cost), dtype=int)
        ends = likelihood.descend_in(likelihood.exact, minima.psi, minima.sign, limit, rows, near=NEAR_END)
        minima = none.with_ends(ends.x, minima.sign, ends.cost)
        minima = minima.within(COMPETING * _scale(likelihood, minima))
    deeper = none
    for k in range(min(len(minima.cost), most)):
        end = likelihood.descend(minima.psi[k : k + 1], minima.sign[k : k + 1], repeats=first, limit=ROUGH)
        if end.converged[0] or k == 0:
            deeper = deeper.with_ends(end.x, minima.sign[k : k + 1], end.cost)
    return deeper


def apart(psi: Real, other: Real, sd: Real) -> bool:
    """Whether two ends are different minima: within 3 sd they are the same flat one.  All arguments (unknowns,)."""
    return bool(np.any(np.abs(other - psi) > 3 * sd))


def guessed(unknowns: Sequence[Unknown], psi: Real) -> float:
    """Logarithm of how likely values (M,) are by the guesses, which are right within a factor of two; 0 without any."""
    away = [
        np.log10(value / unknown.guess) / GUESSED
        for unknown, value in zip(unknowns, psi.tolist(), strict=False)
        if unknown.guess is not None and value * unknown.guess > 0
    ]
    return -0.5 * float(np.sum(np.square(away)))


def rival_notice(
    unknowns: Sequence[Unknown],
    psi: Real,
    sd: Real,
    others: Iterable[tuple[Real, float]],
    scale: float,
    cure: str = DECIDES,
) -> tuple[Notice, ...]:
    """A warning of those of `others`, (ends (M,), χ² above that of ψ), that are other minima and fit nearly as well.

    psi and sd (M,); scale: what a difference of χ² is counted in.
    """
    found: list[tuple[Real, float]] = []
    for other, above in others:
        alone = all(apart(each, other, sd) for each in (psi, *(each for each, _ in found)))
        if above <= DOUBT * scale and alone:
            found.append((other, above))
    return (not_unique(unknowns, psi, found, scale, cure),) if found else ()


def not_unique(
    unknowns: Sequence[Unknown],
    psi: Real,
    others: Sequence[tuple[Real, float]],
    scale: float,
    cure: str = DECIDES,
) -> OtherMinima:
    """The notice that other minima, (ends (M,), χ² above that of ψ (M,)), fit alike, the first of them in words."""
    other, above = others[0]
    change = np.abs(other - psi) / np.maximum(np.maximum(np.abs(psi), np.abs(other)), 1e-300)
    # What differs by less than a thousandth of the largest change is not named.
    largest = [j for j in np.argsort(-change, kind="stable")[:4] if change[j] > 1e-3 * np.max(change)]
    values = ", ".join(f"{unknowns[j].name} = {other[j]:.4g} {unknowns[j].unit}" for j in largest)
    farther, scaled = above / scale, "" if scale == 1 else ", scaled to the misfit"
    worse = f"almost as well (χ² is {farther:.3g} larger{scaled})" if farther > TIE else "equally well"
    worse = f"better (χ² is {-farther:.3g} smaller{scaled})" if farther < -TIE else worse
    more = len(others) - 1
    many = f" ({more} further set{'' if more == 1 else 's'} of values likewise)" if more else ""
    text = f"not unique: {values} fits {worse}{many}; {cure}"
    odds = [
        float(np.exp(guessed(unknowns, end) - guessed(unknowns, psi) - max(rise, 0.0) / (2 * scale)))
        if not np.any((psi > 0) & (end <= 0))
        else 0.0
        for end, rise in others
    ]
    names, ends = tuple(unknowns[j].name for j in largest), tuple(tuple(end.tolist()) for end, _ in others)
    return OtherMinima("not_unique", text, names, ends, tuple(odds))


def searched_again(
    likelihood: Likelihood, found: OptimizeResult, sign: Real
) -> tuple[OptimizeResult, Real, tuple[Notice, ...]]:
    """Repeats that did not end in a fit are searched from starts of their own; the better end is kept.

    The notice is that of `from_minima`, of one repeat alone.  sign (K, channels).
    """
    acceptable = _acceptable(likelihood.data, likelihood.exact, found.x.shape[-1])
    others = 1.5 * np.median(found.cost) if len(found.cost) > 1 else 0.0
    poor = ~found.converged | (found.cost > np.maximum(acceptable, others))
    if len(poor) == 1 and not seen_directly(likelihood.data):
        return found, sign, ()  # its start was its own already
    x, cost, converged = found.x.copy(), found.cost.copy(), found.converged.copy()
    iterations = found.iterations.copy()
    sign, notices, history = sign.copy(), tuple[Notice, ...](), found.history
    for repeat in np.flatnonzero(poor):
        minima = global_minima(likelihood, int(repeat))
        end, flips, notices_of_end = from_minima(likelihood.only(int(repeat)), minima)
        if not end.cost[0] >= cost[repeat]:
            x[repeat], cost[repeat], converged[repeat] = end.x[0], end.cost[0], end.converged[0]
            iterations[repeat] += end.iterations[0]
            sign[repeat] = flips[0]
            notices = notices_of_end if len(poor) == 1 else ()
            if repeat == 0:
                history = end.history
    return OptimizeResult(x, cost, converged, iterations, history), sign, notices


# From nothing to minima


def minima_around(likelihood: Likelihood, start: Real, sign: Real) -> LocalMinima:
    """Where `start` (1, M) leads, and draws about that end, two standard deviations wide; sign (1, channels)."""
    end = likelihood.descend(start, sign)
    minima = LocalMinima.none(start.shape[1], sign.shape[1]).with_ends(end.x, sign, end.cost)
    around = likelihood.model_at(end.x, sign)
    covariance, sd = around.inverse[0], around.sd[0]
    if not np.all(np.isfinite(sd)):
        return minima
    share, directions = np.linalg.eigh(covariance / np.outer(sd, sd))
    drawn = np.random.default_rng(likelihood.effort.seed).standard_normal((8, len(sd)))
    away = (drawn * np.sqrt(np.maximum(share, 0.0))) @ directions.T
    signs = np.repeat(sign, len(drawn), axis=0)
    # Minima whose parts differ in sign were found from half of them.
    others = likelihood.descend(end.x + 2.0 * sd * away, signs)
    ended = others.converged
    return minima.with_ends(others.x[ended], signs[ended], others.cost[ended])


def global_minima(likelihood: Likelihood, repeat: int) -> LocalMinima:
    """The minima that many starts of one repeat lead to, the lowest first.

    The first round starts from candidates, those after it from neighbours of the lowest minima as well.  Rounds end
    when a tenth of the first starts led to the lowest one and it fits (known noise), or half of them, or when two
    rounds in a row find nothing lower.  Raises ConvergenceError if no start ends at a finite cost.
    """
    effort = likelihood.effort
    on_basis = likelihood.view.reduced
    one = Likelihood.of(thinned(likelihood.data.only(repeat)), effort)
    rng = np.random.default_rng([effort.seed, repeat])
    stages, low, high = _stages(one), one.lower, one.upper
    seen = seen_directly(one.data)
    # Where all is seen starts are cheap, and a search goes on from a p-value of 0.1.
    acceptable = _acceptable(one.data, one.exact, len(one.view.names), 0.1 if seen else POOR)
    # Large rigs: fewer starts, and none where a guess leads to a fit; where all is seen the equation starts near.
    ease = min(1.0, SPARSE_FROM / max(one.view.model.n if on_basis is None else on_basis.size, 1))
    ease = min(ease, 0.25) if seen else ease
    starts = max(int(effort.starts * ease), min(effort.starts, 16))
    minima = LocalMinima.none(len(one.view.names), len(one.view.channels))
    if not small(one.view.model) and all(
        u.guess is not None or u.sd is not None for u in one.data.model.unknowns
    ):
        psi, sign, _ = through(stages, *candidates(one.data, 1, rng), past=1, lower=low, upper=high)
        end = one.descend(psi, sign)
        minima = minima.with_ends(end.x, sign, end.cost)
        if np.any(minima.cost <= acceptable):
            return minima
    idle, last_sure = 0, int(seen)
    for turn in range(effort.rounds):
        psi, sign = _starts_of_round(one, stages, minima, int(effort.candidates * ease), starts, turn, rng)
        # Where all is seen, an end far beyond the starts is on its way to infinity.
        reach = 1e4 * np.max(np.abs(psi), axis=0) if seen else np.inf
        # Half of the first starts go past the logarithms as well, all where there is no softened stage
        past = (len(psi) + 1) // (1 if len(stages) == 2 else 2) if turn == 0 else 0
        psi, sign, _ = through(stages, psi, sign, past=past, lower=low, upper=high)
        costs = np.where(np.all(np.abs(psi) <= reach, axis=-1), stages[-1].cost(psi, sign), np.inf)
        deep = np.argsort(costs, kind="stable")[:DEEPEST]
        end = one.descend(psi[deep], sign[deep], limit=25)
        psi[deep], costs[deep] = end.x, np.where(np.isfinite(costs[deep]), end.cost, np.inf)
        before = minima.cost[0] if len(minima.cost) else np.inf
        minima = minima.with_ends(psi, sign, costs)
        if not len(minima.cost):
            raise ConvergenceError(
                "the search converged from no initial guess", cure="give initial guesses of the unknowns"
            )
        lowest = minima.cost[0]
        # Far from any fit a lower end counts only where it is another one, not the same creeping on.
        least = 0.1 * lowest if lowest > FAR * acceptable else 1e-3 * max(1.0, lowest / one.exact.rows)
        idle = idle + 1 if lowest > before - least else 0
        share = np.mean(costs <= lowest * 1.01 + 1) if turn == last_sure else 0.0
        if share >= (0.1 if lowest <= acceptable else 0.5) or idle > 1:
            break
    return minima


def _starts_of_round(
    one: Likelihood,
    stages: Sequence[Stage],
    minima: LocalMinima,
    many: int,
    starts: int,
    turn: int,
    rng: np.random.Generator,
) -> tuple[Real, Real]:
    """The best of many candidates, ranked by the first stage; after the first round neighbours of minima as well."""
    psi, sign = candidates(one.data, many + starts, rng)
    order = np.argsort(stages[0].cost(psi, sign), kind="stable")
    chosen = np.concatenate([[0], order[:starts]]) if turn == 0 else order[: starts // 4]
    if seen_directly(one.data):  # the rank favours one valley, and starts are cheap
        chosen = np.concatenate([chosen[: 1 + starts // 2], 1 + np.arange(starts)])
    middle, psi, sign = psi[0], psi[chosen], sign[chosen]
    if turn == 0 and one.data.states is not None and seen_directly(one.data):
        # Least squares on the equation of motion. Noise of a fifth of the motion makes some parts negative, and what
        # starts there stays there: these are small ones.
        model = one.data.model
        near = where_finite(np.concatenate(equation_starts(model, one.data.states)), middle)
        part = np.array([name not in free_names(model) for name in model.unknown_names])
        near = np.where(part & (near < 0.1 * middle), 0.1 * middle, near)
        psi, sign = np.concatenate([near, psi]), np.concatenate([np.ones((len(near), sign.shape[1])), sign])
    if turn > 0:
        near, near_sign = neighbours(minima.psi[:DEEPEST], minima.sign[:DEEPEST], one.view, starts, rng)
        psi, sign = np.concatenate([psi, near]), np.concatenate([sign, near_sign])
    return psi, sign


def seen_directly(data: Prepared) -> bool:
    """Whether channels whose calibration is known, and no others, show every coordinate and input."""
    return data.states is not None and bool(data.view.is_direct.all())


def _stages(one: Likelihood) -> tuple[Stage, ...]:
    """What is minimised one after the other from afar: logarithms, softened weights, and the likelihood itself.

    Where all is seen the likelihood has few valleys, and softened weights lead past the right one.
    """
    view = one.view
    by_channels = directly_driven(view, one.exact)
    if by_channels is None:
        first = Stage(view, measured(one.data, 0.3))
    else:
        # Logarithms weigh 1 where a channel stands out of its noise, down to 0 below it.
        power = np.abs(np.nan_to_num(one.data.spectrum.amplitudes[0])) ** 2
        noise = np.diagonal(one.data.covariance[0], axis1=-2, axis2=-1).real if one.data.noise_known else 0.0
        total = power + noise
        first = Stage(view, by_channels, power / np.where(total > 0, total, 1.0))
    exact = Stage(view, one.exact)
    if seen_directly(one.data):
        return first, exact
    return first, Stage(view, measured(one.data, SOFTNESS)), exact


def through(
    stages: Sequence[Stage],
    psi: Real,
    sign: Real,
    rows: Ints | None = None,
    *,
    past: int = 0,
    lower: Real | float = -np.inf,
    upper: Real | float = np.inf,
    limit: int = ROUGH,
) -> tuple[Real, Real, Ints]:
    """Where starts (k, M) end that go through all stages, and the first `past` of them without the first stage.

    Each in its repeat of `rows` (k,), `limit` iterations a stage; ends, signs and repeats of all.  Logarithms lead
    nearly all to one minimum, and that may be the wrong one.
    """
    rows = stages[0].data.rows_of(len(psi)) if rows is None else rows
    ended, others = psi, psi[:past]
    for stage in stages:
        ended = descend_all(stage, ended, sign, rows, lower=lower, upper=upper, limit=limit)
    for stage in stages[1:] if past else ():
        others = descend_all(stage, others, sign[:past], rows[:past], lower=lower, upper=upper, limit=limit)
    return (
        np.concatenate([ended, others]),
        np.concatenate([sign, sign[:past]]),
        np.concatenate([rows, rows[:past]]),
    )


def fits(likelihood: Likelihood, end: OptimizeResult) -> bool:
    """Whether the end of a search of one repeat may be the truth, as its χ² is no surprise."""
    return bool(end.cost[0] <= _acceptable(likelihood.data, likelihood.exact, end.x.shape[-1]))


def _acceptable(data: Prepared, exact: Measured, unknowns: int, level: float = POOR) -> float:
    """The χ² above which an end is no fit at a p-value of `level`; inf where the noise is not known."""
    dof = exact.rows - unknowns
    if not data.noise_known or dof <= 0:
        return np.inf
    uncertain = np.min(data.spectrum.dof)
    return float(chdtri(dof, level)) * (1.0 if np.isinf(uncertain) else 1 + 8 / max(uncertain - 4, 1.0))
