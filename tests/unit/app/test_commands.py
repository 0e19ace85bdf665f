"""The commands from end to end, in this process."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dashpot import Estimate, __version__, read, read_rig
from dashpot.app import cli
from dashpot.app.commands import COMMANDS
from dashpot.app.process import Ended
from dashpot.estimate.registry import method
from tests.two_masses import one_mass
from tests.unit.app.conftest import RIG, SET, VALUES, Command

STEADY = (
    "note: 8 stepped-sine dwells: all 1,600 samples used, stated frequencies kept, linear trend removed "
    "[settled_dwells]"
)


def test_simulated_data_give_the_parameters_back(dashpot: Command, data: Path) -> None:
    # Three unknowns and the noise of seed 0: each within 4 sd (chance of a false alarm 2e-4).
    done = dashpot("identify rig.toml data.csv --json out.json")
    assert done.code == 0
    assert done.err == [STEADY]
    found = Estimate.load("out.json")
    assert found.method == "oiv"
    for name, truth in VALUES.items():
        value = found[name]
        assert 0 < value.sd < 0.02 * truth
        assert abs(value.value - truth) < 4 * value.sd
    assert "The model fits" in done.out


def test_json_keeps_its_contract(dashpot: Command, data: Path) -> None:
    done = dashpot("identify", "rig.toml", "data.csv", "--json", "-")
    content = json.loads(done.out)
    assert content["dashpot"] == "0.1"
    assert content["model"] == "Two masses on a shaken base"
    assert content["method"] == "oiv"
    assert content["status"] == "converged"
    assert isinstance(content["iterations"], int)
    assert content["order"] == ["m1", "c1", "c2"]
    covariance = np.array(content["covariance"])
    assert covariance.shape == (3, 3)
    for j, name in enumerate(content["order"]):
        entry = content["parameters"][name]
        assert entry["sd"] == pytest.approx(covariance[j, j] ** 0.5)
        assert entry["interval95"][0] < entry["value"] < entry["interval95"][1]
        assert entry["known"] is False
        assert entry["bound_sd"] > 0
    assert content["parameters"]["m1"]["unit"] == "kg"
    assert content["parameters"]["m2"]["known"] is True
    assert content["parameters"]["m2"]["value"] == 2.7
    for mode in content["modes"]:
        assert {"frequency_hz", "damping_ratio", "eigenvalue", "frequency_sd", "damping_sd"} <= mode.keys()
        assert len(mode["eigenvalue"]) == 2
    assert {"chi2", "dof", "p"} <= content["fit"].keys()
    assert content["warnings"] == []


def test_amplitudes_give_what_their_records_give(dashpot: Command, data: Path) -> None:
    assert dashpot("spectrum", "rig.toml", "data.csv", "--out", "table.csv").code == 0
    direct = json.loads(dashpot("identify", "rig.toml", "data.csv", "--json", "-").out)
    through = json.loads(dashpot("identify", "rig.toml", "table.csv", "--json", "-").out)
    np.testing.assert_allclose(direct["covariance"], through["covariance"], rtol=1e-6)
    for name in direct["order"]:
        a, b = direct["parameters"][name], through["parameters"][name]
        assert a["value"] == pytest.approx(b["value"], abs=1e-6 * a["sd"])


def test_positive_holds_what_noise_makes_negative(dashpot: Command, rig: Path) -> None:
    """A damper that is truly 0 comes out negative in half of the tests: free it is below 0, held it is 0."""
    rig.write_text(
        RIG.replace("[channels]", 'c3 = { between = ["x1", "ground"] }\n[channels]'), encoding="utf-8"
    )
    for seed in map(str, range(20)):
        sent = f"--frequencies 1,2,3,4,5,6,8 --samples 56 --seed {seed} --amplitude u=0.001"
        made = dashpot(f"simulate rig.toml --out {seed}.csv {sent} {SET},c3=0")
        assert made.code == 0, made.err
        free = json.loads(dashpot("identify", "rig.toml", f"{seed}.csv", "--json", "-").out)
        if free["parameters"]["c3"]["value"] < 0:
            break
    held = json.loads(dashpot("identify", "rig.toml", f"{seed}.csv", "--positive", "--json", "-").out)
    assert held["method"] == "ml"
    c3 = held["parameters"]["c3"]
    assert (c3["value"], c3["interval95"][0], c3["min"]) == (0, 0, 0)
    assert c3["without_limits"] < 0 < c3["interval95"][1]
    assert any("bound" in warning for warning in held["warnings"])
    wrong = dashpot("identify", "rig.toml", f"{seed}.csv", "--positive", "--method", "oiv")
    assert wrong.code == 2
    assert "cannot enforce bounds" in wrong.err[0]


def test_simulated_table_carries_its_noise(dashpot: Command, rig: Path) -> None:
    sent = f"--table --frequencies 2,4,8 --samples 100 --amplitude u=0.01 {SET}"
    done = dashpot(f"simulate rig.toml --out t.csv {sent}")
    assert done.code == 0, done.err
    lines = read("t.csv", read_rig("rig.toml").channels).spectrum()
    assert lines.noise == ("given",) * 3
    assert lines.frequency_hz.tolist() == [2, 4, 8]
    # Noise of 0.02 mm a sample: the real and the imaginary part have √(2/N) of it, with little lost to the drift.
    np.testing.assert_allclose(lines.sd()[:, 0], 2e-5 * np.sqrt(2 / 100), rtol=0.02)
    assert np.all(lines.sd()[:, 2] == 0)


def test_the_seed_decides_the_noise(dashpot: Command, rig: Path) -> None:
    def drawn(seed: int) -> str:
        dashpot(f"simulate rig.toml --out s.csv --frequencies 3 --seed {seed} {SET}")
        return Path("s.csv").read_text(encoding="utf-8")

    assert drawn(1) == drawn(1)
    assert drawn(1) != drawn(2)


@pytest.mark.slow
def test_not_converged_is_told_written_and_ends_with_3(
    dashpot: Command, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dashpot.estimate import identify as planning

    monkeypatch.setattr(planning, "method_named", lambda name, **_: method(name, max_iterations=1))
    done = dashpot("identify rig.toml data.csv --method oiv --json out.json")
    assert done.code == 3
    assert done.err[:-1] == [STEADY]
    assert "did not converge" in done.err[-1]
    assert "NOT CONVERGED" in done.out
    assert json.loads(Path("out.json").read_text(encoding="utf-8"))["status"] == "not converged"


def test_help_names_all_commands_and_imports_none(dashpot: Command) -> None:
    code = (
        "import sys; from dashpot.app.cli import run; code = run(['--help']);"
        "heavy = {'numpy', 'rich', 'scipy', 'pydantic', 'matplotlib', 'jinja2', 'pyarrow'} & set(sys.modules);"
        "print(sorted(heavy), file=sys.stderr); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stderr.strip() == "[]"
    assert all(name in done.stdout for name in COMMANDS)


@pytest.mark.slow
def test_identification_loads_nothing_that_only_others_need() -> None:
    code = (
        "import sys, dashpot.api;"
        "heavy = {'scipy.interpolate', 'scipy.optimize', 'scipy.stats', 'pandas', 'matplotlib'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_version(dashpot: Command) -> None:
    assert dashpot("--version").out == f"dashpot {__version__}\n"


def test_a_fault_is_one_line_and_raised_on_request(
    dashpot: Command, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import dashpot.model.rigfile as modelfile

    def broken(path: str) -> None:
        raise ZeroDivisionError("one\ntwo")

    monkeypatch.setattr(modelfile, "read_rig", broken)
    done = dashpot("identify", "rig.toml", "data.csv")
    assert done.code == 1
    assert len(done.err) == 1
    assert "ZeroDivisionError: one two" in done.err[0]
    assert "DASHPOT_TRACEBACK" in done.err[0]
    monkeypatch.setenv("DASHPOT_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        cli.run(["identify", "rig.toml", "data.csv"])


@pytest.mark.parametrize(("stop", "code"), [(Ended(15), 143), (KeyboardInterrupt(), 130)])
def test_a_stop_while_a_module_makes_a_class(
    dashpot: Command, data: Path, monkeypatch: pytest.MonkeyPatch, stop: BaseException, code: int
) -> None:
    """Python 3.11 wraps what is raised in __set_name__ in a RuntimeError."""
    import dashpot.model.rigfile as modelfile

    def imported(path: str) -> None:
        raise RuntimeError("Error calling __set_name__ on '_axis_method_wrapper'") from stop

    monkeypatch.setattr(modelfile, "read_rig", imported)
    done = dashpot("identify", "rig.toml", "data.csv")
    assert done.code == code
    assert len(done.err) == 1
    assert "no file is left half-written" in done.err[0]


@pytest.mark.parametrize(("given", "used"), [(None, "1"), ("2", "2")])
def test_blas_computes_on_one_thread_unless_told_otherwise(given: str | None, used: str) -> None:
    """Set before NumPy is imported: afterwards it would have no effect."""
    program = """
