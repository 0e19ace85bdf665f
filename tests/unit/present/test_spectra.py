"""Figures of an identification."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from dashpot.errors import UsageError
from dashpot.present.figures import spectra as figures
from dashpot.present.figures.style import limit_axis, svg, write_figure


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
    with pytest.raises(UsageError, match="chooses the format"):
        write_figure(tmp_path / "figure.jpg", figure)


def test_phases_stay_in_the_turn_of_the_model() -> None:
    f, turn = np.array([1.0, 2.0, 3.0]), np.exp(1j * np.radians([[-179.0], [170], [10]]))
    model = np.exp(1j * np.radians([[179.0], [-175], [0]]))
    figure = figures.amplitude_and_phase(["a"], ["m"], f, turn, np.zeros((3, 1)), model)
    right = figure.axes[1]
    np.testing.assert_allclose(right.containers[0].lines[0].get_ydata(), [181, -190, 10])
