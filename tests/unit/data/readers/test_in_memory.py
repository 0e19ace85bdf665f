"""Records from what a program holds: mappings, data frames, datasets, structured arrays."""

import inspect
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import dashpot
from dashpot.channel import Channel
from dashpot.data.readers.in_memory import record, records_of
from dashpot.errors import DataError
from tests.unit.data.readers.written import CHANNELS, long_table, recording

TWO = (Channel("x1", {"x1": 1}, unit="mm", scale=1e-3), Channel("u", {"u": 1}, unit="mm", scale=1e-3))
T = np.arange(64) / 16
X = {"x1": np.sin(T), "u": np.cos(T)}


def check(got, time=T):
    assert got.time == pytest.approx(time)
    assert got.values == pytest.approx(1e-3 * np.stack([X["x1"], X["u"]], axis=-1))
    assert [channel.name for channel in got.channels] == ["x1", "u"]


def test_mappings_and_arrays():
    check(record({"time_s": T, **X}, TWO))
    check(record(X, TWO, time=T))
    check(record(X, TWO, rate_hz=16))
    check(record({"t": 1e3 * T, **X} | {"t [ms]": 1e3 * T}, TWO, time=T))
    table = np.empty(64, dtype=[("time_s", "f8"), ("x1", "f4"), ("u", "f8")])
    table["time_s"], table["x1"], table["u"] = T, X["x1"], X["u"]
    assert record(table, TWO).values == pytest.approx(1e-3 * np.stack(list(X.values()), axis=-1), abs=1e-9)
    assert inspect.unwrap(dashpot.record) is record


def test_pandas():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"time_s": T, **X})
    check(record(frame, TWO))
    check(record(frame.set_index("time_s"), TWO))
    inches = pandas.DataFrame({"time_s": T, "x1": X["x1"]})
    inches.attrs["units"] = {"x1": "in"}
    assert record(inches, (Channel("x1", {"x1": 1}),)).values[:, 0] == pytest.approx(0.0254 * X["x1"])
    moments = pandas.DataFrame(
        {"time": pandas.to_datetime("2025-01-01") + pandas.to_timedelta(T, unit="s"), **X}
    )
    check(record(moments, TWO))


def test_polars():
    polars = pytest.importorskip("polars")
    check(record(polars.DataFrame({"time_s": T, **X}), TWO))


def test_xarray():
    xarray = pytest.importorskip("xarray")
    data = xarray.Dataset({name: ("time", x) for name, x in X.items()}, {"time": T})
    check(record(data, TWO))
    data["x1"].attrs["units"] = "in"
    assert record(data, (Channel("x1", {"x1": 1}),)).values[:, 0] == pytest.approx(0.0254 * X["x1"])
    array = xarray.DataArray(
        np.stack(list(X.values())), dims=("channel", "time"), coords={"channel": list(X), "time": T}
    )
    check(record(array, TWO))


def test_several_records():
    table = long_table(recording(64))
    records = records_of(table, CHANNELS)
    assert [r.frequency_hz for r in records] == [2.0, 4.0, 8.0]
    with pytest.raises(DataError, match="are 3 records"):
        record(table, CHANNELS)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        ({"time_s": T, "x1": X["x1"]}, "column u: missing"),
        ({"time_s": T, "x1": X["x1"], "u": T[:5]}, r"the columns differ"),
        ({"time_s": T, "x1": np.where(T == 1, np.nan, T), "u": T}, "record: sample 17: column x1: nan"),
        ({"time_s": T, "x1": ["a"] * 64, "u": T}, "column x1: holds no numbers"),
        ({"time_s": T, "x1": [[1.0], [1.0, 2.0]], "u": T}, "x1 is not an array"),
        ({"time_s": T, "x1": np.ma.array(T, mask=T > 1), "u": T}, "sample 18: column x1: nan"),
        (X, "the time is missing"),
        ({"time_s": T[::-1], **X}, r"does not increase|one sample"),
        (np.zeros((4, 4)), "ndarray is not a table"),
        ([1, 2], "list is not a table"),
        ({}, "there are no variables"),
    ],
)
def test_what_is_wrong_is_said(data, what):
    with pytest.raises(DataError, match=what) as error:
        record(data, TWO)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("count", [0, 1])
