"""JSON in and out: what JSON has not is null, and nothing else is changed."""

import json
import math
from types import MappingProxyType

import numpy as np
import pytest

from dashpot.io.json_document import from_json, nullable, to_json


def test_numbers_that_are_not_finite_are_null_wherever_they_stand() -> None:
    content = {"a": math.nan, "b": [1.0, math.inf, {"c": (-math.inf, 2)}], "d": np.array([[1.5, np.nan]])}
    assert json.loads(to_json(content)) == {"a": None, "b": [1.0, None, {"c": [None, 2]}], "d": [[1.5, None]]}


def test_what_numpy_and_read_only_mappings_hold_is_written() -> None:
    content = MappingProxyType({"n": np.int64(3), "x": np.float64(0.1), "yes": np.bool_(True), "name": "µ"})
    assert to_json(content) == '{\n "n": 3,\n "x": 0.1,\n "yes": true,\n "name": "µ"\n}\n'


def test_every_double_comes_back_exactly() -> None:
    values = np.random.default_rng(1).standard_normal(601) * 10.0 ** np.arange(-300, 301)
    assert from_json(to_json(values)) == values.tolist()


@pytest.mark.parametrize("text", ["{", "", "[1,]", "[" * 100_000])
def test_what_is_no_json_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011  # the reader of a file says what is wrong with it
        from_json(text)


def test_a_number_that_is_null_is_what_stands_for_it() -> None:
    assert math.isnan(nullable(None))
    assert nullable(None, math.inf) == math.inf
    assert nullable(2) == 2.0
