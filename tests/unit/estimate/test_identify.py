"""The way down from identify: the view of what channels show is built once."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dashpot.arrays import Real
from dashpot.channel import Channel
from dashpot.data.conditioning.lines import spectrum
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.identify import identify
from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
from dashpot.estimate.method import Method
from dashpot.model import observation
from dashpot.model.network import Model
from dashpot.numerics.kernel import using
from tests.nonlinear_rigs import motions, settled, two_masses
from tests.partly_seen import reaction, two
from tests.whole_rigs import chain, record_of

Case = tuple[Model, Spectrum, Method | str]


def seen() -> Case:
    bench = two(full=True)
    return bench.model, bench.spectrum(np.random.default_rng(1)), "oiv"


def from_afar() -> Case:
    bench = reaction()
    return (
        bench.model,
        bench.spectrum(np.random.default_rng(1)),
        MaximumLikelihood(starts=4, candidates=20, rounds=1),
    )


def whole() -> Case:
    model, theta = chain(1, 0.08, seed=1)
    test = record_of(model, theta, "random", decay_times=3.0)
    sd = 0.01 * np.std(test.record.values, axis=0) * [1, 0]
    return model, spectrum([test.noisy(np.random.default_rng(1), sd)]), "ml"


def nonlinear() -> Case:
    model, theta = two_masses("cubic")
    return (
        model,
        settled(model, theta, motions("x1", "x2", "u"), [2, 3, 4, 5, 6, 7, 8, 9.5, 11], noise=0.01),
        "ml",
    )


@pytest.mark.parametrize("kernel", ["auto", "numpy"])
@pytest.mark.parametrize("case", [seen, from_afar, whole, nonlinear])
def test_views_are_built_once(case: Callable[[], Case], kernel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    model, data, method = case()
    model = replace(model)  # without what others have made of it
    built: Counter[tuple[object, ...]] = Counter()
    build = observation.ObservationModel

    def counted(
        model: Model, channels: tuple[Channel, ...], omega: Real, *rest: Any
    ) -> observation.ObservationModel:
        built[(len(model.inputs), *map(id, channels), omega.tobytes())] += 1
        return build(model, channels, omega, *rest)

    monkeypatch.setattr(observation, "ObservationModel", counted)
    with using(kernel):
        identify(model, data, method)
    assert built
    assert max(built.values()) == 1
