"""--report of every command that has one."""

import hashlib
import json
import re
from pathlib import Path

import pytest

from dashpot.app import report_files
from tests.two_masses import UNDETERMINED
from tests.unit.app.commands.test_study import STUDY
from tests.unit.app.conftest import RIG, Command


def words(path: str) -> str:
    """The text of a page, which must ask for nothing from elsewhere."""
    html = Path(path).read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="(?!data:|#)', html)
    assert len(html) < 2 * 2**20
    return re.sub(r"\s+", " ", re.sub(r"<style>.*?</style>|<[^>]+>", " ", html, flags=re.DOTALL))


@pytest.mark.slow
def test_identify(dashpot: Command, data: Path) -> None:
    sent = "--report", "r.html", "--json", "e.json", "--seed", "3", "-q"
    assert dashpot("identify", "rig.toml", "data.csv", *sent).code == 0
    text = words("r.html")
    assert "dashpot identify rig.toml data.csv --report r.html --json e.json --seed 3 -q" in text
    assert hashlib.sha256(Path("data.csv").read_bytes()).hexdigest() in text
    assert hashlib.sha256(Path("rig.toml").read_bytes()).hexdigest() in text
    content = json.loads(Path("e.json").read_text(encoding="utf-8"))
    assert f"χ² = {content['fit']['chi2']:.3g}" in text
    assert f"{content['fit']['dof']} degrees of freedom" in text
    assert "--seed 3" in text


def test_labels_head_a_report(dashpot: Command, data: Path) -> None:
    Path("u.toml").write_text(UNDETERMINED, encoding="utf-8")
    labels = ("--label", "Client: <A> & Sons", "--label", "  Test 12,\n run 3 ")
    assert dashpot("check", "u.toml", *labels, "--report", "r.html").code == 3
    html = Path("r.html").read_text(encoding="utf-8")
    first = html[: html.index('class="verdict')]
    assert "<li>Client: &lt;A&gt; &amp; Sons</li><li>Test 12, run 3</li>" in first
    done = dashpot("identify", "rig.toml", "data.csv", *labels)
    assert done.code == 2
    assert "needs --report" in done.err[0]


def test_what_is_not_determined_is_reported_and_still_an_error(dashpot: Command, data: Path) -> None:
    Path("u.toml").write_text(UNDETERMINED, encoding="utf-8")
    for command in ("identify", "check"):
        arguments = ("u.toml", "data.csv") if command == "identify" else ("u.toml",)
        done = dashpot(command, *arguments, "--report", f"{command}.html")
        assert done.code == 3
        text = words(f"{command}.html")
        assert "do not determine the unknowns" in text
        assert "k1 + k2" in text
        assert "k3 = ?" in text  # drawn


@pytest.mark.slow
def test_compare_check_design_validate(dashpot: Command, data: Path) -> None:
    sent = ("--json", "e.json", "--figure", "fit.svg", "-q")
    assert dashpot("identify", "rig.toml", "data.csv", *sent).code == 0
    drawn = Path("fit.svg").read_text(encoding="utf-8")
    assert all(f">{text}<" in drawn for text in ("x1 over u", "model", "measured, ±2 sd", "phase, °"))
    for line in (
        "compare rig.toml data.csv --methods oiv,wls",
        "check rig.toml data.csv --known --profile m1",
        "design rig.toml --after e.json --samples 500 --rate 100 --relative-noise 5%",
        "validate e.json data.csv --figure v.pdf",
    ):
        command = line.split()[0]
        done = dashpot(*line.split(), "--report", f"{command}.html", "--label", "Test 12", "-q")
        assert (done.code, done.err) == (0, []), line
        text = words(f"{command}.html")
        assert f"dashpot {line} --report" in text
        assert "<li>Test 12</li>" in Path(f"{command}.html").read_text(encoding="utf-8")
        assert "What next" in text
    assert "Use the values of oiv" in words("compare.html")
    assert "All unknowns can be found" in words("check.html")
    assert re.search(r"\d+ dwells?, \d+ samples", words("design.html"))
    assert "FIT of every channel" in words("validate.html")
    assert Path("v.pdf").read_bytes().startswith(b"%PDF")


def test_study(dashpot: Command, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    small = STUDY.replace("draws = 30", "draws = 4").replace("[0.01, 0.05, 0.1]", "[0.01, 0.1]")
    (tmp_path / "noise.toml").write_text(small, encoding="utf-8")
    assert dashpot("study", "noise.toml", "--processes", "1", "--report", "s.html", "-q").code == 0
    text = words("s.html")
    assert "Errors of the methods" in text
    assert "--workers 1" in text  # whatever name was typed


def test_without_a_browser_pdf_is_refused_before_the_work(
    dashpot: Command, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_files, "BROWSERS", ("no-such-browser",))
    done = dashpot("identify", "rig.toml", "data.csv", "--report", "r.pdf")
    assert done.code == 2
    assert len(done.err) == 1
    assert "write .html" in done.err[0]
    assert done.out == ""
    Path("r.pdf").symlink_to("data.csv")
    done = dashpot("identify", "--report", "r.pdf", "rig.toml", "data.csv")
    assert "overwrite" in done.err[0]


def test_a_browser_that_fails_leaves_no_file(
    dashpot: Command, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_files, "BROWSERS", ("false",))
    done = dashpot("check", "rig.toml", "--report", "r.pdf")
    assert done.code == 2
    assert "did not print the report" in done.err[0]
    assert not Path("r.pdf").exists()
