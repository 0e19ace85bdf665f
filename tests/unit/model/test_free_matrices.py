"""Free matrices in rig files: which entries they are, what is wrong with them, and that they are written again."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from dashpot.errors import ModelError
from dashpot.model.dynamics import matrices
from dashpot.model.matrix_elements import free_elements, free_entries, free_model
from dashpot.model.network import Input
from dashpot.model.rigfile import parse_rig, write_rig

FILE = """\
coordinates = ["x1", "x2", "x3"]
free = "MCK"
[inputs]
f = { kind = "force", at = "x3" }
"""
TABLE = FILE.replace('free = "MCK"\n', "") + "[free]\n"


def names(text: str) -> list[str]:
    return [element.name for element in parse_rig(text).model.elements]


def test_a_text_frees_whole_matrices() -> None:
    found = parse_rig(FILE).model
    assert found == free_model(found.coordinates, found.inputs, name="")
    assert len(found.unknowns) == 18
    assert names(FILE.replace("MCK", "K")) == ["k_x1", "k_x2", "k_x3", "k_x1_x2", "k_x1_x3", "k_x2_x3"]
    assert free_entries(found) == {key: [("x1", "x2"), ("x1", "x3"), ("x2", "x3")] for key in "MCK"}


def test_a_table_says_which_entries_may_differ_from_zero() -> None:
    text = TABLE + 'M = "diagonal"\nC = [["x2", "x1"]]\nK = "full"\n'
    model = parse_rig(text).model
    assert free_entries(model) == {
        "M": [],
        "C": [("x1", "x2")],
        "K": [("x1", "x2"), ("x1", "x3"), ("x2", "x3")],
    }
    parts = matrices(model, np.arange(1.0, len(model.elements) + 1))
    assert np.count_nonzero(parts.M - np.diag(np.diag(parts.M))) == 0
    assert parts.C[0, 2] == parts.C[1, 2] == 0
    assert parts.C[0, 1] == -7  # c_x1_x2, the seventh element
    inline = FILE.replace('"MCK"', '{ M = "diagonal", C = [["x2", "x1"]], K = "full" }')
    assert parse_rig(inline).model == model


def test_any_symmetric_matrix_is_a_sum_of_its_elements() -> None:
    """And m_x1_x2 is M₁₂ itself, c_x1_x2 is −C₁₂, k_x1_x2 is −K₁₂."""
    rng = np.random.default_rng(1)
    model = free_model(("x1", "x2", "x3"), [Input("f", "force", {"x1": 1.0})])
    p = rng.standard_normal(18)
    parts = matrices(model, p)
    value = dict(zip((e.name for e in model.elements), p, strict=True))
    assert np.isclose(parts.M[0, 1], value["m_x1_x2"])
    assert np.isclose(parts.C[0, 2], -value["c_x1_x3"])
    assert np.isclose(parts.K[1, 2], -value["k_x2_x3"])
    entries = np.stack([np.concatenate([m[np.triu_indices(3)] for m in (q.M, q.C, q.K)]) for q in
                        (matrices(model, one) for one in np.eye(18))])  # fmt: skip
    assert np.linalg.matrix_rank(entries) == 18


@pytest.mark.parametrize(
    "free",
    ['"MCK"', '"CM"', '{ M = "diagonal", K = [["x1", "x2"], ["x2", "x3"]] }', '{ C = [["x3", "x1"]] }'],
)
def test_written_and_read_back(free: str) -> None:
    rig = parse_rig(
        FILE.replace('"MCK"', free) + '[springs]\nk0 = { between = ["x1", "ground"], value = 3 }\n'
    )
    again = parse_rig(write_rig(rig))
    assert again.model == rig.model
    assert all(element.free == (element.name != "k0") for element in again.model.elements)


BAD: Mapping[str, tuple[str, list[str]]] = {
    "no letters": (FILE.replace("MCK", ""), ["rig.toml:2", "free", '"MCK"']),
    "another letter": (FILE.replace("MCK", "MCQ"), ["rig.toml:2", "MCQ"]),
    "letter twice": (FILE.replace("MCK", "MM"), ["rig.toml:2", "MM"]),
    "a number": (FILE.replace('"MCK"', "3"), ["rig.toml:2", "3"]),
    "a list": (FILE.replace('"MCK"', '["M"]'), ["rig.toml:2", "list"]),
    "an empty table": (TABLE, ["rig.toml:", "free", "a table names no matrices"]),
    "another matrix": (TABLE + 'Q = "full"\n', ["rig.toml:5", "free.Q", "M, C and K"]),
    "another word": (TABLE + 'K = "half"\n', ["rig.toml:5", "free.K", '"half"', '"diagonal"']),
    "true": (TABLE + "K = true\n", ["rig.toml:5", "free.K", "true"]),
    "no such point": (TABLE + 'K = [["x1", "y"]]\n', ["rig.toml:5", "free.K[0]", "x1, y", "x1, x2, x3"]),
    "a point with itself": (TABLE + 'K = [["x1", "x1"]]\n', ["rig.toml:5", "x1, x1", "two different"]),
    "three points": (TABLE + 'K = [["x1", "x2", "x3"]]\n', ["rig.toml:5", "not a pair"]),
    "a flat list": (TABLE + 'K = ["x1", "x2"]\n', ["rig.toml:5", "not a pair"]),
    "numbers": (TABLE + "K = [[1, 2]]\n", ["rig.toml:5", "1, 2"]),
    "tables in the pair": (TABLE + "K = [[{}, {}]]\n", ["rig.toml:5", "not a pair"]),
    "the name of an element": (
        FILE + '[springs]\nk_x1 = { between = ["x1", "ground"] }\n', ["rig.toml:6", "k_x1", "2 times"],
    ),
    "below a section": (FILE.replace('free = "MCK"\n', "") + 'free = "MCK"\n', ["rig.toml:4", "above the first"]),
    "angles and lengths": ('angles = ["x2"]\n' + FILE, ["rig.toml:3", "angles together", "elements"]),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_free_matrices_are_one_line_each(case: str) -> None:
    text, parts = BAD[case]
    with pytest.raises(ModelError) as caught:
        parse_rig(text)
    assert len(caught.value.problems) == 1
    line = str(caught.value.problems[0])
    assert "; " in line, f"no cure in {line}"
    for part in parts:
        assert part in line


def test_angles_alone_are_free_as_well() -> None:
    model = parse_rig('angles = ["x1", "x2", "x3"]\n' + FILE).model
    assert {unknown.unit for unknown in model.unknowns} == {"kg·m²", "N·m·s/rad", "N·m/rad"}


def test_elements_of_free_matrices_are_marked() -> None:
    own = free_elements(("x1", "x2"))
    assert all(element.free for element in own)
    assert replace(own[0], free=False) != own[0]
