"""The JSON of an estimate is all that it needs: its rig and its lines, its covariance where that is not too large."""

import json
from pathlib import Path

import numpy as np
import pytest

import dashpot
from dashpot import DataError, Estimate, identify
from dashpot.estimate import result as estimate_json
from tests.partly_seen import noisy_base
from tests.two_masses import RIG, VALUES

DWELLS, WHOLE = "dwells", "a whole record"


def test_above_a_size_the_covariance_is_null(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = noisy_base()
    estimate = identify(bench.model, bench.spectrum(np.random.default_rng(2)))
    whole = json.loads(estimate.to_json())
    assert whole["covariance"] == estimate.covariance.tolist()
    monkeypatch.setattr(estimate_json, "MOST_COVARIANCE", len(estimate.names) - 1)
    text = estimate.to_json()
    assert json.loads(text)["covariance"] is None
    assert json.loads(text)["noise_covariance"] is None
    again = Estimate.from_json(text)
    np.testing.assert_array_equal(again.values, estimate.values)
    np.testing.assert_allclose(again.sd, estimate.sd, rtol=1e-15)
    np.testing.assert_allclose(again.interval(), estimate.interval(), rtol=1e-12)


def made_of(kind: str) -> Estimate:
    """An estimate of a rig that no file describes."""
    rig = dashpot.parse_rig(RIG)
    if kind == DWELLS:
        return rig.identify(list(rig.simulate(VALUES, "1:15/8log", amplitudes={"u": 0.01}, seed=1)))
    rng, time = np.random.default_rng(4), np.arange(400) / 100
    moved = np.convolve(rng.standard_normal(len(time)), np.hanning(9), "same") * 5e-3
    return rig.identify(list(rig.simulate(VALUES, {"time_s": time, "u": moved}, seed=1)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [DWELLS, WHOLE])
def test_an_estimate_carries_its_rig_and_its_lines(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where there is no rig file
    estimate = made_of(kind)
    text = estimate.to_json()
    again = Estimate.from_json(text)
    assert again.to_json() == text
    assert estimate.assessment is not None
    assert again.assessment is not None
    before, after = estimate.assessment.residuals, again.assessment.residuals
    assert before is not None
    assert after is not None
    assert before.transients == after.transients == (kind == WHOLE)
    for name in ("measured", "predicted", "sd", "inputs", "normalised"):
        # Each part has 7 digits, so that it is off by 5e-7 at most; differences of them by as many times more as the
        # motion is larger than its noise.
        first, second = getattr(before, name), getattr(after, name)
        np.testing.assert_array_equal(np.isnan(first), np.isnan(second))
        off = np.abs(np.nan_to_num(first) - np.nan_to_num(second))
        scale = 1.0 if name == "normalised" else np.max(np.abs(first), axis=0) + 1e-300
        assert np.max(off / scale) < (1e-2 if name == "normalised" else 7.1e-7)
    known, of_json = estimate.frf("x1", "u", [2.0, 9.0]), again.frf("x1", "u", [2.0, 9.0])
    np.testing.assert_allclose(of_json, known, rtol=1e-9)
    wish = {"time_s": np.arange(50) / 100, "u": 1e-3 * np.sin(np.arange(50))}
    np.testing.assert_allclose(again.simulate(wish)[0].values, estimate.simulate(wish)[0].values, rtol=1e-9)
    both = [each.with_values(m1=3.5).modes for each in (estimate, again)]
    assert both[0] is not None
    assert both[1] is not None
    np.testing.assert_allclose(both[1].frequency_hz, both[0].frequency_hz, rtol=1e-12)
    points = [
        [line.get_xydata() for axes in figure.axes for line in axes.lines]
        for figure in (estimate.plot(), again.plot())
    ]
    assert sum(len(each) for each in points[0]) > 2 * len(
        before.frequency_hz
    )  # measured points and the model's
    for first, second in zip(*points, strict=True):
        np.testing.assert_allclose(second, first, rtol=1e-5, atol=1e-4)  # phases of 7e-7 rad, in degrees
    assert len(again.plot(values=True).axes) == len(again.names)


@pytest.mark.slow
def test_the_report_of_a_read_estimate_has_its_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    again = Estimate.from_json(made_of(WHOLE).to_json())
    page = Path(again.report("again.html")).read_text(encoding="utf-8")
    for words in (
        "Measured and model",
        "end transients are subtracted",
        "In the complex plane",
        "Residuals",
        "lines from",
    ):
        assert words in page


def test_too_many_lines_and_rigs_of_several_files_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimate = made_of(DWELLS)
    monkeypatch.setattr(estimate_json, "MOST_AMPLITUDES", 8 * 3 - 1)
    content = json.loads(estimate.to_json())
    assert "lines" not in content
    assert "m1 = " in content["rig_text"]
    monkeypatch.chdir(tmp_path)
    Path("more.csv").write_text("5,0\n0,0\n", encoding="utf-8")
    rig = dashpot.parse_rig(
        RIG.replace("[channels]", '[blocks]\nmore = { matrix = "K", file = "more.csv" }\n[channels]')
    )
    data = list(rig.simulate(VALUES, "1:15/8log", amplitudes={"u": 0.01}, seed=1))
    assert "rig_text" not in json.loads(rig.identify(data).to_json())


def test_a_damaged_rig_is_named_when_it_is_asked_for() -> None:
    content = json.loads(made_of(DWELLS).to_json())
    content["rig_text"] = content["rig_text"].replace("[springs]", "[strings]")
    with pytest.raises(dashpot.DashpotError, match="strings"):
        Estimate.from_json(json.dumps(content)).frf("x1", "u", [2.0])
    content["rig_text"] = 5
    with pytest.raises(DataError, match="the rig is not text"):
        Estimate.from_json(json.dumps(content))


def test_lines_that_do_not_belong_together_are_refused() -> None:
    content = json.loads(made_of(DWELLS).to_json())
    content["lines"]["channels"]["x1"]["measured"]["re"].pop()
    with pytest.raises(DataError, match="this is not a dashpot estimate"):
        Estimate.from_json(json.dumps(content))
