"""Rig files: what they say, and that whatever is wrong with one is told in one clear line each."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.errors import ModelError
from dashpot.estimate.assessment import Finding, applied
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.rigfile import Rig, default_channels, edited, parse_rig, read_rig, write_rig

PAPER = """\
name = "Two masses on a shaken base"
coordinates = ["x1", "x2"]
[inputs]
u = { kind = "displacement" }                 # or "force"
[masses]
m1 = { at = "x1" }                            # unknown
m2 = { at = "x2", value = 2.7, sd = 0.01 }    # known with an uncertainty
[springs]
k1 = { between = ["x1", "x2"], value = 4600 }
k2 = { between = ["x2", "u"], value = 4600 }
[dampers]
c1 = { between = ["x1", "x2"], guess = 20 }
c2 = { between = ["x2", "u"] }
c3 = { between = ["x1", "ground"] }
c4 = { between = ["x2", "ground"] }
[channels]
x1   = { of = "x1", quantity = "displacement", unit = "mm" }
acc2 = { of = "x2", quantity = "acceleration", unit = "g" }
rel  = { of = { x1 = 1, x2 = -1 } }
u    = { of = "u", unit = "mm" }
"""

RICH = """\
name = "A rigid body on two springs, a flywheel and an absorber"
coordinates = ["x", "pitch", "wheel"]
angles = ["pitch", "wheel", "turn"]
[inputs]
u = {}
turn = { kind = "displacement" }
f = { kind = "force", at = "x" }
pair = { kind = "force", at = { x = 1, pitch = -0.3 } }
torque = { kind = "force", at = ["pitch", "wheel"] }
[masses]
m = { at = "x", value = 12, unit = "lb" }
J = { at = "pitch", value = 250, sd = 5, unit = "kg cm^2" }
Jw = { at = "wheel", guess = 0.1, min = 0.01, max = 1 }
tip = { along = { x = 1, pitch = 0.5 } }
[springs]
front = { along = { x = 1, pitch = 0.4, u = -1 }, value = 10, unit = "N/mm" }
rear = { along = { x = 1, pitch = -0.4, u = -1 }, same_as = "front", times = 2 }
twist = { between = ["pitch", "wheel"], value = 3, unit = "N·m/deg" }
arm = { along = { pitch = 0.25 }, value = 1, unit = "N/mm" }
drive = { between = ["wheel", "turn"] }
[dampers]
cf = { between = ["x", "u"], unit = "kg/s", guess = 4 }
[inerters]
b = { between = ["x", "u"] }
[hysteretic]
h = { at = "x", value = 2, unit = "kN/m" }
[channels]
pitch = { of = "pitch", unit = "deg" }
speed = { of = "wheel", quantity = "velocity", unit = "rpm" }
corner = { of = { x = 1, pitch = 0.4 }, quantity = "acceleration", unit = "V", gain = "100 mV/g", delay = 1e-3 }
raw = { of = "x", quantity = "acceleration", unit = "mV", gain = "unknown", delay = "unknown", sign = "unknown" }
base_force = { of = "u", quantity = "force", unit = "kN" }
spring_force = { of = "front", unit = "N" }
sum = { of = { front = 1, cf = 1 }, quantity = "force" }
f = { of = "f", unit = "lbf", noise = 0.05, relative_noise = 0.1, rate = 1000 }
torque = { of = "torque", unit = "N·mm" }
"""


def problems(text: str, path: str = "rig.toml") -> list[str]:
    """Messages about a text, after checking their form."""
    with pytest.raises(ModelError) as caught:
        parse_rig(text, path)
    for problem in caught.value.problems:
        assert "\n" not in str(problem)
        assert problem.what
        assert problem.cure
        assert problem.where.startswith(path)
    return [str(problem) for problem in caught.value.problems]


def rig(body: str, head: str = 'coordinates = ["x1", "x2"]') -> str:
    """A rig file of a head line and a body that starts in line 2."""
    return f"{head}\n{body}"


class TestReading:
    def test_the_example_of_the_design(self) -> None:
        read = parse_rig(PAPER)
        model = read.model
        assert model.name == "Two masses on a shaken base"
        assert model.coordinates == ("x1", "x2")
        assert model.inputs == (Input("u"),)
        assert " ".join(element.name for element in model.elements) == "m1 m2 k1 k2 c1 c2 c3 c4"
        assert [unknown.name for unknown in model.unknowns] == ["m1", "m2", "c1", "c2", "c3", "c4"]
        m2, c1 = model.elements[1], model.elements[4]
        assert (m2.value, m2.sd) == (2.7, 0.01)
        assert c1 == Element("c1", Kind.DAMPER, {"x1": 1.0, "x2": -1.0}, guess=20.0)
        assert model.elements[3].along == {"x2": 1.0, "u": -1.0}
        assert model.elements[6].along == {"x1": 1.0}
        x1, acc2, rel, u = read.channels
        assert x1 == Channel("x1", {"x1": 1.0}, Quantity.DISPLACEMENT, "mm", 1e-3)
        assert (acc2.quantity, acc2.scale) == (Quantity.ACCELERATION, 9.80665)
        assert (rel.of, rel.unit, rel.scale) == ({"x1": 1.0, "x2": -1.0}, "m", 1.0)
        assert u.of == {"u": 1.0}

    def test_levers_angles_units_ties_and_calibrations(self) -> None:
        read = parse_rig(RICH)
        by_name = {element.name: element for element in read.model.elements}
        assert by_name["m"].value == pytest.approx(12 * 0.45359237)
        assert (by_name["J"].value, by_name["J"].sd) == pytest.approx((0.025, 0.0005))
        assert (by_name["Jw"].lower, by_name["Jw"].guess, by_name["Jw"].upper) == (0.01, 0.1, 1.0)
        assert by_name["front"].value == 10e3
        assert (by_name["rear"].same_as, by_name["rear"].times) == ("front", 2.0)
        assert by_name["twist"].value == pytest.approx(3 * 180 / np.pi)
        assert (
            by_name["arm"].value == 1000.0
        )  # the factor 0.25 is an arm in m, which makes a length of the angle
        assert by_name["h"].value == 2000.0
        inputs = {one.name: one for one in read.model.inputs}
        assert inputs["f"].at == {"x": 1.0}
        assert inputs["pair"].at == {"x": 1.0, "pitch": -0.3}
        assert inputs["torque"].at == {"pitch": 1.0, "wheel": 1.0}
        channels = {channel.name: channel for channel in read.channels}
        assert channels["pitch"].scale == pytest.approx(np.pi / 180)
        assert channels["speed"].scale == pytest.approx(2 * np.pi / 60)
        assert (channels["corner"].scale, channels["corner"].delay) == (1.0, 1e-3)
        assert channels["corner"].gain == pytest.approx(0.1 / 9.80665)
        assert (channels["raw"].scale, channels["raw"].gain) == (1e-3, None)
        assert (channels["raw"].delay, channels["raw"].sign) == (None, None)
        assert channels["base_force"].scale == 1e3
        assert channels["spring_force"].quantity == Quantity.FORCE
        assert (channels["f"].noise, channels["f"].relative_noise, channels["f"].rate) == (0.05, 0.1, 1000.0)
        assert channels["torque"].scale == pytest.approx(1e-3)

    def test_channels_of_their_own_names_where_the_file_lists_none(self) -> None:
        text = RICH[: RICH.index("[channels]")]
        read = parse_rig(text)
        assert " ".join(channel.name for channel in read.channels) == "x pitch wheel u turn f pair torque"
        assert [channel.unit for channel in read.channels] == ["m", "rad", "rad", "m", "rad", "N", "N", "N·m"]
        assert {channel.scale for channel in read.channels} == {1.0}
        assert read.channels == default_channels(read.model)

    def test_an_empty_section_of_channels_means_none(self) -> None:
        assert parse_rig(PAPER[: PAPER.index("[channels]")] + "[channels]\n").channels == ()

    def test_tables_dotted_keys_and_inline_tables_say_the_same(self) -> None:
        short = parse_rig(rig('[springs]\nk = { between = ["x1", "x2"], value = 3 }'))
        long = parse_rig(rig('[springs.k]\nbetween = [\n  "x1", # first\n  "x2",\n]\nvalue = 3.0'))
        dotted = parse_rig(
            'coordinates = ["x1", "x2"]\nsprings.k.between = ["x1", "x2"]\nsprings.k.value = 3'
        )
        assert short == long == dotted

    def test_between_at_and_along_say_the_same(self) -> None:
        ways = (
            'between = ["x1", "ground"]',
            'at = "x1"',
            "along = { x1 = 1 }",
            "along = { x1 = 1, ground = -1 }",
        )
        rigs = {parse_rig(rig(f"[springs]\nk = {{ {way} }}", 'coordinates = ["x1"]')) for way in ways}
        assert len(rigs) == 1

    @pytest.mark.parametrize("path", [str, Path])
    def test_from_a_file(self, tmp_path: Path, path: type) -> None:
        file = tmp_path / "rig.toml"
        file.write_text(PAPER, encoding="utf-8")
        assert read_rig(path(file)) == Rig(parse_rig(PAPER).model, parse_rig(PAPER).channels, str(file))

    @pytest.mark.parametrize(
        "raw",
        [PAPER.replace("\n", "\r\n").encode(), b"\xef\xbb\xbf" + PAPER.encode(), PAPER.encode().rstrip()],
        ids=["CRLF", "BOM", "no line end"],
    )
    def test_what_editors_do_to_files(self, tmp_path: Path, raw: bytes) -> None:
        file = tmp_path / "rig.toml"
        file.write_bytes(raw)
        assert read_rig(file).model == parse_rig(PAPER).model


class TestWriting:
    @pytest.mark.parametrize("text", [PAPER, RICH, RICH[: RICH.index("[channels]")]])
    def test_reads_back_to_the_same_rig(self, text: str) -> None:
        read = parse_rig(text)
        again = parse_rig(write_rig(read))
        assert again == read
        assert write_rig(again) == write_rig(read)

    def test_a_scale_that_no_unit_has(self) -> None:
        odd = Channel("x1", {"x1": 1.0}, scale=3.0)
        with pytest.raises(ModelError, match="scale"):
            write_rig(Rig(parse_rig(PAPER).model, (odd,)))


class TestFaultyFiles:
    @pytest.mark.parametrize(
        ("raw", "told"),
        [
            *((empty, "rig.toml: the file is empty") for empty in (b"", b"\n\n", b"\xef\xbb\xbf", b"  \t")),
            (b"# to do\n", "rig.toml: coordinates: missing"),
            ('coordinates = ["x1"]\nname = "Prüfstand"'.encode("latin-1"), "rig.toml:2: byte 0xfc"),
            (PAPER.encode("utf-16"), "rig.toml: the file is UTF-16"),
            (b"\0" * 100, "rig.toml:1:"),
        ],
    )
    def test_what_is_no_text_of_a_rig(self, tmp_path: Path, raw: bytes, told: str) -> None:
        path = tmp_path / "rig.toml"
        path.write_bytes(raw)
        with pytest.raises(ModelError) as caught:
            read_rig(path)
        (problem,) = caught.value.problems
        assert str(problem).startswith(f"{tmp_path}/{told}")
        assert "\n" not in str(problem)

    @pytest.mark.parametrize(
        ("name", "told"),
        [
            ("none.toml", "no such file"),
            (".", "this is a folder"),
            ("rig\0.toml", "cannot be read"),
            ("a/rig.toml", "cannot be read"),
        ],
    )
    def test_what_is_no_file(self, tmp_path: Path, name: str, told: str) -> None:
        (tmp_path / "a").write_text("")
        with pytest.raises(ModelError, match=told):
            read_rig(tmp_path / name)

    @pytest.mark.parametrize(
        ("line", "expected"),
        [
            ("k1 = ", "Invalid value"),
            ("k1 { }", "Expected '='"),
            ('k1 = "abc', 'texts end with " on the line'),
            ('k1 = """abc', "close the text"),
            ("k1 = 'abc", "close the text"),
            ("k1 = [1, 2", "close the list"),
            ("k1 = { at = x1 }", 'texts in quotes: "x1"'),
            ("k1 = 4,6", "decimals take a point"),
            ('k1 = { at = "x1",\n  value = 3 }', "stands on one"),
            ('k1 = { at = "x1", }', "remove the comma"),
            ("k1 = 01", "Expected newline"),
            ("[springs", "close the bracket"),
            ("k1 = 2020-13-45", "rig.toml:3"),
            ("k1 = " + "9" * 5000, "too many digits"),
            ("k1 = " + "[" * 5000, "nested too deep"),
            ("k1 = 1\nk1.x = 2", "Cannot"),
        ],
    )
    def test_what_is_not_toml(self, line: str, expected: str) -> None:
        (message,) = problems(f'name = "x"\ncoordinates = ["x1"]\n{line}\n')
        assert re.match(r"rig\.toml(:[345])?: ", message)
        assert expected in message

    @pytest.mark.parametrize(
        ("body", "where"),
        [
            ('[springs]\nk1 = { at = "x1" }\n\nk1 = { at = "x2" }', "rig.toml:5: springs.k1"),
            ('[springs]\nk1 = { at = "x1" }\n[dampers]\n[springs]', "rig.toml:5: springs"),
            ('[springs]\nk1 = { at = "x1", at = "x2" }', "rig.toml:3: springs.k1.at"),
            ('[springs.k1]\nat = "x1"\n[springs.k1]\nvalue = 3', "rig.toml:4: springs.k1"),
            ("coordinates = []", "rig.toml:2: coordinates"),
        ],
    )
    def test_a_key_given_twice(self, body: str, where: str) -> None:
        (message,) = problems(rig(body))
        assert re.fullmatch(
            re.escape(where) + r": given twice, first in line \d; remove one of them", message
        )


