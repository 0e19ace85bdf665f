"""The search on a basis ends where the search on the whole rig ends."""

import numpy as np
import pytest

from dashpot.channel import Channel, Quantity
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood import maximum_likelihood as reduced_search
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.model.elements import Kind, between, mass
from dashpot.model.network import Input, Model
from tests.partly_seen import Bench


def rod(n: int, lines: int) -> Bench:
    """A rod of two halves in n pieces on a shaken base, seen at its ends and by the force at the base."""
    points = ["u", *(f"x{i}" for i in range(1, n + 1))]
    other = n // 2 + 1
    values = {"k1": 400.0 * n**2, f"k{other}": 250.0 * n**2, "c1": 0.25 * n**2}
    elements = [mass(f"m{i}", f"x{i}", value=1.0) for i in range(1, n + 1)]
    for letter, kind in (("k", Kind.SPRING), ("c", Kind.DAMPER)):
        for i in range(1, n + 1):
            name = f"{letter}{i}"
            root = f"k{other}" if letter == "k" and i >= other else f"{letter}1"
            known = {"guess": 0.75 * values[name]} if name in values else {"same_as": root}
            elements.append(between(name, kind, points[i - 1], points[i], **known))
    model = Model(tuple(points[1:]), (Input("u"),), tuple(elements))
    channels = (
        Channel("first", {"x1": 1}, Quantity.ACCELERATION), Channel("end", {f"x{n}": 1}, Quantity.ACCELERATION),
        Channel("u", {"u": 1}), Channel("R", {"u": 1}, Quantity.FORCE),
    )  # fmt: skip
    U, none = np.full((lines, 1), 0.01 + 0j), np.zeros((lines, 0), dtype=complex)
    f = np.geomspace(0.5, 10, lines)
    return Bench("rod", model, values, channels, f, U, none, {"": 0.01, "u": 0.0})


@pytest.mark.parametrize(("lines", "basis"), [(10, 20), (30, 5)])
def test_the_end_is_that_of_the_whole_rig(lines: int, basis: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """With motions at all lines, and at five of thirty, where the full rig checks the others."""
    bench = rod(70, lines)
    spectrum = bench.spectrum(np.random.default_rng(1))
    whole = identify(bench.model, spectrum, MaximumLikelihood())
    monkeypatch.setattr(reduced_search, "FROM", 50)
    monkeypatch.setattr(reduced_search, "LINES", basis)
    found = identify(bench.model, spectrum, MaximumLikelihood())
    assert bool(found.converged)
    off = np.abs(found.values - whole.values) / whole.sd
    assert np.max(off) < (1e-4 if basis >= lines else 0.06)
    assert np.allclose(found.sd, whole.sd, rtol=1e-3)
    assert float(found.fit.chi2) == pytest.approx(float(whole.fit.chi2), rel=1e-3)


def test_thousands_of_coordinates_with_an_interval_that_holds() -> None:
    """Guesses 25 % off; estimates within 4 sd, intervals at the bound of the model's own information."""
    bench = rod(2000, 12)
    found = identify(bench.model, bench.spectrum(np.random.default_rng(2)), MaximumLikelihood())
    assert bool(found.converged)
    assert np.all(np.abs(found.values - bench.psi) < 4 * found.sd)
    assert np.all(found.sd < 0.02 * bench.psi)
    assert float(found.fit.p) > 1e-3
