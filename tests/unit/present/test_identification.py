"""The report of an identification: what it says, shows and draws, against the JSON of the same estimate."""

import base64
import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from html import unescape
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from dashpot import (
    Estimate,
    IdentifiabilityError,
    Kind,
    Spectrum,
    between,
    dwells,
    identify,
    method,
    simulate_spectrum,
)
from dashpot.check.evidence import evidence_of
from dashpot.check.explain.examine import examined
from dashpot.check.profile import with_profile_intervals
from dashpot.check.validation import RecordPrediction
from dashpot.model.nonlinear.force_law import force_law
from dashpot.present import validation
from dashpot.present.document import Document, Paragraph, Picture, Provenance, SourceFile
from dashpot.present.estimate import parameter_rows
from dashpot.present.identification import failure_report, identification_report
from dashpot.present.page import page_html
from dashpot.present.validation import prediction_section
from dashpot.present.words import short
from tests.unit.present.conftest import RIG, VALUES, measured


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


@pytest.mark.slow
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
    order = (
        "Parameters",
        "Modes",
        "Measured and model",
        "Residuals",
        "Intervals",
        "What next",
        "How the data",
        "How it was",
    )
    places = [html.index(f"<h2>{title}") for title in order]
    assert places == sorted(places)
    assert "converged in" not in html[: html.index("<h2>What next")]  # nor what only an operator needs


def drawn_panels(html: str, name: str) -> list[dict[str, Any]]:
    """The panels of a page's figures whose vertical axis has that name, as the script reads them."""
    figures = [json.loads(unescape(text)) for text in re.findall('data-panels="([^"]*)"', html)]
    return [panel for panels in figures for panel in panels if panel["y"].get("name") == name]


Report = tuple[Spectrum, Estimate, str]


@pytest.fixture(scope="module")
def report(good: Estimate, bad: Estimate) -> Callable[[str], Report]:
    """Spectrum, estimate and report of a case, each made once."""

    @cache
    def of(case: str) -> Report:
        spectrum = measured(extra=0.2 if case == "misfit" else 0.0)
        if case == "not converged":
            estimate = replace(good, values=1.3 * good.values, converged=np.asarray(False))
        else:
            estimate = examined(RIG.model, spectrum, bad if case == "misfit" else good)
        return spectrum, estimate, identification_report(RIG.model, spectrum, estimate)

    return of