import os, sys
from dashpot.app import cli
assert "numpy" not in sys.modules
cli.run = lambda *_: print(os.environ["OPENBLAS_NUM_THREADS"], "numpy" in sys.modules) or 0
cli.main()
"""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    if given is not None:
        environment["OPENBLAS_NUM_THREADS"] = given
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == [used, "False"], done.stderr


def test_a_command_ends_without_the_interpreter_being_taken_down(tmp_path: Path) -> None:
    """What was registered for the end is done and told; threads of libraries that still read ahead meet no ruins."""
    program = """
import atexit
from dashpot.app import cli
class Late:
    def __del__(self):
        print("taken down", flush=True)
late = Late()
atexit.register(print, "registered")
cli.run = lambda *_: print("answered") or 3
cli.main()
"""
    script = tmp_path / "dashpot"  # as an installed command is named
    script.write_text(program, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split(), done.stderr) == (3, ["answered", "registered"], "")


def test_a_program_that_runs_the_command_goes_on_after_it() -> None:
    program = """
import runpy, sys
sys.argv = ["dashpot", "--version"]
try:
    runpy.run_module("dashpot", run_name="__main__")
except SystemExit as end:
    print("ended with", end.code)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1] == "ended with 0", done.stderr


@pytest.mark.slow
def test_a_broken_pipe_is_silent(data: Path) -> None:
    command = [sys.executable, "-m", "dashpot", "identify", "rig.toml", "data.csv"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=data.parent
    ) as process:
        process.stdout.close()
        assert process.stderr.read().decode() == STEADY + "\n"
        assert process.wait() == 141