def test_a_table_that_holds_no_samples_is_told(count):
    """They had been told to be rows out of order, or no variables."""
    with pytest.raises(DataError, match=f"column time_s: {count} samples?; give at least two"):
        record({name: x[:count] for name, x in {"time_s": T, **X}.items()}, TWO)


def test_channels_that_are_none_are_told():
    with pytest.raises(DataError, match="no channels are given"):
        record({"time_s": T, **X}, [])
    with pytest.raises(DataError, match="not Channel objects"):
        record({"time_s": T, **X}, ["x1", "u"])


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
@pytest.mark.parametrize("place", ["index", "column"])
def test_moments_of_pandas_are_the_time(zone, place):
    """Also of an index without a name, and with a time zone."""
    pandas = pytest.importorskip("pandas")
    start = pandas.Timestamp("2025-03-30 00:59:59", tz="UTC")  # a second before summer time
    moments = pandas.Series(start + pandas.to_timedelta(T, unit="s")).dt.tz_convert(zone)
    table = pandas.DataFrame(X)
    if place == "index":
        table.index = pandas.DatetimeIndex(moments)
    else:
        table["timestamp"] = moments
    got = record(table, TWO)
    assert got.time - got.time[0] == pytest.approx(T - T[0], abs=1e-9)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"rate_hz": 0.0}, "rate_hz is 0"),
        ({"rate_hz": float("nan")}, "rate_hz is nan"),
        ({"frequency_hz": -1.0, "time": T}, "frequency_hz is -1"),
        ({"rate_hz": 16.0, "time": T}, "there are times"),
        ({"time": T[:-1]}, "differ in length"),
    ],
)
def test_options_that_cannot_be_meant_are_refused(options, what):
    with pytest.raises(DataError, match=what):
        record(X, TWO, **options)


def test_a_column_that_comes_twice_is_named():
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"time_s": T, **X})
    with pytest.raises(DataError, match="column x1: named twice"):
        record(pandas.concat([table, table[["x1"]]], axis=1), TWO)
    with pytest.raises(DataError, match="Series is not a table"):
        record(table["x1"], TWO)


class Benchmark:
    """As nonlinear_benchmarks.Input_output_data: iterable, of a length, without names."""

    def __init__(self, y: np.ndarray, sampling_time: float | None = 0.1) -> None:
        self.u, self.y, self.sampling_time = np.arange(len(y)) % 3.0, y, sampling_time

    def __len__(self) -> int:
        return len(self.y)

    def __iter__(self) -> Iterator[np.ndarray]:
        yield from (self.u, self.y)


def test_data_of_nonlinear_benchmarks_are_a_table(tmp_path: Path) -> None:
    y = np.arange(40.0).reshape(20, 2)
    channels = [Channel("u", {"f": 1}), Channel("y2", {"x": 1})]
    found = record(Benchmark(y), channels)
    np.testing.assert_allclose(found.time, np.arange(20) / 10)
    np.testing.assert_array_equal(found.values, np.column_stack([np.arange(20) % 3, y[:, 1]]))
    one = record(Benchmark(y[:, 0], None), [Channel("y", {"x": 1})], rate_hz=5.0)
    np.testing.assert_allclose(one.time[:2], [0, 0.2])
    with pytest.raises(DataError, match="time is missing"):
        record(Benchmark(y, None), channels)
    (tmp_path / "rig.toml").write_text(
        'coordinates = ["x"]\n[inputs]\nf = { kind = "force", at = "x" }\n[masses]\nm = { at = "x" }\n'
        '[springs]\nk = { between = ["x", "ground"] }\n[channels]\nu = { of = "f" }\ny = { of = "x" }\n'
    )
    with pytest.raises(DataError, match="time is missing"):  # a table, not several data
        dashpot.read_rig(tmp_path / "rig.toml").identify(Benchmark(y[:, 0], None))
