"""A test of many files: manifests and patterns, what they choose and join, and what is wrong with them."""

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.readers import read
from dashpot.data.readers.manifest import files_named, line_numbers
from dashpot.data.record import Record
from dashpot.errors import DataError
from tests.unit.data.readers.written import CHANNELS, NAMES, recording

SENSORS = tuple(Channel(name, {name: 1}, Quantity.ACCELERATION, "m/s²") for name in ("u", "x1"))


def write_dwells(folder, records, names=NAMES, sub="{:g}Hz.csv", time="time_s"):
    for record in records:
        path = folder / sub.format(record.frequency_hz)
        path.parent.mkdir(exist_ok=True)
        rows = [",".join([time, *names])]
        rows += [
            ",".join([repr(t), *(repr(x) for x in row)])
            for t, row in zip(record.time.tolist(), (record.values * 1e3).tolist(), strict=True)
        ]
        path.write_text("\n".join(rows) + "\n")


def manifest(folder, text, name="test.toml"):
    path = folder / name
    path.write_text(text)
    return path


def same(records, expected):
    assert [r.frequency_hz for r in records] == [r.frequency_hz for r in expected]
    for record, wanted in zip(records, expected, strict=True):
        assert record.time == pytest.approx(wanted.time, abs=1e-12)
        assert record.values == pytest.approx(wanted.values, rel=1e-12, abs=1e-15)


def test_a_pattern_of_names(tmp_path):
    write_dwells(tmp_path, recording(64), sub="run/dwell_{:g}Hz_001.csv")
    for pattern in ("run/dwell_{frequency}Hz_*.csv", "**/dwell_{frequency}Hz_00?.csv"):
        same(read(tmp_path / pattern, CHANNELS).records, recording(64))
        path = manifest(tmp_path, f'[[files]]\nname = "{pattern}"\n')
        same(read(path, CHANNELS).records, recording(64))
    path = manifest(
        tmp_path, 'folder = "run"\n[[files]]\nname = "dwell_{frequency}Hz_001.csv"\nband_hz = [3, 5]\n'
    )
    same(read(path, CHANNELS).records, recording(64)[1:2])


def test_columns_units_rate_and_window(tmp_path):
    records = recording(256)
    write_dwells(tmp_path, records, ("A", "B [in]", "C"), time="clock")
    text = """
    [conditioning]
    orders = "1:3:2"
    drift = 0
    [[files]]
    name = "{frequency}Hz.csv"
    columns = { x1 = "A", x2 = "B", u = "C", time_s = "clock" }
    units = { x2 = "mm", time_s = "s" }
    window_s = [0.1, 0.99]
    experiment = 7
    """
    reading = read(manifest(tmp_path, text), CHANNELS)
    assert {record.experiment for record in reading.records} == {7}
    for record, whole in zip(reading.records, records, strict=True):
        inside = (whole.time >= 0.1) & (whole.time <= 0.99)
        assert record.values == pytest.approx(whole.values[inside], rel=1e-12, abs=1e-15)
    assert not reading.notes
    assert reading.conditioning == {"orders": (1, 3), "drift": 0}
    assert reading.spectrum(harmonics="none", noise="white").lines == 6
    assert reading.spectrum(orders=(1,), harmonics="none", noise="white").lines == 3
    rate = manifest(
        tmp_path,
        '[[files]]\nname = "2Hz.csv"\ncolumns = { x1 = "A" }\nrate_hz = 128\nfrequency_hz = 2.0\n'
        '[[files]]\nname = "4Hz.csv"\ncolumns = { x1 = "A" }\nrate_hz = 128\nfrequency_hz = 4.0\n',
    )
    one = read(rate, CHANNELS)
    same(one.records, [Record(CHANNELS[:1], r.time, r.values[:, :1], r.frequency_hz) for r in records[:2]])
    assert [record.experiment for record in one.records] == [0, 1]


