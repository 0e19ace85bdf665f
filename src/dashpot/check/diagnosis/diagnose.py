"""The verb: diagnose(model, spectrum) names what would make the rig fit, best first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arrays import diagonal_matrices, random_generator
from dashpot.check.diagnosis.causes import causes, directed_causes
from dashpot.check.diagnosis.channel_changes import (
    ChannelChange,
    RigChanges,
    channel_changes,
    record_changes,
    with_quiet_noise,
)
from dashpot.check.diagnosis.nonlinear_elements import MARKED, called_for, called_for_in_records
from dashpot.check.diagnosis.ranking import Cause, points_of
from dashpot.check.diagnosis.record_channels import mistakes_by_equation
from dashpot.check.diagnosis.search import Workbench
from dashpot.check.diagnosis.steady_lines import steady_lines
from dashpot.check.diagnosis.wording import finding, in_place_of_laws, nonlinear_finding
from dashpot.check.profile import with_profile_intervals
from dashpot.check.verdict import (
    BEYOND,
    UNTESTED,
    assess,
    rejected,
    settled_by_size,
    several_motions,
    silent_channels,
    with_change_in_time,
)
from dashpot.data.spectrum import FITTED, Spectrum
from dashpot.errors import DashpotError, ModelError
from dashpot.estimate.assessment import Assessment, Finding
from dashpot.estimate.identify import identify
from dashpot.estimate.inference.time_course import TIME_CHANGES, change_notice
from dashpot.estimate.likelihood.global_search import candidates
from dashpot.estimate.nonlinear.search import linear_rig, starting_points
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import observation_model
from dashpot.notices import Notice

LARGEST = 12  # coordinates of the rigs that are diagnosed: trials of larger ones take too long to wait for
PLAIN = (
    "sign",
    "unit",
    "swap",
    "two",
    "conjugate",
    "quantity",
    "frequency",
    "delay",
)  # mistakes of another kind
OF_THE_RIG = ("value", "element", "nonlinear")  # kinds of causes
LEFT_OUT = ("channel", "dwell")  # remedies that leave data out
MUCH = 0.2  # of a channel's motion, left over without known noise
SUPPOSED = 0.01  # of an amplitude: its noise where none is known
EXPLAINED = 0.1  # of χ² that a rig which is another one leaves at the most
LARGELY = 0.3  # of it that a fit without a channel leaves which is wrong in a way that has a name
SHOWN = 2.0  # χ² per degree of freedom of whole records below which their steady part shows no misfit


def diagnose(
    model: Model, spectrum: Spectrum, estimate: Estimate | None = None, *, seed: int = 0
) -> tuple[Finding, ...]:
    """Causes that would explain most of a misfit, the best first; () where nothing that was tried does.

    `spectrum` has no batch axes.  The estimate, where there is one, is one more start.  Nothing is applied.
    """
    return _misfit_and_causes(model, spectrum, estimate, seed)[1]


def _misfit_and_causes(
    model: Model, spectrum: Spectrum, estimate: Estimate | None, seed: int
) -> tuple[float, tuple[Finding, ...]]:
    """χ² per degree of freedom of the rig as it is on the lines that are diagnosed (NaN where none are), and causes."""
    backwards = _pushed_backwards(model, spectrum, estimate)
    if backwards or model.n > LARGEST:
        return np.nan, backwards
    if len(model.nonlinear):  # other remedies are tried on linear rigs
        return np.nan, _where_laws_are_seen(model, spectrum, estimate, np.inf)
    transients, runs = spectrum.carries_loads, len(spectrum.records)
    if transients:
        if not model.inputs:  # a free decay is nothing but a transient
            return np.nan, ()
        spectrum = steady_lines(model, spectrum)
    if not spectrum.noise_known:
        spectrum = _with_supposed_noise(model, spectrum)
    data = prepare(model, spectrum)
    middle, signs = candidates(data, 1, random_generator(seed))
    psi, sign = middle[0], signs[0]
    if estimate is not None and np.all(np.isfinite(estimate.values)):
        psi = estimate.values
        for name, turned in estimate.signs.items():
            sign[spectrum.index(name)] = float(turned)
    lines_are_runs = not transients or spectrum.lines <= runs
    silent = silent_channels(model, spectrum) if lines_are_runs else {}
    as_is, ranked_causes = causes(Workbench(data, psi, sign, lines_are_runs), silent, seed)
    if transients and as_is < SHOWN:
        return as_is, ()
    return as_is, tuple(finding(model, spectrum.channels, cause) for cause in ranked_causes)


def _with_supposed_noise(model: Model, spectrum: Spectrum) -> Spectrum:
    """Amplitudes without known noise with a little of their size.

    What a wrong rig leaves over, which else stands for it, lets every remedy explain all.
    """
    alone = observation_model(model, spectrum.channels, spectrum.omega).inputs_alone
    power = np.where(spectrum.present, np.abs(spectrum.amplitudes) ** 2, 0.0)
    mean = np.sum(power, axis=0) / np.maximum(np.sum(spectrum.present, axis=0), 1)
    V = diagonal_matrices(np.where(alone, 0.0, SUPPOSED**2 * (power + SUPPOSED * mean)))
    return replace(spectrum, covariance=V, noise=(FITTED,) * spectrum.lines)


def _pushed_backwards(model: Model, spectrum: Spectrum, estimate: Estimate | None) -> tuple[Finding, ...]:
    """A force that counts the other way: every part is negative and χ² the same, where forces alone set the scale."""
    forces = [channel for channel in spectrum.channels if set(channel.of) & set(model.force_inputs)]
    scaled = any(element.value for element in model.elements) or model.displacement_inputs
    if estimate is None or scaled or len(forces) != 1:
        return ()
    theta, sd = (values[: len(model.unknowns)] for values in (estimate.values, estimate.noise_sd))
    if not np.all(theta < -BEYOND * sd):
        return ()
    turned = Cause("sign", (forces[0].name,), float(estimate.fit.misfit) ** 2, -1.0)
    return (finding(model, spectrum.channels, turned),)


def examined(
    model: Model, spectrum: Spectrum, estimate: Estimate, *, seed: int = 0, within: float | None = None
) -> Estimate:
    """The estimate with its assessment, and a diagnosis where the rig does not fit; batches as they are.

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
    linear = not len(model.nonlinear)
    misfit = float(estimate.fit.misfit) ** 2
    elements_found = _nonlinear_elements(model, spectrum, estimate) if linear else ()
    if linear and (assessment.verdict == "does not fit" or not bool(estimate.converged)):
        assessment, elements_found = _diagnosed(model, spectrum, estimate, assessment, elements_found, seed)
    elif linear and not estimate.fit.known_noise and _leaves_much(assessment):
        assessment = _with_causes_of_much(model, spectrum, estimate, assessment, seed)
    elif not linear and (assessment.verdict == "does not fit" or not bool(estimate.converged)):
        others = _where_laws_are_seen(model, spectrum, estimate, misfit)
        others = others or _in_place_of_laws(model, spectrum, misfit, seed)
        assessment = replace(assessment, findings=(*assessment.findings, *others))
    if elements_found:
        assessment = _with_nonlinear_elements(assessment, elements_found, misfit)
    estimate, assessment = _without_changes_in_time(estimate, assessment)
    assessment = settled_by_size(assessment, within is not None)
    return _closed(model, spectrum, estimate, assessment)


