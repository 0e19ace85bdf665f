"""The estimate where no method is named: the one that suits, and a thorough search where that may be another valley.

Where all is seen, oiv and ml descend from one start, efficient and fast; at 20 % noise every third chain of five ends
in a wrong valley or nowhere, and such an end may fit as well as the truth (THEORY §11).  Where a method finds nothing,
does not converge, does not fit, makes a part of the rig negative, or where noise leaves a part uncertain, ml searches
from many starts among rigs of positive parts; the likelier end is taken, and the other told where it fits alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from dashpot.arrays import Bools, Ints
from dashpot.data.spectrum import Moments, Spectrum, flattened, in_chunks
from dashpot.errors import ConvergenceError, IdentifiabilityError
from dashpot.estimate.identify import estimate_by_plan, estimation_plan, identify
from dashpot.estimate.inference.diagnostics import of_one_sign
from dashpot.estimate.likelihood.global_search import DOUBT, TIE, apart, guessed, not_unique
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.method import Method
from dashpot.estimate.registry import method_class
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import measures_input
from dashpot.notices import Notice
from dashpot.unknowns import Unknown

LARGEST = 8  # coordinates: beyond, many starts take longer than anyone waits
BEYOND = 2.0  # standard deviations by which a negative part is no accident


def identify_with_noise(
    model: Model,
    spectrum: Spectrum,
    method: Method | str | None = None,
    *,
    seed: int = 0,
    positive: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Estimate, Spectrum]:
    """The estimate that all commands and Python give, and the spectrum with the noise it rests on, which judges it.

    A method that is named or given stands; without one, a thorough search may take the place of the one that suits.
    Repeats are estimated by that alone.  `seed` and `positive` as for `suited_method`.  Raises as that and `identify`.
    """
    spectrum, first = estimation_plan(model, spectrum, method, seed=seed, positive=positive)
    plain = MaximumLikelihood(seed=seed)
    if method is not None or spectrum.batch or first.traits.by_output:
        return estimate_by_plan(model, spectrum, first, progress=progress), spectrum
    try:
        estimate = estimate_by_plan(model, spectrum, first, progress=progress)
    except (IdentifiabilityError, ConvergenceError):
        # ml, from many starts if the rig is small, where the first has no answer; its error where neither has
        search = _searched if model.n <= LARGEST else _converged
        second = search(model, spectrum, plain)
        if second is None:
            raise
        text = f"{first.name} finds no solution for these data; ml was used instead"
        return replace(second, warnings=(*second.warnings, Notice("another_method", text))), spectrum
    if not may_be_another_minimum(model, spectrum, estimate) or model.n > LARGEST:
        return estimate, spectrum
    second = _searched(model, spectrum, plain)
    return estimate if second is None else _likelier(model, estimate, second), spectrum


def identify_each(
    model: Model, spectrum: Spectrum, method: str | None = None, *, seed: int = 0, positive: bool = False
) -> Iterator[tuple[Ints, Estimate | Exception]]:
    """What `identify_with_noise` gives of each repeat, with the places (n,) of the repeats that it is of.

    One batch for the repeats that need no second look, a thousand times as fast, then the others one by one, each with
    its estimate or what it raises.  The spectrum has one batch axis.
    """
    alone = np.ones(len(spectrum.amplitudes), dtype=bool)
    if len(alone) > 1:
        try:
            batch, known = identify_with_noise(model, spectrum, method, seed=seed, positive=positive)
        except Exception:  # of one of them, which is found and says itself what is wrong
            pass
        else:
            alone = ~batch.converged | ~np.all(np.isfinite(batch.sd), axis=-1)
            first = method_class(batch.method).traits
            if method is None and not first.by_output and model.n <= LARGEST:
                alone |= may_be_another_minimum(model, known, batch)
            yield np.flatnonzero(~alone), batch
    for k, repeat in enumerate(in_chunks(flattened(spectrum), 1)):
        if not alone[k]:
            continue
        moments = None if repeat.moments is None else Moments(repeat.moments.products[0])
        one = repeat.derived(
            amplitudes=repeat.amplitudes[0], covariance=repeat.covariance[0], moments=moments
        )
        try:
            yield np.array([k]), identify_with_noise(model, one, method, seed=seed, positive=positive)[0]
        except Exception as error:
            yield np.array([k]), error


def may_be_another_minimum(model: Model, spectrum: Spectrum, estimate: Estimate) -> Bools:
    """Which estimates (...,) may be another minimum: not plausible, or with a part that noise leaves uncertain."""
    # No wrong valley was seen where every part stands further than half of this from 0.
    uncertain = np.any(_below(model, estimate, 30.0), axis=-1)
    if np.any(uncertain):
        uncertain = uncertain & noisy(model, spectrum)
    return ~plausible(model, estimate) | uncertain


def plausible(model: Model, estimate: Estimate) -> Bools:
    """Which estimates (...,) have converged, are not rejected by χ², and make no part negative or endless."""
    wrong = np.any(_below(model, estimate, -BEYOND), axis=-1) | _endless(model, estimate)
    return estimate.converged & ~np.asarray(estimate.fit.p < 1e-3) & ~wrong


def _endless(model: Model, estimate: Estimate) -> Bools:
    """Where an unknown has run off to infinity, where the likelihood is flat: no end of a search; (...,).

    Its standard deviation is then a hundred times the largest part of its kind.
    """
    kinds = {element.name: element.kind for element in model.elements}
    sizes = np.abs(model.parameters(estimate.values[..., : len(model.unknowns)]))
    endless = np.zeros(estimate.converged.shape, dtype=bool)
    for kind in dict.fromkeys(kinds.values()):
        alike = [each is kind for each in kinds.values()]
        largest = np.fmax.reduce(sizes[..., alike], axis=-1)
        most = np.where(largest > 0, 100.0 * largest, np.inf)
        sought = [i for i, unknown in enumerate(model.unknowns) if kinds.get(unknown.name) is kind]
        endless |= np.any(~(estimate.noise_sd[..., sought] <= most[..., None]), axis=-1)
    return endless


def noisy(model: Model, spectrum: Spectrum) -> Bools:
    """Where noise is more than 2 % of the motion at a channel's middle line, (...,); so where it is not given.

    Below that there is one valley.
    """
    measured = np.array([not measures_input(model, channel) for channel in spectrum.channels])
    noise = np.sqrt(np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real)[..., measured]
    if not np.any(np.isfinite(noise)):
        return np.ones(spectrum.batch, dtype=bool)
    with np.errstate(all="ignore"):
        share = noise / np.abs(spectrum.amplitudes[..., measured])
    unknown = np.all(np.isnan(share), axis=-2, keepdims=True)
    return ~np.all(np.nanmedian(np.where(unknown, np.inf, share), axis=-2) <= 0.02, axis=-1)


def _below(model: Model, estimate: Estimate, deviations: float) -> Bools:
    """Parts below so many standard deviations, (..., unknowns); entries of free matrices, nonlinear terms never are."""
    physical = of_one_sign(model)
    values, sd = estimate.values[..., : len(physical)], estimate.noise_sd[..., : len(physical)]
    return physical & (values < deviations * sd)


def _converged(model: Model, spectrum: Spectrum, method: MaximumLikelihood) -> Estimate | None:
    """What the method finds, None where it finds no answer."""
    try:
        estimate = identify(model, spectrum, method)
    except (IdentifiabilityError, ConvergenceError):
        return None
    return estimate if bool(estimate.converged) else None


def _searched(model: Model, spectrum: Spectrum, plain: MaximumLikelihood) -> Estimate | None:
    """The likeliest rig near the likeliest one of positive parts, with what else fits alike; None if there is none.

    Noise gives parts that are hardly seen either sign, and rigs with negative parts valleys of their own: those are
    searched last, from where positive parts have led.
    """
    try:
        held = identify(model, spectrum, replace(plain, positive=True, thorough=True))
    except (IdentifiabilityError, ConvergenceError):
        return None
    begun = replace(plain, start=tuple(held.values.tolist()), start_sign=(1.0,) * len(spectrum.channels))
    free = _converged(model, spectrum, begun)
    if free is None or _endless(model, free):
        return held
    rivals = _rivals(held)
    wider = _converged(model, spectrum, replace(begun, start=tuple(free.values.tolist()), thorough=True))
    if wider is not None and not _endless(model, wider):
        taken, others = _preferred(model, free, wider)
        free, rivals = wider if taken else free, others or rivals
    rest = (notice for notice in free.warnings if notice.code != "not_unique")
    return replace(free, warnings=(*rivals, *rest))


def _rivals(estimate: Estimate) -> tuple[Notice, ...]:
    """The notice of another minimum that fits alike, where there is one."""
    return tuple(notice for notice in estimate.warnings if notice.code == "not_unique")


def _ended(model: Model, estimate: Estimate) -> bool:
    """Whether an estimate is a minimum at all."""
    return bool(estimate.converged) and not _endless(model, estimate)


def _likelier(model: Model, first: Estimate, second: Estimate) -> Estimate:
    """The better of two ends, with the other told where it fits alike."""
    first_ended = _ended(model, first)
    if not _ended(model, second):
        # The first, told that the likelihood is as large or larger towards infinity, where it is
        above = float(second.fit.chi2 - first.fit.chi2)
        if not (first_ended and above <= DOUBT):
            return first
        rival = not_unique(_unknowns(model, first), first.values, [(second.values, above)], 1.0)
        rival = replace(rival, odds=(0.0,))  # no set of values, which an interval could hold
        return replace(first, warnings=(rival, *first.warnings))
    taken, rivals = _preferred(model, first, second)
    if not taken:
        return replace(first, warnings=(*rivals, *first.warnings))
    failing = "reached a local minimum" if first_ended else "did not converge"
    changed = Notice("another_method", f"{first.method} {failing}; ml with many starts was used instead")
    rest = (notice for notice in second.warnings if notice.code != "not_unique")
    return replace(second, warnings=(*rivals, *rest, changed))


def _preferred(model: Model, first: Estimate, second: Estimate) -> tuple[bool, tuple[Notice, ...]]:
    """Whether the second of two ends is the better one, and the notice of what else fits alike.

    Among those that fit alike it is the one with fewer negative parts, else the one with the lower χ², or where these
    are the same, the one nearer to the guesses.
    """
    scale = max(1.0, float(second.fit.chi2) / max(second.fit.dof, 1))
    rise = above = float(first.fit.chi2 - second.fit.chi2) if _ended(model, first) else np.inf
    rivals = _rivals(second)
    if abs(above) <= TIE * scale and not apart(second.values, first.values, second.noise_sd):
        return False, rivals
    alike = abs(above) <= DOUBT * scale
    unknowns = _unknowns(model, second)
    if abs(above) <= TIE * scale:  # the guesses decide
        above = guessed(unknowns, second.values) - guessed(unknowns, first.values)
    negative = [int(np.sum(_below(model, estimate, -BEYOND))) for estimate in (first, second)]
    taken = negative[1] < negative[0] if alike and negative[0] != negative[1] else above > 0
    if not alike:
        return taken, rivals if taken else ()
    if rivals and (taken or not apart(second.values, first.values, second.noise_sd)):
        return taken, rivals
    better, other = (second, first) if taken else (first, second)
    return taken, (not_unique(unknowns, better.values, [(other.values, abs(rise))], scale),)


def _unknowns(model: Model, estimate: Estimate) -> tuple[Unknown, ...]:
    """What is known beforehand of an estimate's unknowns."""
    calibrations = zip(estimate.names, estimate.units, strict=True)
    return (*model.unknowns, *(Unknown(*each) for each in list(calibrations)[len(model.unknowns) :]))
