"""One verb: identify(model, spectrum, method) → Estimate."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dashpot.data.conditioning.settings import Conditioning, SampleMoments
from dashpot.data.readers import Reading
from dashpot.data.spectrum import Spectrum, flattened, in_chunks
from dashpot.errors import DataError, UsageError
from dashpot.estimate.inference import diagnostics
from dashpot.estimate.inference.diagnostics import (
    few_lines,
    modes_unseen,
    of_records,
    require_traces,
    unseen_laws,
)
from dashpot.estimate.inference.time_course import time_change_notices
from dashpot.estimate.inference.uncertainty import (
    Inference,
    inference,
    linear_modes,
    require_end,
    with_noise_of_residuals,
)
from dashpot.estimate.likelihood.heavy_tails import with_heavy_tails
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.settling import with_settling_decided
from dashpot.estimate.method import Method, Traits, require_suited
from dashpot.estimate.preparation import prepare, unseen
from dashpot.estimate.registry import AUTOMATIC, method_class
from dashpot.estimate.registry import method as method_named
from dashpot.estimate.result import MISFIT, RESIDUALS, SENSOR_NOISE, Estimate, Fit, estimate_of
from dashpot.model.network import Model
from dashpot.model.observation import observation_model
from dashpot.notices import Notice

# Amplitudes for one rig: what its elements and the methods ask of the conditioning, decided here for
# everyone.


def amplitudes_for(
    model: Model, reading: Reading, settings: Conditioning, methods: Collection[Traits]
) -> Spectrum:
    """The amplitudes of all that was read, treated as the rig and the methods need, short dwells decided.

    `settings` as for `conditioning_for`.  Raises DataError if a method needs samples that the files do not hold.
    """
    treated = conditioning_for(model, reading, settings, methods)
    return with_settling_decided(model, reading.spectrum(treated))


def conditioning_for(
    model: Model, reading: Reading, settings: Conditioning, methods: Collection[Traits]
) -> Conditioning:
    """The settings, with what they leave open decided by the rig and by what the methods declare to need.

    Second moments: a single method that cannot do without insists on them.  Dwells that have not settled are cut to
    what has, rather than used whole, where one of the methods knows no transients or the rig is not linear.  Of a
    nonlinear rig, harmonics are data.
    """
    needs = [traits.moments for traits in methods]
    moments: SampleMoments = False
    if reading.amplitudes is None and any(needs):
        moments = needs[0] if len(needs) == 1 else "auto"
    changed = settings.changed(moments=moments)
    nonlinear = bool(len(model.nonlinear))
    if changed.transients == "auto" and (nonlinear or not all(traits.transients for traits in methods)):
        changed = changed.changed(transients="settle")
    if nonlinear and changed.orders == "auto":
        highest = 5  # multiples of the drive frequency of dwells tell of nonlinear elements, as far as they are sampled
        for record in reading.records:
            if record.frequency_hz is not None and len(record.time) > 1:
                rate = 1 / record.step_s
                highest = min(highest, int(0.45 * rate / record.frequency_hz), (len(record.time) - 4) // 3)
        changed = changed.changed(orders=tuple(range(1, max(highest, 1) + 1)))
    return changed


CHUNK = 2_000_000  # complex numbers of amplitudes at once: keeps the working set of a batch near 1 GB


def identify(
    model: Model,
    spectrum: Spectrum,
    method: Method | str | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Estimate:
    """Estimate the unknowns of `model` from `spectrum`.

    `method` may be a name ("oiv"); without one, `automatic` chooses.  Leading batch axes of the spectrum are repeats of
    the same test and come back as leading axes of the Estimate; `progress(done, all)` is called between chunks of them.

    Raises UsageError or DataError if the data lack what the method needs, IdentifiabilityError if they do not
    determine the unknowns.
    """
    return estimate_by_plan(model, *estimation_plan(model, spectrum, method), progress=progress)


def estimation_plan(
    model: Model,
    spectrum: Spectrum,
    method: Method | str | None = None,
    *,
    seed: int = 0,
    positive: bool = False,
) -> tuple[Spectrum, Method]:
    """What an estimate rests on, decided here and once: whether short dwells have settled, the method, the noise.

    The spectrum then carries its noise, and the method may begin where that was found.  `seed` and `positive` as of
    `suited_method`; they stand in a method that is given.  Raises as `identify`.
    """
    model.require_unknowns()
    if spectrum.lines == 0:
        raise DataError("the data contain no frequency lines", cure="give at least one frequency")
    diagnostics.require_motion(model, spectrum)
    if isinstance(method, str):
        method = suited_method(method, model, spectrum, seed=seed, positive=positive)
    spectrum = with_settling_decided(model, spectrum, method)
    if method is None:
        method = suited_method(None, model, spectrum, seed=seed, positive=positive)
    # Raises UsageError if the method does not know the rig's elements or the data's transients
    if len(model.nonlinear) and not method.traits.nonlinear:
        raise UsageError(
            f"the method {method.name} cannot handle nonlinear elements",
            cure="use the method ml, oiv, iv, wls, ls or hls",
        )
    if spectrum.carries_loads and len(model.nonlinear):
        raise UsageError(
            "transients of continuous records can be estimated for linear rigs only",
            cure="give settled dwells with their frequencies, or leave out the nonlinear elements",
        )
    if spectrum.carries_loads and not method.traits.transients:
        raise UsageError(
            f"the method {method.name} needs settled dwells; continuous records contain transients",
            cure="use the method ml, or give settled dwells with their frequencies",
        )
    return with_heavy_tails(model, spectrum, method)


def estimate_by_plan(
    model: Model, spectrum: Spectrum, method: Method, *, progress: Callable[[int, int], None] | None = None
) -> Estimate:
    """The estimate that a plan comes to.  Raises as `identify`."""
    flat = flattened(spectrum)
    repeats = len(flat.amplitudes)
    size = max(1, CHUNK // (flat.lines * (model.n + 1) * (len(model.elements) + len(flat.channels))))
    parts: list[Inference] = []
    for part in in_chunks(flat, size):
        parts.append(_identified(model, part, method))
        if progress is not None:
            progress(min(len(parts) * size, repeats), repeats)

    def join(piece: Callable[[Inference], Any]) -> Any:
        return piece(parts[0]) if len(parts) == 1 else np.concatenate([piece(part) for part in parts])

    some = parts[0]
    theta, covariance = join(lambda part: part.solution.theta), join(lambda part: part.uncertainty.covariance)
    chi2, p = join(lambda part: part.uncertainty.chi2), join(lambda part: part.uncertainty.p)
    fit = Fit(chi2.reshape(spectrum.batch), some.dof, p.reshape(spectrum.batch), flat.noise_known)
    held, m = some.solution.bounds, len(model.unknowns)
    if held is not None:
        free = [part.solution.bounds.free for part in parts if part.solution.bounds is not None]
        held = replace(held, free=np.concatenate(free))
    warnings = dict.fromkeys(notice for part in parts for notice in part.solution.warnings)
    bands = [part.uncertainty.bands for part in parts if part.uncertainty.bands is not None]
    basis = SENSOR_NOISE if fit.known_noise else RESIDUALS
    if fit.rejected.any() or any(np.any(each.disagree) for each in bands):
        basis = MISFIT
    shown = notices(model, flat, None if spectrum.batch else parts[0], fit)
    return estimate_of(
        model,
        method.name,
        some.unknowns,
        theta,
        covariance,
        spectrum.batch,
        noise=join(lambda part: part.uncertainty.noise),
        bound=join(lambda part: part.uncertainty.bound),
        dof=join(lambda part: part.uncertainty.dof),
        fit=fit,
        basis=basis,
        converged=join(lambda part: part.solution.converged),
        iterations=join(lambda part: part.solution.iterations),
        history=some.solution.history,
        bounds=held,
        modes=None if spectrum.batch else linear_modes(model, theta[0, :m], covariance[0, :m, :m]),
        signs={
            name: np.concatenate([part.solution.signs[name] for part in parts])
            for name in some.solution.signs
        },
        warnings=(*warnings, *shown),
        notes=flat.notes,
    )


def suited_method(name: str | None, model: Model, spectrum: Spectrum, *, seed: int, positive: bool) -> Method:
    """The method of that name, None: the one that suits; `positive` holds every unknown at or above 0.

    Raises UsageError if there is no such method, or where it cannot hold bounds.
    """
    chosen = automatic(model, spectrum, bounded=positive).name if name is None else name
    return method_named(chosen, seed=seed, positive=True) if positive else method_named(chosen, seed=seed)


def automatic(model: Model, spectrum: Spectrum, *, bounded: bool = False) -> Method:
    """The first method of AUTOMATIC that suits: oiv where calibrated channels see every coordinate and input, else ml.

    Where unknowns have bounds, or are to have some (`bounded`), it must be one that holds them; where there are whole
    records, one that knows their transients; where there are nonlinear elements, one that is efficient for them.
    """
    view = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment)
    bounded = bounded or bool(np.any(np.isfinite(model.bounds)))
    by_output = not view.is_direct.all() or bool(unseen(view, spectrum))
    transients = spectrum.carries_loads
    for name in AUTOMATIC:
        traits = method_class(name).traits
        asked = (
            (by_output, traits.by_output),
            (bounded, traits.bounds),
            (transients, traits.transients),
            (bool(len(model.nonlinear)), traits.nonlinear and traits.maximum_likelihood and traits.by_output),
        )
        if all(able or not wanted for wanted, able in asked):
            break
    return method_named(name)


def _identified(model: Model, spectrum: Spectrum, method: Method) -> Inference:
    """Prepare, solve, infer: one chunk of repeats."""
    # A search that has its start needs no look at all coordinates together, which costs more than the search.
    begun = isinstance(method, MaximumLikelihood) and bool(method.start)
    data = prepare(model, spectrum, moments=bool(method.traits.moments), states=not begun)
    require_suited(method, data)
    if not data.noise_known and np.any(data.view.prior_precision):
        data = with_noise_of_residuals(data, method)
    part = inference(data, method.solve(data), method)
    if not spectrum.records:
        return part
    solution = part.solution
    warnings = (*solution.warnings, *time_change_notices(data, solution), *modes_unseen(data, solution))
    return replace(part, solution=replace(solution, warnings=warnings))


# What stands beside an estimate, in the order in which it is told.


def notices(model: Model, spectrum: Spectrum, single: Inference | None, fit: Fit) -> list[Notice]:
    """What an estimate without batch axes shows of itself (None: there are several), and what the data show.

    Raises IdentifiabilityError if the data do not determine a single estimate.
    """
    of_data = diagnostics.of_data(model, spectrum)
    if single is None:
        return of_data
    part, worth, bounds = single, single.uncertainty, single.solution.bounds
    names, units = tuple(u.name for u in part.unknowns), tuple(u.unit for u in part.unknowns)
    theta, covariance, noise = part.solution.theta[0], worth.covariance[0], worth.noise[0]
    dead = partial(diagnostics.dead_channels, model, spectrum)
    few = partial(few_lines, model, spectrum)
    traces = partial(require_traces, model, names, part.information[0])
    diagnostics.require_determined(names, theta, noise, dead, few, traces)
    # What runs off because the rig or a channel is another one has a cause, which an estimate must be there to show.
    negative = theta[: len(model.unknowns)][diagnostics.of_one_sign(model)] < 0
    sound = not fit.rejected.any() and not np.any(negative)
    if part.valley is not None and not bool(part.solution.converged[0]) and sound:
        require_end(part.valley, names, units, theta)
    shown = []
    if fit.known_noise and not part.method.traits.maximum_likelihood:
        shown += diagnostics.bias(names, theta, part.most_likely[0], covariance, part.method)
    shown += [] if worth.bands is None else worth.bands.notices(names)
    in_time = () if worth.in_time is None else worth.in_time.uneven
    shown += [uneven.notice() for uneven in in_time if uneven is not None]
    shown += diagnostics.of_estimate(model, theta, covariance, noise, fit)
    shown += unseen_laws(model, theta, noise)
    if part.method.traits.maximum_likelihood:
        shown += diagnostics.prior_conflict(part.unknowns, theta, noise, fit)
    shown += of_records(model, theta, noise, spectrum)
    return [*shown, *(() if bounds is None else diagnostics.held(names, theta, bounds)), *of_data]
