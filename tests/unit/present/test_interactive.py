"""What figures tell a page's script."""

import json
import re
from html import unescape
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from dashpot.present.figures.interactive import AxisLabel, hover, hover_cells, interactive_svg


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
