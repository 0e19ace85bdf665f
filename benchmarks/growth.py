"""Processor time and memory of whole commands over the size of what they are given.

`python3 dev.py bench growth`, or with `--kind` one of the rows and `--sizes` others than these.  Every command runs in
a process of its own, whose processor time (start-up included) and largest memory are counted.  The rigs are chains of
masses on a shaken base; the last column is the exponent of growth from the row before.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

CASES = Path(__file__).parents[1] / "examples" / "07_studies" / "yamane1989_tables.toml"
COMMAND = [sys.executable, "-m", "dashpot"]
SIZES = {
    "check over ties": (1000, 4000, 16_000),
    "study over noise levels": (20, 50, 200),
    "identify over unknowns": (50, 100, 200, 400),
    "design over coordinates": (25, 50, 100, 200),
    "design over coordinates, all seen": (25, 50, 100, 200),
    "design over unknowns, all seen": (25, 50, 100),
}


def chain(n: int, known: Callable[[str, int], str], seen: list[int]) -> str:
    """A rig file: masses of 1 kg, springs and dampers from mass to mass, `known(letter, i)` of each of them."""
    points = ["u", *(f"x{i}" for i in range(1, n + 1))]
    text = [
        f"coordinates = {[*points[1:]]}".replace("'", '"'),
        '[inputs]\nu = { kind = "displacement" }',
        "[masses]",
    ]
    text += [f'm{i} = {{ at = "x{i}", value = 1.0 }}' for i in range(1, n + 1)]
    for letter, table in (("k", "springs"), ("c", "dampers")):
        text.append(f"[{table}]")
        text += [
            f'{letter}{i} = {{ between = ["{points[i - 1]}", "x{i}"], {known(letter, i)} }}'
            for i in range(1, n + 1)
        ]
    text += ["[channels]", 'u = { of = "u" }']
    text += [f'x{i} = {{ of = "x{i}", relative_noise = 0.01 }}' for i in seen]
    return "\n".join([*text, ""])


def check(n: int, folder: Path) -> list[list[str]]:
    """One mass on springs that are tied in a chain, each to the one before."""
    springs = [f'k{i} = {{ between = ["u", "x"], same_as = "k{i - 1}" }}' for i in range(1, n)]
    text = [
        'coordinates = ["x"]', '[inputs]\nu = { kind = "displacement" }', '[masses]\nm = { at = "x", value = 1.0 }',
        '[springs]\nk0 = { between = ["u", "x"] }', *springs, '[dampers]\nc = { between = ["u", "x"] }',
        '[channels]\nu = { of = "u" }\nx = { of = "x" }\n',
    ]  # fmt: skip
    (folder / "rig.toml").write_text("\n".join(text), encoding="utf-8")
    return [["check", "rig.toml"]]


def study(n: int, folder: Path) -> list[list[str]]:
    """The paper's four cases with ten draws at n noise levels."""
    text = CASES.read_text(encoding="utf-8")
    head = text[: text.index("[[grid]]")].replace("two_masses.toml", str(CASES.parent / "two_masses.toml"))
    lines = [line for line in head.splitlines() if not line.startswith(("draws", "methods"))]
    levels = np.linspace(0.01, 0.2, n).round(6).tolist()
    new = ["draws = 10", 'methods = ["oiv"]', *lines, "[[grid]]", f"noise = {levels}", "samples = 56", ""]
    (folder / "study.toml").write_text("\n".join(new), encoding="utf-8")
    return [["study", "study.toml", "--out", "out", "--processes", "1"]]


def identify(n: int, folder: Path) -> list[list[str]]:
    """The n springs and dampers of n / 2 masses, every displacement seen, in a simulated table of 40 frequencies."""
    values = {"k": 2000.0 * n, "c": 4.0 * n}
    masses = n // 2

    def known(letter: str, i: int) -> str:
        return f"guess = {values[letter] * (1 + 0.2 * np.sin(i)):.6g}"

    (folder / "rig.toml").write_text(chain(masses, known, list(range(1, masses + 1))), encoding="utf-8")
    simulate = ["simulate", "rig.toml", "--frequencies", "0.5:10/40log", "--table", "-o", "data.csv"]
    return [simulate, ["identify", "rig.toml", "data.csv"]]


def design(n: int, folder: Path, every: bool = False) -> list[list[str]]:
    """Four unknowns, all springs and dampers of either half alike; four displacements seen, or every one."""
    other = n // 2 + 1
    truth = {"k1": 400.0 * n**2, f"k{other}": 250.0 * n**2, "c1": 0.25 * n**2, f"c{other}": 0.2 * n**2}

    def known(letter: str, i: int) -> str:
        root = f"{letter}{1 if i < other else other}"
        return f"guess = {truth[root]}" if root == f"{letter}{i}" else f'same_as = "{root}"'

    seen = list(range(1, n + 1)) if every else np.linspace(1, n, 4, dtype=int).tolist()
    (folder / "rig.toml").write_text(chain(n, known, seen), encoding="utf-8")
    budget = ["--samples", "4000", "--rate", "200", "--band", "0.5:20"]
    return [["design", "rig.toml", *budget, "--set", f"k1={truth['k1'] * 1.1}"]]


def design_all(n: int, folder: Path) -> list[list[str]]:
    """The springs of n masses, each an unknown of its own, every displacement seen."""
    values = {"k": 400.0 * n**2, "c": 0.25 * n**2}

    def known(letter: str, i: int) -> str:
        return f"{'guess' if letter == 'k' else 'value'} = {values[letter] * (1 + 0.2 * np.sin(i)):.6g}"

    (folder / "rig.toml").write_text(chain(n, known, list(range(1, n + 1))), encoding="utf-8")
    return [["design", "rig.toml", "--samples", "40000", "--rate", "200", "--band", "0.5:20"]]


MAKERS = (check, study, identify, design, lambda n, folder: design(n, folder, every=True), design_all)
KINDS: dict[str, Callable[[int, Path], list[list[str]]]] = dict(zip(SIZES, MAKERS, strict=True))


def measured(kind: str, size: int) -> tuple[float, float]:
    """Processor seconds and MiB of the last of the commands; those before it prepare its files."""
    with tempfile.TemporaryDirectory(prefix="dashpot-growth-") as name:
        for command in KINDS[kind](size, Path(name)):
            process = subprocess.Popen([*COMMAND, *command], cwd=name, stdout=subprocess.DEVNULL)
            _, process.returncode, used = os.wait4(process.pid, 0)
            if process.returncode:
                raise SystemExit(f"{kind} of size {size}: {' '.join(command)} failed")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def main() -> None:
    """A line of a table for each size."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--kind", choices=list(KINDS))
    options.add_argument("--sizes", type=int, nargs="*")
    asked = options.parse_args()
    for kind in KINDS if asked.kind is None else (asked.kind,):
        before = None
        for size in asked.sizes or SIZES[kind]:
            seconds, memory = measured(kind, size)
            grown = "" if before is None else f"{np.log(seconds / before[1]) / np.log(size / before[0]):.1f}"
            print(f"| {kind} | {size} | {seconds:.1f} | {memory:.0f} | {grown} |", flush=True)
            before = size, seconds


if __name__ == "__main__":
    main()
