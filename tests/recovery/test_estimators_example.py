"""The example that compares estimators: its files are what its README says, and its table is what comes out."""

import json
import runpy
from pathlib import Path

import pytest

from dashpot.app.cli import run

EXAMPLE = Path(__file__).parents[2] / "examples" / "05_methods"
TRUTH: dict[str, float] = runpy.run_path(str(EXAMPLE / "make_modes.py"))["TRUTH"]


def test_the_amplitudes_are_made_by_the_command_of_the_readme(tmp_path: Path) -> None:
    out = tmp_path / "amplitudes.csv"
    settings = [part for name, value in TRUTH.items() for part in ("--set", f"{name}={value}")]
    code = run([
        "simulate", str(EXAMPLE / "rig.toml"), "--out", str(out), "--table", "--frequencies", "1.5:12/24log",
        "--amplitude", "f=5", "--samples", "50", "--periods", "4", "--seed", "1", "--quiet", *settings,
    ])  # fmt: skip
    assert code == 0
    own, kept = (path.read_text(encoding="utf-8").splitlines() for path in (out, EXAMPLE / "amplitudes.csv"))
    assert own[0] == kept[0]
    assert len(own) == len(kept)
    for one, other in zip(own[1:], kept[1:], strict=True):  # another processor may round otherwise
        for a, b in zip(one.split(","), other.split(","), strict=True):
            assert a == b or float(a) == pytest.approx(float(b), rel=1e-9, abs=1e-12)


def test_the_methods_stand_to_each_other_as_the_readme_says(tmp_path: Path) -> None:
    """Typical errors: hls and iv lose the dampers, wls is worse than tls, cls and oiv; modes agree with the truth."""
    out = tmp_path / "out.json"
    files = [str(EXAMPLE / name) for name in ("rig.toml", "amplitudes.csv")]
    assert run(["compare", *files, "--modal", str(EXAMPLE / "modes.csv"), "--json", str(out), "--quiet"]) == 0
    methods = json.loads(out.read_text(encoding="utf-8"))["methods"]
    worst = {
        name: max(abs(e["parameters"][p]["value"] / true - 1) for p, true in TRUTH.items())
        for name, e in methods.items()
    }
    assert min(worst["hls"], worst["iv"]) > 1
    assert max(worst["tls"], worst["cls"], worst["oiv"]) < 0.08 < worst["wls"]
    for p, true in TRUTH.items():
        low, high = methods["modal"]["parameters"][p]["interval95"]
        assert low <= true <= high, p


def test_the_free_stiffness_is_the_one_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["identify", str(EXAMPLE / "free.toml"), str(EXAMPLE / "amplitudes.csv")]) == 0
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    readme = (EXAMPLE / "README.md").read_text(encoding="utf-8")
    table = [line.rstrip() for line in readme.split("```text\n")[1].split("```")[0].splitlines()]
    start = printed.index(table[0])
    assert printed[start : start + len(table)] == table
