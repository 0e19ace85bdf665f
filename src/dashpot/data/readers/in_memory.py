"""Data that a program holds already: data frames of pandas and polars, datasets of xarray, arrays of NumPy.

Names are those of columns or variables.  Units are in brackets behind names, in `attrs["units"]` of a pandas data frame
({name: unit}), or in `attrs["units"]` of a variable of xarray.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from dashpot.channel import Channel
from dashpot.data.readers.array_columns import ArrayColumns
from dashpot.data.readers.delimited.stepped_sine import Circumstances, read_records
from dashpot.data.readers.sampling import TIME
from dashpot.data.readers.variables import parts_of_variables
from dashpot.data.record import Record
from dashpot.errors import DataError


class HasChannels(Protocol):
    """A rig."""

    @property
    def channels(self) -> Sequence[Channel]:
        """What its columns are."""


def record(
    data: Any,
    channels: Sequence[Channel] | HasChannels,
    *,
    time: Any = None,
    rate_hz: float | None = None,
    frequency_hz: float | None = None,
    experiment: int = 0,
    source: str = "record",
) -> Record:
    """One record of the channels that are named in `data`.

    data      a mapping of names to arrays (samples,), a pandas or polars data frame, an xarray Dataset, or a
              structured NumPy array; numbers in the units of the channels
    channels  of a rig, or the rig
    time      (samples,), s; else the column `time_s` (or an index or coordinate of that or a usual name), else
              `rate_hz` in Hz

    Raises DataError where a channel or the time is missing, something is not a finite number, or there are several
    records.
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
    experiment: int = 0,
    source: str = "record",
) -> tuple[Record, ...]:
    """All records in `data`, with a column `frequency_hz` one for each of its blocks; arguments as of `record`.

    Raises DataError as `record`.
    """
    named = channels.channels if hasattr(channels, "channels") else channels
    variables, units = _variables(data, source)
    if time is not None:
        variables[TIME] = np.asarray(time)
    parts = [
        part
        for part in parts_of_variables(source, variables, units)
        if all(part.find(channel.name) is not None for channel in named)
    ]
    part: ArrayColumns = parts[0] if parts else next(parts_of_variables(source, variables, units))
    circumstances = Circumstances(frequency_hz, experiment, rate_hz)
    return tuple(read_records(part, named, circumstances)[0])


def _variables(data: Any, source: str) -> tuple[dict[str, Any], dict[str, str | None]]:
    """Arrays and units by name."""
    module = type(data).__module__.partition(".")[0]
    if module == "xarray":
        return _of_xarray(data, source)
    if module == "pandas":
        units = dict(getattr(data, "attrs", {}).get("units") or {})
        variables = {str(name): data[name].to_numpy() for name in data.columns}
        if data.index.name is not None and data.index.name not in variables:
            variables[str(data.index.name)] = data.index.to_numpy()
        return variables, units
    if module == "polars":
        return {name: data[name].to_numpy() for name in data.columns}, {}
    if isinstance(data, Mapping):
        return {str(name): np.asarray(values) for name, values in data.items()}, {}
    if isinstance(data, np.ndarray) and data.dtype.names:
        return {name: data[name] for name in data.dtype.names}, {}
    raise DataError(
        f"a {type(data).__name__} is not a table with names",
        source,
        "give a mapping of names to arrays, a data frame, an xarray Dataset or a structured array",
    )


def _of_xarray(data: Any, source: str) -> tuple[dict[str, Any], dict[str, str | None]]:
    """Variables and coordinates of a Dataset; of a DataArray those along its other dimension."""
    if not hasattr(data, "data_vars"):
        others = [dim for dim in data.dims if dim not in ("time", TIME)]
        if len(others) > 1 or (not others and data.name is None):
            raise DataError("the array has no names for its columns", source, "give a Dataset")
        data = data.to_dataset(dim=others[0]) if others else data.to_dataset()
    variables = {
        str(name): np.asarray(item.values) for name, item in {**data.coords, **data.data_vars}.items()
    }
    units = {str(name): item.attrs.get("units") for name, item in {**data.coords, **data.data_vars}.items()}
    return variables, units
