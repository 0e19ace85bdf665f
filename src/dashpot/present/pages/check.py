"""The report of a check: what the channels and the data can determine."""

from __future__ import annotations

from collections.abc import Sequence

from dashpot.channel import Channel
from dashpot.check.data_findings import DataFindings
from dashpot.check.doubt import doubtful
from dashpot.check.identifiability import Structure
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.result import Estimate
from dashpot.io.words import joined
from dashpot.model.network import Model
from dashpot.present.figures.findings import profile_figure
from dashpot.present.pages.evidence import MOST_NAMES, shares_block
from dashpot.present.pages.page import Block, Page, Provenance, figure_picture, page_html
from dashpot.present.pages.report import rig_picture
from dashpot.present.tables.check import known_columns
from dashpot.present.tables.estimate import parameter_columns
from dashpot.present.text.check import collinearity_in_words, profile_in_words, structure_in_words

MOST_PROFILES = 12
IDENTIFY = "Identify: dashpot identify RIG DATA --report report.html."


def check_report(
    model: Model,
    channels: Sequence[Channel],
    structure: Structure,
    spectrum: Spectrum | None = None,
    found: DataFindings | None = None,
    level: float = 0.95,
    provenance: Provenance | None = None,
) -> str:
    """HTML page of a rig whose unknowns can be found; with data, of what they determine only poorly."""
    said = structure_in_words(
        structure, [c.name for c in channels], None if spectrum is None else spectrum.lines
    )
    estimate = None if found is None else found.estimate
    unsure = () if estimate is None else doubtful(estimate, level)
    poor = dict.fromkeys([*_hardly_separated(found), *unsure])
    page = Page(
        model.name or "Check",
        model.summary.removeprefix(f"{model.name}: "),
        "open" if poor or structure.permutation_ambiguities else "good",
        f"All unknowns can be found, but {joined(poor)} only poorly."
        if poor
        else "All unknowns can be found.",
        tuple(said),
        answer=None if estimate is None else _answer(estimate, level),
        drawing=rig_picture(model, channels, estimate, unsure, level),
        steps=tuple(_steps(found, spectrum)),
        evidence=() if found is None or spectrum is None else tuple(_evidence(found, spectrum)),
        terms=() if found is None else ("±", "interval", "bound", "share", "profile"),
        provenance=provenance,
    )
    return page_html(page)


def _hardly_separated(found: DataFindings | None) -> list[str]:
    return (
        [] if found is None else [name for entry in found.collinearity.combinations for name in entry.names]
    )


def _answer(estimate: Estimate, level: float) -> Block:
    return Block("Parameters", (), (tuple(parameter_columns(estimate, level)),))


def _steps(found: DataFindings | None, spectrum: Spectrum | None) -> list[str]:
    if found is None or spectrum is None:
        return [
            "Design the test: dashpot design RIG --samples N.",
            "Then: dashpot identify RIG DATA --report report.html.",
        ]
    steps = [
        f"Know {entry.best} from elsewhere, or add a sensor that separates {joined(entry.names)}."
        for entry in found.collinearity.combinations[:3]
    ]
    if found.collinearity.idle:
        steps.append(
            "Leave out the frequencies that contribute nothing, and dwell longer where they contribute most."
        )
    return steps or [IDENTIFY]


def _evidence(found: DataFindings, spectrum: Spectrum) -> list[Block]:
    units = dict(zip(found.estimate.names, found.estimate.units, strict=True))
    said = tuple(collinearity_in_words(found.collinearity, spectrum, units))
    blocks = [Block("What the data hardly separate", said, whole=True)]
    if len(found.collinearity.names) <= MOST_NAMES:
        blocks.append(shares_block(found.collinearity, spectrum))
    if found.profiles:
        shown = found.profiles[:MOST_PROFILES]
        picture = figure_picture(
            profile_figure(shown), f"Profiles of {joined([entry.name for entry in shown])}"
        )
        blocks.append(
            Block("Profiles", tuple(profile_in_words(entry) for entry in found.profiles), pictures=(picture,))
        )
    if found.known_errors is not None:
        text = "Change of each estimate, per cent, for an error of one per cent of each known parameter."
        blocks.append(
            Block(
                "Errors of known parameters", (text,), (tuple(known_columns(found.known_errors)),), whole=True
            )
        )
    return blocks
