"""Data of one rig beyond memory: every file identified by itself, long records in pieces, and the estimates merged."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtrc, chdtrc

from dashpot.arrays import Real
from dashpot.check.explain.examine import examined
from dashpot.check.verdict import (
    PERHAPS_UNSTABLE,
    rejected,
    unphysical,
    unstable,
    unstable_by_chance,
    worst_of,
)
from dashpot.data.conditioning.clock import cut
from dashpot.data.conditioning.whole_record import continuous
from dashpot.data.noise import LEVEL
from dashpot.data.readers import Reading, read
from dashpot.data.spectrum import Spectrum
from dashpot.errors import ConvergenceError, DashpotError, DataError
from dashpot.estimate.assessment import Assessment, Finding, Judgement
from dashpot.estimate.automatic import identify_with_noise
from dashpot.estimate.inference.uncertainty import linear_modes
from dashpot.estimate.result import MISFIT, Estimate, Fit
from dashpot.fleet.data_sets import Treatment
from dashpot.io.words import counted
from dashpot.model.network import Model
from dashpot.model.rigfile import Rig
from dashpot.notices import Notice
from dashpot.study.blocks import Map

# Estimates of one rig from data apart, merged: as if all data had been identified at once.
#
# For small noise −2 ln(likelihood) of each part is a parabola around its own estimate, known by that and
# its information, so that the parabolas add up without their data: what this loses goes with the share of
# noise in a part squared.


@dataclass(frozen=True)
class Merged:
    """One estimate of all parts, and how the parts scatter about it.

    estimate  without assessment
    chi2      χ² of the parts' estimates about the merged one, by their full covariances
    dof       its degrees of freedom, (parts − 1) × unknowns
    p         probability of a larger one if one rig is behind all parts
    away      (parts, unknowns)  how far each lies from the merged one, in standard deviations of the difference
    """

    estimate: Estimate
    chi2: float
    dof: int
    p: float
    away: Real

    @property
    def disagree(self) -> bool:
        """Whether the parts differ by more than their noise."""
        return self.p < LEVEL


def merge_estimates(model: Model, parts: Sequence[Estimate]) -> Merged:
    """Merge estimates of the same unknowns of `model` from data that share no noise; none has batch axes.

    Each counts by its information from the sensors' noise; priors count once.  Intervals are widened where those of the
    parts are, and where the parts scatter more than they promise.  Raises DataError if their unknowns or the signs
    of channels differ, or one does not determine the unknowns.
    """
    first = parts[0]
    for part in parts:
        if part.names != first.names:
            names = ", ".join(sorted(set(part.names) ^ set(first.names)))
            raise DataError(
                f"parts of the data estimate different unknowns ({names})", cure="identify them separately"
            )
        for channel, sign in first.signs.items():
            if float(part.signs[channel]) != float(sign):
                what = f"the sign of {channel} comes out differently in different parts of the data"
                cure = "was a sensor reversed? identify the parts before and after separately"
                raise DataError(what, cure=cure)
    scale, m = first.noise_sd, len(model.unknowns)
    free = np.array([part.free_values for part in parts]) / scale
    stated, sd = first.priors
    prior, mean = np.nan_to_num((scale / sd) ** 2), np.nan_to_num(stated / scale)
    precision = np.array([_inverse(part.noise_covariance / np.outer(scale, scale)) for part in parts])
    told = precision - np.diag(prior)  # by the data alone
    total = np.sum(told, axis=0) + np.diag(prior)
    weighted = np.einsum("pij,pj->pi", precision, free) - prior * mean
    theta = np.linalg.solve(total, np.sum(weighted, axis=0) + prior * mean)
    noise = _inverse(total)
    spread = np.array([part.covariance / np.outer(scale, scale) for part in parts])
    covariance = noise @ (np.einsum("pij,pjk,pkl->il", told, spread, told) + np.diag(prior)) @ noise
    off = free - theta
    scatter = float(np.einsum("pi,pij,pj->", off, np.array([_inverse(each) for each in spread]), off))
    apart = (len(parts) - 1) * len(scale)
    p = float(chdtrc(apart, scatter)) if apart else 1.0
    dof_of_intervals = np.sum([part.dof for part in parts], axis=0)
    if p < LEVEL:
        covariance = covariance * (scatter / apart)
        dof_of_intervals = np.minimum(dof_of_intervals, apart)
    widened = p < LEVEL or any(part.basis == MISFIT for part in parts)
    alone = np.maximum(np.diagonal(spread, axis1=-2, axis2=-1) - np.diagonal(noise), np.finfo(float).tiny)
    units = np.outer(scale, scale)
    theta, covariance, noise = theta * scale, (covariance if widened else noise) * units, noise * units
    chi2, dof = sum(float(part.fit.chi2) for part in parts), sum(part.fit.dof for part in parts)
    tested = all(np.isfinite(part.fit.p) for part in parts)
    p_of_fit = float(chdtrc(dof, chi2)) if tested else np.nan
    over_bound = np.mean([(part.bound_sd / part.noise_sd) ** 2 for part in parts], axis=0)
    estimate = replace(
        first,
        values=np.clip(theta, first.lower, first.upper),
        free_values=theta,
        covariance=covariance,
        noise_covariance=noise,
        bound_sd=np.sqrt(np.diagonal(noise) * over_bound),
        basis=MISFIT if widened else first.basis,
        dof=dof_of_intervals,
        converged=np.asarray(np.all([part.converged for part in parts])),
        iterations=np.sum([part.iterations for part in parts]),
        history=np.array([theta]),
        fit=Fit(np.array(chi2), dof, np.array(p_of_fit), all(part.fit.known_noise for part in parts)),
        modes=linear_modes(model, theta[:m], covariance[:m, :m]),
        warnings=_together([part.warnings for part in parts]),
        notes=_together([part.notes for part in parts]),
        assessment=None,
        profiles={},
    )
    return Merged(estimate, scatter, apart, p, off / np.sqrt(alone))


def _inverse(matrix: Real) -> Real:
    """Of a covariance whose diagonal is near 1.  Raises DataError if it is singular."""
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        inverse = np.full_like(matrix, np.nan)
    if not np.all(np.isfinite(inverse)):
        raise DataError("a part of the data does not determine the unknowns", cure="leave it out")
    return (inverse + inverse.T) / 2


def _together(each: Sequence[Sequence[Notice]]) -> tuple[Notice, ...]:
    """What is noticed in any part, once, and in how many it is where that is not all."""
    alike: dict[tuple[str, tuple[str, ...]], list[Notice]] = {}
    for notices in each:
        for key, notice in {(notice.code, notice.of): notice for notice in notices}.items():
            alike.setdefault(key, []).append(notice)
    return tuple(
        first
        if len(others) + 1 == len(each)
        else replace(first, text=f"{first.text} ({len(others) + 1} of {len(each)} parts)")
        for first, *others in alike.values()
    )


# What parts of the data of one rig, each identified and examined by itself, say together.


def merged_parts(model: Model, names: Sequence[str], parts: Sequence[Estimate]) -> Estimate:
    """One estimate from those of parts that share no noise, assessed; `names` says which part each is of.

    Raises DataError if they cannot be merged.
    """
    together = merge_estimates(model, parts)
    assessed = [part.assessment for part in parts if part.assessment is not None]
    disagreement = []
    if together.disagree:
        part, unknown = divmod(int(np.argmax(np.abs(together.away))), len(together.estimate.names))
        name, away = together.estimate.names[unknown], together.away[part, unknown]
        off = f"{abs(away):.3g} standard deviations {'above' if away > 0 else 'below'} the merged one"
        text = (
            f"the parts disagree by more than their noise (p = {together.p:.1g}): {name} of {names[part]} is "
            f"{off}"
        )
        disagreement = [Notice("parts_disagree", text, (name,))]
    against = [
        *unphysical(model, together.estimate),
        *unstable(together.estimate),
        *rejected(together.estimate),
        *disagreement,
        *_misfits(names, parts),
    ]
    doubts = [] if against else [*_common_doubts(assessed), *unstable_by_chance(together.estimate)]
    verdict: Judgement = "does not fit" if against else "cannot tell" if doubts else "fits"
    findings: tuple[Finding, ...] = ()
    if (
        against
    ):  # causes that parts name, those named by most first, and of these those that are named earlier
        named: dict[tuple[str, tuple[str, ...]], list[tuple[int, Finding]]] = {}
        for one in assessed:
            for place, finding in enumerate(one.findings):
                named.setdefault((finding.kind, finding.of), []).append((place, finding))
        each_first = [(len(alike), min(alike, key=lambda entry: entry[0])) for alike in named.values()]
        ordered = sorted(each_first, key=lambda entry: (-entry[0], entry[1][0]))
        findings = tuple(finding for _, (_, finding) in ordered)
    assessment = Assessment(
        verdict,
        (*against, *doubts),
        _over_parts([each.relative_residual for each in assessed]),
        worst_of(misfit for each in assessed for misfit in each.worst),
        findings,
        _over_parts([each.relative_noise for each in assessed]),
    )
    count = counted(len(together.away), "part")
    scatter = f"χ² {together.chi2:.4g} with {together.dof} degrees of freedom (p = {together.p:.2g})"
    text = f"{count} of the data were identified separately and merged; their scatter has {scatter}"
    return replace(
        together.estimate,
        assessment=assessment,
        notes=(Notice("parts_merged", text), *together.estimate.notes),
    )


def _misfits(names: Sequence[str], parts: Sequence[Estimate]) -> list[Notice]:
    """That more parts do not fit than sound ones would, and why most of these do not."""
    wrong = [
        (name, part.assessment)
        for name, part in zip(names, parts, strict=True)
        if part.assessment is not None and part.assessment.verdict == "does not fit"
    ]
    # 0.02 of sound parts that are taken for misfits, at the most
    if not wrong or bdtrc(len(wrong) - 1, len(parts), 0.02) > LEVEL:
        return []
    reasons = [(name, reason) for name, each in wrong for reason in each.reasons]
    ((most, _),) = Counter(reason.code for _, reason in reasons).most_common(1)
    name, reason = next((name, reason) for name, reason in reasons if reason.code == most)
    text = f"{len(wrong)} of {counted(len(parts), 'part')} do not fit on their own: {reason.text} ({name})"
    return [Notice("parts_misfit", text, reason.of)]


def _common_doubts(assessed: Sequence[Assessment]) -> list[Notice]:
    """Why it cannot be told whether the rig fits, where most parts cannot tell; stability is for all to show."""
    doubts = [
        [reason for reason in each.reasons if reason.code != PERHAPS_UNSTABLE]
        for each in assessed
        if each.verdict == "cannot tell"
    ]
    unsure = [reasons for reasons in doubts if reasons]
    if 2 * len(unsure) <= len(assessed):
        return []
    told = [reason for reasons in unsure for reason in reasons]
    ((most, _),) = Counter(reason.code for reason in told).most_common(1)
    return [next(reason for reason in told if reason.code == most)]


def _over_parts(shares: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The rms over the parts of a share of each channel's motion; of channels that all parts have."""
    names = [name for name in shares[0] if all(name in each for each in shares)] if shares else []
    return {name: float(np.sqrt(np.mean([each[name] ** 2 for each in shares]))) for name in names}


