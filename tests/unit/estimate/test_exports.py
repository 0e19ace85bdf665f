"""Estimates in the terms of other libraries."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from dashpot import Element, Kind, UsageError, identify
from tests.partly_seen import noisy_base


@pytest.fixture(scope="module")
def estimate():
    bench = noisy_base()
    tied = tuple(
        Element(e.name, e.kind, e.along, same_as="c1", times=2.0) if e.name == "c3" else e
        for e in bench.model.elements
    )
    assert any(e.kind is Kind.DAMPER for e in tied)
    model = replace(bench.model, elements=tied)
    return identify(model, bench.spectrum(np.random.default_rng(2)))


def test_a_table_of_all_parameters(estimate):
    pytest.importorskip("pandas")
    table = estimate.to_dataframe(level=0.9)
    assert list(table.index) == list(estimate.parameters())
    low, high = estimate.interval(0.9)
    for j, name in enumerate(estimate.names):
        row = table.loc[name]
        assert row["value"] == estimate[name].value
        assert (row["low"], row["high"]) == (low[j], high[j])
    assert table.loc["c3", "high"] == pytest.approx(2 * table.loc["c1", "high"])
    assert table.loc["m1", "known"]
    assert table.loc["m1", "sd"] == 0
    assert table.loc["k1", "unit"] == "N/m"


def test_numbers_carry_their_correlations(estimate):
    """The sd of k1/c1 is that by hand from the full covariance; a tied parameter varies with its root."""
    pytest.importorskip("uncertainties")
    numbers = estimate.to_uncertainties()
    ratio = numbers["k1"] / numbers["c1"]
    i, j = estimate.names.index("k1"), estimate.names.index("c1")
    k, c = estimate.values[[i, j]]
    slope = np.array([1 / c, -k / c**2])
    by_hand = np.sqrt(slope @ estimate.covariance[np.ix_([i, j], [i, j])] @ slope)
    assert ratio.std_dev == pytest.approx(by_hand, rel=1e-6)
    assert (numbers["c3"] - 2 * numbers["c1"]).std_dev == pytest.approx(0, abs=1e-9)
    assert numbers["m1"] == estimate.parameters()["m1"].value


def test_labelled_arrays_keep_batches(estimate):
    pytest.importorskip("xarray")
    data = estimate.to_xarray()
    assert float(data["covariance"].sel(parameter="k1", other="c1")) == pytest.approx(
        estimate.covariance[estimate.names.index("k1"), estimate.names.index("c1")]
    )
    assert data.attrs["method"] == estimate.method


@pytest.mark.parametrize(
    ("way", "module"),
    [("to_dataframe", "pandas"), ("to_uncertainties", "uncertainties"), ("to_xarray", "xarray")],
)
def test_what_is_missing_is_named_with_its_extra(estimate, way, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError, match=module) as caught:
        getattr(estimate, way)()
    assert ".[analysis]" in str(caught.value.problems[0].cure)


def test_a_batch_is_no_table():
    bench = noisy_base()
    batch = identify(bench.model, bench.spectrum(np.random.default_rng(2), 2))
    with pytest.raises(UsageError, match="batch"):
        batch.to_dataframe()
