"""Damage of every kind to every format: a right answer or one clear line, within 5 s and 1 GiB."""

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from dashpot.data.readers import read
from dashpot.errors import DataError
from dashpot.model.rigfile import parse_rig
from tests.fuzz import corpus

ROOT = Path(__file__).parents[2]


@pytest.mark.long
def test_systematic_damage_finds_nothing() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.systematic"],
        cwd=ROOT, capture_output=True, text=True, timeout=600, env={**os.environ, "MPLBACKEND": "Agg"},
    )  # fmt: skip
    *faults, total = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert faults == []
    assert total["cases"] >= 1500
    assert total["formats"] >= 28
    assert done.returncode == 0


@pytest.mark.slow
def test_sound_inputs_are_sound() -> None:
    """What is damaged would else be refused for what was wrong before."""
    for name, content in corpus.files().items():
        if name.endswith(".toml") and name not in ("study.toml", "test.toml"):
            parse_rig(content.decode(), name)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_recordings_of_labview_are_whole_or_refused(tmp_path: Path) -> None:
    """Its library leaves out, without a word, a segment whose description is cut off."""
    content = corpus.files()["tdms.tdms"]
    path = tmp_path / "cut.tdms"
    segments = [match.start() for match in re.finditer(b"TDSm", content)]
    for length in (
        1,
        len(content) - 1,
        *(start + within for start in segments for within in (2, 20, 90, 600)),
    ):
        path.write_bytes(content[:length])
        with pytest.raises(DataError) as refused:
            read(path, parse_rig(corpus.BASE).channels)
        assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_an_archive_of_very_many_arrays_is_refused_at_once(tmp_path: Path) -> None:
    """30,000 took 33 s once: each was looked for in a list of all."""
    path = tmp_path / "many.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for k in range(20_001):
            archive.writestr(f"c{k}.npy", b"")
    with pytest.raises(DataError, match="there are 20001"):
        read(path, parse_rig(corpus.BASE).channels)
