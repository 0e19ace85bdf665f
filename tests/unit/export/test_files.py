"""Matrix Market, universal files, tables, MuJoCo: read back by the formats' own readers."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.io import mmread
from scipy.linalg import expm

from dashpot.data.readers.datafile import open_file
from dashpot.data.readers.uff import functions_of, modes_of
from dashpot.errors import DataError, ModelError, UsageError
from dashpot.export.formats import FORMATS, ExportOptions, export_rig, format_of
from dashpot.export.identified_rig import identified_rig
from dashpot.export.mujoco import mujoco_model
from dashpot.export.parameter_tables import matlab_names, matrix_texts
from dashpot.export.transfer_functions import frequency_responses
from dashpot.model.dynamics import matrices
from dashpot.model.modes import eigenmodes
from dashpot.model.rigfile import parse_rig
from tests.unit.export.exported import TWO_MASSES, hysteretic, lever, nonlinear, two_masses


def test_matrices(tmp_path):
    rig = lever("an inerter to the base")
    written = export_rig(rig, tmp_path / "rig.mtx").paths
    assert [path.rpartition("_")[2] for path in written] == [
        "M.mtx",
        "C.mtx",
        "K.mtx",
        "G.mtx",
        "J.mtx",
        "S.mtx",
    ]
    expected = matrices(rig.model, rig.p)
    for path in written:
        letter = path[-5]
        wanted = rig.model.S if letter == "S" else getattr(expected, letter)
        assert np.array_equal(mmread(path).toarray(), wanted)
    assert "H" in matrix_texts(hysteretic())


@pytest.mark.slow
def test_universal_file(tmp_path):
    """Modes and responses, measured and fitted, in the units of the rig file; pyuff reads the same."""
    pyuff = pytest.importorskip("pyuff")
    rig = parse_rig(TWO_MASSES, "rig.toml")
    truth = {"m1": 3.0, "m2": 2.7, "k2": 4600.0, "c1": 20.0, "c2": 30.0}
    records = rig.simulate(truth, "1:15/8", samples=60, amplitudes={"u": 0.01})
    estimate = rig.identify(records)
    path = tmp_path / "rig.uff"
    rig.export(path, estimate, data=records)
    found = identified_rig(rig, estimate)
    H, _ = frequency_responses(found, np.linspace(1, 15, 8))
    functions = list(functions_of(open_file(path)))
    assert [(f.ids[0], f.ids[1]) for f in functions] == [
        (name, origin) for origin in ("measured", "fitted") for name in ("x1/u", "x2/u")
    ]
    for measured, fitted, response in zip(functions[:2], functions[2:], H[..., 0].T, strict=True):
        assert fitted.ordinate == pytest.approx(response, rel=1e-12)
        assert measured.ordinate == pytest.approx(response, rel=1e-9)  # no noise
        assert (fitted.unit, fitted.reference_unit) == ("mm", "mm")
    read = list(modes_of(open_file(path)))
    expected = eigenmodes(found.model, found.p)
    assert [mode.eigenvalue for mode in read] == pytest.approx(expected.eigenvalues, rel=1e-5)
    assert [mode.shapes[:, 0] for mode in read] == pytest.approx(expected.shapes, abs=1e-5)
    by_pyuff = pyuff.UFF(str(path)).read_sets()
    assert [each["type"] for each in by_pyuff] == [58] * 4 + [55] * 2
    assert by_pyuff[2]["data"] == pytest.approx(H[:, 0, 0], rel=1e-12)


@pytest.mark.slow
def test_measured_responses_need_one_input_at_a_time(tmp_path):
    text = TWO_MASSES.replace("u = {}", 'u = {}\nf = { kind = "force", at = "x1" }')
    rig = parse_rig(text.replace("[channels]", '[channels]\nf = { of = "f" }'), "rig.toml")
    truth = {"m1": 3.0, "m2": 2.7, "k2": 4600.0, "c1": 20.0, "c2": 30.0}
    both = rig.simulate(truth, "1:15/8", samples=60, amplitudes={"u": 0.01, "f": 5.0})
    with pytest.raises(DataError, match="several inputs act"):
        rig.export(tmp_path / "rig.uff", truth, data=both)


def test_tables(tmp_path):
    rig = parse_rig(TWO_MASSES, "rig.toml")
    truth = {"m1": 3.0, "m2": 2.7, "k2": 4600.0, "c1": 20.0, "c2": 30.0}
    noisy = parse_rig(re.sub('unit = "mm"', 'unit = "mm", noise = 0.01', TWO_MASSES), "rig.toml")
    estimate = rig.identify(noisy.simulate(truth, "1:15/8", samples=60, amplitudes={"u": 0.01}))
    for ending in ("csv", "parquet", "m"):
        rig.export(tmp_path / f"p.{ending}", estimate)
    table = pq.read_table(tmp_path / "p.parquet").to_pylist()
    lines = (tmp_path / "p.csv").read_text().splitlines()
    assert lines[0] == "parameter,kind,value,sd,low95,high95,unit,known,between"
    for row, line in zip(table, lines[1:], strict=True):
        known = estimate.parameters()[row["parameter"]]
        assert row["value"] == known.value == float(line.split(",")[2])
        assert row["sd"] == pytest.approx(known.sd, rel=1e-12)
        assert (row["low95"], row["high95"]) == pytest.approx(known.interval95, rel=1e-12)
    script = (tmp_path / "p.m").read_text()
    assert f"m1 = {estimate['m1'].value!r};  % kg" in script
    assert "parameter_names = {'m1', 'm2', 'k2', 'c1', 'c2'};" in script


def test_tables_of_nonlinear_rigs_hold_their_constants(tmp_path):
    text = TWO_MASSES.replace(
        "guess = 20 }", 'guess = 20, law = "tanh(v/v0)", v0 = { value = 0.1, sd = 0.01 } }'
    )
    export_rig(identified_rig(parse_rig(text, "rig.toml")), tmp_path / "p.csv")
    assert "c1.v0,constant,0.1,0.01," in (tmp_path / "p.csv").read_text()


def test_names_of_matlab():
    assert matlab_names(["m1", "2k", "end", "c.v0", "c v0", "x" * 80]) == [
        "m1",
        "p_2k",
        "p_end",
        "c_v0",
        "c_v0_2",
        "x" * 60,
    ]


def mujoco_matrices(text):
    """M, C, K and the loads of a model with fixed tendons, by this parser."""
    root = ElementTree.fromstring(text)
    bodies = root.findall("worldbody/body")
    joints = [body.find("joint").get("name") for body in bodies]
    masses = []
    for body in bodies:
        inertial = body.find("inertial")
        slide = body.find("joint").get("type") == "slide"
        masses.append(float(inertial.get("mass") if slide else inertial.get("diaginertia").split()[0]))
    M, parts, loads = np.diag(masses), {"stiffness": 0, "damping": 0}, {}
    of_tendon = {}
    for tendon in root.findall("tendon/fixed"):
        row = np.zeros(len(joints))
        for joint in tendon.findall("joint"):
            row[joints.index(joint.get("joint"))] = float(joint.get("coef"))
        of_tendon[tendon.get("name")] = row
        for law in parts:
            parts[law] = parts[law] + float(tendon.get(law, 0)) * np.outer(row, row)
    for motor in root.findall("actuator/motor"):
        loads[motor.get("name")] = of_tendon[motor.get("tendon")]
    return M, parts["damping"], parts["stiffness"], loads


def test_mujoco_has_the_same_matrices():
    rig = two_masses()
    M, C, K, loads = mujoco_matrices(mujoco_model(rig))
    expected = matrices(rig.model, rig.p)
    assert np.array_equal(M, expected.M)
    assert pytest.approx(expected.C) == C
    assert pytest.approx(expected.K) == K
    assert loads["u"] == pytest.approx(expected.G[:, 0])
    assert loads["u_rate"] == pytest.approx(expected.F[:, 0])


@pytest.mark.parametrize(("at_each_stage", "most"), [(False, 2e-5), (True, 1e-8)])
def test_mujoco_moves_as_the_rig_does(at_each_stage, most):
    """From rest, on a shaken base, with what the file itself says of step and integrator; SciPy's expm as oracle."""
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    rig = two_masses()
    parts = matrices(rig.model, rig.p)
    omega, amplitude, n = 2 * np.pi * 3.0, 0.01, len(rig.model.coordinates)
    system = np.zeros((2 * n + 2, 2 * n + 2))  # state, then sin ωt and cos ωt
    system[:n, n : 2 * n] = np.eye(n)
    system[n : 2 * n] = np.linalg.solve(
        parts.M,
        np.column_stack([-parts.K, -parts.C, amplitude * parts.G[:, 0], amplitude * omega * parts.F[:, 0]]),
    )
    system[2 * n, -1], system[-1, 2 * n] = omega, -omega
    model = mujoco.MjModel.from_xml_string(mujoco_model(rig))
    data, step = mujoco.MjData(model), model.opt.timestep

    def drive(data, time):
        data.ctrl[:] = amplitude * np.sin(omega * time), amplitude * omega * np.cos(omega * time)

    state, seen, exact = np.eye(2 * n + 2)[-1], [], []
    advance = expm(system * step)
    if at_each_stage:
        mujoco.set_mjcb_control(lambda _, data: drive(data, data.time))
    try:
        for _ in range(round(1.0 / step)):
            if not at_each_stage:
                drive(data, data.time + step / 2)
            mujoco.mj_step(model, data)
            state = advance @ state
            seen.append(data.qpos.copy())
            exact.append(state[:n])
    finally:
        mujoco.set_mjcb_control(None)
    assert np.max(np.abs(np.array(seen) - exact)) < most * np.max(np.abs(exact))


