"""The FMU through FMPy: it validates, builds, and moves as the rig does, with steps of any size."""

import shutil
import xml.etree.ElementTree as ElementTree
import zipfile

import numpy as np
import pytest
from scipy.linalg import expm

from dashpot.errors import UsageError
from dashpot.export import fmu
from dashpot.export.fmu import write_fmu
from dashpot.export.formats import ExportOptions
from dashpot.export.identified_rig import identified_rig
from dashpot.export.state_space import state_space_of
from dashpot.model.motion import integrator
from dashpot.model.rigfile import parse_rig
from tests.unit.export.exported import TWO_MASSES, VARIANTS, expected_response, lever, two_masses

fmpy = pytest.importorskip("fmpy")
validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu
needs_compiler = pytest.mark.skipif(
    not any(shutil.which(name) for name in fmu.COMPILERS), reason="no C compiler"
)


@pytest.fixture(scope="module")
def unit_file(tmp_path_factory):
    """Two masses as a unit with a binary."""
    path = tmp_path_factory.mktemp("fmu") / "rig.fmu"
    write_fmu(two_masses(), path, ExportOptions())
    return path


def drive(system, time, w):
    """Inputs with their slopes as FMPy takes them; w (samples, inputs)."""
    names = [port.name for port in system.inputs]
    signals = np.zeros(
        len(time), dtype=[(n, float) for n in ("time", *names, *(f"{n}_slope" for n in names))]
    )
    signals["time"] = time
    slopes = np.diff(w, axis=0, append=w[-1:]) / np.append(np.diff(time), 1.0)[:, None]
    for k, name in enumerate(names):
        signals[name], signals[f"{name}_slope"] = w[:, k], slopes[:, k]
    return signals


def simulated(path, system, time, w, starts):
    step = time[1] - time[0]
    result = fmpy.simulate_fmu(
        str(path), stop_time=time[-1], output_interval=step, input=drive(system, time, w), start_values=starts
    )
    return np.stack([result[port.name] for port in system.outputs], axis=-1)


def steady_start(system, q, omega):
    """Start values of the steady motion under Re(q e^{jωt})."""
    z = np.linalg.solve(1j * omega * np.eye(len(system.A)) - system.A, system.B @ q)
    beta0, beta1 = system.shifts
    n, r = beta0.shape
    x, v = z[:n] + beta0 @ q[:r], z[n : 2 * n] + beta1 @ q[:r] + 1j * omega * beta0 @ q[:r]
    values = np.concatenate([x, v, z[2 * n :]]).real
    return {f"{name}_start": float(value) for name, value in zip(system.states, values, strict=True)}


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("variant", ["a damper to the base", "an inerter to the base"])
def test_it_moves_as_the_rig(tmp_path, variant):
    """Under sines the error is that of joining their samples by lines, (ωh)²/12 = 1.5e-7 of the amplitude."""
    rig = lever(variant)
    system = state_space_of(rig)
    path = tmp_path / "rig.fmu"
    assert write_fmu(rig, path, ExportOptions()).compiled
    assert not validate_fmu(str(path))
    rng = np.random.default_rng(0)
    q = rng.normal(size=len(system.inputs)) + 1j * rng.normal(size=len(system.inputs))
    omega = 2 * np.pi * 3
    time = np.arange(7001) / 14000
    w = np.real(q * np.exp(1j * omega * time)[:, None])
    y = simulated(path, system, time, w, steady_start(system, q, omega))
    amplitudes = expected_response(rig, system, np.array([omega]))[0] @ q
    expected = np.real(amplitudes * np.exp(1j * omega * time)[:, None])
    assert np.max(np.abs(y - expected) / np.abs(amplitudes)) < 1e-6


@needs_compiler
def test_steps_of_any_size_are_exact(unit_file):
    """Under straight lines between 0.05 s, which is half a period of the upper mode, one step is as good as 64."""
    system = state_space_of(two_masses())
    coarse = np.arange(21) * 0.05
    fine = np.arange(20 * 64 + 1) * 0.05 / 64
    corners = np.random.default_rng(1).normal(size=21)
    slow = simulated(unit_file, system, coarse, corners[:, None], {})
    fast = simulated(unit_file, system, fine, np.interp(fine, coarse, corners)[:, None], {})
    assert slow == pytest.approx(fast[::64], abs=1e-11 * np.max(np.abs(fast)))


