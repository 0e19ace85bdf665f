"""[substructures] of rig files: their matrices come together at the interfaces as the textbooks assemble them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

from dashpot.errors import ModelError
from dashpot.model.dynamics import matrices
from dashpot.model.matrix_elements import block_elements
from dashpot.model.modes import eigenmodes
from dashpot.model.network import Model
from dashpot.model.rigfile import read_rig


def chain(n: int, k: float, m: float) -> tuple[np.ndarray, np.ndarray]:
    """K and M of a free rod of n points."""
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, 0] = K[-1, -1] = k
    return K, m * np.diag([0.5, *np.ones(n - 2), 0.5])


MAST, BOOM = chain(12, 3e4, 0.2), chain(9, 1e4, 0.1)
RIG = """
coordinates = ["tip"]

[substructures]
mast = { coordinates = "a1:a12", joined = { a1 = "ground" } }
boom = { coordinates = "b1:b9", joined = { b1 = "a12", b9 = "tip" } }

[blocks]
mast_stiffness = { of = "mast", matrix = "K", file = "mast_K.csv" }
mast_mass = { of = "mast", matrix = "M", file = "mast_M.csv", value = 1 }
boom_stiffness = { of = "boom", matrix = "K", file = "boom_K.csv" }
boom_mass = { of = "boom", matrix = "M", file = "boom_M.csv", value = 1 }

[springs]
stay = { between = ["a6", "tip"], value = 500 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, parts in (("mast", MAST), ("boom", BOOM)):
        for letter, matrix in zip("KM", parts, strict=True):
            np.savetxt(tmp_path / f"{name}_{letter}.csv", matrix, delimiter=",")
    return tmp_path


def read(folder: Path, text: str) -> Model:
    (folder / "rig.toml").write_text(text)
    return read_rig(folder / "rig.toml").model


def textbook(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """K, M of both parts by primal assembly, Lᵀ diag(A_s) L, and the names of their coordinates."""
    names = [f"a{i}" for i in range(2, 13)] + [f"b{i}" for i in range(2, 9)] + ["tip"]
    rows = [None, *names[:11], "a12", *names[11:]]
    L = np.array([[float(row == name) for name in names] for row in rows])
    whole = []
    for factors, mast, boom in (((1.0, 1.0), MAST[1], BOOM[1]), (theta, MAST[0], BOOM[0])):
        apart = np.block([[factors[0] * mast, np.zeros((12, 9))], [np.zeros((9, 12)), factors[1] * boom]])
        whole.append(L.T @ apart @ L)
    M, K = whole
    stay = np.array([float(name == "a6") - float(name == "tip") for name in names])
    return K + 500 * np.outer(stay, stay), M, names


def test_parts_are_joined_at_their_interfaces(folder: Path) -> None:
    model = read(folder, RIG)
    theta = np.array([0.9, 1.2])
    K, M, names = textbook(theta)
    assert sorted(model.coordinates) == sorted(names)
    assert [unknown.name for unknown in model.unknowns] == ["mast_stiffness", "boom_stiffness"]
    parts = matrices(model, model.parameters(theta))
    at = [model.coordinates.index(name) for name in names]
    np.testing.assert_allclose(parts.K[np.ix_(at, at)], K, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(parts.M[np.ix_(at, at)], M, rtol=1e-12, atol=1e-15)


def test_modes_are_those_that_craig_and_bampton_come_near(folder: Path) -> None:
    """Fixed-interface modes and constraint modes of each part, written out; the joined rig has the limit of many."""
    model = read(folder, RIG.replace("value = 500", "value = 0.001"))
    exact = eigenmodes(model, model.parameters(np.ones(2))).frequency_hz

    def component(parts: tuple[np.ndarray, np.ndarray], boundary: list[int], held: list[int], kept: int):
        K, M = parts
        inner = [i for i in range(len(K)) if i not in (*boundary, *held)]
        _, shapes = eigh(K[np.ix_(inner, inner)], M[np.ix_(inner, inner)])
        T = np.zeros((len(K), len(boundary) + kept))
        T[boundary, range(len(boundary))] = 1
        T[inner, : len(boundary)] = -np.linalg.solve(K[np.ix_(inner, inner)], K[np.ix_(inner, boundary)])
        T[inner, len(boundary) :] = shapes[:, :kept]
        return T.T @ K @ T, T.T @ M @ T

    before = np.inf
    for kept in (1, 3, 7):
        mast = component(MAST, [11], [0], kept)  # the joint
        boom = component(BOOM, [0, 8], [], kept)  # the joint and the tip
        size = 2 + 2 * kept
        into = [[0, *range(2, 2 + kept)], [0, 1, *range(2 + kept, size)]]
        K, M = np.zeros((size, size)), np.zeros((size, size))
        for at, (stiff, mass) in zip(into, (mast, boom), strict=True):
            K[np.ix_(at, at)] += stiff
            M[np.ix_(at, at)] += mass
        hz = np.sqrt(eigh(K, M, eigvals_only=True)[:3]) / (2 * np.pi)
        above = np.max(hz / exact[:3] - 1)
        assert -1e-6 < above < before
        before = above
    assert before < 1e-3


def test_rows_of_a_block_may_be_held_or_share_a_point() -> None:
    K, _ = chain(4, 2.0, 1.0)
    elements = block_elements("k", "K", K, (None, "x", "y", "x"))
    model = Model(("x", "y"), (), (*elements, *block_elements("m", "M", np.eye(2), ("x", "y"), value=1.0)))
    found = matrices(model, model.parameters(np.ones(1))).K
    np.testing.assert_allclose(found, [[2 + 2 + 2, -4], [-4, 4]])


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('b1 = "a12"', 'b1 = "a99"', "a99"),
        ('b1 = "a12"', 'q1 = "a12"', "q1"),
        ('of = "boom", matrix = "K"', 'of = "bom", matrix = "K"', "bom"),
        ('of = "boom", matrix = "K"', 'of = "boom", coordinates = ["a2"], matrix = "K"', "coordinates"),
        ('"b1:b9"', '"a4:a12"', "exists already"),
        ('a1 = "ground"', 'a1 = "a2", a2 = "a1"', "joined to itself"),
        ('"b1:b9"', '"b1:b8"', "boom"),
    ],
)
def test_what_is_wrong_is_told_at_its_place(folder: Path, old: str, new: str, what: str) -> None:
    with pytest.raises(ModelError, match=r"rig\.toml") as caught:
        read(folder, RIG.replace(old, new))
    assert what in str(caught.value)
