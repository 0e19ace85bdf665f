"""Data that a program holds already: data frames of pandas and polars, datasets of xarray, arrays of NumPy.

Names are those of columns or variables.  Units are in brackets behind names, in `attrs["units"]` of a pandas data frame
({name: unit}), or in `attrs["units"]` of a variable of xarray.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from dashpot.channel import Channel, Experiment
from dashpot.data.readers.arrays import ArrayColumns, parts_of_variables
from dashpot.data.readers.columns import TIME, TIME_NAMES, bare, time_column
from dashpot.data.readers.interpretation import Experiments, Interpreted
from dashpot.data.readers.records import Circumstances, read_records
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.io.words import counted, listed, shown


class HasChannels(Protocol):
    """A rig."""

    @property
    def channels(self) -> Sequence[Channel]:
        """What its columns are."""

    @property
    def experiments(self) -> Sequence[Experiment]:
        """Those in which its channels may be otherwise."""


def record(
    data: Any,
    channels: Sequence[Channel] | HasChannels,
    *,
    time: Any = None,
    rate_hz: float | None = None,
    frequency_hz: float | None = None,
    experiment: int | str = 0,
    source: str = "record",
) -> Record:
    """One record, with the channels named in `data`.

    data      a mapping of names to arrays (samples,), a pandas or polars data frame, an xarray Dataset, a structured
              NumPy array, or an Input_output_data of the package nonlinear_benchmarks (columns u and y); numbers in
              the units of the channels
    channels  of a rig, or the rig
    experiment  a number, or the name of one of the rig's experiments
    time      (samples,), s; by default the column, index or coordinate `time_s` (or one with a common name for time),
              or else from `rate_hz`, Hz

    Raises DataError if there are no channels, a channel or the time is missing or given twice, a value is masked or
    not finite, there are fewer than two samples, or there are several records.
    """
    records = records_of(
        data,
        channels,
        time=time,
        rate_hz=rate_hz,
        frequency_hz=frequency_hz,
        experiment=experiment,
        source=source,
    )
    if len(records) > 1:
        raise DataError(
            f"the data are {len(records)} records: the time starts again, or the frequency changes",
            source,
            "separate them, or use records_of",
        )
    return records[0]


def records_of(
    data: Any,
    channels: Sequence[Channel] | HasChannels,
    *,
    time: Any = None,
    rate_hz: float | None = None,
    frequency_hz: float | None = None,
    experiment: int | str = 0,
    source: str = "record",
) -> tuple[Record, ...]:
    """All records in `data`: one per block of equal `frequency_hz`, if that is a column; arguments as for `record`.

    Raises DataError as `record`.
    """
    named = channels.channels if hasattr(channels, "channels") else channels
    if not named or not all(isinstance(channel, Channel) for channel in named):
        cure = 'give a rig, or Channels such as Channel("x1", {"x1": 1})'
        what = "the channels are not Channel objects" if named else "no channels are given"
        raise DataError(what, source, cure)
    for what, number in (("frequency_hz", frequency_hz), ("rate_hz", rate_hz)):
        if number is not None and not 0 < number < 1e12:
            raise DataError(f"{what} is {number:g}", source, "give a positive number")
    values, units = _variables(data, source)
    variables = {name: _array(name, value, source) for name, value in values.items()}
    if time is not None:
        variables[TIME] = _array("time", time, source)
    lengths, wanted = {}, {TIME, *(channel.name for channel in named)}
    for name, array in variables.items():
        if bare(name)[0] not in wanted:
            continue
        if array.dtype.kind not in "fiubcmM":
            cure = f"convert it to numbers, not {array.dtype}"
            raise DataError(f"column {shown(name)}: holds no numbers", source, cure)
        if array.ndim and array.size < 2:
            what = f"column {shown(name)}: {counted(array.size, 'sample')}"
            raise DataError(what, source, "give at least two")
        if array.size > 1 and array.size == max(array.shape):
            lengths[name] = array.size
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{shown(name)}: {length}" for name, length in lengths.items())
        raise DataError(f"the columns differ in length ({told})", source, "give one number for each sample")
    parts = [
        part
        for part in parts_of_variables(source, variables, units)
        if all(part.find(channel.name) is not None for channel in named)
    ]
    part: ArrayColumns = parts[0] if parts else next(parts_of_variables(source, variables, units))
    if time is None and rate_hz is None and time_column(part, named, may_lack=True) is None:
        what = f"the time is missing; the columns are {listed(values)}"
        raise DataError(what, source, "add a column time_s, or give time (s) or rate_hz")
    if rate_hz is not None and time_column(part, named, may_lack=True) is not None:
        raise DataError("there are times as well as rate_hz", source, "leave one of them out")
    by = Experiments(tuple(named), tuple(getattr(channels, "experiments", ())))
    kind = by.number(experiment, source) if isinstance(experiment, str) else 0
    run = 0 if isinstance(experiment, str) else experiment
    circumstances = Circumstances(frequency_hz, run, rate_hz, by.names)
    content = by.content(
        lambda columns: Interpreted(tuple(read_records(part, columns, circumstances)[0])), kind
    )
    return content.records


def columns_in_memory(data: Any, source: str) -> ArrayColumns:
    """All columns of a data frame, a mapping, a Dataset or a structured array.  Raises DataError if it is none."""
    values, units = _variables(data, source)
    variables = {name: _array(name, value, source) for name, value in values.items()}
    return next(parts_of_variables(source, variables, units))


def _array(name: str, values: Any, source: str) -> Any:
    """An array; what is masked is a gap.  Raises DataError for what is none."""
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiub":
        return np.ma.filled(values.astype(float), np.nan)
    try:
        return np.asarray(values)
    except ValueError:
        raise DataError(f"{shown(name)} is not an array", source, "give one number for each sample") from None


def _variables(data: Any, source: str) -> tuple[dict[str, Any], dict[str, str | None]]:
    """Arrays and units by name."""
    module = type(data).__module__.partition(".")[0]
    frame = type(data).__name__ == "DataFrame"
    if module == "xarray":
        # Variables and coordinates of a Dataset; of a DataArray those along its other dimension
        if not hasattr(data, "data_vars"):
            others = [dim for dim in data.dims if dim not in ("time", TIME)]
            if len(others) > 1 or (not others and data.name is None):
                raise DataError("the array has no names for its columns", source, "give a Dataset")
            data = data.to_dataset(dim=others[0]) if others else data.to_dataset()
        variables = {
            str(name): np.asarray(item.values) for name, item in {**data.coords, **data.data_vars}.items()
        }
        units = {
            str(name): item.attrs.get("units") for name, item in {**data.coords, **data.data_vars}.items()
        }
        return variables, units
    if module == "pandas" and frame:
        # An index that has a name or holds moments is a column, too, moments the time
        columns = data.columns[data.columns.duplicated()]
        if len(columns):
            raise DataError(f"column {shown(str(columns[0]))}: named twice", source, "rename one of them")
        variables = {str(name): _naive(data[name]) for name in data.columns}
        index = data.index
        moments = type(index).__name__ in ("DatetimeIndex", "TimedeltaIndex")
        timed = any(bare(name)[0].lower() in TIME_NAMES for name in variables)
        name = TIME if moments and not timed else index.name
        if name is not None and str(name) not in variables:
            variables[str(name)] = _naive(index.to_series())
        return variables, dict(getattr(data, "attrs", {}).get("units") or {})
    if module == "polars" and frame:
        return {name: data[name].to_numpy() for name in data.columns}, {}
    if all(hasattr(data, name) for name in ("u", "y", "sampling_time")):
        # Input_output_data of the package nonlinear_benchmarks
        step = data.sampling_time
        variables = {} if step is None else {TIME: np.arange(len(data.y)) * float(step)}
        for name in ("u", "y"):
            signals = np.asarray(getattr(data, name)).reshape(len(data.y), -1).T
            variables |= {f"{name}{i}" if len(signals) > 1 else name: y for i, y in enumerate(signals, 1)}
        return variables, {}
    if isinstance(data, Mapping):
        return {str(name): values for name, values in data.items()}, {}
    if isinstance(data, np.ndarray) and data.dtype.names:
        return {name: data[name] for name in data.dtype.names}, {}
    raise DataError(
        f"{type(data).__name__} is not a table with names",
        source,
        "give a mapping of names to arrays, a data frame, an xarray Dataset or a structured array",
    )


def _naive(series: Any) -> Any:
    """Its values; moments with a time zone in universal time."""
    zoned = getattr(series.dtype, "tz", None) is not None
    return (series.dt.tz_convert("UTC").dt.tz_localize(None) if zoned else series).to_numpy()
