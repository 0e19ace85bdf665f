"""dashpot identify --in-parts: files one by one, merged."""

import json
from pathlib import Path

import pytest

from tests.unit.app.conftest import SET, Command


@pytest.fixture
def files(dashpot: Command, rig: Path) -> list[str]:
    """Three tests of the rig."""
    names = [f"part{k}.csv" for k in range(3)]
    for k, name in enumerate(names):
        sent = f"--frequencies 1:15/8log --amplitude u=0.01 --seed {k} {SET}"
        assert dashpot(f"simulate rig.toml --out {name} {sent}").code == 0
    return names


@pytest.mark.slow
def test_parts_are_merged_the_same_by_two_workers(dashpot: Command, files: list[str]) -> None:
    alone = dashpot("identify", "rig.toml", *files, "--in-parts", "--workers", "1", "--json", "one.json")
    assert alone.code == 0, alone.err
    assert any("3 parts of the data were identified separately" in line for line in alone.err)
    assert (
        dashpot("identify", "rig.toml", *files, "--in-parts", "--workers", "2", "--json", "two.json").code
        == 0
    )
    assert Path("one.json").read_bytes() == Path("two.json").read_bytes()
    merged = json.loads(Path("one.json").read_text(encoding="utf-8"))
    together = json.loads(dashpot("identify", "rig.toml", *files, "--json", "-").out)
    assert merged["fit"]["verdict"] == together["fit"]["verdict"] == "fits"
    for name, parameter in together["parameters"].items():
        assert abs(merged["parameters"][name]["value"] - parameter["value"]) < 0.2 * parameter["sd"] + 1e-12
    assert dashpot("validate", "one.json", files[0]).code == 0


@pytest.mark.long
def test_a_cluster_merges_parts_to_the_same_bits(dashpot: Command, files: list[str]) -> None:
    pytest.importorskip("distributed")
    shared = ("--dask", "local", "--workers", "2")
    for name, how in (("one.json", ("--workers", "1")), ("dask.json", shared)):
        done = dashpot("identify", "rig.toml", *files, "--in-parts", "--json", name, "-q", *how)
        assert done.code == 0, done.err
    assert Path("one.json").read_bytes() == Path("dask.json").read_bytes()


@pytest.mark.slow
def test_a_report_of_merged_parts_says_what_it_rests_on(dashpot: Command, files: list[str]) -> None:
    done = dashpot("identify", "rig.toml", *files, "--in-parts", "--workers", "1", "--report", "out.html")
    assert done.code == 0, done.err
    page = Path("out.html").read_text(encoding="utf-8")
    assert "3 parts of the data were identified separately" in page


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--workers", "2"), "--workers needs"),
        (("--dask", "local"), "--dask needs"),
        (("--in-parts", "--figure", "fit.png"), "--figure needs all"),
        (("--in-parts", "--hold-out", "25%"), "--hold-out needs all"),
        (("--in-parts", "part0.csv"), "is given 2 times"),
    ],
)
def test_what_does_not_go_together_is_one_line(
    dashpot: Command, files: list[str], options: tuple[str, ...], said: str
) -> None:
    done = dashpot("identify", "rig.toml", *files, *options)
    assert done.code == 2
    assert len(done.err) == 1
    assert said in done.err[0]
    assert not Path("fit.png").exists()


def test_nonlinear_rigs_are_refused(dashpot: Command, rig: Path, files: list[str]) -> None:
    text = rig.read_text(encoding="utf-8")
    rig.write_text(
        text.replace("[dampers]", 'k3 = { between = ["x1", "x2"], law = "cubic" }\n[dampers]'),
        encoding="utf-8",
    )
    done = dashpot("identify", "rig.toml", *files, "--in-parts")
    assert done.code == 2
    assert "parts can be merged for linear rigs only" in done.err[0]
