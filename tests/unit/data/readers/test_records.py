"""Stepped-sine CSV and tables of amplitudes: what is read, and what is refused with its place."""

import csv
import gzip
import os

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.readers import read, write_amplitudes, write_records
from dashpot.data.readers.text import name_in, write_rows
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DataError

X1, U = Channel("x1", {"x1": 1}, unit="mm", scale=1e-3), Channel("u", {"u": 1})
CHANNELS = (X1, U)


def dwell(f, seed=0, samples=60, experiment=0, channels=CHANNELS):
    rng = np.random.default_rng(seed)
    t = np.arange(samples) / 40
    y = np.cos(2 * np.pi * f * t)[:, None] + 0.1 * rng.normal(size=(samples, len(channels)))
    return Record(channels, t, y, f, experiment)


@pytest.fixture
def put(tmp_path):
    def write(content, name="test.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def refusal(path, channels=CHANNELS, **options):
    """The one line that refuses a file, without the folder."""
    with pytest.raises(DataError) as caught:
        read(path, channels, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 1000
    assert caught.value.problems[0].cure
    return message.replace(f"{os.path.dirname(path)}/", "")


# ------------------------------------------------------------------------------------------------ records


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz"])
def test_records_read_back(tmp_path, name):
    records = [dwell(1.0), dwell(2.0, 1), dwell(2.0, 2), dwell(2.0, 3, experiment=4)]
    write_records(records, tmp_path / name)
    reading = read(tmp_path / name, CHANNELS)
    assert reading.notes == ()
    assert reading.amplitudes is None
    for given, found in zip(records, reading.records, strict=True):
        np.testing.assert_array_equal(found.time, given.time)
        np.testing.assert_allclose(found.values, given.values, rtol=4e-16)
        assert (found.frequency_hz, found.experiment) == (given.frequency_hz, given.experiment)
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_units_become_si_and_columns_come_in_any_order(put):
    path = put("u,junk,time_s,x1,frequency_hz\n1,a,0,2,5\n3,b,0.1,4,5\n")
    reading = read(path, CHANNELS)
    np.testing.assert_allclose(reading.records[0].values, [[2e-3, 1], [4e-3, 3]])
    assert reading.records[0].channels == CHANNELS
    assert len(reading.notes) == 1
    assert reading.notes[0].text.endswith("not read, because the rig file does not list them: junk")


@pytest.mark.parametrize(
    "name", ["Frequency_Hz", "FREQ_HZ", "f_Hz", "Freq", "frequency (Hz)", "drive freq [Hz]"]
)
def test_usual_names_of_the_drive_frequency(put, name):
    reading = read(put(f"{name},time_s,x1,u\n2,0,1,2\n2,0.1,3,4\n3,0,1,2\n3,0.1,3,4\n"), CHANNELS)
    assert [record.frequency_hz for record in reading.records] == [2, 3]
    kilo = read(put("f_kHz,time_s,x1,u\n2,0,1,2\n2,0.1,3,4\n"), CHANNELS)
    assert kilo.records[0].frequency_hz == 2000


def test_records_that_may_be_dwells_are_said_to_be(put):
    rows = "2,0,1,2\n2,0.1,3,4\n3,0,1,2\n3,0.1,3,4\n"
    for name in ("f", "F_N", "speed"):  # a force may be called f
        (note,) = read(put(f"{name},time_s,x1,u\n{rows}"), CHANNELS).notes
        assert "frequency_hz" in note.text


def test_a_file_without_frequency_is_one_record(put):
    path = put("time_s,x1,u\n0,1,2\n0.1,3,4\n0.25,3,4\n")
    assert read(path, CHANNELS).records[0].frequency_hz is None
    assert read(path, CHANNELS, frequency_hz=3.0).records[0].frequency_hz == 3.0
    with pytest.raises(DataError, match="a record of 3 samples"):
        read(path, CHANNELS).spectrum()
    named = put(path.read_bytes(), "sweep_12.5Hz_b.csv")
    reading = read(named, CHANNELS)
    assert reading.records[0].frequency_hz == 12.5
    assert "12.5 Hz" in reading.notes[0].text


def test_several_files_are_experiments_of_their_own(put):
    a = put("time_s,x1,u\n0,1,2\n0.1,3,4\n", "a.csv")
    reading = read([a, a], CHANNELS, frequency_hz=1)
    assert [record.experiment for record in reading.records] == [0, 1]


@pytest.mark.parametrize(
    ("content", "step_s", "codes"),
    [
        ("0.00,1,2\n0.01,3,4\n0.02,5,6\n", 0.01, ["no_header"]),
        ("# taken by hand\n0;1,5;2\n500;3;4\n1000;5;6\n", 500e-6, ["no_header", "time_unit_guessed"]),
        ("Rig 3, bay 2\nRun of May\n\n0\t1\t2\n1\t3\t4\n2\t5\t6\n", 1e-3, ["no_header", "time_unit_guessed"]),
        ("t,,acc\n0,1,2\n2000000,3,4\n4000000,5,6\n", 2e-3, ["time_unit_guessed"]),
        ("t [us],,acc\n0,1,2\n200,3,4\n400,5,6\n", 200e-6, []),
        ("time_s,,acc\n0,1,2\n200,3,4\n400,5,6\n", 200.0, []),
    ],
)
def test_columns_without_names_and_times_without_a_unit(put, content, step_s, codes):
    """Columns are called by their numbers, and stamps in whole numbers are those of a counting clock."""
    reading = read(put(content), [Channel("column2", {"x": 1.0})])
    (record,) = reading.records
    np.testing.assert_allclose(np.diff(record.time), step_s)
    assert [note.code for note in reading.notes if note.code != "columns_not_read"] == codes
    assert record.values[1:].ravel().tolist() == [3.0, 5.0]


HEAD = "frequency_hz,time_s,x1,u\n"
ROWS = "1,0.0,1.5,2\n1,0.1,1.5,2\n1,0.2,1.5,2\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "test.csv: the file is empty"),
        ("\n \n", "test.csv: the file is empty"),
        ("# only\n# comments\n", "test.csv: the file has no header"),
        (HEAD, "test.csv:1: the file has a header"),
        (HEAD + "\n\n", "test.csv:1: the file has a header"),
        (ROWS, "test.csv:1: column time_s: missing"),
        (HEAD + ROWS + "1,0.3,nan,2\n", 'test.csv:5: column x1: "nan"'),
        (HEAD + ROWS + "1,0.3,1,-inf\n", 'test.csv:5: column u: "-inf"'),
        (HEAD + ROWS + "1,0.3,1,1e999\n", 'test.csv:5: column u: "1e999"'),
        (HEAD + ROWS + "1,0.3,1,1e200\n", 'test.csv:5: column u: "1e200"'),
        (HEAD + ROWS + "1,0.3,,2\n", "test.csv:5: column x1: the cell is empty"),
        (HEAD + ROWS + "1,0.3,abc,2\n", 'test.csv:5: column x1: "abc"'),
        ("# a\n\n" + HEAD + "\n" + ROWS + "\n1,0.3,abc,2\n", 'test.csv:9: column x1: "abc"'),
        (HEAD + ROWS + "1,0.3,1\n", "test.csv:5: the row has 3"),
        (HEAD + ROWS + "1,0.3", "test.csv:5: the row has 2"),
        (HEAD + "1,0,1,5,2\n", "decimal commas need"),
        (HEAD + "0,0.0,1,2\n0,0.1,1,2\n", "test.csv:2: column frequency_hz: frequency 0 Hz"),
        (HEAD + ROWS + "\n-3,0.0,1,2\n", "test.csv:6: column frequency_hz: frequency -3"),
        (HEAD + ROWS + "1,0.2,1,2\n", "test.csv:5: column time_s: the time does not increase"),
        (HEAD + ROWS + "1,0.15,1,2\n", "test.csv:5: column time_s: the time does not increase"),
        (HEAD + ROWS + "2,0.15,1,2\n", "test.csv:5: column time_s: the block has one"),
        (HEAD.replace("x1", "X1") + ROWS, "column x1: missing (the rig file lists it as a channel)"),
        (HEAD.replace("time_s", "times") + ROWS, "test.csv:1: column time_s: missing"),
        (HEAD.replace(",u", ",x1") + ROWS, "test.csv:1: column x1: named twice, in columns"),
        (HEAD.replace("x1", "x1 [m]") + ROWS, "column x1: in m, the rig"),
        (HEAD.replace("x1", "x1 [N]") + ROWS, "column x1: N is not a unit"),
        ((HEAD + ROWS).replace("x1", "\x81").encode("latin1"), "test.csv:1: byte 21"),
        ((HEAD + ROWS).encode("utf-16")[:-1], "test.csv: the file is damaged"),
        (b"PK\x03\x04\x00\x00\x00", "test.csv: this is an archive"),
        (b"%PDF-1.7\n\x00", "test.csv: this is a PDF"),
        (b"\x00\x01\x02\x03", "test.csv: the file is not text"),
        (gzip.compress((HEAD + ROWS).encode(), mtime=0)[:-12], "test.csv: the packed file"),
        (HEAD.replace(",u", ",u,experiment") + "1,0,1,2,0.5\n1,1,1,2,0.5\n", "column experiment: 0.5"),
        (HEAD + ROWS + '1,0.3,"1,2\n', "test.csv:5: "),
    ],
)
def test_bad_files_are_refused_with_their_place(put, content, message):
    assert message in refusal(put(content))