def _leaves_much(assessment: Assessment) -> bool:
    """Whether much of a channel's motion is left over, which noise that is not known may be or a wrong rig."""
    return max(assessment.relative_residual.values(), default=0.0) > MUCH


def _with_causes_of_much(
    model: Model, spectrum: Spectrum, estimate: Estimate, assessment: Assessment, seed: int
) -> Assessment:
    """The assessment of a fit without known noise, which is none where a remedy explains most of what it leaves."""
    on_lines, causes_found = _misfit_and_causes(model, spectrum, estimate, seed)
    mended = [each for each in causes_found[:1] if each.kind not in LEFT_OUT]
    if not mended or not _left(mended[0]) < EXPLAINED * on_lines:
        return assessment
    name, left = max(assessment.relative_residual.items(), key=lambda each: each[1])
    text = f"{100 * left:.0f} % of the motion at {name} is left over, of which one remedy explains most"
    reasons = (Notice("much_left", text, (name,)), *(r for r in assessment.reasons if r.code not in UNTESTED))
    kept = tuple(reason for reason in reasons if reason.code != "below_noise")
    return replace(assessment, verdict="does not fit", reasons=kept, findings=causes_found)


def _diagnosed(
    model: Model, spectrum: Spectrum, estimate: Estimate, assessment: Assessment,
    elements_found: tuple[Finding, ...], seed: int,
) -> tuple[Assessment, tuple[Finding, ...]]:  # fmt: skip
    """The assessment with the causes that explain its misfit, and the nonlinear elements that are still called for."""
    misfit = float(estimate.fit.misfit) ** 2
    share = _left(elements_found[0]) / misfit if elements_found else 1.0
    on_lines, causes_found = (
        (misfit, ()) if share < EXPLAINED else _misfit_and_causes(model, spectrum, estimate, seed)
    )
    rigs = _other_rigs(model, spectrum, estimate) if share >= EXPLAINED else RigChanges()
    if rigs.left < EXPLAINED:
        causes_found = _with_rigs_first(model, spectrum, rigs, causes_found)
    leading = _parted(causes_found)[0]
    explained = rigs.left < EXPLAINED or bool(leading and _left(leading[0]) < SHOWN)
    wrong = None if explained else _wrong_channel(model, spectrum, estimate, rigs)
    if wrong is not None:
        return _with_wrong_channel(model, spectrum, assessment, wrong, causes_found), ()
    if rigs.left < min(EXPLAINED, share / 2) or _of_another_linear_rig(causes_found, on_lines, share):
        elements_found = ()
    elif share < 1 - MARKED:
        causes_found = ()
    assessment = replace(
        assessment,
        findings=_ranked(causes_found, assessment.findings, on_lines, surely=rigs.left < EXPLAINED),
    )
    return assessment, elements_found


