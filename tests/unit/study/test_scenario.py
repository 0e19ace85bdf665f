"""Scenarios whose dwells do not wait for the steady state."""

from pathlib import Path

import numpy as np
import pytest

from dashpot.errors import UsageError
from dashpot.estimate.identify import identify
from dashpot.study.scenario import Scenario, scenarios
from dashpot.study.studyfile import read_study
from tests.two_masses import one_mass

RIG = one_mass("u", "value = 1", "guess = 900", "guess = 0.6", {"x": "noise = 0.02", "u": ""})
STUDY = """\
draws = 80
methods = ["ml"]
periods = 6
transients = TRANSIENTS
[rigs.one]
file = "rig.toml"
[frequencies]
few = [3, 4.5, 6]
[[grid]]
kind = "channels"
samples = [120]
"""


def scenario(folder: Path, transients: str = "true", more: str = "") -> Scenario:
    (folder / "rig.toml").write_text(RIG)
    text = more + STUDY.replace("TRANSIENTS", transients)
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return scenarios(read_study(folder / "study.toml"))[0]


def test_dwells_with_transients_reach_their_bound(tmp_path: Path) -> None:
    """80 draws of two unknowns: rms error over the bound 1 ± 3 / √(2 · 160) = ± 0.17, seed 0."""
    short = scenario(tmp_path)
    bound = short.bound_sd()
    found = identify(short.model, short.drawn(np.random.default_rng(0), 80), "ml")
    assert np.sqrt(np.mean(((found.values - short.theta) / bound) ** 2)) == pytest.approx(1.0, abs=0.17)
    assert np.median(found.sd, axis=0) == pytest.approx(bound, rel=0.03)  # a misfit by chance widens a few
    settled = scenario(tmp_path, "false")
    assert settled.fingerprint != short.fingerprint
    assert np.all(settled.bound_sd() < 2 * bound)


def test_what_does_not_go_with_transients_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no drift"):
        scenario(tmp_path, more="drift = 1\n").bound_sd()
    with pytest.raises(UsageError, match="neither true nor"):
        scenario(tmp_path, '"yes"')
