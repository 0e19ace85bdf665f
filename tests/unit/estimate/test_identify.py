"""The way down from identify: each module is entered once, by nothing it has called, and views are built once."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import FrameType

import numpy as np
import pytest

import dashpot
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

HERE = str(dashpot.__path__[0])
IDENTIFY = "estimate/identify.py"
MINIMISER = "numerics/levenberg_marquardt.py"  # asks its caller for the cost: the one way up


@dataclass(frozen=True)
class Walk:
    """What a call enters on its way down.

    again  (module, its caller) wherever a module is entered that has called another one and waits for it
    stops  the modules of estimate that identify.py itself enters by their functions, one after the other; what it reads
           of a value (a property of the model, of a spectrum) is no stop
    """

    again: set[tuple[str, str]]
    stops: list[str]


def walked(call: Callable[[], object]) -> Walk:
    stack: list[str | None] = []
    walk = Walk(set(), [])

    def module(frame: FrameType) -> str | None:
        path = frame.f_code.co_filename
        return path[len(HERE) + 1 :] if path.startswith(HERE) else None

    def is_stop(entered: str, frame: FrameType) -> bool:
        name = frame.f_code.co_qualname
        return entered.startswith("estimate/") and ("." not in name or name.endswith(".solve"))

    def profile(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            entered, waiting = module(frame), [name for name in stack if name is not None]
            if entered is not None and waiting and entered != waiting[-1]:
                if entered in waiting:
                    walk.again.add((entered, waiting[-1]))
                if waiting[-1] == IDENTIFY and is_stop(entered, frame) and walk.stops[-1:] != [entered]:
                    walk.stops.append(entered)
            stack.append(entered)
        elif event == "return" and stack:
            stack.pop()

    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
    return walk


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
def test_no_module_is_entered_twice(
    case: Callable[[], Case], kernel: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, data, method = case()
    model = replace(model)  # without what others have made of it
    built: Counter[tuple[object, ...]] = Counter()
    build = observation._observation_model

    def counted(model: Model, channels: tuple[Channel, ...], omega: Real) -> observation.ObservationModel:
        built[(len(model.inputs), *map(id, channels), omega.tobytes())] += 1
        return build(model, channels, omega)

    monkeypatch.setattr(observation, "_observation_model", counted)
    with using(kernel):
        walk = walked(lambda: identify(model, data, method))
    assert {caller for _, caller in walk.again} <= {MINIMISER}
    assert len(walk.stops) >= 8
    assert len(set(walk.stops)) == len(walk.stops)
    assert built
    assert max(built.values()) == 1
