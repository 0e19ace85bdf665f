"""Data files named on the command line."""

import os

import pytest

from dashpot.app.data_files import read_files
from dashpot.errors import UsageError
from dashpot.model.rigfile import parse_rig
from tests.unit.export.exported import TWO_MASSES


@pytest.mark.parametrize("again", ["./run.csv", "link.csv"])
def test_a_file_named_twice_is_refused_whatever_the_name(
    again: str, tmp_path: os.PathLike[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its noise would count as that of two tests, and the intervals be too narrow by the root of two."""
    monkeypatch.chdir(tmp_path)
    with open("run.csv", "w", encoding="utf-8") as file:
        file.write("frequency_hz,x1_re,x1_im,u_re,u_im\n1,1,0,1,0\n2,1,0,1,0\n")
    os.symlink("run.csv", "link.csv")
    with pytest.raises(UsageError, match="given 2 times"):
        read_files(parse_rig(TWO_MASSES), ["run.csv", again], {"frequency": None}, quiet=True)
