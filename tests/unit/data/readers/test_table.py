"""Text of any shape: the same samples however they are written, and what is refused."""

import gzip

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.readers import read
from dashpot.data.readers.columns import seconds_of
from dashpot.data.readers.datafile import open_file
from dashpot.data.readers.registry import reader_of
from dashpot.data.readers.text import open_table
from dashpot.errors import DataError

MM = (Channel("x1", {"x1": 1}, unit="mm", scale=1e-3), Channel("u", {"u": 1}, unit="mm", scale=1e-3))
SI = (Channel("x1", {"x1": 1}), Channel("u", {"u": 1}))
X1, U = [1.5, -2.25, 3.0, 0.5], [0.25, 0.5, -0.75, 1.0]
ROWS = "".join(f"{0.1 * i:.1f},{a},{b}\n" for i, (a, b) in enumerate(zip(X1, U, strict=True)))
PLAIN = "time_s,x1,u\n" + ROWS


def semicolons(text):
    return text.replace(",", ";").replace(".", ",")


SHAPES = {
    "plain": PLAIN,
    "comments": "# a\n\n# b\n" + PLAIN,
    "preamble": "Instrument: Q7\nOperator, somebody\nSamples, 4\n\n" + PLAIN,
    "sep": "sep=;\n" + semicolons(PLAIN),
    "decimal commas": semicolons(PLAIN),
    "tabs": PLAIN.replace(",", "\t"),
    "bars": PLAIN.replace(",", "|"),
    "quotes and blanks around names": PLAIN.replace("x1", '"x1"').replace(",u", ", u "),
    "remarks in brackets": PLAIN.replace("x1", "x1 (left)"),
    "blank rows": PLAIN.replace("\n0.2", "\n\n\n0.2"),
    "blanks": PLAIN.replace(",", "   ").replace("\n0", "\n  0"),
    "UTF-16": PLAIN.encode("utf-16"),
    "units in brackets": PLAIN.replace("x1,u", "x1 [mm],u (mm)"),
    "a row of units": PLAIN.replace("x1,u\n", "x1,u\ns,mm,mm\n"),
    "a row of bracketed units": PLAIN.replace("x1,u\n", "x1,u\n[s],[mm],[mm]\n"),
    "preamble and units": "Title\nDate, today\n" + PLAIN.replace("x1,u\n", "x1,u\ns,mm,mm\n"),
    "milliseconds": "Time [ms],x1,u\n" + ROWS.replace("0.1,", "100,").replace("0.2,", "200,").replace("0.3,", "300,"),
    "a row of units with milliseconds": "t,x1,u\nms,mm,mm\n"
    + ROWS.replace("0.1,", "100,").replace("0.2,", "200,").replace("0.3,", "300,"),
    "delimiter at the end of the header": PLAIN.replace("x1,u\n", "x1,u,\n"),
    "moments": "timestamp,x1,u\n"
    + "".join(f"2025-03-06 23:59:59.{i + 7}00,{a},{b}\n" for i, (a, b) in enumerate(zip(X1[:3], U, strict=False)))
    + "2025-03-07 00:00:00.000,0.5,1.0\n",
    "time of day": "Time,x1,u\n"
    + "".join(f"23:59:59.{i + 7},{a},{b}\n" for i, (a, b) in enumerate(zip(X1[:3], U, strict=False)))
    + "00:00:00.0,0.5,1.0\n",
    "other columns": "note,time_s,x1,u\n" + "".join(f"ok,{row}\n" for row in ROWS.splitlines()),
}  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("packed", [False, True])
def test_the_same_samples(tmp_path, shape, packed):
    content = SHAPES[shape]
    data = content if isinstance(content, bytes) else content.encode()
    path = tmp_path / "test.txt"
    path.write_bytes(gzip.compress(data) if packed else data)
    (record,) = read(path, MM, frequency_hz=2.0).records
    assert record.time == pytest.approx([0, 0.1, 0.2, 0.3], abs=1e-9)
    assert record.values == pytest.approx(1e-3 * np.array([X1, U]).T, rel=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("piece", [6, 50, 1000])
def test_large_files_are_not_held(tmp_path, shape, piece, monkeypatch):
    monkeypatch.setattr("dashpot.data.readers.datafile.LARGE", 1)
    monkeypatch.setattr("dashpot.data.readers.datafile.PIECE", piece)
    monkeypatch.setattr("dashpot.data.readers.text.PIECE", piece)
    content = SHAPES[shape]
    path = tmp_path / "test.txt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert open_table(path).file is not None
    (record,) = read(path, MM, frequency_hz=2.0).records
    assert record.values == pytest.approx(1e-3 * np.array([X1, U]).T, rel=1e-14)
    path.write_text(PLAIN.replace("-0.75", "bad"))
    with pytest.raises(DataError, match=r"test.txt:4: column u: .bad. is not a number"):
        read(path, MM)
    path.write_text("# of blanks\n\n" + SHAPES["blanks"].replace("-0.75", "bad"))
    with pytest.raises(DataError, match=r"test.txt:6: column u: .bad. is not a number"):
        read(path, MM)
    path.write_bytes(PLAIN.encode("utf-16")[:-1])
    with pytest.raises(DataError, match=r"test.txt: the file is damaged"):
        read(path, MM)


def test_volts_need_a_sensitivity(tmp_path):
    path = tmp_path / "test.csv"
    path.write_text("time_s,acc [mV]\n0,1\n1,2\n")
    sensor = Channel("acc", {"x1": 1}, Quantity.ACCELERATION, "mV", 1e-3, gain=0.0102)
    assert read(path, (sensor,)).records[0].values[:, 0] == pytest.approx([1e-3, 2e-3])
    free = Channel("acc", {"x1": 1}, Quantity.ACCELERATION, gain=None)
    assert read(path, (free,)).records[0].values[:, 0] == pytest.approx([1, 2])
    for channel in (
        Channel("acc", {"x1": 1}, Quantity.ACCELERATION),
        Channel("acc", {"x1": 1}, Quantity.ACCELERATION, "V", 1.0, gain=0.0102),
        Channel("acc", {"x1": 1}, Quantity.ACCELERATION, "g", 9.80665),
    ):
        with pytest.raises(DataError, match=r"column acc: in mV, the rig"):
            read(path, (channel,))


def test_units_of_the_file_count_where_the_rig_says_none(tmp_path):
    path = tmp_path / "test.csv"
    path.write_text(PLAIN.replace("x1,u\n", "x1,u [in]\ns,mm,\n"))
    (record,) = read(path, SI).records
    assert record.values == pytest.approx(np.array([X1, U]).T * [1e-3, 0.0254], rel=1e-14)


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (PLAIN.replace("x1,u\n", "x1,u\ns,N,mm\n"), "column x1: N is not a unit"),
        (PLAIN.replace("time_s", "time [mm]"), "time .mm.: mm"),
        (PLAIN.replace("time_s,x1", "time,t"), "column x1: missing|several columns"),
        (SHAPES["moments"].replace("23:59:59.800", "then"), "is not a date"),
        (SHAPES["preamble"].replace("0.5,1.0\n", "0.5,\n"), "test.csv:9: column u: the cell is empty"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, content, what):
    path = tmp_path / "test.csv"
    path.write_text(content)
    with pytest.raises(DataError, match=what) as error:
        read(path, SI)
    assert "\n" not in str(error.value)


def test_a_bad_first_row_is_no_preamble(tmp_path):
    path = tmp_path / "test.csv"
    path.write_text("time_s,x1,u\n0.0,1.0,2.0\nno,more,numbers\n0.1,1.0,2.0\n0.2,2.0,2.0\n")
    assert open_table(path).header == ("time_s", "x1", "u")
    with pytest.raises(DataError, match=r"test.csv:3: column time_s"):
        read(path, SI)


def test_moments_in_other_orders():
    seconds, wrong = seconds_of(["06.03.2025 12:00:00,5", "6.3.2025 12:00:01,75", "07.03.2025 12:00:00,5"])
    assert wrong is None
    assert seconds == pytest.approx([0, 1.25, 86400])
    assert seconds_of(["12:00:00", "2025-13-41 12:00:00"])[1] == 1


def test_amplitude_and_phase(tmp_path):
    plain, polar = tmp_path / "plain.csv", tmp_path / "polar.csv"
    X, V = np.array([3 - 4j, 0.1j]), np.array([1.0, -2.0])
    rows = [
        f"{f},{x.real},{x.imag},0.1,{v},0.0,0.0"
        for f, x, v in zip((1, 2), X.tolist(), V.tolist(), strict=True)
    ]
    plain.write_text("frequency_hz,x1_re,x1_im,x1_sd,u_re,u_im,u_sd\n" + "\n".join(rows) + "\n")
    rows = [
        f"{2 * np.pi * f:.17g},{abs(x):.17g},{np.degrees(np.angle(x)):.17g},0.1,{abs(v)},{np.angle(v):.17g},0.0"
        for f, x, v in zip((1, 2), X.tolist(), V.tolist(), strict=True)
    ]
    head = "frequency [rad/s],x1_amplitude [mm],x1_phase,x1_sd [mm],u_mag,u_phase [rad],u_sd\n"
    polar.write_text(head + "\n".join(rows) + "\n")
    expected, got = read(plain, MM).spectrum(), read(polar, MM).spectrum()
    assert got.frequency_hz == pytest.approx(expected.frequency_hz, rel=1e-14)
    assert got.amplitudes == pytest.approx(expected.amplitudes, rel=1e-12, abs=1e-18)
    assert got.covariance == pytest.approx(expected.covariance, rel=1e-12)
    polar.write_text(polar.read_text().replace("u_phase [rad]", "u_phase [mm]"))
    with pytest.raises(DataError, match="mm is not a unit"):
        read(polar, MM)


def test_files_that_are_none(tmp_path):
    for path, what in (
        (tmp_path, "is a directory"),
        (tmp_path / "no.csv", "no such file"),
        ("/dev/null", "is empty"),
        ("/dev/zero", "is a device"),
        ("a\0b", "cannot be read"),
    ):
        with pytest.raises(DataError, match=what) as error:
            read(path, SI)
        assert "\n" not in str(error.value)
    many = tmp_path / "many.csv"
    many.write_text(",".join(f"c{i}" for i in range(10**6)) + "\n")
    with pytest.raises(DataError, match="header row is over"):
        read(many, SI)
    many.write_text("a," * 20_000 + "\n1,2\n")
    with pytest.raises(DataError, match="the header has 20001"):
        read(many, SI)


def test_readers_know_their_files(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(PLAIN)
    assert reader_of(open_file(path)).format == "text"
    path.write_text("PacketCounter,SampleTimeFine,Acc_X\n0,1,2\n")
    assert reader_of(open_file(path)).format == "Xsens DOT"


@pytest.mark.parametrize(
    ("cell", "noted"),
    [("1,000", True), ("12,345", True), ("0,125", False), ("1,5", False), ("1,0000", False)],
)
def test_commas_that_may_part_thousands_are_noted(tmp_path, cell, noted):
    path = tmp_path / "test.csv"
    path.write_text(f"time_s;x1\n0;{cell}\n1;{cell}\n2;{cell}\n")
    reading = read(path, MM[:1])
    assert reading.records[0].values[0, 0] == pytest.approx(1e-3 * float(cell.replace(",", ".")))
    assert [note.code for note in reading.notes].count("decimal_comma") == noted
