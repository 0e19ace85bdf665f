"""Candidates for nonlinear elements, ranked by evidence."""

from __future__ import annotations

from rich.console import Console

from dashpot.check.element_evidence import ElementComparison, ElementEvidence
from dashpot.model.elements import Kind
from dashpot.model.rigfile import element_line
from dashpot.present.tables.layout import TableColumn, show_table


def show_elements(console: Console, comparison: ElementComparison) -> None:
    """A row for each candidate, and the entries of the rig file of those that the data call for."""
    rows = comparison.ranked
    columns = [
        TableColumn("added", tuple(", ".join(_named(row)) for row in rows)),
        TableColumn("residuals", tuple(f"{100 * row.remaining:.3g} %" for row in rows), "right"),
        TableColumn("ln evidence", tuple(f"{row.evidence:+.4g}" for row in rows), "right"),
    ]
    show_table(console, columns)
    console.print("Residuals and ln evidence are relative to the rig as it is.")
    chosen = comparison.chosen
    if chosen is None:
        console.print("The data call for none of them.")
        return
    console.print(
        f"The data call for {' and '.join(_named(chosen))}. Nothing has been added; to add it, write"
    )
    for element in chosen.elements:
        console.print(f"  [{element.kind.section}] {element_line(element)}")
    for name in _negative_dampers(chosen):
        console.print(
            f"{name} comes out negative. No passive damper is: it corrects what other dampers take for too much."
        )


def _named(one: ElementEvidence) -> list[str]:
    """name (law, points) of each element."""
    words = []
    negative = _negative_dampers(one)
    for element in one.elements:
        law = "" if element.force_law is None else element.force_law.text
        points = tuple(element.along) if len(element.along) > 1 else (*element.along, "ground")
        sign = ", negative" if element.name in negative else ""
        words.append(f"{element.name} ({law}, {'-'.join(points)}{sign})")
    return words


def _negative_dampers(one: ElementEvidence) -> list[str]:
    """Names of its dampers that would feed energy in."""
    pairs = zip(one.elements, one.values, strict=True)
    return [element.name for element, value in pairs if element.kind is Kind.DAMPER and value < 0]
