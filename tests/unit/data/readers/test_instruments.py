"""Files of instruments, Xsens DOT and LabVIEW: what is read, and what is refused."""

import re

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.readers import read
from dashpot.data.readers.datafile import open_file
from dashpot.data.readers.instruments import read_labview
from dashpot.errors import DataError

SENSORS = tuple(Channel(name, {name: 1}, Quantity.ACCELERATION, "m/s²") for name in ("u", "x1"))


def xsens(first=0, rows=40, step=8333, start=1000, change=None):
    """A file whose Acc_X is the clock in s."""
    lines = ["sep=,", "DeviceTag:,Xsens DOT", "", "PacketCounter,SampleTimeFine,Euler_X,Acc_X,Acc_Y,Acc_Z"]
    for i in range(first, first + rows):
        clock = (start + step * i) % 2**32
        acceleration = "0.0,0.0,0.0" if i == first else f"{1e-6 * (start + step * i):.9f},1.0,9.8"
        lines.append(f"{i - first},{clock},0.5,{acceleration}")
    text = "\n".join(lines) + "\n"
    return text if change is None else text.replace(*change, 1)


@pytest.fixture
def files(tmp_path):
    def write(**texts):
        for name, text in texts.items():
            (tmp_path / f"{name}.csv").write_text(text)
        sensors = ", ".join(f'{name} = {{ {name} = "Acc_X" }}' for name in texts)
        test = tmp_path / "test.toml"
        test.write_text(f'[[files]]\nname = "{{sensor}}.csv"\nsensors = {{ {sensors} }}\n')
        return test

    return write


class TestXsens:
    def test_sensors_are_aligned_on_their_clock(self, files):
        reading = read(files(u=xsens(), x1=xsens(first=2)), SENSORS, frequency_hz=2.0)
        (record,) = reading.records
        # u begins with row 0, x1 with row 2; their first rows are zeros.
        assert len(record.time) == 40 - 3
        assert record.time[0] == 0
        assert np.diff(record.time) == pytest.approx(8333e-6)
        assert record.values[:, 0] == pytest.approx(record.values[:, 1])
        assert record.values[:, 0] == pytest.approx(1e-6 * (1000 + 8333 * 3) + record.time)
        assert record.frequency_hz == 2.0
        assert "2 samples" in reading.notes[-1].text
        with pytest.raises(DataError, match="did not record"):
            read(files(u=xsens(), x1=xsens(first=10_000)), SENSORS)

    def test_a_clock_that_starts_again(self, files):
        start = 2**32 - 10 * 8333
        (record,) = read(files(u=xsens(start=start), x1=xsens(start=start)), SENSORS).records
        assert np.diff(record.time) == pytest.approx(8333e-6)

    def test_lost_packets_keep_their_times(self, files):
        lines = xsens().splitlines()
        text = "\n".join([*lines[:20], *lines[23:]]) + "\n"
        reading = read(files(u=text, x1=xsens()), SENSORS)
        (record,) = reading.records
        assert np.max(np.diff(record.time)) == pytest.approx(4 * 8333e-6)
        assert any("3 packets are missing" in note.text for note in reading.notes)

    @pytest.mark.parametrize(
        ("text", "what"),
        [
            ("", "is empty"),
            ("sep=,\nDeviceTag:,Xsens DOT\n", "no rows"),
            (xsens(rows=1), "no measurements"),
            (xsens(change=("Acc_X", "Acc_W")), "Acc_X: missing"),
            (xsens(change=(",1.0,9.8", ",nan,9.8")), "u.csv:6: column Acc_Y"),
            (xsens(change=("2,17666,", "2,1,")), "u.csv:7: column SampleTimeFine: the time does"),
            (xsens(change=("2,17666,", "2,17666.5,")), "u.csv:7: column SampleTimeFine"),
            (xsens()[:-30], "u.csv:44"),
        ],
    )
    def test_bad_files(self, files, text, what):
        with pytest.raises(DataError, match=what) as error:
            read(files(u=text, x1=xsens()), SENSORS)
        assert "\n" not in str(error.value)


LVM_HEAD = """LabVIEW Measurement\t
Separator\tTab
Decimal_Separator\t.
X_Columns\tOne
***End_of_Header***\t
\t
Channels\t2\t\t
Delta_X\t0.01\t0.01\t
***End_of_Header***\t\t\t
X_Value\tAcceleration (Trigger)\tForce (Trigger)\tComment
"""
AF = (
    Channel("Acceleration", {"x": 1}, Quantity.ACCELERATION, "g", 9.80665),
    Channel("Force", {"f": 1}, Quantity.FORCE),
)


def lvm(rows=100, comment=""):
    t = 0.01 * np.arange(rows)
    cells = [f"{x:.6f}\t{np.cos(2 * np.pi * 3 * x):.6f}\t{np.sin(2 * np.pi * 3 * x):.6f}" for x in t]
    cells[0] += comment
    return LVM_HEAD + "\n".join(cells) + "\n"