def test_a_multisine_is_the_mean_of_its_periods(tmp_path):
    rng = np.random.default_rng(1)
    t = np.arange(6 * 100) / 100
    X = {3: 1 - 2j, 5: 0.5j}
    y = sum(np.real(x * np.exp(2j * np.pi * k * t)) for k, x in X.items()) + 0.01 * rng.normal(size=len(t))
    np.savez(tmp_path / "test.npz", signal=y, dt=0.01)
    path = manifest(
        tmp_path,
        '[[files]]\nname = "test.npz"\ncolumns = { x1 = "signal" }\nfrequency_hz = 1.0\nlines = [3, 5]\n'
        "skip_periods = 1\n",
    )
    reading = read(path, (Channel("x1", {"x1": 1}),))
    assert not reading.records
    lines = reading.spectrum()
    assert lines.noise == ("periods", "periods")
    assert lines.frequency_hz == pytest.approx([3, 5])
    assert np.all(np.abs(lines.amplitudes[:, 0] - list(X.values())) < 5 * lines.sd()[:, 0])


def xsens(first, offset, rows=400, step=8333):
    ticks = [1000 + step * i for i in range(first, first + rows)]
    lines = ["sep=,", "DeviceTag:,Xsens DOT", "", "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z"]
    lines += [f"{i},{tick},{np.sin(2e-6 * np.pi * tick) + offset:.9f},1,9.8" for i, tick in enumerate(ticks)]
    return "\n".join(lines) + "\n"


SENSOR_TEST = """
[[files]]
name = "sine_{frequency}__{sensor}.csv"
[files.sensors]
ground = { u = "Acc_X" }
floor = { x1 = "Acc_X" }
"""


def test_the_name_of_a_sensor_may_stand_in_other_names(tmp_path):
    """A sensor u beside a folder "run", a sensor i in "sine": only where the pattern says {sensor} it is one."""
    folder = tmp_path / "run_u_floor"
    folder.mkdir()
    for sensor in ("u", "i"):
        (folder / f"sine_1.0__{sensor}.csv").write_text(xsens(0, 0.0))
    text = SENSOR_TEST.replace("ground", "u").replace("floor", "i")
    for where in ("", "run_u_floor/"):
        path = folder / "test.toml" if not where else tmp_path / "test.toml"
        path.write_text(text.replace('name = "', f'name = "{where}'))
        (record,) = read(path, SENSORS).records
        assert [channel.name for channel in record.channels] == ["u", "x1"]


def test_units_of_one_sensor_are_not_asked_of_the_others(tmp_path):
    (tmp_path / "sine_1.0__ground.csv").write_text(xsens(0, 0.0).replace("Acc_X,", "Acc_X [mm/s²],"))
    (tmp_path / "sine_1.0__floor.csv").write_text(xsens(0, 0.0))
    text = SENSOR_TEST.replace("[files.sensors]", 'units = { u = "m/s²" }\n[files.sensors]')
    (record,) = read(manifest(tmp_path, text), SENSORS).records
    assert record.values[:, 0] == pytest.approx(record.values[:, 1], abs=1e-12)
    (tmp_path / "sine_1.0__floor.csv").write_text(xsens(0, 0.0).replace("Acc_X", "Acc_Q"))
    with pytest.raises(DataError, match="column Acc_X: missing"):
        read(tmp_path / "test.toml", SENSORS)


