"""The estimate with its verdict and, if the rig does not fit, the likely causes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.special import chdtrc

from dashpot.arrays import Real, diagonal_matrices, random_generator
from dashpot.channel import Channel
from dashpot.check.explain.channels import factor_in_words, late, turned
from dashpot.check.explain.effect import Effect, as_is
from dashpot.check.explain.engine import (
    LARGEST,
    NEARLY_ALL,
    Explanation,
    allowing_for,
    allowing_for_causes,
    explain,
    explain_beside_laws,
)
from dashpot.check.explain.laws import (
    ENOUGH,
    ScoredElement,
    called_for,
    called_for_in_records,
    in_place_of_laws,
)
from dashpot.check.explain.problem import LineProblem
from dashpot.check.explain.record_channels import mistakes_by_equation
from dashpot.check.explain.records import explained_records
from dashpot.check.explain.rigs import missing_elements, missing_in_words, points_of
from dashpot.check.explain.score import score_tests
from dashpot.check.profile import with_profile_intervals
from dashpot.check.verdict import (
    BEYOND,
    UNTESTED,
    assess,
    likely,
    one_cause,
    rejected,
    settled_by_size,
    several_motions,
    silent_channels,
)
from dashpot.data.spectrum import FITTED, SettledDwell, Spectrum
from dashpot.errors import DashpotError, ModelError
from dashpot.estimate.assessment import Assessment, Finding
from dashpot.estimate.identify import identify
from dashpot.estimate.inference.time_course import TIME_CHANGES
from dashpot.estimate.likelihood.global_search import candidates
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.likelihood.record_noise import RESIDUAL, with_record_noise
from dashpot.estimate.method import Method
from dashpot.estimate.nonlinear.search import linear_rig, starting_points
from dashpot.estimate.preparation import Prepared, prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import measures_input, observation_model
from dashpot.notices import Notice

OF_SAMPLES = {"white", "blocks", "periods"}  # kinds of noise that were read from samples
MUCH = 0.2  # of a channel's motion, left over without known noise
SUPPOSED = 0.01  # of an amplitude: its noise where none is known
OF_THE_RIG = ("value", "element", "nonlinear", "hysteretic", "oscillator")  # kinds of causes


def diagnose(
    model: Model, spectrum: Spectrum, estimate: Estimate | None = None, *, seed: int = 0
) -> tuple[Finding, ...]:
    """Likely causes of a rig that does not fit, the likeliest first; () where they cannot be sought.

    `spectrum` has no batch axes.  The estimate, where there is one, is one more start.  Nothing is applied.
    """
    return _diagnosed(model, spectrum, estimate, seed)[0]


def _diagnosed(
    model: Model, spectrum: Spectrum, estimate: Estimate | None, seed: int
) -> tuple[tuple[Finding, ...], Explanation | None]:
    """As `diagnose`, and what the engine found, where it was asked."""
    backwards = _pushed_backwards(model, spectrum, estimate)
    if backwards or model.n > LARGEST:
        return backwards, None
    if len(model.nonlinear):
        try:
            return _beside_laws(model, spectrum, estimate, np.inf)
        except DashpotError:  # laws may leave no trace
            return (), None
    found = explained(model, spectrum, estimate, seed=seed)
    return ((), None) if found is None else (found.findings(), found)


def explained(
    model: Model, spectrum: Spectrum, estimate: Estimate | None = None, *, seed: int = 0
) -> Explanation | None:
    """What the engine finds for a linear rig, without batch axes; None for a free decay, nothing but a transient."""
    if spectrum.carries_loads:
        if not model.inputs:
            return None
        one_line_each = spectrum.lines <= len(spectrum.records)
        silent = silent_channels(model, spectrum) if one_line_each else {}
        method: Method = MaximumLikelihood(seed=seed)
        if estimate is None:  # what data with a mistake leave undetermined, they determine once it is mended
            try:
                spectrum, method = with_record_noise(model, spectrum, method)
            except DashpotError:
                return None
        starts, sign = _begun_at(prepare(model, spectrum, states=False), estimate, seed)
        if isinstance(method, MaximumLikelihood) and method.start:  # where the search for the noise has ended
            starts, sign = (np.array(method.start), *starts), np.array(method.start_sign)
        return explained_records(model, spectrum, starts, sign, silent=silent, seed=seed)
    if not spectrum.noise_known:
        spectrum = _with_supposed_noise(model, spectrum)
    silent = silent_channels(model, spectrum)
    data = prepare(model, spectrum)
    starts, sign = _begun_at(data, estimate, seed)
    of_samples = set(spectrum.noise) <= OF_SAMPLES
    return explain(LineProblem(data, sign, starts), silent=silent, of_samples=of_samples, seed=seed)


def _begun_at(data: Prepared, estimate: Estimate | None, seed: int) -> tuple[tuple[Real, ...], Real]:
    """ψ (M,) of the estimate, if there is one, and of a typical rig as the file describes it: a wrong rig may have led
    anywhere.  With them the signs of all channels (channels,)."""
    (psi, *_), (sign, *_) = candidates(data, 1, random_generator(seed))
    if estimate is None or not np.all(np.isfinite(estimate.values)):
        return (psi,), sign
    for name, value in estimate.signs.items():
        sign[data.spectrum.index(name)] = float(value)
    return (estimate.values, psi), sign


def _with_supposed_noise(model: Model, spectrum: Spectrum) -> Spectrum:
    """Amplitudes without known noise with a little of their size.

    What a wrong rig leaves over, which else would be taken for noise, lets every remedy explain all.
    """
    alone = observation_model(model, spectrum.channels, spectrum.omega, spectrum.experiment).inputs_alone
    power = np.where(spectrum.present, np.abs(spectrum.amplitudes) ** 2, 0.0)
    mean = np.sum(power, axis=0) / np.maximum(np.sum(spectrum.present, axis=0), 1)
    V = diagonal_matrices(np.where(alone, 0.0, SUPPOSED**2 * (power + SUPPOSED * mean)))
    return replace(spectrum, covariance=V, noise=(FITTED,) * spectrum.lines)


def _pushed_backwards(model: Model, spectrum: Spectrum, estimate: Estimate | None) -> tuple[Finding, ...]:
    """A force of opposite sign: every part is negative and χ² the same, where forces alone set the scale."""
    forces = [channel for channel in spectrum.channels if set(channel.of) & set(model.force_inputs)]
    scaled = any(element.value for element in model.elements) or model.displacement_inputs
    if estimate is None or scaled or len(forces) != 1:
        return ()
    theta, sd = (values[: len(model.unknowns)] for values in (estimate.values, estimate.noise_sd))
    if not np.all(theta < -BEYOND * sd):
        return ()
    said = turned(model, forces[0])
    left = float(estimate.fit.misfit) ** 2
    return (Finding("sign", (forces[0].name,), said.text, said.change, left, -1.0, said.channels, odds=1.0),)


def examined(
    model: Model, spectrum: Spectrum, estimate: Estimate, *, seed: int = 0, within: float | None = None
) -> Estimate:
    """The estimate with its assessment, and likely causes where the rig does not fit; batches as they are.

    within: as of `assess`.  Where the rig fits, the intervals follow χ² where that is no parabola.
    """
    if estimate.values.ndim != 1:
        return estimate
    try:
        assessment = assess(model, spectrum, estimate, within=within)
    except ModelError as error:
        if bool(estimate.converged):
            raise
        # A search that was lost may end at a rig without any response; what misled it can be told all the same.
        assessment = Assessment("does not fit", (Notice("no_response", error.problems[0].what),), {}, ())
    unsettled = assessment.verdict == "does not fit" or not bool(estimate.converged)
    of_residuals = RESIDUAL in spectrum.noise
    found: Explanation | None = None
    laws: list[ScoredElement] = []
    if len(model.nonlinear):
        if unsettled:
            misfit = float(estimate.fit.misfit) ** 2
            others, found = _beside_laws(model, spectrum, estimate, misfit)
            others = others or _in_place_of_laws(model, spectrum, misfit, seed)
            assessment = replace(assessment, findings=(*assessment.findings, *others))
    else:
        laws = called_for_in_records(model, spectrum, estimate) if model.n <= LARGEST else []
        if unsettled or laws:
            findings, found = _diagnosed(model, spectrum, estimate, seed)
            misfit = float(estimate.fit.misfit) ** 2
            listed = (
                each.effect(model).finding(each.value, misfit * (1 - each.share), explains=each.share)
                for each in laws
            )
            assessment = _with_causes(assessment, findings, tuple(listed))
        elif (of_residuals or not estimate.fit.known_noise) and _suspicious(assessment):
            findings, found = _diagnosed(model, spectrum, estimate, seed)
            assessment = _with_likely_cause(assessment, findings, _harmless(estimate, found))
    estimate, assessment = _without_changes_in_time(estimate, assessment)
    harmless = _harmless(estimate, found)
    in_vain = of_residuals and found is not None
    assessment = settled_by_size(assessment, within is not None, in_vain=in_vain, harmless=harmless)
    estimate = _closed(model, spectrum, estimate, assessment)
    if estimate.assessment is None or estimate.assessment.verdict != "does not fit":
        return estimate
    first = estimate.assessment.findings[:1]
    if laws and laws[0].psi is not None and first and first[0].kind == "nonlinear":
        return allowing_for(model, estimate, [(1.0, laws[0].psi, 0.0)])
    return estimate if found is None else allowing_for_causes(model, estimate, found)


def _harmless(estimate: Estimate, found: Explanation | None) -> bool:
    """Whether the likeliest cause would move each unknown by less than its standard deviation, were it mended."""
    if found is None or not found.causes:
        return False
    for fit in found.causes[0].fit.parts or (found.causes[0].fit,):
        there = dict(zip(fit.problem.names, fit.psi.tolist(), strict=True))
        for name, value, sd in zip(estimate.names, estimate.values, estimate.noise_sd, strict=True):
            if abs(there.get(name, value) - value) > sd:
                return False
    return True


def _with_causes(assessment: Assessment, found: tuple[Finding, ...], laws: tuple[Finding, ...]) -> Assessment:
    """The assessment with what was found to be the matter.

    Nonlinear elements that whole records call for stand first, unless a cause of the list explains more than they;
    so do changes in the course of a record and channels that end, unless a cause explains nearly all.
    """
    best = found[0] if found else None
    by_law = laws[0].explains or 0.0 if laws else 0.0
    explains = 0.0 if best is None or best.explains is None else best.explains
    # A score tells what one step explains: less than the law would.
    if laws and explains < 1 - (1 - by_law) / 10:
        share = f"{100 * by_law:.0f} %"
        text = f"a nonlinear element between {' and '.join(laws[0].of)} explains {share} of the residuals (p < 1e-6)"
        others = (each for each in assessment.reasons if each.code not in UNTESTED)
        reasons = (Notice("nonlinear", text, laws[0].of), *others)
        listed = tuple(each for each in found if each.kind not in ("nonlinear", "unexplained"))
        return replace(assessment, verdict="does not fit", reasons=reasons, findings=(*laws, *listed))
    in_time = assessment.findings
    if not in_time:
        return replace(assessment, findings=found)
    first, then = (found, in_time) if explains >= NEARLY_ALL else (in_time, found)
    named = {("unexplained", ()), *((each.kind, each.of) for each in first)}
    more = (each for each in then if (each.kind, each.of) not in named)
    return replace(assessment, findings=(*first, *more))


def _suspicious(assessment: Assessment) -> bool:
    """Whether a fit that is its own measure of the noise leaves more than noise in a channel, or much of its motion."""
    beyond = any(share is not None and share.lower95 > 0 for share in assessment.discrepancy.values())
    return beyond or max(assessment.relative_residual.values(), default=0.0) > MUCH


def _with_likely_cause(assessment: Assessment, found: tuple[Finding, ...], harmless: bool) -> Assessment:
    """The assessment of a fit without known noise, which is none where causes are likely and would move an unknown."""
    if harmless or not likely(found):
        return assessment
    reasons = (one_cause(found[0]), *(each for each in assessment.reasons if each.code not in UNTESTED))
    kept = tuple(reason for reason in reasons if reason.code != "below_noise")
    return replace(assessment, verdict="does not fit", reasons=kept, findings=found)


def _beside_laws(
    model: Model, spectrum: Spectrum, estimate: Estimate | None, misfit: float
) -> tuple[tuple[Finding, ...], Explanation | None]:
    """What may be the matter with settled dwells of a rig with laws of its own, and what the engine found.

    Gross mistakes of channels by the equation of motion, where all motion is seen; what the engine finds, where the rig
    describes the motion roughly; elements in addition to the rig's own laws, unless a cause explains nearly all.
    """
    if spectrum.carries_loads or model.n > LARGEST:
        return (), None
    data = prepare(model, spectrum)
    mistakes = () if data.states is None else mistakes_by_equation(data, misfit)
    if mistakes and (mistakes[0].remaining or 0.0) < ENOUGH:
        return mistakes, None
    known = estimate is not None and bool(np.all(np.isfinite(estimate.values)))
    psi = estimate.values if estimate is not None and known else starting_points(data)[0]
    (sign,) = spectrum.signs({} if estimate is None else estimate.signs)
    problem = LineProblem(data, sign, (psi,))
    found = None
    # Where a rig leaves half of the power of a channel, its trials lead nowhere.
    left = problem.left(psi) if known else problem.y
    if np.all(np.sum(np.abs(left) ** 2, axis=0) < 0.5 * np.sum(np.abs(problem.y) ** 2, axis=0)):
        found = explain_beside_laws(problem, silent_channels(model, spectrum))
        if found.causes and found.causes[0].explains >= NEARLY_ALL:
            return found.findings(), found
    if mistakes:  # which comes near, as nothing else does
        return mistakes, None
    laws = () if data.states is None else called_for(problem, thorough=False)
    if laws:
        return tuple(each.effect(model).finding(each.value, each.left / each.dof) for each in laws), None
    return ((), None) if found is None else (found.findings(), found)


def _in_place_of_laws(model: Model, spectrum: Spectrum, misfit: float, seed: int) -> tuple[Finding, ...]:
    """Nonlinear elements that settled dwells call for where the rig's own are left out, and that leave less misfit."""
    if spectrum.carries_loads:
        return ()
    try:
        linear = linear_rig(model)
        found = diagnose(linear, spectrum, identify(linear, spectrum, "ml"), seed=seed)
    except DashpotError:
        return ()
    return tuple(
        in_place_of_laws(model, each)
        for each in found
        if each.kind == "nonlinear"
        and each.remaining is not None
        and each.remaining < (1 - NEARLY_ALL) * misfit
    )