@pytest.mark.slow
def test_what_was_noticed_in_the_records_is_told_once_for_all_dwells(dashpot: Command) -> None:
    """A frequency that is stated 0.4 % too high is found and told; --refine does it for each dwell, none does not."""
    Path("rig.toml").write_text(RIG, encoding="utf-8")
    sent = ["--frequencies", "2:15/8log", "--periods", "20", "--amplitude", "u=0.002", "--out", "true.csv"]
    assert dashpot(f"simulate rig.toml {SET}", *sent).code == 0
    head, *rows = Path("true.csv").read_text(encoding="utf-8").splitlines()
    cells = [row.split(",", 1) for row in rows]
    text = "\n".join([head, *(f"{1.004 * float(hz):.12g},{rest}" for hz, rest in cells)]) + "\n"
    Path("data.csv").write_text(text, encoding="utf-8")
    usual, alike = dashpot("identify", "rig.toml", "data.csv"), "8 dwells alike"
    assert usual.err == [
        f"note: the response is at 0.996016 × the stated frequencies ({alike}): this ratio is used [clock_refined]",
        STEADY.replace("kept", "refined"),
    ]
    blind = dashpot("identify", "rig.toml", "data.csv", "--transients", "none", "--refine", "none")
    assert blind.err == [STEADY]
    assert "--settle auto and --refine always" in " ".join(blind.out.split())
    for command in (("identify",), ("compare", "--methods", "oiv"), ("spectrum", "--out", "table.csv")):
        name, *more = command
        done = dashpot(name, "rig.toml", "data.csv", "--refine", *more)
        assert done.code == 0
        assert (
            "note: data.csv:2: driven at 2 Hz, not at 2.008 Hz (and 7 more like this) [frequency_refined]"
            in done.err
        )
        assert len(done.err) == 2
    assert dashpot("identify", "rig.toml", "data.csv", "--refine", "-q").err == []


