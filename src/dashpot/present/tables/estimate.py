"""Tables for a terminal: parameters, modes, fit."""

from __future__ import annotations

import math
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from rich import box
from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

from dashpot.data.spectrum import Spectrum
from dashpot.estimate.assessment import Assessment
from dashpot.estimate.result import Estimate, Fit, ModeValues
from dashpot.io.words import joined
from dashpot.present.text.assessment import diagnosis_in_words, motion_in_words, verdict_in_words
from dashpot.present.text.notices import with_remedy
from dashpot.present.text.numbers import aligned, alike, percent, plain, probability, rounded, short

WIDTH = 80
MISFIT = "model misfit"
NOISE_ONLY = "± sensor\nnoise only"
JUSTIFY: Mapping[str, JustifyMethod] = {
    "value": "right", "±": "right", NOISE_ONLY: "right", "± %": "right", "bound": "right", "unit": "left",
}  # fmt: skip


def console() -> Console:
    """Where tables go: the terminal as wide as it is, else 80 columns without colour."""
    width = None if sys.stdout.isatty() else WIDTH
    return Console(width=width, highlight=False, emoji=False, markup=False)


@dataclass(frozen=True)
class Row:
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


def parameter_rows(estimate: Estimate, level: float = 0.95) -> list[Row]:
    """Unknowns in order, then tied parameters, then known ones; digits as far as the sd allows."""
    low, high = (dict(zip(estimate.names, ends.tolist(), strict=True)) for ends in estimate.interval(level))
    noise = dict(zip(estimate.names, estimate.noise_sd.tolist(), strict=True))
    everything = estimate.parameters()
    rows = []
    for name in estimate.names:
        v = everything[name]
        rows.append(_row(name, v.value, v.sd, (low[name], high[name]), v.bound_sd, noise[name], v.unit))
    for name, root, times, unit in estimate.tied:
        v = everything[name]
        value, sd = rounded(v.value, v.sd)
        tie = f"= {root}" if times == 1 else f"= {times:g} × {root}"
        rows.append(Row(name, value, sd, "", "", "", "", "", unit, False, tie))
    for name, number, unit in estimate.known:
        rows.append(Row(name, plain(number), "known", "", "", "", "", "", unit, True))
    return rows


def _row(
    name: str, value: float, sd: float, ends: tuple[float, float], bound: float, noise: float, unit: str
) -> Row:
    shown, spread = rounded(value, sd)
    low, high = alike(ends, sd)
    return Row(
        name, shown, spread, percent(sd, value), low, high, short(bound, 2), short(noise, 2), unit, False
    )


def parameter_table(estimate: Estimate, level: float = 0.95, width: int | None = None) -> Table:
    """value, ±, relative ±, interval, bound, unit; where the model does not fit, also the ± of sensor noise alone.

    What is least missed is left out until the table is no wider than `width`.
    """
    rows = parameter_rows(estimate, level)
    low, high = (max((len(getattr(row, end)) for row in rows), default=0) for end in ("low", "high"))
    columns: dict[str, list[str]] = {
        "parameter": [row.name for row in rows],
        "value": [row.value for row in rows],
        "±": [row.sd for row in rows],
        NOISE_ONLY: [row.noise for row in rows],
        "± %": [row.share for row in rows],
        f"{100 * level:g} % interval": [
            f"{row.low.rjust(low)} … {row.high.ljust(high)}" if row.low else row.tie for row in rows
        ],
        "bound": [row.bound for row in rows],
        "unit": ["" if row.unit == "1" else row.unit for row in rows],
    }
    if estimate.basis != MISFIT:
        del columns[NOISE_ONLY]
    for least_missed in ("bound", "± %", NOISE_ONLY):
        if width is not None and _natural_width(columns) > width:
            columns.pop(least_missed, None)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
    for title in columns:
        if title == "parameter":
            table.add_column(title, overflow="fold", min_width=9)
        else:
            table.add_column(title, justify=JUSTIFY.get(title, "center"), no_wrap=True)
    for row, cells in zip(rows, zip(*columns.values(), strict=True), strict=True):
        table.add_row(*cells, style="dim" if row.known else None)
    return table