@pytest.mark.slow
@needs_compiler
def test_a_measured_base_gives_the_fitted_response(tmp_path):
    """A base that moves at random, 200 samples a second: the FMU follows the fitted motion in time to 1e-6.

    Between samples the base is a cubic spline, whose acceleration is what the FMU takes inputs for: straight lines.
    """
    rig = parse_rig(TWO_MASSES, "rig.toml")
    truth = {"m1": 3.0, "m2": 2.7, "k2": 4600.0, "c1": 20.0, "c2": 30.0}
    estimate = rig.identify(rig.simulate(truth, "1:15/8", samples=60, amplitudes={"u": 0.01}))
    found = identified_rig(rig, estimate)
    path = tmp_path / "rig.fmu"
    rig.export(path, estimate, given="acceleration")
    time, base = np.arange(401) / 200, 0.01 * np.cumsum(np.random.default_rng(2).normal(size=401))
    motion = integrator(found.model, found.p, 1 / 200).motion(base[:, None])
    _, rate, acceleration = motion.w[..., 0]
    system = state_space_of(found, "acceleration")
    y = simulated(path, system, time, acceleration[:, None], {"u_start": base[0], "u_rate_start": rate[0]})
    assert np.max(np.abs(y - motion.x)) < 1e-9 * np.max(np.abs(motion.x))


@needs_compiler
def test_parameters_can_be_set(unit_file):
    """A base that is 1 m away, to which a stiffer rig at rest goes as its own state space says."""
    time, w = np.arange(101) / 100, np.ones((101, 1))
    stiffer = state_space_of(identified_rig(parse_rig(TWO_MASSES, "rig.toml"), values={"k2": 9200.0}))
    y = simulated(unit_file, stiffer, time, w, {"k2": 9200.0})
    still = -np.linalg.solve(stiffer.A, stiffer.B)[:, 0]
    start = np.concatenate([np.zeros(2), -stiffer.shifts[1][:, 0]])
    away = np.stack([expm(stiffer.A * t) @ (start - still) for t in time])
    assert y == pytest.approx((still + away) @ stiffer.C.T, rel=1e-9, abs=1e-12)


@needs_compiler
def test_states_are_kept_and_restored(unit_file):
    description = fmpy.read_model_description(str(unit_file))
    folder = fmpy.extract(str(unit_file))
    unit = fmpy.instantiate_fmu(folder, description)
    at = {variable.name: variable.valueReference for variable in description.modelVariables}
    unit.enterInitializationMode()
    unit.setFloat64([at["u"]], [1.0])
    unit.exitInitializationMode()
    kept = unit.getFMUState()
    unit.doStep(currentCommunicationPoint=0, communicationStepSize=0.1)
    first = unit.getFloat64([at["x1"]])
    unit.setFMUState(kept)
    assert unit.getFloat64([at["x1"]]) == [0]
    unit.doStep(currentCommunicationPoint=0, communicationStepSize=0.1)
    assert unit.getFloat64([at["x1"]]) == first
    with pytest.raises(Exception, match="fmi3SetFloat64"):
        unit.setFloat64([at["m1"]], [1.0])
    unit.freeFMUState(kept)
    unit.terminate()
    unit.freeInstance()
    shutil.rmtree(folder)


def test_without_a_compiler_it_holds_its_source(tmp_path, monkeypatch):
    monkeypatch.setattr(fmu, "COMPILERS", ())
    monkeypatch.delenv("CC", raising=False)
    path = tmp_path / "rig.fmu"
    assert not write_fmu(lever("springs to the base"), path, ExportOptions()).compiled
    with zipfile.ZipFile(path) as unit:
        names = unit.namelist()
        description = ElementTree.fromstring(unit.read("modelDescription.xml"))
    assert sorted(names) == [
        "modelDescription.xml",
        "sources/buildDescription.xml",
        "sources/dashpot_fmu.c",
        "sources/rig.h",
    ]
    assert description.get("modelName") == "Lever & <tip>"
    assert len({v.get("name") for v in description.find("ModelVariables")}) == 22


@needs_compiler
def test_the_source_has_no_warning(tmp_path, monkeypatch):
    import subprocess

    for variant in VARIANTS:
        path = tmp_path / "rig.fmu"
        write_fmu(lever(variant), path, ExportOptions(compiled=False))
        with zipfile.ZipFile(path) as unit:
            unit.extractall(tmp_path)
        command = [
            "cc",
            "-std=c99",
            "-Wall",
            "-Wextra",
            "-pedantic",
            "-Werror",
            "-fsyntax-only",
            "dashpot_fmu.c",
        ]
        done = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def test_a_compiler_that_fails_is_named(tmp_path, monkeypatch):
    false = shutil.which("false")
    if false is None:
        pytest.skip("no program that fails")
    monkeypatch.setenv("CC", false)
    with pytest.raises(UsageError, match="does not compile the FMU"):
        write_fmu(two_masses(), tmp_path / "rig.fmu", ExportOptions())
    assert not (tmp_path / "rig.fmu").exists()
