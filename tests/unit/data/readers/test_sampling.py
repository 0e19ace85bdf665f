"""A sampling step that no clock can tell is refused, whatever format it comes from."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.data.inspection import inspect_file
from dashpot.data.readers import read
from dashpot.data.readers.uff import TIME_RESPONSE, NodalFunction, NodePoint
from dashpot.data.readers.uff_writer import write_universal_file
from dashpot.errors import DataError
from tests.unit.data.readers.written import CHANNELS


@pytest.mark.parametrize("step", ["5e-324", "1e-320", "1e-31"])
def test_an_absurd_step_is_told_in_one_line(tmp_path, step):
    t = np.arange(40) * float(step)
    uff, table = tmp_path / "a.uff", tmp_path / "a.csv"
    function = NodalFunction(TIME_RESPONSE, NodePoint("", 3, 3), NodePoint(), t, np.sin(np.arange(40.0)), "m")
    write_universal_file(uff, [replace(function, even=True)], binary=False, double=True)
    table.write_text(
        "time_s,x1,x2,u\n"
        + "".join(f"{time!r},{k % 5},{k % 3},{k % 7}\n" for k, time in enumerate(t.tolist()))
    )
    for path in (uff, table):
        (part,) = inspect_file(path).parts
        (problem,) = part.damaged
        assert "step" in str(problem)
        assert "\n" not in str(problem)
    with pytest.raises(DataError, match="step"):
        read(table, CHANNELS, frequency_hz=2.0)
