"""What is said of rigs that cannot be found, in words of physics."""

from dataclasses import replace

import pytest

from dashpot import parse_rig
from dashpot.channel import Channel
from dashpot.check.deficiencies import in_words, problems_in_words, require_identifiable
from dashpot.check.identifiability import structure
from dashpot.errors import IdentifiabilityError
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.rigfile import Rig
from tests.rigs import channels, paper_rig, perfect
from tests.two_masses import SEEN, two_mass_rig


def told(rig: Rig) -> list[tuple[str, str]]:
    found = structure(rig.model, rig.channels)
    return [in_words(one, found, rig.model, rig.channels) for one in found.deficiencies]


def test_parallel_elements() -> None:
    assert told(two_mass_rig(dampers='c5 = { between = ["ground", "x2"] }\n')) == [
        (
            "of c4, c5 only c4 + c5 can be found: both join x2 to ground",
            "give c4 or c5 a value, or attach one elsewhere",
        )
    ]
    three = two_mass_rig(dampers='c5 = { between = ["ground", "x2"] }\nc6 = { along = { x2 = 0.5 } }\n')
    assert told(three) == [
        (
            "of c4, c5, c6 only c4 + c5 + 0.25·c6 can be found: all join x2 to ground",
            "give 2 of c4, c5 and c6 a value, or attach one elsewhere",
        )
    ]


def test_nothing_known() -> None:
    [(what, cure)] = told(two_mass_rig(k1=""))
    assert what.startswith("nothing is known and only displacements go in, so all forces scale together")
    assert "weigh m1" in cure
    assert "the force that moves u" in cure
    [(_, cure)] = told(
        two_mass_rig(k1="", seen=SEEN + 'r = { of = "u", quantity = "force", gain = "unknown" }\n')
    )
    assert "measure" not in cure


def test_the_cure_names_the_sensors_that_help() -> None:
    found = two_mass_rig(
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
    [(what, cure)] = told(rig)
    assert what == "of k1, k2 only 1/k1 + 1/k2 can be found: they are in series through j"
    assert cure == "give k1 or k2 a value, or measure j"


def test_calibrations() -> None:
    delays = "".join(f'{x} = {{ of = "{x}", delay = "unknown" }}\n' for x in ("x1", "x2", "u"))
    [(what, _)] = told(two_mass_rig(seen="[channels]\n" + delays))
    assert what == "of x1.delay, x2.delay, u.delay only x1.delay - u.delay, x2.delay - u.delay can be found"
    gains = delays.replace("delay", "gain")
    [(what, _)] = told(two_mass_rig(seen="[channels]\n" + gains))
    assert what == "only the ratios of x1.gain, x2.gain, u.gain can be found"


def test_an_input_that_nobody_measures() -> None:
    [(what, cure)] = told(two_mass_rig(seen='[channels]\nx1 = { of = "x1" }\n'))
    assert what == "one channel cannot separate the rig from its unmeasured input u"
    assert cure.startswith("measure u")


def test_a_mass_on_the_base() -> None:
    rig = parse_rig(
        'coordinates = ["x1"]\n[inputs]\nu = {}\n[masses]\nm0 = { at = "u" }\nm1 = { at = "x1", value = 1 }\n'
        '[springs]\nk1 = { between = ["x1", "u"] }\n[channels]\nx1 = { of = "x1" }\nu = { of = "u" }\n'
    )
    [(what, cure)] = told(rig)
    assert what == "nothing that is measured depends on m0"
    assert cure == "give it a value or leave it out, or measure the force that moves u"


def test_refusal_names_the_file() -> None:
    rig = paper_rig()
    free = replace(rig.model, elements=tuple(replace(e, value=None) for e in rig.model.elements))
    with pytest.raises(IdentifiabilityError) as refused:
        require_identifiable(free, channels(rig), "rig.toml")
    assert refused.value.exit_code == 3
    assert str(refused.value).startswith("rig.toml: nothing is known")


def test_free_matrices_with_a_point_unseen_are_told_in_plain_numbers() -> None:
    rig = parse_rig(
        'free = "MCK"\ncoordinates = ["x1", "x2", "x3"]\n[inputs]\nf = { kind = "force", at = "x3" }\n[channels]\n'
        'x1 = { of = "x1" }\nx3 = { of = "x3" }\nf = { of = "f", quantity = "force" }\n'
    )
    ((what, cure),) = told(rig)
    assert "can change together without a trace" in what
    assert "m_x2 +100 %" in what
    assert "e+" not in what
    assert cure == "give 3 of m_x1, m_x2, m_x3, m_x1_x2 and 14 others a value, or measure x2"


def test_too_few_lines_and_how_many_more() -> None:
    rig = paper_rig([3.0])
    found = structure(rig.model, channels(rig), perfect(rig, channels(rig)))
    [problem] = problems_in_words(found, rig.model, channels(rig), "data.csv")
    assert problem.where == "data.csv"
    assert problem.what.startswith("1 line at 1 frequency fix only 4 combinations of the 6 unknowns: ")
    assert problem.cure == "measure at 1 more frequency, or give 2 of m1, m2, c1, c2, c3 and c4 a value"


def long_chain(n: int, *, doubled: bool) -> tuple[Model, tuple[Channel, ...]]:
    """n coordinates on a moved base, the first mass known; `doubled`: two springs have another beside them."""
    x = [f"x{i}" for i in range(1, n + 1)]
    below = ["u", *x]
    elements = [mass(f"m{i}", x[i], value=1.0 if i == 0 else None) for i in range(n)]
    for kind, letter in ((Kind.SPRING, "k"), (Kind.DAMPER, "c")):
        elements += [between(f"{letter}{i + 1}", kind, x[i], below[i]) for i in range(n)]
    if doubled:
        elements += [between(f"more{i}", Kind.SPRING, x[i], below[i]) for i in (4, 9)]
    model = Model(tuple(x), (Input("u"),), tuple(elements))
    return model, tuple(Channel(point, {point: 1.0}) for point in (*x, "u"))


@pytest.mark.parametrize("n", [24, 300])
def test_springs_side_by_side_are_named_in_rigs_of_any_size(n: int) -> None:
    with pytest.raises(IdentifiabilityError) as refused:
        require_identifiable(*long_chain(n, doubled=True))
    assert [problem.what for problem in refused.value.problems] == [
        "of k5, more4 only k5 + more4 can be found: both join x5 to x4",
        "of k10, more9 only k10 + more9 can be found: both join x10 to x9",
    ]
    require_identifiable(*long_chain(n, doubled=False))


def test_large_rigs_are_checked_for_more_than_elements_side_by_side() -> None:
    """24 coordinates: every fourth seen is enough, and a spring from the base to the ground leaves no trace."""
    model, seen = long_chain(24, doubled=False)
    require_identifiable(model, (*seen[3:-1:4], seen[-1]))
    loose = replace(model, elements=(*model.elements, between("idle", Kind.SPRING, "u", "ground")))
    with pytest.raises(IdentifiabilityError, match="idle"):
        require_identifiable(loose, seen)
