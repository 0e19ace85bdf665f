"""What can be found of a rig with nonlinear elements, by the rank of the slopes of its settled motions (THEORY §9).

There is no exact rank: a nonlinear law has no finite field.  Slopes come from the harmonic balance at nominal values,
at many frequencies and two sizes of the drive, or at the lines and inputs of data; columns are scaled by the unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dashpot.arrays import Complex, Real
from dashpot.channel import Channel
from dashpot.check.identifiability import Structure
from dashpot.check.structure import Deficiency
from dashpot.data.spectrum import SettledDwell, Spectrum
from dashpot.errors import DashpotError, IdentifiabilityError, ModelError
from dashpot.estimate.nonlinear.objective import NonlinearPart, WarmStart, evaluate, nonlinear_part
from dashpot.estimate.preparation.prepared import prepare
from dashpot.model.modes import typical_sizes
from dashpot.model.network import Model
from dashpot.model.nonlinear.alternating import alternate
from dashpot.model.nonlinear.harmonics import complex_of
from dashpot.model.observation import measures_input, observation_model

FREQUENCIES = 12  # of the drive, around the rig's own
SIZES = (1.0, 0.4)  # of the drive
ORDERS = (1, 2, 3)  # harmonics that are looked at
NOMINAL = 1e-3  # amplitude of displacement inputs, m
STRENGTH = 0.2  # of a nonlinear force over the linear one, where nothing tells
BLIND = 1e-7  # singular value over the largest below which a combination shows nothing
SHARE = 1e-3  # part of a direction from which an unknown belongs to it
GOLDEN = (np.sqrt(5) - 1) / 2


def nonlinear_structure(
    model: Model, channels: Sequence[Channel], spectrum: Spectrum | None = None
) -> Structure:
    """Whether the unknowns can be found from the channels; with `spectrum` from its lines and inputs.

    Raises IdentifiabilityError where no settled motion, or no finite one, is found at the nominal values, DataError
    where an input is not measured.
    """
    if not channels:
        raise ModelError("no channels are listed", cure="say in [channels] of the rig file what is measured")
    given = _settled_test(model, channels) if spectrum is None else spectrum
    data = prepare(model, given)
    view = data.view
    part = nonlinear_part(data, np.nan_to_num(given.amplitudes)[None], None)
    with np.errstate(all="ignore"):  # laws may overflow, which is refused below
        psi = np.concatenate([_nominal(model, part), view.nominal_calibrations])
        J = _slopes(model, given, part, psi)
    scale = np.where(psi == 0, 1.0, psi)
    rows = np.concatenate([J.real, J.imag]) * scale
    if not np.all(np.isfinite(rows)):
        raise IdentifiabilityError(
            "a law is no finite number in the motion at the nominal values of the rig",
            cure="give the unknowns guesses, or write a law that is finite there",
        )
    known = np.diag(np.where(view.prior_precision > 0, np.linalg.norm(rows), 0.0))
    _, s, Vh = np.linalg.svd(np.concatenate([rows, known]), full_matrices=False)
    rank = int(np.sum(s > BLIND * s[0])) if s[0] > 0 else 0
    deficiencies = tuple(_deficiency(view.names, vector, scale) for vector in Vh[rank:])
    return Structure(view.names, view.units, rank, psi, deficiencies)


def _deficiency(names: Sequence[str], vector: Real, scale: Real) -> Deficiency:
    """One direction that no channel shows; an unknown alone is one that has no effect at all."""
    part = np.abs(vector) > SHARE * np.max(np.abs(vector))
    chosen = tuple(name for name, there in zip(names, part, strict=True) if there)
    direction = np.where(part, vector, 0.0) * scale
    return Deficiency("mixed", chosen, direction[None], np.zeros((0, len(chosen))))


def _settled_test(model: Model, channels: Sequence[Channel]) -> Spectrum:
    """Dwells around the rig's own frequencies, driven in two sizes; only their inputs mean something.

    A force input is as large as moves the typical spring by NOMINAL.
    """
    sizes, rate = typical_sizes(model)
    force = next(size for kind, size in sizes.items() if kind.value == "spring") * NOMINAL
    base = rate / (2 * np.pi) * np.geomspace(0.3, 2.0, FREQUENCIES)
    lines, dwell, amplitude = [], [], []
    for number, (f, size) in enumerate((f, size) for size in SIZES for f in base):
        for order in ORDERS:
            lines.append(order * f)
            dwell.append(number)
            amplitude.append(size if order == 1 else 0.0)
    omega = 2 * np.pi * np.array(lines)
    q = np.concatenate(
        [np.full(len(model.displacement_inputs), NOMINAL), np.full(len(model.force_inputs), force)]
    )
    view = observation_model(model, channels, omega)
    shown: Complex = np.einsum("lcq,lq->lc", view.direct_q, np.array(amplitude)[:, None] * q)
    moving = [not measures_input(model, channel) for channel in channels]
    shown[:, moving] = 1.0
    count, width = len(lines), len(channels)
    noise = np.array([1e-3 if moves else 0.0 for moves in moving])
    return Spectrum(
        tuple(channels), np.array(lines), shown,
        np.broadcast_to(np.diag(noise).astype(np.complex128), (count, width, width)), np.ones(count, dtype=int),
        np.full(count, np.inf), ("given",) * count, np.zeros(count, dtype=int), stretch=np.array(dwell),
        stretches=tuple(SettledDwell(float(f)) for _ in SIZES for f in base),
    )  # fmt: skip


def _nominal(model: Model, part: NonlinearPart) -> Real:
    """θ near priors and guesses, elsewhere typical values, nonlinear forces a share of the linear ones."""
    sizes, rate = typical_sizes(model)
    elongation = float(np.max(np.abs(part.q)[..., : model.D.shape[1]], initial=0.0))
    elongation = elongation if elongation > 0 else NOMINAL
    stiffness = next(size for kind, size in sizes.items() if kind.value == "spring")
    kinds = {element.name: element for element in model.elements}
    constants = {f"{e.name}.{c.name}": (e, c) for e, c in model.constants}
    values = []
    for unknown in model.unknowns:
        if unknown.nominal:
            values.append(unknown.nominal)
        elif unknown.name in constants:
            element, constant = constants[unknown.name]
            assert element.force_law is not None
            metre, second = element.force_law.exponents[1].get(constant.name, (0.0, 0.0))
            values.append(0.3 * elongation ** (metre + second) * (elongation * rate) ** -second)
        elif kinds[unknown.name].force_law is not None:
            values.append(np.nan)
        else:
            values.append(sizes[kinds[unknown.name].kind])
    apart = 0.9 + 0.2 * np.modf(np.arange(1, len(values) + 1) * GOLDEN)[0]
    theta = np.array(values) * apart
    return _with_strengths(model, theta, elongation, rate, STRENGTH * stiffness * elongation)


def _with_strengths(model: Model, theta: Real, elongation: float, rate: float, force: float) -> Real:
    """Open parameters of nonlinear elements such that they pull with `force` at that elongation."""
    filled = np.where(np.isfinite(theta), theta, 1.0)
    q = np.zeros((1, len(model.nonlinear), 3))
    q[0, :, 1] = elongation
    a = alternate(model, model.inner_constants(filled)[None], np.array([rate]), q, 256, slopes=False).a
    unit = np.max(np.abs(complex_of(a))[0], axis=-1)
    for row, index in enumerate(model.nonlinear):
        for j in np.flatnonzero(model.T[index]):
            if not np.isfinite(theta[j]):
                filled[j] = force / (unit[row] if unit[row] > 0 else 1.0)
    return filled


def _slopes(model: Model, spectrum: Spectrum, part: NonlinearPart, psi: Real) -> Complex:
    """Slopes of the moving channels along ψ, (rows, M), each channel of size 1."""
    view = observation_model(model, spectrum.channels, spectrum.omega)
    fresh = replace(part, start=None, warm=WarmStart())
    at = evaluate(view, fresh, psi[None], np.ones((1, len(view.channels))), part.q[:1], None, False)
    lost = ~at.converged[part.dwells.dwell]
    if np.all(lost):
        raise IdentifiabilityError(
            "no settled motion is found at the nominal values of the rig", cure="give the unknowns guesses"
        )
    J, y = at.J[0], at.predicted[0]
    there = np.isfinite(spectrum.amplitudes) & ~lost[:, None]
    moving = np.array([not measures_input(model, channel) for channel in spectrum.channels])
    size = np.sqrt(np.mean(np.abs(np.where(there, y, 0.0)) ** 2, axis=0))
    scaled = J / np.where(size > 0, size, 1.0)[:, None]
    return scaled[:, moving][there[:, moving]]


def blind_laws(model: Model, spectrum: Spectrum) -> Structure | None:
    """The structure where unknowns of nonlinear elements, alone or with others, leave no trace; None where all do.

    Such data would keep an iteration busy for nothing.
    """
    laws = {element.name for element in model.elements if element.force_law is not None}
    laws |= {f"{element.name}.{constant.name}" for element, constant in model.constants}
    try:
        structure = nonlinear_structure(model, spectrum.channels, spectrum)
    except DashpotError:  # the nominal motion says nothing; the search may find its own
        return None
    blind = tuple(deficiency for deficiency in structure.deficiencies if laws.intersection(deficiency.names))
    return replace(structure, deficiencies=blind) if blind else None
