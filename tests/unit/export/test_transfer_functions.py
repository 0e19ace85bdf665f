"""Transfer functions against dashpot's own responses and python-control; uncertainty against Monte Carlo."""

import json

import control
import numpy as np
import pytest

from dashpot.data.readers import read
from dashpot.errors import ModelError
from dashpot.export.formats import ExportOptions, export_rig
from dashpot.export.identified_rig import IdentifiedRig
from dashpot.export.state_space import state_space_of
from dashpot.export.transfer_functions import frequency_responses, transfer_functions_of
from tests.unit.export.exported import VARIANTS, expected_response, hysteretic, lever, nonlinear, two_masses

OMEGA = 2 * np.pi * np.array([0.5, 2.0, 5.0, 9.0, 20.0])


@pytest.mark.parametrize("variant", VARIANTS)
def test_they_respond_as_the_rig(variant):
    rig = lever(variant)
    system = state_space_of(rig)
    functions = transfer_functions_of(system)
    expected = expected_response(rig, system, OMEGA)
    assert functions.response(OMEGA) == pytest.approx(expected, rel=1e-8)
    of_control = functions.to_control()
    magnitude, _, _ = control.frequency_response(of_control, OMEGA)
    assert np.moveaxis(magnitude, -1, 0) == pytest.approx(np.abs(expected), rel=1e-6)


def test_polynomials_are_those_of_the_textbook():
    """x1/u of two masses on a base that moves a spring and a damper: (c1 s + k1)(c2 s + k2) over det D(s)."""
    rig = two_masses()
    functions = json.loads(transfer_functions_of(state_space_of(rig)).to_json())
    top = np.polymul([20.0, 4600.0], [30.0, 4600.0])
    below = np.polysub(
        np.polymul([3.0, 20.0, 4600.0], [2.7, 50.0, 9200.0]), np.polymul([20.0, 4600.0], [20.0, 4600.0])
    )
    assert functions["functions"][0]["numerator"] == pytest.approx(top / below[0], rel=1e-9)
    assert functions["denominator"] == pytest.approx(below / below[0], rel=1e-9)


def test_hysteretic_rigs_have_frequency_responses_and_nonlinear_ones_have_not():
    H, sd = frequency_responses(hysteretic(), np.array([1.0, 3.0]))
    assert H.shape == sd.shape == (2, 2, 1)
    with pytest.raises(ModelError, match="a frequency response"):
        frequency_responses(nonlinear(), np.array([1.0]))


def test_standard_deviations_are_those_of_draws():
    """400 draws, seed 1: an sd of them is uncertain by 3.5 %, the worst of 16 by three times that."""
    rig = lever("a damper to the base")
    covariance = np.diag((0.002 * rig.theta) ** 2)
    rig = IdentifiedRig(rig.model, rig.channels, rig.theta, covariance)
    frequency = np.array([3.0, 6.0])
    _, sd = frequency_responses(rig, frequency)
    draws = np.random.default_rng(1).multivariate_normal(rig.theta, covariance, 400)
    drawn = np.array(
        [
            frequency_responses(IdentifiedRig(rig.model, rig.channels, t, covariance), frequency)[0]
            for t in draws
        ]
    )
    both = np.sqrt(np.mean(np.abs(drawn - np.mean(drawn, axis=0)) ** 2, axis=0) / 2)
    assert sd == pytest.approx(both, rel=0.11, abs=1e-12)


def test_the_table_is_read_back(tmp_path):
    rig = two_masses()
    path = tmp_path / "frf.csv"
    frequency = np.array([1.0, 2.5, 6.0])
    export_rig(rig, path, "frequency-responses", ExportOptions(frequency_hz=frequency))
    spectrum = read(path, rig.channels).spectrum()
    H, _ = frequency_responses(rig, frequency)
    assert spectrum.frequency_hz == pytest.approx(frequency)
    at = [channel.name for channel in spectrum.channels].index("x1")
    drive = [channel.name for channel in spectrum.channels].index("u")
    assert spectrum.amplitudes[:, at] / spectrum.amplitudes[:, drive] == pytest.approx(H[:, 0, 0], rel=1e-12)
