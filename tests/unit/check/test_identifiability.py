"""What is said of rigs that cannot be found, and exact ranks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dashpot import parse_rig
from dashpot.check.identifiability import Structure, require_identifiable, structure
from dashpot.errors import IdentifiabilityError
from dashpot.numerics import finite_field as field
from dashpot.numerics.finite_field import PRIME
from tests.rigs import channels, paper_rig, perfect, random_rig

HEAD = 'coordinates = ["x1", "x2"]\n[inputs]\nu = {}\n'
SEEN = '[channels]\nx1 = { of = "x1" }\nx2 = { of = "x2" }\nu = { of = "u" }\n'


def judged(
    more: str = "", k1: str = ", value = 4600", seen: str = SEEN, dampers: str = "", head: str = HEAD
) -> Structure:
    text = (
        f'{head}[masses]\nm1 = {{ at = "x1" }}\nm2 = {{ at = "x2" }}\n'
        f'[springs]\nk1 = {{ between = ["x1", "x2"]{k1} }}\nk2 = {{ between = ["x2", "u"] }}\n{more}'
        f'[dampers]\nc2 = {{ between = ["x2", "u"] }}\nc4 = {{ between = ["x2", "ground"] }}\n{dampers}{seen}'
    )
    rig = parse_rig(text)
    return structure(rig.model, rig.channels)


def told(found: Structure) -> list[tuple[str, str]]:
    return [(one.what, one.cure) for one in found.deficiencies]


def test_a_sound_rig() -> None:
    found = judged()
    assert found.identifiable
    assert told(found) == []
    assert found.leaning == ()


def test_parallel_elements() -> None:
    assert told(judged(dampers='c5 = { between = ["ground", "x2"] }\n')) == [
        (
            "of c4, c5 only c4 + c5 can be found: both join x2 to ground",
            "give one of them a value, or attach one elsewhere",
        )
    ]
    three = judged(dampers='c5 = { between = ["ground", "x2"] }\nc6 = { along = { x2 = 0.5 } }\n')
    assert told(three) == [
        (
            "of c4, c5, c6 only c4 + c5 + 0.25·c6 can be found: all join x2 to ground",
            "give 2 of them a value, or attach one elsewhere",
        )
    ]


def test_nothing_known() -> None:
    [(what, cure)] = told(judged(k1=""))
    assert what.startswith("nothing is known and only displacements go in, so all forces scale together")
    assert "weigh m1" in cure
    assert "the force that moves u" in cure
    assert judged(k1="", seen=SEEN + 'r = { of = "u", quantity = "force" }\n').identifiable
    [(_, cure)] = told(judged(k1="", seen=SEEN + 'r = { of = "u", quantity = "force", gain = "unknown" }\n'))
    assert "measure" not in cure


def test_a_known_zero_fixes_nothing() -> None:
    assert not judged(k1=", value = 0").identifiable


def test_a_stated_sd_is_told_where_all_rests_on_it() -> None:
    found = judged(k1=", value = 4600, sd = 10")
    assert found.identifiable
    assert found.leaning == ("k1",)


def test_parallel_and_nothing_known_are_two_findings() -> None:
    found = judged(k1="", dampers='c5 = { between = ["x2", "ground"] }\n')
    assert [one.sort for one in found.deficiencies] == ["sum", "scale"]
    assert found.rank == len(found.names) - 2


def test_the_cure_names_the_sensors_that_help() -> None:
    found = judged(
        seen='[channels]\nx1 = { of = "x1" }\nu = { of = "u" }\n',
        dampers='c3 = { between = ["x1", "ground"] }\nc1 = { between = ["x1", "x2"] }\n',
    )
    [(_, cure)] = told(found)
    assert cure.endswith("or measure x2 or the force that moves u")


def test_springs_in_series() -> None:
    rig = parse_rig(
        'coordinates = ["x1", "j"]\n[inputs]\nu = {}\n[masses]\nm1 = { at = "x1", value = 1 }\n'
        '[springs]\nk1 = { between = ["x1", "j"] }\nk2 = { between = ["j", "u"] }\n'
        '[channels]\nx1 = { of = "x1" }\nu = { of = "u" }\n'
    )
    [(what, cure)] = told(structure(rig.model, rig.channels))
    assert what == "of k1, k2 only 1/k1 + 1/k2 can be found: they are in series through j"
    assert cure == "give one of them a value, or measure j"


def test_calibrations() -> None:
    delays = "".join(f'{x} = {{ of = "{x}", delay = "unknown" }}\n' for x in ("x1", "x2", "u"))
    [(what, _)] = told(judged(seen="[channels]\n" + delays))
    assert what == "of x1.delay, x2.delay, u.delay only x1.delay - u.delay, x2.delay - u.delay can be found"
    gains = delays.replace("delay", "gain")
    [(what, _)] = told(judged(seen="[channels]\n" + gains))
    assert what == "only the ratios of x1.gain, x2.gain, u.gain can be found"
    assert judged(seen="[channels]\n" + gains.replace('u", gain = "unknown"', 'u"')).identifiable


def test_an_input_that_nobody_measures() -> None:
    [(what, cure)] = told(judged(seen='[channels]\nx1 = { of = "x1" }\n'))
    assert what == "one channel cannot tell the rig from what drives it: u is not measured"
    assert cure.startswith("measure u")


def test_a_mass_on_the_base() -> None:
    rig = parse_rig(
        'coordinates = ["x1"]\n[inputs]\nu = {}\n[masses]\nm0 = { at = "u" }\nm1 = { at = "x1", value = 1 }\n'
        '[springs]\nk1 = { between = ["x1", "u"] }\n[channels]\nx1 = { of = "x1" }\nu = { of = "u" }\n'
    )
    [(what, cure)] = told(structure(rig.model, rig.channels))
    assert what == "nothing that is measured depends on m0"
    assert cure == "give it a value or leave it out, or measure the force that moves u"


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
    assert found.exchanges == (("x2", "x3"),)
    rig = parse_rig(text % ", value = 2")
    assert structure(rig.model, rig.channels).exchanges == ()


def test_nothing_holds_a_coordinate() -> None:
    rig = parse_rig(
        'coordinates = ["x1", "x2"]\n[inputs]\nu = {}\n[springs]\nk1 = { along = { x1 = 1, x2 = 1, u = -1 } }\n'
        "k2 = { along = { x1 = 1, x2 = 1 } }\n"
    )
    with pytest.raises(IdentifiabilityError, match="x1, x2 can move with no force"):
        structure(rig.model, rig.channels)


def test_too_few_lines_and_how_many_more() -> None:
    rig = paper_rig([3.0])
    one = structure(rig.model, channels(rig), perfect(rig, channels(rig)))
    assert one.rank == 4  # two coordinates, real and imaginary part
    assert "measure at 1 more frequency" in one.deficiencies[0].cure
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


def test_refusal_names_the_file() -> None:
    rig = paper_rig()
    free = replace(rig.model, elements=tuple(replace(e, value=None) for e in rig.model.elements))
    with pytest.raises(IdentifiabilityError) as refused:
        require_identifiable(free, channels(rig), "rig.toml")
    assert refused.value.exit_code == 3
    assert str(refused.value).startswith("rig.toml: nothing is known")


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 6), st.integers(0, 6))
def test_ranks_and_null_spaces_of_integers(seed: int, rows: int, columns: int, inner: int) -> None:
    """Against floating point, on products of small integers whose rank both can tell."""
    rng = np.random.default_rng(seed)
    A = rng.integers(-3, 4, (rows, inner)) @ rng.integers(-3, 4, (inner, columns))
    assert field.rank(A) == np.linalg.matrix_rank(A)
    basis = field.null_space(A)
    assert len(basis) == columns - field.rank(A)
    assert not np.any((A % PRIME) @ basis.T.astype(object) % PRIME)


@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_solutions_are_exact(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    A, b = rng.integers(0, PRIME, (3, n, n)), rng.integers(0, PRIME, (3, n, 2))
    A[0, 0] = 0
    x, regular = field.solve(A, b)
    assert not regular[0]
    assert np.all(regular[1:])
    assert np.all((A[1:].astype(object) @ x[1:].astype(object) - b[1:]) % PRIME == 0)


def test_residues_read_numbers_as_they_are_written() -> None:
    assert (field.residue(0.1) + field.residue(0.2) - field.residue(0.3)) % PRIME == 0
    assert field.residue(1 / 3) * 3 % PRIME == 1
    assert field.residue(-2.5) * 2 % PRIME == PRIME - 5
    assert (field.ROOT**2 + 1) % PRIME == 0


def test_free_matrices_with_a_point_unseen_are_told_in_plain_numbers() -> None:
    rig = parse_rig(
        'free = "MCK"\ncoordinates = ["x1", "x2", "x3"]\n[inputs]\nf = { kind = "force", at = "x3" }\n[channels]\n'
        'x1 = { of = "x1" }\nx3 = { of = "x3" }\nf = { of = "f", quantity = "force" }\n'
    )
    ((what, cure),) = told(structure(rig.model, rig.channels))
    assert "can change together without a trace" in what
    assert "m_x2 +100 %" in what
    assert "e+" not in what
    assert cure == "give 3 of them a value, or measure x2"
