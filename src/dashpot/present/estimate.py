"""An estimate as a document: parameters, matrices and modes, and sentences on what they are worth."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from dashpot.estimate.assessment import Assessment, Discrepancy, Finding
from dashpot.estimate.likelihood.record_noise import INPUT_NOISE
from dashpot.estimate.linear.instrumental_variables import FreeMatrices
from dashpot.estimate.result import MISFIT, RESIDUALS, Cycle, Estimate, Fit, ModeValues
from dashpot.io.words import joined
from dashpot.model.matrix_elements import Letter
from dashpot.notices import Notice
from dashpot.present.document import (
    Document,
    Paragraph,
    Section,
    Table,
    TableColumn,
    Verdict,
    columns_of,
    printed,
    section,
)
from dashpot.present.words import (
    OPTIONS,
    aligned,
    alike,
    capitalised,
    flush,
    percent,
    plain,
    probability,
    sentence,
    short,
    value_and_sd,
    with_remedy,
)

BOUND_TEXT = "The bound is the smallest ± that any unbiased method can reach (Cramér-Rao)."
UNITS = {False: {"M": "kg", "C": "N·s/m", "K": "N/m"}, True: {"M": "kg·m²", "C": "N·m·s/rad", "K": "N·m/rad"}}
MOST_ROWS = 200  # of tied or of known parameters; of more the table shows the first few
FIRST_ROWS = 10
SAID_BY_THE_FIT = ("model_misfit", "unknown_noise")  # codes

Entry = TypeVar("Entry")


def estimate_document(
    estimate: Estimate,
    level: float = 0.95,
    *,
    untried: Collection[str] = tuple(OPTIONS),
    verbose: bool = False,
) -> Document:
    """What is printed of an estimate (no batch axes): verdict, causes, values, modes, warnings.

    `verbose` adds the bound, χ², the method and its iterations, the largest residuals and what ± means; `untried` as
    `warnings_in_words` has it.
    """
    dim = ["dim" if row.known else "" for row in parameter_rows(estimate, level)]
    converged, assessment = bool(estimate.converged), estimate.assessment
    failed = [] if converged else [Paragraph(convergence_in_words(estimate), "bold red")]
    causes = () if assessment is None else diagnosis_in_words(assessment.findings)
    warnings = [f"Warning: {text}" for text in warnings_in_words(estimate, untried=untried, coded=True)]
    if estimate.basis == MISFIT:
        warnings.insert(0, f"Warning: {basis_in_words(estimate)} [model_misfit]")
    # The verdict in per cent of the motion, then what else speaks against the fit, each with its code: before the
    # values where no cause is known, else behind them
    misfit = list[str]()
    if assessment is None:
        (verdict,) = fit_paragraphs(estimate)
    else:
        said, _, style = VERDICTS[assessment.verdict]
        missed = _share_missed(assessment)
        said = f"{said}{missed and ': '}{missed}."
        if causes:
            misfit = [f"Misfit: {sentence(each.text)} [{each.code}]" for each in _other_reasons(assessment)]
        else:
            said = " ".join([said, *reasons_in_words(estimate, assessment)])
        verdict = Paragraph(said, style)
    sections = [
        section("", *failed, verdict, *(Paragraph(line, "cyan") for line in causes)),
        section(
            "Parameters",
            Table(parameter_columns(estimate, level, bound=verbose), dim),
            Paragraph(left_out, "dim") if (left_out := left_out_in_words(estimate)) else None,
        ),
        section("Signs", signs_in_words(estimate)),
        section("Modes", mode_columns(estimate.modes) if has_modes(estimate) else None),
        section(CYCLES, *((CYCLES_TEXT, cycle_columns(estimate.cycles)) if estimate.cycles else ())),
        section("Misfit", *(Paragraph(text, style) for text in misfit)),
        section("Warnings", *(Paragraph(text, "yellow") for text in warnings)),
    ]
    if verbose:
        how = [convergence_in_words(estimate)] if converged else []
        numbers = [] if assessment is None else [residuals_in_words(estimate.fit), _of_motion(assessment)]
        about = remarks(estimate)[estimate.basis == MISFIT :]
        sections.append(section("Details", *how, *numbers, *about))
    return Document(estimate.model, tuple(each for each in sections if each.blocks))


def reasons_in_words(estimate: Estimate, assessment: Assessment) -> list[str]:
    """Reasons of the verdict other than the share of the motion and χ², each with its code."""
    reasons = _other_reasons(assessment)
    names = {*estimate.names, *assessment.relative_residual, *(name for r in reasons for name in r.of)}
    return [f"{capitalised(sentence(reason.text), names)} [{reason.code}]" for reason in reasons]


def _other_reasons(assessment: Assessment) -> list[Notice]:
    return [reason for reason in assessment.reasons if reason.code not in ("chi2", "discrepancy")]


def _share_missed(assessment: Assessment) -> str:
    """How much of the motion the model misses, in per cent: a bound where noise is known, else the difference."""
    for reason in assessment.reasons:
        if reason.code == "discrepancy":
            return reason.text.replace("the model", "it", 1)
    if (worst := _bound_missed(assessment)) is not None:
        share, name = worst
        where = f" (at {name})" if name else ""
        return f"apart from noise it misses at most {short(100 * share.upper95, 2)} % of the motion{where}"
    if not assessment.relative_residual:
        return ""
    name, most = max(assessment.relative_residual.items(), key=lambda each: each[1])
    where = f" at {name}" if len(assessment.relative_residual) > 1 else ""
    return f"measured and predicted motion differ by {short(100 * most, 2)} %{where}"


def estimate_text(estimate: Estimate) -> str:
    """What the command prints of an estimate; of a batch, one line."""
    if estimate.values.ndim > 1:
        return repr(estimate)
    return printed(estimate_document(estimate, untried=()))


# Sentences.


def convergence_in_words(estimate: Estimate) -> str:
    """Whether the iteration converged."""
    count = int(estimate.iterations)
    if not bool(estimate.converged):
        return f"{estimate.method}: NOT CONVERGED after {count} iterations; these are the values of the last one."
    how = "in closed form" if count == 0 else f"converged in {count} iteration{'' if count == 1 else 's'}"
    return f"{estimate.method}: {how}."


def remarks(estimate: Estimate) -> list[str]:
    """What ± and the bound are, which noise of inputs they count, and which intervals follow a profile."""
    noise = [sentence(capitalised(note.text)) for note in estimate.notes if note.code == INPUT_NOISE]
    texts = [basis_in_words(estimate), " ".join(noise), profiles_in_words(estimate)]
    if np.any(np.isfinite(estimate.bound_sd)):
        texts.append(BOUND_TEXT)
    return [text for text in texts if text]


def basis_in_words(estimate: Estimate, *, noise_only: bool = True) -> str:
    """What ± is, and what it includes; `noise_only`: whether a column of that name stands beside it."""
    if estimate.basis == MISFIT:
        other = "; 'noise only' assumes a perfect model and is too small here" if noise_only else ""
        return (
            "± is one standard deviation. It is widened for the misfit and covers what each likely cause would "
            f"change{other}."
        )
    if estimate.basis == RESIDUALS:
        return "± is one standard deviation, estimated from the scatter of the residuals."
    return "± is one standard deviation due to noise in the data."


def profiles_in_words(estimate: Estimate) -> str:
    """Which intervals are not symmetric, for they follow χ²; empty where all are normal."""
    names = list(estimate.profiles)
    if not names:
        return ""
    verb = "Profile interval" if len(names) == 1 else "Profile intervals"
    return f"{verb}: {joined(names)} (the interval is asymmetric, so ± misleads)."


def warnings_in_words(
    estimate: Estimate, *, untried: Collection[str] = tuple(OPTIONS), coded: bool = False
) -> tuple[str, ...]:
    """Warnings other than what fit and verdict say anyway, each with what to do about it.

    `untried`: treatments of time records that were not chosen; amplitudes are as they are.  `coded`: each ends with
    its code in brackets, by which the manual explains it.
    """
    said = dict.fromkeys(SAID_BY_THE_FIT, frozenset[str]())
    if estimate.assessment is not None:
        # A reason speaks for the warning of the same code, unless that concerns others than it names.
        said |= {notice.code: frozenset(notice.of) for notice in estimate.assessment.reasons}
        said |= {"reversed_phase": frozenset[str]()} if estimate.assessment.findings else {}
    return tuple(
        sentence(with_remedy(notice, untried=untried)) + (f" [{notice.code}]" if coded else "")
        for notice in estimate.warnings
        if notice.code not in said or (said[notice.code] and not said[notice.code].issuperset(notice.of))
    )


def left_out_in_words(estimate: Estimate) -> str:
    """How many parameters the table does not show; empty where it shows all."""
    parts = [
        f"{len(entries) - FIRST_ROWS:,} more that are {what}"
        for entries, what in ((estimate.tied, "tied"), (estimate.known, "known"))
        if len(entries) > MOST_ROWS
    ]
    return f"Not shown: {' and '.join(parts)}." if parts else ""


def signs_in_words(estimate: Estimate) -> str:
    """The signs of the channels whose sign was unknown; empty where there are none."""
    pairs = [f"{name} {'+' if float(sign) > 0 else '−'}" for name, sign in estimate.signs.items()]
    return f"Signs found: {', '.join(pairs)}." if pairs else ""


def aperiodic_in_words(rate: float) -> str:
    """What a mode without oscillation does, by its real eigenvalue in 1/s."""
    if rate == 0:
        return "moves freely, no restoring force"
    kind = "decays" if rate < 0 else "grows"
    return f"does not oscillate: {kind} in {short(1 / abs(rate))} s"


# Tables.


@dataclass(frozen=True)
class ParameterRow:
    """One parameter, as text; `known` are given, not found; `tie` names the unknown that it is a multiple of."""

    name: str
    value: str
    sd: str
    unit: str
    known: bool = False
    tie: str = ""
    share: str = ""
    low: str = ""
    high: str = ""
    bound: str = ""
    noise: str = ""


def parameter_rows(estimate: Estimate, level: float = 0.95) -> list[ParameterRow]:
    """Unknowns in order, then tied parameters, then known ones; digits as far as the sd allows."""
    everything = estimate.parameters()
    rows = []
    for name, low, high, noise in zip(
        estimate.names, *estimate.interval(level), estimate.noise_sd.tolist(), strict=True
    ):
        v = everything[name]
        shown = value_and_sd(v.value, v.sd)
        ends = alike((float(low), float(high)), v.sd)
        spread = percent(v.sd, v.value), *ends, short(v.bound_sd, 2), short(noise, 2)
        rows.append(ParameterRow(name, *shown, v.unit, False, "", *spread))
    for name, root, times, unit in _shown(estimate.tied):
        shown = value_and_sd(everything[name].value, everything[name].sd)
        tie = f"= {root}" if times == 1 else f"= {times:g} × {root}"
        rows.append(ParameterRow(name, *shown, unit, tie=tie))
    for name, number, unit in _shown(estimate.known):
        rows.append(ParameterRow(name, plain(number), "known", unit, known=True))
    return rows


def _shown(entries: Sequence[Entry]) -> Sequence[Entry]:
    """What a table shows of tied or known parameters: all of some, the first of the many that a large rig has."""
    return entries if len(entries) <= MOST_ROWS else entries[:FIRST_ROWS]


def parameter_columns(
    estimate: Estimate, level: float = 0.95, *, bound: bool = True, noise: bool = True
) -> list[TableColumn]:
    """Name, value, ±, unit, relative ±, interval; `bound`: also the bound; `noise`: of a misfit the ± of noise only."""
    rows = parameter_rows(estimate, level)
    low, high = (max((len(getattr(row, end)) for row in rows), default=0) for end in ("low", "high"))
    # ±, and whether the fit, on whose residuals it rests, could be tested
    spread = "±, not\ntested>" if estimate.basis == RESIDUALS else "±>"
    heads = ["parameter", "value>", spread, "unit", "± %>", f"{100 * level:g} % interval^"]
    bounded = bound and bool(np.any(np.isfinite(estimate.bound_sd)))
    optional = {"±, noise\nonly>": noise and estimate.basis == MISFIT, "bound>": bounded}
    texts = []
    for row in rows:
        interval = f"{row.low.rjust(low)} … {row.high.ljust(high)}" if row.low else row.tie
        unit = "" if row.unit == "1" else row.unit
        more = [text for text, there in zip((row.noise, row.bound), optional.values(), strict=True) if there]
        texts.append((row.name, row.value, row.sd, unit, row.share, interval, *more))
    return columns_of([*heads, *(head for head, there in optional.items() if there)], texts)


def spread_columns(estimate: Estimate) -> list[TableColumn]:
    """± of each unknown, of a misfit also that of noise only, and the bound where it is known."""
    rows = [row for row in parameter_rows(estimate) if row.share]
    columns = [("unknown", [row.name for row in rows]), ("±>", [row.sd for row in rows])]
    if estimate.basis == MISFIT:
        columns.append(("±, noise only>", [row.noise for row in rows]))
    if np.any(np.isfinite(estimate.bound_sd)):
        columns.append(("bound>", [row.bound for row in rows]))
    columns.append(("unit", ["" if row.unit == "1" else row.unit for row in rows]))
    heads, texts = zip(*columns, strict=True)
    return columns_of(heads, zip(*texts, strict=True))


STATED = "What was stated"
STATED_TEXT = (
    "Pull: how far the data move a stated value, in its standard deviations; beyond 3 the two disagree. "
    "'costs': the share of a variance that would vanish if the stated value were exact."
)


def stated_columns(estimate: Estimate) -> list[TableColumn]:
    """Each statement with an sd, what the data made of it, its pull, and the unknowns that it costs most."""
    rows = []
    for (name, value, sd), pull in zip(
        estimate.stated, estimate.pulls[~np.isnan(estimate.pulls)].tolist(), strict=True
    ):
        found = estimate[name]
        # 3: unknowns named with a statement, where it costs them at least 5 % of their variance
        costs = [cost for cost in estimate.costs if cost.of == name and cost.share > 0.05][:3]
        unit = "" if found.unit == "1" else found.unit
        told = joined([f"{100 * cost.share:.0f} % of {cost.on}" for cost in costs])
        rows.append(
            (name, *value_and_sd(value, sd), *value_and_sd(found.value, found.sd), unit, f"{pull:+.1f}", told)
        )
    return columns_of(["stated", "value>", "±>", "estimate>", "±>", "unit", "pull>", "costs"], rows)


def has_modes(estimate: Estimate) -> bool:
    """Whether there are modes to show."""
    return estimate.modes is not None and len(estimate.modes.eigenvalues) > 0


def mode_columns(modes: ModeValues | None) -> list[TableColumn]:
    """Natural frequencies and damping ratios with their standard deviations; modes that do not oscillate."""
    assert modes is not None
    rows = []
    for k, eigenvalue in enumerate(modes.eigenvalues.tolist()):
        if eigenvalue.imag == 0:
            rows.append(("–", "", "–", "", aperiodic_in_words(eigenvalue.real)))
            continue
        frequency = value_and_sd(float(modes.frequency_hz[k]), float(modes.frequency_sd[k]))
        damping = value_and_sd(float(modes.damping_ratio[k]), float(modes.damping_sd[k]))
        rows.append((*frequency, *damping, "unstable" if eigenvalue.real > 0 else ""))
    *numbers, remarks = zip(*rows, strict=True)
    texts = [[str(k + 1) for k in range(len(rows))], *map(aligned, numbers), remarks]
    heads = ["mode>", "frequency, Hz>", "±>", "damping ratio>", "±>", ""]
    columns = columns_of(heads, zip(*texts, strict=True))
    return columns if any(remarks) else columns[:-1]


CYCLES = "Cycles of motion"
CYCLES_TEXT = (
    "Energy per cycle, equivalent stiffness and equivalent viscous damping in the motion of these data (of "
    "continuous records: in sines as large and as fast)."
)


def cycle_columns(cycles: Sequence[Cycle]) -> list[TableColumn]:
    """A row for each of the first 30 cycles, SI units but mm; of several specimens their elements first."""
    cycles = cycles[:30]
    angular = cycles[0].unit == "rad"
    units = ("N·m/rad", "N·m·s/rad") if angular else ("N/m", "N·s/m")
    rows = []
    for cycle in cycles:
        pairs = [
            value_and_sd(getattr(cycle, name), getattr(cycle, f"{name}_sd"))
            for name in ("energy", "stiffness", "damping")
        ]
        size = cycle.amplitude * (1.0 if cycle.unit == "rad" else 1e3)
        numbers = [text for pair in pairs for text in pair]
        rows.append(("+".join(cycle.elements), short(cycle.frequency_hz, 4), short(size, 4), *numbers))
    texts = list(zip(*rows, strict=True))
    heads = ["elements", "Hz>", f"{'rad' if angular else 'mm'}>"]
    heads += ["energy, J>", "±>", f"stiffness, {units[0]}>", "±>", f"damping, {units[1]}>", "±>"]
    shown = texts[:1] + [tuple(aligned(column)) for column in texts[1:]]
    columns = columns_of(heads, zip(*shown, strict=True))
    return columns if len(set(texts[0])) > 1 else columns[1:]


def matrix_sections(matrices: FreeMatrices, angular: bool = False) -> tuple[Section, ...]:
    """Every matrix that was found, its upper triangle, value ± standard deviation."""
    letters = dict.fromkeys(letter for letter, _, _ in matrices.entries)
    return tuple(
        section(letter, matrix_columns(matrices, letter, UNITS[angular][letter])) for letter in letters
    )


def matrix_columns(matrices: FreeMatrices, letter: Letter, unit: str) -> list[TableColumn]:
    """Coordinates, then a column of the upper triangle for each."""
    values, sd = getattr(matrices, letter), matrices.sd(letter)
    free = {(i, j) for which, i, j in matrices.entries if which == letter}
    columns = [TableColumn(f"{letter}, {unit}", tuple(matrices.coordinates))]
    for j, name in enumerate(matrices.coordinates):
        pairs = [value_and_sd(values[i, j], sd[i, j]) if (i, j) in free else ("0", "") for i in range(j + 1)]
        values_shown = flush([value for value, _ in pairs])
        texts = [
            f"{value} ± {spread}" if spread else value
            for value, (_, spread) in zip(values_shown, pairs, strict=True)
        ]
        columns.append(TableColumn(name, (*texts, *[""] * (len(matrices.coordinates) - j - 1))))
    return columns


# The verdict on a fit and the diagnosis of a misfit, in sentences.


# In words, for a page, and the style on a terminal.
VERDICTS: dict[str, tuple[str, Verdict, str]] = {
    "fits": ("The model fits", "good", "green"),
    "does not fit": ("The model does not fit", "bad", "bold red"),
    "cannot tell": ("The fit cannot be tested", "open", "yellow"),
}


def is_tested(fit: Fit) -> bool:
    """Whether χ² can test the fit at all."""
    return fit.known_noise and fit.dof > 0


def fit_in_words(fit: Fit) -> str:
    """What χ² says, in one sentence."""
    if fit.dof <= 0:
        return "There are as many unknowns as measurements, so the fit cannot be tested."
    if not fit.known_noise:
        return (
            f"The noise is not known; it is estimated from the residuals ({fit.dof} degrees of freedom), so the "
            "fit cannot be tested."
        )
    if not math.isfinite(float(fit.p)):
        return f"The fit cannot be tested: {_chi2(fit)}."
    ratio = short(float(fit.misfit), 2)
    if bool(fit.rejected):
        return f"The model does not fit: residuals are {ratio} × the noise ({_chi2(fit)})."
    if float(fit.p) > 0.999:
        return (
            f"Residuals are only {ratio} × the stated noise ({_chi2(fit, p=False)}): the stated noise is too "
            "large, and so are the intervals."
        )
    return f"The model fits: residuals are {ratio} × the noise ({_chi2(fit)})."


def _chi2(fit: Fit, *, p: bool = True) -> str:
    """χ², its degrees of freedom, and how likely a larger one is, where that is known."""
    numbers = f"χ² = {short(float(fit.chi2))}, {fit.dof} degrees of freedom"
    likely = probability(float(fit.p))
    if not p or not math.isfinite(float(fit.p)):
        return numbers
    return f"{numbers}, {f'p {likely}' if likely.startswith('<') else f'p = {likely}'}"


def verdict_in_words(fit: Fit, assessment: Assessment) -> str:
    """The verdict with its reasons, and χ²."""
    reasons = "; ".join(notice.text for notice in assessment.reasons if notice.code != "chi2")
    why = "; ".join(part for part in (reasons, _residuals(fit)) if part)
    return f"{VERDICTS[assessment.verdict][0]}{why and ': '}{why}."


def _residuals(fit: Fit) -> str:
    """How large the residuals are, with χ²; empty where that cannot be tested."""
    return f"residuals are {short(float(fit.misfit), 2)} × the noise ({_chi2(fit)})" if is_tested(fit) else ""


def fit_paragraphs(estimate: Estimate) -> list[Paragraph]:
    """What is known of the fit: the verdict with its likely causes where it was assessed, else χ²."""
    fit, assessment = estimate.fit, estimate.assessment
    if assessment is None:
        style = ("red" if bool(fit.rejected) else "green") if is_tested(fit) else ""
        return [Paragraph(fit_in_words(fit), style)]
    said = Paragraph(verdict_in_words(fit, assessment), VERDICTS[assessment.verdict][2])
    motion = Paragraph(_of_motion(assessment))
    causes = [Paragraph(line, "cyan") for line in diagnosis_in_words(assessment.findings)]
    return [said, *([motion] if motion.text else []), *causes]


def residuals_in_words(fit: Fit) -> str:
    """How large the residuals are, with χ²; empty where that cannot be tested."""
    size = _residuals(fit)
    return capitalised(sentence(size)) if size else ""


def worst_in_words(assessment: Assessment) -> str:
    """Where the largest residuals are; empty where none were named."""
    worst = [
        f"{one.channel} at {short(one.frequency_hz, 4)} Hz ({short(one.sd, 2)} sd)"
        for one in assessment.worst
    ]
    return f"Largest residuals: {joined(worst)}." if worst else ""


def _of_motion(assessment: Assessment) -> str:
    return " ".join(filter(None, (motion_in_words(assessment), worst_in_words(assessment))))


def motion_in_words(assessment: Assessment) -> str:
    """How far measured and predicted amplitudes differ, and what of it is noise."""
    parts = [f"{short(100 * part, 2)} % at {name}" for name, part in assessment.relative_residual.items()]
    noise, alone = assessment.relative_noise.values(), ""
    if noise:
        low, high = (f"{short(100 * size, 2)} %" for size in (min(noise), max(noise)))
        shares = [f"{short(100 * size, 2)} %" for size in noise]
        alike = low if low == high else f"{low.removesuffix(' %')} to {high}"
        # figures within a quarter of each other are a range
        alone = (
            f"; noise alone would account for {alike if max(noise) <= 1.25 * min(noise) else joined(shares)}"
        )
    sentences = [f"Measured and predicted motion differ by {joined(parts)}{alone}."] if parts else []
    worst = _bound_missed(assessment)
    if worst is not None and worst[0].lower95 > 0:  # more of it is known than the bound in the verdict
        value, bound = (f"{short(100 * size, 2)} %" for size in (worst[0].value, worst[0].upper95))
        most = f"{value}, and at most {bound} (95 % bound) of the motion"
        sentences.append(f"Apart from noise, the model misses {most}{worst[1] and f' at {worst[1]}'}.")
    return " ".join(sentences)


def headline(estimate: Estimate, unsure: Sequence[str]) -> str:
    """Whether to trust the answer, in one sentence."""
    if not bool(estimate.converged):
        return "No answer: the search did not converge. The values below are those of the last step."
    poor = [name for name in unsure if "." not in name]
    names = joined(poor[:4]) + (" and others" if len(poor) > 4 else "")
    rest = f" {names} {'is' if len(poor) == 1 else 'are'} poorly determined." if poor else ""
    assessment = estimate.assessment
    if assessment is None:
        return fit_in_words(estimate.fit) + rest
    how = _share_missed(assessment)
    said = sentence(f"{VERDICTS[assessment.verdict][0]}{how and ': '}{how}")
    if assessment.verdict == "does not fit":
        why = f" Likely cause: {sentence(assessment.cause.text)}" if assessment.cause else ""
        return f"{said}{why} Do not rely on these values as they are.{rest}"
    return said + rest


def page_verdict(estimate: Estimate) -> Verdict:
    """Whether an estimate is good, bad, or open."""
    if not bool(estimate.converged):
        return "bad"
    if estimate.assessment is not None:
        return VERDICTS[estimate.assessment.verdict][1]
    if not is_tested(estimate.fit):
        return "open"
    return "bad" if bool(estimate.fit.rejected) else "good"


def _bound_missed(assessment: Assessment) -> tuple[Discrepancy, str] | None:
    """What the model misses of a motion beyond noise, at most, and at which of several channels; None where not known
    of each."""
    shares = {name: share for name, share in assessment.discrepancy.items() if share is not None}
    if not shares or len(shares) < len(assessment.discrepancy) or assessment.verdict == "does not fit":
        return None
    name, share = max(shares.items(), key=lambda each: each[1].upper95)
    return share, name if len(shares) > 1 else ""


def diagnosis_in_words(findings: tuple[Finding, ...]) -> list[str]:
    """A line for each of the most probable causes, with its odds and what to do about it."""
    lines = []
    # Another factor of the same channel, as good, is no other cause
    factors = {(each.of, each.group): each for each in reversed(findings) if each.kind in ("unit", "gain")}
    told = [
        each for each in findings if each is factors.get((each.of, each.group), each) or each.group is None
    ]
    for rank, finding in enumerate(told[:3]):  # the most probable and two more
        group = findings[0].group is not None and finding.group == findings[0].group
        lead = "Likely cause" if rank == 0 else "Or, fitting these data equally well" if group else "Or"
        if finding.beside:
            lead = "In addition"
        odds = "" if finding.odds is None else f" (odds {percent_of_odds(finding.odds)})"
        if finding.kind == "unexplained":
            lead, odds = ("An unlisted cause", odds) if len(findings) > 1 else ("No cause found", "")
        stop = "" if finding.change.endswith("}") else "."  # a line of a rig file is to be copied as it is
        outlook = remaining_in_words(finding)
        parts = (
            f"{lead}{odds}: {sentence(finding.text)}",
            outlook and capitalised(sentence(outlook)),
            f"To change: {finding.change}{stop}",
        )
        lines.append(" ".join(part for part in parts if part))
    return lines


def percent_of_odds(odds: float) -> str:
    """Odds in per cent, never more certain than they can be kept."""
    return "over 99 %" if odds >= 0.99 else "under 1 %" if odds <= 0.01 else f"{100 * odds:.0f} %"


def remaining_in_words(finding: Finding) -> str:
    """What residuals the remedy would leave; nothing where it was not tried."""
    if finding.remaining is None:
        return ""
    return f"residuals would fall to {short(max(finding.remaining, 0.0) ** 0.5, 2)} × the noise"
