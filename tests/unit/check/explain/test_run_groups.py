"""A rig that is changed between runs."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.explain.examine import diagnose
from dashpot.check.residuals import channel_response
from dashpot.data.conditioning.lines import spectrum as conditioned
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.assessment import Finding
from dashpot.model.network import Model
from dashpot.model.rigfile import parse_rig
from tests import rigs
from tests.unit.check.explain.test_diagnose import clean


def changed(model: Model, spectrum: Spectrum, element: str, factor: float, where: np.ndarray) -> Spectrum:
    """The paper's rig with one part times a factor at the lines `where`; the base moves alike, noise as it was."""
    p = model.parameters(rigs.paper_rig().theta)
    other = np.where([e.name == element for e in model.elements], factor * p, p)
    base = spectrum.amplitudes[:, spectrum.index("u")]
    away = [
        (channel_response(model, parts, spectrum.channels, spectrum.omega)[..., 0].T * base).T
        for parts in (p, other)
    ]
    return replace(spectrum, amplitudes=spectrum.amplitudes + where[:, None] * (away[1] - away[0]))


def named(element: str, *, by_experiment: bool) -> Finding:
    model, spectrum = clean("paper", np.random.default_rng(3))
    late = np.arange(spectrum.lines) % 2 == 1 if by_experiment else np.arange(spectrum.lines) >= 13
    data = changed(model, spectrum, element, 1.2, late)
    return diagnose(model, replace(data, experiment=late.astype(int)) if by_experiment else data)[0]


@pytest.mark.slow
@pytest.mark.parametrize(("element", "by_experiment"), [("m2", False), ("k2", True)])
def test_what_is_not_the_same_in_all_runs_is_named(element: str, by_experiment: bool) -> None:
    """A part that is sought (m2) and one whose value is stated (k2)."""
    best = named(element, by_experiment=by_experiment)
    assert (best.kind, best.of) == ("changed", (element,))
    assert best.number is not None
    value = dict(zip(*_parts(), strict=True))[element]
    assert abs(best.number) == pytest.approx(0.2 * value, rel=0.15)
    assert ("experiment" if by_experiment else "Hz on") in best.text
    assert best.remaining < 1.5


@pytest.mark.slow
def test_a_value_with_a_tolerance_is_free_of_it_where_it_changed() -> None:
    model, spectrum = clean("paper", np.random.default_rng(3))
    late = np.arange(spectrum.lines) >= 13
    data = changed(model, spectrum, "k2", 1.2, late)
    stated = tuple(replace(e, sd=0.002 * e.value) if e.name == "k2" else e for e in model.elements)
    best = diagnose(replace(model, elements=stated), data)[0]
    assert (best.kind, best.of) == ("changed", ("k2",))
    assert best.number is not None
    assert abs(best.number) == pytest.approx(0.2 * dict(zip(*_parts(), strict=True))["k2"], rel=0.15)
    assert best.remaining < 1.5


RIG_OF_ONE = parse_rig(
    """
coordinates = ["x1", "x2"]
[inputs]
u = {}
[masses]
m1 = { at = "x1", value = 1 }
m2 = { at = "x2", value = 1 }
[springs]
k = { between = ["x1", "u"], guess = 100 }
k2 = { between = ["x2", "x1"], value = 100 }
[dampers]
c = { between = ["x1", "u"], value = 1 }
[channels]
x1 = { of = "x1", noise = 1e-5 }
x2 = { of = "x2", noise = 1e-5 }
u = { of = "u", noise = 1e-5 }
""",
    "rig.toml",
)


@pytest.mark.slow
def test_one_run_cannot_be_parted() -> None:
    """One line has more numbers than the rig has unknowns."""
    only = conditioned(RIG_OF_ONE.simulate({"k": 100.0}, [1.0], samples=60, amplitudes={"u": 0.01}, seed=1))
    away = replace(only, amplitudes=only.amplitudes * np.array([1 + 1j, 2 - 1j, 1]))
    assert all(cause.kind != "changed" for cause in diagnose(RIG_OF_ONE.model, away))


def _parts() -> tuple[list[str], list[float]]:
    rig = rigs.paper_rig()
    return [e.name for e in rig.model.elements], rig.model.parameters(rig.theta).tolist()
