"""A rig that is not the same in all runs: one part of them fits one rig, the rest another.

Both parts are fitted by themselves.  Where each then shows little but noise, the difference of the two sets of
parameters is laid to the one part of the rig that explains most of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Bools, Real
from dashpot.check.diagnosis.nonlinear_elements import ENOUGH
from dashpot.check.diagnosis.rig_changes import changes, extended, missing_elements, stated_values
from dashpot.check.diagnosis.search import Workbench
from dashpot.check.diagnosis.trials import Outcome, Trial, prepared, without
from dashpot.estimate.likelihood.objective import local, measured
from dashpot.model.elements import Element

MOST_GROUPS = 24  # ways to part the runs that are tried
FOLLOWED = 3  # of them that are fitted closely
SPARE = 1.5  # real numbers for each unknown that a part must have
EXPLAINED = 0.8  # part of the difference that one part of the rig must explain to be named


@dataclass(frozen=True)
class RunGroups:
    """Runs in two groups that show different rigs.

    where     the second group in words
    element   what differs, None where no one part of the rig explains it
    step      of its parameter, from the other runs to these; None where there is no such element
    chi2, dof of both groups together, each fitted by itself
    """

    where: str
    element: Element | None
    step: float | None
    chi2: float
    dof: int


def run_groups(bench: Workbench, base: Trial, pool: Sequence[Real]) -> RunGroups | None:
    """The two groups of runs that fit, each by itself or one with a part otherwise; None where no two do."""
    parted = _partings(bench, base)
    if not parted:
        return None
    first = bench.refitted([_part(base, where, ~lines) for where, _, lines in parted], pool)
    second = bench.refitted([_part(base, where, lines) for _, where, lines in parted], pool)
    likely = np.argsort([a.chi2 + b.chi2 for a, b in zip(first, second, strict=True)])[:FOLLOWED].tolist()
    near = [outcome.psi for k in likely for outcome in (first[k], second[k])]
    again = bench.refitted([outcome.trial for k in likely for outcome in (first[k], second[k])], near)
    pairs = list(zip(again[::2], again[1::2], strict=True))
    best = min(pairs, key=lambda pair: pair[0].chi2 + pair[1].chi2)
    if best[0].chi2 + best[1].chi2 < ENOUGH * (best[0].dof + best[1].dof):
        return _with_what_differs(bench, *best)
    both_ways = (*zip(first, second, strict=True), *zip(second, first, strict=True))
    fitting = sorted((pair for pair in both_ways if pair[0].reduced < ENOUGH), key=lambda pair: -pair[0].dof)
    otherwise = [_one_part_otherwise(bench, *pair) for pair in fitting[:FOLLOWED]]
    fits = [groups for groups in otherwise if groups is not None and groups.chi2 < ENOUGH * groups.dof]
    return min(fits, key=lambda groups: groups.chi2 / groups.dof, default=None)


def _one_part_otherwise(bench: Workbench, fitting: Outcome, other: Outcome) -> RunGroups | None:
    """The groups, the other one with a stated value otherwise or a part that the rig lacks; None if there is none."""
    rest = Workbench(prepared(bench.data, other.trial), fitting.psi, bench.sign)
    best = min(changes(rest, fitting.psi), key=lambda change: change.chi2, default=None)
    if best is None:
        return None
    stated = next((e.value for e in bench.data.model.elements if e.name == best.element.name), 0.0)
    step = best.number - (0.0 if stated is None else stated)
    (where,) = other.trial.of
    return RunGroups(where, best.element, step, fitting.chi2 + best.chi2, fitting.dof + best.dof)


def _partings(bench: Workbench, base: Trial) -> list[tuple[str, str, Bools]]:
    """Two groups in words, and the second as lines: each experiment; what follows each run, in the data's order."""
    spectrum = bench.data.spectrum
    experiments = np.unique(spectrum.experiment)
    parted = []
    if 1 < len(experiments) <= MOST_GROUPS:
        for number in experiments.tolist():
            parted.append(
                (f"all runs but experiment {number}", f"experiment {number}", spectrum.experiment == number)
            )
    order = np.arange(spectrum.lines)
    ends = np.unique(np.linspace(1, spectrum.lines - 1, MOST_GROUPS).astype(int)).tolist()
    for k in ends if bench.lines_are_runs else ():
        before, on = (f"{spectrum.frequency_hz[line]:g} Hz" for line in (k - 1, k))
        parted.append((f"the runs up to {before}", f"the runs from {on} on", order >= k))
    least = SPARE * len(bench.psi)
    numbers = 2 * np.sum(base.kept, axis=1) - 2 * len(bench.data.model.inputs)
    return [
        (first, second, lines)
        for first, second, lines in parted
        if np.sum(numbers[lines]) > least and np.sum(numbers[~lines]) > least
    ]


def _part(base: Trial, where: str, lines: Bools) -> Trial:
    """The data of some lines alone."""
    return without(base, "changed", (where,), np.broadcast_to(~lines[:, None], base.y.shape))


def _with_what_differs(bench: Workbench, first: Outcome, second: Outcome) -> RunGroups:
    """The groups with the one part of the rig that explains the difference of their parameters."""
    (where,) = second.trial.of
    chi2, dof = first.chi2 + second.chi2, first.dof + second.dof
    model = bench.data.model
    sign = bench.sign[None]
    at_first = local(bench.view, measured(prepared(bench.data, first.trial)), first.psi[None], sign)
    elements = [*missing_elements(model), *stated_values(model)]
    larger, start = extended(bench, second.psi, elements)
    larger = prepared(larger, second.trial)
    at_second = local(larger.view, measured(larger), start[None], sign)
    names = list(larger.view.names)
    free = [names.index(name) for name in bench.view.names]
    information = at_second.symmetric[0]
    inverse = np.linalg.pinv(information[np.ix_(free, free)], rcond=1e-12)
    inverse_first = np.linalg.pinv(at_first.symmetric[0], rcond=1e-12)
    # What moves the parameters of the second group: one of them, or what the rig has not got or takes as known.
    moves = {name: np.eye(len(free))[j] for j, name in enumerate(bench.view.names)}
    moves |= {e.name: inverse @ information[free, names.index(e.name)] for e in elements}
    difference = second.psi - first.psi
    weight = np.linalg.pinv(inverse + inverse_first, rcond=1e-12)
    whole = float(difference @ weight @ difference)
    listed = []
    for name, move in moves.items():
        strength = float(move @ weight @ move)
        if strength > 0 and np.isfinite(strength):
            step = float(move @ weight @ difference) / strength
            listed.append((step**2 * strength, step, name))
    by_name = {e.name: e for e in (*model.elements, *elements)}
    explained, step, name = max(listed, default=(0.0, 0.0, ""))
    if not explained > EXPLAINED * whole or name not in by_name:
        return RunGroups(where, None, None, chi2, dof)
    return RunGroups(where, by_name[name], float(step), chi2, dof)
