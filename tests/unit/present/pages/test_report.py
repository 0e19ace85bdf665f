"""The report of an identification."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np

from dashpot import Estimate
from dashpot.present.pages.report import identification_report
from dashpot.present.tables.estimate import parameter_rows
from tests.unit.present.conftest import RIG, measured


class Page(HTMLParser):
    """Tags that are open at the end, and addresses outside the page."""

    VOID = frozenset({"meta", "br", "path", "use", "rect"})

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


def test_the_report_stands_alone(good: Estimate) -> None:
    html = identification_report(RIG.model, measured(), good, 0.95, ["rig.toml", "a&b.csv"])
    page = Page()
    page.feed(html)
    assert page.open == []
    assert page.outside == []
    assert page.seen.count("svg") == 4
    assert "script" not in page.seen
    assert "&lt;script&gt;" in html
    assert "a&amp;b.csv" in html
    for title in ("Parameters", "Modes", "Measured and predicted", "Residuals", "Convergence", "Correlation"):
        assert f"<h2>{title}" in html
    for row in parameter_rows(good):
        assert row.value in html


def test_the_report_is_the_same_every_time(good: Estimate) -> None:
    assert identification_report(RIG.model, measured(), good) == identification_report(
        RIG.model, measured(), good
    )


def test_not_converged_is_loud(good: Estimate) -> None:
    stuck = replace(good, converged=np.asarray(False))
    assert "did not converge" in identification_report(RIG.model, measured(), stuck)
