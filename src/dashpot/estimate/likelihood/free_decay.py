"""Where a search in free decays begins: with rigs whose modes are those that the motion shows.

The lines of a sampled free decay are those of a state space without input, all that sampling folds back included:
X = C (1 − A/z)⁻¹ b with z = e^{jωh}.  So z^i X is a row of the observability matrix, C Aⁱ, times the states, and a real
polynomial in z.  That is projected out; what is left spans the observability matrix, whose shift is A.  It needs no
start and no order of frequencies, and sees modes in the noise of single lines.  Source: McKelvey, Akçay and Ljung,
"Subspace-based multivariable system identification from frequency response data", IEEE Transactions on Automatic
Control 41 (1996).
"""

from __future__ import annotations

import numpy as np

from dashpot.arrays import Complex, Ints, Real
from dashpot.data.modal_data import ModalData, of_eigenvalues
from dashpot.data.spectrum import Spectrum
from dashpot.data.stretch import WholeRecord
from dashpot.errors import DashpotError
from dashpot.estimate.likelihood.descent import NEAR_END, ROUGH, Effort, Likelihood
from dashpot.estimate.likelihood.local_minima import LocalMinima
from dashpot.estimate.likelihood.thinning import thinned
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.network import Model
from dashpot.model.observation import ObservationModel, small
from dashpot.numerics.levenberg_marquardt import PATIENCE

EACH, FEWER = 80, 12  # lines of each part of the band
BLOCKS = 8  # powers of z for each coordinate, more where fewer channels than that see it
OVERDAMPED = 0.7  # of critical damping, from which on a pole is noise
# What is taken for the uncertainty of modes, which only ranks rigs before the likelihood does.
SD_FREQUENCY, SD_DAMPING, SD_SHAPE = 1e-4, 0.05, 0.01


def moves_freely(model: Model, spectrum: Spectrum) -> bool:
    """Whether all that is seen of a small linear rig is whole records of free motion."""
    if model.inputs or len(model.nonlinear) or not small(model):
        return False
    return all(isinstance(stretch, WholeRecord) and stretch.loads for stretch in spectrum.stretches)


def decay_minima(data: Prepared, effort: Effort) -> LocalMinima:
    """Where rigs with the modes of free decays lead in one repeat, the lowest first; none of other data."""
    view = data.view
    few = thinned(data, EACH)
    rigs = _rigs(few, effort)
    signs = np.ones((len(rigs), len(view.channels)))
    minima = LocalMinima.none(len(view.names), len(view.channels))
    if not len(rigs):
        return minima
    # Many rigs are one: a few lines tell which.
    for each, limit in ((FEWER, PATIENCE), (EACH, ROUGH)):
        likelihood = Likelihood.of(thinned(few, each), effort)
        with np.errstate(all="ignore"):
            ends = likelihood.descend_in(likelihood.exact, rigs, signs, limit, near=NEAR_END)
        minima = LocalMinima.none(*minima.psi.shape[1:], *minima.sign.shape[1:])
        minima = minima.with_ends(ends.x, signs, ends.cost).competing(likelihood.exact.rows)
        rigs, signs = minima.psi, minima.sign
    return minima


def _rigs(data: Prepared, effort: Effort) -> Real:
    """Rigs with the modes that free decays show, (rigs, unknowns); none where channels tell too little of shapes."""
    view = data.view
    none = np.empty((0, len(view.names)))
    calibrated = not view.gains and not view.delays and not np.any(view.flips)
    if not (calibrated and moves_freely(view.model, data.spectrum)):
        return none
    from dashpot.estimate.modal.mode_search import rigs_with  # loads scipy.optimize

    poles, shown = free_modes(data)
    try:
        return (
            rigs_with(view.model, _modal_data(view, poles, shown), seed=effort.seed) if len(poles) else none
        )
    except (DashpotError, np.linalg.LinAlgError):
        return none


def free_modes(data: Prepared) -> tuple[Complex, Complex]:
    """Eigenvalues with Im > 0, (modes,) 1/s, by magnitude, and what channels show of them, (channels, modes).

    No more than the rig has; of the records that are sampled like the first one, in one repeat.
    """
    n, spectrum = data.model.n, data.spectrum
    records = _alike(spectrum)
    channels = len(spectrum.channels)
    lines = sum(len(each) for _, each in records)
    blocks = min(max(BLOCKS * n * n // channels, BLOCKS * n), lines // channels)
    if (blocks - 1) * channels < 2 * n:
        return np.empty(0, dtype=complex), np.empty((channels, 0), dtype=complex)
    noise = np.sqrt(np.median(np.diagonal(data.covariance[0], axis1=-2, axis2=-1).real, axis=0))
    size = np.sqrt(np.mean(np.abs(spectrum.amplitudes[0]) ** 2, axis=0))
    unit = np.where(noise > 0, noise, np.where(size > 0, size, 1.0))
    step = records[0][0].step_s
    left = [
        _states_seen(spectrum.amplitudes[0, each] / unit, np.exp(1j * spectrum.omega[each] * step), blocks)
        for _, each in records
    ]
    _, _, rows = np.linalg.svd(np.linalg.qr(np.concatenate(left), mode="r"))
    observability = rows[: 2 * n].T
    A = np.linalg.lstsq(observability[:-channels], observability[channels:], rcond=None)[0]
    z, states = np.linalg.eig(A)
    with np.errstate(all="ignore"):
        poles = np.log(z.astype(complex)) / step
    swings = (poles.imag > 0) & np.isfinite(poles) & (np.abs(poles.real) < OVERDAMPED * np.abs(poles))
    poles, states = poles[swings], states[:, swings]
    order = np.argsort(np.abs(poles))
    return poles[order], (unit[:, None] * (observability[:channels] @ states))[:, order]


def _alike(spectrum: Spectrum) -> list[tuple[WholeRecord, Ints]]:
    """The records that are sampled like the first one, with the lines in which all channels are there."""
    whole = np.all(np.isfinite(spectrum.amplitudes[0]), axis=-1)
    records = [
        (value, np.flatnonzero((spectrum.stretch == number) & whole))
        for number, value in enumerate(spectrum.stretches)
        if isinstance(value, WholeRecord)
    ]
    step = records[0][0].step_s
    return [(value, lines) for value, lines in records if abs(value.step_s / step - 1) < 1e-9]


def _states_seen(amplitudes: Complex, z: Complex, blocks: int) -> Real:
    """z^i X of one record, (2 lines, blocks · channels), without the polynomials that its ends add."""
    powers = z[:, None] ** np.arange(blocks)
    products = (powers[:, :, None] * amplitudes[:, None, :]).reshape(len(z), -1)
    moved = np.concatenate([products.real, products.imag])
    basis, _ = np.linalg.qr(np.concatenate([powers[:, 1:].real, powers[:, 1:].imag]))
    left: Real = moved - basis @ (basis.T @ moved)
    return left


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
