"""Figures, what they tell a page's script, and figures as files."""

import json
import re
from html import unescape
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from dashpot.channel import Channel, Quantity
from dashpot.errors import UsageError
from dashpot.free.response import MeasuredResponse
from dashpot.present.figures import spectra as figures
from dashpot.present.figures.design import Bars, plan_figure
from dashpot.present.figures.interactive import AxisLabel, hover, hover_cells, interactive_svg
from dashpot.present.figures.style import limit_axis, svg, write_figure


@pytest.mark.slow
def test_figures_leave_no_settings_behind() -> None:
    before = dict(mpl.rcParams)
    f = np.array([1.0, 2, 5])
    z = np.array([[1 + 1j], [2.0], [0.0]])
    figure = figures.amplitude_and_phase(["a"], ["m"], f, z, np.full((3, 1), 0.1), z)
    assert svg(figure).startswith("<svg")
    svg(figures.residual_plot(["a"], f, np.full((3, 1), np.nan)))
    svg(figures.residual_plot(["a"], f, np.array([[1.0], [2.0], [40.0]]), ("a", 5.0, 40.0)))
    svg(figures.residual_plot(["a"], f, np.array([[1.0], [2.0], [np.inf]]), ("a", 5.0, np.inf)))
    assert dict(mpl.rcParams) == before


def test_an_end_that_is_no_finite_number_leaves_the_axis_as_it_is() -> None:
    axes = Figure().subplots()
    limit_axis(axes.set_xlim, 0.5, np.inf)
    limit_axis(axes.set_ylim, np.nan, 3.0)
    assert (*axes.get_xlim(), *axes.get_ylim()) == (0.5, 1.0, 0.0, 3.0)


@pytest.mark.parametrize(("end", "head"), [("svg", b"<?xml"), ("PNG", b"\x89PNG"), ("pdf", b"%PDF")])
def test_the_end_of_a_name_chooses_the_format(tmp_path: Path, end: str, head: bytes) -> None:
    path = tmp_path / f"figure.{end}"
    contents = set()
    for _ in range(2):
        figure = figures.residual_plot(["a"], np.array([1.0, 2]), np.array([[1.0], [2.0]]))
        write_figure(path, figure)
        contents.add(path.read_bytes())
    (content,) = contents
    assert content.startswith(head)
    with pytest.raises(UsageError, match="unknown format"):
        write_figure(tmp_path / "figure.jpg", figure)


def test_phases_stay_in_the_turn_of_the_model() -> None:
    f, turn = np.array([1.0, 2.0, 3.0]), np.exp(1j * np.radians([[-179.0], [170], [10]]))
    model = np.exp(1j * np.radians([[179.0], [-175], [0]]))
    figure = figures.amplitude_and_phase(["a"], ["m"], f, turn, np.zeros((3, 1)), model)
    right = figure.axes[1]
    np.testing.assert_allclose(right.containers[0].lines[0].get_ydata(), [181, -190, 10])


def described(figure: Figure) -> tuple[str, list[dict[str, Any]]]:
    """The SVG, and the description in it."""
    text = interactive_svg(figure)
    found = re.search('data-panels="([^"]*)"', text)
    return text, json.loads(unescape(found[1]))


def test_points_lines_and_bands_are_told_where_they_are_drawn() -> None:
    figure = Figure(figsize=(5, 3))
    left, right = figure.subplots(1, 2, sharex=True)
    f, y = np.array([1.0, 2.0, 50.0]), np.array([3.0, np.nan, 0.2])
    left.errorbar(f, y, yerr=[[0.5, 0.0, 0.1], [1.0, 0.0, 0.1]], fmt="o", label='measured "at" <b>')
    left.plot(f, f, label="model")
    left.fill_between(f, 0.9 * f, 1.1 * f, label="band")
    left.axhline(1.0)
    left.set_xscale("log")
    left.set_xlim(0.5, 100)
    right.plot(f, f, "x", label="_silent")
    hover(left, AxisLabel("frequency", "Hz"), AxisLabel("amplitude", "m"))
    hover(right, AxisLabel("frequency", "Hz"), AxisLabel("phase", "°"))
    text, (first, second) = described(figure)
    points, line, band = first["series"]
    assert points == {
        "name": 'measured "at" <b>', "kind": "points", "x": [1, 2, 50], "y": [3, None, 0.2],
        "low": [2.5, None, 0.1], "high": [4, None, 0.3],
    }  # fmt: skip
    assert (line["kind"], band["kind"]) == ("line", "band")
    for drawn in (line, band):
        assert text.count(f'id="{drawn["id"]}"') == 1
    assert first["x"] == {"name": "frequency", "unit": "Hz", "scale": "log", "limits": [0.5, 100]}
    assert second["series"] == []
    assert first["shared"] == second["shared"]
    # The first dot of the SVG stands where limits and box put it.
    x0, y0, width, height = first["box"]
    low, high = first["y"]["limits"]
    spots = [(float(a), float(b)) for a, b in re.findall(r'<use [^>]*x="([\d.]+)" y="([\d.]+)"', text)]
    expected = (x0 + width * np.log(2) / np.log(200), y0 + height * (high - 3) / (high - low))
    assert min(np.hypot(a - expected[0], b - expected[1]) for a, b in spots) < 0.01


