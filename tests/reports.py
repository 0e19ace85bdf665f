"""A report of every kind, made by the command from the examples."""

import contextlib
import json
import runpy
from pathlib import Path

from dashpot.app.cli import run
from tests.two_masses import UNDETERMINED

ROOT = Path(__file__).parents[1]
EXAMPLES = {path.name.partition("_")[2]: path for path in (ROOT / "examples").glob("[0-9]*")}
MISFIT = str(EXAMPLES["shake_table"] / "rig.toml"), str(EXAMPLES["shake_table"] / "amplitudes.csv")
METHODS = str(EXAMPLES["methods"] / "rig.toml"), str(EXAMPLES["methods"] / "amplitudes.csv")
EARTHQUAKE = str(EXAMPLES["earthquake"] / "rig.toml")
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
    "whole record": (
        0,
        "identify",
        EARTHQUAKE,
        "quake.csv",
        "--noise-record",
        "still.csv",
        "--hold-out",
        "25%",
    ),
    "misfit of a record": (0, "identify", "heavy.toml", "quake.csv", "--noise-record", "still.csv"),
    "validate records": (0, "validate", "quake.json", "quake.csv", "aftershock.csv", "--rig", EARTHQUAKE),
    "study": (0, "study", "study.toml", "--draws", "20", "--workers", "1"),
    "reproduce": (0, "reproduce", "yamane1989", "--draws", "20", "--workers", "1"),
}
STUDY = """
name = "Noise and samples"
seed = 1
draws = 20
methods = ["ls", "iv", "oiv"]
periods = 0.5

[rigs.paper]
file = {rig}
values = {{ m1 = 3.0, m2 = 2.7, c1 = 30.0, c2 = 40.0, c3 = 90.0, c4 = 50.0 }}

[frequencies]
few = [2, 3, 4, 6, 8, 10, 12]

[[grid]]
noise = [0.05, 0.1, 0.2]
samples = 56

[[grid]]
noise = 0.1
samples_in_all = [100, 400]
methods = ["iv", "oiv"]
"""


def make_reports(folder: Path) -> None:
    """Write them as NAME.html into a folder, with the data that they need."""
    (folder / "undetermined.toml").write_text(UNDETERMINED, encoding="utf-8")
    runpy.run_path(str(EXAMPLES["friction"] / "make_dwells.py"))["main"](str(folder / "dwells.csv"))
    runpy.run_path(str(EXAMPLES["earthquake"] / "make_record.py"))["main"](folder)
    heavy = Path(EARTHQUAKE).read_text(encoding="utf-8").replace('"1.2 kg"', '"1.8 kg"', 1)
    (folder / "heavy.toml").write_text(heavy, encoding="utf-8")
    study = STUDY.format(rig=json.dumps(str(EXAMPLES["studies"] / "two_masses.toml")))
    (folder / "study.toml").write_text(study, encoding="utf-8")
    with contextlib.chdir(folder):
        assert run(["identify", EARTHQUAKE, "quake.csv", "--json", "quake.json", "-q"]) == 0
        rig = str(EXAMPLES["first_fit"] / "rig.toml")
        for name, frequencies in (("first.csv", "2:14:1"), ("second.csv", "2.5:11:2")):
            assert (
                run(["simulate", rig, "--frequencies", frequencies, "--seed", "1", "--out", name, "-q"]) == 0
            )
        for name, (code, *words) in REPORTS.items():
            quiet = () if words[0] == "check" else ("-q",)
            assert run([*words, "--report", f"{name}.html", *quiet]) == code, name
