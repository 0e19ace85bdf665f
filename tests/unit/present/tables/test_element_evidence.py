"""Candidates ranked by evidence, as the terminal shows them."""

from dataclasses import replace
from io import StringIO

import pytest
from rich.console import Console

from dashpot.check.element_evidence import ElementComparison, ElementEvidence
from dashpot.model.elements import Kind, between
from dashpot.model.nonlinear.force_law import force_law
from dashpot.present.tables.element_evidence import show_elements


@pytest.mark.parametrize(("value", "said"), [(-0.3, True), (0.3, False)])
def test_a_negative_damper_is_said_to_be_one(value: float, said: bool) -> None:
    damper = replace(between("cq", Kind.DAMPER, "x", "u"), force_law=force_law("v*abs(v)", damper=True))
    best = ElementEvidence((damper,), (value,), 0.7, 50.0)
    console = Console(file=StringIO(), width=100)
    show_elements(console, ElementComparison("rig", 100.0, (best,), best))
    text = " ".join(console.file.getvalue().split())
    assert ("cq (v*abs(v), x-u, negative)" in text) == said
    assert ("comes out negative" in text) == said