@pytest.mark.parametrize(
    ("last", "cut"), [("-1.50000e-03", c) for c in ("-1.50000e-0", "-1.5", "-1.50000e", "-")]
)
def test_a_number_that_was_cut_off_is_refused(put, last, cut):
    whole = "time_s,u,x1\n" + "".join(f"{i},0,{last}\n" for i in range(9))
    assert len(read(put(whole), CHANNELS).records[0].time) == 9
    assert refusal(put(whole[: -len(last) - 1] + cut)).startswith("test.csv:10: ")
    reading = read(put(whole[:-1]), CHANNELS)
    assert "no line end" in reading.notes[0].text


def test_writing_refuses_what_would_not_read_back(tmp_path):
    late = dwell(1.0)
    late = Record(CHANNELS, late.time + 2, late.values, 1.0)
    for records in ([], [dwell(1.0), late], [dwell(1.0), Record((X1,), late.time, late.values[:, :1], 1.0)]):
        with pytest.raises(DataError):
            write_records(records, tmp_path / "a.csv")
    with pytest.raises(DataError, match="cannot be written"):
        write_records([dwell(1.0)], tmp_path / "none" / "a.csv")
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------------------------------------ amplitudes


def same(a, b):
    assert a.channels == b.channels
    assert (a.noise, a.samples.tolist(), a.experiment.tolist()) == (
        b.noise,
        b.samples.tolist(),
        b.experiment.tolist(),
    )
    np.testing.assert_array_equal(a.frequency_hz, b.frequency_hz)
    np.testing.assert_array_equal(a.dof, b.dof)
    np.testing.assert_allclose(a.amplitudes, b.amplitudes, rtol=1e-15)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-14, atol=1e-300)


