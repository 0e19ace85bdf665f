"""Matrices as blocks: the elements make up the same matrix; a frame in space is identified in the sparse pattern."""

import numpy as np
import pytest
from scipy import sparse

from dashpot.channel import Channel, Quantity
from dashpot.errors import ModelError
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.model.dynamics import FROM, matrices, response
from dashpot.model.elements import Kind, mass
from dashpot.model.matrix_elements import block_elements
from dashpot.model.network import Input, Model
from tests.rigs import stated

POINTS = ("a", "b", "c", "d")


@pytest.mark.parametrize("letter", ["M", "C", "K", "H"])
@pytest.mark.parametrize("form", [np.asarray, sparse.csr_array, sparse.coo_matrix])
def test_the_elements_make_up_the_matrix(letter, form):
    rng = np.random.default_rng(4)
    A = rng.normal(size=(4, 4))
    A = A + A.T
    A[0, 2] = A[2, 0] = 0.0
    elements = (mass("m", "a", value=0.0), *block_elements("A", letter, form(A), POINTS, value=2.5))
    model = Model(POINTS, (), elements)
    np.testing.assert_allclose(getattr(matrices(model, model.p0), letter), 2.5 * A, rtol=1e-14, atol=1e-14)
    assert [e.name for e in elements if not e.is_entry] == ["m", "A"]
    assert {model.unit(element) for element in elements[1:]} == {"1"}


def test_a_base_may_be_a_row():
    K = np.array([[2.0, -2.0], [-2.0, 2.0]])
    model = Model(("x",), (Input("u"),), (mass("m", "x"), *block_elements("K", "K", K, ("x", "u"))))
    parts = matrices(model, model.parameters(model.theta({"m": 1.0})))  # the factor's guess is 1
    assert pytest.approx(2.0) == parts.K
    assert pytest.approx(2.0) == parts.G
    assert (
        sum(e.block is not None for e in model.elements) == 2
    )  # its rows add up to 0: nothing meets the ground


@pytest.mark.parametrize(
    ("matrix", "cause"),
    [
        (np.eye(3), "3 × 3, for 4 points"),
        (np.triu(np.ones((4, 4))), "not symmetric"),
        (np.zeros((4, 4)), "is 0"),
        (np.eye(4) * 1j, "not real and finite"),
        (np.full((4, 4), np.inf), "not real and finite"),
    ],
)
def test_what_is_no_block_is_refused(matrix, cause):
    with pytest.raises(ModelError, match=cause):
        block_elements("A", "K", matrix, POINTS)


def truss(storeys: int) -> tuple[list[np.ndarray], np.ndarray]:
    """A square tower of bars in space on four fixed feet: stiffness of posts and of braces, and masses; (dof, dof)."""
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    nodes = np.array([(*corner, level) for level in range(storeys + 1) for corner in square])
    K = [np.zeros((nodes.size, nodes.size)) for _ in range(2)]
    for low in range(0, 4 * storeys, 4):
        bars = [(0, low + k, low + 4 + k) for k in range(4)]
        bars += [(1, low + k, low + 4 + (k + 1) % 4) for k in range(4)]
        bars += [(1, low + 4 + k, low + 4 + (k + 1) % 4) for k in range(4)] + [(1, low + 4, low + 6)]
        for group, i, j in bars:
            axis = nodes[j] - nodes[i]
            length = np.linalg.norm(axis)
            row = np.zeros(nodes.size)
            row[3 * i : 3 * i + 3], row[3 * j : 3 * j + 3] = -axis / length, axis / length
            K[group] += 1e5 / length * np.outer(row, row)
    return [part[12:, 12:] for part in K], np.eye(nodes.size - 12)


@pytest.mark.slow
def test_a_frame_in_space_is_identified_from_few_sensors():
    stiffness, M = truss(34)
    n = len(M)
    assert n >= FROM  # in the sparse pattern
    names = tuple(f"q{k}" for k in range(n))
    damping = 2e-4 * (stiffness[0] + stiffness[1])
    elements = [e for name, K in zip(("posts", "braces"), stiffness, strict=True)
                for e in block_elements(name, "K", sparse.csr_array(K), names)]  # fmt: skip
    elements += block_elements("loss", "C", sparse.csr_array(damping), names, guess=0.8)
    elements += block_elements("mass", "M", sparse.csr_array(M), names, value=1.0)
    model = Model(names, (Input("F", "force", {names[-1]: 1.0, names[-2]: 0.3}),), tuple(elements))
    truth = np.array([0.93, 1.1, 1.05])
    hz = np.linspace(0.4, 4.0, 12)
    omega = 2 * np.pi * hz
    X = response(model, model.parameters(truth), omega, np.zeros((12, 0), complex), np.ones((12, 1), complex))
    K = truth[0] * stiffness[0] + truth[1] * stiffness[1]
    f = np.zeros(n)
    f[-1], f[-2] = 1.0, 0.3
    direct = [np.linalg.solve(K + 1j * w * truth[2] * damping - w**2 * M, f) for w in omega[:3]]
    np.testing.assert_allclose(X[:3], direct, rtol=1e-8)

    seen = [n - 1, n - 2, n // 2]
    Y = np.concatenate([X[:, seen], np.ones((12, 1))], axis=-1)
    sd = 0.01 * np.abs(Y)
    sd[:, -1] = 0.0
    rng = np.random.default_rng(7)
    Y = Y + sd * (rng.standard_normal(Y.shape) + 1j * rng.standard_normal(Y.shape))
    channels = (*(Channel(names[k], {names[k]: 1.0}) for k in seen), Channel("F", {"F": 1.0}, Quantity.FORCE))
    spectrum = stated(channels, hz, Y, 2 * sd[:, :, None] ** 2 * np.eye(4))
    estimate = identify(model, spectrum, MaximumLikelihood())
    assert bool(estimate.converged)
    assert estimate.names == ("posts", "braces", "loss")
    assert np.max(np.abs(estimate.values - truth) / estimate.sd) < 4
    assert np.max(estimate.sd) < 0.05
    assert estimate.tied == ()
    assert [name for name, _, _ in estimate.known] == ["mass"]
    assert Kind.INERTER not in {e.kind for e in model.elements}
