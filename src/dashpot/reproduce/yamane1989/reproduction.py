"""The paper's tables and figures again, by Monte Carlo, beside what it printed, and what that shows beyond the paper.

K. Yamane, "Identification of Multi-Degree-of-Freedom Dynamical Systems Based on the Response in Receiving Forced
Displacement Inputs (the Case Using Harmonic Excitation Data)", 1989.  Its tables are one noise draw each; here each
has many draws, so it can be said where the paper's one falls among them.  All errors are in % of the true value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from dashpot.errors import UsageError
from dashpot.reproduce.yamane1989.draws import Draws
from dashpot.reproduce.yamane1989.figures import FigureData, figure_2, figure_3
from dashpot.reproduce.yamane1989.findings import Findings, findings
from dashpot.reproduce.yamane1989.rig import DRAWS, SEED, figures_study, tables_study
from dashpot.reproduce.yamane1989.tables import (
    EigenvalueEntry,
    PrintedColumn,
    Rank,
    identified_eigenvalues,
    ranking,
    table_1,
    table_2,
    table_3,
    table_4,
)
from dashpot.study.grid import scenarios
from dashpot.study.montecarlo import Map, run_scenarios

FEWEST = 20


@dataclass(frozen=True)
class Reproduction:
    """All of it, as plain numbers."""

    draws: int
    seed: int
    source: str
    unknown: tuple[str, ...]
    eigenvalues: tuple[EigenvalueEntry, ...]
    table2: tuple[PrintedColumn, ...]
    table3: tuple[PrintedColumn, ...]
    table4: tuple[PrintedColumn, ...]
    identified_eigenvalues: tuple[EigenvalueEntry, ...]
    ranking: tuple[Rank, ...]
    figure2: FigureData
    figure3: FigureData
    findings: Findings
    corrections: tuple[Mapping[str, str], ...]


def reproduce(
    draws: int = DRAWS,
    seed: int = SEED,
    progress: Callable[[int, int], None] | None = None,
    *,
    mapper: Map = map,
) -> Reproduction:
    """Tables 1-4 and Figures 2-3 with `draws` noise draws for each point; `progress(done, all)` counts identifications.

    The same seed gives the same numbers whatever the `mapper`.  About 2 ms a draw and point.  Raises UsageError for
    fewer than FEWEST draws.
    """
    if draws < FEWEST:
        raise UsageError(f"{draws} draws are too few to speak of a spread", cure=f"take {FEWEST} or more")
    points = (*scenarios(figures_study(draws, seed)), *scenarios(tables_study(draws, seed)))
    unique = {point.name: point for point in points}
    repeats = Draws(run_scenarios(list(unique.values()), seed, mapper=mapper, progress=progress))
    return Reproduction(
        draws,
        seed,
        repeats.paper.source,
        repeats.paper.unknown,
        table_1(),
        table_2(repeats),
        table_3(repeats),
        table_4(repeats),
        identified_eigenvalues(repeats),
        ranking(repeats),
        figure_2(repeats),
        figure_3(repeats),
        findings(repeats),
        repeats.paper.corrections,
    )