@pytest.mark.slow
@pytest.mark.parametrize("gain", [-1.0, 0.001])
def test_a_wrong_sign_or_unit_shows_in_an_unknown_gain(dashpot: Command, data: Path, gain: float) -> None:
    """What the how-to advises where a model does not fit: all gains unknown but that of the input."""
    head, *rows = data.read_text(encoding="utf-8").splitlines()
    at = head.split(",").index("x2")
    lines = [head]
    for row in rows:
        cells = row.split(",")
        cells[at] = repr(gain * float(cells[at]))
        lines.append(",".join(cells))
    Path("wrong.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert dashpot("identify rig.toml wrong.csv --json blind.json").code == 0
    assert json.loads(Path("blind.json").read_text(encoding="utf-8"))["fit"]["verdict"] == "does not fit"
    loose = RIG.replace('unit = "mm", noise', 'unit = "mm", gain = "unknown", noise')
    assert loose.count('gain = "unknown"') == 2
    Path("loose.toml").write_text(loose, encoding="utf-8")
    done = dashpot("identify", "loose.toml", "wrong.csv", "--json", "out.json")
    assert done.code == 0
    found = Estimate.load("out.json")
    assert abs(found["x2.gain"].value - gain) < 4 * found["x2.gain"].sd < 0.1 * abs(gain)
    assert abs(found["x1.gain"].value - 1) < 4 * found["x1.gain"].sd < 0.1
    assert "The model fits" in done.out


NONLINEAR = one_mass(
    "u", "value = 1.2", "guess = 1900", "guess = 6", {"x": 'unit = "mm"', "u": 'unit = "mm"'},
    k3='law = "cubic", guess = 4e8',
)  # fmt: skip


def test_a_curve_of_nothing_but_the_drive_is_refused(dashpot: Command) -> None:
    Path("n.toml").write_text(NONLINEAR.replace('x = { of = "x", unit = "mm" }\n', ""))
    result = dashpot("response", "n.toml", "--band", "2:9", "--amplitude", "1mm", "--figure", "o.svg")
    assert result.code == 2
    assert "n.toml: no channel shows how the rig moves" in result.err[0]


@pytest.mark.slow
def test_nonlinear_rigs_are_simulated_and_their_curves_drawn(dashpot: Command) -> None:
    Path("n.toml").write_text(NONLINEAR)
    drive = ["--frequencies", "3:9:1", "--amplitude", "1mm"]
    assert dashpot("simulate", "n.toml", "--out", "n.csv", *drive).code == 0
    assert dashpot("identify", "n.toml", "n.csv").code == 0
    Path("in.csv").write_text("time_s,u\n" + "".join(f"{k / 200},{0.1 * (k % 37)}\n" for k in range(400)))
    assert dashpot("simulate", "n.toml", "--input", "in.csv", "--out", "r.csv").code == 0
    assert Path("r.csv").read_text().startswith("time_s,x,u")
    drawn = dashpot("response n.toml --band 7:9 --amplitude 0.5mm -o c.csv --figure c.png --backbone 1")
    assert drawn.code == 0, drawn.err
    assert "0.5 mm: 7 to 9 Hz" in drawn.out
    assert Path("c.csv").read_text().startswith("curve,frequency_hz,drive,stable,x_swing,u_swing")
    assert Path("c.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["simulate", "n.toml", "--out", "o.csv", "--frequencies", "3"], "add --amplitude u=1mm"),
        (["design", "n.toml", "--samples", "100"], "depends on the drive level"),
        (["simulate", "n.toml", "--out", "o.csv"], "--input"),
        (["simulate", "n.toml", "--out", "o.csv", "--input", "n.toml", "--frequencies", "3"], "two drives"),
        (["response", "n.toml"], "--band"),
        (["response", "rig.toml", "--band", "1:3", "--set", "m1=1,c1=1,c2=1"], "nonlinear"),
    ],
)
def test_what_drives_a_nonlinear_rig_must_be_said_once(
    dashpot: Command, rig: Path, arguments: list[str], named: str
):
    Path("n.toml").write_text(NONLINEAR)
    result = dashpot(*arguments)
    assert result.code == 2
    assert named in str(result.err)


