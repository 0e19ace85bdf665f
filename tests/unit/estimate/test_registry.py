"""Estimators by name: what each declares is all that others know of it."""

import sys
from dataclasses import dataclass, fields
from types import MappingProxyType, ModuleType
from typing import ClassVar

import numpy as np
import pytest

from dashpot import DataError, MaximumLikelihood, OptimalIV, UsageError, compare, identify
from dashpot.check.structure import require_scale_seen
from dashpot.estimate import registry
from dashpot.estimate.identify import automatic
from dashpot.estimate.method import Method, Solution, Traits
from dashpot.estimate.preparation import Prepared
from dashpot.estimate.registry import METHODS, method, method_class
from tests.partly_seen import noisy_base


def test_every_name_is_that_of_its_class() -> None:
    for name in METHODS:
        kind = method_class(name)
        assert kind.name == name
        assert isinstance(kind.traits, Traits)
        assert isinstance(method(name), kind)


def test_settings_are_taken_or_refused() -> None:
    """A seed may be given to all; a setting that a method has not is an error, not a silence."""
    found = method("ml", seed=7, starts=3)
    assert isinstance(found, MaximumLikelihood)
    assert (found.seed, found.starts) == (7, 3)
    assert method("oiv", seed=7) == OptimalIV()
    with pytest.raises(UsageError, match="oiv has no setting positive") as caught:
        method("oiv", positive=True)
    assert "max_iterations" in str(caught.value.problems[0].cure)
    with pytest.raises(UsageError, match="ls has no setting positive"):
        method("ls", positive=True)
    with pytest.raises(UsageError, match="there is no method best"):
        method("best")


def test_declarations_agree_with_the_classes() -> None:
    """What can be seen of a class says the same as its declaration."""
    for name in METHODS:
        kind = method_class(name)
        settings = {entry.name for entry in fields(kind)}  # type: ignore[arg-type]
        assert ("positive" in settings) == kind.traits.bounds
        assert not (kind.traits.moments and kind.traits.by_output)


@dataclass(frozen=True)
class Oracle(Method):
    """Says what it has been told: a new estimator, as someone would add it."""

    answer: float = 1.0
    name: ClassVar[str] = "oracle"
    traits: ClassVar[Traits] = Traits(by_output=True, maximum_likelihood=True)

    def solve(self, data: Prepared) -> Solution:
        """The truth times `answer`."""
        repeats, m = len(data.spectrum.amplitudes), len(data.model.unknowns)
        theta = np.full((repeats, m), self.answer) * noisy_base().psi[:m]
        good = np.ones(repeats, dtype=bool)
        return Solution(
            theta, np.tile(np.eye(m), (repeats, 1, 1)), good, np.zeros(repeats, dtype=int), theta[:1]
        )


@pytest.fixture
def oracle(monkeypatch: pytest.MonkeyPatch) -> None:
    """One line in the registry, and a module with one class."""
    module = ModuleType("dashpot.estimate.oracle")
    module.Oracle = Oracle  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "dashpot.estimate.oracle", module)
    monkeypatch.setattr(registry, "METHODS", MappingProxyType({**METHODS, "oracle": ("oracle", "Oracle")}))


@pytest.mark.usefixtures("oracle")
def test_a_new_estimator_is_one_class_and_one_line() -> None:
    """It identifies, is compared, judged and chosen by what it declares; no other module knows its name."""
    bench = noisy_base()
    spectrum = bench.spectrum(np.random.default_rng(1))
    found = identify(bench.model, spectrum, "oracle")
    assert found.method == "oracle"
    np.testing.assert_allclose(found.values, bench.psi)
    assert not found.fit.rejected
    require_scale_seen(method_class("oracle"), bench.model, spectrum.channels)
    beside = compare(bench.model, spectrum, {"oracle": method("oracle", answer=1.01), "ml": method("ml")})
    assert beside.most_likely == ("oracle", "ml")
    assert beside.centre(found.names[0]) == pytest.approx(1.01 * bench.psi[0])


def test_the_equation_needs_every_coordinate() -> None:
    """What a method declares to need is asked for before it solves, with one message for all."""
    bench = noisy_base()
    spectrum = bench.spectrum(np.random.default_rng(1))
    assert isinstance(automatic(bench.model, spectrum), MaximumLikelihood)
    for name in METHODS:
        if not method_class(name).traits.by_output:
            with pytest.raises(DataError, match="no channel measures"):
                identify(bench.model, spectrum, name)
