"""Fleets in blocks: the same whoever computes them, kept over interruptions, with failures told and not spread."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dashpot.data.readers import write_amplitudes
from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.fleet import runner
from dashpot.fleet.data_sets import Source, Treatment, of_files
from dashpot.fleet.runner import run_fleet
from dashpot.model.observation import with_relative_noise
from dashpot.model.rigfile import Rig, parse_rig
from dashpot.study.simulate import dwells, simulate_spectrum
from tests.unit.app.conftest import RIG, VALUES

COUNT = 12


@pytest.fixture(scope="module")
def rig() -> Rig:
    read = parse_rig(RIG)
    return replace(read, channels=with_relative_noise(read.model, read.channels, 0.02))


@pytest.fixture(scope="module")
def files(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Data sets of rigs alike to 3 %; one has its own frequencies, one is another rig."""
    folder, rng = tmp_path_factory.mktemp("fleet"), np.random.default_rng(0)
    model = rig.model
    paths = []
    for k in range(COUNT):
        theta = model.theta(VALUES) * (1 + 0.03 * rng.standard_normal(len(model.unknowns)))
        if k == 7:
            theta[0] *= 1.6
        lines = np.linspace(2, 12, 9 if k == 3 else 10)
        test = dwells(model, lines, 40)
        spectrum = simulate_spectrum(model, model.parameters(theta), rig.channels, test, rng)
        paths.append(str(folder / f"rig{k}.csv"))
        write_amplitudes(spectrum, paths[-1])
    return paths


def same(a: Any, b: Any) -> None:
    first, second = a.table(), b.table()
    assert list(first) == list(second)
    for name, values in first.items():
        assert np.array_equal(values, second[name], equal_nan=values.dtype.kind == "f"), name


def test_each_row_is_what_identify_says_of_the_file_alone(rig: Rig, files: list[str]) -> None:
    outcome = run_fleet(rig, of_files(files))
    assert outcome.names == tuple(VALUES)
    for k in (0, 3):
        alone = identify(rig.model, rig.read(files[k]).spectrum())
        assert outcome.columns["status"][k] == "converged"
        for j, name in enumerate(alone.names):
            assert outcome.columns[f"{name}:value"][k] == pytest.approx(alone.values[j], rel=1e-9)
            assert outcome.columns[f"{name}:sd"][k] == pytest.approx(alone.sd[j], rel=1e-9)
    assert outcome.outliers == [7]
    assert outcome.usual[0].outlier[7]


def test_batches_are_the_same_rows_as_one_by_one(
    rig: Rig, files: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    single = run_fleet(rig, of_files(files))
    monkeypatch.setattr(runner, "SIZES", ())  # one block, in which ten of twelve have the same lines
    batch = run_fleet(rig, of_files(files))
    for name, values in single.columns.items():
        if values.dtype.kind == "f":
            assert np.allclose(batch.columns[name], values, rtol=1e-7), name


def backwards(function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Any]:
    for task in reversed(list(tasks)):
        yield function(task)


def test_interrupted_resumed_and_in_any_order_it_is_the_same_to_the_bit(
    rig: Rig, files: list[str], tmp_path: Path
) -> None:
    whole = run_fleet(rig, of_files(files), pool=True)
    done = 0

    def interrupted(function: Any, tasks: Any) -> Iterator[Any]:
        nonlocal done
        for task in tasks:
            if done == 5:
                raise KeyboardInterrupt
            done += 1
            yield function(task)

    with pytest.raises(KeyboardInterrupt):
        run_fleet(rig, of_files(files), tmp_path / "b", mapper=interrupted)
    resumed = run_fleet(rig, of_files(files), tmp_path / "b", mapper=backwards, pool=True)
    assert resumed.kept == 5
    same(resumed, whole)
    assert run_fleet(rig, of_files(files), tmp_path / "b").kept == COUNT


@pytest.mark.slow
def test_what_has_changed_is_computed_again(rig: Rig, files: list[str], tmp_path: Path) -> None:
    run_fleet(rig, of_files(files), tmp_path / "b")
    assert run_fleet(rig, of_files(files), tmp_path / "b", Treatment(method="wls")).kept == 0
    other = replace(rig, channels=with_relative_noise(rig.model, rig.channels, 0.03))
    assert run_fleet(other, of_files(files), tmp_path / "b").kept == 0
    assert run_fleet(rig, of_files([*files[1:], files[0]]), tmp_path / "b").kept == COUNT
    block = min((tmp_path / "b").glob("*.parquet"))
    data = bytearray(block.read_bytes())
    data[len(data) // 2] ^= 1
    block.write_bytes(data)
    repaired = run_fleet(rig, of_files(files), tmp_path / "b")
    assert repaired.kept >= COUNT - 1
    same(repaired, run_fleet(rig, of_files(files)))


def test_failures_are_told_and_stop_nothing(rig: Rig, files: list[str], tmp_path: Path) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text(Path(files[0]).read_text().replace("x1_re", "y_re"))
    empty = tmp_path / "empty.csv"
    empty.write_text(Path(files[0]).read_text().splitlines()[0])
    paths = [*files[:6], str(bad), str(tmp_path / "none.csv"), str(empty)]
    outcome = run_fleet(rig, of_files(paths))
    assert outcome.failed == [6, 7, 8]
    reasons = list(outcome.columns["reason"][6:])
    assert "column x1_re: missing" in reasons[0]
    assert "there is no such file" in reasons[1]
    assert reasons[2]
    assert np.isnan(outcome.columns["m1:value"][6:]).all()
    assert np.isfinite(outcome.columns["m1:value"][:6]).all()
    assert outcome.summary()["failed"] == 3


def test_a_data_set_that_is_given_twice_has_two_rows(rig: Rig, files: list[str]) -> None:
    outcome = run_fleet(rig, of_files([files[0], files[1], files[0]]), mapper=backwards)
    assert outcome.columns["m1:value"][0] == outcome.columns["m1:value"][2]


def test_a_folder_of_other_files_is_refused(rig: Rig, files: list[str], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match=r"notes\.txt"):
        run_fleet(rig, of_files(files), tmp_path)
    with pytest.raises(UsageError, match="no data sets"):
        run_fleet(rig, Source(0, lambda _: iter(())))
