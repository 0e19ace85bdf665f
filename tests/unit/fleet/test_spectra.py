"""Rows of many rigs read at once are what each of them is alone; what is wrong with one says that one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dashpot.fleet import runner
from dashpot.fleet.data_sets import HeldRows, Treatment
from dashpot.fleet.runner import PartReader, alike_cuts, stacked_cuts
from dashpot.model.rigfile import Rig, parse_rig
from tests.unit.app.conftest import RIG

RIGS, LINES = 9, 6


@pytest.fixture(scope="module")
def rig() -> Rig:
    return parse_rig(RIG)


def rows_of(rig: Rig, rng: np.random.Generator, noise: bool = True) -> HeldRows:
    """Amplitudes of some rigs at the same lines, of which one has two lines less."""
    lines = [LINES - 2 if k == 4 else LINES for k in range(RIGS)]
    count = sum(lines)
    columns = {"frequency_hz": np.concatenate([np.linspace(2, 12, LINES)[:some] for some in lines])}
    for channel in rig.channels:
        columns |= {f"{channel.name}_{part}": rng.standard_normal(count) for part in ("re", "im")}
        if noise:
            columns[f"{channel.name}_sd"] = rng.uniform(0.01, 0.02, count)
    ends = tuple(int(end) for end in np.cumsum(lines))
    return HeldRows(tuple(f"r{k}" for k in range(RIGS)), "all.parquet", ends, columns, {})


def cuts_and_failures(rig: Rig, rows: HeldRows) -> tuple[dict[int, Any], dict[int, str]]:
    failures: dict[int, str] = {}
    reader = PartReader(rig, Treatment(), lambda k, error: failures.update({k: str(error)}))
    return reader.cuts(rows), failures


def spoilt(rows: HeldRows, name: str, row: int, value: float) -> HeldRows:
    values = rows.columns[name].copy()
    values[row] = value
    return replace(rows, columns={**rows.columns, name: values})


@pytest.mark.parametrize("case", ["sound", "gap", "negative", "empty channel", "no noise"])
def test_rows_read_at_once_are_as_each_alone(rig: Rig, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    rows = rows_of(rig, rng, noise=case != "no noise")
    channel = rig.channels[0].name
    if case == "gap":
        rows = spoilt(rows, f"{channel}_im", 2 * LINES, np.nan)
    if case == "negative":
        rows = spoilt(spoilt(rows, f"{channel}_sd", 0, -1.0), f"{channel}_sd", LINES, -2.0)
    if case == "empty channel":  # of one rig, which alone is refused
        for line in range(3 * LINES, 4 * LINES):
            rows = spoilt(spoilt(rows, f"{channel}_re", line, np.nan), f"{channel}_im", line, np.nan)
    together, failures = cuts_and_failures(rig, rows)
    monkeypatch.setattr(runner, "AT_ONCE", 1)
    alone, failures_alone = cuts_and_failures(rig, rows)
    assert failures == failures_alone
    wrong = {"gap": {2}, "negative": {0, 1}, "empty channel": {3}}.get(case, set())
    assert set(failures) == wrong
    assert set(together) == set(alone) == set(range(RIGS)) - wrong
    for k, cut in together.items():
        one, other = cut.spectrum(), alone[k].spectrum()
        for name in ("frequency_hz", "amplitudes", "covariance", "samples", "dof", "experiment", "stretch"):
            assert np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True), name
        assert (one.noise, one.stretches) == (other.noise, other.stretches)
    assert sorted(map(len, alike_cuts(together))) == [1, RIGS - 1 - len(wrong)]


def test_alike_ones_are_a_batch(rig: Rig) -> None:
    cuts, _ = cuts_and_failures(rig, rows_of(rig, np.random.default_rng(2)))
    places = alike_cuts(cuts)[0]
    batch = stacked_cuts([cuts[k] for k in places])
    assert batch.batch == (RIGS - 1,)
    for i, k in enumerate(places):
        one = cuts[k].spectrum()
        assert np.array_equal(batch.amplitudes[i], one.amplitudes)
        assert np.array_equal(batch.covariance[i], one.covariance)


def test_a_rig_that_is_wrong_does_not_slow_the_others(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of many is found by halving, not by reading all one by one."""
    rows = spoilt(rows_of(rig, np.random.default_rng(3)), f"{rig.channels[0].name}_sd", 0, -1.0)
    calls: list[int] = []
    usual = HeldRows.some

    def counted(self: HeldRows, first: int, end: int) -> HeldRows:
        calls.append(end - first)
        return usual(self, first, end)

    monkeypatch.setattr(HeldRows, "some", counted)
    _, failures = cuts_and_failures(rig, rows)
    assert list(failures) == [0]
    assert sorted(calls) == [1, 1, 2, 2, 4, 5, 9]
