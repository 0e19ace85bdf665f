"""Plans as JSON and as tables."""

from __future__ import annotations

import json

import pytest

from dashpot.design.plan_files import answer_to_json, plan_to_csv
from tests.designs import advised, paper_setup


def test_files() -> None:
    said = advised(paper_setup(), settle=0.5)
    content = json.loads(answer_to_json(said))
    assert [d["samples"] for d in content["dwells"]] == [d.samples for d in said.plan.dwells]
    assert content["dwells"][0]["amplitudes"] == {"u": 1e-3}
    assert content["predicted"]["m1"]["sd"] == pytest.approx(said.plan.predicted.sd[0])
    assert content["gap"] < 1e-6
    rows = plan_to_csv(said.plan, {"u": "N·m"}).splitlines()
    assert rows[0] == "dwell,frequency_hz,u_amplitude_Nm,settle_s,periods,time_s,samples"
    assert len(rows) == 1 + len(said.plan.dwells)
