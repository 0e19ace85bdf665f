"""A report of every kind, made by the command from the examples."""

from __future__ import annotations

import contextlib
import runpy
from pathlib import Path

from dashpot.app.cli import run
from tests.two_masses import UNDETERMINED

ROOT = Path(__file__).parents[1]
EXAMPLES = {path.name.partition("_")[2]: path for path in (ROOT / "examples").glob("[0-9]*")}
MISFIT = str(EXAMPLES["shake_table"] / "rig.toml"), str(EXAMPLES["shake_table"] / "amplitudes.csv")
METHODS = str(EXAMPLES["methods"] / "rig.toml"), str(EXAMPLES["methods"] / "amplitudes.csv")
# By name: the exit code, and the command's words without --report.
REPORTS = {
    "misfit": (0, "identify", *MISFIT),
    "fits": (0, "identify", *METHODS, "--json", "estimate.json"),
    "compare": (0, "compare", *METHODS),
    "no answer": (3, "identify", "undetermined.toml", METHODS[1]),
    "nonlinear dwells": (0, "identify", str(EXAMPLES["friction"] / "rig.toml"), "dwells.csv"),
    "several records": (0, "identify", str(EXAMPLES["first_fit"] / "rig.toml"), "first.csv", "second.csv"),
    "check": (0, "check", *METHODS, "--profile", "k1,c1", "--known"),
    "undetermined": (3, "check", "undetermined.toml"),
    "design": (0, "design", METHODS[0], "--after", "estimate.json", "--samples", "2000"),
    "validate": (0, "validate", "estimate.json", METHODS[1], "--rig", METHODS[0]),
    "reproduce": (0, "reproduce", "yamane1989", "--draws", "20", "--workers", "1"),
}


def make_reports(folder: Path) -> None:
    """Write them as NAME.html into a folder, with the data that they need."""
    (folder / "undetermined.toml").write_text(UNDETERMINED, encoding="utf-8")
    runpy.run_path(str(EXAMPLES["friction"] / "make_dwells.py"))["main"](str(folder / "dwells.csv"))
    with contextlib.chdir(folder):
        rig = str(EXAMPLES["first_fit"] / "rig.toml")
        for name, frequencies in (("first.csv", "2:14:1"), ("second.csv", "2.5:11:2")):
            assert (
                run(["simulate", rig, "--frequencies", frequencies, "--seed", "1", "--out", name, "-q"]) == 0
            )
        for name, (code, *words) in REPORTS.items():
            quiet = () if words[0] == "check" else ("-q",)
            assert run([*words, "--report", f"{name}.html", *quiet]) == code, name
