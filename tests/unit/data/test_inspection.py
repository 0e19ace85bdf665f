"""What is told of a data file: sampling, gaps, clipping, resolution, content, and the channels it suggests."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import dashpot
from dashpot.data.inspection import channels_in, guessed_quantity, inspect_file, suggested_channels
from dashpot.errors import DataError
from dashpot.free.response import write_response
from dashpot.present.data import inspection_document, part_in_words, picture
from dashpot.present.document import show
from tests.unit.data.readers.written import WRITERS, recording


@pytest.fixture
def noisy(tmp_path):
    """10 Hz sampling at 100 Hz, three gaps, 8-bit readings, one channel clipped, one with empty cells, one of words."""
    rng = np.random.default_rng(3)
    t = np.delete(np.arange(1000) / 100, [100, 300, 301, 500])
    x = np.round(127 * np.sin(2 * np.pi * 10 * t) + rng.normal(size=len(t))) * 0.01
    y = np.clip(2 * np.sin(2 * np.pi * 3 * t) + 0.01 * rng.normal(size=len(t)), -1.5, 1.5)
    rows = ["time_s,acc [g],y (mm),label,z"]
    rows += [
        f"{a:.2f},{b:.2f},{c!r},run,{'' if i < 20 else c}"
        for i, (a, b, c) in enumerate(zip(t.tolist(), x.tolist(), y.tolist(), strict=True))
    ]
    path = tmp_path / "noisy.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_what_is_told(noisy):
    inspection = inspect_file(noisy)
    (part,) = inspection.parts
    assert inspection.format == "text"
    assert part.samples == 996
    assert part.rates_hz == pytest.approx((100, 100))
    assert part.gaps == 3
    assert part.longest_gap == pytest.approx((2.99, 3.02))
    assert part.duration_s == pytest.approx(9.99)
    assert part.others == ("label",)
    acc, y, z = part.columns
    assert (acc.name, acc.unit, acc.quantity) == ("acc", "g", "acceleration")
    assert acc.resolution == pytest.approx(0.01)
    assert 7.9 < acc.bits < 8.2
    assert acc.clipped == 0
    assert y.clipped > 300
    assert z.missing == 20
    strongest = acc.bands_hz[int(np.argmax(acc.level_db))]
    assert strongest == pytest.approx(10, abs=1.5)
    assert np.max(acc.level_db) == 0


def test_what_is_shown(noisy):
    inspection = inspect_file(noisy)
    out = Console(width=80, record=True, file=None, force_terminal=False)
    with out.capture() as capture:
        show(out, inspection_document(inspection))
    text = capture.get()
    assert "996 samples, 100 Hz over 9.99 s" in text
    assert "3 gaps, the longest from" in text
    assert "clipped?" in text
    assert "label" in text
    assert max(len(line) for line in text.splitlines()) <= 80
    assert part_in_words(inspection.parts[0], inspection.source).startswith("996 samples")
    assert len(picture(inspection.parts[0].columns[0])) <= 20


def test_channels_are_suggested(noisy, tmp_path):
    text = suggested_channels([inspect_file(noisy)])
    table = tomllib.loads(text)["channels"]
    assert table["acc"] == {"of": "?", "quantity": "acceleration", "unit": "g"}
    assert table["y"] == {"of": "?", "quantity": "displacement", "unit": "mm"}
    odd = tmp_path / "odd.csv"
    odd.write_text('time_s,"Kraft ""links"" 1"\n0,1\n1,2\n')
    assert tomllib.loads(suggested_channels([inspect_file(odd)]))["channels"] == {
        'Kraft "links" 1': {"of": "?", "quantity": "force"}
    }


def test_quantities_are_guessed_by_unit_then_by_name():
    assert guessed_quantity("whatever", "µm") == "displacement"
    assert guessed_quantity("whatever", "deg/s") == "velocity"
    assert guessed_quantity("Acc_X", None) == "acceleration"
    assert guessed_quantity("Acc_X", "V") == "acceleration"
    assert guessed_quantity("whatever", None) is None


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_is_inspected(tmp_path, name):
    suffix, write = WRITERS[name]
    path = tmp_path / f"test{suffix}"
    write(path, recording())
    inspection = inspect_file(path)
    names = {column.name for part in inspection.parts for column in part.columns}
    assert {"x1", "x2", "u"} <= names
    assert {f for part in inspection.parts for f in part.frequencies} == {2.0, 4.0, 8.0}
    assert any(part.rates_hz == pytest.approx((128, 128)) for part in inspection.parts)


def test_channels_of_data_without_a_rig(tmp_path: Path) -> None:
    """Columns without names, those that a manifest chooses, and responses with covariances, from file to response."""
    rng = np.random.default_rng(0)
    t, u = np.arange(2000) / 100, rng.standard_normal(2000)
    np.savetxt(tmp_path / "plain.csv", np.column_stack([t, u, 2 * u, 3 * u]), delimiter=",")
    manifest = tmp_path / "test.toml"
    manifest.write_text(
        '[[files]]\nname = "plain.csv"\ncolumns = { u = "column2", x = "column4" }\nunits = { x = "mm" }\n'
    )
    assert list(channels_in([tmp_path / "plain.csv"])) == ["column2", "column3", "column4"]
    assert {name: channel.unit for name, channel in channels_in([manifest]).items()} == {"u": "", "x": "mm"}
    found = dashpot.frf(str(manifest), "u")
    assert found.pairs == ("x/u",)
    assert found.values[:, 0, 0] == pytest.approx(3)
    both = dashpot.frf(str(tmp_path / "plain.csv"), "column2")
    write_response(both, tmp_path / "frf.parquet")
    assert set(channels_in([tmp_path / "frf.parquet"])) == {"column2", "column3", "column4"}
    assert dashpot.frf(str(tmp_path / "frf.parquet"), "column2").pairs == both.pairs
    (tmp_path / "index.csv").write_text(",time_s,x\n0,0.0,1\n1,0.1,2\n2,0.2,3\n")
    assert list(channels_in([tmp_path / "index.csv"])) == ["x"]


def test_what_cannot_be_read_is_said(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\x00\x01\x02\x03")
    with pytest.raises(DataError, match="its format is unknown"):
        inspect_file(tmp_path / "a.csv")


def test_all_samples_of_long_files_count(tmp_path, monkeypatch):
    """Only the resolution and the content are sought in a part of them."""
    monkeypatch.setattr("dashpot.data.inspection.MOST_SAMPLES", 100)
    path = tmp_path / "long.csv"
    path.write_text(
        "time_s,x\n" + "".join(f"{k / 10:.1f},{k % 7 + (9 if k == 800 else 0)}\n" for k in range(1000))
    )
    (part,) = inspect_file(path).parts
    assert part.samples == 1000
    assert part.duration_s == pytest.approx(99.9)
    assert part.longest_gap is None
    assert part.columns[0].greatest == 800 % 7 + 9


def test_dwells_are_stretches_on_clocks_of_their_own(tmp_path: Path) -> None:
    """Ten periods each at 2 and 8 Hz, 20 samples a period: one rate for all had made gaps of the slow dwell's steps."""
    path, rows = tmp_path / "dwells.csv", ["frequency_hz,time_s,x"]
    for hz in (2.0, 8.0):
        for i in range(200):
            rows.append(f"{hz},{i / (20 * hz)},{np.sin(2 * np.pi * i / 20)}")
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    (part,) = inspect_file(path).parts
    assert part.stretches == 2
    assert part.rates_hz == pytest.approx((40, 160))
    assert part.gaps == 0
    assert part.uneven < 1e-9
    assert part.duration_s == pytest.approx(199 / 40 + 199 / 160)
    (x,) = part.columns
    loud = x.bands_hz[x.level_db > -10]
    assert loud.min() < 4.1
    assert 8 < loud.max() < 12