@pytest.mark.parametrize("name", ["s.csv", "s.csv.gz"])
def test_amplitudes_read_back(tmp_path, name):
    channels = (
        Channel("x1", {"x1": 1}, unit="mm", scale=1e-3, gain=2.5, sign=-1, delay=1e-3),
        Channel("a", {"x1": 1}, Quantity.ACCELERATION, gain=None),
        U,
    )
    lines = spectrum([dwell(f, i, channels=channels, experiment=i) for i, f in enumerate((1.1, 2.3, 3.7))])
    write_amplitudes(lines, tmp_path / name)
    reading = read(tmp_path / name, channels)
    assert reading.notes == ()
    assert reading.records == ()
    same(lines, reading.spectrum())
    with pytest.raises(DataError, match="no samples"):
        reading.spectrum(moments=True)


@pytest.mark.parametrize("name", ['"', "=1+2", "+x", "-x", "@x", "'=x", "x'", "'x"])
def test_names_read_back_and_are_no_formulas(tmp_path, name):
    channels = (Channel(name, {"x1": 1}), U)
    lines = spectrum([dwell(f, i, channels=channels) for i, f in enumerate((1.1, 2.3, 3.7))])
    write_amplitudes(lines, tmp_path / "s.csv")
    same(lines, read(tmp_path / "s.csv", channels).spectrum())
    with open(tmp_path / "s.csv", newline="") as file:
        assert next(csv.reader(file))[1].lstrip()[0] not in "=+-@"
    write_rows(tmp_path / "p.csv", ["name", "value"], [[name, "\tx", "\rx", "-1.5e-3"], np.ones(4)])
    with open(tmp_path / "p.csv", newline="") as file:
        cells = [row[0] for row in csv.reader(file)][1:]
    assert [name_in(cell) for cell in cells] == [name, "\tx", "\rx", "-1.5e-3"]
    assert all(cell[0] not in "=+-@\t\r" for cell in cells[:3])