def test_sensors_of_other_sample_times_keep_them(tmp_path):
    (tmp_path / "sine_1.0__ground.csv").write_text(xsens(0, 0.0))
    (tmp_path / "sine_1.0__floor.csv").write_text(xsens(0, 1.0, rows=300, step=11111))
    reading = read(manifest(tmp_path, SENSOR_TEST), SENSORS)
    (joint,) = reading.joint
    assert not reading.records
    assert len(joint.parts[0].time) != len(joint.parts[1].time)
    assert [note.code for note in reading.notes] == ["own_times"]
    lines = reading.spectrum(harmonics="none", noise="white")
    assert [channel.name for channel in lines.channels] == ["u", "x1"]
    assert lines.lines == 1
    assert lines.amplitudes[0, 1] == pytest.approx(lines.amplitudes[0, 0], abs=1e-6)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "test.toml: the file is empty"),
        ("[[files]\n", "test.toml:1"),
        ('[[file]]\nname = "a"\n', "test.toml: files: missing"),
        ('[[files]]\nnames = "a"\n', "missing"),
        ('[[files]]\nname = "2Hz.csv"\nrate = 5\n', r"test.toml:3: files\[0\].rate: unknown key"),
        ('[[files]]\nname = "2Hz.csv"\nrate_hz = -5\n', r"test.toml:3: files\[0\].rate_hz: "),
        ('[[files]]\nname = "2Hz.csv"\nclock = "mine"\n', r"test.toml:3: files\[0\].clock"),
        ('[conditioning]\nsettle = "yes"\n[[files]]\nname = "2Hz.csv"\n', "test.toml:2: conditioning.settle"),
        ('[[files]]\nname = "{frequency}kHz.csv"\n', "test.toml:1: no file fits"),
        ('[[files]]\nname = "{frequenz}Hz.csv"\n', "unknown field {frequenz}"),
        ('[[files]]\nname = "2Hz.csv"\nwindow_s = [7, 1]\n', r"window_s: \[7"),
        ('[[files]]\nname = "2Hz.csv"\nband_hz = [nan, 1]\n', r"band_hz: \[nan, 1\]"),
        ('[[files]]\nname = "2Hz.csv"\nexperiment = 99999999999999999999\n', "write a whole"),
        ('[[files]]\nname = "2Hz.csv"\nlines = [1.5]\n', r"files\[0\].lines: \[1.5\]"),
        ("[[files]]\nname = []\n", r"files\[0\].name: \[\] cannot be used"),
        ('[[files]]\nname = "2Hz.csv"\nskip_periods = 1\n', "skip_periods is for multisines"),
        ('[[files]]\nname = "2Hz.csv"\nclock = "own"\n', 'clock = "own" is for the files of several sensors'),
        ('[[files]]\nname = "2Hz.csv"\nalign_s = [0, 1]\n', 'align_s is for sensors .*say clock = "own"'),
        ('[[files]]\nname = "{frequency}Hz.csv"\nfrequency_hz = 4.0\n', "the frequency is stated"),
        ('[[files]]\nname = "2Hz.csv"\ncolumns = { x1 = "u", u = "u" }\n', "x1 and u"),
        ('[[files]]\nname = "2Hz.csv"\nunits = { u = "wat" }\n', "units: wat of u"),
        ('[[files]]\nname = "2Hz.csv"\npart = "x"\n', "there is no part"),
        ('[conditioning]\ndrift = -1\n[[files]]\nname = "2Hz.csv"\n', "drift: -1"),
        ('[conditioning]\nsettle = "2 m"\n[[files]]\nname = "2Hz.csv"\n', 'settle: "2 m"'),
        ('[[files]]\nname = "{frequency}_{frequency}"\n', "a field occurs twice"),
        ('[[files]]\nname = "no.csv"\n', "no.csv: there is no such"),
        ('[[files]]\nname = "{frequency}Hz.csv"\nband_hz = [20, 30]\n', "no file of these"),
        ('[[files]]\nname = "2Hz.csv"\ncolumns = { x9 = "x1" }\n', "x9 is not a channel"),
        ('[[files]]\nname = "2Hz.csv"\ncolumns = { x1 = "x9" }\n', "2Hz.csv:1: column x9: missing"),
        ('[[files]]\nname = "2Hz.csv"\nunits = { x1 = "N" }\n', "N is not a unit"),
        ('[[files]]\nname = "2Hz.csv"\nlines = "1:x"\n', "1:x are not multiples"),
        ('[[files]]\nname = "2Hz.csv"\nlines = [1]\nfrequency_hz = 0.3\n', "not a whole"),
        ('[[files]]\nname = "2Hz.csv"\nwindow_s = [90, 91]\n', "fewer than two samples are left"),
        ('[[files]]\nname = "2Hz.csv"\npart = "sheet 4"\n', "there is no part"),
        ('[[files]]\nname = "{sensor}Hz.csv"\n[files.sensors]\na = {}\n', "no file of these"),
        ('[[files]]\nname = "{sensor}Hz.csv"\n[files.sensors]\na = {}\n2 = {}\n', "no file of sensor"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, text, what):
    write_dwells(tmp_path, recording(64))
    with pytest.raises(DataError, match=what) as error:
        read(manifest(tmp_path, text), CHANNELS)
    assert all("\n" not in str(problem) for problem in error.value.problems)


def test_an_experiment_in_a_name_is_of_a_size_that_can_be_held(tmp_path):
    (tmp_path / "run99999999999999999999.csv").write_text("time_s,x1\n0,1\n1,2\n")
    with pytest.raises(DataError, match="the experiment 99999999999999999999"):
        read(tmp_path / "run{experiment}.csv", CHANNELS)


