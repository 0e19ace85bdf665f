"""What is written reads back to the last bit, in every format that can hold it: samples, amplitudes, responses."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.readers import read
from dashpot.data.readers.uff import FRF, NodalFunction, NodePoint
from dashpot.data.readers.uff_writer import write_universal_file
from tests.unit.data.readers.column_files import TABLES, famos, hdf5, mat, mdf, npz, tdms, uff

CHANNELS = (Channel("x", {"x": 1}), Channel("u", {"u": 1}))
COUNT = 50
RNG = np.random.default_rng(7)
TIMES = np.sort(RNG.uniform(-3, 7, COUNT))
EVEN = np.arange(COUNT) / 128
# All digits, and sizes from far below every measurement to the largest that is taken for one.
SAMPLES = RNG.normal(size=(COUNT, 2)) * 10.0 ** RNG.integers(-95, 95, (COUNT, 2))
LINES = np.sort(RNG.uniform(1, 90, COUNT))
AMPLITUDES = RNG.normal(size=(COUNT, 2)) + 1j * RNG.normal(size=(COUNT, 2))


def workbook(path: Path, columns: dict[str, Real]) -> None:
    """With the 17 digits that Excel itself stores; openpyxl gives 16."""
    TABLES[".xlsx"](path, columns)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    numbers = iter(
        [repr(float(value)).encode() for row in zip(*columns.values(), strict=True) for value in row]
    )
    sheet = "xl/worksheets/sheet1.xml"
    parts[sheet] = re.sub(rb'(t="n"[^>]*><v>)[^<]*', lambda cell: cell[1] + next(numbers), parts[sheet])
    assert next(numbers, None) is None
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)


EXACT = {**TABLES, ".xlsx": workbook}


def columns_of_samples() -> dict[str, Real]:
    return {"x": SAMPLES[:, 0], "u": SAMPLES[:, 1]}


def same_record(path: Path, times: Real) -> None:
    (record,) = read(path, CHANNELS).records
    assert np.array_equal(record.time, times)
    assert np.array_equal(record.values, SAMPLES)


@pytest.mark.parametrize("suffix", EXACT)
def test_samples(tmp_path: Path, suffix: str) -> None:
    EXACT[suffix](tmp_path / f"a{suffix}", {"time_s": TIMES, **columns_of_samples()})
    same_record(tmp_path / f"a{suffix}", TIMES)


SAMPLED: dict[str, Callable[[Path, dict[str, Real]], None]] = {
    ".mat": lambda path, columns: mat(path, columns | {"fs": np.array(128.0)}),
    ".h5": lambda path, columns: hdf5(path, columns | {"fs": np.array(128.0)}),
    ".npz": lambda path, columns: npz(path, columns | {"dt": np.array(1 / 128)}),
    ".tdms": lambda path, columns: tdms(path, columns, wf_increment=1 / 128),
    ".mf4": lambda path, columns: mdf(path, columns, EVEN),
    ".uff": lambda path, columns: uff(path, columns, EVEN),
    ".raw": lambda path, columns: famos(path, columns, 1 / 128),
}


@pytest.mark.parametrize("suffix", SAMPLED)
def test_samples_on_the_clock_of_the_format(tmp_path: Path, suffix: str) -> None:
    SAMPLED[suffix](tmp_path / f"a{suffix}", columns_of_samples())
    same_record(tmp_path / f"a{suffix}", EVEN)


@pytest.mark.parametrize("suffix", EXACT)
def test_amplitudes(tmp_path: Path, suffix: str) -> None:
    deviations = RNG.uniform(0.5, 2, (COUNT, 2))
    columns = {"frequency_hz": LINES}
    for k, name in enumerate(("x", "u")):
        X = AMPLITUDES[:, k]
        columns |= {f"{name}_re": X.real, f"{name}_im": X.imag, f"{name}_sd": deviations[:, k]}
    EXACT[suffix](tmp_path / f"a{suffix}", columns)
    lines = read(tmp_path / f"a{suffix}", CHANNELS).spectrum()
    assert np.array_equal(lines.frequency_hz, LINES)
    assert np.array_equal(lines.amplitudes, AMPLITUDES)
    variances = np.einsum("lcc->lc", lines.covariance)
    assert np.array_equal(variances, 2 * deviations**2)


def same_response(path: Path) -> None:
    lines = read(path, CHANNELS).spectrum()
    assert np.array_equal(lines.frequency_hz, LINES)
    assert np.array_equal(lines.amplitudes[:, 0], AMPLITUDES[:, 0])


@pytest.mark.parametrize(
    "suffix", [suffix for suffix in EXACT if suffix != ".h5"]
)  # where x/u is u in group x
def test_frequency_responses(tmp_path: Path, suffix: str) -> None:
    H = AMPLITUDES[:, 0]
    EXACT[suffix](tmp_path / f"a{suffix}", {"frequency_hz": LINES, "x/u_re": H.real, "x/u_im": H.imag})
    same_response(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("little", [True, False])
def test_frequency_responses_of_universal_files(tmp_path: Path, little: bool) -> None:
    response = NodalFunction(
        FRF, NodePoint("x", 1, 1), NodePoint("u", 2, 1), LINES, AMPLITUDES[:, 0], "m", "m", even=False
    )
    write_universal_file(tmp_path / "a.uff", [response], little=little)
    same_response(tmp_path / "a.uff")
