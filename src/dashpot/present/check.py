"""What the channels and the data can determine, as a document: structure, collinearity, profiles, known errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dashpot.channel import Channel
from dashpot.check.evidence import (
    Collinearity,
    Combination,
    DataFindings,
    KnownErrors,
    doubtful,
    shares_by_band,
)
from dashpot.check.identifiability import Structure
from dashpot.check.profile import Profile
from dashpot.data.spectrum import Spectrum
from dashpot.io.words import joined, listed
from dashpot.model.network import Model
from dashpot.present.document import Document, Provenance, Section, TableColumn, columns_of, section
from dashpot.present.estimate import STATED, STATED_TEXT, parameter_columns, stated_columns
from dashpot.present.figures.spectra import profile_figure, shares_figure
from dashpot.present.page import figure_picture, page_html
from dashpot.present.schematic.drawing import rig_picture
from dashpot.present.words import alike, short


def check_document(
    structure: Structure, channels: Sequence[str], spectrum: Spectrum | None, found: DataFindings | None
) -> Document:
    """What is printed of a rig whose unknowns can be found; with data, of what they determine only poorly."""
    lines = None if spectrum is None else spectrum.lines
    sections = [section("", *structure_in_words(structure, channels, lines))]
    if found is not None and spectrum is not None:
        sections.append(_hardly_separated(found, spectrum))
        sections.append(section("Profiles", *map(profile_in_words, found.profiles)))
        if found.known_errors is not None:
            said = "How far a 1 % error of each known parameter changes the estimates:"
            sections.append(section("", said, known_columns(found.known_errors)))
            if found.estimate.stated:
                sections.append(section(STATED, STATED_TEXT, stated_columns(found.estimate)))
    return Document("", tuple(each for each in sections if each.blocks))


def check_report(
    model: Model,
    channels: Sequence[Channel],
    structure: Structure,
    spectrum: Spectrum | None = None,
    found: DataFindings | None = None,
    level: float = 0.95,
    provenance: Provenance | None = None,
) -> str:
    """HTML page of the same."""
    lines = None if spectrum is None else spectrum.lines
    estimate = None if found is None else found.estimate
    unsure = () if estimate is None else doubtful(estimate, level)
    apart = [] if found is None else [name for e in found.collinearity.combinations for name in e.names]
    poor = dict.fromkeys([*apart, *unsure])
    evidence: list[Section] = []
    if found is not None and spectrum is not None:
        evidence = [_hardly_separated(found, spectrum), *shares_section(found.collinearity, spectrum)]
        if found.profiles:
            shown = found.profiles[:12]  # profiles in one picture
            picture = figure_picture(
                profile_figure(shown), f"Profiles of {joined([one.name for one in shown])}"
            )
            evidence.append(section("Profiles", *map(profile_in_words, found.profiles), picture))
        if found.known_errors is not None:
            text = "Change of each estimate, per cent, for an error of one per cent of each known parameter."
            columns = known_columns(found.known_errors)
            evidence.append(section("Errors of known parameters", text, columns, whole=True))
            if found.estimate.stated:
                evidence.append(section(STATED, STATED_TEXT, stated_columns(found.estimate), whole=True))
    if found is None:
        todo = [
            "Design the test: dashpot design RIG --samples N.",
            "Then: dashpot identify RIG DATA --report report.html.",
        ]
    else:
        steps = [
            f"Measure {entry.best} separately, or add a sensor that separates {joined(entry.names)}."
            for entry in found.collinearity.combinations[:3]
        ]
        if found.collinearity.idle:
            steps.append(
                "Leave out the frequencies that contribute nothing, and dwell longer where they contribute most."
            )
        todo = steps or ["Identify: dashpot identify RIG DATA --report report.html."]
    return page_html(
        Document(
            model.name or "Check",
            tuple(evidence),
            "open" if poor or structure.permutation_ambiguities else "good",
            model.summary.removeprefix(f"{model.name}: "),
            f"All unknowns can be found{f', but {joined(poor)} only poorly' if poor else ''}.",
            tuple(structure_in_words(structure, [c.name for c in channels], lines)),
            answer=None if estimate is None else section("Parameters", parameter_columns(estimate, level)),
            drawing=rig_picture(model, channels, estimate, unsure, level),
            steps=tuple(todo),
            terms=() if found is None else ("±", "interval", "bound", "share", "profile"),
            provenance=provenance,
        )
    )


def _hardly_separated(found: DataFindings, spectrum: Spectrum) -> Section:
    units = dict(zip(found.estimate.names, found.estimate.units, strict=True))
    # Strong collinearities and frequencies without information, one paragraph each
    said = [combination_in_words(combination, units) for combination in found.collinearity.combinations]
    if not said:
        said.append("No strong correlation between parameters.")
    every = spectrum.frequency_hz.tolist()
    idle = [every[line] for line in found.collinearity.idle]
    if len(idle) > 20:  # fewer are listed one by one
        telling = sorted(set(every) - set(idle))
        where = f"; the most informative are {telling[0]:.4g} to {telling[-1]:.4g} Hz" if telling else ""
        text = f"{len(idle)} of the {len(every)} frequencies add almost no information on any unknown{where}."
        said.append(text)
    elif idle:
        named = joined(f"{f:.4g}" for f in idle)
        said.append(f"Frequencies that add almost no information on any unknown: {named} Hz.")
    return section("What is strongly correlated", *said, whole=True)


def shares_section(weak: Collinearity, spectrum: Spectrum) -> list[Section]:
    """What each line tells of each unknown, where they are few enough for a picture."""
    if len(weak.names) > 40:  # more unknowns do not fit in one picture
        return []
    figure = shares_figure(weak.names, *shares_by_band(weak, spectrum.frequency_hz))
    text = "Which frequencies determine each unknown: per cent of the information on it."
    if weak.idle:
        text += f" {len(weak.idle)} of {spectrum.lines} lines contribute to no unknown."
    picture = figure_picture(figure, "Share of the information on each unknown by frequency")
    return [section("Information by frequency", text, picture)]


def known_columns(errors: KnownErrors) -> list[TableColumn]:
    """Per cent by which each unknown moves for an error of 1 % of each known parameter."""
    rows = (
        (name, *(f"{x:+.2f} %" if math.isfinite(x) else "–" for x in row))
        for name, row in zip(errors.known, errors.relative.tolist(), strict=True)
    )
    return columns_of(["1 % of", *(f"{name}>" for name in errors.unknowns)], rows)


def structure_in_words(structure: Structure, channels: Sequence[str], lines: int | None = None) -> list[str]:
    """What a structure without deficiencies means, one paragraph each."""
    count = len(structure.names)
    unknowns = f"the {count} unknowns" if count > 1 else "the unknown"
    at = "" if lines is None else f" at these {lines} frequencies"
    paragraphs = [
        f"Identifiable: {unknowns} ({listed(structure.names)}) can be found from {listed(channels)}{at}."
    ]
    if structure.prior_dependent:
        paragraphs.append(f"Identifiable only with the prior on {listed(structure.prior_dependent)}.")
    for first, other in structure.permutation_ambiguities:
        paragraphs.append(
            f"{first} and {other} are unmeasured and interchangeable. Give an element at one of them a min or "
            "max."
        )
    return paragraphs


def combination_in_words(combination: Combination, units: dict[str, str]) -> str:
    """A combination of unknowns that the data hardly determine, its effect and its cure."""
    wide = short(max(combination.widening.tolist()), 2)
    if len(combination.names) == 1:
        name = combination.names[0]
        return (
            f"{name} is strongly correlated with the other unknowns, which makes its interval {wide} times "
            "wider."
        )
    moves = ", ".join(
        f"{name} {x:+.2g}" + (" s" if units.get(name) == "s" else "")
        for name, x in zip(combination.names, combination.direction.tolist(), strict=True)
    )
    return (
        f"{joined(combination.names)} are strongly correlated: a joint change in proportion ({moves}) is known "
        f"to {short(100 * combination.spread, 2)} % (standard deviation), which widens their intervals up to "
        f"{wide} times. If {combination.best} were known, the intervals of the others would shrink to "
        f"{short(100 * combination.narrowing, 2)} % of their present width."
    )


def profile_in_words(profile: Profile) -> str:
    """Both intervals of one unknown, and which to trust (no batch axes)."""
    ends = [
        float(profile.lower),
        float(profile.upper),
        float(profile.normal_lower),
        float(profile.normal_upper),
    ]
    size = (ends[3] - ends[2]) / 4
    value, low, high, left, right = alike([float(profile.value), *ends], size)
    low, high = (("none" if math.isinf(x) else text) for x, text in ((ends[0], low), (ends[1], high)))
    unit = "" if profile.unit == "1" else f" {profile.unit}"
    text = (
        f"{profile.name} = {value}{unit}: {100 * profile.level:g} % interval from the profile {low} … {high}, "
        f"normal {left} … {right}"
    )
    if bool(profile.improved):
        return (
            f"{text}. The profile found a better fit than the estimate: give initial guesses, or more random "
            "starts."
        )
    if math.isinf(ends[0]) or math.isinf(ends[1]):
        return f"{text}. The normal interval is wrong here: the interval is open on one side."
    if bool(profile.misleads):
        off = f"{100 * float(profile.difference):.0f} %"
        return f"{text}. The normal interval is wrong here (an end is off by {off} of its length)."
    return f"{text}. They agree."
