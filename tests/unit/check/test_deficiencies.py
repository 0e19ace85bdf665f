"""What is said of rigs that cannot be found, in words of physics."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from dashpot import parse_rig
from dashpot.channel import Channel
from dashpot.check.deficiencies import in_words, require_identifiable
from dashpot.check.identifiability import structure
from dashpot.errors import IdentifiabilityError
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.rigfile import Rig
from tests.rigs import channels, paper_rig
from tests.two_masses import SEEN, two_mass_rig


def told(rig: Rig) -> list[tuple[str, str]]:
    found = structure(rig.model, rig.channels)
    return [in_words(one, found, rig.model, rig.channels) for one in found.deficiencies]


LONE = 'coordinates = ["x1"]\n[inputs]\nu = {}\n[masses]\nm0 = { at = "u" }\nm1 = { at = "x1", value = 1 }\n'
SERIES = LONE.replace('["x1"]', '["x1", "j"]').replace('m0 = { at = "u" }\n', "")
CALIBRATED = "".join(f'{x} = {{ of = "{x}", delay = "unknown" }}\n' for x in ("x1", "x2", "u"))
SEEN_ALONE = '[channels]\nx1 = { of = "x1" }\nu = { of = "u" }\n'
CASES: dict[str, tuple[Callable[[], Rig], str, str]] = {
    "side by side": (
        lambda: two_mass_rig(dampers='c5 = { between = ["ground", "x2"] }\n'),
        "both join x2 to ground",
        "give c4 or c5 a value",
    ),
    "three, one at a lever": (
        lambda: two_mass_rig(dampers='c5 = { between = ["ground", "x2"] }\nc6 = { along = { x2 = 0.5 } }\n'),
        "only c4 + c5 + 0.25·c6",
        "give 2 of c4, c5 and c6 a value",
    ),
    "nothing known": (lambda: two_mass_rig(k1=""), "only the ratios", "or measure the force that moves u"),
    "a force of unknown gain": (
        lambda: two_mass_rig(k1="", seen=SEEN + 'r = { of = "u", quantity = "force", gain = "unknown" }\n'),
        "m1·r.gain",
        "",
    ),
    "what more sensors would show": (
        lambda: two_mass_rig(
            seen=SEEN_ALONE, dampers='c3 = { between = ["x1", "ground"] }\nc1 = { between = ["x1", "x2"] }\n'
        ),
        "",
        "or measure x2 or the force that moves u",
    ),
    "in series": (
        lambda: parse_rig(
            f'{SERIES}[springs]\nk1 = {{ between = ["x1", "j"] }}\nk2 = {{ between = ["j", "u"] }}\n{SEEN_ALONE}'
        ),
        "they are in series through j",
        "give k1 or k2 a value, or measure j",
    ),
    "delays": (
        lambda: two_mass_rig(seen=f"[channels]\n{CALIBRATED}"), "x1.delay - u.delay, x2.delay - u.delay can be", "",
    ),
    "gains": (
        lambda: two_mass_rig(seen=f"[channels]\n{CALIBRATED.replace('delay', 'gain')}"), "only the ratios of x1", "",
    ),
    "an input that nobody measures": (
        lambda: two_mass_rig(seen='[channels]\nx1 = { of = "x1" }\n'), "the input u is unmeasured", "measure u",
    ),
    "a mass on the base": (
        lambda: parse_rig(f'{LONE}[springs]\nk1 = {{ between = ["x1", "u"] }}\n{SEEN_ALONE}'),
        "depends on m0",
        "or measure the force that moves u",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_cannot_be_found_is_told_with_its_cure(case: str) -> None:
    make, what, cure = CASES[case]
    [(said, advice)] = told(make())
    assert what in said
    assert cure in advice
    assert case != "a force of unknown gain" or "measure" not in advice


def test_refusal_names_the_file() -> None:
    rig = paper_rig()
    free = replace(rig.model, elements=tuple(replace(e, value=None) for e in rig.model.elements))
    with pytest.raises(IdentifiabilityError) as refused:
        require_identifiable(free, channels(rig), "rig.toml")
    assert refused.value.exit_code == 3
    assert str(refused.value).startswith("rig.toml: no mass, stiffness or force is known")


def test_free_matrices_with_a_point_unseen_are_told_in_plain_numbers() -> None:
    rig = parse_rig(
        'free = "MCK"\ncoordinates = ["x1", "x2", "x3"]\n[inputs]\nf = { kind = "force", at = "x3" }\n[channels]\n'
        'x1 = { of = "x1" }\nx3 = { of = "x3" }\nf = { of = "f", quantity = "force" }\n'
    )
    ((what, cure),) = told(rig)
    assert "can change together" in what
    assert "m_x2 +100 %" in what
    assert "e+" not in what
    assert cure == "give 3 of m_x1, m_x2, m_x3, m_x1_x2 and 14 others a value, or measure x2"


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
    first, second = (problem.what for problem in refused.value.problems)
    assert "k5 + more4" in first
    assert "both join x5 to x4" in first
    assert "k10 + more9" in second
    assert "both join x10 to x9" in second
    require_identifiable(*long_chain(n, doubled=False))


def test_large_rigs_are_checked_for_more_than_elements_side_by_side() -> None:
    """24 coordinates: every fourth seen is enough, and a spring from the base to the ground leaves no trace."""
    model, seen = long_chain(24, doubled=False)
    require_identifiable(model, (*seen[3:-1:4], seen[-1]))
    loose = replace(model, elements=(*model.elements, between("idle", Kind.SPRING, "u", "ground")))
    with pytest.raises(IdentifiabilityError, match="idle"):
        require_identifiable(loose, seen)


def test_gains_of_a_release_that_only_the_start_would_tell_are_refused_before_the_fit() -> None:
    """A single channel's gain is that of the unknown release; of two only the ratio can be found."""
    rig = parse_rig(
        'coordinates = ["x"]\n[masses]\nm = { at = "x", value = 1 }\n[springs]\nk = { between = ["x", "ground"] }\n'
        '[channels]\ncam = { of = "x", unit = "px", gain = "unknown" }\n'
    )
    with pytest.raises(IdentifiabilityError, match=r"cam\.gain"):
        require_identifiable(rig.model, rig.channels)
    scaled = parse_rig(
        'coordinates = ["x"]\n[masses]\nm = { at = "x", value = 1 }\n[springs]\nk = { between = ["x", "ground"] }\n'
        '[channels]\ncam = { of = "x", unit = "px", gain = "unknown" }\nlaser = { of = "x", unit = "mm" }\n'
    )
    require_identifiable(scaled.model, scaled.channels)
