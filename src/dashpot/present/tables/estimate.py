"""An estimate as text: parameters, modes, fit, warnings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from rich.cells import cell_len
from rich.console import Console

from dashpot.estimate.linear.definite import FreeMatrices
from dashpot.estimate.result import MISFIT, RESIDUALS, Estimate, Fit, ModeValues
from dashpot.model.unstructured import Letter
from dashpot.present.notices import OPTIONS
from dashpot.present.tables.layout import (
    TableColumn,
    html_paragraph,
    html_table,
    printed,
    show_paragraph,
    show_table,
)
from dashpot.present.text.assessment import diagnosis_in_words, motion_in_words, verdict_in_words
from dashpot.present.text.estimate import (
    aperiodic_in_words,
    basis_in_words,
    bound_in_words,
    convergence_in_words,
    fit_in_words,
    inputs_in_words,
    profiles_in_words,
    warnings_in_words,
)
from dashpot.present.text.numbers import aligned, alike, percent, plain, rounded, short

# M, C and K with their standard deviations, for a terminal.


UNITS = {False: {"M": "kg", "C": "N·s/m", "K": "N/m"}, True: {"M": "kg·m²", "C": "N·m·s/rad", "K": "N·m/rad"}}


def show_matrices(console: Console, matrices: FreeMatrices, angular: bool = False) -> None:
    """Every matrix that was found, its upper triangle, value ± standard deviation; as many columns as fit."""
    for letter in dict.fromkeys(letter for letter, _, _ in matrices.entries):
        console.print()
        show_table(console, matrix_columns(matrices, letter, UNITS[angular][letter]))


def matrix_columns(matrices: FreeMatrices, letter: Letter, unit: str) -> list[TableColumn]:
    """Coordinates, then a column of the upper triangle for each."""
    values, sd = getattr(matrices, letter), matrices.sd(letter)
    free = {(i, j) for which, i, j in matrices.entries if which == letter}
    columns = [TableColumn(f"{letter}, {unit}", tuple(matrices.coordinates))]
    for j, name in enumerate(matrices.coordinates):
        pairs = [rounded(values[i, j], sd[i, j]) if (i, j) in free else ("0", "") for i in range(j + 1)]
        left = aligned([value for value, _ in pairs])
        widest = max(map(cell_len, left))
        texts = [
            f"{value.rjust(widest)} ± {spread}" if spread else value.rjust(widest)
            for value, (_, spread) in zip(left, pairs, strict=True)
        ]
        columns.append(TableColumn(name, (*texts, *[""] * (len(matrices.coordinates) - j - 1))))
    return columns


MOST_ROWS = 200  # of tied or of known parameters; of more the table shows the first few
FIRST_ROWS = 10

Entry = TypeVar("Entry")


@dataclass(frozen=True)
class ParameterRow:
    """One parameter, as text; `known` are given, not found; `tie` says of which unknown it is a multiple."""

    name: str
    value: str
    sd: str
    share: str
    low: str
    high: str
    bound: str
    noise: str
    unit: str
    known: bool
    tie: str = ""


def parameter_rows(estimate: Estimate, level: float = 0.95) -> list[ParameterRow]:
    """Unknowns in order, then tied parameters, then known ones; digits as far as the sd allows."""
    low, high = (dict(zip(estimate.names, ends.tolist(), strict=True)) for ends in estimate.interval(level))
    noise = dict(zip(estimate.names, estimate.noise_sd.tolist(), strict=True))
    everything = estimate.parameters()
    rows = []
    for name in estimate.names:
        v = everything[name]
        value, sd = rounded(v.value, v.sd)
        ends = alike((low[name], high[name]), v.sd)
        rows.append(
            ParameterRow(
                name, value, sd, percent(v.sd, v.value), ends[0], ends[1], short(v.bound_sd, 2),
                short(noise[name], 2), v.unit, False,
            )
        )  # fmt: skip
    for name, root, times, unit in shown_of(estimate.tied):
        v = everything[name]
        value, sd = rounded(v.value, v.sd)
        tie = f"= {root}" if times == 1 else f"= {times:g} × {root}"
        rows.append(ParameterRow(name, value, sd, "", "", "", "", "", unit, False, tie))
    for name, number, unit in shown_of(estimate.known):
        rows.append(ParameterRow(name, plain(number), "known", "", "", "", "", "", unit, True))
    return rows


def shown_of(entries: Sequence[Entry]) -> Sequence[Entry]:
    """What a table shows of tied or known parameters: all of some, the first of the many that a large rig has."""
    return entries if len(entries) <= MOST_ROWS else entries[:FIRST_ROWS]


def left_out_in_words(estimate: Estimate) -> str:
    """How many parameters the table does not show; empty where it shows all."""
    parts = [
        f"{len(entries) - FIRST_ROWS:,} more that are {what}"
        for entries, what in ((estimate.tied, "tied"), (estimate.known, "known"))
        if len(entries) > MOST_ROWS
    ]
    return f"Not shown: {' and '.join(parts)}." if parts else ""


def parameter_columns(estimate: Estimate, level: float = 0.95) -> list[TableColumn]:
    """Name, value, unit, ±, relative ±, interval, bound; where the model does not fit, also the ± of noise only."""
    rows = parameter_rows(estimate, level)
    low, high = (max((len(getattr(row, end)) for row in rows), default=0) for end in ("low", "high"))
    intervals = [f"{row.low.rjust(low)} … {row.high.ljust(high)}" if row.low else row.tie for row in rows]
    # ±, and whether the fit, on whose residuals it rests, could be tested
    columns = [
        TableColumn("parameter", tuple(row.name for row in rows)),
        TableColumn("value", tuple(row.value for row in rows), "right"),
        TableColumn(
            "±, not\ntested" if estimate.basis == RESIDUALS else "±", tuple(row.sd for row in rows), "right"
        ),
        TableColumn("unit", tuple("" if row.unit == "1" else row.unit for row in rows)),
        TableColumn("± %", tuple(row.share for row in rows), "right"),
        TableColumn(f"{100 * level:g} % interval", tuple(intervals), "center"),
    ]
    if estimate.basis == MISFIT:
        columns.append(TableColumn("±, noise\nonly", tuple(row.noise for row in rows), "right"))
    if np.any(np.isfinite(estimate.bound_sd)):
        columns.append(TableColumn("bound", tuple(row.bound for row in rows), "right"))
    return columns


def mode_columns(modes: ModeValues) -> list[TableColumn]:
    """Natural frequencies and damping ratios with their standard deviations; modes that do not oscillate."""
    rows = []
    for k, eigenvalue in enumerate(modes.eigenvalues.tolist()):
        if eigenvalue.imag == 0:
            rows.append(("–", "", "–", "", aperiodic_in_words(eigenvalue.real)))
            continue
        f, f_sd = rounded(float(modes.frequency_hz[k]), float(modes.frequency_sd[k]))
        z, z_sd = rounded(float(modes.damping_ratio[k]), float(modes.damping_sd[k]))
        rows.append((f, f_sd, z, z_sd, "unstable" if eigenvalue.real > 0 else ""))
    frequency, frequency_sd, damping, damping_sd, remarks = zip(*rows, strict=True)
    columns = [TableColumn("mode", tuple(str(k + 1) for k in range(len(rows))), "right")]
    pairs = (("frequency, Hz", frequency), ("±", frequency_sd), ("damping ratio", damping), ("±", damping_sd))
    columns += [TableColumn(title, tuple(aligned(texts)), "right") for title, texts in pairs]
    if any(remarks):
        columns.append(TableColumn("", remarks))
    return columns


def show_estimate(
    out: Console, estimate: Estimate, level: float = 0.95, *, untried: Collection[str] = tuple(OPTIONS)
) -> None:
    """Print an estimate (no batch axes); `untried` as `warnings_in_words` has it."""
    out.print()
    if estimate.model:
        show_paragraph(out, estimate.model, "bold")
    show_paragraph(out, convergence_in_words(estimate), "" if bool(estimate.converged) else "bold red")
    out.print()
    known = ["dim" if row.known else "" for row in parameter_rows(estimate, level)]
    show_table(out, parameter_columns(estimate, level), known)
    if left_out_in_words(estimate):
        show_paragraph(out, left_out_in_words(estimate), "dim")
    if estimate.signs:
        out.print()
        show_paragraph(out, signs_in_words(estimate))
    if has_modes(estimate):
        assert estimate.modes is not None
        out.print()
        show_table(out, mode_columns(estimate.modes))
    out.print()
    for text, style in fit_paragraphs(estimate):
        show_paragraph(out, text, style)
    for text in remarks(estimate):
        show_paragraph(out, text)
    for warning in warnings_in_words(estimate, untried=untried):
        show_paragraph(out, f"Warning: {warning}", "yellow")


def fit_paragraphs(estimate: Estimate) -> list[tuple[str, str]]:
    """What is known of the fit: the verdict with its likely causes where it was assessed, else χ²; text and style."""
    fit, assessment = estimate.fit, estimate.assessment
    if assessment is None:
        return [(fit_in_words(fit), _colour(fit))]
    colour = {"fits": "green", "does not fit": "bold red", "cannot tell": "yellow"}[assessment.verdict]
    paragraphs = [(verdict_in_words(fit, assessment), colour), (motion_in_words(assessment), "")]
    paragraphs += [(line, "cyan") for line in diagnosis_in_words(assessment.findings)]
    return [(text, style) for text, style in paragraphs if text]


def remarks(estimate: Estimate) -> Sequence[str]:
    """What ± and the bound are, which noise of inputs they count, and which intervals follow a profile."""
    texts = (
        basis_in_words(estimate),
        inputs_in_words(estimate),
        profiles_in_words(estimate),
        bound_in_words(estimate),
    )
    return [text for text in texts if text]


def has_modes(estimate: Estimate) -> bool:
    """Whether there are modes to show."""
    return estimate.modes is not None and len(estimate.modes.eigenvalues) > 0


def signs_in_words(estimate: Estimate) -> str:
    """The signs of the channels whose sign was unknown."""
    pairs = (f"{name} {'+' if float(sign) > 0 else '−'}" for name, sign in estimate.signs.items())
    return f"Signs found: {', '.join(pairs)}."


def estimate_text(estimate: Estimate, level: float = 0.95) -> str:
    """What the command prints of an estimate; of a batch, one line."""
    if estimate.values.ndim > 1:
        return repr(estimate)
    return printed(lambda out: show_estimate(out, estimate, level, untried=()))


def estimate_html(estimate: Estimate, level: float = 0.95) -> str:
    """The same as HTML, for a notebook."""
    parts = [html_paragraph(convergence_in_words(estimate))]
    parts.append(html_table(parameter_columns(estimate, level), estimate.model))
    if has_modes(estimate):
        assert estimate.modes is not None
        parts.append(html_table(mode_columns(estimate.modes)))
    texts = [*(text for text, _ in fit_paragraphs(estimate)), *remarks(estimate)]
    texts += [f"Warning: {warning}" for warning in warnings_in_words(estimate, untried=())]
    return "".join([*parts, *map(html_paragraph, texts)])


def _colour(fit: Fit) -> str:
    if not fit.known_noise or fit.dof <= 0:
        return ""
    return "red" if bool(fit.rejected) else "green"