GOOD = '[masses]\nm1 = { at = "x1" }\nm2 = { at = "x2" }\n'  # lines 2 to 4


class TestFaultyEntries:
    @pytest.mark.parametrize(
        ("line", "expected"),
        [
            ('k = { at = "x1", value = "4600" }', 'springs.k.value: "4600"'),
            ('k = { at = "x1", value = "4,6" }', "write 4.6"),
            ('k = { at = "x1", value = "4600 N/s" }', 'springs.k.value: "N/s"'),
            ('k = { at = "x1", value = "unknown" }', "leave the key"),
            ('k = { at = "x1", value = "much" }', '"much" is text'),
            ('k = { at = "x1", value = true }', "springs.k.value: true is not a number"),
            ('k = { at = "x1", value = nan }', "springs.k.value: nan is not finite"),
            ('k = { at = "x1", guess = -inf }', "springs.k.guess: -inf is not finite"),
            ('k = { at = "x1", value = 1e200 }', "springs.k.value: '1e+200'"),
            ('k = { at = "x1", value = 1e999 }', "springs.k.value: inf is not finite"),
            ('k = { at = "x1", value = ' + "9" * 400 + " }", "springs.k.value: the number is too"),
            ('k = { at = "x1", value = 2020-01-01 }', "springs.k.value: 2020-01-01"),
            ('k = { at = "x1", value = [1] }', "springs.k.value: a list is not a number"),
            ('k = { at = "x1", value = -5 }', "springs.k: a spring of -5"),
            ('k = { at = "x1", valu = 3 }', "springs.k.valu: unknown key"),
            ('k = { at = "x1", unit = "N" }', 'springs.k.unit: "N"'),
            ('k = { at = "x1", unit = 3 }', "springs.k.unit: 3 is not text"),
            ('k = { at = "x1", between = ["x1", "x2"] }', "springs.k: at and between"),
            ("k = { value = 3 }", "springs.k: it is not attached"),
            ("k = {}", "springs.k: it is not attached"),
            ("k = 4600", 'springs.k: 4600 is not a table; write k = { between = ["x1", "ground"], value'),
            ("k = true", "springs.k: true is not a table"),
            ('k = "x1"', 'springs.k: "x1"'),
            ('k = ["x2", "x1"]', 'springs.k: a list is not a table; write k = { between = ["x2", "x1"] }'),
            ('name = "x"', "name stands above"),
            ('k = { between = ["x1", "x3"] }', 'springs.k.between: "x3"'),
            ('k = { between = ["x1", "Ground"] }', 'did you mean "ground"?'),
            ('k = { between = ["x1", "x1"] }', "springs.k.between: both ends are at x1"),
            ('k = { between = ["ground", "ground"] }', "springs.k.between: both ends are at ground"),
            ('k = { between = ["x1"] }', "springs.k.between: 1 point instead"),
            ('k = { between = ["x1", "x2", "u"] }', "along = {"),
            ('k = { between = "x1" }', 'springs.k.between: "x1"'),
            ('k = { between = ["x1", 2] }', "springs.k.between[1]: 2 is not text"),
            ('k = { at = "ground" }', "springs.k.at: it is attached"),
            ('k = { at = ["x1", "x2"] }', "springs.k.at: a list has no factors"),
            ('k = { along = "x1" }', 'springs.k.along: "x1"'),
            ("k = { along = {} }", "springs.k.along: the table names"),
            ("k = { along = { x1 = 0 } }", "springs.k.along.x1: the factor of x1"),
            ('k = { along = { x1 = "1" } }', 'springs.k.along.x1: "1"'),
            ("k = { along = { x1 = nan } }", "springs.k.along.x1: nan is not finite"),
            ("k = { along = { y = 1 } }", 'springs.k.along.y: "y"'),
            ('k = { at = "x1", same_as = "kk" }', 'springs.k.same_as: "kk"'),
            ('k = { at = "x1", same_as = "m1" }', "springs.k: a spring (N/m) cannot be tied to the mass m1"),
            ('m1 = { at = "x1" }', "springs.m1: the name m1"),
            ('"a\\nb" = { at = "x1" }', "is not a usable"),
        ],
    )
    def test_elements(self, line: str, expected: str) -> None:
        messages = problems(rig(f"{GOOD}[springs]\n{line}\n"))
        assert any(message.startswith("rig.toml:6: ") and expected in message for message in messages), (
            messages
        )
        assert len(messages) == 1 or "cannot be tied" in expected

    @pytest.mark.parametrize(
        ("body", "expected"),
        [
            ("[mases]", "2: mases: unknown key or section"),
            ("spring = 3", "2: spring: unknown key or section"),
            ("springs = 3", "2: springs: 3 is not a section"),
            ("[[springs]]", "2: springs: a list of tables"),
            ("[inputs]\nu = {}", "3: inputs.u: no element is attached"),
            ('[inputs]\nu = { kind = "displacment" }', 'did you mean "displacement"?'),
            ("[inputs]\nu = { kind = 3 }", "3: inputs.u.kind: 3 is not text"),
            ('[inputs]\nf = { kind = "force" }', "3: inputs.f: a force input"),
            ('[inputs]\nf = { kind = "force", at = "x3" }', '3: inputs.f.at: "x3"'),
            ('[inputs]\nf = { kind = "force", at = "ground" }', '"ground" is not a coordinate'),
            ('[inputs]\nf = { kind = "force", at = ["x1", "x1"] }', "a name appears"),
            ('[inputs]\nf = { kind = "force", at = [] }', "the list is empty"),
            ('[inputs]\nf = { kind = "force", at = [1] }', "the list holds"),
            ('[inputs]\nf = { kind = "force", at = { x1 = 0 } }', "3: inputs.f.at.x1: the factor of x1"),
            ('[inputs]\nf = "force"', '3: inputs.f: "force"'),
            ('angles = ["x3"]', "2: angles: x3"),
            ('[inputs]\nu = { at = "x1" }\n[springs]\nk={between=["u","x1"]}', "a displacement input takes"),
            (
                '[inputs]\nf = {kind = "force", at = "x1"}\n[springs]\nk={at="f"}',
                "springs.k.at: f is a force",
            ),
            ('[springs]\na={at="x1",same_as="b"}\nb={at="x1",same_as="a"}', "4: springs.b: a circular tie:"),
        ],
    )
    def test_the_rest_of_the_file(self, body: str, expected: str) -> None:
        messages = problems(rig(f"{body}\n{GOOD}"))
        assert any(expected in message for message in messages), messages

    @pytest.mark.parametrize(
        ("head", "expected"),
        [
            ('coordinates = "x1"', 'rig.toml:1: coordinates: "x1"'),
            ("coordinates = 3", "rig.toml:1: coordinates: 3 is not a list"),
            ('coordinates = ["x1", 2]', "rig.toml:1: coordinates[1]: 2 is not text"),
            ("coordinates = []", "rig.toml:1: coordinates: there are no coordinates"),
            ('coordinates = [\n"x1",\n"x2",\n"x1"]', "rig.toml:4: coordinates[2]: the name x1"),
            ('coordinates = ["x1", "x2", "x9"]', "rig.toml:1: coordinates[2]: nothing is attached"),
            ('coordinates = ["x1", "x2", "ground"]', "coordinates[2]: the name ground"),
            ('name = 3\ncoordinates = ["x1", "x2"]', "rig.toml:1: name: 3 is not text"),
            ('name = "no coordinates"', "rig.toml: coordinates: missing"),
        ],
    )
    def test_the_head(self, head: str, expected: str) -> None:
        messages = problems(f"{head}\n{GOOD}")
        assert any(message.startswith(expected) or expected in message for message in messages), messages

    def test_a_mass_between_two_points(self) -> None:
        (message,) = problems(rig('[masses]\nm1 = { between = ["x1", "x2"] }'))
        assert message.startswith("rig.toml:3: masses.m1.between: a mass has one place, not two; write at =")

    def test_no_elements(self) -> None:
        assert "rig.toml: masses: there are no elements; add masses, springs or dampers" in problems(rig(""))

    @pytest.mark.parametrize(
        ("line", "expected"),
        [
            ("a = {}", 'channels.a.of: missing; add of = "x1"'),
            ("a = 3", "channels.a: 3 is not a table"),
            ('a = "x2"', 'channels.a: "x2" is not a table; write a = { of = "x2" }'),
            ('a = { of = "x1", at = "x1" }', "channels.a.at: unknown key"),
            ('a = { of = "xx1" }', 'channels.a.of: "xx1"'),
            ("a = { of = { x1 = 1, y = 2 } }", 'channels.a.of.y: "y"'),
            ("a = { of = { x1 = 0 } }", "channels.a.of.x1: the factor of x1"),
            ('a = { of = "ground" }', "channels.a.of: the ground does not move"),
            ('a = { of = "x1", quantity = "accel" }', 'did you mean "acceleration"?'),
            ('a = { of = "x1", quantity = "acceleration", unit = "mm" }', '"mm" is not a unit'),
            ('a = { of = "x1", unit = "deg" }', '"deg" is not a unit'),
            ('a = { of = "x1", unit = "rev" }', "mil; if it turns, list its point in angles"),
            ('a = { of = "x1", quantity = "acceleration", unit = "V" }', 'gain = "unknown"'),
            (
                'a = { of = "x1", quantity = "acceleration", unit = "V", gain = "100 mV/N" }',
                "channels.a.gain: ",
            ),
            ('a = { of = "x1", gain = "100 mV/m" }', 'a sensitivity of "100 mV/m"'),
            ('a = { of = "x1", gain = "some" }', "channels.a.gain"),
            ('a = { of = "x1", gain = 0 }', "channels.a.gain: a gain of 0"),
            ('a = { of = "x1", sign = 2 }', "channels.a.sign: the sign is 2"),
            ('a = { of = "x1", delay = "1 mm" }', 'channels.a.delay: "mm"'),
            ('a = { of = "x1", rate = "1 kV" }', 'channels.a.rate: "kV"'),
            ('a = { of = "x1", noise = "1 g" }', 'channels.a.noise: "g"'),
            ('a = { of = "x1", noise = "-1 %" }', "channels.a.noise: a standard deviation"),
            ('a = { of = "x1", noise = "1 %", relative_noise = 0.1 }', "channels.a.noise: the relative"),
            ('a = { of = "x1", relative_noise = "1 mm" }', '"1 mm"'),
            (
                'a = { of = "x1", quantity = "acceleration", unit = "V", gain = 1, noise = "1 g" }',
                "channels.a.noise: noise in g",
            ),
            ('a = { of = { x1 = "20 mm" } }', "channels.a.of.x1: x1"),
            ('a = { of = "x1", sign = "1 V" }', 'channels.a.sign: "1 V"'),
            ('a = { of = "x1", noise = -1 }', "channels.a.noise: a standard deviation"),
            ('a = { of = "x1", relative_noise = -1 }', "channels.a.relative_noise"),
            ('a = { of = "x1", rate = 0 }', "channels.a.rate: a rate of 0"),
            ('a = { of = "x1", quantity = "force" }', "channels.a.of: x1"),
            ('a = { of = "m1", quantity = "velocity" }', "channels.a.of: m1"),
            ('a = { of = "f", quantity = "displacement" }', "channels.a.of: f is a force"),
            ('a = { of = { u = 1, k = 1 }, quantity = "force" }', "channels.a.of: a force of several"),
            ("a = { of = { x1 = 1, m1 = 1 } }", "channels.a.of: m1"),
            ('" a" = { of = "x1" }', '" a"'),
            ('a = { of = "x1", units = "mm" }', "channels.a.units: unknown key"),
        ],
    )
    def test_channels(self, line: str, expected: str) -> None:
        inputs = '[inputs]\nu = {}\nf = { kind = "force", at = "x1" }\n'
        body = inputs + '[springs]\nk = { between = ["x1", "u"] }\n[channels]\n'
        (message,) = problems(rig(f"{GOOD}{body}{line}\n"))
        assert message.startswith("rig.toml:11: ")
        assert expected in message

    def test_forces_and_torques_do_not_add(self) -> None:
        body = 'angles = ["x2"]\n' + GOOD + '[channels]\na = { of = { m1 = 1, m2 = 1 }, quantity = "force" }'
        (message,) = problems(rig(body))
        assert "forces and torques cannot be added" in message

    def test_all_problems_are_told_at_once_in_the_order_of_the_file(self) -> None:
        text = """\
nam = "x"
coordinates = ["x1", "x2"]
[inputs]
u = { kind = "displacment" }
[masses]
m1 = { at = "x1", value = -1 }
m2 = 2.7
[springs]
k1 = { between = ["x1", "x3"], value = "4600" }
k2 = { between = ["x2", "u"], value = nan, unit = "mm" }
[springs.k3]
along.x1 = 1
along.y = 2
[channels]
a = { of = "x1", quantity = "velocity", unit = "mm" }
"""
        messages = problems(text)
        assert [message.split(": ")[0] for message in messages] == [
            f"rig.toml:{line}" for line in (1, 4, 6, 7, 9, 10, 13, 15)
        ]

    def test_what_hangs_on_a_faulty_entry_is_not_reported_as_well(self) -> None:
        text = rig(
            '[inputs]\nu = { kind = "force?" }\n[masses]\nm = { at = "x1", value = "1" }\n[springs]\n'
            'k = { between = ["x2", "u"], same_as = "kk" }\nkk = { at = "x2", value = "1" }\n'
            '[channels]\na = { of = "m" }\nb = { of = "u" }'
        )
        assert [message.split(": ")[1] for message in problems(text)] == [
            "inputs.u.kind",
            "masses.m.value",
            "springs.kk.value",
        ]

    def test_coordinates_in_a_table_of_many_points_are_not_listed_all(self) -> None:
        names = ", ".join(f'"p{i}"' for i in range(1000))
        message = next(
            one
            for one in problems(f'coordinates = [{names}]\n[springs]\nk = {{ at = "q" }}')
            if "springs" in one
        )
        assert len(message) < 300