def test_a_time_to_settle_is_written_as_on_the_command_line(tmp_path):
    write_dwells(tmp_path, recording(64))
    text = '[conditioning]\nsettle = "500 ms"\n[[files]]\nname = "{frequency}Hz.csv"\n'
    assert read(manifest(tmp_path, text), CHANNELS).conditioning == {"settle": 0.5}


def test_the_files_that_a_manifest_stands_for(tmp_path):
    write_dwells(tmp_path, recording(64))
    path = manifest(tmp_path, '[[files]]\nname = "{frequency}Hz.csv"\n')
    wanted = [tmp_path / f"{record.frequency_hz:g}Hz.csv" for record in recording(64)]
    assert files_named(path) == files_named(tmp_path / "{frequency}Hz.csv") == wanted
    assert files_named(wanted[0]) == wanted[:1]


def test_multiples():
    assert line_numbers("11:14", "x") == (11, 12, 13, 14)
    assert line_numbers("1:9:4", "x") == (1, 5, 9)
    assert line_numbers("7,3", "x") == (3, 7)
    for wrong in ("", "0:3", "3:1", "1:9:0", "1:2:3:4", "1:10000000000", []):
        with pytest.raises(DataError, match="are not multiples"):
            line_numbers(wrong, "x")


@pytest.mark.parametrize(
    "name", ["../secret.csv", "run/../../secret.csv", "../*.csv", "{frequency}Hz/../../*"]
)
def test_names_do_not_lead_out_of_the_folder(tmp_path, name):
    (tmp_path / "data" / "2Hz").mkdir(parents=True)
    (tmp_path / "secret.csv").write_text("time_s,x1\n")
    absolute = (tmp_path / "secret.csv").as_posix()
    for each in (name, absolute, absolute.replace("secret", "*")):
        with pytest.raises(DataError, match="out of the folder"):
            files_named(manifest(tmp_path / "data", f'[[files]]\nname = "{each}"\n'))


def test_links_do_not_lead_out_of_the_folder(tmp_path):
    inside, outside = tmp_path / "data", tmp_path / "elsewhere"
    inside.mkdir()
    write_dwells(outside.parent, recording(64)[:1], sub="elsewhere/{:g}Hz.csv")
    (inside / "2Hz.csv").symlink_to(outside / "2Hz.csv")
    (inside / "run").symlink_to(outside)
    for name in ("2Hz.csv", "{frequency}Hz.csv", "run/2Hz.csv", "*/2Hz.csv"):
        with pytest.raises(DataError, match=r"2Hz.csv is a link"):
            files_named(manifest(inside, f'[[files]]\nname = "{name}"\n'))
    for name in ("run/*.csv", "run/**/*.csv", "*/*.csv"):  # nor is what is there looked at
        with pytest.raises(DataError, match=r"run/? is a link"):
            files_named(manifest(inside, f'[[files]]\nname = "{name}"\n'))
    chosen = manifest(inside, 'folder = "../elsewhere"\n[[files]]\nname = "*.csv"\n')
    assert [path.name for path in files_named(chosen)] == ["2Hz.csv"]
    (outside / "again.csv").symlink_to("2Hz.csv")
    assert [path.name for path in files_named(chosen)] == ["2Hz.csv", "again.csv"]


def test_a_search_has_an_end(tmp_path, monkeypatch):
    with pytest.raises(DataError, match="file system"):
        files_named(manifest(tmp_path, 'folder = "/"\n[[files]]\nname = "**/*.csv"\n'))
    (tmp_path / "a" / "b" / "c").mkdir(parents=True)
    for name in ("a/1.csv", "a/b/2.csv", "a/b/c/3.csv", "a/.hidden.csv"):
        (tmp_path / name).write_text("x")
    (tmp_path / "a" / "b" / "up").symlink_to(tmp_path)
    path = manifest(tmp_path, '[[files]]\nname = "**/*.csv"\n')
    assert [each.name for each in files_named(path)] == ["1.csv", "2.csv", "3.csv"]
    for name, limit in (("MOST_ENTRIES", 5), ("DEEPEST", 2), ("LONGEST_SEARCH", -1.0)):
        with monkeypatch.context() as limited:
            limited.setattr(f"dashpot.data.readers.manifest.{name}", limit)
            with pytest.raises(DataError, match="closely"):
                files_named(path)
