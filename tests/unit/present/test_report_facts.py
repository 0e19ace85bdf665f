"""Every number of a report against the JSON of the same estimate, to the digits that are shown."""

import json
import re
from html import unescape
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from dashpot import Estimate
from dashpot.check.diagnosis.diagnose import examined
from dashpot.present.identification import identification_report
from tests.unit.present.conftest import RIG, measured


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
def page(request: pytest.FixtureRequest, good: Estimate, bad: Estimate) -> tuple[str, dict[str, Any]]:
    """A report and the JSON of its estimate."""
    spectrum = measured(extra=0.2 if request.param == "misfit" else 0.0)
    estimate = examined(RIG.model, spectrum, bad if request.param == "misfit" else good)
    return identification_report(RIG.model, spectrum, estimate), json.loads(estimate.to_json())


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
        assert shows(row["bound"], entry["bound_sd"]), row
        compared += 1
    assert compared >= 4
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
    times = re.search(r"([\d.]+) × the noise", text)
    assert shows(times[1], np.sqrt(fit["chi2"] / fit["dof"]))
    p = re.search(r"p (=|<) ([\d.e-]+)\)", text)
    assert shows(p[2], fit["p"]) if p[1] == "=" else fit["p"] < float(p[2])
    parts = dict(reversed(pair) for pair in re.findall(r"([\d.]+) % at (\w+)", text))
    assert set(parts) == set(fit["relative_residual"])
    for name, part in parts.items():
        assert shows(part, 100 * fit["relative_residual"][name])
    told = re.search(r"noise alone would leave (.*?)\. ", text)
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
    verdicts = {"fits": "The model fits.", "does not fit": "The model does not fit the data"}
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