def _without_changes_in_time(estimate: Estimate, assessment: Assessment) -> tuple[Estimate, Assessment]:
    """Changes in the course of a record as what they are where the rig is another one: the last of the reasons.

    The warnings, which go with a remedy for each, name them no more.
    """
    if not assessment.findings or assessment.findings[0].kind not in OF_THE_RIG:
        return estimate, assessment
    in_time = tuple(reason for reason in assessment.reasons if reason.code in TIME_CHANGES)
    others = tuple(reason for reason in assessment.reasons if reason.code not in TIME_CHANGES)
    warnings = tuple(notice for notice in estimate.warnings if notice.code not in TIME_CHANGES)
    return replace(estimate, warnings=warnings), replace(assessment, reasons=(*others, *in_time))


def _closed(model: Model, spectrum: Spectrum, estimate: Estimate, assessment: Assessment) -> Estimate:
    """The estimate with its assessment, of fits looked at closely, and with the intervals that suit it."""
    if not estimate.fit.known_noise:  # what a remedy leaves has no measure
        findings = tuple(replace(each, remaining=None) for each in assessment.findings)
        assessment = replace(assessment, findings=findings)
    # Scores over a noise that is too small prove nothing.
    plain = assessment.verdict == "fits" and not rejected(estimate)
    findings = directed(model, spectrum, estimate) if plain else ()
    if findings:
        text = f"statistically significant although the overall χ² test passes: {findings[0].text}"
        reasons = (Notice("directed", text, findings[0].of), *assessment.reasons)
        assessment = replace(assessment, verdict="does not fit", reasons=reasons, findings=findings)
    if len(model.nonlinear):
        several = several_motions(model, spectrum, estimate)
        estimate = replace(estimate, warnings=(*estimate.warnings, *several))
    if assessment.verdict != "does not fit":
        estimate = with_profile_intervals(model, spectrum, estimate)
    return replace(estimate, assessment=assessment)