MOST_LINES = 250_000  # of a part: some 2 kB each are held while it is identified


@dataclass(frozen=True)
class FileTask:
    """A file of data of a rig."""

    rig: Rig
    treatment: Treatment
    path: str


@dataclass(frozen=True)
class FileParts:
    """What the parts of a file give: estimates with the parts' names, why others give none, and what was noticed."""

    path: str
    names: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    failures: tuple[DashpotError, ...]
    notes: tuple[Notice, ...]


def identify_in_parts(
    rig: Rig,
    paths: Sequence[str],
    treatment: Treatment,
    *,
    mapper: Map = map,
    progress: Callable[[int, int], None] | None = None,
) -> Estimate:
    """Identify every file by itself, by any `mapper`, and merge what they say; parts without an answer are named.

    The result is the same to the bit with any mapper.  Raises what the first file raises where none gives an estimate,
    DataError if the parts cannot be merged.
    """
    results: dict[str, FileParts] = {}
    for done in mapper(identify_file, (FileTask(rig, treatment, path) for path in paths)):
        results[done.path] = done
        if progress is not None:
            progress(len(results), len(paths))
    each = [results[path] for path in paths]
    failures, estimates, names, notes = (
        [entry for parts in each for entry in getattr(parts, kind)]
        for kind in ("failures", "estimates", "names", "notes")
    )
    if not estimates:
        raise failures[0]
    estimate = merged_parts(rig.model, names, estimates)
    if failures:
        text = f"{counted(len(failures), 'part')} left out, the first because {failures[0]}"
        estimate = replace(estimate, warnings=(*estimate.warnings, Notice("parts_left_out", text)))
    return replace(estimate, notes=tuple(dict.fromkeys((*estimate.notes, *notes))))


