"""dashpot fleet: many data sets in, one table out; and the processes that share the work."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from multiprocessing import active_children
from pathlib import Path
from types import ModuleType

import numpy as np
import pyarrow as pa
import pyarrow.csv as text
import pyarrow.parquet as parquet
import pytest

from dashpot.app.workers import mapping
from dashpot.data.readers import write_amplitudes
from dashpot.errors import UsageError
from dashpot.model.observation import with_relative_noise
from dashpot.model.rigfile import parse_rig
from dashpot.study.simulate import dwells, simulate_spectrum
from tests.unit.app.conftest import RIG, VALUES, Command

COUNT = 8
PATIENCE_S = 200  # for programs to start on a busy machine


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A rig file, a folder of data sets of rigs alike, and the same as one table."""
    rig = parse_rig(RIG)
    model, rng = rig.model, np.random.default_rng(0)
    channels = with_relative_noise(model, rig.channels, 0.02)
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "data").mkdir()
    for k in range(COUNT):
        theta = model.theta(VALUES) * (1 + 0.03 * rng.standard_normal(len(model.unknowns)))
        theta = theta * (1.7 if k == 5 else 1.0)
        spectrum = simulate_spectrum(
            model, model.parameters(theta), channels, dwells(model, np.linspace(2, 12, 10), 40), rng
        )
        write_amplitudes(replace(spectrum, channels=rig.channels), tmp_path / "data" / f"rig{k + 3}.csv")
    tables = [text.read_csv(tmp_path / "data" / f"rig{k + 3}.csv") for k in range(COUNT)]
    named = [
        table.append_column("serial", pa.array([f"{k + 3}"] * len(table))) for k, table in enumerate(tables)
    ]
    parquet.write_table(pa.concat_tables(named), tmp_path / "all.parquet")
    return tmp_path


def test_a_row_for_each_file_and_the_odd_one_named(dashpot: Command, data: Path) -> None:
    ran = dashpot("fleet rig.toml data/*.csv --out fleet.parquet --pool --json fleet.json")
    assert ran.code == 0, ran.err
    rows = parquet.read_table(data / "fleet.parquet").to_pylist()
    assert [row["name"] for row in rows] == [f"data/rig{k + 3}.csv" for k in range(COUNT)]
    assert [row["outlier"] for row in rows] == [k == 5 for k in range(COUNT)]
    assert all(row["m1_lower"] < row["m1"] < row["m1_upper"] for row in rows)
    assert all(row["m1_pooled_sd"] <= row["m1_sd"] * 1.001 for k, row in enumerate(rows) if k != 5)
    assert "Outliers: data/rig8.csv" in " ".join(ran.out.split())
    assert max(len(line) for line in ran.out.splitlines()) <= 80
    summary = json.loads((data / "fleet.json").read_text())
    assert summary["data_sets"] == COUNT
    assert summary["parameters"]["m1"]["outliers"] == ["data/rig8.csv"]
    again = dashpot("fleet", "rig.toml", "data/*.csv", "--out", "fleet.parquet", "-q")
    assert (again.code, again.out) == (0, "")


def test_a_table_of_many_rigs_gives_the_same(dashpot: Command, data: Path) -> None:
    assert dashpot("fleet", "rig.toml", "data/*.csv", "--out", "a.parquet", "-q").code == 0
    ran = dashpot("fleet", "rig.toml", "all.parquet", "--rig-column", "serial", "--out", "b.parquet", "-q")
    assert ran.code == 0, ran.err
    files, table = (parquet.read_table(data / f"{name}.parquet").to_pydict() for name in "ab")
    assert table["name"] == [str(k + 3) for k in range(COUNT)]
    assert table["k1" if "k1" in table else "m1"] == files["m1"]


def test_a_failed_data_set_has_its_reason(dashpot: Command, data: Path) -> None:
    (data / "data" / "rig5.csv").write_text("frequency_hz,u_re\n1,2\n")
    ran = dashpot("fleet", "rig.toml", "data/*.csv", "--out", "fleet.parquet")
    assert ran.code == 0
    rows = parquet.read_table(data / "fleet.parquet").to_pylist()
    assert rows[2]["status"] == "failed"
    assert "missing" in rows[2]["reason"]
    assert "Failed: 1 data set. data/rig5.csv: " in " ".join(ran.out.split())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("none/*.csv", "--out", "f.parquet"), "none/*.csv: no file fits"),
        (("all.parquet", "--rig-column", "number", "--out", "f.parquet"), "column number: missing"),
        (("data/*.csv", "--out", "data/rig4.csv"), "data/rig4.csv: unknown format"),
        (("data/*.csv", "--out", "f.parquet", "--method", "oiv", "--positive"), "the method oiv"),
    ],
)
def test_bad_usage_ends_with_2_and_leaves_nothing(
    dashpot: Command, data: Path, arguments: tuple[str, ...], message: str
) -> None:
    before = {path.name for path in data.iterdir()}
    ran = dashpot("fleet", "rig.toml", *arguments)
    assert ran.code == 2
    assert len(ran.err) == 1
    assert message in ran.err[0]
    assert {path.name for path in data.iterdir()} == before


