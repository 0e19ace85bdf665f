"""Evidence in reports: profiles where they differ."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot import Spectrum, dwells, identify, simulate_spectrum
from dashpot.check.evidence import evidence_of
from dashpot.check.profile import profile
from dashpot.check.validation import RecordPrediction
from dashpot.present import validation
from dashpot.present.document import Paragraph, Picture
from dashpot.present.identification import identification_report
from dashpot.present.validation import prediction_section
from dashpot.present.words import short
from tests.unit.present.conftest import RIG, VALUES


def noisy(noise: float) -> Spectrum:
    """Three dwells of the rig with that noise of each sample."""
    channels = tuple(
        channel if channel.noise is None else replace(channel, noise=noise) for channel in RIG.channels
    )
    rng = np.random.default_rng(3)
    p = RIG.model.parameters(RIG.model.theta(VALUES))
    return simulate_spectrum(RIG.model, p, channels, dwells(RIG.model, [1.0, 5.0, 7.0], 200), rng)


def test_profiles_are_shown_where_the_normal_interval_misleads() -> None:
    good, poor = noisy(0.01), noisy(1.0)
    sure = identify(RIG.model, good)
    assert evidence_of(RIG.model, good, sure).profiles == ()
    unsure = identify(RIG.model, poor)
    found = evidence_of(RIG.model, poor, unsure).profiles
    misled = [name for name in unsure.names if profile(RIG.model, poor, name, 0.95, unsure).misleads]
    assert misled
    assert [each.name for each in found] == misled
    html = identification_report(RIG.model, poor, unsure)
    assert "Profiles that differ" in html
    assert "Profiles that differ" not in identification_report(RIG.model, good, sure)


def test_histories_say_which_part_of_a_record_they_hold() -> None:
    values = np.full((3, 1), 1e-3 + 0j)
    sizes = np.ones(1), np.ones(1), np.full(1, 6.0)
    record = RecordPrediction(("x",), ("m",), np.array([1.0, 1.5, 2.0]), values, values, *sizes, 2.0, 40)
    texts = [
        block.text
        for block in prediction_section("In time", (record,)).blocks
        if isinstance(block, Paragraph)
    ]
    assert any("2.000 s and hold the 3 lines from 1.000 to 2.000 Hz" in text for text in texts)


def test_the_fit_in_words_is_that_of_the_curves(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    truth = rng.standard_normal((40, 2)) + 1j * rng.standard_normal((40, 2))
    off = 0.1 * (rng.standard_normal((40, 2)) + 1j * rng.standard_normal((40, 2)))
    fit = 1 - np.linalg.norm(off, axis=0) / np.linalg.norm(truth, axis=0)
    record = RecordPrediction(
        ("x", "y"), ("m", "m"), np.arange(1, 41) / 2.0, truth, truth - off, fit, np.ones(2), np.full(2, 80.0), 2.0, 400,
    )  # fmt: skip
    figures = []
    monkeypatch.setattr(
        validation, "figure_picture", lambda figure, text: figures.append(figure) or Picture("", text)
    )
    said = prediction_section("In time", (record,)).blocks[0]
    (figure,) = figures
    for axes in figure.axes:
        drawn = {line.get_label(): np.asarray(line.get_ydata()) for line in axes.get_lines()}
        channel = record.channels.index(axes.get_title(loc="left") or axes.get_ylabel()[:1])
        away = np.linalg.norm(drawn["difference"]) / np.linalg.norm(drawn["measured"])
        assert 1 - away == pytest.approx(fit[channel], rel=1e-9)
        assert f"{record.channels[channel]} {short(100 * (1 - float(away)), 3)} %" in said.text


def test_profiles_of_estimates_that_are_no_minimum_are_left_out() -> None:
    poor = noisy(1.0)
    least_squares = replace(identify(RIG.model, poor), method="ls")
    assert evidence_of(RIG.model, poor, least_squares).profiles == ()
