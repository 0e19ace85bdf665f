"""From a question to its answer."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dashpot.design.advise import Question, answer
from dashpot.design.allocation import Criterion
from tests.designs import paper_setup


def test_a_doubt_of_nothing_asks_for_the_test_of_the_values() -> None:
    own = paper_setup()
    values = dict(zip((u.name for u in own.model.unknowns), own.theta[0], strict=True))
    asked = Question(
        model=own.model,
        channels=own.channels,
        criterion=Criterion("A"),
        values=values,
        samples=1000,
        band=(0.5, 25),
    )
    plain, doubted = answer(asked).plan, answer(replace(asked, uncertainty=0)).plan
    assert doubted.predicted.figure == pytest.approx(plain.predicted.figure, rel=1e-4)
