"""Notices beside an estimate: what it lacks, and what in the data or in the rig file is probably a slip.

Nothing here changes a number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import bdtrc

from dashpot.arrays import Bools, Real
from dashpot.channel import Quantity
from dashpot.data.spectrum import Spectrum
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.method import HeldBounds, Method
from dashpot.estimate.result import Fit
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Kind
from dashpot.model.network import Model
from dashpot.model.observation import is_direct
from dashpot.model.unstructured import free_entries, free_names
from dashpot.notices import Notice
from dashpot.numerics.small_systems import standard_deviations

ZERO = 1.96  # standard deviations within which a negative part may be none
BIASED = 3.0  # standard deviations
FALSE_ALARMS = 0.05  # of short records of white noise, at most, fail the test of whiteness

APART = 4.0  # standard deviations beyond which two statements contradict each other
# Share of a prior's variance in the posterior beyond which the data say too little to contradict it.
MOST_TOLD = 0.95
SILENT = 1e-12  # of the largest amplitude of the same quantity: rounding


def dead_channels(model: Model, spectrum: Spectrum) -> list[str]:
    """Channels of a moving point that show nothing at any line, though others of their quantity do."""
    sizes = np.nan_to_num(np.abs(spectrum.amplitudes)).max(axis=tuple(range(spectrum.amplitudes.ndim - 1)))
    largest: dict[Quantity, float] = {}
    for channel, size in zip(spectrum.channels, sizes.tolist(), strict=True):
        largest[channel.quantity] = max(largest.get(channel.quantity, 0.0), size)
    return [
        channel.name
        for channel, size in zip(spectrum.channels, sizes.tolist(), strict=True)
        if size <= SILENT * largest[channel.quantity]
        and channel.quantity is not Quantity.FORCE
        and not set(channel.of).isdisjoint(model.coordinates)
    ]


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
        f"{more} of {spectrum.lines} lines repeat another line to the last digit and are counted as independent "
        "measurements; if the same data were given twice, the intervals are too small"
    )
    return [Notice("duplicated_lines", text)]


def prior_conflict(model: Model, theta: Real, noise_covariance: Real) -> list[Notice]:
    """Warnings of parameters stated with an sd that the data, left alone, put elsewhere; θ counts the statement.

    An efficient estimate θ and the statement μ ± s it has used differ by s² − var θ in variance where both are right.
    theta (m,), noise_covariance (m, m).
    """
    notices = []
    for j in model.prior_precision.nonzero()[0]:
        stated, variance = 1 / model.prior_precision[j], noise_covariance[j, j]
        spread = max(stated - variance, (1 - MOST_TOLD) * stated)
        apart = abs(theta[j] - model.prior_mean[j]) / np.sqrt(spread)
        if not apart > APART:
            continue
        alone = (theta[j] - model.prior_mean[j] * variance / stated) / (1 - min(variance / stated, MOST_TOLD))
        name, unit = model.unknowns[j].name, model.unknowns[j].unit
        text = (
            f"{name} is stated as {model.prior_mean[j]:.4g} ± {np.sqrt(stated):.2g} {unit}, but the data alone give "
            f"{alone:.4g}, {apart:.2g} standard deviations away: the statement, the data or the model is wrong"
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
    beyond = theta < -APART * np.sqrt(np.diagonal(noise_covariance))
    if not dampers or not np.all(beyond[dampers]):
        return []
    if np.all(beyond) and len(beyond) > len(
        dampers
    ):  # masses and springs as well: what drives them counts backwards
        return []
    text = (
        "all unknown dampers are negative: the phases may have the opposite sign; dashpot reads amplitudes as "
        "x(t) = Re(X e^{jωt}), for data of the other convention change the sign of the imaginary parts"
    )
    return [Notice("reversed_phase", text, tuple(model.unknowns[j].name for j in dampers))]


def of_estimate(model: Model, theta: Real, covariance: Real, noise: Real, fit: Fit) -> list[Notice]:
    """What one estimate and its fit show; `noise` is the covariance that the sensors' noise alone gives.

    theta (m,), covariance and noise (m, m).
    """
    return [
        *_of_fit(fit),
        *wrong_signs(model, theta, noise),
        *_beyond_bounds(model, theta),
        *reversed_phase(model, theta, noise),
    ]


def of_data(model: Model, spectrum: Spectrum) -> list[Notice]:
    """What the data show, whatever was found in them."""
    return [*_coloured(spectrum), *_inputs_left_out(model, spectrum), *duplicated_lines(spectrum)]


def _of_fit(fit: Fit) -> list[Notice]:
    if not fit.known_noise:
        text = (
            "the noise of the amplitudes is not given: equal relative noise is assumed and its size taken from the "
            "residuals"
        )
        return [Notice("unknown_noise", text)]
    if not bool(fit.rejected):
        return []
    text = (
        f"the model does not fit: residuals are {float(fit.misfit):.3g} times the sensors' noise "
        f"(χ² {float(fit.chi2):.4g} with {fit.dof} degrees of freedom); intervals are widened by that "
        "factor, further where parts of the band disagree more"
    )
    return [Notice("model_misfit", text)]


def _beyond_bounds(model: Model, theta: Real) -> list[Notice]:
    lower, upper = model.bounds
    values = theta[: len(lower)]
    (beyond,) = ((values < lower) | (values > upper)).nonzero()
    names = [model.unknowns[j].name for j in beyond]
    return [
        Notice(
            "beyond_bound", f"{name} lies beyond its bounds; of all methods only ml keeps to them", (name,)
        )
        for name in names
    ]


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
    largest = largest_of_kind(model, model.parameters(theta[: len(model.unknowns)]))
    notices = []
    for j, (unknown, value) in enumerate(zip(model.unknowns, theta, strict=False)):
        if value < 0 and unknown.name not in free and unknown.name not in any_sign:
            within = value > -ZERO * sd[j]
            why = "0 is within its interval" if within else "the model or the data are wrong somewhere"
            if within and -value > largest.get(unknown.name, np.inf):
                why = f"the data say next to nothing about it (± {sd[j]:.2g} {unknown.unit})"
            text = f"{unknown.name} is negative ({value:.4g} {unknown.unit}): {why}"
            notices.append(Notice("negative_but_zero" if within else "negative", text, (unknown.name,)))
    if not free:
        return notices
    parts = matrices(model, model.parameters(theta[: len(model.unknowns)]))
    for letter in free_entries(model):
        values = np.linalg.eigvalsh(getattr(parts, letter))
        if values[0] < -1e-9 * values[-1]:
            text = (
                f"{letter} is not positive definite (eigenvalues from {values[0]:.3g} to {values[-1]:.3g}); "
                "the method oiv+ finds the most likely matrices that are"
            )
            notices.append(Notice("not_definite", text, (letter,)))
    return notices


def largest_of_kind(model: Model, p: Real) -> dict[str, float]:
    """The largest positive part of its kind for each element whose kind has one.  p (elements,)."""
    largest: dict[Kind, float] = {}
    for element, value in zip(model.elements, p.tolist(), strict=True):
        if value > largest.get(element.kind, 0.0):
            largest[element.kind] = value
    return {element.name: largest[element.kind] for element in model.elements if element.kind in largest}


def held(names: tuple[str, ...], theta: Real, bounds: HeldBounds) -> list[Notice]:
    """Warnings of unknowns that lie at a bound; one repeat.  theta (m,)."""
    at = (theta <= bounds.lower) | (theta >= bounds.upper)
    return [
        Notice(
            "at_bound", f"{name} is at its bound; without the bound {float(free):.4g} would fit best", (name,)
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
    if not away[worst] > BIASED:
        return []
    text = (
        f"{method.name} is biased by the noise of these data: {names[worst]} lies {away[worst]:.3g} standard "
        "deviations from the maximum-likelihood value, which oiv gives"
    )
    return [Notice("biased", text, (names[worst],))]


def _coloured(spectrum: Spectrum) -> list[Notice]:
    """What the tests of whiteness led to, where they failed at more lines than white noise explains."""
    coloured = spectrum.noise.count("blocks")
    if not coloured or bdtrc(coloured - 1, spectrum.lines, FALSE_ALARMS) > FALSE_ALARMS * (1 + 1e-9):
        return []
    text = f"coloured noise at {coloured} of {spectrum.lines} frequencies; the intervals include it"
    return [Notice("coloured_noise", text)]


def _inputs_left_out(model: Model, spectrum: Spectrum) -> list[Notice]:
    """Inputs that some lines measure and others leave empty: there they are unknown, which costs precision."""
    if spectrum.complete:
        return []
    measured, notices = spectrum.present, []
    for name in (*model.displacement_inputs, *model.force_inputs):
        direct = [set(channel.of) == {name} and is_direct(model, channel) for channel in spectrum.channels]
        at = np.any(measured[:, direct], axis=-1)
        if np.any(at) and not np.all(at):
            text = (
                f"the input {name} is not measured at {np.sum(~at)} of {len(at)} lines and is unknown there, which "
                "widens the intervals; if it was at rest, write 0"
            )
            notices.append(Notice("input_not_measured", text, (name,)))
    return notices


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
    dead = dead_channels()
    lost = [name for name, v in zip(names, variance, strict=True) if not np.isfinite(v)]
    if dead:
        raise IdentifiabilityError(
            f"the data do not determine {', '.join(lost) if lost else 'the unknowns'}, for {', '.join(dead)} "
            f"show{'s' if len(dead) == 1 else ''} no motion at any line",
            cure="check that the sensor is connected, or leave the channel out of the rig file",
        )
    few = few_lines()
    if few is not None:
        raise IdentifiabilityError(
            f"the data do not determine {', '.join(lost) if lost else 'the unknowns'}: {few}",
            cure="widen the band, or record for longer",
        )
    traces()
    raise IdentifiabilityError(
        f"the data do not determine {', '.join(lost) if lost else 'the unknowns'}",
        cure="give an unknown a value, add frequencies, or ask `dashpot check` which combinations can be found",
    )
