"""A study in a folder: blocks as they are finished, a summary at the end, and going on where it was interrupted.

study.json                    what lies here: name, seed, block size, and each scenario with its fingerprint
draws/KEY/000000.parquet      the repeats of a block, or of several from that one on, a row for each method and draw
summary.parquet               bias, spread, coverage and bound, one row for each scenario, method and parameter
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dashpot.errors import DashpotError, UsageError
from dashpot.io.atomic import LOCK, PART, locked, remove_parts, write_text
from dashpot.io.json_document import from_json, to_json
from dashpot.notices import Notice
from dashpot.study.grid import Study, scenarios
from dashpot.study.montecarlo import BLOCK, LEVELS, Map, Results, Summary, Task, run_scenarios, run_task
from dashpot.study.scenario import Scenario
from dashpot.study.store import State, write_table

FORMAT = 3


@dataclass(frozen=True)
class SummaryRow:
    """What one method did in one scenario."""

    scenario: Scenario
    method: str
    summary: Summary


@dataclass(frozen=True)
class StudyOutcome:
    """A finished study: a row for each scenario and method, in the order of the study."""

    name: str
    seed: int
    rows: tuple[SummaryRow, ...]
    notes: tuple[Notice, ...] = ()

    def columns(self) -> dict[str, list[Any]]:
        """The summary as a table: one row for each scenario, method and parameter; errors in % of the true value."""
        factors = list(dict.fromkeys(key for row in self.rows for key in row.scenario.factors))
        columns: dict[str, list[Any]] = {key: [] for key in factors}
        for row in self.rows:
            s = row.summary
            for j, unknown in enumerate(row.scenario.model.unknowns):
                numbers: dict[str, Any] = {key: row.scenario.factors.get(key) for key in factors}
                numbers |= {
                    "method": row.method,
                    "parameter": unknown.name,
                    "unit": unknown.unit,
                    "true_value": float(row.scenario.theta[j]),
                    "draws": s.draws,
                    "failed": s.failed,
                    "rejected": s.rejected,
                }
                for name in (
                    "mean", "mean_se", "spread", "spread_se", "rms", "stated", "bound", "efficiency", "coverage",
                    "coverage_se",
                ):  # fmt: skip
                    numbers[name] = float(getattr(s, name)[j])
                for k, level in enumerate(LEVELS):
                    numbers[f"quantile_{level:g}"] = float(s.quantiles[k, j])
                for key, number in numbers.items():
                    columns.setdefault(key, []).append(number)
        return columns


def run_study(
    study: Study,
    folder: Path | None = None,
    *,
    mapper: Map = map,
    progress: Callable[[int, int], None] | None = None,
    block: int = BLOCK,
    remote: bool = False,
) -> StudyOutcome:
    """Compute what is not in `folder` yet, by any `mapper`, and summarise; without a folder all stays in memory.

    The result depends on the study alone: not on the mapper, nor on interruptions.  A study that has grown (more
    draws, levels, methods …) uses what an earlier one left.  `progress(done, all)` counts identifications.  With
    `remote` the mapper's processes do not see the folder, and blocks come back to be written here.

    Raises UsageError where the folder holds something else, another process works in it, or a method cannot do what is
    asked of it; DataError where the folder cannot be written; ModelError where a rig has no steady response;
    IdentifiabilityError where a test does not determine the unknowns.
    """
    points = scenarios(study)
    rehearse(points)
    if folder is None:
        return _outcome(
            study, run_scenarios(points, study.seed, block=block, mapper=mapper, progress=progress)
        )
    _make(folder)
    with locked(folder):
        _claim(study, points, folder, block)
        for place in (folder, folder / "draws", *folder.glob("draws/*")):
            remove_parts(place)
        results = run_scenarios(
            points, study.seed, folder=folder, block=block, mapper=mapper, progress=progress, remote=remote
        )
        outcome = _outcome(study, results)
        write_table(folder / "summary.parquet", outcome.columns())
    return outcome


def _outcome(study: Study, results: Results) -> StudyOutcome:
    texts: Mapping[State, str] = {
        "damaged": "{} of the study's blocks computed again: damaged, or not in its place",
        "outdated": "{} of the study's blocks computed again: another version of dashpot had computed it",
    }
    notes = [
        Notice(f"{state}_blocks", text.format(results.replaced[state]))
        for state, text in texts.items()
        if results.replaced.get(state)
    ]
    return StudyOutcome(study.name, study.seed, tuple(_rows(results)), tuple(notes))


def rehearse(points: Sequence[Scenario]) -> None:
    """Two draws of every scenario by every method, and its bound: what cannot work fails now, not hours later.

    Raises the DashpotError, placed at the scenario.
    """
    for point in points:
        try:
            point.bound_sd()
        except DashpotError as error:
            first = error.problems[0]
            raise type(error)(first.what, point.name, first.cure) from error
        run_task(Task(point, 0, 2, 0))


def _rows(results: Results) -> Iterable[SummaryRow]:
    for scenario in results.scenarios:
        for name, summary in results.summaries(scenario).items():
            yield SummaryRow(scenario, name, summary)


def _make(folder: Path) -> None:
    """Make the folder, or see that what lies in it is a study.  Raises UsageError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = [
            path for path in folder.iterdir() if path.name != LOCK and not path.name.startswith(PART[0])
        ]
    except OSError as error:
        raise UsageError(
            f"the folder cannot be used ({error.strerror or error})", str(folder), "name another one"
        ) from None
    if others and not (folder / "study.json").exists():
        raise UsageError(
            "the folder holds other files, and no study", str(folder), "name a new folder for the study"
        )


def _claim(study: Study, points: Sequence[Scenario], folder: Path, block: int) -> None:
    """Write down whose folder it is, or see that it is this study's.  Raises UsageError."""
    content: dict[str, Any] = {
        "format": FORMAT,
        "name": study.name,
        "seed": study.seed,
        "block": block,
        "scenarios": {
            point.key: {"factors": dict(point.factors), "fingerprint": point.fingerprint} for point in points
        },
    }
    manifest = folder / "study.json"
    if manifest.exists():
        content["scenarios"] = _earlier(manifest, content) | content["scenarios"]
    write_text(manifest, to_json(content))


def _earlier(manifest: Path, content: dict[str, Any]) -> dict[str, Any]:
    """Scenarios of the study that lies there already.  Raises UsageError where the two do not go together."""
    another = "name another folder, or delete this one"
    try:
        other = from_json(manifest.read_text(encoding="utf-8"))
        old = dict(other["scenarios"])
        prints = {key: str(entry["fingerprint"]) for key, entry in old.items()}
    except (OSError, ValueError, KeyError, TypeError):
        raise UsageError("this is not a study of dashpot", str(manifest), another) from None
    for key in ("format", "seed", "block"):
        if other.get(key) != content[key]:
            raise UsageError(
                f"the folder holds a study with {key} {other.get(key)}, not {content[key]}",
                str(manifest),
                another,
            )
    for key, entry in content["scenarios"].items():
        if key in prints and prints[key] != entry["fingerprint"]:
            named = " ".join(f"{name}={value}" for name, value in entry["factors"].items())
            raise UsageError(f"the folder holds another study: {named} is different", str(manifest), another)
    return old