def _natural_width(columns: Mapping[str, Sequence[str]]) -> int:
    widths = [max(map(len, [*title.split("\n"), *cells])) for title, cells in columns.items()]
    return sum(widths) + 2 * (len(widths) - 1)


def mode_table(modes: ModeValues) -> Table:
    """Natural frequencies and damping ratios with their standard deviations; motions that do not swing apart."""
    rows = []
    for k, eigenvalue in enumerate(modes.eigenvalues.tolist()):
        if eigenvalue.imag == 0:
            rows.append((str(k + 1), "–", "", "–", "", _aperiodic(eigenvalue.real)))
            continue
        f, f_sd = rounded(float(modes.frequency_hz[k]), float(modes.frequency_sd[k]))
        z, z_sd = rounded(float(modes.damping_ratio[k]), float(modes.damping_sd[k]))
        rows.append((str(k + 1), f, f_sd, z, z_sd, "unstable" if eigenvalue.real > 0 else ""))
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False, show_edge=False)
    for title in ("mode", "frequency, Hz", "±", "damping ratio", "±"):
        table.add_column(title, justify="right", no_wrap=True)
    remarks = any(row[-1] for row in rows)
    if remarks:
        table.add_column("")
    for cells in zip(*(aligned(column) if 0 < c < 5 else column for c, column in enumerate(zip(*rows, strict=True))),
                     strict=True):  # fmt: skip
        table.add_row(*(cells if remarks else cells[:-1]))
    return table


def _aperiodic(rate: float) -> str:
    if rate == 0:
        return "moves freely, no restoring force"
    kind = "decays" if rate < 0 else "grows"
    return f"does not swing: {kind} in {short(1 / abs(rate))} s"


def fit_in_words(fit: Fit) -> str:
    """What χ² says, in one sentence."""
    if fit.dof <= 0:
        return "As many unknowns as measurements: the fit cannot be tested."
    numbers = f"χ² = {short(float(fit.chi2))}, {fit.dof} degrees of freedom"
    if not fit.known_noise:
        return f"The noise is unknown and taken from the residuals ({fit.dof} degrees of freedom): no test of the fit."
    if not math.isfinite(float(fit.p)):
        return f"The fit cannot be tested: {numbers}."
    p = probability(float(fit.p))
    p = f"p {p}" if p.startswith("<") else f"p = {p}"
    ratio = float(fit.misfit)
    if bool(fit.rejected):
        return f"The model does not fit: residuals are {short(ratio, 2)} × the noise ({numbers}, {p})."
    if float(fit.p) > 0.999:
        return (
            f"Residuals are only {short(ratio, 2)} × the stated noise ({numbers}): "
            "the noise is stated too large, and so are the intervals."
        )
    return f"The model fits: residuals are {short(ratio, 2)} × the noise ({numbers}, {p})."


def basis_in_words(estimate: Estimate) -> str:
    """What the intervals count."""
    if estimate.basis == MISFIT:
        return (
            "± and intervals count the model's misfit (residuals, not sensors, set their size); "
            "'sensor noise only' is what the sensors alone would give and is too small here."
        )
    if estimate.basis == "residuals":
        return "± and intervals count the scatter of the residuals."
    return "± and intervals count the sensors' noise."


def convergence_in_words(estimate: Estimate) -> str:
    """Whether the iteration settled."""
    count = int(estimate.iterations)
    if not bool(estimate.converged):
        return f"{estimate.method}: NOT CONVERGED after {count} iterations; the values are where it stopped."
    how = "in closed form" if count == 0 else f"converged in {count} iteration{'' if count == 1 else 's'}"
    return f"{estimate.method}: {how}."


def worth_telling(estimate: Estimate) -> tuple[str, ...]:
    """Warnings beside what fit and verdict say anyway, each with what to do about it."""
    said = {"model_misfit", "unknown_noise"}
    if estimate.assessment is not None:
        said |= {notice.code for notice in estimate.assessment.reasons}
        said |= {"reversed_phase"} if estimate.assessment.findings else set()
    return tuple(with_remedy(notice) for notice in estimate.warnings if notice.code not in said)