def test_without_dask_the_extra_is_named_when_it_is_asked_for(
    dashpot: Command, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    ran = dashpot("fleet", "rig.toml", "data/*.csv", "--out", "f.parquet", "--dask", "local")
    assert ran.code == 2
    assert len(ran.err) == 1
    assert "distributed" in ran.err[0]
    assert ".[scale]" in ran.err[0]


# Workers that are killed


def squared(task: tuple[int, str]) -> int:
    """The square; the process dies over 3 when it meets it first."""
    number, folder = task
    if number == 3 and not os.path.exists(f"{folder}/killed"):
        Path(folder, "killed").write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


def deadly(_: int) -> int:
    """Nothing: the process dies."""
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


@pytest.mark.slow
def test_workers_killed_while_work_is_shared_out_are_replaced() -> None:
    """The pool is broken when the next task comes to it, not when a result does."""

    def tasks() -> Iterator[int]:
        for k in range(12):
            if k == 6:
                for process in active_children():
                    process.kill()
                    process.join()
                time.sleep(0.5)  # until the pool knows
            yield k

    with mapping(2) as mapper:
        assert sorted(mapper(abs, tasks())) == list(range(12))


@pytest.mark.long
def test_work_that_kills_every_worker_ends_with_a_line() -> None:
    with pytest.raises(UsageError, match="killed 4 times"), mapping(2) as mapper:
        list(mapper(deadly, range(3)))


@pytest.mark.long
def test_a_cluster_gives_the_same_bits_and_survives_a_killed_worker(dashpot: Command, data: Path) -> None:
    distributed: ModuleType = pytest.importorskip("distributed")
    assert distributed
    assert dashpot("fleet", "rig.toml", "data/*.csv", "--out", "a.parquet", "-q").code == 0
    ran = dashpot("fleet rig.toml data/*.csv --out b.parquet -q --dask local --workers 2")
    assert ran.code == 0, ran.err
    assert (data / "a.parquet").read_bytes() == (data / "b.parquet").read_bytes()
    from dashpot.app.workers import cluster_mapping

    with cluster_mapping("local", 2) as mapper:
        assert sorted(mapper(squared, ((k, str(data)) for k in range(12)))) == [k**2 for k in range(12)]
    assert (data / "killed").exists()


@contextmanager
def scheduler_with_workers(folder: Path, workers: int) -> Iterator[str]:
    """Address of a scheduler of Dask with that many workers, processes as one starts them by hand."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}  # tasks of this module must be found
    told, dask = folder / "scheduler.json", [sys.executable, "-m", "dask"]
    here = f"scheduler --host 127.0.0.1 --port 0 --no-dashboard --scheduler-file {told}".split()
    started = [subprocess.Popen([*dask, *here], env=env, **quiet)]
    try:
        while not told.exists():
            assert started[0].poll() is None
            time.sleep(0.1)
        address = json.loads(told.read_text(encoding="utf-8"))["address"]
        worker = [*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        worker += ["--local-directory", str(folder / "scratch")]
        started += [subprocess.Popen(worker, env=env, **quiet) for _ in range(workers)]
        with import_module("distributed").Client(address, timeout=PATIENCE_S) as client:
            client.wait_for_workers(workers, timeout=PATIENCE_S)
        yield address
    finally:
        for process in started[::-1]:
            process.kill()
            process.wait()


@pytest.mark.long
def test_a_scheduler_elsewhere_gives_the_same_bits(dashpot: Command, data: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    assert dashpot("fleet", "rig.toml", "data/*.csv", "--out", "a.parquet", "-q").code == 0
    from dashpot.app.workers import cluster_mapping

    with scheduler_with_workers(tmp_path, 2) as address:
        assert address.startswith("tcp://")
        ran = dashpot("fleet", "rig.toml", "data/*.csv", "--out", "b.parquet", "-q", "--dask", address)
        assert ran.code == 0, ran.err
        assert (data / "a.parquet").read_bytes() == (data / "b.parquet").read_bytes()
        with cluster_mapping(address) as mapper:  # one of the two workers ends, and is not started again
            assert sorted(mapper(squared, ((k, str(data)) for k in range(12)))) == [k**2 for k in range(12)]
    assert (data / "killed").exists()


@pytest.mark.long
def test_a_study_on_a_cluster_is_the_same_to_the_bit(dashpot: Command, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    from tests.unit.app.commands.test_study import STUDY

    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "noise.toml").write_text(STUDY)
    assert dashpot("study", "noise.toml", "-q", "--out", "one", "--processes", "1").code == 0
    ran = dashpot("study", "noise.toml", "-q", "--out", "many", "--processes", "2", "--dask", "local")
    assert ran.code == 0, ran.err
    for path in (tmp_path / "one").rglob("*.parquet"):
        assert path.read_bytes() == (tmp_path / "many" / path.relative_to(tmp_path / "one")).read_bytes()


@pytest.mark.long
def test_a_scheduler_that_is_not_there(dashpot: Command, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("dashpot.app.workers.PATIENCE", 1.0)
    ran = dashpot("fleet", "rig.toml", "data/*.csv", "--out", "b.parquet", "--dask", "tcp://127.0.0.1:9")
    assert ran.code == 2
    assert len(ran.err) == 1
    assert "the Dask scheduler does not answer" in ran.err[0]


def test_one_file_without_a_column_of_rigs_is_one_rig_which_is_said(dashpot: Command, data: Path) -> None:
    ran = dashpot("fleet", "rig.toml", "data/rig4.csv", "--out", "one.parquet")
    assert ran.code == 0
    assert "--rig-column" in ran.err[0]


def test_a_fleet_of_which_nothing_can_be_identified_ends_with_a_code_and_one_reason(
    dashpot: Command, data: Path
) -> None:
    (data / "all.csv").write_text("serial,frequency_hz,wrong_re,wrong_im\na,1,2,3\nb,1,2,3\n")
    ran = dashpot("fleet", "rig.toml", "all.csv", "--rig-column", "serial", "--out", "all.parquet")
    assert ran.code == 3
    assert ran.out.replace("\n", " ").count("missing") == 1
    assert "Failed: 2 data sets. a, b: " in ran.out.replace("\n", " ")
