"""The verdict of parts that are merged: of their estimates together, and of how many fit by themselves."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dashpot.check.explain.examine import examined
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.assessment import Assessment, Judgement
from dashpot.estimate.identify import identify
from dashpot.estimate.result import Estimate
from dashpot.fleet.record_parts import merged_parts
from dashpot.model.observation import with_relative_noise
from dashpot.model.rigfile import parse_rig
from dashpot.notices import Notice
from dashpot.study.simulate import dwells, simulate_spectrum
from tests.two_masses import RIG, VALUES

READ = parse_rig(RIG)
CHANNELS = with_relative_noise(READ.model, READ.channels, 0.02)
NAMES = [f"part{k}" for k in range(6)]


@cache
def parts(changed: tuple[float, ...] = (1.0,) * 6, turned: tuple[int, ...] = ()) -> list[Estimate]:
    """Estimates of six tests: m1 `changed` times as large in each, x1's sensor turned round in some."""
    rng, made = np.random.default_rng(1), []
    for k, times in enumerate(changed):
        theta = READ.model.theta(VALUES) * np.array([times, 1.0, 1.0])
        test = dwells(READ.model, np.linspace(1.5, 14, 12), 40)
        spectrum = simulate_spectrum(READ.model, READ.model.parameters(theta), CHANNELS, test, rng)
        if k in turned:
            spectrum = with_x1_turned(spectrum)
        made.append(examined(READ.model, spectrum, identify(READ.model, spectrum, "ml")))
    return made


def with_x1_turned(spectrum: Spectrum) -> Spectrum:
    amplitudes = spectrum.amplitudes.copy()
    amplitudes[..., spectrum.index("x1")] *= -1
    return replace(spectrum, amplitudes=amplitudes)


def assessed(estimates: Sequence[Estimate]) -> Assessment:
    assessment = merged_parts(READ.model, NAMES[: len(estimates)], estimates).assessment
    assert assessment is not None
    return assessment


def judged(estimate: Estimate, verdict: Judgement, *reasons: Notice) -> Estimate:
    assert estimate.assessment is not None
    return replace(estimate, assessment=replace(estimate.assessment, verdict=verdict, reasons=reasons))


def test_sound_parts_fit_together_and_it_is_said_how_they_scatter() -> None:
    estimate = merged_parts(READ.model, NAMES, parts())
    assert estimate.assessment.verdict == "fits"
    assert estimate.notes[0].code == "parts_merged"
    assert str(estimate.notes[0]).startswith("6 parts of the data")
    assert set(estimate.assessment.relative_residual) == {"x1", "x2"}
    for name, left in estimate.assessment.relative_residual.items():
        assert 0.5 < left / estimate.assessment.relative_noise[name] < 1.6  # a few loud lines decide
    assert len(estimate.assessment.worst) == 3


def test_a_rig_that_changes_on_the_way_is_told_with_the_part_that_lies_off() -> None:
    assessment = assessed(parts((1.0, 1.0, 1.0, 1.2, 1.0, 1.0)))
    assert assessment.verdict == "does not fit"
    told = next(reason for reason in assessment.reasons if reason.code == "parts_disagree")
    assert "m1 of part3" in told.text
    assert told.text.endswith("above the merged one")
    assert told.of == ("m1",)


@pytest.mark.slow
def test_causes_are_those_that_most_parts_name() -> None:
    assessment = assessed(parts((1.0,) * 3, turned=(0, 1, 2)))
    assert assessment.verdict == "does not fit"
    assert {"chi2", "parts_misfit"} <= {reason.code for reason in assessment.reasons}
    assert (assessment.findings[0].kind, assessment.findings[0].of) == ("sign", ("x1",))


def test_one_false_alarm_of_many_parts_is_none_and_several_are_a_misfit() -> None:
    sound, alarm = parts(), Notice("smooth_residuals", "the residuals of x1 run smoothly", ("x1",))
    once = [judged(sound[0], "does not fit", alarm), *sound[1:]]
    assert assessed(once).verdict == "fits"
    often = [*(judged(each, "does not fit", alarm) for each in sound[:3]), *sound[3:]]
    told = assessed(often)
    assert told.verdict == "does not fit"
    assert str(told.reasons[-1]) == (
        "3 of 6 parts do not fit on their own: the residuals of x1 run smoothly (part0)"
    )


@pytest.mark.parametrize(("unsure", "verdict"), [(6, "cannot tell"), (4, "cannot tell"), (3, "fits")])
def test_most_parts_cannot_tell(unsure: int, verdict: str) -> None:
    doubt = Notice("no_noise", "the noise is not known")
    sound = parts()
    estimates = [*(judged(each, "cannot tell", doubt) for each in sound[:unsure]), *sound[unsure:]]
    assert assessed(estimates).verdict == verdict