def show_estimate(out: Console, estimate: Estimate, level: float = 0.95) -> None:
    """Print an estimate (no batch axes)."""
    out.print()
    if estimate.model:
        out.print(Text(estimate.model, style="bold"))
    out.print(Text(convergence_in_words(estimate), style="" if bool(estimate.converged) else "bold red"))
    out.print()
    table = parameter_table(estimate, level, out.width)
    out.print(table)
    if estimate.signs:
        found = ", ".join(
            f"{name} {'+' if float(sign) > 0 else '-'}" for name, sign in estimate.signs.items()
        )
        out.print()
        _paragraph(out, f"Signs found: {found}", "")
    if estimate.modes is not None and len(estimate.modes.eigenvalues):
        out.print()
        out.print(mode_table(estimate.modes))
    out.print()
    if estimate.assessment is None:
        _paragraph(out, fit_in_words(estimate.fit), _colour(estimate.fit))
    else:
        _show_assessment(out, estimate.fit, estimate.assessment)
    shown = any(column.header == "bound" for column in table.columns)
    _paragraph(out, basis_in_words(estimate) + (bound_in_words(estimate) if shown else ""), "")
    for warning in worth_telling(estimate):
        _paragraph(out, f"Warning: {warning}", "yellow")


def _show_assessment(out: Console, fit: Fit, assessment: Assessment) -> None:
    colour = {"fits": "green", "does not fit": "bold red", "cannot tell": "yellow"}[assessment.verdict]
    _paragraph(out, verdict_in_words(fit, assessment), colour)
    _paragraph(out, motion_in_words(assessment), "")
    for line in diagnosis_in_words(assessment.findings):
        _paragraph(out, line, "cyan")


def bound_in_words(estimate: Estimate) -> str:
    """What the bound is."""
    finite = bool(np.any(np.isfinite(estimate.bound_sd)))
    return " bound: the least ± that any unbiased method could reach (Cramér-Rao)." if finite else ""


def _colour(fit: Fit) -> str:
    if not fit.known_noise or fit.dof <= 0:
        return ""
    return "red" if bool(fit.rejected) else "green"


def _paragraph(out: Console, text: str, style: str) -> None:
    for line in textwrap.wrap(text, out.width, break_long_words=False, break_on_hyphens=False):
        out.print(Text(line, style=style), soft_wrap=True)


def show_spectrum(out: Console, spectrum: Spectrum, units: Sequence[str], where: str) -> None:
    """Print what a spectrum holds: lines, channels with their SI units, and how large their noise is."""
    sd = spectrum.sd()
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False, show_edge=False)
    table.add_column("channel", overflow="fold", min_width=9)
    for title in ("amplitude", "noise of it", "relative"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("unit")
    magnitude = np.abs(spectrum.amplitudes)
    for i, channel in enumerate(spectrum.channels):
        table.add_row(channel.name, *_range(magnitude[:, i], sd[:, i]), units[i])
    f = spectrum.frequency_hz
    out.print(
        Text(
            f"{where}: {spectrum.lines} lines from {short(float(np.min(f)))} to {short(float(np.max(f)))} Hz"
        ),
        soft_wrap=True,
    )
    out.print()
    out.print(table)
    kinds = dict.fromkeys(spectrum.noise)
    told = {
        "white": "white residuals", "blocks": "lines beside each harmonic", "periods": "the scatter of periods",
        "given": "what was given",
    }  # fmt: skip
    out.print()
    out.print(Text(f"Noise from {joined(told.get(kind, 'nothing: it is unknown') for kind in kinds)}."))


def _range(magnitude: np.ndarray, sd: np.ndarray) -> Sequence[str]:
    finite = np.isfinite(magnitude)
    if not np.any(finite):
        return ("not measured", "", "")
    low, high = float(np.min(magnitude[finite])), float(np.max(magnitude[finite]))
    noise = float(np.median(sd[finite]))
    typical = float(np.median(magnitude[finite]))
    return (f"{short(low)} … {short(high)}", short(noise, 2), percent(noise, typical) + " %")
