"""Tables of frequency response functions: one experiment for each input, in the units of the rig file."""

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.readers import read
from dashpot.errors import DataError
from dashpot.estimate.identify import identify
from dashpot.model.dynamics import response
from tests.two_masses import PUSHED, pushed_pair

RIG = pushed_pair("u")
CHANNELS = (
    Channel("x1", {"x1": 1.0}, unit="mm", scale=1e-3),
    Channel("a2", {"x2": 1.0}, Quantity.ACCELERATION),
    Channel("u", {"u": 1.0}, unit="mm", scale=1e-3),
    Channel("f", {"f": 1.0}, Quantity.FORCE, unit="N"),
)


def _table(sd: bool = False, drop: str = "") -> str:
    """The rig's own response functions, in the units of CHANNELS."""
    hz = np.linspace(2, 14, 9)
    omega, p = 2 * np.pi * hz, RIG.parameters(RIG.theta(PUSHED))
    columns = {"frequency_hz": hz}
    for into, U, f in (("u", 1e-3, 0.0), ("f", 0.0, 1.0)):
        X = response(RIG, p, omega, np.full((9, 1), U + 0j), np.full((9, 1), f + 0j))
        for out, H in (("x1", X[:, 0] / 1e-3), ("a2", -(omega**2) * X[:, 1])):
            columns[f"{out}/{into}_re"], columns[f"{out}/{into}_im"] = H.real, H.imag
            if sd:
                columns[f"{out}/{into}_sd"] = 0.01 * np.abs(H)
    columns.pop(drop, None)
    rows = [",".join(repr(float(v)) for v in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join([",".join(columns), *rows]) + "\n"


def test_response_functions_to_two_inputs_give_every_parameter_back(tmp_path):
    path = tmp_path / "frf.csv"
    path.write_text(_table())
    spectrum = read(path, CHANNELS).spectrum()
    assert spectrum.lines == 18
    assert set(spectrum.experiment.tolist()) == {0, 1}
    assert spectrum.amplitudes[0, spectrum.index("u")] == pytest.approx(1e-3)
    estimate = identify(RIG, spectrum)
    for name, value in PUSHED.items():
        assert estimate[name].value == pytest.approx(value, rel=1e-8)


def test_standard_deviations_become_the_covariance(tmp_path):
    path = tmp_path / "frf.csv"
    path.write_text(_table(sd=True))
    spectrum = read(path, CHANNELS).spectrum()
    x1 = spectrum.index("x1")
    np.testing.assert_allclose(spectrum.sd()[:, x1], 0.01 * np.abs(spectrum.amplitudes[:, x1]), rtol=1e-12)
    assert np.all(spectrum.sd()[:, spectrum.index("u")] == 0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (_table(drop="a2/f_re"), "there is no column"),
        (_table(drop="a2/f_im"), "a2/f_im"),
        (_table().replace("x1/", "y1/").replace("a2/", "y2/"), "names two channels"),
        (_table().replace("frequency_hz", "hz"), "frequency_hz"),
        ("\n".join(_table().splitlines()[:2]) + ",nan\n", "frf.csv:2"),
    ],
)
def test_bad_tables_are_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "frf.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=r"frf\.csv") as error:
        read(path, CHANNELS)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
