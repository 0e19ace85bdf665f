"""Plans as JSON and as tables."""

from __future__ import annotations

import json

import pytest

from dashpot.design.criteria import AOptimal
from dashpot.design.plan import plan
from dashpot.design.plan_files import plan_to_csv, plan_to_json
from dashpot.design.schedule import Budget, band_grid
from tests.designs import BAND, paper_setup


def test_files() -> None:
    own = paper_setup()
    found = plan(own, AOptimal(), Budget(time=30, rate=100, settle=0.5), band_grid(own, *BAND))
    content = json.loads(plan_to_json(found))
    assert [d["samples"] for d in content["dwells"]] == [d.samples for d in found.dwells]
    assert content["dwells"][0]["amplitudes"] == {"u": 1.0}
    assert content["predicted"]["m1"]["sd"] == pytest.approx(found.predicted.sd[0])
    assert content["gap"] < 1e-6
    rows = plan_to_csv(found).splitlines()
    assert rows[0] == "dwell,frequency_hz,u_amplitude,settle_s,periods,time_s,samples"
    assert len(rows) == 1 + len(found.dwells)
