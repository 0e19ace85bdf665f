"""What fixes the size of the forces."""

import numpy as np
import pytest

from dashpot import Channel, Input, Kind, Model, Quantity, between, mass, matrices, modes, response
from dashpot.check.structure import free_scales

FORCE = Quantity.FORCE


def rig(k2: dict[str, float] | None = None, inputs: tuple[Input, ...] = (Input("u"),)) -> Model:
    elements = (
        mass("m1", "x1"),
        mass("m2", "x2"),
        between("k1", Kind.SPRING, "x1", "x2"),
        between("k2", Kind.SPRING, "x2", "u", **(k2 or {})),
    )
    return Model(("x1", "x2"), inputs, elements)


SEEN = (Channel("x1", {"x1": 1.0}), Channel("x2", {"x2": 1.0}), Channel("u", {"u": 1.0}))
ALL = ("m1", "m2", "k1", "k2")


def test_nothing_known_scales_together() -> None:
    model = rig()
    assert free_scales(model, SEEN) == (ALL,)
    # Which is true: any factor leaves the response as it is.
    p, omega, U = np.array([1.0, 2.0, 30.0, 50.0]), np.array([1.0, 7.0]), np.ones((2, 1), dtype=complex)
    np.testing.assert_allclose(response(model, 3 * p, omega, U), response(model, p, omega, U), rtol=1e-12)
    np.testing.assert_allclose(modes(model, 3 * p).eigenvalues, modes(model, p).eigenvalues, rtol=1e-9)
    np.testing.assert_allclose(matrices(model, 3 * p).K, 3 * matrices(model, p).K)


@pytest.mark.parametrize(
    ("known", "free"),
    [
        ({"value": 50.0}, ()),
        ({"value": 50.0, "sd": 5.0}, ()),
        ({"value": 0.0}, (("m1", "m2", "k1"),)),
        ({"guess": 50.0}, (ALL,)),
    ],
)
def test_a_value_fixes_the_scale_unless_it_is_0(
    known: dict[str, float], free: tuple[tuple[str, ...], ...]
) -> None:
    assert free_scales(rig(known), SEEN) == free


@pytest.mark.parametrize(
    ("channel", "fixed"),
    [
        (Channel("F", {"u": 1.0}, FORCE), True),
        (Channel("F", {"k1": 1.0}, FORCE), True),
        (Channel("F", {"u": 1.0}, FORCE, sign=None), True),
        (Channel("F", {"u": 1.0}, FORCE, delay=None), True),
        (Channel("F", {"u": 1.0}, FORCE, gain=None), False),
        (Channel("a", {"x1": 1.0}, Quantity.ACCELERATION), False),
    ],
)
def test_a_measured_force_fixes_it_where_its_gain_is_known(channel: Channel, fixed: bool) -> None:
    assert (free_scales(rig(), (*SEEN, channel)) == ()) is fixed


def test_an_applied_force_counts_where_it_is_measured() -> None:
    model = rig(inputs=(Input("u"), Input("f", "force", {"x1": 1.0})))
    assert free_scales(model, SEEN) == (ALL,)
    assert free_scales(model, (*SEEN, Channel("f", {"f": 1.0}, FORCE))) == ()


def test_parts_that_meet_only_at_inputs_each_need_their_own() -> None:
    def two(b_known: dict[str, float | str]) -> Model:
        elements = (
            mass("ma", "a", value=2.0), between("ka", Kind.SPRING, "a", "u"),
            mass("mb", "b"), between("kb", Kind.SPRING, "b", "u", **b_known),
        )  # fmt: skip
        return Model(("a", "b"), (Input("u"),), elements)

    assert free_scales(two({}), ()) == (("mb", "kb"),)
    assert free_scales(two({"value": 3.0}), ()) == ()
    assert free_scales(two({"same_as": "ka"}), ()) == ()  # the tie carries the scale over
    assert free_scales(two({}), (Channel("F", {"u": 1.0}, FORCE),)) == ()
