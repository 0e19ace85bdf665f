"""Which experiment of the rig file data are of: by the names of files, a column, a manifest, or in Python."""

from pathlib import Path

import numpy as np
import pytest

import dashpot
from dashpot.channel import RUNS
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError
from dashpot.model.rigfile import Rig, parse_rig

RIG = """
coordinates = ["x1"]
[inputs]
u = { kind = "displacement" }
[masses]
m1 = { at = "x1", value = 1 }
[springs]
k1 = { between = ["x1", "u"] }
[channels]
x1 = { of = "x1", gain = 2 }
u = { of = "u" }
[experiments.heavy]
data = "heavy*.csv"
m1 = 2
x1.gain = 4
[experiments.light]
data = ["light*.csv", "lost.csv"]
m1 = "own"
"""
TABLE = "frequency_hz,x1_re,x1_im,u_re,u_im\n5,8,0,1,0\n6,8,0,1,0\n"
RECORD = "time_s,x1,u\n" + "".join(f"{k / 100},8,{k % 3}\n" for k in range(50))


@pytest.fixture
def rig() -> Rig:
    return parse_rig(RIG)


def amplitudes(rig: Rig, *paths: Path) -> Spectrum:
    found = dashpot.read([str(path) for path in paths], rig).amplitudes
    assert found is not None
    return found


def test_files_by_their_names(tmp_path: Path, rig: Rig) -> None:
    for name in ("base.csv", "heavy7.csv", "lost.csv"):
        (tmp_path / name).write_text(TABLE)
    found = amplitudes(rig, *(tmp_path / name for name in ("base.csv", "heavy7.csv", "lost.csv")))
    assert (found.experiment // RUNS).tolist() == [0, 0, 1, 1, 2, 2]
    assert [channel.name for channel in found.channels] == ["x1", "u", "x1@heavy"]
    # The known gains have been taken out; what is not a channel of the experiment is missing.
    np.testing.assert_array_equal(found.amplitudes[:, 0].real, [4, 4, np.nan, np.nan, 4, 4])
    np.testing.assert_array_equal(found.amplitudes[:, 2].real, [np.nan, np.nan, 2, 2, np.nan, np.nan])


def test_a_file_that_fits_two_patterns_is_refused(tmp_path: Path) -> None:
    rig = parse_rig(RIG.replace('["light*.csv", "lost.csv"]', '"*7.csv"'))
    (tmp_path / "heavy7.csv").write_text(TABLE)
    with pytest.raises(DataError, match="heavy, light"):
        dashpot.read(str(tmp_path / "heavy7.csv"), rig)


@pytest.mark.parametrize("records", [False, True])
def test_rows_by_a_column(tmp_path: Path, rig: Rig, records: bool) -> None:
    whole = RECORD if records else TABLE
    head, *rows = whole.splitlines()
    lines = [f"{head},experiment", *(f"{row},0" for row in rows), *(f"{row},heavy" for row in rows)]
    (tmp_path / "all.csv").write_text("\n".join(lines) + "\n")
    found = dashpot.read(str(tmp_path / "all.csv"), rig)
    if records:
        assert [record.experiment // RUNS for record in found.records] == [0, 1]
        assert [record.channels[0].gain for record in found.records] == [2, 4]
    else:
        assert found.amplitudes is not None
        assert (found.amplitudes.experiment // RUNS).tolist() == [0, 0, 1, 1]
    (tmp_path / "all.csv").write_text("\n".join(lines).replace("heavy", "heavvy") + "\n")
    with pytest.raises(DataError, match="heavvy"):
        dashpot.read(str(tmp_path / "all.csv"), rig)


def test_files_by_a_manifest(tmp_path: Path, rig: Rig) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    manifest = tmp_path / "test.toml"
    manifest.write_text('[[files]]\nname = "a.csv"\nexperiment = "light"\n')
    assert (amplitudes(rig, manifest).experiment // RUNS).tolist() == [2, 2]
    manifest.write_text('[[files]]\nname = "a.csv"\nexperiment = "dark"\n')
    with pytest.raises(DataError, match="dark"):
        dashpot.read(str(manifest), rig)


def test_records_and_columns_in_python(rig: Rig) -> None:
    columns = {"time_s": np.arange(50) / 100, "x1": np.full(50, 8.0), "u": np.arange(50.0) % 3}
    record = dashpot.record(columns, rig, experiment="heavy")
    assert (record.experiment // RUNS, record.channels[0].name) == (1, "x1@heavy")
    named = {**columns, "experiment": np.array(["light"] * 50)}
    (of_light,) = dashpot.records_of(named, rig)
    assert (of_light.experiment // RUNS, of_light.channels[0].name) == (2, "x1")
    with pytest.raises(DataError, match="dark"):
        dashpot.record(columns, rig, experiment="dark")
