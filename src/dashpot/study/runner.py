"""A study in a folder: blocks as they are finished, a summary at the end, and going on where it was interrupted.

study.json                    what lies here: name, seed, block size, and each scenario with its fingerprint
draws/KEY/000000.parquet      the repeats of a block, one row for each method and draw
summary.parquet               bias, spread, coverage and bound, one row for each scenario, method and parameter
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.errors import DashpotError, UsageError
from dashpot.io.atomic import write_bytes
from dashpot.io.json_document import from_json, to_json
from dashpot.study.montecarlo import BLOCK, LEVELS, Map, Results, Scenario, Summary, Task, run, run_task
from dashpot.study.scenario import Study, scenarios
from dashpot.study.store import write_table

FORMAT = 1


@dataclass(frozen=True)
class Row:
    """What one method did in one scenario."""

    scenario: Scenario
    method: str
    summary: Summary


@dataclass(frozen=True)
class Outcome:
    """A finished study: a row for each scenario and method, in the order of the study."""

    name: str
    seed: int
    rows: tuple[Row, ...]

    def columns(self) -> dict[str, list[Any]]:
        """The summary as a table: one row for each scenario, method and parameter; errors in % of the true value."""
        factors = list(dict.fromkeys(key for row in self.rows for key in row.scenario.factors))
        found: dict[str, list[Any]] = {key: [] for key in factors}
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
                    found.setdefault(key, []).append(number)
        return found


def run_study(
    study: Study,
    folder: Path | None = None,
    *,
    mapper: Map = map,
    progress: Callable[[int, int], None] | None = None,
    block: int = BLOCK,
) -> Outcome:
    """Compute what is not in `folder` yet, by any `mapper`, and summarise; without a folder all stays in memory.

    The result depends on the study alone: not on the mapper, nor on interruptions.  A study that has grown (more
    draws, levels, methods …) uses what an earlier one left.  `progress(done, all)` counts identifications.

    Raises UsageError where the folder holds something else, or a method cannot do what is asked of it;
    IdentifiabilityError where a test does not determine the unknowns.
    """
    found = scenarios(study)
    rehearse(found)
    if folder is not None:
        _claim(study, found, folder, block)
    results = run(found, study.seed, folder=folder, block=block, mapper=mapper, progress=progress)
    outcome = Outcome(study.name, study.seed, tuple(_rows(results)))
    if folder is not None:
        write_table(folder / "summary.parquet", outcome.columns())
    return outcome


def rehearse(found: Sequence[Scenario]) -> None:
    """Two draws of every scenario by every method, and its bound: what cannot work fails now, not hours later.

    Raises the DashpotError, placed at the scenario.
    """
    for one in found:
        try:
            one.bound_sd()
        except DashpotError as error:
            first = error.problems[0]
            raise type(error)(first.what, one.name, first.cure) from error
        run_task(Task(one, 0, 2, 0))


def _rows(results: Results) -> Iterable[Row]:
    for one in results.scenarios:
        for name, summary in results.summaries(one).items():
            yield Row(one, name, summary)


def _claim(study: Study, found: Sequence[Scenario], folder: Path, block: int) -> None:
    """Make the folder this study's, or see that it is.  Raises UsageError."""
    own: dict[str, Any] = {
        "format": FORMAT,
        "name": study.name,
        "seed": study.seed,
        "block": block,
        "scenarios": {
            one.key: {"factors": dict(one.factors), "fingerprint": fingerprint(one)} for one in found
        },
    }
    manifest = folder / "study.json"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not manifest.exists():
            if any(folder.iterdir()):
                raise UsageError(
                    "the folder holds other files, and no study",
                    str(folder),
                    "name a new folder for the study",
                )
        else:
            own["scenarios"] = _earlier(manifest, own) | own["scenarios"]
    except OSError as error:
        raise UsageError(
            f"the folder cannot be used ({error.strerror or error})", str(folder), "name another one"
        ) from None
    write_bytes(manifest, to_json(own).encode("utf-8"))


def _earlier(manifest: Path, own: dict[str, Any]) -> dict[str, Any]:
    """Scenarios of the study that lies there already.  Raises UsageError where the two do not go together."""
    another = "name another folder, or delete this one"
    try:
        other = from_json(manifest.read_text(encoding="utf-8"))
        old = dict(other["scenarios"])
        prints = {key: str(entry["fingerprint"]) for key, entry in old.items()}
    except (ValueError, KeyError, TypeError):
        raise UsageError("this is no study of dashpot", str(manifest), another) from None
    for key in ("format", "seed", "block"):
        if other.get(key) != own[key]:
            raise UsageError(
                f"the folder holds a study with {key} {other.get(key)}, not {own[key]}",
                str(manifest),
                another,
            )
    for key, entry in own["scenarios"].items():
        if key in prints and prints[key] != entry["fingerprint"]:
            named = " ".join(f"{name}={value}" for name, value in entry["factors"].items())
            raise UsageError(
                f"the folder holds another study: {named} was something else", str(manifest), another
            )
    return old


def fingerprint(one: Scenario) -> str:
    """A digest of all that the repeats of a scenario depend on, but its name, the seed and the number of draws."""
    test = one.test
    parts = [
        repr((one.model.coordinates, sorted(one.model.angles), one.noise, one.drift)),
        repr([(i.name, i.kind, sorted(i.at.items())) for i in one.model.inputs]),
        repr([
            (e.name, e.kind.value, sorted(e.along.items()), e.value, e.sd, e.guess, e.lower, e.upper, e.same_as,
             e.times)
            for e in one.model.elements
        ]),
        repr([
            (c.name, sorted(c.of.items()), c.quantity.value, c.scale, c.gain, c.delay, c.sign, c.noise,
             c.relative_noise)
            for c in one.channels
        ]),
    ]  # fmt: skip
    digest = hashlib.sha256("\n".join(parts).encode())
    for array in (one.theta, test.frequency_hz, test.samples, test.periods, test.U, test.f):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
