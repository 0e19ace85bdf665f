"""What elements between two ends do in a cycle of motion: energy, equivalent stiffness, equivalent damping.

For an elongation d(t) = Σ_h Re(d_h e^{jhωt}) and the force F(t) of all elements that join the same ends

    E = ∮ F dd = π Σ_h h Im(F_h d_h*)      K = Re(F₁/d₁)      C = Im(F₁/d₁)/ω

so that K and C are the spring and the viscous damper of the same fundamental force, and E = π ω C |d₁|² of a sine.
Standard deviations are those of the estimate's covariance, by exact slopes; the motion is treated as exact.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Complex, Real, frozen
from dashpot.channel import kind_of
from dashpot.data.record import Record, real_factor
from dashpot.data.spectrum import Spectrum, WholeRecord
from dashpot.estimate.nonlinear.objective import dwells_of
from dashpot.estimate.result import Cycle, Estimate
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate
from dashpot.model.nonlinear.harmonics import complex_of, real_of
from dashpot.model.observation import calibration_factors, observation_model


@dataclass(frozen=True)
class Specimen:
    """Elements that join the same ends, and with which sign each is stretched by the elongation of the first."""

    members: tuple[int, ...]
    signs: tuple[float, ...]


def specimens(model: Model) -> tuple[Specimen, ...]:
    """All groups of elements that join the same ends, masses aside, in the experiment that the rig stands in."""
    groups: dict[frozenset[tuple[str, float]], list[tuple[int, float]]] = {}
    for i, element in enumerate(model.elements):
        if element.kind is Kind.MASS or not element.along or not model.acts[i] or element.block is not None:
            continue
        sign = float(np.sign(min(element.along.items())[1]))
        key = frozenset((point, sign * factor) for point, factor in element.along.items())
        groups.setdefault(key, []).append((i, sign))
    return tuple(
        Specimen(tuple(i for i, _ in group), tuple(sign * group[0][1] for _, sign in group))
        for group in groups.values()
    )


def cycles_of(
    model: Model, specimen: Specimen, theta: Real, covariance: Real, omega: Real, d: Complex
) -> Iterator[Cycle]:
    """The cycles of elements at elongations d (N, H + 1), ω (N,); covariance (unknowns, unknowns) of θ."""
    orders = np.arange(d.shape[1])
    p, constants = model.parameters(theta), model.inner_constants(theta)
    factors = model.factors(omega[:, None] * orders)
    curved = model.nonlinear.tolist()
    q = np.zeros((len(d), len(curved), 2 * d.shape[1] - 1))
    for i, sign in zip(specimen.members, specimen.signs, strict=True):
        if i in curved:
            q[:, curved.index(i)] = real_of(sign * d)
    # 1024 instants of a cycle: kinks of laws show in their first harmonic by 1e-5
    at = alternate(model, np.tile(constants, (len(d), 1)), omega, q, 1024)
    force, slope = np.zeros_like(d), np.zeros((*d.shape, len(theta)), dtype=np.complex128)
    for i, sign in zip(specimen.members, specimen.signs, strict=True):
        unit = factors[:, :, i] * d
        if i in curved:
            row = curved.index(i)
            unit = sign * complex_of(at.a[:, row])
            inner = complex_of(np.moveaxis(at.by_constant[row], -1, 1))  # (N, constants, H + 1)
            by_theta = model.constants_map[0][model.constant_slices[row]]
            slope += sign * p[i] * np.einsum("ngh,gm->nhm", inner, by_theta)
        force += p[i] * unit
        slope += unit[..., None] * model.T[i]
    turned, over = np.pi * orders * np.conj(d), force[:, 1] / d[:, 1]
    along = slope[:, 1] / d[:, 1, None]
    values = np.stack([np.sum((turned * force).imag, axis=1), over.real, over.imag / omega], axis=1)
    of_energy = np.einsum("nh,nhm->nm", turned, slope).imag
    slopes = np.stack([of_energy, along.real, along.imag / omega[:, None]], axis=1)
    sd = np.sqrt(np.maximum(np.einsum("nqi,ij,nqj->nq", slopes, covariance, slopes), 0.0))
    elements = [model.elements[i] for i in specimen.members]
    ends = tuple(elements[0].along)
    unit_of_motion = "rad" if all(point in model.angles for point in ends) else "m"
    for n, (value, spread) in enumerate(zip(values.tolist(), sd.tolist(), strict=True)):
        yield Cycle(
            tuple(element.name for element in elements),
            ends,
            float(omega[n] / (2 * np.pi)),
            float(abs(d[n, 1])),
            unit_of_motion,
            *(number for pair in zip(value, spread, strict=True) for number in pair),
        )


def cycles_at(
    model: Model, estimate: Estimate, amplitudes: Sequence[float], frequencies_hz: Sequence[float]
) -> tuple[Cycle, ...]:
    """The cycles of all elements in sines of each amplitude (m or rad) at each frequency (Hz)."""
    theta, covariance = _of_theta(model, estimate)
    omega, d = _sines(amplitudes, frequencies_hz)
    return tuple(
        cycle for each in specimens(model) for cycle in cycles_of(model, each, theta, covariance, omega, d)
    )


def _sines(amplitudes: Sequence[float], frequencies_hz: Sequence[float]) -> tuple[Real, Complex]:
    """ω (N,) and harmonics (N, 2) of sines of each amplitude at each frequency."""
    a, f = (part.ravel() for part in np.meshgrid(amplitudes, frequencies_hz))
    return 2 * np.pi * f, np.stack([np.zeros_like(a), a], axis=1).astype(np.complex128)


def _of_theta(model: Model, estimate: Estimate) -> tuple[Real, Real]:
    """Values and covariance of the unknowns of the rig, without calibrations."""
    m = len(model.unknowns)
    return estimate.values[:m], estimate.covariance[:m, :m]


def cycles_of_spectrum(model: Model, estimate: Estimate, spectrum: Spectrum) -> tuple[Cycle, ...]:
    """The cycles of a test stand in the motion of its dwells, or as large and as fast as in its whole records.

    Responses per unit of an input contain no information on a cycle: `cycles_at` gives those of a stated amplitude.
    """
    sized = np.array([isinstance(each, WholeRecord) or not each.per_unit for each in spectrum.stretches])
    if not np.all(sized):
        spectrum = spectrum.select(np.flatnonzero(sized[spectrum.stretch]))
    if not spectrum.lines:
        return ()
    view = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment)
    sign = np.array([[float(estimate.signs.get(channel.name, 1.0)) for channel in spectrum.channels]])
    Y = spectrum.amplitudes / calibration_factors(view, estimate.values[None], sign)[0]
    C = view.direct_q * (view.inputs_alone[:, None] & np.isfinite(Y)[..., None])
    if np.any(np.linalg.matrix_rank(C) < C.shape[-1]):
        return ()
    moved = len(model.displacement_inputs)
    U = (np.linalg.pinv(C) @ np.nan_to_num(Y)[..., None])[..., :moved, 0]
    whole = np.array([isinstance(spectrum.stretches[k], WholeRecord) for k in spectrum.stretch])
    cycles: list[Cycle] = []
    kinds = kind_of(spectrum.experiment)
    for number in np.unique(kinds[~whole]).tolist():
        lines = np.flatnonzero((kinds == number) & ~whole)
        dwells = dwells_of(model, spectrum.select(lines))
        points = np.zeros((len(dwells.omega), int(np.max(dwells.order)) + 1, moved), dtype=np.complex128)
        points[dwells.dwell, dwells.order] = U[lines]
        there = model.standing_in(number)
        theta, covariance = _of_theta(there, estimate)
        for each in specimens(there):
            d = points @ there.D[each.members[0]]
            moves = np.abs(d[:, 1]) > 1e-9 * np.max(np.abs(points), axis=(1, 2))  # rounding
            if np.any(moves):  # those that are stretched at all
                cycles += cycles_of(there, each, theta, covariance, dwells.omega[moves], d[moves])
    if np.any(whole):
        motions = []
        for k in np.unique(spectrum.stretch[whole]):
            at = spectrum.in_time(int(k)).for_squares
            motions.append((spectrum.omega[at.lines], U[at.lines], at.history(U)))
        cycles += _usual(model, estimate, motions)
    return tuple(cycles[:400])  # more dwells are a map, which `Estimate.cycles_at` draws


def cycles_of_records(model: Model, estimate: Estimate, records: Iterable[Record]) -> tuple[Cycle, ...]:
    """The cycles of a stand as large and as fast as in continuous records; none where motion is not displacement."""
    motions: list[tuple[Real, Complex, Real]] = []
    for record in records:
        shown = [_displacement(record, name) for name in model.displacement_inputs]
        history = (
            np.stack([part for part in shown if part is not None], axis=1) if shown else np.zeros((0, 0))
        )
        if history.shape[1] < len(shown):
            return ()
        history = history - np.mean(history, axis=0)
        steps = len(history)
        duration = float(record.time[-1] - record.time[0]) * steps / (steps - 1)
        lines = np.fft.rfft(history * np.hanning(steps)[:, None], axis=0)[1:].astype(np.complex128)
        omega = frozen(2 * np.pi * np.arange(1, len(lines) + 1) / duration, np.float64)
        motions.append((omega, lines, frozen(history, np.float64)))
    return _usual(model, estimate, motions)


def _displacement(record: Record, point: str) -> Real | None:
    """The samples of the first channel that shows this point's displacement alone, SI units."""
    for j, channel in enumerate(record.channels):
        if dict(channel.of) == {point: 1.0} and channel.quantity.value == "displacement":
            return record.values[:, j] / real_factor(channel)
    return None


