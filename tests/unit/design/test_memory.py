"""What a plan's information takes of memory where coordinates are many."""

from __future__ import annotations

import tracemalloc

import numpy as np

from dashpot.channel import Channel
from dashpot.design.test_setup import nominal_setup
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model


def test_the_information_of_two_hundred_coordinates_is_made_some_lines_at_a_time() -> None:
    """40 lines, 200 sensors, 600 elements: slopes of all lines together would be 77 MB, several times."""
    n = 200
    points = ["u", *(f"x{i}" for i in range(1, n + 1))]
    elements = [mass(f"m{i}", f"x{i}", value=1.0) for i in range(1, n + 1)]
    for letter, kind, size in (("k", Kind.SPRING, 400.0 * n**2), ("c", Kind.DAMPER, 0.25 * n**2)):
        for i in range(1, n + 1):
            known = {"guess": size} if i == 1 else {"same_as": f"{letter}1"}
            elements.append(between(f"{letter}{i}", kind, points[i - 1], points[i], **known))
    model = Model(tuple(points[1:]), (Input("u"),), tuple(elements))
    channels = (Channel("u", {"u": 1.0}), *(Channel(x, {x: 1.0}, relative_noise=0.01) for x in points[1:]))
    setup = nominal_setup(model, channels, {"k1": 400.0 * n**2, "c1": 0.25 * n**2})
    lines, pattern = np.geomspace(0.5, 20, 40), np.zeros(40, dtype=np.int64)
    few = setup.information(lines[::10], pattern[::10])
    tracemalloc.start()
    every = setup.information(lines, pattern)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 * 2**20
    assert np.allclose(every[:, ::10], few, rtol=1e-12, atol=0)
