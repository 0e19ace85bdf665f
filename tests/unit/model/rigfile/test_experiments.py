"""[experiments] of rig files: read, written, and told where they make no sense."""

import pytest

from dashpot.errors import ModelError, UsageError
from dashpot.model.rigfile import parse_rig, write_rig

HEAD = """
coordinates = ["x1", "x2"]
[inputs]
u = { kind = "displacement" }
[masses]
m1 = { at = "x1" }
m2 = { at = "x2", guess = 2 }
[springs]
k1 = { between = ["x1", "x2"], unit = "N/mm", value = 4.6, sd = 0.1 }
k2 = { between = ["x2", "u"] }
k3 = { between = ["x2", "ground"], same_as = "k1", times = 2 }
[dampers]
c1 = { between = ["x1", "x2"], value = 3 }
[channels]
x1 = { of = "x1", unit = "mm" }
x2 = { of = "x2", unit = "mm", gain = "unknown" }
f = { of = "k1", quantity = "force" }
u = { of = "u", unit = "mm" }
"""
BODY = """
[experiments.added]
data = "run2*.csv"
masses.extra = { at = "x1", value = "500 g" }
k1 = 5.1
c1 = "own"
x1.gain = { value = 1, sd = "1 %" }
[experiments.later]
m2 = { value = 1.2, sd = 0.01 }
x2.gain = 1.02
"""


def test_what_differs_is_elements_and_channels_of_one_experiment() -> None:
    rig = parse_rig(HEAD + BODY)
    own = {e.name: e for e in rig.model.elements if e.only is not None}
    assert rig.model.experiments == ("added", "later")
    assert own["extra"].value == 0.5
    assert own["k1@added"].value == 5100.0  # in the unit of k1
    assert (own["c1@added"].value, own["c1@added"].guess) == (None, 3.0)
    assert (own["m2@later"].value, own["m2@later"].sd) == (1.2, 0.01)
    assert own["k3@added"].same_as == "k1@added"  # what is tied follows
    assert [c.name for c in rig.all_channels] == ["x1", "x2", "f", "u", "x1@added", "x2@later"]
    assert rig.model.unknown_names == ("m1", "m2", "k1", "k2", "c1@added", "m2@later")
    there = [
        e.name for e, acts in zip(rig.model.elements, rig.model.standing_in(1).acts, strict=True) if acts
    ]
    assert there == ["m1", "m2", "k2", "extra", "k1@added", "c1@added", "k3@added"]


def test_written_it_reads_back_to_the_same_rig() -> None:
    rig = parse_rig(HEAD + BODY)
    again = parse_rig(write_rig(rig))
    assert (again.model, again.all_channels, again.experiments) == (
        rig.model,
        rig.all_channels,
        rig.experiments,
    )


def test_one_experiment_is_a_rig_of_its_own() -> None:
    rig = parse_rig(HEAD + BODY)
    added, usual = rig.in_experiment("added"), rig.in_experiment()
    assert added.model.unknown_names == ("m1", "m2", "k2", "c1@added")
    assert added.channels[0].gain is None
    assert added.channels[2].of == {"k1@added": 1.0}
    assert usual.model.unknown_names == ("m1", "m2", "k1", "k2")
    assert not added.experiments
    with pytest.raises(UsageError, match="did you mean"):
        rig.in_experiment("addde")
    with pytest.raises(UsageError, match="added"):
        usual.in_experiment("added")


@pytest.mark.parametrize(
    ("line", "place"),
    [
        ("m9 = 1", "experiments.added.m9"),
        ("x1.gian = 2", "experiments.added.x1.gian"),
        ("x1 = 3", "experiments.added.x1"),
        ('m1 = "abc"', "experiments.added.m1"),
        ("m1 = { value = -1 }", "experiments.added.m1"),
        ('masses.extra = { at = "x7", value = 1 }', "experiments.added.masses.extra.at"),
        ("masses = 3", "experiments.added.masses"),
        ('k1 = "3 kg"', "experiments.added.k1"),
        ("data = 3", "experiments.added.data"),
        ("x1.gain = 0", "experiments.added.x1.gain"),
        ('x1.gain = { of = "cal" }', "experiments.added.x1.gain.of"),
        ("c1.gain = 2", "experiments.added.c1.gain"),
        ('masses.k2 = { at = "x1", value = 1 }', "k2"),
    ],
)
def test_what_makes_no_sense_is_told_at_its_place(line: str, place: str) -> None:
    with pytest.raises(ModelError, match=place) as error:
        parse_rig(f"{HEAD}[experiments.added]\n{line}\n")
    assert len(error.value.problems) == 1


def test_nonlinear_rigs_do_not_differ() -> None:
    text = HEAD.replace('k2 = { between = ["x2", "u"] }', 'k2 = { between = ["x2", "u"], law = "d**3" }')
    with pytest.raises(ModelError, match="nonlinear"):
        parse_rig(text + BODY)
