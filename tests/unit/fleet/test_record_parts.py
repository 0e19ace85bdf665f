"""Data of one rig file by file: the same as all of it together, long records in pieces, failures told."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from dashpot.data.conditioning.clock import cut
from dashpot.data.readers import read, write_records
from dashpot.data.spectrum import concatenate
from dashpot.errors import DataError
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.fleet import record_parts
from dashpot.fleet.data_sets import Treatment
from dashpot.fleet.record_parts import FileParts, FileTask, identify_in_parts
from dashpot.model.rigfile import Rig
from tests.whole_rigs import chain, record_of

PARTS = 3
Parts = tuple[Estimate, list[tuple[int, int]]]


@pytest.fixture(scope="module")
def rig() -> Rig:
    model, theta = chain(1)
    return Rig(model, record_of(model, theta, "random", decay_times=2).record.channels)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A record in a file for each third, and whole."""
    folder = tmp_path_factory.mktemp("record")
    model, theta = chain(1)
    test = record_of(model, theta, "random", decay_times=60)
    noise = 0.02 * test.size * np.array([1.0, 0.0])
    record = test.noisy(np.random.default_rng(0), noise)
    paths = [folder / f"part{k}.npz" for k in range(PARTS)]
    for k, path in enumerate(paths):
        write_records([cut(record, k / PARTS, (k + 1) / PARTS)], path)
    write_records([record], folder / "whole.npz")
    return [str(path) for path in (*paths, folder / "whole.npz")]


@pytest.fixture(scope="module")
def apart(rig: Rig, files: list[str]) -> Parts:
    """The estimate of the thirds one by one, and what was told of its progress."""
    done: list[tuple[int, int]] = []
    return identify_in_parts(rig, files[:PARTS], Treatment(), progress=lambda *at: done.append(at)), done


def backwards(function: Callable[[FileTask], FileParts], tasks: Iterable[FileTask]) -> Iterable[FileParts]:
    return [function(task) for task in reversed(list(tasks))]


@pytest.mark.slow
def test_files_one_by_one_are_all_of_them_together(rig: Rig, files: list[str], apart: Parts) -> None:
    estimate, done = apart
    assert done == [(1, 3), (2, 3), (3, 3)]
    together = identify(
        rig.model, concatenate([read([path], rig.channels).spectrum() for path in files[:PARTS]])
    )
    assert np.all(np.abs(estimate.values - together.values) < 0.1 * together.sd)
    assert estimate.noise_sd == pytest.approx(together.noise_sd, rel=0.05)
    assert estimate.assessment.verdict != "does not fit"


@pytest.mark.slow
def test_the_result_does_not_depend_on_who_computes_what_when(
    rig: Rig, files: list[str], apart: Parts
) -> None:
    other = identify_in_parts(rig, files[:PARTS], Treatment(), mapper=backwards)
    assert other.to_json() == apart[0].to_json()


@pytest.mark.slow
def test_a_very_long_record_is_cut_into_pieces(
    rig: Rig, files: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = identify_in_parts(rig, files[PARTS:], Treatment())
    lines = read(files[PARTS:], rig.channels).spectrum().lines
    monkeypatch.setattr(record_parts, "MOST_LINES", round(lines / 3.5))
    parts = record_parts.identify_file(FileTask(rig, Treatment(), files[PARTS]))
    count = len(parts.names)
    assert 4 <= count <= 6
    assert parts.names == tuple(f"{files[PARTS]} ({k + 1} of {count})" for k in range(count))
    pieces = identify_in_parts(rig, files[PARTS:], Treatment())
    assert str(pieces.notes[0]).startswith(f"{count} parts of the data")
    # Pieces of a dozen decay times each: their loads cost more than those of real ones, and estimates of less
    # information differ from efficient ones by what they lose (Hausman).
    assert np.all((pieces.noise_sd > whole.noise_sd) & (pieces.noise_sd < 1.7 * whole.noise_sd))
    lost = np.sqrt(pieces.noise_sd**2 - whole.noise_sd**2)
    assert np.all(np.abs(pieces.values - whole.values) < 3 * lost)


def test_a_file_that_cannot_be_read_is_left_out_and_told(rig: Rig, files: list[str], tmp_path: Path) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text("time_s,x1,u\n0,1\n")
    estimate = identify_in_parts(rig, [files[0], str(bad)], Treatment())
    told = next(notice for notice in estimate.warnings if notice.code == "parts_left_out")
    assert "1 part left out" in told.text
    assert "bad.csv" in told.text
    with pytest.raises(DataError, match=r"bad\.csv"):
        identify_in_parts(rig, [str(bad)], Treatment())