@pytest.mark.slow
@pytest.mark.parametrize("case", ["fits", "misfit", "not converged"])
def test_the_verdict_comes_first_and_the_largest_residual_is_that_of_the_plot(
    case: str, report: Callable[[str], Report]
) -> None:
    spectrum, _, html = report(case)
    said = {
        "fits": "The model fits",
        "misfit": "The model does not fit",
        "not converged": "No answer: the search",
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


@pytest.mark.slow
@pytest.mark.parametrize("name", [None, "wls"])
def test_iterations_are_said_as_they_were_and_none_are_drawn(
    name: str | None, report: Callable[[str], Report]
) -> None:
    """A plot of them once ended before their number."""
    _, estimate, html = report("fits")
    if name is not None:
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


@pytest.mark.slow
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


class Tables(HTMLParser):
    """The rows of cells of each table of a page, the head first."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("th", "td"):
            self.tables[-1][-1].append("")
            self.inside = True

    def handle_endtag(self, tag: str) -> None:
        self.inside = self.inside and tag not in ("th", "td")

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.tables[-1][-1][-1] += data.strip()


def tables(html: str) -> dict[str, list[dict[str, str]]]:
    """By the title of the first column, the rows as column title -> text."""
    parser = Tables()
    parser.feed(html)
    return {rows[0][0]: [dict(zip(rows[0], row, strict=True)) for row in rows[1:]] for rows in parser.tables}


def shows(text: str, value: float) -> bool:
    """Whether a number was rounded to that text."""
    digits, _, power = text.replace("\N{MINUS SIGN}", "-").partition("e")
    places = len(digits.partition(".")[2]) if "." in digits else len(digits.rstrip("0")) - len(digits)
    half = 0.5 * 10.0 ** (int(power or 0) - places)  # 190 may stand for 189.4
    return abs(float(text.replace("\N{MINUS SIGN}", "-")) - value) <= 1.001 * half


@pytest.fixture(scope="module", params=["fits", "misfit"])
def page(request: pytest.FixtureRequest, report: Callable[[str], Report]) -> tuple[str, dict[str, Any]]:
    """A report and the JSON of its estimate."""
    _, estimate, html = report(request.param)
    return html, json.loads(estimate.to_json())


@pytest.mark.slow
def test_tables_are_those_of_the_json(page: tuple[str, dict[str, Any]]) -> None:
    html, content = page
    of = tables(html)
    compared = 0
    for row in of["parameter"]:
        entry = content["parameters"][row["parameter"]]
        assert shows(row["value"], entry["value"]), row
        assert row["unit"] == entry["unit"]
        if row["± %"] == "":  # known, or tied to another
            continue
        low, high = row["95 % interval"].split(" … ")
        assert shows(row["±"], entry["sd"]), row
        assert shows(row["± %"], 100 * entry["sd"] / abs(entry["value"])), row
        assert shows(low, entry["interval95"][0]), row
        assert shows(high, entry["interval95"][1]), row
        compared += 1
    assert compared >= 4
    assert [row["unknown"] for row in of["unknown"]] == content["order"]
    for row in of["unknown"]:
        entry = content["parameters"][row["unknown"]]
        assert shows(row["±"], entry["sd"])
        assert shows(row["bound"], entry["bound_sd"])
    assert len(of["mode"]) == len(content["modes"])
    for row, mode in zip(of["mode"], content["modes"], strict=True):
        assert shows(row["frequency, Hz"], mode["frequency_hz"])
        assert shows(row["damping ratio"], mode["damping_ratio"])


def test_words_are_those_of_the_json(page: tuple[str, dict[str, Any]]) -> None:
    html, content = page
    text = unescape(re.sub(r"<(style|script|svg)\b.*?</\1>|<[^>]+>", " ", html, flags=re.DOTALL))
    fit = content["fit"]
    chi2, dof = re.search(r"χ² = ([\d.e]+), (\d+) degrees of freedom", text).groups()  # type: ignore[union-attr]
    assert shows(chi2, fit["chi2"])
    assert int(dof) == fit["dof"]
    times = re.search(r"([\d.]+) × the noise \(χ²", text)
    assert shows(times[1], np.sqrt(fit["chi2"] / fit["dof"]))
    p = re.search(r"p (=|<) ([\d.e-]+)\)", text)
    assert shows(p[2], fit["p"]) if p[1] == "=" else fit["p"] < float(p[2])
    parts = dict(reversed(pair) for pair in re.findall(r"([\d.]+) % at (\w+)", text))
    assert set(parts) == set(fit["relative_residual"])
    for name, part in parts.items():
        assert shows(part, 100 * fit["relative_residual"][name])
    told = re.search(r"noise alone would account for (.*?)\. ", text)
    noise, sizes = re.findall(r"[\d.]+", told[1]), list(fit["relative_noise"].values())
    ends = [min(sizes), max(sizes)][: len(noise)] if len(told[1].split()) in (2, 4) else sizes
    for part, size in zip(noise, ends, strict=True):
        assert shows(part, 100 * size)
    worst = re.findall(r"(\w+) at ([\d.]+) Hz \(([\d.]+) sd\)", text)
    assert len(worst) == len(fit["worst"]) > 0
    for (name, f, size), entry in zip(worst, fit["worst"], strict=True):
        assert name == entry["channel"]
        assert shows(f, entry["frequency_hz"])
        assert shows(size, entry["sd"])
    for cause in content["diagnosis"]:
        assert " ".join(cause["text"].split())[1:] in " ".join(text.split())
    verdicts = {"fits": "The model fits", "does not fit": "The model does not fit"}
    assert verdicts[fit["verdict"]] in text


def test_pictures_are_those_of_the_json(page: tuple[str, dict[str, Any]]) -> None:
    html, content = page
    figures = [json.loads(unescape(text)) for text in re.findall('data-panels="([^"]*)"', html)]
    panels = [panel for panels in figures for panel in panels]
    (correlation,) = [panel for panel in panels if panel["y"].get("name") == "correlation"]
    C = np.array(content["covariance"])
    expected = C / np.sqrt(np.outer(np.diag(C), np.diag(C)))
    cells = correlation["cells"]
    assert cells["rows"] == cells["columns"] == content["order"]
    np.testing.assert_allclose(np.array(cells["values"], dtype=float), expected, atol=1e-3)
    drawn = unescape(" ".join(re.findall(r"<text[^>]*>([^<]*)</text>", html)))  # in the drawing of the rig
    for name in content["order"]:
        value = re.search(rf"\b{name} = ([-\d.e]+)", drawn)
        assert value is not None, name
        assert shows(value[1], content["parameters"][name]["value"])


def noisy(noise: float) -> Spectrum:
    """Three dwells of the rig with that noise of each sample."""
    channels = tuple(
        channel if channel.noise is None else replace(channel, noise=noise) for channel in RIG.channels
    )
    rng = np.random.default_rng(3)
    p = RIG.model.parameters(RIG.model.theta(VALUES))
    return simulate_spectrum(RIG.model, p, channels, dwells(RIG.model, [1.0, 5.0, 7.0], 200), rng)


@pytest.mark.slow
def test_profiles_are_shown_of_the_intervals_that_follow_them() -> None:
    """The report states one interval for each unknown: where a profile is drawn, the table has its ends."""
    good, poor = noisy(0.01), noisy(1.0)
    sure = with_profile_intervals(RIG.model, good, identify(RIG.model, good))
    assert evidence_of(RIG.model, good, sure).profiles == ()
    unsure = with_profile_intervals(RIG.model, poor, identify(RIG.model, poor))
    found = evidence_of(RIG.model, poor, unsure).profiles
    assert found
    assert [each.name for each in found] == list(unsure.profiles)
    low, high = unsure.interval()
    for each in found:
        j = unsure.names.index(each.name)
        np.testing.assert_allclose([each.lower, each.upper], [low[j], high[j]], rtol=0.02)
    html = identification_report(RIG.model, poor, unsure)
    assert any(heading.startswith("Profiles") for heading in re.findall("<h[23]>([^<]*)", html))
    assert html.count("95 % interval from") == 0


def test_histories_say_which_part_of_a_record_they_hold() -> None:
    values = np.full((3, 1), 1e-3 + 0j)
    sizes = np.ones(1), np.ones(1), np.full(1, 6.0)
    record = RecordPrediction(("x",), ("m",), np.array([1.0, 1.5, 2.0]), values, values, *sizes, 2.0, 40)
    texts = [
        block.text
        for block in prediction_section("In time", (record,)).blocks
        if isinstance(block, Paragraph)
    ]
    assert any("2.000 s and contain the 3 lines from 1.000 to 2.000 Hz" in text for text in texts)


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
    unchanged = with_profile_intervals(RIG.model, poor, least_squares)
    assert evidence_of(RIG.model, poor, unchanged).profiles == ()


def test_the_first_page_says_what_the_values_rest_on(page: tuple[str, dict[str, Any]]) -> None:
    text, content = page
    (assumed,) = re.findall(r"Assumed: ([^.]*)\.", text)
    known = [name for name, entry in content["parameters"].items() if entry["known"]]
    assert all(name in assumed for name in known[:5])
    assert "calibration" in assumed
