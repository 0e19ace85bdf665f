"""Drawings as geometry: nothing crosses a symbol, no text lies over another, over a line or beyond the edge."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest

from dashpot import Element, Estimate, Input, Kind, Model, between, mass, parse_rig, read_rig
from dashpot.channel import Channel, Quantity
from dashpot.present.schematic.bodies import connections
from dashpot.present.schematic.drawing import Drawing, folded, schematic
from dashpot.present.schematic.symbols import Box, Part, Text, stroke, text_width
from tests import rigs
from tests.unit.present.conftest import RIG

ROOT = Path(__file__).parents[3]
EXAMPLES = [
    path
    for path in sorted((ROOT / "examples").rglob("*.toml"))
    if "coordinates =" in path.read_text(encoding="utf-8")
]
TOUCH = 0.6  # px by which boxes shrink before they are compared: lines end on their edges


def overlap(a: Box, b: Box) -> bool:
    """Whether the two share an area."""
    return a.left < b.right and b.left < a.right and a.top < b.bottom and b.top < a.bottom


def within(a: Box, b: Box) -> bool:
    """Whether a lies inside b."""
    return b.left <= a.left and b.top <= a.top and a.right <= b.right and a.bottom <= b.bottom


def texts_of(parts: Iterable[Part]) -> list[Text]:
    return [text for part in parts for text in part.texts]


def faults(drawing: Drawing) -> list[str]:
    """What crosses, overlaps or is cut off."""
    placed, found = drawing.placed, []
    solid = [(part.title, part.box.grown(-TOUCH)) for part in placed.parts if part.box is not None]
    texts = [(repr(text.line.text), text.box.grown(-TOUCH)) for text in texts_of(placed.parts)]
    found += [f"{a[0]} over {b[0]}" for a, b in combinations(solid, 2) if overlap(a[1], b[1])]
    found += [f"{a[0]} over {b[0]}" for a, b in combinations(texts, 2) if overlap(a[1], b[1])]
    bodies = {part.title for part in (*placed.walls, *placed.bodies)}
    for name, box in texts:
        for what, other in solid:
            if overlap(box, other) and not (what in bodies and within(box, other)):
                found.append(f"{name} over {what}")
    for wire in placed.wires:
        for a, b in pairwise(wire.points):
            assert a.x == b.x or a.y == b.y
            line = Box(min(a.x, b.x), min(a.y, b.y), max(a.x, b.x), max(a.y, b.y)).grown(1e-9)
            found += [f"line {a}-{b} through {what}" for what, box in [*solid, *texts] if overlap(line, box)]
    frame = Box(0, 0, drawing.width, drawing.height)
    for part in drawing.parts:
        points = [point for shape in part.shapes for point in shape.points]
        ends = [Box(point.x, point.y, point.x, point.y) for point in points]
        inside = [text.box for text in part.texts] + ends
        found += [f"{part.title} is cut off" for box in inside if not within(box, frame)]
    everything = [text.box.grown(-TOUCH) for text in texts_of(drawing.parts)]
    found += ["texts overlap in the frame" for a, b in combinations(everything, 2) if overlap(a, b)]
    drawn = sorted(part.title for part in placed.links if ": " in part.title)
    elements = [e for e in drawing.model.elements if not e.free and e.kind is not Kind.MASS]
    if drawn != sorted(f"{e.name}: {e.kind}" for e in elements):
        found.append(f"elements {drawn} of {len(elements)}")
    return found


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_examples(path: Path) -> None:
    rig = read_rig(path)
    assert faults(schematic(rig.model, rig.channels)) == []


def random_drawing(seed: int) -> Drawing:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 10))
    rig = None
    while rig is None:
        inputs = int(rng.integers(0, 4)), int(rng.integers(0, 3))
        rig = rigs._throw(rng, n, *inputs, rigs.ALL_KINDS, True, True, 0.3, 12, False)
    channels = rigs.channels(rig, (Quantity.DISPLACEMENT, Quantity.ACCELERATION), rng)
    if n > 2:
        one, two = (str(name) for name in rng.choice(rig.model.coordinates, 2, replace=False))
        channels += (Channel("rel", {one: 1.0, two: -1.0}), Channel("load", {"s1": 1.0}, Quantity.FORCE))
    names = rng.choice([u.name for u in rig.model.unknowns], size=2).tolist()
    return schematic(rig.model, channels, doubtful=names)


@pytest.mark.parametrize("seed", range(25))
def test_random_rigs(seed: int) -> None:
    assert faults(random_drawing(seed)) == []


def test_values_and_intervals_have_room(good: Estimate) -> None:
    assert faults(schematic(RIG.model, RIG.channels, good, good.names)) == []


def chain_with(extra: tuple[Element, ...], n: int = 5) -> Model:
    names = tuple(f"x{i + 1}" for i in range(n))
    elements = [mass(f"m{i}", name) for i, name in enumerate(names)]
    elements += [
        between(f"k{i}", Kind.SPRING, name, names[i - 1] if i else "u") for i, name in enumerate(names)
    ]
    return Model(names, (Input("u"),), (*elements, *extra), "chain")


@pytest.mark.parametrize(
    "extra",
    [
        (between("a", Kind.SPRING, "x1", "x3"), between("b", Kind.SPRING, "x2", "x4")),
        tuple(between(f"s{i}", Kind.DAMPER, "u", f"x{i}") for i in range(2, 6)),
        tuple(
            between(f"s{i}{j}", Kind.SPRING, f"x{i}", f"x{j}") for i in range(1, 6) for j in range(i + 2, 6)
        ),
        (Element("lever", Kind.SPRING, {"x1": 0.3, "x4": 0.7, "x5": -2.0}),),
        (Element("J", Kind.MASS, {"x1": 0.5, "x5": -0.5}),),
        (Element("w", Kind.SPRING, {"u": 1.0}), Element("sum", Kind.DAMPER, {"x1": 1.0, "x2": 1.0})),
    ],
    ids=["crossed", "fan", "complete", "lever", "rotary mass", "odd"],
)
def test_skips_and_levers(extra: tuple[Element, ...]) -> None:
    assert faults(schematic(chain_with(extra))) == []


def test_long_names_and_other_scripts_have_room() -> None:
    long = "a_rather_long_name_of_a_coordinate_in_a_rig"
    model = Model(
        (long, "質量"),
        (Input("u"), Input("Kraft ↑ <&>", "force", {long: 0.5, "質量": -1.0})),
        (
            mass("m" * 40, long), mass("質量の名前", "質量"), between("k", Kind.SPRING, long, "u"),
            between("c", Kind.DAMPER, long, "質量"), between("k_g", Kind.SPRING, long, "ground"),
        ),
        "A name that is very much longer than the drawing is wide, so that it has to go on in a second line",
    )  # fmt: skip
    drawing = schematic(model)
    assert faults(drawing) == []
    assert "Kraft ↑ &lt;&amp;&gt;" in drawing.svg()


def test_a_rigid_body_is_one_body() -> None:
    rig = parse_rig(
        """
        coordinates = ["z", "pitch"]
        angles = ["pitch"]
        [inputs]
        front = {}
        rear = {}
        [masses]
        m = { at = "z" }
        J = { at = "pitch" }
        [springs]
        kf = { along = { z = 1, pitch = 1.2, front = -1 } }
        kr = { along = { z = 1, pitch = -1.4, rear = -1 } }
        """
    )
    drawing = schematic(rig.model, rig.channels)
    assert faults(drawing) == []
    assert [body.role for body in connections(rig.model, rig.channels).bodies] == ["base", "base", "body"]
    assert "z + 1.2 pitch − front" in drawing.svg()


def test_the_geometry_check_sees_faults() -> None:
    drawing = schematic(chain_with(()))
    moved = tuple(
        replace(link, box=replace(link.box, left=link.box.left - 60)) for link in drawing.placed.links
    )
    assert faults(replace(drawing, placed=replace(drawing.placed, links=moved)))


def test_many_elements_are_drawn_with_names_only_and_too_many_bodies_are_refused() -> None:
    more = tuple(between(f"d{i}", Kind.DAMPER, f"x{i % 5 + 1}", "ground", value=3.25) for i in range(60))
    drawing = schematic(chain_with(more))
    assert faults(drawing) == []
    assert "3.25" not in "".join(text.line.text for text in texts_of(drawing.placed.parts))
    with pytest.raises(Exception, match="too many for a drawing"):
        schematic(chain_with((), 60))


def test_text_widths_are_those_of_the_font() -> None:
    assert text_width("m" * 10, 10) == pytest.approx(2 * text_width("m" * 5, 10))
    assert text_width("i", 10) < text_width("m", 10) < text_width("m", 10, bold=True)


def storeys(count: int, bays: int) -> Model:
    """A frame: masses in storeys, each held by the one below and, within a storey, by the next."""
    elements, names = [], []
    for i in range(count):
        for j in range(bays):
            names.append(f"x{i}_{j}")
            below = f"x{i - 1}_{j}" if i else "u"
            elements += [mass(f"m{i}_{j}", names[-1]), between(f"k{i}_{j}", Kind.SPRING, below, names[-1])]
            if j:
                elements.append(between(f"h{i}_{j}", Kind.SPRING, names[-2], names[-1]))
    return Model(tuple(names), (Input("u"),), tuple(elements), "frame")


@pytest.mark.parametrize(
    "model", [chain_with((), 18), chain_with((), 39), storeys(8, 3)], ids=["chain 18", "chain 39", "frame 24"]
)
def test_wide_drawings_are_cut_into_rows_that_can_be_read(model: Model) -> None:
    drawing = schematic(model)
    assert faults(drawing) == []
    assert drawing.placed.width > 1440
    assert drawing.width <= 1100  # px, that a page shows
    planned = Counter(text.line.text for text in texts_of(drawing.placed.parts))
    written = Counter(text.line.text for part in drawing.parts for text in part.texts)
    assert planned <= written
    symbols = [part.title for part in drawing.parts if part.title.endswith(": spring")]
    assert len(set(symbols)) == sum(element.kind is Kind.SPRING for element in model.elements)


def test_cut_lines_go_on_at_the_same_height() -> None:
    line = Part("", (stroke(((0.0, 50.0), (2000.0, 50.0), (2000.0, 90.0)), "ink"),))
    boxes = [
        Part(f"box {k}", (stroke(Box(x, 0.0, x + 80, 40.0).corners, "ink", closed=True),))
        for k, x in enumerate(range(10, 2000, 200))
    ]
    parts, width, _ = folded([line, *boxes], 2010.0, 100.0)
    assert width < 1100  # px, that a page shows
    kept = [shape for part in parts if part.title for shape in part.shapes]
    assert len(kept) == len(boxes)
    pieces = [
        shape
        for part in parts
        if not part.title
        for shape in part.shapes
        if shape.points[0][1] == shape.points[1][1]
    ]
    assert sum(shape.points[1][0] - shape.points[0][0] for shape in pieces) == pytest.approx(2000.0)
    rows = sorted({shape.points[0][1] for shape in pieces})
    assert len(rows) == len(pieces) == 3
