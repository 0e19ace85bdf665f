"""Modes that have died away before a free decay begins are named, with the unknowns that rest on them."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.check.verdict import assess
from dashpot.data.conditioning.whole_record import whole_record
from dashpot.data.record import Record
from dashpot.estimate.identify import identify
from dashpot.model.network import Model
from dashpot.notices import Notice
from tests.whole_rigs import chain, record_of

MODEL, THETA = chain(3, 0.02, base=False)
DECAY = record_of(MODEL, THETA, "none", decay_times=6, samples_per_cycle=8, seed=3)


def judged(model: Model, begin: float, seed: int) -> tuple[str, list[Notice]]:
    """Verdict and what is said of unseen modes of a decay that begins so late, as a share of its length."""
    noisy = DECAY.noisy(np.random.default_rng(seed), 0.02 * DECAY.size)
    rows = slice(int(begin * len(noisy.time)), None)
    spectrum = whole_record(Record(noisy.channels, noisy.time[rows], noisy.values[rows]))
    estimate = identify(model, spectrum)
    said = [notice for notice in estimate.warnings if notice.code == "modes_unseen"]
    return assess(model, spectrum, estimate).verdict, said


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_a_decay_that_begins_late_leaves_modes_to_the_noise(seed: int) -> None:
    assert judged(MODEL, 0.0, seed) == ("fits", [])
    verdict, said = judged(MODEL, 0.3, seed)
    assert verdict != "fits"
    assert len(said) == 1
    assert "m3" in said[0].of


def test_an_unseen_mode_of_parts_that_are_known_is_nothing_to_tell() -> None:
    """The lowest mode gives one spring and one damper, the others being known."""
    known = {"k1", "c1"}
    model = replace(
        MODEL,
        elements=tuple(
            element
            if element.value is not None or element.name in known
            else replace(element, value=float(THETA[MODEL.unknown_names.index(element.name)]))
            for element in MODEL.elements
        ),
    )
    assert set(model.unknown_names) == known
    assert judged(model, 0.3, 0) == ("fits", [])
