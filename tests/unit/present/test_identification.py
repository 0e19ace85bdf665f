"""What an estimate looks like: terminal tables, figures, the report."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import matplotlib as mpl
import numpy as np
import pytest
from rich.console import Console

from dashpot import Estimate, Model, Spectrum, dwells, identify, parse_rig, simulate_spectrum
from dashpot.notices import Notice
from dashpot.present.figures import spectra as figures
from dashpot.present.pages.report import identification_report
from dashpot.present.tables.estimate import (
    basis_in_words,
    fit_in_words,
    parameter_rows,
    parameter_table,
    show_estimate,
    show_spectrum,
    worth_telling,
)

RIG = parse_rig(
    """
name = "Frame <script>alert(1)</script>"
coordinates = ["x1", "x2"]
[inputs]
u = {}
[masses]
m1 = { at = "x1" }
m2 = { at = "x2", value = 2.7 }
[springs]
k1 = { between = ["x1", "x2"] }
k2 = { between = ["x2", "u"], same_as = "k1", times = 1.5 }
[dampers]
c1 = { between = ["x1", "x2"] }
c2 = { between = ["x2", "u"] }
[channels]
x1 = { of = "x1", noise = 0.01 }
x2 = { of = "x2", noise = 0.01 }
u = { of = "u" }
"""
)
VALUES = {"m1": 3.0, "k1": 4600.0, "c1": 20.0, "c2": 30.0}


def measured(model: Model = RIG.model, extra: float = 0.0) -> Spectrum:
    """A test of the rig; with `extra` its first mass is heavier below the middle frequency: no model fits."""
    p = model.parameters(model.theta(VALUES))
    rng = np.random.default_rng(3)
    low = simulate_spectrum(model, p, RIG.channels, dwells(model, [1.0, 2, 3, 4, 5], 200), rng)
    heavy = model.parameters(model.theta({**VALUES, "m1": 3.0 + extra}))
    return low + simulate_spectrum(model, heavy, RIG.channels, dwells(model, [6.0, 8, 10, 15, 20], 200), rng)


@pytest.fixture(scope="module")
def good() -> Estimate:
    return identify(RIG.model, measured())


@pytest.fixture(scope="module")
def bad() -> Estimate:
    return identify(RIG.model, measured(extra=0.2))


def printed(estimate: Estimate, width: int = 80) -> str:
    out = io.StringIO()
    show_estimate(Console(file=out, width=width, highlight=False, emoji=False, markup=False), estimate)
    return out.getvalue()


def test_the_table_fits_80_columns_without_colour(good: Estimate, bad: Estimate) -> None:
    for estimate in (good, bad):
        text = printed(estimate)
        assert "\x1b" not in text
        assert max(map(len, text.splitlines())) <= 80
        # No line is broken: every parameter stands with its unit in one line.
        for row in parameter_rows(estimate):
            (line,) = (line for line in text.splitlines() if line.startswith(row.name + " "))
            assert line.rstrip().endswith(row.unit)
            assert row.value in line
            assert row.sd in line
            assert row.low in line
            assert row.bound in line


def test_rows_say_what_is_found_tied_and_known(good: Estimate) -> None:
    rows = {row.name: row for row in parameter_rows(good)}
    assert list(rows) == ["m1", "k1", "c1", "c2", "k2", "m2"]
    assert rows["m2"].known
    assert (rows["m2"].value, rows["m2"].sd) == ("2.7", "known")
    assert rows["k2"].tie == "= 1.5 × k1"
    assert float(rows["k2"].value) == pytest.approx(1.5 * good["k1"].value, abs=0.1 * 1.5 * good["k1"].sd)
    low, high = good.interval(0.9)
    ninety = parameter_rows(good, 0.9)[0]
    assert float(ninety.low) == pytest.approx(low[0], abs=0.06 * good.sd[0])
    assert float(ninety.high) == pytest.approx(high[0], abs=0.06 * good.sd[0])
    assert "90 % interval" in [column.header for column in parameter_table(good, 0.9).columns]


def test_a_misfit_is_named_with_both_uncertainties(good: Estimate, bad: Estimate) -> None:
    text = printed(bad)
    assert "The model does not fit" in text
    assert "noise only" in text
    assert "misfit" in basis_in_words(bad)
    row = parameter_rows(bad)[0]
    assert float(row.sd) == pytest.approx(bad.sd[0], rel=0.06)
    assert float(row.noise) == pytest.approx(bad.noise_sd[0], rel=0.06)
    assert float(row.noise) < 0.5 * float(row.sd)
    (line,) = (line for line in text.splitlines() if line.startswith("m1 "))
    assert row.noise in line.split()
    assert "noise only" not in printed(good)
    assert "The model fits" in printed(good)


def test_what_the_fit_says_is_said_once(good: Estimate, bad: Estimate) -> None:
    """Warnings of what the sentence on the fit says are left out by their code; others are shown."""
    assert "model_misfit" in {warning.code for warning in bad.warnings}
    assert worth_telling(bad) == ()
    unknown = measured()
    unknown = replace(
        unknown, covariance=np.full_like(unknown.covariance, np.nan), noise=("unknown",) * unknown.lines
    )
    blind = identify(RIG.model, unknown)
    assert [warning.code for warning in blind.warnings] == ["unknown_noise"]
    assert worth_telling(blind) == ()
    assert "noise is unknown" in fit_in_words(blind.fit)
    assert "scatter of the residuals" in basis_in_words(blind)
    other = replace(good, warnings=(Notice("negative", "c1 is negative", ("c1",)),))
    assert "Warning: c1 is negative" in printed(other)


def test_fit_in_words(good: Estimate) -> None:
    fit = replace(good.fit, chi2=np.array(100.0), dof=100, p=np.array(0.48))
    assert fit_in_words(fit).startswith("The model fits: residuals are 1.0 × the noise (χ² = 100")
    assert "too large" in fit_in_words(replace(fit, chi2=np.array(4.0), p=np.array(1.0)))
    large = fit_in_words(replace(fit, chi2=np.array(14400.0), p=np.array(0.0)))
    assert large.startswith("The model does not fit: residuals are 12 × the noise")
    assert "p < 1e-6" in large
    assert "cannot be tested" in fit_in_words(replace(fit, dof=0))


def test_not_converged_is_loud(good: Estimate) -> None:
    stuck = replace(good, converged=np.asarray(False))
    assert "NOT CONVERGED" in printed(stuck)
    assert "did not settle" in identification_report(RIG.model, measured(), stuck)


def test_motions_that_do_not_swing() -> None:
    rig = parse_rig(
        'coordinates = ["x"]\n[inputs]\nu = {}\n[masses]\nm = { at = "x", value = 1 }\n'
        '[springs]\nk = { between = ["x", "u"] }\n[dampers]\nc = { between = ["x", "u"] }\n'
    )
    p = rig.model.parameters(rig.model.theta({"k": 4.0, "c": 10.0}))
    spectrum = simulate_spectrum(
        rig.model, p, rig.channels, dwells(rig.model, [0.1, 0.5, 2.0], 50), np.random.default_rng(0)
    )
    text = printed(identify(rig.model, spectrum))
    assert "does not swing: decays in 2.40 s" in text


def test_a_spectrum_is_summed_up() -> None:
    out = io.StringIO()
    show_spectrum(Console(file=out, width=80), measured(), ["m", "m", "m"], "t.csv")
    text = out.getvalue()
    assert "t.csv: 10 lines from 1.00 to 20.0 Hz" in text
    assert re.search(r"^x1 .* m", text, re.MULTILINE)


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


def test_figures_leave_no_settings_behind() -> None:
    before = dict(mpl.rcParams)
    f = np.array([1.0, 2, 5])
    z = np.array([[1 + 1j], [2.0], [0.0]])
    figure = figures.amplitude_and_phase(["a"], ["m"], f, z, np.full((3, 1), 0.1), None, None, z)
    assert figures.svg(figure).startswith("<svg")
    figures.svg(figures.residual_plot(["a"], f, np.full((3, 1), np.nan + 0j)))
    figures.svg(figures.history_plot(["a"], np.array([[1.0], [0.0]])))
    assert dict(mpl.rcParams) == before


def test_phases_stay_in_the_turn_of_the_model() -> None:
    np.testing.assert_allclose(
        figures._beside(np.array([-179.0, 170, 10]), np.array([179.0, -175, 0])), [181, -190, 10]
    )
    broken = figures._unbroken(np.array([170.0, -170.0, -160.0]))
    assert np.isnan(broken[1])
    assert broken[2] == -160
