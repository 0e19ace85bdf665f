"""Data files named on the command line."""

import os

import pytest

from dashpot.app.data_files import require_each_once
from dashpot.errors import UsageError


@pytest.mark.parametrize("again", ["./run.csv", "link.csv"])
def test_a_file_named_twice_is_refused_whatever_the_name(
    again: str, tmp_path: os.PathLike[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its noise would count as that of two tests, and the intervals be too narrow by the root of two."""
    monkeypatch.chdir(tmp_path)
    with open("run.csv", "w", encoding="utf-8"):
        pass
    os.symlink("run.csv", "link.csv")
    with pytest.raises(UsageError, match="given 2 times"):
        require_each_once(["run.csv", again])