def _other_rigs(model: Model, spectrum: Spectrum, estimate: Estimate) -> RigChanges:
    """Rigs with one linear part otherwise, fitted to whole records; none where there are none."""
    if not spectrum.carries_loads or model.n > LARGEST:
        return RigChanges()
    return record_changes(model, spectrum, estimate)


def _wrong_channel(
    model: Model, spectrum: Spectrum, estimate: Estimate, rigs: RigChanges
) -> ChannelChange | None:
    """The channel that is wrong, or changes, against all others, where the rig fits without it."""
    if not np.isfinite(rigs.as_is):
        return None
    excess = max(rigs.as_is - rigs.noise, 0.0)
    limits = rigs.noise + EXPLAINED * excess, rigs.noise + LARGELY * excess
    wrong = channel_changes(model, with_quiet_noise(spectrum)[0], estimate, *limits)
    return wrong[0] if wrong else None


def _with_wrong_channel(
    model: Model, spectrum: Spectrum, assessment: Assessment, wrong: ChannelChange, causes_found: tuple[Finding, ...]
) -> Assessment:  # fmt: skip
    """The assessment with that channel as its first cause; what else seems to change in time comes of it."""
    if wrong.change is not None:
        assessment = with_change_in_time(assessment, change_notice(wrong.change, len(spectrum.records)))
        first = assessment.findings[0]
    else:
        assert wrong.cause is not None
        reasons = tuple(reason for reason in assessment.reasons if reason.code not in TIME_CHANGES)
        assessment = replace(assessment, reasons=reasons or assessment.reasons)
        first = replace(finding(model, spectrum.channels, wrong.cause), remaining=None)
    others = (each for each in causes_found if each.of != first.of)
    return replace(assessment, findings=(first, *others))


def _with_rigs_first(
    model: Model, spectrum: Spectrum, rigs: RigChanges, causes_found: tuple[Finding, ...]
) -> tuple[Finding, ...]:
    """The causes with those rigs behind the plain mistakes that lead, in place of what coarser lines made of them."""
    leading, others = _parted(causes_found)
    others = tuple(each for each in others if each.kind not in ("value", "element"))
    return (*leading, *(finding(model, spectrum.channels, cause) for cause in rigs.causes), *others)


def _parted(causes_found: tuple[Finding, ...]) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """The plain mistakes that lead, and the rest."""
    leading = next((k for k, each in enumerate(causes_found) if each.kind not in PLAIN), len(causes_found))
    return causes_found[:leading], causes_found[leading:]


def _closed(model: Model, spectrum: Spectrum, estimate: Estimate, assessment: Assessment) -> Estimate:
    """The estimate with its assessment, of fits looked at closely, and with the intervals that suit it."""
    if not estimate.fit.known_noise:  # what a remedy leaves has no measure
        findings = tuple(replace(each, remaining=None) for each in assessment.findings)
        assessment = replace(assessment, findings=findings)
    if assessment.verdict == "fits" and not rejected(
        estimate
    ):  # scores over a noise that is too small prove nothing
        assessment = _looked_at_closely(model, spectrum, estimate, assessment)
    if len(model.nonlinear):
        estimate = replace(
            estimate, warnings=(*estimate.warnings, *several_motions(model, spectrum, estimate))
        )
    if assessment.verdict != "does not fit":
        estimate = with_profile_intervals(model, spectrum, estimate)
    return replace(estimate, assessment=assessment)


def _nonlinear_elements(model: Model, spectrum: Spectrum, estimate: Estimate) -> tuple[Finding, ...]:
    """Nonlinear elements that whole records call for, what explains most first."""
    if model.n > LARGEST:
        return ()
    misfit = float(estimate.fit.misfit) ** 2
    findings = []
    for scored in called_for_in_records(model, spectrum, estimate):
        points, left = points_of(scored.element, model), misfit * (1 - scored.fall / scored.chi2)
        findings.append(nonlinear_finding(model, points, scored.element, scored.value, left))
    return tuple(findings)


