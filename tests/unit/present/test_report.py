"""The report of an identification."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from dashpot import Estimate, IdentifiabilityError, Kind, between, identify, method
from dashpot.check.diagnosis.diagnose import examined
from dashpot.check.residuals import residuals
from dashpot.model.nonlinear.force_law import force_law
from dashpot.present.document import Document, Provenance, SourceFile
from dashpot.present.estimate import parameter_rows
from dashpot.present.identification import failure_report, identification_report
from dashpot.present.page import page_html
from dashpot.present.words import short
from tests.unit.present.conftest import RIG, measured


class Page(HTMLParser):
    """Tags that are open at the end, and addresses outside the page."""

    VOID = frozenset({"meta", "br", "path", "use", "rect", "circle", "animate", "image"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.outside: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        for name, value in attrs:
            if (
                name in ("src", "href", "xlink:href")
                and value is not None
                and not value.startswith(("#", "data:"))
            ):
                self.outside.append(value)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag in self.VOID:
            return
        assert self.open.pop() == tag


PROVENANCE = Provenance(
    "2031-02-03 04:05 +0000",
    (("dashpot", "9.9"),),
    "dashpot identify rig.toml 'a&b.csv'",
    "/home/me",
    (("--level", "0.95", False), ("--seed", "7", True)),
    (SourceFile("a&b.csv", 1234, "0123abcd"),),
)


def page_of(html: str) -> Page:
    """The page, whose tags must be closed and which must ask for nothing outside."""
    page = Page()
    page.feed(html)
    assert page.open == []
    assert page.outside == []
    assert (
        html.count("<script") == page.seen.count("script") <= 1
    )  # the figures' own, which the page's policy names
    own = re.search("<script>(.*?)</script>", html, re.DOTALL)
    digest = hashlib.sha256(own[1].encode() if own else b"").digest()
    assert f"script-src 'sha256-{base64.b64encode(digest).decode()}'" in html
    return page


def test_the_report_stands_alone(good: Estimate) -> None:
    html = identification_report(RIG.model, measured(), good, 0.95, PROVENANCE)
    assert html == identification_report(RIG.model, measured(), good, 0.95, PROVENANCE)
    page_of(html)
    assert "&lt;script&gt;" in html
    for title in (
        "Parameters",
        "What next",
        "Modes",
        "Measured and model",
        "Residuals",
        "Correlation",
        "Information by frequency",
    ):
        assert f"<h2>{title}" in html
    for row in parameter_rows(good):
        assert row.value in html
    for text in (
        "2031-02-03",
        "dashpot 9.9",
        "identify rig.toml",
        "/home/me",
        '<b><span class="option">--seed</span> 7</b>',
        "0123abcd",
        "a&amp;b.csv",
    ):
        assert text in html
    assert html.index("Parameters") < html.index("What next") < html.index("<h2>Modes")


def test_numbers_are_those_of_the_json_and_of_the_pictures() -> None:
    estimate = examined(RIG.model, measured(), identify(RIG.model, measured()))
    html = identification_report(RIG.model, measured(), estimate)
    content = json.loads(estimate.to_json())
    assert estimate.assessment is not None
    worst = content["fit"]["worst"][0]
    label = f"{worst['channel']}, {worst['frequency_hz']:.4g} Hz: {worst['sd']:.2g}"
    assert label in html  # in the picture
    assert f"The largest is {worst['sd']:.2g}: {worst['channel']} at" in html
    found = residuals(RIG.model, estimate.values, measured())
    assert np.nanmax(np.abs(found.normalised)) / np.sqrt(2) == worst["sd"]
    for name, part in content["fit"]["relative_residual"].items():
        assert f"{100 * part:.2g} % at {name}" in html
    for name, value in content["parameters"].items():
        shown = next(row for row in parameter_rows(estimate) if row.name == name)
        assert abs(float(shown.value) - value["value"]) <= max(0.06 * value["sd"], 1e-9 * abs(value["value"]))


def drawn_panels(html: str, name: str) -> list[dict[str, Any]]:
    """The panels of a page's figures whose vertical axis has that name, as the script reads them."""
    figures = [json.loads(unescape(text)) for text in re.findall('data-panels="([^"]*)"', html)]
    return [panel for panels in figures for panel in panels if panel["y"].get("name") == name]


