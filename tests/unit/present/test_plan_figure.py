"""The figure of a planned test, from arrays."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.text import Annotation

from dashpot.present.figures.design import Bars, plan_figure


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
