"""The network: incidence, ties, unknowns, and what a model refuses."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from dashpot.errors import ModelError
from dashpot.io.words import listed
from dashpot.model import network
from dashpot.model.dynamics import matrices
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model


def spring(name: str, first: str = "x1", second: str = "ground", **known: Any) -> Element:
    return between(name, Kind.SPRING, first, second, **known)


def model(
    *elements: Element, coordinates: tuple[str, ...] = ("x1",), inputs: tuple[Input, ...] = (), **rest: Any
) -> Model:
    return Model(coordinates, inputs, elements, **rest)


RIG = Model(
    ("x1", "x2"),
    (
        Input("f1", "force", {"x1": 1.0, "x2": -2.0}),
        Input("u"),
        Input("f2", "force", {"x2": 1.0}),
        Input("v"),
    ),
    (
        mass("m1", "x1"),
        mass("m2", "x2", value=2.7, sd=0.01),
        spring("k1", "x1", "x2", value=4600.0),
        Element("k2", Kind.SPRING, {"x2": 1.0, "x1": 0.5, "v": -1.0}, same_as="k1", times=2.0),
        between("c1", Kind.DAMPER, "x2", "u", guess=20.0, lower=1.0, upper=100.0),
        between("c2", Kind.DAMPER, "u", "x1", same_as="c3", times=3.0),
        between("c3", Kind.DAMPER, "x1", "ground", same_as="c1", times=0.5),
    ),
)


class TestIncidence:
    def test_B(self) -> None:
        rows = [[1, 0], [0, 1], [1, -1], [0.5, 1], [0, 1], [-1, 0], [1, 0]]
        np.testing.assert_array_equal(RIG.B, rows)
        np.testing.assert_array_equal(RIG.sparse_B.toarray(), rows)

    def test_D_is_over_the_displacement_inputs_alone(self) -> None:
        assert RIG.displacement_inputs == ("u", "v")
        np.testing.assert_array_equal(RIG.D, [[0, 0], [0, 0], [0, 0], [0, -1], [-1, 0], [1, 0], [0, 0]])

    def test_S_is_over_the_force_inputs_alone(self) -> None:
        assert RIG.force_inputs == ("f1", "f2")
        np.testing.assert_array_equal(RIG.S, [[1, 0], [-2, 1]])

    def test_no_inputs(self) -> None:
        rig = model(spring("k"))
        assert rig.D.shape == (1, 0)
        assert rig.S.shape == (1, 0)

    def test_arrays_are_read_only(self) -> None:
        for array in (RIG.B, RIG.D, RIG.S, RIG.T, RIG.p0, RIG.prior_precision, RIG.prior_mean):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0


class TestUnknowns:
    def test_order_priors_and_limits(self) -> None:
        assert [one.name for one in RIG.unknowns] == ["m1", "m2", "c1"]
        _, m2, c1 = RIG.unknowns
        assert (m2.prior, m2.sd, m2.unit) == (2.7, 0.01, "kg")
        assert (c1.guess, c1.lower, c1.upper, c1.unit) == (20.0, 1.0, 100.0, "N·s/m")

    def test_parameters_follow_their_ties(self) -> None:
        p = RIG.parameters(np.array([3.0, 2.5, 40.0]))
        np.testing.assert_allclose(p, [3.0, 2.5, 4600.0, 9200.0, 40.0, 60.0, 20.0])
        np.testing.assert_array_equal(RIG.p0, [0, 0, 4600.0, 9200.0, 0, 0, 0])

    def test_parameters_in_a_batch(self) -> None:
        theta = np.random.default_rng(1).normal(size=(4, 5, 3))
        batch = RIG.parameters(theta)
        for i in np.ndindex(4, 5):
            np.testing.assert_allclose(batch[i], RIG.parameters(theta[i]), rtol=1e-15)

    def test_theta_from_names_values_and_guesses(self) -> None:
        np.testing.assert_array_equal(RIG.theta({"m1": 3.0}), [3.0, 2.7, 20.0])
        np.testing.assert_array_equal(RIG.theta({"m1": 3.0, "c1": 0.0}), [3.0, 2.7, 0.0])

    def test_theta_without_a_value(self) -> None:
        with pytest.raises(ModelError, match="m1 has no value"):
            RIG.theta({})

    def test_theta_with_a_stranger(self) -> None:
        with pytest.raises(ModelError, match="k1 is not an unknown"):
            RIG.theta({"m1": 1.0, "k1": 3.0})

    def test_priors(self) -> None:
        np.testing.assert_allclose(RIG.prior_precision, [0.0, 1e4, 0.0])
        np.testing.assert_array_equal(RIG.prior_mean, [0.0, 2.7, 0.0])

    def test_units_of_angles(self) -> None:
        rig = model(
            mass("J", "a"), spring("kt", "a", "b"), between("ct", Kind.DAMPER, "b", "ground"), spring("k", "x1", "a"),
            coordinates=("x1", "a", "b"), angles=frozenset({"a", "b"}),
        )  # fmt: skip
        assert [one.unit for one in rig.unknowns] == ["kg·m²", "N·m/rad", "N·m·s/rad", "N/m"]


class TestIdentity:
    def test_sparse_and_full_products_are_one(self, monkeypatch: pytest.MonkeyPatch) -> None:
        p = np.arange(1.0, len(RIG.elements) + 1)
        full = matrices(RIG, p)
        monkeypatch.setattr(network, "DENSE", 0)
        large = matrices(copy.deepcopy(RIG), p)
        for letter in "MCKHFGJ":
            np.testing.assert_array_equal(getattr(large, letter), getattr(full, letter))
        indices, indptr, A = RIG.assembly
        phi = p * RIG.factors(np.array([3.0]))[0]
        own = sparse.csc_array((A @ phi, indices, indptr), shape=(RIG.n, RIG.n)).toarray()
        np.testing.assert_allclose(own, full.K + 1j * full.H + 3j * full.C - 9 * full.M, rtol=1e-14)

    def test_copies_and_pickles_are_equal(self) -> None:
        assert RIG.B is not None  # a cached array does not travel
        for twin in (pickle.loads(pickle.dumps(RIG)), copy.deepcopy(RIG)):
            assert twin == RIG
            assert hash(twin) == hash(RIG)
            np.testing.assert_array_equal(twin.B, RIG.B)

    def test_elements_and_inputs_hash(self) -> None:
        assert len({spring("k"), spring("k"), spring("q")}) == 2
        assert len({Input("u"), Input("u"), Input("f", "force", {"x": 1.0})}) == 2

    def test_the_mapping_given_is_copied(self) -> None:
        along = {"x1": 1.0}
        element = Element("k", Kind.SPRING, along)
        along["x2"] = 1.0
        assert dict(element.along) == {"x1": 1.0}
        with pytest.raises(TypeError):
            element.along["x2"] = 1.0  # type: ignore[index]


NAN = float("nan")
REFUSED: list[tuple[Callable[[], Model], str | None, str]] = [
    (lambda: model(coordinates=("x1",)), "masses", "there are no elements"),
    (lambda: model(spring("k"), coordinates=()), "coordinates", "there are no coordinates"),
    (lambda: model(spring("k"), spring("k")), "k", "the name k is used 2 times"),
    (lambda: model(spring("x1")), "x1", "the name x1 is used 2 times"),
    (lambda: model(spring("q"), spring("k", "ground", "ground")), "k", "both ends are on the ground"),
    (lambda: model(spring("ground")), "ground", "the name ground is taken"),
    (lambda: model(spring("")), "", "'' is not a usable name"),
    (lambda: model(spring("a\nb")), "a\nb", "not a usable name"),
    (lambda: model(spring("k", "x1", "y")), "k", "y is neither a coordinate nor a displacement input"),
    (lambda: model(Element("k", Kind.SPRING, {"x1": 0.0})), "k", "the factor of x1 is 0"),
    (lambda: model(Element("k", Kind.SPRING, {"x1": NAN})), "k", "the factor of x1 is nan"),
    (lambda: model(spring("k", value=NAN)), "k", "value is nan"),
    (lambda: model(spring("k", upper=float("inf"))), "k", "max is inf"),
    (lambda: model(spring("k", value=-1.0)), "k", "a spring of -1 N/m is negative"),
    (lambda: model(spring("k", value=1.0, sd=0.0)), "k", "sd is 0"),
    (lambda: model(spring("k", value=1.0, sd=-1.0)), "k", "sd is -1"),
    (lambda: model(spring("k", value=1.0, sd=1e-200)), "k", "sd is 1e-200"),
    (lambda: model(spring("k", sd=1.0)), "k", "sd without a value"),
    (lambda: model(spring("k", value=1.0, guess=1.0)), "k", "both a value and a guess"),
    (lambda: model(spring("k", lower=2.0, upper=2.0)), "k", "min 2 is not below max 2"),
    (lambda: model(spring("k", lower=2.0, guess=1.0)), "k", "the guess 1 is below min 2"),
    (lambda: model(spring("k", upper=2.0, value=3.0, sd=1.0)), "k", "the value 3 is above max 2"),
    (lambda: model(spring("k"), coordinates=("x1", "x2")), "x2", "nothing is attached to the coordinate x2"),
    (lambda: model(spring("k"), inputs=(Input("u"),)), "u", "no element is attached to the input u"),
    (lambda: model(spring("k"), inputs=(Input("f", "force"),)), "f", "a force input must say where it acts"),
    (
        lambda: model(spring("k"), inputs=(Input("f", "force", {"y": 1.0}),)),
        "f",
        "acts at y, which is not a coordinate",
    ),
    (lambda: model(spring("k"), inputs=(Input("f", "force", {"x1": 0.0}),)), "f", "the factor of x1 is 0"),
    (lambda: model(spring("k", "x1", "u"), inputs=(Input("u", at={"x1": 1.0}),)), "u", "takes no `at`"),
    (lambda: model(spring("k"), inputs=(Input("u", "speed"),)), "u", "'speed' is not a kind of input"),  # type: ignore[arg-type]
    (lambda: model(spring("k"), angles=frozenset({"y"})), "angles", "y is neither a coordinate nor"),
    (lambda: model(spring("k", times=2.0)), "k", "`times` without `same_as`"),
    (lambda: model(spring("k"), spring("q", same_as="k", times=0.0)), "q", "times is 0"),
    (lambda: model(spring("k"), spring("q", same_as="k", value=1.0)), "q", "a tied parameter has a value"),
    (lambda: model(spring("q", same_as="k")), "q", "same_as names k, which is not an element"),
    (lambda: model(spring("q", same_as="q")), "q", "a circular tie: q → q"),
    (
        lambda: model(spring("k"), mass("m", "x1", same_as="k")),
        "m",
        "a mass (kg) cannot be tied to the spring k (N/m)",
    ),
    (
        lambda: model(
            spring("k"), spring("q", "a", same_as="k"), coordinates=("x1", "a"), angles=frozenset({"a"})
        ),
        "q",
        "a spring (N·m/rad) cannot be tied",
    ),
]


@pytest.mark.parametrize(("build", "where", "what"), REFUSED, ids=[what for _, _, what in REFUSED])
def test_what_a_model_refuses(build: Callable[[], Model], where: str, what: str) -> None:
    with pytest.raises(ModelError) as caught:
        build()
    (problem,) = caught.value.problems
    assert problem.where == where
    assert what in problem.what
    assert problem.cure


def test_a_circle_is_told_at_each_of_its_members_and_not_at_what_hangs_on_it() -> None:
    with pytest.raises(ModelError) as caught:
        model(spring("a", same_as="b"), spring("b", same_as="c"), spring("c", same_as="b"))
    assert [problem.where for problem in caught.value.problems] == ["b", "c"]


def test_a_model_tells_all_its_problems() -> None:
    with pytest.raises(ModelError) as caught:
        model(spring("k", value=-1.0), spring("q", "x1", "y"), inputs=(Input("u"),), coordinates=("x1", "x2"))
    assert [problem.where for problem in caught.value.problems] == ["k", "q", "u", "x2"]


def test_an_inerter_may_be_tied_to_a_mass() -> None:
    rig = model(mass("m", "x1"), between("b", Kind.INERTER, "x1", "ground", same_as="m"))
    np.testing.assert_array_equal(rig.T, [[1.0], [1.0]])


def test_long_lists_are_cut() -> None:
    assert listed(["a", "b"]) == "a, b"
    assert listed(map(str, range(100)), most=2) == "0, 1 and 98 more"


@pytest.mark.parametrize("seed", range(5))
def test_ties_end_where_a_walk_along_each_of_them_ends(seed: int) -> None:
    """Chains and trees of ties in any order of the elements, against each chain walked by itself."""
    rng = np.random.default_rng(seed)
    names = [f"k{i}" for i in range(40)]
    tied = {i: names[int(rng.integers(max(0, i - 3), i))] for i in range(1, 40) if rng.random() < 0.9}
    springs = [
        spring(name, same_as=tied[i], times=float(rng.uniform(0.5, 2))) if i in tied else spring(name)
        for i, name in enumerate(names)
    ]
    rig = model(*(springs[i] for i in rng.permutation(40)))
    by_name = {element.name: element for element in rig.elements}
    for element, tie in zip(rig.elements, rig.ties, strict=True):
        times = 1.0
        while element.same_as is not None:
            times *= element.times
            element = by_name[element.same_as]
        assert rig.elements[tie.root] is element
        assert tie.times == pytest.approx(times, rel=1e-13)
