"""Elements that whole records of nonlinear rigs call for beside those that the rig has."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.explain.in_time import examined_records
from dashpot.data.record import Record
from dashpot.estimate.assessment import Assessment, applied
from dashpot.estimate.nonlinear.whole_record import fit_records
from dashpot.model.elements import Kind, between
from dashpot.model.nonlinear.force_law import Constant, force_law
from dashpot.model.nonlinear.integration import Integrator
from tests.nonlinear_rigs import motions, two_masses
from tests.unit.estimate.nonlinear.test_whole_record import record

ALL = motions("x1", "x2", "u")


def judged(law: str, data: Record) -> Assessment:
    model, _ = two_masses(law)
    fitted = fit_records(model, [data])
    assessment = examined_records(model, [data], fitted.estimate(), fitted).assessment
    assert assessment is not None
    return assessment


@pytest.mark.long
def test_another_law_than_the_rig_has_is_named_and_makes_it_no_fit() -> None:
    _, theta, data = record("v*abs(v)", ALL, noise=0.02)
    assessment = judged("cubic", data)
    assert assessment.verdict == "does not fit"
    assert [reason.code for reason in assessment.reasons] == ["element_called_for"]
    finding = assessment.findings[0]
    assert (finding.kind, finding.of, finding.remaining) == ("nonlinear", ("x2", "u"), None)
    assert "damping that grows with speed" in finding.text
    assert finding.number == pytest.approx(theta[-1], rel=0.3)
    assert finding.odds is not None
    assert 0.9 < finding.odds < 1
    mended, _ = applied(two_masses("cubic")[0], ALL, finding)
    assert mended.elements[-1].kind is Kind.DAMPER


@pytest.mark.long
@pytest.mark.parametrize("mistake", ["delay", "gain", "time"])
def test_a_mistake_of_a_channel_is_named_by_the_same_engine(mistake: str) -> None:
    """x1 two samples late, 15 % too large, or four samples short; 1 % noise, seed 7."""
    _, _, data = record("cubic", ALL, noise=0.01, seed=7)
    values = data.values.copy()
    match mistake:
        case "delay":
            values[2:, 0] = data.values[:-2, 0]
            data = data.part(slice(2, None))
            values = values[2:]
        case "gain":
            values[:, 0] *= 1.15
        case "time":
            values[400:-4, 0] = data.values[404:, 0]
    first = judged("cubic", replace(data, values=values)).findings[0]
    assert first.kind == mistake
    assert first.of[0] == "x1"


@pytest.mark.long
@pytest.mark.parametrize("colour", [0.0, 0.95])
def test_noise_calls_for_nothing_whatever_its_colour_or_course(colour: float) -> None:
    """Of the displacements, in proportion to them, and of the base; seed 4."""
    rng = np.random.default_rng(4)
    _, _, data = record("cubic", ALL)
    e = rng.standard_normal((len(data.time) + 200, 3))
    for k in range(1, len(e)):
        e[k] += colour * e[k - 1]
    e = e[200:] / np.std(e)
    for noisy in (
        data.values + np.std(data.values, axis=0) * e * [0.03, 0.03, 0.0],
        data.values * (1 + 0.05 * e * [1.0, 1.0, 0.0]),
        data.values + np.std(data.values, axis=0) * e * [0.01, 0.01, 0.03],
    ):
        assert judged("cubic", replace(data, values=noisy)).verdict == "cannot tell"


def test_candidates_with_a_state_are_found_from_the_motion_of_the_rig(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each was followed from sample to sample before, which took most of the time of a verdict."""
    _, _, data = record("cubic", ALL, noise=0.01, samples=400)
    fitted = fit_records(two_masses("cubic")[0], [data])
    slider = between("s", Kind.SPRING, "x1", "u")
    slider = replace(slider, force_law=force_law("jenkins", [Constant("slip", 3e-4)]))
    afresh, at, (place,) = fitted.problem.with_elements(fitted.psi, [slider])
    expected = afresh.afresh().sure_residuals(at)[0][1]
    follow, segments = Integrator.follow, list[int]()
    monkeypatch.setattr(
        Integrator,
        "follow",
        lambda self, begun, *how: segments.append(len(begun)) or follow(self, begun, *how),
    )
    slopes = fitted.problem.with_elements(fitted.psi, [slider])[0].sure_residuals(at)[0][1]
    assert min(segments) > 1
    column = expected[..., place]
    assert np.max(np.abs(slopes[..., place] - column)) < 1e-6 * np.max(np.abs(column))
