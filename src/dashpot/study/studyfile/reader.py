"""Reading study files."""

from __future__ import annotations

import os
from pathlib import Path

from dashpot.errors import DashpotError, UsageError
from dashpot.io.toml_document import TomlDocument, Wanted, parse_toml, read_toml
from dashpot.io.words import written
from dashpot.study.grid import Study, points
from dashpot.study.studyfile.grids import Tables, read_grids
from dashpot.study.studyfile.tables import read_frequencies, read_input_amplitudes, read_rigs, read_unknowns
from dashpot.study.studyfile.values import StudyValues

HEAD = (
    "name", "seed", "draws", "methods", "periods", "drift", "amplitudes", "rigs", "frequencies", "unknowns", "grid",
    "transients",
)  # fmt: skip
_WANTED = Wanted("study file", "describe a study, starting with [rigs.NAME]")


def read_study(path: str | os.PathLike[str]) -> Study:
    """The study in the TOML file `path`; rig files are looked for beside it.

    Raises UsageError with every problem found, each at file:line and key, DataError where the path is a device.
    """
    return _study(read_toml(path, UsageError, _WANTED))


def parse_study(text: str, path: str = "study.toml") -> Study:
    """The study described by a TOML text; `path` is named in messages, and rig files are looked for in its folder.

    Raises UsageError with every problem found, each at file:line and key.
    """
    return _study(parse_toml(text, path, UsageError, _WANTED))


def _study(document: TomlDocument) -> Study:
    values, table = StudyValues(document), document.table
    values.keys((), table, HEAD)
    name = values.text(("name",), table.get("name", Path(document.path).stem))
    if not name.isprintable():
        values.report.add(("name",), f"{written(name)} is not a usable name", "use one line of plain text")
    seed = values.whole(("seed",), table.get("seed", 0), 0, 2**63)
    drift = values.whole(("drift",), table["drift"], 0, 5) if "drift" in table else None
    periods = values.number(("periods",), table.get("periods", 1.0), positive=True)
    transients = values.flag(("transients",), table.get("transients", False))
    rigs = read_rigs(values)
    lines = read_frequencies(values)
    unknowns = read_unknowns(values, rigs)
    amplitudes = read_input_amplitudes(values, rigs)
    grids = read_grids(values, Tables(*(values.names_in(key) for key in ("rigs", "frequencies", "unknowns"))))
    values.report.raise_any()
    study = Study(name, seed, rigs, lines, tuple(grids), unknowns, amplitudes, periods, drift, transients)
    for k, grid in enumerate(study.grids):
        try:
            points(study, grid)
        except DashpotError as error:
            for problem in error.problems:
                values.report.add(("grid", k), problem.what, problem.cure)
    values.report.raise_any()
    return study