def test_a_model_of_code_is_written(tmp_path: Path) -> None:
    model = Model(
        ("x",), (Input("f", "force", {"x": 2.0}),), (Element("k", Kind.SPRING, {"x": 3.0}, value=1e-29),)
    )
    file = tmp_path / "rig.toml"
    file.write_text(write_rig(Rig(model, default_channels(model))), encoding="utf-8")
    assert read_rig(file).model == model


SHARED = """
coordinates = ["x1", "x2"]
[inputs]
f1 = { kind = "force", at = "x1" }
f2 = { kind = "force", at = "x2" }
[masses]
m1 = { at = "x1", value = 1 }
m2 = { at = "x2", value = 2 }
[springs]
k1 = { between = ["x1", "ground"] }
k2 = { between = ["x2", "ground"], same_as = "k1" }
[channels]
F1 = { of = "f1", gain = "unknown" }
F2 = { of = "f2", gain = "unknown", same_gain_as = "F1" }
F3 = { of = "f2", same_gain_as = "F1" }
"""


def test_a_gain_shared_by_channels() -> None:
    read = parse_rig(SHARED)
    assert [channel.gain for channel in read.channels] == [None, None, None]
    assert [channel.same_gain_as for channel in read.channels] == [None, "F1", "F1"]
    assert parse_rig(write_rig(read)) == read


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (('same_gain_as = "F1" }\nF3', 'same_gain_as = "F4" }\nF3'), '"F4" is not a channel; '),
        (('same_gain_as = "F1" }\nF3', 'same_gain_as = "F2" }\nF3'), "shares its gain"),
        (('"f1", gain = "unknown"', '"f1", gain = 2'), "the gain of F1"),
        (('gain = "unknown", same', "gain = 3, same"), "the gain is given"),
        (('"f2", same_gain_as = "F1"', '"f2", same_gain_as = "F2"'), "has its gain"),
        (('same_gain_as = "F1" }\nF3', "same_gain_as = 1 }\nF3"), "1 is not text"),
    ],
)
def test_a_gain_that_cannot_be_shared(change: tuple[str, str], what: str) -> None:
    assert change[0] in SHARED
    found = problems(SHARED.replace(*change))
    assert any(what in one and "same_gain_as" in one for one in found)