@pytest.mark.parametrize("case", ["fits", "misfit", "not converged"])
def test_the_verdict_comes_first_and_the_largest_residual_is_that_of_the_plot(
    case: str, good: Estimate, bad: Estimate
) -> None:
    spectrum = measured(extra=0.2 if case == "misfit" else 0.0)
    estimate = {
        "fits": examined(RIG.model, spectrum, good),
        "misfit": examined(RIG.model, spectrum, bad),
        "not converged": replace(good, values=1.3 * good.values, converged=np.asarray(False)),
    }[case]
    html = identification_report(RIG.model, spectrum, estimate)
    said = {
        "fits": "The model fits",
        "misfit": "The model does not fit",
        "not converged": "No answer: the iteration",
    }
    assert html.index(said[case]) < min(html.index("<svg"), html.index("<h2>Parameters"))
    assert ('class="verdict bad"' in html[: html.index(said[case])]) == (case != "fits")
    assert ("Do not use these values" in html) == (case == "not converged")
    (panel,) = drawn_panels(html, "residual")
    points = [
        (size, series["name"], f)
        for series in panel["series"]
        for f, size in zip(series["x"], series["y"], strict=True)
    ]
    size, name, f = max(points)
    assert f"The largest is {short(size, 2)}: {name} at {short(f, 4)} Hz." in html
    assert f"{name}, {f:.4g} Hz: {short(size, 2)}<" in html
    assert panel["y"]["limits"][1] > size  # which the axis shows
    for series in panel["series"]:
        rms = np.sqrt(np.mean(np.square(series["y"])))
        assert f"{series['name']} {short(float(rms), 2)}" in html
    assert all(panel["x"]["limits"][0] <= f <= panel["x"]["limits"][1] for _, _, f in points)
    low, high = (short(float(end), 4) for end in (spectrum.frequency_hz.min(), spectrum.frequency_hz.max()))
    assert f"{spectrum.lines} lines from {low} to {high} Hz" in html


@pytest.mark.parametrize("name", ["oiv", "wls"])
def test_iterations_are_said_as_they_were_and_none_are_drawn(name: str) -> None:
    """A plot of them once ended before their number."""
    estimate = identify(RIG.model, measured(), method(name))
    html = identification_report(RIG.model, measured(), estimate)
    count = json.loads(estimate.to_json())["iterations"]
    assert ("in closed form" if count == 0 else f"converged in {count} iteration") in html
    panels = [json.loads(unescape(text)) for text in re.findall('data-panels="([^"]*)"', html)]
    axes = {panel["x"].get("name") for figure in panels for panel in figure if "x" in panel}
    assert axes
    assert not any("iteration" in (name or "") for name in axes)
    assert len(estimate.history) <= count + 1
    np.testing.assert_allclose(estimate.history[-1], estimate.values, rtol=1e-6)


def test_where_nothing_is_determined_the_report_says_so() -> None:
    error = IdentifiabilityError("the data fix only k1 + k2", cure="give one of them a value")
    html = failure_report(RIG.model, RIG.channels, error, PROVENANCE)
    page_of(html)
    for text in ("do not determine", "The data fix only k1 + k2.", "Give one of them a value.", "<svg"):
        assert text in html


@pytest.mark.parametrize("cubic", [False, True])
def test_nonlinear_rigs_and_whole_records_need_no_spectrum(good: Estimate, cubic: bool) -> None:
    """Of a nonlinear rig it is said once that the values hold for motions as large as those of the test."""
    joint = replace(between("k3", Kind.SPRING, "x1", "ground", value=1e9), force_law=force_law("cubic"))
    model = replace(RIG.model, elements=(*RIG.model.elements, joint)) if cubic else RIG.model
    html = identification_report(model, None, good, channels=RIG.channels)
    page_of(html)
    assert "<h2>Intervals" in html
    assert "<h2>Residuals" not in html
    assert html.count("The rig is nonlinear (k3)") == cubic


def test_commands_and_lines_of_rig_files_are_code_and_no_option_is_broken() -> None:
    step = (
        "Try [springs] k = { at = x }. Fall to 7.6 × <b>. dashpot identify --apply NEW.toml writes it. See dashpot "
        "check rig.toml."
    )
    page = page_html(Document("a", headline="c", steps=(step,)))
    assert '<code>dashpot identify <span class="option">--apply</span> NEW.toml</code> writes' in page
    assert "<code>dashpot check rig.toml</code>." in page
    assert "Try <code>[springs] k = { at = x }</code>. Fall" in page
    assert "&lt;b&gt;" in page
