"""The reproduction: the paper's rig, complete tables, and statements that follow from the numbers."""

import re
from dataclasses import fields, replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from dashpot.errors import DataError, UsageError
from dashpot.model.modes import modes
from dashpot.present.pages.yamane1989 import pictures, show, write
from dashpot.reproduce.yamane1989 import findings as yamane

DRAWS = 40


@pytest.fixture(scope="module")
def found():
    return yamane.reproduce(DRAWS, seed=5)


def test_table_1():
    """Printed to four decimals, but for its last digit."""
    rig, paper = yamane.model(), yamane.printed()
    values = modes(rig, rig.parameters(rig.theta(dict(paper.values)))).eigenvalues
    assert np.allclose(values, paper.eigenvalues, rtol=0, atol=6e-5)
    assert np.allclose(np.abs(values.imag) / (2 * np.pi), [2.96, 9.60], atol=5e-3)


def test_tables_are_whole(found):
    columns = (*found.table2, *found.table3, *found.table4)
    assert [(c.title, c.method) for c in found.table2] == [
        (f"{level} %", method) for level in (1, 5, 10, 20) for method in ("ls", "iv", "oiv")
    ]
    assert len(found.table4) == 12
    assert len(found.table3) == 4
    printed = [entry for column in columns for entry in column.entries if entry.printed is not None]
    # Table 2: ls and iv at four levels; Table 3: six and four; Table 4: four cases.
    assert len(printed) == 2 * 4 * 6 + 6 + 4 + 4 * 6
    for entry in printed:
        assert 0 <= entry.percentile <= 100
        assert entry.z == pytest.approx((entry.printed - entry.mean) / entry.spread)
        assert abs(entry.z) < 4
    for column in columns:
        assert column.draws == DRAWS
        assert all(
            np.isfinite(getattr(entry, f.name)) for entry in column.entries for f in fields(entry)[2:10]
        )
        assert column.joint_p is None or 0 < column.joint_p <= 1


def test_percentile_and_distance_are_of_the_draws():
    rng = np.random.default_rng(1)
    errors = rng.standard_normal((2000, 3)) @ np.array([[1.0, 0, 0], [2, 1, 0], [0, 3, 5]])
    assert yamane.farther(errors, np.mean(errors, axis=0)) == 1.0
    assert yamane.farther(errors, np.array([100.0, 0, 0])) == pytest.approx(1 / 2001)
    # The median of χ² with three degrees of freedom is 2.366.
    L = np.linalg.cholesky(np.cov(errors.T))
    middle = np.mean(errors, axis=0) + L @ np.array([np.sqrt(2.366), 0, 0])
    assert yamane.farther(errors, middle) == pytest.approx(0.5, abs=0.05)
    rms, error = yamane.rms_spread(errors)
    assert rms == pytest.approx(np.sqrt(np.mean(np.var(errors, axis=0, ddof=1))))
    assert 0 < error < 0.1 * rms


def test_eigenvalues_of_many_rigs_are_those_of_each():
    rig, paper = yamane.model(), yamane.printed()
    theta = rig.theta(dict(paper.values)) * np.random.default_rng(2).uniform(0.8, 1.2, (5, 6))
    many = yamane.eigenvalues(rig, theta)
    for own, row in zip(theta, many, strict=True):
        assert np.allclose(row, modes(rig, rig.parameters(own)).eigenvalues, rtol=1e-9)
    stiff = theta[:1] * np.array([1, 1, 100, 100, 100, 100])
    assert np.all(np.isnan(yamane.eigenvalues(rig, stiff)) | (yamane.eigenvalues(rig, stiff).imag > 0))


def test_ranking_is_ordered_by_its_numbers(found):
    for kind in ("relative", "constant"):
        own = [rank for rank in found.ranking if rank.kind == kind]
        assert [rank.case for rank in own] == ["CASE-1", "CASE-2", "CASE-3", "CASE-4"]
        by_place = sorted(own, key=lambda rank: rank.place_iv)
        assert [rank.iv for rank in by_place] == sorted(rank.iv for rank in own)
        assert sorted(rank.place_oiv for rank in own) == [1, 2, 3, 4]
    assert {rank.samples for rank in found.ranking} == {1400, 1008}


def test_findings_say_what_the_numbers_say(found):
    text = {finding.title: finding.text for finding in found.findings}
    assert len(text) == 9
    column = next(c for c in found.table2 if c.title == "10 %" and c.method == "iv")
    factor = next(t for title, t in text.items() if "factor of accuracy" in title)
    assert f"{column.rms:.2f} % with iv" in factor
    assert f"{column.rms / column.bound:.2f} × the bound" in factor
    draw = text["Table 2 shows one noise draw four times"]
    assert float(re.search(r"at least (0\.\d+)", draw)[1]) > 0.99
    luck = text["The paper's draw was a lucky one"]
    assert "printed maximum 2.08 %" in luck
    for words in text.values():
        assert words[0].isupper() or words[0].isdigit()
        assert "nan" not in words


def test_figures_have_all_their_points(found):
    assert {curve.parameter for curve in found.figure2.curves} == {"m1", "m2", "c3"}
    assert {curve.method for curve in found.figure2.curves} == {"ls", "iv", "oiv"}
    assert {curve.parameter for curve in found.figure3.curves} == {"m1", "m2"}
    for curve in (*found.figure2.curves, *found.figure3.curves):
        assert np.all(curve.low < curve.high)
        assert np.all(np.isfinite(curve.mean))
    assert found.figure2.curves[0].x[[0, -1]].tolist() == [1, 35]
    assert found.figure3.curves[0].x[[0, -1]].tolist() == [50, 1600]
    assert len(found.figure2.points) == 2 * 4 * 3
    spread = next(c.spread for c in found.figure3.curves if c.method == "oiv" and c.parameter == "m1")
    assert spread[0] > 3 * spread[-1]  # √32 = 5.7 in the mean


def test_the_seed_decides_everything():
    """Few draws of the cheapest part: twice the same, another seed another."""
    study = yamane.tables(20, 5)
    grid = replace(study.grids[0], noise=(0.1,))
    points = yamane.scenarios(replace(study, grids=(grid,)))
    first, again, other = (yamane.run(points, seed).repeats(points[0])["oiv"].values for seed in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_too_few_draws_are_refused():
    with pytest.raises(UsageError, match="take 20 or more"):
        yamane.reproduce(5)


def test_it_can_be_shown_and_written(found, tmp_path):
    out = StringIO()
    show(found, Console(file=out, width=80))
    text = out.getvalue()
    assert "Table 2" in text
    assert "What it shows" in text
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "…" not in text
    assert "[bold]" not in text
    written = write(found, tmp_path / "report.html", tmp_path / "figures")
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == [
        "figure2.png", "figure3.png", "ranking.png", "table2.png", "table4.png",
    ]  # fmt: skip
    assert len(written) == 6
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 5
    assert "http" not in page  # needs nothing from elsewhere
    for finding in found.findings:
        assert finding.title.replace("'", "&#39;") in page
    assert write(found) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="folder cannot be made"):
        write(found, figures=tmp_path / "file" / "deeper")


def test_pictures_are_the_same_bytes_again(found):
    first, second = pictures(found), pictures(found)
    assert {name: content for name, (_, content) in first.items()} == {
        name: content for name, (_, content) in second.items()
    }
    assert all(content.startswith(b"\x89PNG") for _, content in first.values())
