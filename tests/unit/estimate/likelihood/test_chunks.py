"""Chunks of starts and lines: the sums are those of all at once, and memory does not grow with lines and starts."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dashpot.estimate.likelihood import measured as chunks
from dashpot.estimate.likelihood.global_search import candidates
from dashpot.estimate.likelihood.measured import pieces
from dashpot.estimate.likelihood.objective import local, measured, per_line
from dashpot.estimate.preparation import prepare
from dashpot.model.observation import observation_model
from tests.partly_seen import BENCHES, noisy_base

ROOT = Path(__file__).parents[4]
LARGEST = 1024  # MiB beyond the data


@pytest.mark.parametrize("make", BENCHES)
@pytest.mark.parametrize("numbers", [1, 3_000, 20_000])
def test_sums_in_pieces_are_the_sums_of_all(make, numbers, monkeypatch):
    """Whatever the size of the pieces: of one line of one start, of a few, of a few starts at all lines."""
    bench = make()
    data = prepare(bench.model, bench.spectrum(np.random.default_rng(3)))
    view = observation_model(bench.model, data.spectrum.channels, data.spectrum.omega)
    exact = measured(data)
    psi = bench.psi * np.exp(0.05 * np.random.default_rng(4).standard_normal((7, len(bench.psi))))
    sign = np.ones((7, len(view.channels)))
    weight = np.random.default_rng(5).random((data.spectrum.lines, len(view.channels)))

    def all_of_them():
        summed = [local(view, exact, psi, sign)]
        if exact.q is not None:
            summed.append(local(view, exact, psi, sign, weight))
        lists = [(each.cost, each.gradient, each.symmetric) for each in summed]
        drawn = candidates(data, 30, np.random.default_rng(6))
        return [*(part for each in lists for part in each), *per_line(view, exact, psi, sign), *drawn]

    monkeypatch.setattr(chunks, "PIECE", 10**12)
    assert len(list(pieces(view, exact, 7))) == 1
    whole = all_of_them()
    monkeypatch.setattr(chunks, "PIECE", numbers)
    parts = list(pieces(view, exact, 7))
    assert len(parts) > 1
    covered = np.zeros((7, data.spectrum.lines), dtype=int)
    for part in parts:
        covered[part.rows, part.lines] += 1
    assert np.all(covered == 1)
    for one, other in zip(whole, all_of_them(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11 * np.max(np.abs(one)))


def test_repeats_are_cut_as_starts_are(monkeypatch):
    """Each repeat keeps its own data and weights."""
    bench = noisy_base()
    data = prepare(bench.model, bench.spectrum(np.random.default_rng(3), 5, 0.3))
    data = replace(data, covariance=data.covariance * np.linspace(1, 2, 5)[:, None, None, None])
    view = observation_model(bench.model, data.spectrum.channels, data.spectrum.omega)
    exact = measured(data)
    psi, sign = np.tile(bench.psi, (5, 1)), np.ones((5, len(view.channels)))
    whole = local(view, exact, psi, sign)
    monkeypatch.setattr(chunks, "PIECE", 9_000)
    cut = local(view, exact, psi, sign)
    np.testing.assert_allclose(whole.cost, cut.cost, rtol=1e-12)
    np.testing.assert_allclose(whole.symmetric, cut.symmetric, rtol=1e-9, atol=1e-9 * np.max(whole.symmetric))


PROGRAM = """
import resource, sys, tracemalloc
import numpy as np
from dashpot import Channel, Element, Input, Kind, MaximumLikelihood, Model, Spectrum, identify
from dashpot.model.dynamics import response

lines, starts, candidates, repeats = map(int, sys.argv[1:])
m, k, c = Kind.MASS, Kind.SPRING, Kind.DAMPER
elements = (
    Element("m1", m, {"x1": 1}, value=2.0), Element("m2", m, {"x2": 1}), Element("k1", k, {"x1": 1, "x2": -1}),
    Element("k2", k, {"x2": 1, "u": -1}), Element("c1", c, {"x1": 1, "x2": -1}), Element("c2", c, {"x2": 1, "u": -1}),
)
model = Model(("x1", "x2"), (Input("u"),), elements)
f, U = np.linspace(1, 20, lines), np.full((lines, 1), 1e-3 + 0j)
p = np.array([2.0, 3.0, 4000.0, 6000.0, 20.0, 30.0])
X = response(model, p, 2 * np.pi * f, U, np.zeros((lines, 0), complex))
sd = np.array([5e-6, 5e-6, 1e-6])
rng = np.random.default_rng(1)
Y = np.broadcast_to(np.concatenate([X, U], axis=1), (repeats, lines, 3)[repeats == 1:])
Y = Y + sd * (rng.standard_normal(Y.shape) + 1j * rng.standard_normal(Y.shape))
V = np.broadcast_to(np.diag(2 * sd**2).astype(complex), (*Y.shape, 3))
channels = (Channel("x1", {"x1": 1}, gain=None), Channel("x2", {"x2": 1}), Channel("u", {"u": 1}))
spectrum = Spectrum(
    channels, f, Y, V, np.ones(lines), np.full(lines, np.inf), ("given",) * lines, np.zeros(lines)
)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
tracemalloc.start()
found = identify(model, spectrum, MaximumLikelihood(starts=starts, candidates=candidates, rounds=1))
held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
gain = found.values[..., found.names.index("x1.gain")]
print(tracemalloc.get_traced_memory()[1] / 2**20, held / 2**10, np.median(gain))
"""


def _measured(*numbers: int, kernel: str = "auto") -> list[float]:
    """MiB of arrays and of the process beyond the data, and the gain."""
    environment = os.environ | {
        "PYTHONPATH": str(ROOT / "src"), "OPENBLAS_NUM_THREADS": "1", "DASHPOT_KERNEL": kernel
    }  # fmt: skip
    words = [sys.executable, "-c", PROGRAM, *map(str, numbers)]
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=True)
    return [float(word) for word in done.stdout.split()]


@pytest.mark.long
@pytest.mark.parametrize(
    ("lines", "starts", "candidates", "repeats"),
    [(600, 64, 2000, 1), (2000, 64, 2000, 1), (6000, 64, 2000, 1), (600, 16, 500, 20)],
)
def test_memory_of_many_lines_starts_and_repeats(lines, starts, candidates, repeats):
    """2.1, 6.6 and 19 GB once, at 600, 2,000 and 6,000 lines."""
    arrays, process, gain = _measured(lines, starts, candidates, repeats)
    assert gain == pytest.approx(1, abs=0.1)
    assert max(arrays, process) < 1024


@pytest.mark.slow
def test_memory_is_bounded():
    """In NumPy, whose arrays are cut: 1,000 lines, noisy inputs, an unknown gain, the best 6 of 250 candidates.

    Uncut they take 0.4 GiB.
    """
    peak, _, gain = _measured(1000, 6, 250, 1, kernel="numpy")
    assert gain == pytest.approx(1, abs=0.1)
    assert peak < LARGEST / 4