def _usual(
    model: Model, estimate: Estimate, motions: Sequence[tuple[Real, Complex, Real]]
) -> tuple[Cycle, ...]:
    """The cycles of sines as large and as fast as the motion of records: ω, lines (lines, r), history (samples, r).

    A quarter, half and all of the largest elongation, at frequencies below which 10, 50 and 90 % of the power of its
    rate lie.
    """
    theta, covariance = _of_theta(model, estimate)
    cycles: list[Cycle] = []
    for each in specimens(model):
        row = model.D[each.members[0]]
        A = max((float(np.ptp(history @ row)) / 2 for _, _, history in motions), default=0.0)
        if not A > 0:
            continue
        omega = np.concatenate([omega for omega, _, _ in motions])
        power = np.concatenate([np.abs(omega * (lines @ row)) ** 2 for omega, lines, _ in motions])
        order = np.argsort(omega, kind="stable")
        reached = np.cumsum(power[order])
        at = np.searchsorted(reached, np.array([0.1, 0.5, 0.9]) * reached[-1])
        frequencies = [float(f"{f:.3g}") for f in omega[order][at] / (2 * np.pi)]
        apart = [f for k, f in enumerate(frequencies) if k == 0 or f > 1.05 * frequencies[k - 1]]
        sizes = [float(f"{share * A:.3g}") for share in (0.25, 0.5, 1.0)]
        cycles += cycles_of(model, each, theta, covariance, *_sines(sizes, apart))
    return tuple(cycles)
