"""Any rig that a file can describe is written and read back unchanged; any text at all gives a rig or a ModelError."""

import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.channel import Channel, Quantity
from dashpot.errors import ModelError, Problem
from dashpot.io.toml_document import Lines
from dashpot.model.elements import Element, Kind
from dashpot.model.network import Input, Model
from dashpot.model.rigfile import SECTIONS, Rig, parse_rig, write_rig
from dashpot.units import scale

NAMES = st.one_of(
    st.from_regex(r"[a-zA-Z_][a-zA-Z0-9_]{0,6}", fullmatch=True),
    st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=6),
).filter(lambda name: name.isprintable() and name == name.strip() and name not in ("ground", "?"))
FACTORS = st.floats(-1e6, 1e6).filter(lambda x: abs(x) >= 1e-30) | st.sampled_from([1.0, -1.0])
SIZES = st.floats(1e-12, 1e15)
UNITS = {
    (Quantity.DISPLACEMENT, False): ["m", "mm", "µm", "in"],
    (Quantity.VELOCITY, False): ["m/s", "mm/s"],
    (Quantity.ACCELERATION, False): ["m/s²", "g", "mg"],
    (Quantity.DISPLACEMENT, True): ["rad", "deg"],
    (Quantity.VELOCITY, True): ["rad/s", "rpm"],
    (Quantity.ACCELERATION, True): ["rad/s²"],
}


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    names = draw(st.lists(NAMES, min_size=4, max_size=16, unique=True))
    counts = draw(st.tuples(st.integers(1, 3), st.integers(0, 2), st.integers(0, 2)))
    coordinates, bases, forces = names[: counts[0]], [], []
    rest = names[counts[0] :]
    for group, count in ((bases, counts[1]), (forces, counts[2])):
        group.extend(rest[:count] if len(rest) > count else [])
        rest = rest[len(group) :]
    points = [*coordinates, *bases]
    angles = draw(st.frozensets(st.sampled_from(points)))
    inputs = [Input(name) for name in bases]
    inputs += [Input(name, "force", draw(tables(coordinates))) for name in forces]
    # All points are attached by the first element
    along = [dict.fromkeys(points, 1.5), *(draw(tables(points)) for _ in rest[1:])]
    kinds = sorted(
        draw(st.lists(st.sampled_from([*Kind]), min_size=len(rest), max_size=len(rest))), key=[*Kind].index
    )
    elements: list[Element] = []
    for name, kind, one in zip(rest, kinds, along, strict=True):
        elements.append(draw(element(name, kind, one, elements, angles)))
    model = Model(tuple(coordinates), tuple(inputs), tuple(elements), draw(st.text(max_size=8)), angles)
    channel_names = draw(st.lists(NAMES, max_size=4, unique=True))
    return Rig(model, tuple(draw(channel(name, model)) for name in channel_names), "rig.toml")


def tables(points: list[str]) -> st.SearchStrategy[dict[str, float]]:
    return st.dictionaries(st.sampled_from(points), FACTORS, min_size=1, max_size=3)


@st.composite
def element(
    draw: st.DrawFn,
    name: str,
    kind: Kind,
    along: dict[str, float],
    before: list[Element],
    angles: frozenset[str],
) -> Element:
    def turned(one: dict[str, float]) -> bool:
        return set(one) <= angles

    roots = [one.name for one in before if one.kind == kind and turned(dict(one.along)) == turned(along)]
    match draw(st.sampled_from(["known", "prior", "guess", "limits", "tied"])):
        case "known":
            return Element(name, kind, along, value=draw(SIZES | st.just(0.0)))
        case "prior":
            return Element(name, kind, along, value=draw(SIZES), sd=draw(SIZES))
        case "limits":
            return Element(name, kind, along, lower=-draw(SIZES), guess=0.0, upper=draw(SIZES))
        case "tied" if roots:
            return Element(name, kind, along, same_as=draw(st.sampled_from(roots)), times=draw(FACTORS))
    return Element(name, kind, along, guess=draw(st.none() | SIZES))


