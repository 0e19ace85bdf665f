"""What an estimate looks like on a terminal."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from dashpot import Estimate, identify
from dashpot.data.conditioning.settings import Conditioning
from dashpot.estimate.assessment import Assessment
from dashpot.notices import Notice
from dashpot.present.document import html_of, show
from dashpot.present.estimate import (
    basis_in_words,
    estimate_document,
    fit_in_words,
    parameter_columns,
    parameter_rows,
    warnings_in_words,
)
from tests import rigs
from tests.unit.present.conftest import RIG, measured


def printed(estimate: Estimate, width: int = 80, *, verbose: bool = True) -> str:
    out = io.StringIO()
    console = Console(file=out, width=width, highlight=False, emoji=False, markup=False)
    show(console, estimate_document(estimate, verbose=verbose))
    return out.getvalue()


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_the_table_keeps_to_the_width_and_loses_nothing(good: Estimate, bad: Estimate, width: int) -> None:
    for estimate in (good, bad):
        text = printed(estimate, width)
        assert "\x1b" not in text
        assert max(map(len, text.splitlines())) <= width
        for column in parameter_columns(estimate):
            assert column.title.split("\n")[0] in text
        for row in parameter_rows(estimate):
            lines = [line for line in text.splitlines() if line.startswith(row.name + " ")]
            cells = " ".join(lines)
            for part in (row.value, row.sd, row.unit, row.share, row.low, row.high, row.bound):
                assert part in cells


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
    assert "90 % interval" in [column.title for column in parameter_columns(good, 0.9)]


def test_a_misfit_is_named_with_both_uncertainties(good: Estimate, bad: Estimate) -> None:
    text = printed(bad)
    assert "The model does not fit" in text
    assert "±, noise" in text
    assert "misfit" in basis_in_words(bad)
    row = parameter_rows(bad)[0]
    assert float(row.sd) == pytest.approx(bad.sd[0], rel=0.06)
    assert float(row.noise) == pytest.approx(bad.noise_sd[0], rel=0.06)
    assert float(row.noise) < 0.5 * float(row.sd)
    lines = [line for line in text.splitlines() if line.startswith("m1 ")]
    assert row.noise in " ".join(lines).split()
    assert "±, noise" not in printed(good)
    assert "The model fits" in printed(good)


def test_what_the_fit_says_is_said_once(good: Estimate, bad: Estimate) -> None:
    """Warnings of what the sentence on the fit says are left out by their code; others are shown."""
    assert "model_misfit" in {warning.code for warning in bad.warnings}
    assert warnings_in_words(bad) == ()
    blind = identify(RIG.model, rigs.of_unknown_noise(measured()))
    assert [warning.code for warning in blind.warnings] == ["unknown_noise"]
    assert warnings_in_words(blind) == ()
    assert "noise is not known" in fit_in_words(blind.fit)
    assert "scatter of the residuals" in basis_in_words(blind)
    other = replace(good, warnings=(Notice("negative", "c1 is negative", ("c1",)),))
    assert "Warning: c1 is negative" in printed(other)
    for named, wanted in (("c1", ()), ("k1", ("c1 is negative.",))):
        # The verdict names parts that are negative beyond doubt; of others it has said nothing.
        reasons = (Notice("negative", f"{named} is negative", (named,)),)
        told = replace(other, assessment=Assessment("does not fit", reasons))
        assert warnings_in_words(told) == wanted


def test_coloured_noise_is_answered_with_options_only_where_there_are_records(good: Estimate) -> None:
    coloured = replace(good, warnings=(Notice("coloured_noise", "coloured noise at 3 of 8 frequencies"),))
    assert "--settle auto" in warnings_in_words(coloured)[0]
    assert "--settle" not in warnings_in_words(coloured, untried=())[0]
    (other,) = warnings_in_words(coloured, untried=Conditioning(settle="auto").untried)
    assert "--settle" not in other
    assert "--refine always" in other


def test_the_html_of_an_estimate_is_escaped_and_complete(bad: Estimate) -> None:
    html = html_of(estimate_document(bad))
    assert "<script" not in html
    for row in parameter_rows(bad):
        assert row.value in html
    assert "does not fit" in html


def test_the_verdict_comes_first_and_what_it_rests_on_is_asked_for(good: Estimate) -> None:
    judged = replace(good, assessment=Assessment("fits", ()))
    text = printed(judged, verbose=False)
    assert text.splitlines()[1].startswith("The model fits")
    assert not {"bound", "χ²", "converged"} & set(text.replace("=", " ").split())
    assert all(word in printed(judged) for word in ("bound", "χ²", "converged"))


def test_warnings_and_reasons_carry_the_codes_of_the_manual(good: Estimate) -> None:
    told = replace(
        good,
        warnings=(Notice("few_lines", "only 5 frequency lines"),),
        assessment=Assessment(
            "does not fit", (Notice("smooth_residuals", "the residuals of x1 follow a trend"),)
        ),
    )
    text = " ".join(printed(told, verbose=False).split())
    assert "Warning: only 5 frequency lines. [few_lines]" in text
    assert "The residuals of x1 follow a trend. [smooth_residuals]" in text