@pytest.mark.slow
def test_a_wrong_unit_that_the_data_state_is_corrected_by_a_gain(dashpot: Command, data: Path) -> None:
    """A rig file in another unit than the heading of a column would be refused."""
    head, *rows = data.read_text(encoding="utf-8").splitlines()
    at = head.split(",").index("x2")
    cells = [row.split(",") for row in rows]
    smaller = [",".join([*row[:at], repr(float(row[at]) / 1000), *row[at + 1 :]]) for row in cells]
    Path("m.csv").write_text("\n".join([head.replace("x2", "x2 [mm]"), *smaller]) + "\n", encoding="utf-8")
    assert dashpot("identify rig.toml m.csv --apply new.toml -q").code == 0
    assert "gain = 0.001" in Path("new.toml").read_text(encoding="utf-8")
    assert dashpot("identify new.toml m.csv --json again.json -q").code == 0
    assert json.loads(Path("again.json").read_text(encoding="utf-8"))["fit"]["verdict"] == "fits"


@pytest.mark.slow
def test_apply_edits_the_text_of_the_rig_file_and_replaces_no_other(dashpot: Command, data: Path) -> None:
    """One entry changes; comments, units and order stay.  A file that is there is replaced with --force alone."""
    head, *rows = data.read_text(encoding="utf-8").splitlines()
    at = head.split(",").index("x2")
    cells = [row.split(",") for row in rows]
    turned = [",".join([*row[:at], repr(-float(row[at])), *row[at + 1 :]]) for row in cells]
    Path("turned.csv").write_text("\n".join([head, *turned]) + "\n", encoding="utf-8")
    told = dashpot("identify rig.toml turned.csv --apply new.toml")
    assert told.code == 0
    assert "Written: new.toml, the rig file with [channels] x2 = " in " ".join(told.out.split())
    new = Path("new.toml").read_text(encoding="utf-8")
    assert sum(a != b for a, b in zip(RIG.splitlines(), new.splitlines(), strict=True)) == 1
    assert dashpot("identify new.toml turned.csv --json again.json -q").code == 0
    assert json.loads(Path("again.json").read_text(encoding="utf-8"))["fit"]["verdict"] == "fits"
    refused = dashpot("identify rig.toml data.csv --apply new.toml --json e.json -q")
    assert refused.code == 2
    assert "new.toml: a file of this name exists" in refused.err[0]
    assert not Path("e.json").exists()
    assert dashpot("identify rig.toml turned.csv --apply new.toml --force -q").code == 0
    fits = dashpot("identify rig.toml data.csv --apply other.toml --json e.json")
    assert (fits.code, Path("other.toml").exists(), Path("e.json").exists()) == (0, False, True)
    assert "Nothing to apply" in fits.out