@st.composite
def channel(draw: st.DrawFn, name: str, model: Model) -> Channel:
    calibration = {
        "gain": draw(st.none() | FACTORS),
        "delay": draw(st.none() | FACTORS),
        "sign": draw(st.none() | st.sampled_from([1.0, -1.0])),
        "noise": draw(st.just(0.0) | SIZES),
        "relative_noise": draw(st.just(0.0) | SIZES),
        "rate": draw(st.none() | SIZES),
    }
    if model.force_inputs and draw(st.booleans()):
        (one, *_) = [one for one in model.inputs if one.kind == "force"]
        unit = "N·m" if set(one.at) <= model.angles else "kN"
        factor = scale(unit, "force", unit == "N·m")
        return Channel(name, {one.name: 1.0}, Quantity.FORCE, unit, factor, **calibration)
    of = draw(tables([*model.coordinates, *model.displacement_inputs]))
    angular = set(of) <= model.angles
    quantity = draw(st.sampled_from([Quantity.DISPLACEMENT, Quantity.VELOCITY, Quantity.ACCELERATION]))
    unit = draw(st.sampled_from([*UNITS[quantity, angular], "mV"]))
    return Channel(name, of, quantity, unit, scale(unit, quantity, angular, unit == "mV"), **calibration)


@pytest.mark.slow
@settings(max_examples=60)
@given(rigs())
def test_a_rig_is_written_with_a_line_for_each_element_and_read_back_unchanged(rig: Rig) -> None:
    text = write_rig(rig)
    assert parse_rig(text) == rig
    lines, sections = Lines(text), {kind: section for section, kind in SECTIONS.items()}
    found = [lines.of((sections[one.kind], one.name)) for one in rig.model.elements]
    assert None not in found
    assert found == sorted(set(found))  # type: ignore[type-var]


def check(text: str) -> None:
    """A rig, or problems of one line each with a place and a cure."""
    problems: tuple[Problem, ...] = ()
    try:
        parse_rig(text)
    except ModelError as error:
        problems = error.problems
    for problem in problems:
        assert "\n" not in str(problem)
        assert problem.where.startswith("rig.toml")
        assert problem.cure


@pytest.mark.slow
@given(st.text())
def test_any_text_gives_a_rig_or_a_model_error(text: str) -> None:
    check(text)


WORDS = (
    "name coordinates angles inputs masses springs channels x1 u k1 at between along value sd min max unit same_as "
    "times of quantity gain kind noise rate"
)
LEAVES = """ "x1" "u" "ground" "k1" "force" "mm" "unknown" "5mV/g" 1 -2.5 true nan inf 1e999 07:32:00 "" """
KEYS = st.sampled_from(WORDS.split())
VALUES = st.recursive(
    st.sampled_from([*LEAVES.split(), "'''\n'''"]),
    lambda inner: (
        st.lists(inner, max_size=3).map(lambda items: "[" + ", ".join(items) + "]")
        | st.dictionaries(KEYS, inner, max_size=4).map(
            lambda items: "{ " + ", ".join(f"{key} = {value}" for key, value in items.items()) + " }"
        )
    ),
    max_leaves=8,
)
DOCUMENTS = st.lists(
    st.one_of(st.tuples(KEYS, VALUES).map(" = ".join), KEYS.map("[{}]".format), KEYS.map("[[{}]]".format)),
    max_size=12,
).map("\n".join)


@given(DOCUMENTS)
def test_any_toml_gives_a_rig_or_problems_at_lines(text: str) -> None:
    check(text)


@given(DOCUMENTS)
def test_every_key_of_any_toml_has_a_line(text: str) -> None:
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    lines = Lines(text)
    for key, value in document.items():
        assert lines.of((key,)) is not None
        if isinstance(value, dict):
            assert all(lines.of((key, inner)) is not None for inner in value)