@pytest.mark.parametrize("name", ["time_s", "frequency_hz", "experiment"])
def test_columns_of_every_data_file_are_no_channels(name: str) -> None:
    head = f'coordinates = ["{name}"]\n[inputs]\nu = {{}}\n[masses]\nm = {{ at = "{name}", value = 1 }}\n'
    head += f'[springs]\nk = {{ between = ["u", "{name}"] }}\n'
    channels = f'[channels]\nu = {{ of = "u" }}\n"{name}" = {{ of = "{name}" }}\n'
    for text, place in ((head, "coordinates"), (head + channels, f"channels.{name}")):
        with pytest.raises(ModelError, match=rf"{place}: \"{name}\" is reserved for a column of data files"):
            parse_rig(text)
    parse_rig(head + f'[channels]\nu = {{ of = "u" }}\nx = {{ of = "{name}" }}\n')


OF_A_PERSON = """\
# rig 7
coordinates = ["x1", "x2"]

[masses]
m1 = { at = "x1", guess = 3.0 }  # with bolts
m2 = {at = "x2", value = "2700 g"}

[springs]
k1 = { between = ["x1", "ground"], value = "4.6 N/mm" }
k2 = { between = ["x1", "x2"] }

# sensors
[channels]
x1 = { of = "x1", unit = "mm" }  # laser
[channels.x2]
of = "x2"
unit = "mm"
"""


