"""A new format is a reader and a line in the registry."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dashpot.channel import Channel
from dashpot.data.readers import read, registry
from dashpot.data.readers.arrays import ArrayColumns, array_columns
from dashpot.data.readers.datafile import DataFile


def read_lists(file: DataFile) -> Iterator[ArrayColumns]:
    """Lists of numbers by name, as JSON."""
    lists = json.loads(file.contents)["lists"]
    yield array_columns(file.name, {name: np.array(values) for name, values in lists.items()})


def test_a_new_format_is_a_reader_and_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        registry, "READERS", (registry.Reader("JSON of lists", read_lists, (b'{"lists"',)), *registry.READERS)
    )
    lists = {"time_s": np.arange(6) / 10, "x": np.arange(6.0)}
    path = tmp_path / "data.lists"
    path.write_text(json.dumps({"lists": {name: values.tolist() for name, values in lists.items()}}))
    (record,) = read(path, [Channel("x", {"x": 1.0}, unit="mm", scale=1e-3)]).records
    np.testing.assert_allclose(record.values[:, 0], 1e-3 * lists["x"])
    np.testing.assert_allclose(record.time, lists["time_s"])
