"""State spaces against dashpot's own responses, finite differences, python-control and MATLAB files."""

import io
import json

import control
import numpy as np
import pytest
from scipy.io import loadmat

import dashpot
from dashpot.errors import DataError, ModelError, UsageError
from dashpot.export.identified_rig import identified_rig
from dashpot.export.state_space import state_space_of
from dashpot.model.rigfile import parse_rig
from tests.unit.export.exported import TWO_MASSES, VARIANTS, expected_response, hysteretic, lever, two_masses

OMEGA = 2 * np.pi * np.array([0.5, 2.0, 5.0, 9.0, 20.0])


@pytest.mark.parametrize("given", [None, "acceleration"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_it_responds_as_the_rig(variant, given):
    rig = lever(variant)
    system = state_space_of(rig, given)
    assert system.response(OMEGA) == pytest.approx(expected_response(rig, system, OMEGA), rel=1e-10)


def test_inputs_are_differentiated_as_far_as_outputs_need():
    """A reaction force of a damper to the base needs its velocity, an accelerometer above that damper as well."""
    quantities = {name: [port.quantity for port in state_space_of(lever(name)).inputs] for name in VARIANTS}
    assert quantities == {
        "springs to the base": ["velocity", "displacement", "force"],
        "a damper to the base": ["velocity", "displacement", "force"],
        "an inerter to the base": ["acceleration", "displacement", "force"],
        "an accelerometer": ["velocity", "displacement", "force"],
    }
    assert [port.name for port in state_space_of(lever("a damper to the base")).inputs] == [
        "u_rate",
        "w",
        "f",
    ]
    assert state_space_of(two_masses()).inputs[0].quantity == "displacement"
    with pytest.raises(UsageError, match="depends on the acceleration of u; give u as acceleration"):
        state_space_of(lever("an inerter to the base"), "displacement")
    with pytest.raises(UsageError, match="f is not a displacement input"):
        state_space_of(two_masses(), {"f": "velocity"})
    with pytest.raises(UsageError, match="cannot be given as jerk"):
        state_space_of(two_masses(), "jerk")


@pytest.mark.parametrize("variant", VARIANTS)
def test_slopes_are_those_of_finite_differences(variant):
    rig = lever(variant)
    system = state_space_of(rig)
    for k, theta in enumerate(rig.theta):
        ends = []
        for sign in (1, -1):
            moved = rig.theta.copy()
            moved[k] = theta * (1 + sign * 1e-5)
            ends.append(state_space_of(type(rig)(rig.model, rig.channels, moved, rig.covariance)))
        for letter, slope in zip("ABCD", system.slopes, strict=True):
            difference = (getattr(ends[0], letter) - getattr(ends[1], letter)) / (2e-5 * theta)
            assert slope[k] == pytest.approx(difference, rel=1e-6, abs=1e-8 * (1 + np.max(np.abs(slope[k]))))


def test_python_control_has_the_same_bode_plot():
    rig = lever("a damper to the base")
    system = state_space_of(rig)
    expected = expected_response(rig, system, OMEGA)
    of_control = system.to_control()
    magnitude, phase, _ = control.frequency_response(of_control, OMEGA)
    assert np.moveaxis(magnitude, -1, 0) == pytest.approx(np.abs(expected), rel=1e-9)
    away = np.moveaxis(phase, -1, 0) - np.angle(expected)
    assert np.exp(1j * away) == pytest.approx(np.ones_like(away), abs=1e-9)
    assert of_control.input_labels == ["u_rate", "w", "f"]
    assert of_control.output_labels == ["x1", "x2", "force", "reaction"]


def test_matlab_and_json_hold_all_of_it():
    rig = lever("an accelerometer")
    system = state_space_of(rig)
    read = loadmat(io.BytesIO(system.to_mat()), squeeze_me=True)
    content = json.loads(system.to_json())
    for letter in "ABCD":
        assert read[letter] == pytest.approx(getattr(system, letter), rel=0, abs=0)
        assert np.array(content[letter]) == pytest.approx(getattr(system, letter), rel=0, abs=0)
    assert list(read["input_name"]) == [port["name"] for port in content["inputs"]]
    assert list(read["output_unit"]) == ["m/s²", "m/s", "N", "N"]
    assert read["parameter_covariance"] == pytest.approx(rig.covariance)
    assert read["dA"].shape == (*system.A.shape, len(rig.names))
    assert content["order"] == list(rig.names)
    assert np.array(content["slopes"]["dB"]) == pytest.approx(system.slopes[1])


def test_what_it_cannot_hold_is_refused():
    with pytest.raises(ModelError, match="a state space cannot represent the hysteretic damping of h"):
        state_space_of(hysteretic())
    without_mass = parse_rig(TWO_MASSES.replace('m2 = { at = "x2", value = 2.7, sd = 0.01 }', ""), "rig.toml")
    with pytest.raises(ModelError, match="a coordinate without mass"):
        state_space_of(identified_rig(without_mass))


def test_an_estimate_alone_stands_for_its_rig(tmp_path):
    """Identified, saved and loaded: values, covariance and response are those of the estimate."""
    path = tmp_path / "rig.toml"
    path.write_text(TWO_MASSES)
    rig = dashpot.read_rig(str(path))
    truth = {"m1": 3.0, "m2": 2.7, "k2": 4600.0, "c1": 20.0, "c2": 30.0}
    records = rig.simulate(truth, "1:15/8", samples=60, amplitudes={"u": 0.01})
    estimate = rig.identify(records)
    loaded = dashpot.Estimate.from_json(estimate.to_json())
    system = loaded.to_state_space()
    assert system.covariance == pytest.approx(estimate.covariance)
    given = identified_rig(rig, estimate)
    assert system.response(OMEGA) == pytest.approx(expected_response(given, system, OMEGA), rel=1e-10)
    assert pytest.approx(system.A) == rig.to_state_space(estimate).A
    assert rig.to_state_space(truth).A[2, 0] == pytest.approx(-4600 / 3)
    other = parse_rig(TWO_MASSES.replace("c2 =", "c9 ="), "other.toml")
    with pytest.raises(DataError, match="another rig"):
        other.to_state_space(estimate)
