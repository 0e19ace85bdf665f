"""Blocks of a study on disk: every kind of damage is found, computed again, and said; one process at a time."""

import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dashpot.errors import DataError, UsageError
from dashpot.io.atomic import LOCK, locked
from dashpot.study import montecarlo
from dashpot.study.blocks import BlockStore, Columns, Key
from dashpot.study.montecarlo import run_study
from dashpot.study.scenario import Study
from dashpot.study.studyfile import read_study
from tests.two_masses import RIG, TWO_SCENARIOS

STUDY = TWO_SCENARIOS.replace("draws = 4", "draws = 30")
LABEL = {
    "fingerprint": "f" * 64, "seed": 7, "index": 3, "size": 5, "methods": ["wls", "oiv"], "unknowns": 2,
    "version": "1.0",
}  # fmt: skip
KEY = Key("draws/here/000003", LABEL)


@pytest.fixture
def study(tmp_path: Path) -> Study:
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    return read_study(tmp_path / "study.toml")


def computed(seed: int) -> Columns:
    """A block's columns."""
    rng = np.random.default_rng(seed)
    numbers: Columns = {f"values_{i}": rng.normal(size=10) for i in range(2)}
    numbers["values_0"][0] = np.nan
    return {"method": np.repeat(["wls", "oiv"], 5), "converged": rng.random(10) > 0.3, **numbers}


def kept(folder: Path, key: Key = KEY) -> bytes:
    """A block in a folder: what its file holds."""
    list(BlockStore(folder).map(computed, [0], key=lambda _: key))
    return (folder / f"{key.name}.parquet").read_bytes()


def found(folder: Path, key: Key = KEY) -> tuple[Columns | None, list[str]]:
    """What lies in place of a block, and what it is; computed again it is another one."""
    store = BlockStore(folder)
    before = (folder / f"{KEY.name}.parquet").read_bytes()
    (block,) = store.map(computed, [1], key=lambda _: key)
    (folder / f"{KEY.name}.parquet").write_bytes(before)
    return block.columns() if block.kept else None, list(store.states)


def same(one: Columns, other: Columns) -> bool:
    return list(one) == list(other) and all(
        np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f") for name in one
    )


@pytest.mark.parametrize("folder", [True, False])
def test_a_block_comes_back_as_it_went_whoever_computes_it(tmp_path: Path, folder: bool) -> None:
    store = BlockStore(tmp_path if folder else None)

    def key(seed: int) -> Key:
        return replace(KEY, name=f"draws/{seed}")

    def backwards(f: Callable[[object], object], work: Iterable[object]) -> list[object]:
        return [f(task) for task in reversed(list(work))]

    blocks = list(store.map(computed, [0, 1, 2], key=key, mapper=backwards))
    assert [block.task for block in blocks] == [2, 1, 0]
    again = list(store.map(computed, [0, 3, 1], key=key))
    assert sorted((block.task, block.kept) for block in again) == [(0, True), (1, True), (3, False)]
    for block in again:
        assert same(block.columns(), computed(block.task))
        assert same(store.read(key(block.task)), block.columns())


@pytest.mark.parametrize(
    ("change", "state"),
    [
        ({"index": 4}, "damaged"),
        ({"fingerprint": "e" * 64}, "damaged"),
        ({"seed": 8}, "damaged"),
        ({"version": "0.9"}, "outdated"),
        ({"size": 4}, "other"),
        ({"methods": ["oiv", "wls"]}, "other"),
        ({"methods": ["wls", "tls"]}, "other"),
    ],
)
def test_a_block_of_something_else_is_seen(tmp_path: Path, change: dict[str, object], state: str) -> None:
    kept(tmp_path)
    wanted = replace(KEY, label={**LABEL, **change})
    with pytest.raises(DataError, match=state):
        BlockStore(tmp_path).read(wanted)
    assert found(tmp_path, wanted) == (None, [state])
    assert found(tmp_path)[1] == ["whole"]


def test_no_damage_passes_for_other_numbers(tmp_path: Path) -> None:
    """A flipped bit, a zeroed page, an end cut off, all along the file: found, or without any meaning."""
    raw, path = kept(tmp_path), tmp_path / f"{KEY.name}.parquet"
    rng, length, seen = np.random.default_rng(1), 34, []  # bytes: pages within a column and across its ends
    for at in range(0, len(raw), length):
        flipped = raw[:at] + bytes([raw[at] ^ (1 << int(rng.integers(8)))]) + raw[at + 1 :]
        for changed in (flipped, raw[:at] + bytes(length) + raw[at + length :], raw[:at]):
            path.write_bytes(changed)
            columns, _ = found(tmp_path)
            seen.append(columns is None)
            assert columns is None or same(columns, computed(0)), at
    assert np.mean(seen) > 0.5


def test_damaged_blocks_are_computed_again(study: Study, tmp_path: Path) -> None:
    """Two in each other's place, of one scenario and of two; and one of which a bit is flipped."""
    folder = tmp_path / "s"
    whole = run_study(study, folder, block=10)
    assert whole.notes == ()
    before = {path: path.read_bytes() for path in sorted(folder.glob("draws/*/*.parquet"))}
    first, second, third, other, flipped, _ = before
    for path, source in ((first, other), (other, first), (second, third), (third, second)):
        path.write_bytes(before[source])
    raw = bytearray(before[flipped])
    raw[len(raw) // 3] ^= 4
    flipped.write_bytes(raw)
    again = run_study(study, folder, block=10)
    assert [(note.code, note.text.split()[0]) for note in again.notes] == [("damaged_blocks", "5")]
    assert again.columns() == whole.columns()
    assert {path: path.read_bytes() for path in before} == before


def test_blocks_of_another_version_are_computed_again(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "s"
    with monkeypatch.context() as patched:
        patched.setattr(montecarlo, "version", lambda _: "0.0.9")
        run_study(study, folder, block=10)
    again = run_study(study, folder, block=10)
    assert [note.code for note in again.notes] == ["outdated_blocks"]
    assert again.notes[0].text.startswith("6 of the study's blocks computed again: another version")
    assert run_study(study, folder, block=10).notes == ()


def test_other_methods_of_the_same_number_are_computed(study: Study, tmp_path: Path) -> None:
    """As many rows of other methods were taken for the methods asked for."""
    folder = tmp_path / "s"
    run_study(study, folder, block=10)
    other = replace(study, grids=(replace(study.grids[0], methods=("wls", "ml")),))
    assert run_study(other, folder, block=10).columns() == run_study(other, block=10).columns()


def test_a_folder_is_one_processs_at_a_time(study: Study, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    run_study(study, folder, block=10)
    assert not (folder / LOCK).exists()
    code = (
        "import sys; from dashpot.io.atomic import locked\n"
        f"with locked({str(folder)!r}): print('held', flush=True); sys.stdin.read()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout.readline() == "held\n"
    part = folder / "draws" / ".dashpot-0.part"
    part.write_text("being written by the other")
    with pytest.raises(
        UsageError, match=rf"another dashpot \(process {holder.pid}\) is working in this folder"
    ):
        run_study(study, folder, block=10)
    assert part.exists()
    holder.kill()
    holder.communicate()
    run_study(study, folder, block=10)  # the lock died with its holder
    assert not (folder / LOCK).exists()
    assert not list(folder.rglob(".*"))


def test_the_lock_is_freed_by_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError), locked(tmp_path):
        raise KeyError
    with locked(tmp_path):
        assert (tmp_path / LOCK).exists()
    assert not (tmp_path / LOCK).exists()
