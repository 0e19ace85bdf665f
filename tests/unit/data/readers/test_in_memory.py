"""Records from what a program holds: mappings, data frames, datasets, structured arrays."""

import numpy as np
import pytest

import dashpot
from dashpot.channel import Channel
from dashpot.data.readers.in_memory import record, records_of
from dashpot.errors import DataError
from tests.unit.data.readers.written import CHANNELS, NAMES, long_table, recording

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
    assert dashpot.record is record


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
        ({"time_s": T, "x1": X["x1"], "u": T[:5]}, "column u: missing"),
        (
            {"time_s": T, "x1": np.where(T == 1, np.nan, T), "u": T},
            "record: sample 17: column x1: nan is not a finite",
        ),
        ({"time_s": T, "x1": ["a"] * 64, "u": T}, "column x1: missing"),
        (X, "column time_s: missing"),
        ({"time_s": T[::-1], **X}, r"does not increase|one sample"),
        (np.zeros((4, 4)), "ndarray is not a table with names"),
        ([1, 2], "list is not a table with names"),
        ({}, "there are no variables"),
    ],
)
def test_what_is_wrong_is_said(data, what):
    with pytest.raises(DataError, match=what) as error:
        record(data, TWO)
    assert "\n" not in str(error.value)


def test_a_rig_stands_for_its_channels():
    class Rig:
        channels = TWO

    check(record({"time_s": T, **X}, Rig()))
    assert NAMES == ("x1", "x2", "u")