class TestLabview:
    @pytest.fixture(params=[False, True], ids=["small", "large"], autouse=True)
    def _size(self, request, monkeypatch):
        """Every file as it is, and as if it were too large to be held."""
        if request.param:
            monkeypatch.setattr("dashpot.data.readers.datafile.LARGE", 1)
            monkeypatch.setattr("dashpot.data.readers.datafile.PIECE", 300)

    @pytest.mark.parametrize("comment", ["", "\t", "\tstarted by hand"])
    def test_told_by_its_first_row_and_driven_as_its_name_says(self, tmp_path, comment):
        path = tmp_path / "3Hz_tmp_001.txt"
        path.write_text(lvm(comment=comment))
        reading = read(path, AF)
        (record,) = reading.records
        assert record.frequency_hz == 3.0
        assert reading.spectrum(harmonics=(), noise="white").amplitudes[0] == pytest.approx(
            [9.80665, -1j], abs=1e-5
        )

    def test_times_that_the_header_says(self, tmp_path):
        """X_Columns No: the first column is empty, decimal commas in the header as in the rows."""
        path = tmp_path / "a.lvm"
        text = re.sub(r"^[0-9.]+\t", "\t", lvm(), flags=re.MULTILINE).replace(
            "X_Columns\tOne", "X_Columns\tNo"
        )
        path.write_text(text.replace("Delta_X", "X0\t0.5\t0.5\t\nDelta_X").replace(".", ","))
        (record,) = read(path, AF).records
        path.write_text(lvm())
        (timed,) = read(path, AF).records
        assert record.time == pytest.approx(0.5 + timed.time, rel=1e-12)
        assert np.array_equal(record.values, timed.values)
        for clocks, what in (
            ("0.01\t0.02", "clocks of their own"),
            ("fast\tfast", "Delta_X is not a number"),
            ("0.0\t0.0", "Delta_X 0, from which no times follow .*; set Delta_X in the header"),
            ("-0.01\t-0.01", "Delta_X -0.01, from which no times follow"),
            ("Inf\tInf", "Delta_X inf, from which no times follow"),
        ):
            path.write_text(text.replace("0.01\t0.01", clocks))
            with pytest.raises(DataError, match=what):
                read(path, AF)
        path.write_text(text.replace("Delta_X", "Step"))
        with pytest.raises(DataError, match=r"column time_s: missing"):
            read(path, AF)
        manifest = tmp_path / "test.toml"
        manifest.write_text('[[files]]\nname = "a.lvm"\nrate_hz = 100\n')
        assert np.array_equal(read(manifest, AF).records[0].values, timed.values)

    def test_units_in_windows_letters(self, tmp_path):
        path = tmp_path / "a.lvm"
        units = "Y_Unit_Label\tm/s²\tN\nDelta_X"
        path.write_bytes(lvm().replace("Delta_X", units).encode("cp1252"))
        (segment,) = read_labview(open_file(path))
        assert segment.units == (None, "m/s²", "N")

    def test_several_segments(self, tmp_path):
        path = tmp_path / "test_3Hz.txt"
        segment = lvm().partition("***End_of_Header***")[2].lstrip("\t\n")
        path.write_text(lvm() + "\n" + segment + "\n" + segment)
        channels = (Channel("Acceleration (Trigger)", {"x": 1}, Quantity.ACCELERATION, "g", 9.80665),)
        reading = read(path, channels)
        assert len(reading.records) == 3
        assert [record.source[-11:] for record in reading.records] == [
            "(segment 1)",
            "(segment 2)",
            "(segment 3)",
        ]
        first, _, third = reading.records
        assert np.array_equal(first.values, third.values)
        last = path.read_text().splitlines()
        last[-1] = last[-1].replace("\t", "\tx", 1)
        path.write_text("\n".join(last) + "\n")
        with pytest.raises(DataError, match=f"segment 3.:{len(last)}: column Acceleration"):
            read(path, channels)

    @pytest.mark.parametrize(
        ("text", "what"),
        [
            (LVM_HEAD, "a header and no rows"),
            (LVM_HEAD[: LVM_HEAD.index("X_Value")], "no header row"),
            (lvm() + LVM_HEAD + "0\t1\t2\n", "the block has one"),
            (lvm().replace("Force (Trigger)\tComment", "X_Value\tForce (Trigger)"), "column of time"),
            (lvm().replace("0.010000\t", "0.010000\tbad", 1), "test_3Hz.txt:12: column Acceleration"),
            (lvm()[:-12], "test_3Hz.txt:110"),
        ],
    )
    def test_bad_files(self, tmp_path, text, what):
        path = tmp_path / "test_3Hz.txt"
        path.write_text(text)
        with pytest.raises(DataError, match=what) as error:
            read(path, AF)
        assert "\n" not in str(error.value)
