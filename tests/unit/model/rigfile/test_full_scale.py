"""Channels in counts or shares of the full scale of a converter."""

import numpy as np
import pytest

from dashpot.data.readers import read
from dashpot.errors import ModelError
from dashpot.model.rigfile import parse_rig, write_rig

RIG = """
coordinates = ["x1"]
[inputs]
u = {}
[masses]
m = { at = "x1" }
[springs]
k = { between = ["x1", "u"], value = 1000 }
[channels]
u = { of = "u" }
"""


def channel(line: str, quantity: str = "acceleration"):
    rig = parse_rig(f'{RIG}a = {{ of = "x1", quantity = "{quantity}", {line} }}\n', "rig.toml")
    return rig, rig.channels[1]


@pytest.mark.parametrize(
    ("line", "raw", "expected"),
    [
        ('unit = "counts", bits = 16, full_scale = "50 g"', 2**14, 25 * 9.80665),
        ('bits = 16, full_scale = "50 g"', -(2**15), -50 * 9.80665),
        ('unit = "counts", bits = 24, full_scale = "10 V", gain = "100 mV/g"', 2**22, 50 * 9.80665),
        ('unit = "counts", bits = 12, full_scale = "500 mV", gain = 0.25', 2**11, 2.0),
        ('unit = "FS", full_scale = "50 g"', 0.5, 25 * 9.80665),
        ("full_scale = 20", 0.25, 5.0),
        ('full_scale = "2000 mm/s^2"', 0.25, 0.5),
    ],
)
def test_raw_numbers_become_si(tmp_path, line, raw, expected):
    rig, found = channel(line)
    assert raw * found.scale / found.factor == pytest.approx(expected, rel=1e-12)
    again = parse_rig(write_rig(rig), "again.toml").channels[1]
    assert again.scale / again.factor == pytest.approx(found.scale / found.factor, rel=1e-12)
    (tmp_path / "a.csv").write_text(f"time_s,u,a\n0,0,{raw}\n0.1,0,0\n0.2,0,0\n0.3,0,{raw}\n")
    (record,) = read(tmp_path / "a.csv", rig.channels).records
    assert record.values[[0, 3], 1] / found.factor == pytest.approx(np.full(2, expected), rel=1e-12)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('unit = "counts", full_scale = "50 g"', "the counts at full scale are not given; add bits"),
        ("bits = 16", "bits without a full scale"),
        ('bits = 16.5, full_scale = "50 g"', "a converter of 16.5 bits; give a whole number from 2 to 64"),
        ('bits = 16, unit = "FS", full_scale = "50 g"', "bits of a channel in shares"),
        ('unit = "mm/s^2", bits = 16, full_scale = "50 g"', "a full scale of a channel in mm/s"),
        ('bits = 16, full_scale = "10 V"', "a full scale in volts needs a sensitivity"),
        ('bits = 16, full_scale = "50 g", gain = 2', "both a gain and a full scale in the quantity itself"),
        ('bits = 16, full_scale = "50 g", gain = "unknown"', "both a full scale and an unknown gain"),
        ('bits = 16, full_scale = "5 mm"', '"mm" is not a unit of acceleration'),
        ("bits = 16, full_scale = 0", "a full scale of 0; give a positive one"),
    ],
)
def test_what_is_missing_or_contradicts_itself_is_said_with_its_line(line, said):
    with pytest.raises(ModelError) as refused:
        channel(line)
    (problem,) = refused.value.problems
    assert said in str(problem)
    assert str(problem).startswith("rig.toml:11: channels.a.")
