"""Drawings as files: values of an estimate, what is in doubt, modes that move."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import dashpot
from dashpot import Estimate, Kind, Model, UsageError, between, mass, parse_rig
from dashpot.check.evidence import doubtful, undetermined
from dashpot.present.estimate import parameter_rows
from dashpot.present.schematic.drawing import mode_drawing, numbered_mode, schematic
from dashpot.present.schematic.placing import elongation, law_in_symbols
from tests.networks import network
from tests.two_masses import UNDETERMINED
from tests.unit.present.conftest import RIG

SVG = "{http://www.w3.org/2000/svg}"


def texts(svg: str) -> list[str]:
    """All texts, which must be well-formed XML."""
    return [element.text or "" for element in ElementTree.fromstring(svg).iter(f"{SVG}text")]


def test_what_xml_forbids_or_turns_text_is_shown_escaped() -> None:
    svg = schematic(replace(RIG.model, name="a\ufffeb\u202ec"), RIG.channels).svg()
    ElementTree.fromstring(svg)
    assert not {"\ufffe", "\u202e"} & set(svg)
    assert "202e" in svg


def test_values_and_intervals_are_those_of_the_tables(good: Estimate) -> None:
    found = texts(schematic(RIG.model, RIG.channels, good).svg())
    for row in parameter_rows(good):
        if row.name in {element.name for element in RIG.model.elements}:
            assert any(text.startswith(f"{row.name} = {row.value}") for text in found)
            assert not row.low or f"{row.low} … {row.high}" in found


def test_doubt_is_a_wide_interval_or_an_iteration_without_end(good: Estimate) -> None:
    index = 1
    name = good.names[index]
    covariance = good.covariance.copy()
    sure = doubtful(good)
    covariance[index, index] = good.values[index] ** 2 / 9
    assert doubtful(replace(good, covariance=covariance)) == (*sure, name)
    assert doubtful(replace(good, converged=np.asarray(False))) == good.names
    svg = schematic(RIG.model, RIG.channels, good, [name]).svg()
    assert any(text.startswith(f"{name} = ") and text.endswith("(?)") for text in texts(svg))
    assert "stroke-dasharray" in svg


def test_what_channels_cannot_determine_is_doubtful() -> None:
    rig = parse_rig(UNDETERMINED)
    assert set(undetermined(rig.model, rig.channels)) == {"k1", "k2"}
    assert [text for text in texts(rig.draw().svg()) if text.endswith("? (?)")] == [
        "k1 = ? (?)",
        "k2 = ? (?)",
    ]


def test_known_unknown_and_doubtful_differ_without_colour() -> None:
    model = network("x", "", "m@x k:x-ground=2 c:x-ground")
    shapes = {part.title: part.shapes[0] for part in schematic(model, doubtful=["c"]).parts if part.shapes}
    assert shapes["k: spring"].weight < shapes["c: damper"].weight
    assert shapes["c: damper"].dashed
    assert not shapes["k: spring"].dashed


@pytest.mark.slow
@pytest.mark.parametrize(("end", "head"), [("svg", b"<svg"), ("png", b"\x89PNG"), ("pdf", b"%PDF")])
def test_files(tmp_path: Path, good: Estimate, end: str, head: bytes) -> None:
    drawing = dashpot.draw(RIG, good)
    path = tmp_path / f"rig.{end}"
    drawing.save(path)
    content = path.read_bytes()
    assert content.startswith(head)
    drawing.save(path)
    assert path.read_bytes() == content
    RIG.draw(good, mode=1).save(path)
    assert path.read_bytes().startswith(head)
    with pytest.raises(UsageError, match=r"use \.svg"):
        drawing.save(tmp_path / "rig.jpg")


def test_the_same_parts_move_in_all_frames_and_as_the_mode_says(good: Estimate) -> None:
    title, shape = numbered_mode(RIG.model, good, 2)
    assert title.startswith(f"Mode 2: {good.modes.frequency_hz[1]:.4g}"[:10])
    drawing = mode_drawing(RIG.model, shape, title)
    assert len({tuple(len(part.shapes) for part in frame) for frame in drawing.frames}) == 1
    moved = {}
    for part in drawing.frames[0]:
        if part.title.startswith("body"):
            x = part.shapes[0].points[0][0]
            rest = np.mean(
                [next(p for p in f if p.title == part.title).shapes[0].points[0][0] for f in drawing.frames]
            )
            moved[part.title] = x - rest
    expected = 18.0 * shape.real / np.max(np.abs(shape))
    assert list(moved.values()) == pytest.approx(
        [expected[RIG.model.coordinates.index(name.removeprefix("body "))] for name in moved], abs=1e-6
    )
    svg = drawing.svg()
    ElementTree.fromstring(svg)
    assert len(re.findall("<animate ", svg)) > 5
    still = re.findall('<g class="still">(.*?)</g>\n</g>', svg, re.DOTALL)
    assert len(still) == svg.count('<g class="moving">') > 1
    assert not any("<animate " in group for group in still)
    assert "prefers-reduced-motion:reduce" in svg


def test_modes_of_stated_values_and_modes_that_are_not_there() -> None:
    model = Model(
        ("x",), (), (mass("m", "x", value=1.0), between("k", Kind.SPRING, "x", "ground", guess=4.0))
    )
    assert numbered_mode(model, None, 1)[0] == "Mode 1: 0.3183 Hz, damping ratio 0"
    with pytest.raises(UsageError, match="there is no mode"):
        numbered_mode(model, None, 2)


def test_laws_and_elongations_are_written_by_hand() -> None:
    assert law_in_symbols("d**2*v") == "d²·v"
    assert elongation({"x1": 0.5, "x2": -1.0, "u": -2.0}) == "0.5 x1 − x2 − 2 u"
    assert elongation({"x1": -1.0}) == "−x1"