# Of a fit that χ² passes, single directions in which it is off beyond doubt: the gain or delay of a channel, an element
# between two points (THEORY §11).  χ² spreads what it finds over all amplitudes; a score test looks along one column,
# projected out of what the rig's own unknowns can do, and finds a tenth of the misfit that χ² needs.


LEVEL = 1e-3  # of all directions together: one clean test in a thousand
APART = 0.03  # part of a column that the rig's own unknowns must leave
MOST_AMPLITUDES = 20_000
MOST_DIRECTED = 3  # causes that are named


def directed(model: Model, spectrum: Spectrum, estimate: Estimate) -> tuple[Finding, ...]:
    """What of a fit is off beyond doubt, the clearest first; () where nothing is, or no noise is known.

    Each direction is tested by itself alongside the rig's unknowns, at LEVEL over their number.
    """
    settled = all(isinstance(stretch, SettledDwell) for stretch in spectrum.stretches)
    small = model.n <= LARGEST and spectrum.amplitudes.size <= MOST_AMPLITUDES
    able = settled and small and not len(model.nonlinear) and estimate.fit.known_noise
    if not able or not bool(estimate.converged) or estimate.fit.dof < 1:
        return ()
    elements = {element.name: element for element in missing_elements(model)}
    channels, exact = _with_open_calibrations(model, spectrum)
    try:
        data = prepare(model, replace(spectrum, moments=None), states=False)
        problem = LineProblem(data, spectrum.signs(estimate.signs)[0], (estimate.values,))
        problem = problem.of_rig(replace(model, elements=(*model.elements, *elements.values())), channels)
    except DashpotError:
        return ()  # channels that contradict each other, say
    names = problem.names
    information, score, chi2 = problem.slopes(problem.starts[0])
    together = {}
    if len(exact) == 1:  # an input without noise is late where all that it moves is early
        for word in ("gain", "delay"):
            together[f"{exact[0]}.{word}"] = [
                name for name in names if name.endswith(f".{word}") and name not in estimate.names
            ]
    moves = np.eye(len(names))
    alike = [[float(name in members) for name in names] for members in together.values()]
    moves = np.concatenate([moves, np.reshape(alike, (-1, len(names)))])
    every = (*names, *together)
    fixed = [name not in estimate.names for name in every]
    tests = score_tests(every, fixed, moves @ information @ moves.T, moves @ score, chi2, APART)
    # Where the noise was estimated, χ² scatters as much more as the intervals are wider.
    with np.errstate(invalid="ignore", divide="ignore"):
        widened = float(np.nanmax(np.append((estimate.noise_sd / estimate.bound_sd) ** 2, 1.0)))
    certain = [test for test in tests if float(chdtrc(1, test.fall / widened)) * len(tests) < LEVEL]
    by_name = {channel.name: channel for channel in spectrum.channels}
    findings = []
    for test in sorted(certain, key=lambda each: -each.fall)[:MOST_DIRECTED]:
        left = (test.chi2 - test.fall) / max(estimate.fit.dof - 1, 1)
        size = -test.step if test.name in together else test.step
        name, _, word = test.name.rpartition(".")
        of: tuple[str, ...] = (name,)
        if name and word == "gain":
            kind, size, words = "gain", 1 + size, partial(factor_in_words, model, by_name[name])
        elif name:
            kind, words = "delay", partial(late, model, by_name[name])
        else:
            element = elements[test.name]
            kind, of, words = "element", points_of(element, model), partial(missing_in_words, model, element)
        findings.append(Effect(kind, of, as_is, words, (size,)).finding(size, left))
    return tuple(findings)


def _with_open_calibrations(model: Model, spectrum: Spectrum) -> tuple[tuple[Channel, ...], tuple[str, ...]]:
    """The channels with gain and delay to be found where they have noise, and the names of inputs that have none."""
    variance = np.diagonal(spectrum.covariance, axis1=-2, axis2=-1).real
    noisy = np.any(variance.reshape(-1, len(spectrum.channels)) > 0, axis=0).tolist()
    channels = tuple(
        replace(channel, gain=None, delay=None) if heard and channel.same_gain_as is None else channel
        for channel, heard in zip(spectrum.channels, noisy, strict=True)
    )
    exact = tuple(
        channel.name
        for channel, heard in zip(spectrum.channels, noisy, strict=True)
        if not heard and measures_input(model, channel)
    )
    return channels, exact
