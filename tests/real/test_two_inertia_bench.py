"""The motor bench from its raw file: calibrations, inertias and stiffness without any start value."""

import json
from pathlib import Path

import numpy as np
import pytest

from dashpot.app.cli import run
from dashpot.data.readers import read
from dashpot.estimate.identify import automatic, identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.result import Estimate
from dashpot.model.rigfile import read_rig
from tests.real.recordings import EXAMPLES, RAW, needs_recordings, tables

EXAMPLE = EXAMPLES / "04_motor_bench"
FILES = RAW / "two_inertia_bench" / "MultisineTypeA.mat"


@pytest.fixture(scope="module")
def bench() -> Estimate:
    rig = read_rig(EXAMPLE / "rig.toml")
    assert all(unknown.guess is None for unknown in rig.model.unknowns)
    spectrum = read(str(EXAMPLE / "amplitudes.csv"), rig.channels).spectrum()
    assert isinstance(automatic(rig.model, spectrum), MaximumLikelihood)
    # A tenth of the default search, to save time: it leads to the same end.
    return identify(rig.model, spectrum, MaximumLikelihood(starts=8, candidates=200, rounds=1))


def test_the_bench_is_built_alike(bench: Estimate) -> None:
    assert bench.method == "ml"
    assert bool(bench.converged)
    assert bench["J2"].value / bench["J1"].value == pytest.approx(1, abs=0.01)


def test_calibrations_are_found(bench: Estimate) -> None:
    assert float(bench.signs["theta_l"]) == -1
    # The torque is late by about 0.1 ms, so the current is early.
    delay = bench["current.delay"]
    assert delay.value == pytest.approx(-0.1e-3, abs=0.02e-3)
    assert delay.interval95[1] < 0


def test_resonance_and_antiresonance(bench: Estimate) -> None:
    assert bench.modes.frequency_hz[-1] == pytest.approx(76, abs=1)
    assert np.sqrt(bench["k"].value / bench["J2"].value) / (2 * np.pi) == pytest.approx(54, abs=1)
    assert all(bench[name].value > 0 for name in ("c", "d1", "d2"))


def test_friction_is_not_hidden(bench: Estimate) -> None:
    assert bool(bench.fit.rejected)
    assert bench.basis == "model misfit"


@needs_recordings
def test_the_table_is_what_the_raw_file_gives(tmp_path: Path) -> None:
    again, kept = tables(EXAMPLE, FILES, tmp_path)
    assert list(again.frequency_hz) == list(range(11, 251))
    assert np.max(np.abs(again.amplitudes - kept.amplitudes) / kept.sd()) < 1e-3
    assert np.max(np.abs(again.sd() / kept.sd() - 1)) < 1e-3
    correlation = np.abs(again.covariance[:, 1, 2]) / (2 * again.sd()[:, 1] * again.sd()[:, 2])
    assert (
        np.median(correlation[:60]) > 0.9
    )  # both angles drift together: the covariance between channels matters


@pytest.mark.long
def test_the_bench_without_sign_and_delay_is_told_both_one_after_the_other(tmp_path: Path) -> None:
    """It once ended as converged with J1 0 ± 130 and exit 0."""
    rig = (EXAMPLE / "rig.toml").read_text(encoding="utf-8")
    plain = rig.replace(', sign = "unknown"', "").replace(', delay = "unknown"', "")
    assert plain != rig
    (tmp_path / "plain.toml").write_text(plain, encoding="utf-8")
    lines = (EXAMPLE / "amplitudes.csv").read_text(encoding="utf-8").splitlines()
    header, *rows = [line for line in lines if not line.startswith("#")]
    (tmp_path / "data.csv").write_text("\n".join([header, *rows[::8]]) + "\n", encoding="utf-8")
    files = {
        name: str(tmp_path / name) for name in ("plain.toml", "data.csv", "a.json", "signed.toml", "b.json")
    }

    plain_bench = ["identify", files["plain.toml"], files["data.csv"], "-q", "--json", files["a.json"]]
    ended = run([*plain_bench, "--apply", files["signed.toml"]])
    first = json.loads((tmp_path / "a.json").read_text())
    assert first["fit"]["verdict"] == "does not fit"
    assert (first["status"], ended) in {("not converged", 3), ("converged", 0)}
    J1 = first["parameters"]["J1"]
    assert not (J1["sd"] < 0.5 * abs(J1["value"]) and J1["value"] > 0.01)
    assert (first["diagnosis"][0]["kind"], first["diagnosis"][0]["of"]) == ("sign", ["theta_l"])

    assert (
        run(
            ["identify", files["signed.toml"], files["data.csv"], "-q", "--strict", "--json", files["b.json"]]
        )
        == 4
    )
    # It explains 57 % of the misfit only, so that something that is not listed is likelier to be the whole of it.
    named = json.loads((tmp_path / "b.json").read_text())["diagnosis"]
    first = next(each for each in named if each["kind"] != "unexplained")
    # A drive that is held for a step is late by half of it: the channel is early.
    assert first["of"] == ["current"]
    early = {"delay": -first["number"], "hold": first["number"] / 2}[first["kind"]]
    assert early == pytest.approx(0.1e-3, abs=0.02e-3)
