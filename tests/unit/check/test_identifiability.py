"""Rigs that cannot be found: exact ranks, directions, what would help."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dashpot import parse_rig
from dashpot.channel import Channel, Quantity
from dashpot.check import identifiability
from dashpot.check.identifiability import Structure, determines, nonlinear_structure, structure
from dashpot.check.structure import LinePattern, LinesAtHand, enough_lines, exact, floating, lines_of, nominal
from dashpot.errors import IdentifiabilityError
from dashpot.numerics import finite_field as field
from tests.rigs import channels, paper_rig, perfect, random_rig
from tests.two_masses import two_mass_rig


def judged(**changes: str) -> Structure:
    rig = two_mass_rig(**changes)
    return structure(rig.model, rig.channels)


def test_a_sound_rig() -> None:
    found = judged()
    assert found.identifiable
    assert found.deficiencies == ()
    assert found.prior_dependent == ()


def test_a_known_zero_fixes_nothing() -> None:
    assert not judged(k1=", value = 0").identifiable


def test_a_stated_sd_that_all_rests_on_is_named() -> None:
    found = judged(k1=", value = 4600, sd = 10")
    assert found.identifiable
    assert found.prior_dependent == ("k1",)


def test_parallel_and_nothing_known_are_two_findings() -> None:
    found = judged(k1="", dampers='c5 = { between = ["x2", "ground"] }\n')
    assert [one.sort for one in found.deficiencies] == ["sum", "scale"]
    assert found.rank == len(found.names) - 2


def test_alike_coordinates_that_nobody_sees_may_be_exchanged() -> None:
    text = (
        'coordinates = ["x1", "x2", "x3"]\n[inputs]\nu = {}\n[masses]\nm1 = { at = "x1", value = 1 }\n'
        'm2 = { at = "x2" }\nm3 = { at = "x3"%s }\n[springs]\nk1 = { between = ["x1", "u"] }\n'
        'k2 = { between = ["x2", "x1"] }\nk3 = { between = ["x1", "x3"] }\n'
        '[channels]\nx1 = { of = "x1" }\nu = { of = "u" }\n'
    )
    rig = parse_rig(text % "")
    found = structure(rig.model, rig.channels)
    assert found.identifiable
    assert found.permutation_ambiguities == (("x2", "x3"),)
    rig = parse_rig(text % ", value = 2")
    assert structure(rig.model, rig.channels).permutation_ambiguities == ()


def test_nothing_holds_a_coordinate() -> None:
    rig = parse_rig(
        'coordinates = ["x1", "x2"]\n[inputs]\nu = {}\n[springs]\nk1 = { along = { x1 = 1, x2 = 1, u = -1 } }\n'
        "k2 = { along = { x1 = 1, x2 = 1 } }\n"
    )
    with pytest.raises(IdentifiabilityError, match="x1, x2 can move without"):
        structure(rig.model, rig.channels)


def test_too_few_lines_and_how_many_more() -> None:
    rig = paper_rig([3.0])
    one = structure(rig.model, channels(rig), perfect(rig, channels(rig)))
    assert one.rank == 4  # two coordinates, real and imaginary part
    assert one.deficiencies[0].lines == LinesAtHand(1, 1, 1)
    assert one.deficiencies[0].directions.shape == (2, 6)
    rig = paper_rig([3.0, 5.0])
    assert structure(rig.model, channels(rig), perfect(rig, channels(rig))).identifiable
    rig = paper_rig([3.0, 3.0])  # the same once more
    again = structure(rig.model, channels(rig), perfect(rig, channels(rig)))
    assert again.rank == 4


def test_an_input_that_was_never_driven() -> None:
    rig = random_rig(np.random.default_rng(4), 2, displacements=2, forces=0, known=0.3)
    seen = channels(rig)
    assert structure(rig.model, seen, perfect(rig, seen)).identifiable
    still = replace(rig, U=rig.U * 0.0)
    assert structure(rig.model, seen, perfect(still, seen)).rank == 0


def test_some_of_the_lines_decide_as_all_of_them_do() -> None:
    rng = np.random.default_rng(7)
    decided = []
    for _ in range(60):
        rig = random_rig(rng, int(rng.integers(1, 5)), known=float(rng.choice([0.0, 0.3])))
        seen = channels(rig)
        lines = int(rng.integers(1, 12))
        present = rng.random((lines, len(seen))) < rng.choice([0.3, 0.7, 1.0])
        driven = rng.random((lines, len(rig.model.inputs))) < 0.8
        pattern = LinePattern(np.arange(lines), present, driven)
        all_lines = exact(rig.model, seen, pattern, np.random.default_rng(1))
        full = field.rank(all_lines.rows) == all_lines.rows.shape[1]
        assert determines(rig.model, tuple(seen), pattern) == full
        decided.append(full)
    assert 10 < sum(decided) < 50


def test_the_answer_is_kept_for_a_rig_its_channels_and_its_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """An equal rig asks no more; another value, channel or pattern of lines does."""
    asked: list[int] = []

    def counted(*arguments: Any) -> Any:
        asked.append(1)
        return exact(*arguments)

    monkeypatch.setattr(identifiability, "exact", counted)
    rig = paper_rig()
    model = replace(rig.model, name="asked for the first time here")
    seen = tuple(channels(rig))
    lines = lines_of(model, perfect(rig, seen))
    assert determines(model, seen, lines)
    assert determines(replace(model), tuple(channels(rig)), lines_of(model, perfect(rig, seen)))
    assert determines(model, seen, lines.spread(len(lines.frequency) - 1))
    assert len(asked) == 1
    first, *rest = model.elements
    known = replace(model, elements=(replace(first, value=1.0), *rest))
    idle = LinePattern(lines.frequency, lines.present, np.zeros_like(lines.driven))
    for others in (
        (known, seen, lines),
        (model, (replace(seen[0], gain=None), *seen[1:]), lines),
        (model, seen, idle),
    ):
        before = len(asked)
        determines(*others)
        assert len(asked) > before


def test_combinations_are_coefficients_of_what_can_be_found() -> None:
    """Sums, products and sums of reciprocals, each in echelon form; sensors that would show the rest."""
    [parallel] = judged(dampers='c5 = { between = ["ground", "x2"] }\n').deficiencies
    assert (parallel.sort, parallel.names) == ("sum", ("c4", "c5"))
    np.testing.assert_allclose(parallel.combinations, [[1.0, 1.0]])
    [scale] = judged(k1="").deficiencies
    assert scale.sort == "scale"
    assert scale.combinations.shape == (len(scale.names) - 1, len(scale.names))
    np.testing.assert_allclose(np.sum(scale.combinations, axis=1), 0.0, atol=1e-9)
    assert scale.sensors == (Channel("…", {"u": 1.0}, Quantity.FORCE),)


LET_GO = """
coordinates = ["x1", "x2"]
[masses]
m1 = {{ at = "x1"{m1} }}
m2 = {{ at = "x2" }}
[springs]
k1 = {{ between = ["x1", "x2"] }}
k2 = {{ between = ["x2", "ground"] }}
[dampers]
c1 = {{ between = ["x1", "x2"] }}
c2 = {{ between = ["x2", "ground"]{law} }}
[channels]
{seen}
"""
ONE, BOTH = 'x1 = { of = "x1" }', 'x1 = { of = "x1" }\nx2 = { of = "x2" }'


@pytest.mark.parametrize(
    ("m1", "seen", "missing"),
    # Two poles are four numbers; the shapes of two modes, seen at two points, are as many again.
    [(", value = 1", BOTH, 0), (", value = 1", ONE, 1), ("", BOTH, 1), ("", ONE, 2)],
)
def test_a_rig_that_was_let_go_shows_its_poles_and_shapes_and_no_forces(
    m1: str, seen: str, missing: int
) -> None:
    rig = parse_rig(LET_GO.format(m1=m1, seen=seen, law=""))
    found = structure(rig.model, rig.channels)
    assert found.rank == len(found.names) - missing
    slopes = floating(
        rig.model,
        rig.channels,
        enough_lines(rig.model, rig.channels, 6),
        *nominal(rig.model, rig.channels),
        np.random.default_rng(1),
    )
    assert np.linalg.matrix_rank(slopes * found.nominal, 1e-8) == found.rank


def test_a_nonlinear_rig_that_was_let_go_is_asked_for_its_motion_in_time() -> None:
    law = ', law = "coulomb", v0 = 0.01'
    known = parse_rig(LET_GO.format(m1=", value = 1", seen=BOTH, law=law))
    assert nonlinear_structure(known.model, known.channels).identifiable
    none = parse_rig(LET_GO.format(m1="", seen=BOTH, law=law))
    found = nonlinear_structure(none.model, none.channels)
    assert found.rank == len(found.names) - 1