def identify_file(task: FileTask) -> FileParts:
    """Identify the parts of a file.  A function of the module, so that any process can be sent it."""
    names: list[str] = []
    estimates: list[Estimate] = []
    failures: list[DashpotError] = []
    notes: tuple[Notice, ...] = ()
    try:
        reading = read([task.path], task.rig.channels, frequency_hz=task.treatment.frequency_hz)
        notes = reading.notes
        for name, part in parts_of(task, reading):
            try:
                model, treatment = task.rig.model, task.treatment
                estimate, spectrum = identify_with_noise(
                    model, part, treatment.method, seed=treatment.seed, positive=treatment.positive
                )
                if not bool(estimate.converged):
                    what = f"{estimate.method} did not converge in {int(estimate.iterations)} iterations"
                    raise ConvergenceError(what, name, "leave it out")
                estimates.append(
                    examined(model, spectrum, estimate, seed=treatment.seed, within=task.rig.within)
                )
                names.append(name)
            except DashpotError as error:
                failures.append(error)
    except DashpotError as error:
        failures.append(error)
    return FileParts(task.path, tuple(names), tuple(estimates), tuple(failures), notes)


def parts_of(task: FileTask, reading: Reading) -> Iterator[tuple[str, Spectrum]]:
    """The lines of a file with their name; of continuous records that have very many, those of pieces, one at a time.

    How many lines the band has of a long record is asked of a piece of it.  Raises DataError if the samples cannot
    be used.
    """
    samples = sum(len(record.time) for record in reading.records)
    if not reading.continuous or samples <= 2 * MOST_LINES:
        yield task.path, task.treatment.spectrum(task.rig, reading)
        return
    records = continuous(reading.records)
    long = max(records, key=lambda record: len(record.time))
    begin = cut(long, 0.0, min(2 * MOST_LINES / len(long.time), 1.0))
    lines = task.treatment.spectrum(task.rig, replace(reading, records=(begin,))).lines
    lines_per_sample = lines / len(begin.time)
    if lines_per_sample * samples <= MOST_LINES:
        yield task.path, task.treatment.spectrum(task.rig, reading)
        return
    for number, record in enumerate(records):
        name = task.path if len(records) == 1 else f"{task.path}, record {number + 1}"
        count = math.ceil(lines_per_sample * len(record.time) / MOST_LINES)
        for k in range(count):
            piece = replace(reading, records=(cut(record, k / count, (k + 1) / count),))
            yield f"{name} ({k + 1} of {count})", task.treatment.spectrum(task.rig, piece)
