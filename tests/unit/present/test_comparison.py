"""The table and the picture of several methods: what stands where, what is marked, what fits."""

import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from rich.console import Console

from dashpot.estimate.comparison import Comparison, compare
from dashpot.estimate.registry import method
from dashpot.present.comparison import comparison_document
from dashpot.present.document import show
from dashpot.present.figures.comparison import comparison_figure, interval_plot
from dashpot.present.figures.style import BAD, COLOURS, png
from tests.rigs import channels, covariance, noisy, paper_rig


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    """The paper's rig by hls, oiv and ls (which these data do not suit); m1's "truth" is wrong."""
    rig = paper_rig()
    ch = channels(rig)
    spectrum = noisy(rig, ch, covariance(rig, ch, 0.02), np.random.default_rng(1))
    truth = dict(zip(rig.names, rig.theta.tolist(), strict=True)) | {"m1": 3.5}
    return compare(rig.model, spectrum, {name: method(name) for name in ("hls", "oiv", "ls")}, truth=truth)


def printed(comparison: Comparison, width: int, level: float = 0.95) -> list[str]:
    out = io.StringIO()
    show(Console(file=out, width=width, highlight=False), comparison_document(comparison, level))
    return [line.rstrip() for line in out.getvalue().splitlines()]


@pytest.mark.parametrize("width", [40, 60, 80, 200])
def test_the_table_keeps_to_the_width_and_loses_nothing(comparison: Comparison, width: int) -> None:
    lines = printed(comparison, width)
    assert max(map(len, lines)) <= width
    text = "\n".join(lines)
    assert "…" not in text
    for value in comparison.estimates["oiv"]:
        assert f"{value.value:.3g}"[:3] in text
    assert text.count("\noiv ") == sum(line.startswith("bound") for line in lines)  # one row in each block


def test_each_method_has_a_row_below_the_truth_and_the_bound(comparison: Comparison) -> None:
    lines = printed(comparison, 200)
    assert lines[1].split() == [*comparison.names, "worst"]
    assert lines[2].split()[0] == "kg"
    rows = {
        line.split()[0]: line.split()
        for line in lines
        if line and line.split()[0] in ("truth", "hls", "oiv", "bound")
    }
    assert rows["truth"][1:] == ["3.5", "2.7", "30", "40", "90", "50"]
    assert rows["oiv"].count("±") == rows["bound"].count("±") == 6
    starred = [cell for cell in rows["oiv"] if cell.endswith("*")]
    assert len(starred) == 1
    assert float(rows["oiv"][-1]) == pytest.approx(100 * 0.5 / 3.5, rel=0.1)  # the worst error, of m1
    assert any(line.startswith("ls: ") for line in lines)


def test_the_bound_is_that_of_the_test_not_of_measured_modes(comparison: Comparison) -> None:
    """Modes are other data, and may tell more or less."""
    oiv = comparison.estimates["oiv"]
    both = {"oiv": oiv, "modal": replace(oiv, bound_sd=oiv.bound_sd / 2)}
    one = Comparison(comparison.model, comparison.names, comparison.units, both, {}, {})
    assert one.bound_sd("m1") == oiv["m1"].bound_sd
    alone = Comparison(comparison.model, comparison.names, comparison.units, {"modal": oiv}, {}, {})
    assert alone.bound_sd("m1") is None


def test_the_picture_has_a_panel_for_each_unknown_and_marks_what_misses(comparison: Comparison) -> None:
    figure = comparison_figure(comparison)
    panels = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title(loc="left") for axes in panels] == list(comparison.names)
    red = [
        axes.get_title(loc="left")
        for axes in panels
        if any(to_hex(line.get_color()) == BAD for line in axes.lines)
    ]
    missed = set()
    for estimate in comparison.estimates.values():
        low, high = estimate.interval()
        for j, name in enumerate(comparison.names):
            if not low[j] <= comparison.truth[name] <= high[j]:
                missed.add(name)
    assert set(red) == missed
    assert "m1" in missed
    assert png(figure).startswith(b"\x89PNG")


def test_an_interval_much_wider_than_the_others_ends_in_arrows() -> None:
    """The narrowest is 2 wide: 12 is shown, 13 runs out on both sides."""
    for half, arrows in ((6.0, 0), (6.5, 2)):
        value = np.zeros((3, 1))
        low, high = np.array([[-1.0], [-1.2], [-half]]), np.array([[1.0], [1.2], [half]])
        figure = interval_plot(["k"], ["N/m"], ["a", "b", "c"], value, low, high, {}, {})
        (axes,) = figure.axes
        marks = [line for line in axes.lines if line.get_marker() in ("<", ">")]
        assert len(marks) == arrows
        left, right = axes.get_xlim()
        assert (left < -half) == (arrows == 0)
        assert right == pytest.approx(-left)


def test_estimates_without_intervals_are_drawn_as_dots() -> None:
    """Noise of unknown size at exact data: sd 0 or not finite."""
    value = np.array([[2.0], [2.1]])
    nothing = np.full((2, 1), np.nan)
    figure = interval_plot(["k"], ["1"], ["a", "b"], value, nothing, nothing, {"k": 2.0}, {})
    (axes,) = figure.axes
    assert axes.get_xlim()[0] < 2.0 < 2.1 < axes.get_xlim()[1]
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    assert {to_hex(line.get_color()) for line in dots} == {COLOURS[0]}  # nothing is said to miss
