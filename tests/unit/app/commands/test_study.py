"""dashpot study: files in, a folder out, and an end to it when asked."""

from pathlib import Path

import pyarrow.parquet as parquet
import pytest

from tests.unit.app.conftest import RIG, VALUES, Command

STUDY = f"""\
name = "noise and samples"
draws = 30
methods = ["oiv", "wls"]
[rigs.two]
file = "rig.toml"
values = {{ {", ".join(f"{name} = {value}" for name, value in VALUES.items())} }}
[frequencies]
few = [2, 4, 6, 8, 10, 12]
[[grid]]
noise = [0.01, 0.05, 0.1]
samples = 20
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """A study file beside its rig."""
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "noise.toml").write_text(STUDY)
    return tmp_path / "noise.toml"


@pytest.mark.slow
def test_a_folder_with_summary_draws_and_pictures(dashpot: Command, study: Path) -> None:
    ran = dashpot("study", "noise.toml", "--processes", "1")
    assert ran.code == 0, ran.err
    table = parquet.read_table(study.parent / "noise" / "summary.parquet").to_pylist()
    assert len(table) == 3 * 2 * len(VALUES)
    assert {row["parameter"] for row in table} == set(VALUES)
    assert all(row["draws"] == 30 and row["failed"] == 0 for row in table)
    assert len(list((study.parent / "noise" / "draws").rglob("*.parquet"))) == 3
    pictures = sorted(path.name for path in (study.parent / "noise").glob("*.png"))
    assert pictures == ["noise_accuracy.png", "noise_errors.png"]
    assert "ratio" in ran.out
    assert "noise/summary.parquet" in ran.out


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[0.01, 0.05, 0.1]", "-1", "dashpot: noise.toml:10: grid[0].noise[0]: a noise of -1"),
        ("rig.toml", "none.toml", "dashpot: none.toml: there is no such file"),
        (
            "samples = 20",
            "samples = 2",
            "samples=2 covariance=given: 2 samples over 1 periods cannot separate",
        ),
        ('"wls"', '"ls"', "ls needs the velocity"),
    ],
)
def test_bad_studies_end_with_2_and_leave_no_summary(
    dashpot: Command, study: Path, old: str, new: str, message: str
) -> None:
    study.write_text(STUDY.replace(old, new))
    ran = dashpot("study", "noise.toml")
    assert ran.code == 2
    assert len(ran.err) == 1
    assert message in ran.err[0]
    assert not (study.parent / "noise").exists()