def _where_laws_are_seen(
    model: Model, spectrum: Spectrum, estimate: Estimate | None, misfit: float
) -> tuple[Finding, ...]:
    """Plain mistakes of channels, else elements beside the rig's own laws, of settled dwells that show all motion."""
    if spectrum.carries_loads or model.n > LARGEST:
        return ()
    data = prepare(model, spectrum)
    if data.states is None:
        return ()
    mistakes = mistakes_by_equation(data, misfit)
    if mistakes:
        return tuple(finding(model, spectrum.channels, cause) for cause in mistakes)
    known = estimate is not None and bool(np.all(np.isfinite(estimate.values)))
    psi = estimate.values if estimate is not None and known else starting_points(data)[0]
    (sign,) = spectrum.signs({} if estimate is None else estimate.signs)
    return tuple(
        nonlinear_finding(
            model,
            points_of(scored.element, model),
            scored.element,
            scored.value,
            (scored.chi2 - scored.fall) / scored.dof,
        )
        for scored in called_for(data, psi, sign, thorough=False)
    )


def _in_place_of_laws(model: Model, spectrum: Spectrum, misfit: float, seed: int) -> tuple[Finding, ...]:
    """Nonlinear elements that settled dwells call for where the rig's own are left out, and that leave less misfit."""
    if spectrum.carries_loads:
        return ()
    try:
        linear = linear_rig(model)
        estimate = identify(linear, spectrum, "ml")
        causes_found = _misfit_and_causes(linear, spectrum, estimate, seed)[1]
    except DashpotError:
        return ()
    return tuple(
        in_place_of_laws(model, each)
        for each in causes_found
        if each.kind == "nonlinear" and _left(each) < EXPLAINED * misfit
    )


def _with_nonlinear_elements(
    assessment: Assessment, elements_found: tuple[Finding, ...], misfit: float
) -> Assessment:
    """The assessment where whole records call for a nonlinear element, which stands behind plain mistakes alone.

    Clocks that slip, spikes and jumps are what a linear rig sees of it.
    """
    points, share = " and ".join(elements_found[0].of), 1 - _left(elements_found[0]) / misfit
    text = f"a nonlinear element between {points} explains {100 * share:.0f} % of the residuals (p < 1e-6)"
    leading = tuple(each for each in assessment.findings if each.kind in PLAIN)
    others = [each for each in assessment.findings if each.kind not in (*PLAIN, "nonlinear")]
    reasons = [each for each in assessment.reasons if each.code not in UNTESTED]
    return replace(
        assessment,
        verdict="does not fit",
        reasons=(Notice("nonlinear", text, elements_found[0].of), *reasons),
        findings=(*leading, *elements_found, *others),
    )


def _of_another_linear_rig(causes_found: tuple[Finding, ...], misfit: float, share: float) -> bool:
    """Whether a linear part that is missing or has another value explains nearly all of the `misfit`.

    Residuals of a wrong mass go with the motion, so that a nonlinear element explains much of them, but never as much:
    `share` is what it leaves.
    """
    left = [_left(each) / misfit for each in causes_found if each.kind in ("value", "element")]
    return min(left, default=np.inf) < min(EXPLAINED, share / 2)


def _left(tried: Finding) -> float:
    """χ² over its degrees of freedom with a remedy that was tried."""
    return np.inf if tried.remaining is None else tried.remaining


def _ranked(
    causes_found: tuple[Finding, ...], in_time: tuple[Finding, ...], misfit: float, *, surely: bool = False
) -> tuple[Finding, ...]:
    """What changes in the course of a record stands after the plain mistakes that lead, before all others.

    A rig that is another one leaves residuals that change as the motion does: where it explains nearly all of the
    `misfit` (χ² over its degrees of freedom on the lines that were diagnosed), it stands before them; `surely`: its
    fit to whole records has shown that.
    """
    plain, others = _parted(causes_found)
    rig = tuple(
        each for each in others if each.kind in OF_THE_RIG and (surely or _left(each) < EXPLAINED * misfit)
    )
    if not in_time or not rig:
        return (*plain, *in_time, *others)
    return (*plain, *rig, *(each for each in others if each not in rig), *in_time)


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


def _looked_at_closely(
    model: Model, spectrum: Spectrum, estimate: Estimate, assessment: Assessment
) -> Assessment:
    """The assessment of a fit, which is none where a gain, a delay or an element is off beyond doubt."""
    findings = tuple(
        finding(model, spectrum.channels, cause) for cause in directed_causes(model, spectrum, estimate)
    )
    if not findings:
        return assessment
    text = f"{findings[0].text}, too small for χ² to show, yet more than noise explains"
    reasons = (Notice("directed", text, findings[0].of), *assessment.reasons)
    return replace(assessment, verdict="does not fit", reasons=reasons, findings=findings)