def test_what_mujoco_cannot_hold_is_refused():
    with pytest.raises(ModelError, match="cannot represent tip"):
        mujoco_model(lever("springs to the base"))


def test_endings_tell_formats(tmp_path):
    assert format_of("a.json").content == "state-space"
    assert format_of("a.json", "transfer-functions").content == "transfer-functions"
    for path, content, said in (
        ("a.xyz", None, "no export has the extension .xyz; use .csv, .fmu"),
        ("a", None, "the file name has no extension"),
        ("a.mat", "fmu", "fmu is not written to .mat files; use .fmu"),
        ("a.mat", "poem", "poem is not"),
    ):
        with pytest.raises(UsageError, match=said):
            format_of(path, content)
    with pytest.raises(UsageError, match="frequency responses need"):
        export_rig(two_masses(), tmp_path / "a.csv", "frequency-responses")


@pytest.mark.parametrize("each", [f for f in FORMATS if f.content != "parameters"], ids=lambda f: f.content)
def test_nonlinear_rigs_are_refused_in_one_line_and_nothing_is_left(tmp_path, each):
    path = tmp_path / f"rig{each.suffixes[0]}"
    with pytest.raises(ModelError, match=r"cannot represent the nonlinear"):
        export_rig(nonlinear(), path, each.content, ExportOptions(**_frequencies(each)))
    assert not list(tmp_path.iterdir())


def _frequencies(each):
    return {"frequency_hz": np.ones(1)} if "frequency_hz" in each.takes else {}


@pytest.mark.parametrize(
    "each", [f for f in FORMATS if "frequency_hz" not in f.takes], ids=lambda f: f.content
)
def test_options_without_use_are_refused(tmp_path, each):
    path = tmp_path / f"rig{each.suffixes[0]}"
    with pytest.raises(
        UsageError, match=f"an export of {each.content} does not use frequencies; leave them out"
    ):
        export_rig(two_masses(), path, each.content, ExportOptions(frequency_hz=np.ones(1)))
    assert not path.exists()


def test_the_same_rig_gives_the_same_bytes(tmp_path):
    for ending in ("json", "mat", "uff", "xml", "csv", "m"):
        export_rig(two_masses(), tmp_path / f"a.{ending}")
        export_rig(two_masses(), tmp_path / f"b.{ending}")
        first, second = ((tmp_path / f"{name}.{ending}").read_bytes() for name in "ab")
        if ending != "mat":  # its header holds the date
            assert first == second
