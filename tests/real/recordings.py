"""The recordings beside the checkout, which are not part of it, and the examples that were made of them."""

import runpy
from pathlib import Path

import pytest

from dashpot.data.readers import read
from dashpot.data.spectrum import Spectrum
from dashpot.model.rigfile import read_rig

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
RAW = ROOT.parent / "shared" / "data"
needs_recordings = pytest.mark.skipif(not RAW.is_dir(), reason="the recordings are not here")


def tables(example: Path, raw: Path, folder: Path) -> tuple[Spectrum, Spectrum]:
    """The amplitudes that an example's program makes of the raw files, written to `folder`, and those kept with it."""
    written = folder / "amplitudes.csv"
    runpy.run_path(str(example / "make_amplitudes.py"))["main"](str(raw), str(written))
    channels = read_rig(example / "rig.toml").channels
    again, kept = (read(str(table), channels).spectrum() for table in (written, example / "amplitudes.csv"))
    return again, kept