def test_unknown_noise_exact_noise_and_missing_channels_read_back(tmp_path):
    X = np.array([[1 + 2j, 3], [4, 5j], [np.nan, 6]])
    V = np.zeros((3, 2, 2), dtype=complex)
    V[1, 0, 0] = 2.0
    for noise, covariance in (
        (("given",) * 3, V),
        (("unknown",) * 3, np.full_like(V, np.nan)),
        (("given", "given", "unknown"), np.where(np.arange(3)[:, None, None] == 2, np.nan, V)),
    ):
        lines = Spectrum(CHANNELS, [1, 2, 2], X, covariance, [1, 2, 3], [np.inf, 5, 7], noise, [0, 0, 1])
        write_amplitudes(lines, tmp_path / "s.csv")
        same(lines, read(tmp_path / "s.csv", CHANNELS).spectrum())
    batch = Spectrum(CHANNELS, [1, 2, 2], X[None], V, [1, 2, 3], [1, 5, 7], noise, [0, 0, 1])
    with pytest.raises(DataError, match="repeats"):
        write_amplitudes(batch, tmp_path / "s.csv")


TABLE = "frequency_hz,experiment,x1_re,x1_im,x1_sd,u_re,u_im\n1,0,1,1,1,1,0\n2,0,1,1,1,1,0\n3,1,1,1,1,1,0\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("x1_im", "x1_i", "test.csv:1: column x1_im: missing (the rig file lists the channel)"),
        ("2,0,1,1,1", "2,0,,1,1", "test.csv:3: column x1_re: the cell is empty"),
        ("2,0,1,1,1", "2,0,,,", "test.csv:3: column x1_re: the cell is empty"),
        ("2,0,1,1,1", "2,0,1,,1", "test.csv:3: column x1_im: the cell is empty"),
        ("2,0,1,1,1", "2,0,1,1,", "test.csv:3: column x1_sd: the cell is empty"),
        ("2,0,1,1,1", "2,0,1,1,-1", "test.csv:3: column x1_sd: a standard deviation"),
        ("2,0,1,1,1", "2,0,1,nan,1", 'test.csv:3: column x1_im: "nan"'),
        ("2,0,1,1,1", "-2,0,1,1,1", "test.csv:3: column frequency_hz: frequency -2"),
        ("2,0,1,1,1", "2,0.5,1,1,1", "test.csv:3: column experiment: 0.5"),
        ("u_im", "x1_im", "test.csv:1: column x1_im: named twice"),
        ("u_re", "u_re [N]", "column u: N is not a unit"),
        ("frequency_hz", "line", "test.csv:1: column frequency_hz: missing"),
    ],
)
def test_bad_tables_are_refused_with_their_place(put, old, new, message):
    assert message in refusal(put(TABLE.replace(old, new, 1)))


def test_a_channel_may_be_left_out_of_an_experiment(put):
    lines = read(put(TABLE.replace("3,1,1,1,1", "3,1,,,")), CHANNELS).spectrum()
    assert np.isnan(lines.amplitudes[2, 0])
    assert np.all(np.isfinite(lines.amplitudes[:2]))


def test_impossible_covariances_are_refused(put):
    header = "frequency_hz,x1_re,x1_im,x1_sd,u_re,u_im,u_sd,x1&u_cov_re,x1&u_cov_im\n"
    assert (
        np.linalg.eigvalsh(read(put(header + "1,1,1,1,1,0,1,1.9,0\n"), CHANNELS).spectrum().covariance[0])[0]
        > 0
    )
    assert "larger than the sd" in refusal(put(header + "1,1,1,1,1,0,1,2.1,0\n"))


# ------------------------------------------------------------------------------------------------ damage


def test_json_is_no_recording(tmp_path):
    (tmp_path / "estimate.json").write_text('{\n "model": "a"\n}\n')
    with pytest.raises(DataError, match=r"estimate.json: this is JSON"):
        read(tmp_path / "estimate.json", CHANNELS)
