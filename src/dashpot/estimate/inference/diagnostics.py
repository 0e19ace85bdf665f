"""Notices that go with an estimate: what it lacks, and what in the data or in the rig file is probably a slip.

Nothing here changes a number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtrc, fdtrc, gammaincc

from dashpot.arrays import Bools, Complex, Real
from dashpot.channel import Quantity
from dashpot.data.noise import together
from dashpot.data.spectrum import Spectrum, WholeRecord
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.likelihood.global_search import moves_freely
from dashpot.estimate.likelihood.objective import measured
from dashpot.estimate.likelihood.record_passes import EndsFitted, RecordPieces
from dashpot.estimate.likelihood.record_sums import ends_fitted, information_under
from dashpot.estimate.method import HeldBounds, Method, Solution
from dashpot.estimate.preparation import Prepared
from dashpot.estimate.result import Fit
from dashpot.io.words import joined, with_values
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Kind
from dashpot.model.matrix_elements import free_entries, free_names
from dashpot.model.modes import eigenmodes
from dashpot.model.network import Model
from dashpot.model.observation import is_direct, measures_input
from dashpot.notices import Notice
from dashpot.numerics.small_systems import scaled_inverse, standard_deviations
from dashpot.unknowns import Unknown, pull

# What whole records lack: length, lines, or inputs that have anything to do with the motion.
#
# A dead sensor, another clock, a band in which nothing was driven, or the free decay of a rig whose input
# rests: the noise of such an input explains nothing, and a fit that takes it for the drive ends anywhere.


def of_records(model: Model, theta: Real, covariance: Real, spectrum: Spectrum) -> list[Notice]:
    """What is to be said of an estimate that whole records have given (no batch axes).

    theta (m,) or longer with its covariance by the noise alone.
    """
    if not spectrum.records:
        return []
    notices = []
    frequency = eigenmodes(model, model.parameters(theta[: len(model.unknowns)])).frequency_hz
    records = [value for value in spectrum.stretches if isinstance(value, WholeRecord)]
    longest, slowest = (
        max(value.duration_s for value in records),
        float(np.min(frequency[frequency > 0], initial=np.inf)),
    )
    if len(records) == len(spectrum.stretches) and longest * slowest < 1:
        text = (
            f"the longest record ({longest:.4g} s) is shorter than one period of the slowest mode "
            f"({1 / slowest:.4g} s), so its transient is poorly separated from the forced motion; "
            "record for longer"
        )
        notices.append(Notice("short_record", text))
    notices += modes_outside(model, theta, covariance, frequency, spectrum)
    few = few_lines(model, spectrum)
    if few is not None:
        notices.append(Notice("few_lines", f"{few}: widen the band or record for longer"))
    return notices + unrelated_inputs(model, spectrum)


def modes_outside(
    model: Model, theta: Real, covariance: Real, frequency: Real, spectrum: Spectrum
) -> list[Notice]:
    """A warning where the band holds some modes of the rig only, and leaves unknowns open for that."""
    low, high = float(np.min(spectrum.frequency_hz)), float(np.max(spectrum.frequency_hz))
    moving = frequency[frequency > 0]
    inside = int(np.sum((moving >= low) & (moving <= high)))
    count = len(model.unknowns)
    sd = np.sqrt(np.diagonal(covariance)[:count])
    # Open by the noise alone: known to no better than a tenth
    open_ones = [u.name for u, s, v in zip(model.unknowns, sd, theta, strict=False) if not s < 0.1 * abs(v)]
    if inside == len(moving) or not open_ones:
        return []
    text = (
        f"the band from {low:.3g} to {high:.3g} Hz contains {inside} of the rig's {len(moving)} modes, "
        f"too few to determine {joined(open_ones)}: widen the band, or state values"
    )
    return [Notice("modes_outside", text, tuple(open_ones))]


def few_lines(model: Model, spectrum: Spectrum) -> str | None:
    """What to say where the lines of whole records carry hardly more than the terms of their ends; else None."""
    records = [value for value in spectrum.stretches if isinstance(value, WholeRecord)]
    if not records or len(records) < len(spectrum.stretches):
        return None
    outputs = int(np.sum([not measures_input(model, channel) for channel in spectrum.channels]))
    lines = spectrum.lines
    fitted = outputs if model.inputs else 0  # free motion alone is known between the samples as well
    terms = sum(2 * model.n * value.loads + value.polynomial * fitted for value in records)
    if 2 * lines * outputs >= 4 * (terms + len(model.unknowns)):  # with fewer, little is left for the rig
        return None
    whose = "records'" if len(records) > 1 else "record's"
    return (
        f"only {lines} frequency lines for {terms} transient terms of the {whose} ends and "
        f"{len(model.unknowns)} unknowns"
    )


def unrelated_inputs(model: Model, spectrum: Spectrum) -> list[Notice]:
    """A warning where no output of any whole record goes with the inputs: F tests in bins of lines, taken together.

    In each bin of lines the outputs are fitted by a straight transient alone, and by the inputs times a constant
    response as well: inputs of white noise then pass as often as stated, whatever the outputs are.
    """
    inputs = np.array([measures_input(model, channel) for channel in spectrum.channels], dtype=bool)
    if not np.any(inputs) or np.all(inputs):
        return []
    amplitudes = spectrum.amplitudes[(0,) * len(spectrum.batch)]
    bins = [
        p
        for number, value in enumerate(spectrum.stretches)
        if isinstance(value, WholeRecord)
        for p in _p_values(amplitudes[spectrum.stretch == number], inputs)
    ]
    if not bins or min(map(together, np.transpose(bins))) * np.sum(~inputs) <= 0.01:  # a relation shows
        return []
    names = [channel.name for channel, given in zip(spectrum.channels, inputs, strict=True) if given]
    low, high = float(np.min(spectrum.frequency_hz)), float(np.max(spectrum.frequency_hz))
    text = (
        f"no channel responds to {joined(names)} ({low:.3g} to {high:.3g} Hz), so the values mean "
        "nothing: check the sensor, its clock and the band; for a free decay replace the input by "
        '"ground"'
    )
    return [Notice("unrelated_inputs", text, tuple(names))]


def _p_values(X: Complex, inputs: Bools) -> list[Real]:
    """p-values of the F tests in each bin of one record, (outputs,) each; X (lines, channels)."""
    columns = 2 + int(np.sum(inputs))
    each = max(12, columns + 4)  # lines in which a response is nearly constant and a transient straight
    starts = np.arange(0, len(X) - each + 1, each)
    if not len(starts) or not np.all(np.isfinite(X)):
        return []
    if len(starts) > 400:
        # Those in which the inputs are strongest: a few tones are in few bins of a long record, and the others
        # contain no information on them.
        power = np.abs(X[:, inputs]) ** 2
        total = np.sum(power / np.maximum(np.mean(power, axis=0), np.finfo(float).tiny), axis=1)
        starts = starts[np.sort(np.argsort(np.add.reduceat(total, starts), kind="stable")[-400:])]
    part = X[starts[:, None] + np.arange(each)]
    run = np.linspace(-1, 1, each)[:, None]
    transient = np.broadcast_to(np.concatenate([np.ones((each, 1)), run], axis=1), (len(part), each, 2))
    driven = np.concatenate([transient, part[..., inputs]], axis=-1)
    without, left = _left(transient, part[..., ~inputs]), _left(driven, part[..., ~inputs])
    more, free = columns - 2, each - columns
    with np.errstate(divide="ignore", invalid="ignore"):
        F = np.where(left > 0, (without - left) / more / (left / free), np.inf)
    return list(fdtrc(2 * more, 2 * free, F))


def _left(columns: Complex, Y: Complex) -> Real:
    """Sums of squares of what columns (bins, lines, columns) leave of Y (bins, lines, outputs), (bins, outputs)."""
    size = np.linalg.norm(columns, axis=-2, keepdims=True)
    scaled = columns / np.maximum(size, np.finfo(float).tiny)
    rounding = scaled.shape[-2] * np.finfo(float).eps
    shown = scaled @ (np.linalg.pinv(scaled, rcond=rounding) @ Y)
    return np.sum(np.abs(Y - shown) ** 2, axis=-2)


# Modes that the free motion of a record does not show: values that rest on one of them rest on chance.
#
# Without inputs the boundary loads of a record make all of its motion (THEORY §8). Of a symmetric pencil
# the part of mode λ, φ in the response D(s)⁻¹ (a + s b) is in proportion to φᵀ (a + λ b), whose covariance
# follows from that of the loads. Where no record shows it the likelihood takes the highest noise in the
# band for the mode, and states a deviation as if that were one.


MODES_UNSEEN = "modes_unseen"


@dataclass(frozen=True)
class _FreeMode:
    """A mode in the free motion: its frequency, Hz, its part q (records, 2), and how that follows from the loads,
    (records, 2, columns), and varies, (records, 2, 2)."""

    frequency_hz: float
    part: Real
    by_columns: Real
    covariance: Real


def modes_unseen(data: Prepared, solution: Solution) -> tuple[Notice, ...]:
    """That modes found in free motion (one repeat of a linear rig) may be noise, and which unknowns rest on them."""
    spectrum, view = data.spectrum, data.view
    model = view.model
    if not (moves_freely(model, spectrum) and len(solution.theta) == 1):
        return ()
    pieces, sign = measured(data).record_pieces, spectrum.signs(solution.signs)
    fit = ends_fitted(pieces, solution.theta, sign)
    low, high = np.min(spectrum.frequency_hz), np.max(spectrum.frequency_hz)
    unseen = []
    for mode in _free_modes(pieces, fit, solution.theta[0]):
        if not low <= mode.frequency_hz <= high:
            continue
        inverse = np.linalg.pinv(mode.covariance, hermitian=True)
        square = np.einsum("ri,rij,rj->", mode.part, inverse, mode.part)
        # p-value of the highest that noise shows anywhere in so many lines, in whatever shape suits it best
        p = spectrum.lines * float(gammaincc(len(view.channels) * len(mode.part), square / 2))
        if p > 1e-3:
            unseen.append(mode)
    if not unseen:
        return ()
    # The likeliest loads under which these modes are still
    by = np.concatenate([mode.by_columns for mode in unseen], axis=1)
    part = np.concatenate([mode.part for mode in unseen], axis=1)
    across = fit.covariance[0] @ np.swapaxes(by, -1, -2)
    z = fit.z[0] - (across @ np.linalg.pinv(by @ across, hermitian=True) @ part[..., None])[..., 0]
    sd, sd_without = (
        standard_deviations(
            scaled_inverse(
                information_under(pieces, solution.theta, sign, ends) + np.diag(view.prior_precision)
            )
        )[0]
        for ends in (fit, replace(fit, z=z[None]))
    )
    rests = ~(sd_without < 1.05 * sd)  # by a twentieth more: a value rests on the modes
    names = tuple(name for name, resting in zip(model.unknown_names, rests, strict=False) if resting)
    if not names:
        return ()
    text = (
        f"the free decay does not show the mode{'s' if len(unseen) > 1 else ''} at "
        f"{joined(f'{mode.frequency_hz:.4g}' for mode in unseen)} Hz above the noise, and "
        f"{joined(names)} depend{'s' if len(names) == 1 else ''} on "
        f"{'them' if len(unseen) > 1 else 'it'}: the intervals cannot be trusted"
    )
    return (Notice(MODES_UNSEEN, text, names),)


def _free_modes(pieces: RecordPieces, fit: EndsFitted, theta: Real) -> list[_FreeMode]:
    """All modes of a rig with the values θ but those that only drift."""
    model, n = pieces.ends.rig.model, pieces.ends.n
    of_rig = eigenmodes(model, model.parameters(theta[: len(model.unknowns)]))
    by_columns = np.zeros((*fit.z.shape[1:2], 2, fit.z.shape[-1]))
    free_modes = []
    for eigenvalue, shape, hz in zip(of_rig.eigenvalues, of_rig.shapes, of_rig.frequency_hz, strict=True):
        if hz == 0:
            continue
        by_impulse = np.broadcast_to(shape, (len(by_columns), n))
        by_doublet = eigenvalue / pieces.ends.highest[:, None] * shape
        by_loads = np.concatenate([by_impulse, by_doublet], axis=1)
        by = by_columns.copy()
        by[:, :, : 2 * n] = np.stack([by_loads.real, by_loads.imag], axis=1)
        part = np.einsum("rij,rj->ri", by, fit.z[0])
        free_modes.append(_FreeMode(float(hz), part, by, by @ fit.covariance[0] @ np.swapaxes(by, -1, -2)))
    return free_modes


ZERO = 1.96  # standard deviations within which a negative part may be none


def dead_channels(model: Model, spectrum: Spectrum) -> list[str]:
    """Channels of a moving point that show nothing at any line, though others of their quantity do."""
    sizes = np.nan_to_num(np.abs(spectrum.amplitudes)).max(axis=tuple(range(spectrum.amplitudes.ndim - 1)))
    largest: dict[Quantity, float] = {}
    for channel, size in zip(spectrum.channels, sizes.tolist(), strict=True):
        largest[channel.quantity] = max(largest.get(channel.quantity, 0.0), size)
    return [
        channel.name
        for channel, size in zip(spectrum.channels, sizes.tolist(), strict=True)
        if size <= 1e-12 * largest[channel.quantity]  # rounding
        and channel.quantity is not Quantity.FORCE
        and not set(channel.of).isdisjoint(model.coordinates)
    ]


def require_motion(model: Model, spectrum: Spectrum) -> None:
    """Raises IdentifiabilityError if no channel of a moving point shows any: a rig of any size fits that."""
    dead = dead_channels(model, spectrum)
    if dead and len(dead) == sum(not measures_input(model, channel) for channel in spectrum.channels):
        raise _nothing_moves(f"the data do not determine {', '.join(model.unknown_names)}", dead)


def _nothing_moves(what: str, dead: Sequence[str]) -> IdentifiabilityError:
    return IdentifiabilityError(
        f"{what}, because {joined(dead)} show{'s' if len(dead) == 1 else ''} no motion at any line",
        cure="check that the sensor is connected, or leave the channel out of the rig file",
    )


def duplicated_lines(spectrum: Spectrum) -> list[Notice]:
    """A warning of lines whose noisy amplitudes are those of another line to the last digit."""
    if len(set(spectrum.frequency_hz.tolist())) == spectrum.lines or not spectrum.covariance.any():
        return []
    # Lines of a batch that repeat each other do so in its first repeat.
    first = np.nan_to_num(spectrum.amplitudes[(0,) * len(spectrum.batch)])
    if len({(f, *row) for f, row in zip(spectrum.frequency_hz.tolist(), first.tolist(), strict=True)}) == len(
        first
    ):
        return []
    Y = np.moveaxis(np.nan_to_num(spectrum.amplitudes), -2, 0).reshape(spectrum.lines, -1)
    rows = np.concatenate([np.asarray(spectrum.omega)[:, None], Y.real, Y.imag], axis=1)
    rows = rows[np.any(Y != 0, axis=1)]
    more = len(rows) - len(np.unique(rows, axis=0))
    if not more:
        return []
    text = (
        f"{more} of {spectrum.lines} lines repeat another line to the last digit but count as "
        "independent measurements; if the same data were given twice, the intervals are too small"
    )
    return [Notice("duplicated_lines", text)]


def prior_conflict(
    unknowns: Sequence[Unknown], values: Real, noise_covariance: Real, fit: Fit
) -> list[Notice]:
    """Warnings of what is stated with an sd and put elsewhere by the data, left alone; the values count the statement.

    values (M,), noise_covariance (M, M).
    """
    notices = []
    for unknown, value, variance in zip(unknowns, values, np.diagonal(noise_covariance), strict=True):
        name, unit, stated, sd = unknown.name, unknown.unit, unknown.prior, unknown.sd
        if stated is None or sd is None:
            continue
        apart = float(pull(value, variance, stated, sd, fit.tested))
        # 3.0: standard deviations beyond which a statement and the data contradict each other
        if not abs(apart) > 3.0:
            continue
        alone = stated + apart**2 * sd**2 / (value - stated)
        text = (
            f"{name} is stated as {stated:.4g} ± {sd:.2g}{'' if unit == '1' else f' {unit}'}, but the "
            f"data alone give {alone:.4g}, {abs(apart):.2g} standard deviations away: check the stated "
            "value, the data and the model"
        )
        notices.append(Notice("prior_conflict", text, (name,)))
    return notices


def reversed_phase(model: Model, theta: Real, noise_covariance: Real) -> list[Notice]:
    """A hint where every damper comes out negative beyond doubt: phases that count the other way do that.

    theta (m,), noise_covariance (m, m).
    """
    if not (theta < 0).any():
        return []
    dissipative = {element.name for element in model.elements if element.law.dissipative}
    dampers = [j for j, unknown in enumerate(model.unknowns) if unknown.name in dissipative]
    # Beyond four standard deviations a value is negative without doubt.
    beyond = theta < -4.0 * np.sqrt(np.diagonal(noise_covariance))
    if not dampers or not np.all(beyond[dampers]):
        return []
    if np.all(beyond) and len(beyond) > len(dampers):  # what drives masses and springs counts backwards
        return []
    text = (
        "all unknown dampers came out negative: the phases may have the opposite sign; dashpot uses "
        "x(t) = Re(X e^{jωt}), so for data with e^(−jωt) change the sign of the imaginary parts"
    )
    return [Notice("reversed_phase", text, tuple(model.unknowns[j].name for j in dampers))]


def of_estimate(model: Model, theta: Real, covariance: Real, noise: Real, fit: Fit) -> list[Notice]:
    """What one estimate and its fit show; `noise` is the covariance that the sensors' noise alone gives.

    theta (m,), covariance and noise (m, m).
    """
    notices = list[Notice]()
    if not fit.known_noise:
        text = (
            "the noise is not given: it is assumed proportional to each amplitude and its size is "
            "estimated from the residuals"
        )
        notices.append(Notice("unknown_noise", text))
    elif bool(fit.rejected):
        text = (
            f"the model does not fit: residuals are {float(fit.misfit):.3g} times the sensor noise (χ² "
            f"{float(fit.chi2):.4g} with {fit.dof} degrees of freedom); intervals are widened by at "
            "least that factor"
        )
        notices.append(Notice("model_misfit", text))
    notices += wrong_signs(model, theta, noise)
    lower, upper = model.bounds
    for name, value, low, high in zip(model.unknown_names, theta, lower, upper, strict=False):
        if value < low or value > high:
            text = f"{name} is outside its bounds; only the method ml enforces bounds"
            notices.append(Notice("beyond_bound", text, (name,)))
    return notices + reversed_phase(model, theta, noise)


def of_data(model: Model, spectrum: Spectrum) -> list[Notice]:
    """What the data show, whatever was found in them."""
    notices, coloured = list[Notice](), spectrum.noise.count("blocks")
    # The tests of whiteness failed at more lines than the 5 % of white noise explain.
    if coloured and not bdtrc(coloured - 1, spectrum.lines, 0.05) > 0.05 * (1 + 1e-9):
        text = (
            f"the noise is not white at {coloured} of {spectrum.lines} frequencies; it was measured "
            "next to each, and the intervals account for it"
        )
        notices.append(Notice("coloured_noise", text))
    # Inputs that some lines measure and others leave empty are unknown there, which costs precision.
    for name in () if spectrum.complete else (*model.displacement_inputs, *model.force_inputs):
        direct = [set(channel.of) == {name} and is_direct(model, channel) for channel in spectrum.channels]
        at = np.any(spectrum.present[:, direct], axis=-1)
        if np.any(at) and not np.all(at):
            text = (
                f"the input {name} is not measured at {np.sum(~at)} of {len(at)} lines; it is treated "
                "as unknown there, which widens the intervals. If it was at rest, enter 0"
            )
            notices.append(Notice("input_not_measured", text, (name,)))
    return notices + duplicated_lines(spectrum)


def nonlinear_names(model: Model) -> frozenset[str]:
    """Unknowns of nonlinear elements, whose parameters and constants may have any sign."""
    names = {e.name for e in model.elements if e.force_law is not None}
    return frozenset(names | {f"{e.name}.{c.name}" for e, c in model.constants})


def of_one_sign(model: Model) -> Bools:
    """Unknowns of the rig that cannot be negative: not entries of free matrices, nor of nonlinear laws; (unknowns,)."""
    exempt = free_names(model) | nonlinear_names(model)
    return np.array([name not in exempt for name in model.unknown_names], dtype=bool)


def wrong_signs(model: Model, theta: Real, noise_covariance: Real) -> list[Notice]:
    """Warnings of negative parts, and of free matrices that are not definite.

    theta (m,), noise_covariance (m, m): an interval that a misfit has widened excuses no sign.
    """
    free = free_names(model)
    if not free and not (theta < 0).any():
        return []
    any_sign = nonlinear_names(model)
    sd = standard_deviations(noise_covariance)
    largest: dict[Kind, float] = {}  # positive part of each kind
    for element, value in zip(
        model.elements, model.parameters(theta[: len(model.unknowns)]).tolist(), strict=True
    ):
        largest[element.kind] = max(largest.get(element.kind, 0.0), value)
    of_kind = {element.name: largest[element.kind] for element in model.elements}
    notices = []
    for j, (unknown, value) in enumerate(zip(model.unknowns, theta, strict=False)):
        if value < 0 and unknown.name not in free and unknown.name not in any_sign:
            within = value > -ZERO * sd[j]
            below = f"{-value / sd[j]:.2g} standard deviations of the noise below 0"
            why = "consistent with zero" if within else f"{below}; check the model and the data"
            if within and -value > (of_kind.get(unknown.name) or np.inf):
                why = f"it is poorly determined (± {sd[j]:.2g} {unknown.unit})"
            text = f"{unknown.name} came out negative ({value:.4g} {unknown.unit}): {why}"
            notices.append(Notice("negative_but_zero" if within else "negative", text, (unknown.name,)))
    if not free:
        return notices
    parts = matrices(model, model.parameters(theta[: len(model.unknowns)]))
    for letter in free_entries(model):
        values = np.linalg.eigvalsh(getattr(parts, letter))
        if values[0] < -1e-9 * values[-1]:
            text = (
                f"{letter} is not positive definite (eigenvalues {values[0]:.3g} to {values[-1]:.3g}); "
                "--method oiv+ finds the most likely matrices that are"
            )
            notices.append(Notice("not_definite", text, (letter,)))
    return notices


def held(names: tuple[str, ...], theta: Real, bounds: HeldBounds) -> list[Notice]:
    """Warnings of unknowns that lie at a bound; one repeat.  theta (m,)."""
    at = (theta <= bounds.lower) | (theta >= bounds.upper)
    return [
        Notice(
            "at_bound",
            f"{name} is at its bound; without the bound the best fit is {float(free):.4g}",
            (name,),
        )
        for name, bound, free in zip(names, at, bounds.free[0], strict=True)
        if bound
    ]


def bias(names: tuple[str, ...], theta: Real, best: Real, covariance: Real, method: Method) -> list[Notice]:
    """A warning where an estimate lies further from the most likely one than its spread explains (Hausman 1978).

    theta and best (m,), covariance (m, m).
    """
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        away = np.where(sd > 0, np.abs(theta - best) / sd, 0.0)
    worst = int(np.argmax(np.nan_to_num(away)))
    if not away[worst] > 3.0:
        return []
    text = (
        f"{method.name} is biased by noise in these data: {names[worst]} is {away[worst]:.3g} standard "
        "deviations from the maximum-likelihood value; use oiv"
    )
    return [Notice("biased", text, (names[worst],))]


def require_determined(
    names: tuple[str, ...],
    theta: Real,
    covariance: Real,
    dead_channels: Callable[[], Sequence[str]] = tuple,
    few_lines: Callable[[], str | None] = lambda: None,
    traces: Callable[[], None] = lambda: None,
) -> None:
    """Raises IdentifiabilityError, which names `dead_channels` or `few_lines`, where an unknown has no interval.

    theta (m,), covariance (m, m); traces: raises the error with what leaves no trace, where that can be told.
    """
    variance = covariance.diagonal()
    if np.isfinite(theta).all() and np.isfinite(variance).all() and (variance >= 0).all():
        return
    dead, few = dead_channels(), few_lines()
    lost = [name for name, v in zip(names, variance, strict=True) if not np.isfinite(v)]
    what = f"the data do not determine {', '.join(lost) if lost else 'the unknowns'}"
    if dead:
        raise _nothing_moves(what, dead)
    if few is not None:
        raise IdentifiabilityError(f"{what}: {few}", cure="widen the band, or record for longer")
    traces()
    raise IdentifiabilityError(
        what,
        cure=(
            "state a value, add frequencies, or run `dashpot check` to see which combinations can be found"
        ),
    )


# Unknowns that leave no trace, told by the information; and laws of nonlinear elements that the data do not
# show.


UNSEEN_LAW = "law_not_seen"  # code of a notice


# 1e-13 of an information matrix with ones on its diagonal
def require_traces(model: Model, names: Sequence[str], information: Real, least: float = 1e-13) -> None:
    """Raises IdentifiabilityError that names laws or combinations of unknowns that leave no trace.

    names: the first unknowns of information (M, M); least: eigenvalue, of the matrix with ones on its diagonal, below
    which it tells nothing.
    """
    if not np.all(np.isfinite(information)):
        return
    diagonal = np.abs(np.diagonal(information))
    nonlinear = nonlinear_names(model)
    silent = [name for name, told in zip(names, diagonal, strict=False) if told == 0 and name in nonlinear]
    if silent:
        raise IdentifiabilityError(
            f"the data contain no information on {joined(silent)}: the element never moves far enough "
            "for its law to show",
            cure=(
                f"increase the drive, state a value for {'it' if len(silent) == 1 else 'them'}, or "
                "remove the element"
            ),
        )
    scale = np.where(diagonal > 0, np.sqrt(diagonal), 1.0)
    scaled = information / np.outer(scale, scale) + np.diag(1.0 * (diagonal == 0))
    values, vectors = np.linalg.eigh(scaled)
    if not values[0] < least:
        return
    kept = list(range(len(scaled)))  # the least group of those that can change together without a trace
    for j in np.argsort(np.abs(vectors[:, 0]), kind="stable").tolist():
        rest = [i for i in kept if i != j]
        if rest and np.linalg.eigvalsh(scaled[np.ix_(rest, rest)])[0] < least:
            kept = rest
    together = [name for i, name in enumerate(names) if i in kept]
    if len(together) > 1:
        raise IdentifiabilityError(
            f"the data cannot separate {joined(together)}: changing them together leaves the response "
            "unchanged",
            cure=f"{with_values(together)}, or leave one out",
        )


def unseen_laws(model: Model, theta: Real, covariance: Real) -> list[Notice]:
    """Warnings of nonlinear elements whose parameter may be 0: the data do not show them.

    Where the element shows, but 0 is within the intervals of lengths or speeds in its law, these are named.
    theta (m,) or longer, covariance (m, m) by the noise alone: an interval that a misfit has widened hides no law.
    """
    if not len(model.nonlinear):
        return []
    sd = dict(zip(model.unknown_names, standard_deviations(covariance), strict=False))
    values = dict(zip(model.unknown_names, theta.tolist(), strict=False))
    notices = []
    for element in (model.elements[int(index)] for index in model.nonlinear):
        law, name = element.force_law, element.name
        if law is None:
            continue
        if name not in values or not abs(values[name]) <= ZERO * sd[name]:
            constants = [f"{name}.{c}" for c in law.constant_names if c in law.positive]
            rough = [c for c in constants if c in values and abs(values[c]) <= ZERO * sd[c]]
            if rough:
                its, are = (
                    ("its interval includes", "is") if len(rough) == 1 else ("their intervals include", "are")
                )
                text = (
                    f"{joined(rough)} {are} poorly determined: {its} 0; intervals of {name} and its "
                    "other constants are approximate: increase the drive, or state a value"
                )
                notices.append(Notice("constant_hardly_seen", text, tuple(rough)))
            continue
        inner = [f"{name}.{constant.name}" for constant in law.constants if constant.unknown]
        then = f", so {joined(inner)} mean{'s' if len(inner) == 1 else ''} nothing" if inner else ""
        text = (
            f"the data do not show {name}: its interval includes 0{then}; increase the drive, or remove "
            "the element"
        )
        notices.append(Notice(UNSEEN_LAW, text, (name,)))
    return notices