def test_a_rig_file_is_edited_as_a_person_would() -> None:
    before = parse_rig(OF_A_PERSON)
    elements = {element.name: element for element in before.model.elements}
    elements["k1"] = replace(elements["k1"], value=4800.0)
    elements["k3"] = replace(elements["k2"], name="k3")
    elements["c1"] = replace(elements["k2"], name="c1", kind=Kind.DAMPER)
    after = replace(
        before,
        model=replace(before.model, elements=tuple(elements.values())),
        channels=tuple(replace(channel, gain=1.02) for channel in before.channels),
    )
    text = edited(OF_A_PERSON, before, after)
    assert write_rig(parse_rig(text)) == write_rig(after)
    expected = (
        OF_A_PERSON.replace("4.6 N/mm", "4.8 N/mm")
        .replace(
            'k2 = { between = ["x1", "x2"] }',
            'k2 = { between = ["x1", "x2"] }\nk3 = { between = ["x1", "x2"] }',
        )
        .replace('"mm" }  # laser', '"mm", gain = 1.02 }  # laser')
        .replace('of = "x2"\nunit = "mm"\n', 'of = "x2"\nunit = "mm"\ngain = 1.02\n')
    )
    assert text == expected + '\n[dampers]\nc1 = { between = ["x1", "x2"] }\n'


def test_a_body_that_a_rig_lacks_is_added_with_its_coordinate() -> None:
    before = parse_rig(OF_A_PERSON)
    parts = (mass("m_body", "body"), between("k_body", Kind.SPRING, "body", "x2"))
    model, _ = applied(
        before.model, before.channels, Finding("oscillator", ("x2",), "", "", None, elements=parts)
    )
    text = edited(OF_A_PERSON, before, replace(before, model=model))
    assert 'coordinates = ["x1", "x2", "body"]' in text
    assert '{at = "x2", value = "2700 g"}\nm_body = { at = "body" }\n' in text
    assert write_rig(parse_rig(text)) == write_rig(replace(before, model=model))


def test_channels_that_a_rig_file_leaves_unsaid_are_added_where_one_changes() -> None:
    text = OF_A_PERSON[: OF_A_PERSON.index("# sensors")]
    before = parse_rig(text)
    turned = tuple(replace(each, gain=-1.0) if each.name == "x1" else each for each in before.channels)
    changed = edited(text, before, replace(before, channels=turned))
    assert changed.startswith(text)
    assert parse_rig(changed).channels == turned
