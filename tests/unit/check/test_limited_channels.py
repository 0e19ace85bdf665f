"""Channels of whole records that end: the only motion of a rig as well, where nothing contradicts it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import dashpot
from dashpot.arrays import Real
from dashpot.check.explain import examine
from dashpot.estimate.assessment import Assessment
from tests.whole_rigs import chain, record_of


def judged(shape: Callable[[Real], Real]) -> Assessment:
    """One mass on a shaken base, its motion as a sensor of this shape shows it, 1 % noise."""
    rig = chain(1, 0.03, base=True, seed=3)
    record = record_of(*rig, "random", samples_per_cycle=10, decay_times=5, seed=2).record
    values = np.array(record.values)
    size = float(values[:, 0].std())
    values[:, 0] = size * shape(values[:, 0] / size)
    noise = np.random.default_rng(5).normal(size=len(values))
    values[:, 0] += 0.01 * size * noise
    assessment = dashpot.identify(rig[0], replace(record, values=values), diagnose=True).assessment
    assert assessment is not None
    return assessment


@pytest.mark.slow
@pytest.mark.parametrize(
    "shape",
    [lambda x: np.minimum(x, 1.2), lambda x: np.clip(x, -1.75, 1.75), lambda x: 1.5 * np.tanh(x / 1.5)],
    ids=["clipped on one side", "clipped where it moves most", "saturated"],
)
def test_a_single_channel_that_ends_is_no_fit_and_is_named(shape: Callable[[Real], Real]) -> None:
    """A mass was 26 deviations off and nothing was said."""
    assessment = judged(shape)
    assert assessment.verdict == "does not fit"
    assert "limited_channel" in [reason.code for reason in assessment.reasons]
    first = assessment.findings[0]
    assert (first.kind, first.of) == ("saturation", ("x1_dis",))
    assert first.odds > 0.9


@pytest.mark.slow
def test_a_channel_that_ends_leads_where_of_the_list_it_only_comes_nearest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is seen in the record and found in the list as well counted for less than what is seen alone."""
    explained = examine.explained
    monkeypatch.setattr(
        examine, "explained", lambda *of, **more: replace(explained(*of, **more), unlisted=1.0)
    )
    findings = judged(lambda x: np.minimum(x, 1.2)).findings
    assert (findings[0].kind, findings[0].of) == ("saturation", ("x1_dis",))
    assert "unexplained" not in [each.kind for each in findings]


def test_a_channel_that_does_not_end_is_left_alone() -> None:
    assessment = judged(lambda x: x)
    assert assessment.findings == ()
    assert "limited_channel" not in [reason.code for reason in assessment.reasons]
