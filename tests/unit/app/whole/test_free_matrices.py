"""Free M, C and K from the command line: found, printed as matrices, held definite, compared; what does not suit."""

import json
from pathlib import Path

import pytest

from tests.unit.app.commands.test_compare import refused
from tests.unit.app.conftest import Command, Ran

FRAME = """\
coordinates = ["x1", "x2"]
[inputs]
f = { kind = "force", at = "x2" }
[masses]
m1 = { at = "x1", guess = 2 }
m2 = { at = "x2", guess = 1 }
[springs]
k1 = { between = ["x1", "ground"], guess = 3000 }
k2 = { between = ["x1", "x2"], guess = 2000 }
[dampers]
c1 = { between = ["x1", "ground"], guess = 0.004 }
c2 = { between = ["x1", "x2"], guess = 0.004 }
[channels]
x1 = { of = "x1", unit = "mm", noise = 1.0 }
x2 = { of = "x2", unit = "mm", noise = 1.0 }
f = { of = "f" }
"""
FREE = (
    'coordinates = ["x1", "x2"]\nfree = "MCK"\n[inputs]\nf = { kind = "force", at = "x2" }\n'
    + FRAME[FRAME.index("[channels]") :]
)


@pytest.fixture
def free(dashpot: Command) -> Path:
    """free.toml, and data.csv with the frame of frame.toml pushed at x2."""
    Path("frame.toml").write_text(FRAME, encoding="utf-8")
    Path("free.toml").write_text(FREE, encoding="utf-8")
    done = dashpot("simulate frame.toml --out data.csv --frequencies 3:12/15log --amplitude f=5 --seed 1")
    assert done.code == 0, done.err
    return Path("free.toml")


def entries(done: Ran, matrix: str) -> dict[tuple[str, str], tuple[float, float]]:
    """What was printed of one matrix: (row, column) → (value, sd)."""
    lines = done.out.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith(f"{matrix}, "))
    names = lines[first].split()[2:]
    found = {}
    for i, line in enumerate(lines[first + 2 : first + 2 + len(names)]):
        parts = line.replace("±", " ").split()
        own = names[i:]
        assert parts[0] == names[i]
        for k, column in enumerate(own):
            found[names[i], column] = (float(parts[1 + 2 * k]), float(parts[2 + 2 * k]))
    return found


TRUE = {
    "M": {("x1", "x1"): 2.0, ("x1", "x2"): 0.0, ("x2", "x2"): 1.0},
    "C": {("x1", "x1"): 0.008, ("x1", "x2"): -0.004, ("x2", "x2"): 0.004},
    "K": {("x1", "x1"): 5000.0, ("x1", "x2"): -2000.0, ("x2", "x2"): 2000.0},
}


@pytest.mark.parametrize("method", ["oiv", "oiv+"])
def test_all_matrices_are_found_and_printed(dashpot: Command, free: Path, method: str) -> None:
    """Within 4 sd of the frame's, with the free estimate's sd."""
    done = dashpot("identify", "free.toml", "data.csv", "--method", method)
    assert done.code == 0, done.err
    assert max(map(len, done.out.splitlines())) <= 80
    for matrix, true in TRUE.items():
        found = entries(done, matrix)
        for place, value in true.items():
            assert abs(found[place][0] - value) < 4 * found[place][1], (matrix, place)
    assert "is negative" not in done.out  # entries may have any sign


def test_c_that_is_not_definite_is_said_and_held(dashpot: Command, free: Path) -> None:
    """The damping is too small for these data: freely found, C has a negative eigenvalue; with oiv+ it has none."""
    plain = dashpot("identify", "free.toml", "data.csv")
    assert "C is not positive definite" in plain.out
    held = dashpot("identify", "free.toml", "data.csv", "--method", "oiv+", "--json", "-")
    p = {name: v["value"] for name, v in json.loads(held.out)["parameters"].items()}
    c11, c12, c22 = p["c_x1"] + p["c_x1_x2"], -p["c_x1_x2"], p["c_x2"] + p["c_x1_x2"]
    assert c11 * c22 - c12**2 > 0
    assert c11 > 0


def test_entries_that_are_held_at_zero(dashpot: Command, free: Path) -> None:
    free.write_text(
        FREE.replace('"MCK"', '{ M = "diagonal", C = "full", K = [["x1", "x2"]] }'), encoding="utf-8"
    )
    done = dashpot("identify", "free.toml", "data.csv")
    assert done.code == 0, done.err
    lines = done.out.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("M, kg"))
    assert lines[first + 2].split()[-1] == "0"
    assert "m_x1_x2" not in done.out


def test_matrices_of_a_rig_of_elements(dashpot: Command, free: Path) -> None:
    assert "K, N/m" not in dashpot("identify", "frame.toml", "data.csv").out
    done = dashpot("identify", "frame.toml", "data.csv", "--matrices")
    found = entries(done, "K")
    assert found["x2", "x2"] == (-found["x1", "x2"][0], found["x1", "x2"][1])  # both are k2


def test_free_matrices_beside_hysteretic_dampers(dashpot: Command, free: Path) -> None:
    """Found like all else; the matrices do not tell all of such a rig and are not printed."""
    text = FREE.replace('"MCK"', '"MK"') + '[hysteretic]\nh = { between = ["x1", "ground"], value = 0 }\n'
    free.write_text(text, encoding="utf-8")
    done = dashpot("identify", "free.toml", "data.csv")
    assert done.code == 0, done.err
    assert "k_x1_x2" in done.out
    assert "K, N/m" not in done.out


def test_positive_lets_entries_have_any_sign(dashpot: Command, free: Path) -> None:
    """m_x1_x2 is M12 itself, and may well be negative; the free estimate is."""
    found = [
        json.loads(dashpot("identify", "free.toml", "data.csv", *more, "--json", "-").out)["parameters"]
        for more in (["--method", "ml"], ["--positive"])
    ]
    negative = [name for name, entry in found[0].items() if entry["value"] < 0]
    assert negative
    for name in negative:
        assert found[1][name]["value"] == pytest.approx(found[0][name]["value"], rel=1e-3)


def test_what_does_not_suit(dashpot: Command, free: Path) -> None:
    """A coordinate that is not measured, hysteretic dampers in M, C, K, a word that names no matrices."""
    blind = FREE.replace('x1 = { of = "x1", unit = "mm", noise = 1.0 }\n', "")
    Path("blind.toml").write_text(blind, encoding="utf-8")
    done = dashpot("identify", "blind.toml", "data.csv", "--json", "out.json")
    assert (done.code, done.out) == (3, "")
    assert "; " in done.err[0]
    hysteretic = FRAME.replace("[channels]", '[hysteretic]\nh1 = { between = ["x1", "ground"] }\n[channels]')
    Path("h.toml").write_text(hysteretic, encoding="utf-8")
    refused(
        dashpot("identify", "h.toml", "data.csv", "--matrices", "--json", "out.json"),
        "--matrices",
        "hysteretic",
    )
    free.write_text(FREE.replace("MCK", "ABC"), encoding="utf-8")
    refused(dashpot("identify", "free.toml", "data.csv", "--json", "out.json"), "free.toml:2", "ABC")
