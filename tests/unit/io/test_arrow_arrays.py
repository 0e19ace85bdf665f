"""Columns of Arrow and arrays of NumPy: the same numbers there and back, without pandas."""

import subprocess
import sys
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from dashpot.io.json_document import array_of, arrow_table

COLUMNS: dict[str, Any] = {
    "numbers": np.array([1.0, np.nan, -np.inf, 0.1]),
    "every other": np.arange(8.0)[::2],
    "counts": np.array([1, -2, 3, 2**62]),
    "marks": np.array([True, False, True, True]),
    "texts": np.array(["", "ü", "a" * 300, "0"], dtype=object),
    "single": np.array([1.5, 2.5, 3.5, 4.5], dtype=np.float32),
    "words": np.array(["a", "bc", "", "d"]),
    "list": ["a", "b", "c", "d"],
}


def test_a_table_has_what_arrow_itself_would_make_of_the_columns() -> None:
    made, usual = arrow_table(COLUMNS), pa.table(COLUMNS)
    made.validate(full=True)
    assert made.schema == usual.schema
    for name in COLUMNS:
        assert made[name].null_count == 0
        assert repr(made[name].to_pylist()) == repr(usual[name].to_pylist()), name
    assert arrow_table({"none": np.zeros(0)}).num_rows == 0


@pytest.mark.parametrize(
    "column",
    [
        pa.chunked_array([pa.array([1.0, 2.0]), pa.array([3.0])]),
        pa.chunked_array([pa.array([1, 2], pa.int16())]),
        pa.chunked_array([pa.array([1.0, None, 3.0])]),
        pa.chunked_array([pa.array([1.0, 2.0, 3.0]).slice(1)]),
        pa.chunked_array([], pa.float64()),
        pa.array([1.0, 2.0], pa.float32()),
    ],
)
def test_an_array_has_the_numbers_and_kind_of_the_column(column: Any) -> None:
    array = array_of(column)
    expected = np.array([np.nan if value is None else value for value in column.to_pylist()])
    assert np.array_equal(array, expected, equal_nan=True)
    assert array.dtype == column.type.to_pandas_dtype()


def test_pandas_is_not_loaded() -> None:
    program = """
import sys, numpy as np
from dashpot.io.json_document import array_of, arrow_table
names = ["a", "b", "c"]
words = {"name": np.array(names, dtype=object), "word": np.array(names), "list": names}
table = arrow_table({"x": np.arange(3.0), **words})
assert array_of(table["x"]).tolist() == [0.0, 1.0, 2.0]
raise SystemExit("pandas" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