def test_heat_maps_tell_their_cells() -> None:
    figure = Figure()
    axes = figure.subplots()
    values = np.array([[1.0, np.nan], [0.25, -1.0]])
    axes.imshow(values)
    hover_cells(axes, ["a", "b"], ["1 Hz", "2 Hz"], values, AxisLabel("share", "%"))
    _, (panel,) = described(figure)
    assert panel["cells"] == {
        "rows": ["a", "b"], "columns": ["1 Hz", "2 Hz"], "values": [[1, None], [0.25, -1]],
    }  # fmt: skip


def test_limits_of_symmetric_logarithms_are_told() -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.plot([1, 2], [1, 100], "o", label="x")
    axes.set_yscale("symlog", linthresh=2)
    hover(axes, AxisLabel("frequency"), AxisLabel("residual"))
    _, (panel,) = described(figure)
    assert panel["y"]["linear"] == pytest.approx(2)


def test_other_figures_carry_nothing() -> None:
    figure = Figure()
    figure.subplots().plot([1, 2], [1, 2], label="x")
    assert "data-panels" not in interactive_svg(figure)


@pytest.mark.slow
@pytest.mark.parametrize("dwells_hz", [[3.08, 5.69, 7.17, 8.0, 10.14, 29.8], [7.0, 7.1, 7.2], [5.0]])
def test_names_of_dwells_touch_neither_each_other_nor_other_dwells(dwells_hz: list[float]) -> None:
    frequency, count = np.geomspace(0.6, 30, 50), len(dwells_hz)
    figure = plan_figure(
        "A test", frequency, [("u", np.full(50, 0.5))], np.array(dwells_hz), np.linspace(270, 420, count), "samples",
        ["m", "k"], np.ones((50, 2)), ["m", "k"], [Bars("this test", np.array([1.0, 2.0]))],
    )  # fmt: skip
    figure.draw_without_rendering()
    over = next(axes for axes in figure.axes if axes.get_ylabel().startswith("dwell"))
    names = [text for text in over.texts if isinstance(text, Annotation)]
    boxes = [name.get_window_extent() for name in names]
    assert names[0].get_text() == f"{dwells_hz[-1]:.4g} Hz"  # the longest
    assert not any(first.overlaps(second) for first, second in combinations(boxes, 2))
    for name, box in zip(names, boxes, strict=True):
        for x, y in over.transData.transform(np.stack([dwells_hz, np.linspace(270, 420, count)], axis=1)):
            of_another = name.get_text() != f"{over.transData.inverted().transform((x, y))[0]:.4g} Hz"
            assert not (of_another and box.x0 < x < box.x1 and y > box.y0), name.get_text()


def test_measured_responses_have_bands_and_a_plane_in_which_a_resonance_is_a_circle() -> None:
    f = np.linspace(9.0, 11.0, 201)
    w = 2 * np.pi * f
    mobility = 2j * w / ((20 * np.pi) ** 2 - w**2 + 2j * w)  # a circle of diameter 1 about 1/2
    sizes = np.full((201, 1, 1), 2e-4 + 0j)
    parts = (Channel("f", {"f": 1.0}, Quantity.FORCE),), (Channel("v", {"x": 1.0}, Quantity.VELOCITY),)
    ones = np.ones((201, 1))
    found = MeasuredResponse(*parts, f, mobility[:, None, None], sizes, ones, ones[:, 0].astype(int), "local")
    magnitude, phase, coherence, plane = figures.measured_response_figure(found).axes
    x, y = plane.lines[0].get_data()
    np.testing.assert_allclose((x - 0.5) ** 2 + y**2, 0.25, atol=1e-12)
    band = magnitude.collections[0].get_paths()[0].vertices
    middle = band[np.isclose(band[:, 0], 10.0)][:, 1]
    np.testing.assert_allclose([middle.min(), middle.max()], [1 - 0.0196, 1 + 0.0196])
    assert phase.get_xlim() == coherence.get_xlim()
