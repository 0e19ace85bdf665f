"""Gains and delays with numbers of their own, and calibrations that channels share: read, written, refused."""

from __future__ import annotations

import pytest

from dashpot.errors import ModelError
from dashpot.model.rigfile import parse_rig, write_rig
from dashpot.unknowns import Unknown

RIG = """coordinates = ["x1", "x2"]
[masses]
m1 = { at = "x1" }
m2 = { at = "x2" }
[springs]
k1 = { between = ["x1", "x2"] }
[calibrations]
c = { value = 1, sd = "1 %" }
[channels]
x1 = { of = "x1", gain = { of = "c" } }
x2 = { of = "x2", ALSO }
"""


def channel(text: str) -> object:
    return parse_rig(RIG.replace("ALSO", text)).channels[1]


@pytest.mark.parametrize(
    ("text", "gain", "delay"),
    [
        ('gain = { value = 1.02, sd = "1 %" }', Unknown("x2.gain", "1", 1.02, 0.0102), None),
        ("gain = { value = 2, sd = 0.1, min = 1, max = 3 }", Unknown("x2.gain", "1", 2, 0.1, None, 1, 3), None),
        ("gain = { guess = 3 }", Unknown("x2.gain", "1", guess=3), None),
        ('gain = { of = "c" }', Unknown("c", "1", 1, 0.01), None),
        ('delay = { value = "2 ms", sd = "100 us" }', None, Unknown("x2.delay", "s", 0.002, 0.0001)),
        ('delay = { guess = "2 ms", max = "5 ms" }', None, Unknown("x2.delay", "s", guess=0.002, upper=0.005)),
        (
            'quantity = "acceleration", unit = "mV", gain = { value = "100 mV/g", sd = "2 %" }',
            Unknown("x2.gain", "1", 0.1 / 9.80665, 0.002 / 9.80665), None,
        ),
    ],
)  # fmt: skip
def test_what_is_known_of_a_calibration(text: str, gain: Unknown | None, delay: Unknown | None) -> None:
    read = channel(text)
    for prior, known, wanted in ((read.gain_prior, read.gain, gain), (read.delay_prior, read.delay, delay)):
        if wanted is None:
            assert prior is None
            continue
        assert known is None
        assert (prior.name, prior.unit) == (wanted.name, wanted.unit)
        for key in ("prior", "sd", "guess", "lower", "upper"):
            number = getattr(wanted, key)
            assert getattr(prior, key) == (None if number is None else pytest.approx(number))


def test_a_value_without_an_sd_is_known() -> None:
    assert channel('gain = { value = 1.5 }, delay = { value = "1 ms" }') == channel(
        'gain = 1.5, delay = "1 ms"'
    )


@pytest.mark.parametrize(
    "text",
    [
        'gain = { of = "c" }, delay = { value = 0.001, sd = 1e-4 }',
        "gain = { guess = 2.5, min = 1.0 }",
        "gain = 2.0",
    ],
)
def test_written_rigs_read_back_the_same(text: str) -> None:
    read = parse_rig(RIG.replace("ALSO", text))
    assert parse_rig(write_rig(read)) == read


@pytest.mark.parametrize(
    ("text", "place", "what", "cure"),
    [
        ('gain = { of = "d" }', "rig.toml:11: channels.x2.gain.of", '"d" is not a calibration', "choose from c"),
        ("gain = { of = [1] }", "rig.toml:11: channels.x2.gain.of", "is not a calibration", "choose from c"),
        ('gain = { of = "c", sd = 1 }', "rig.toml:11: channels.x2.gain", "numbers of its own", "keep"),
        ('delay = { of = "c" }', "rig.toml:11: channels.x2.delay.of", "a gain and a delay", "one for each"),
        ("gain = { sd = 0.1 }", "rig.toml:11: channels.x2.gain", "sd without a value", "give the value"),
        ("gain = { value = 1, sd = 0 }", "rig.toml:11: channels.x2.gain", "sd is 0", "positive"),
        ("gain = { guess = 1, min = 2 }", "rig.toml:11: channels.x2.gain", "below min", "change"),
        ("gain = { guess = 1, min = 2, max = 1 }", "rig.toml:11: channels.x2.gain", "not below max", "swap"),
        ("gain = { value = 0, sd = 1 }", "rig.toml:11: channels.x2.gain", "measures nothing", "unknown"),
        ("gain = { valeu = 1 }", "rig.toml:11: channels.x2.gain.valeu", "unknown key", "value"),
        ('gain = { value = "1 m" }', "rig.toml:11: channels.x2.gain.value", "sensitivity", "unit"),
        ('delay = { value = "1 m" }', "rig.toml:11: channels.x2.delay.value", "unit", "ms"),
        ('same_gain_as = "x1", gain = { guess = 1 }', "rig.toml:11: channels.x2.gain", "given as well", "keep"),
        ('bits = 16, full_scale = "1 m", gain = { guess = 1 }', "rig.toml:11: channels.x2.full_scale", "gain", ""),
    ],
)  # fmt: skip
def test_what_cannot_be_is_told_with_its_line(text: str, place: str, what: str, cure: str) -> None:
    changed = RIG.replace("ALSO", text)
    with pytest.raises(ModelError) as caught:
        parse_rig(changed)
    (problem,) = caught.value.problems
    assert problem.where == place
    assert what in problem.what
    assert cure in (problem.cure or "")


def test_without_the_section_the_cure_shows_how_to_declare_it() -> None:
    text = RIG.replace('[calibrations]\nc = { value = 1, sd = "1 %" }\n', "").replace(", ALSO", "")
    with pytest.raises(ModelError) as caught:
        parse_rig(text)
    assert "[calibrations]" in (caught.value.problems[0].cure or "")


def test_a_calibration_that_no_channel_has_is_refused() -> None:
    with pytest.raises(ModelError) as caught:
        parse_rig(RIG.replace(", ALSO", "").replace("[channels]", "d = 1\n[channels]"))
    (problem,) = caught.value.problems
    assert problem.where == "rig.toml:9: calibrations.d"


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (
            ('c = { value = 1, sd = "1 %" }', 'c = { value = "1 mV/g", sd = "1 %" }'),
            "rig.toml:8: calibrations.c.value",
        ),
        (("c = { value", "k1 = { value"), "rig.toml:8: calibrations.k1"),
        (("c = { value", '"x2.gain" = { value'), "rig.toml:8: calibrations"),
        (("c = { value = 1", "c = { vlaue = 1"), "rig.toml:8: calibrations.c.vlaue"),
        (('c = { value = 1, sd = "1 %" }', "c = [1]"), "rig.toml:8: calibrations.c"),
    ],
)
def test_what_is_wrong_with_a_shared_calibration_is_told_once_at_its_line(
    change: tuple[str, str], place: str
) -> None:
    text = RIG.replace("ALSO", 'gain = { of = "c" }').replace(*change)
    name = "k1" if "k1 = { value" in change[1] else "x2.gain" if "x2.gain" in change[1] else "c"
    with pytest.raises(ModelError) as caught:
        parse_rig(text.replace('of = "c"', f'of = "{name}"'))
    assert caught.value.problems[0].where.startswith(place)
    assert len(caught.value.problems) == 1


def test_calibrations_without_channels_are_refused() -> None:
    with pytest.raises(ModelError):
        parse_rig(RIG.split("[channels]", maxsplit=1)[0])
