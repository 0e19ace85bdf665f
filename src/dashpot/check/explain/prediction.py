"""Mistakes of data that a known rig predicts badly: what makes them its own.

The rig is what an estimate says: nothing is fitted but the inputs, within what their channels show.  Whole records are
represented by a few of their lines without transients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dashpot.check.element_evidence import with_guesses
from dashpot.check.explain.channels import in_data
from dashpot.check.explain.engine import mistakes_of_data
from dashpot.check.explain.problem import LineProblem
from dashpot.check.explain.record_channels import channel_mistakes
from dashpot.check.explain.steady_lines import steady_lines
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.assessment import Finding
from dashpot.estimate.preparation import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model

SHOWN = 1.5  # χ² per degree of freedom of the data as they are, below which nothing is looked for
EXPLAINED = 0.8  # share of the misfit that a mistake must explain, of a rig that is known


def mistakes_in_lines(model: Model, estimate: Estimate, spectrum: Spectrum) -> tuple[Finding, ...]:
    """What is wrong with the channels or the clock of data that an estimate of a linear rig predicts badly.

    The likeliest first; of each whole record by itself, of settled lines together.  () where nothing explains it.
    """
    if len(model.nonlinear) or not model.inputs:
        return ()
    settled = ~np.isin(spectrum.stretch, spectrum.records)
    of_parts = {"the settled lines": settled} if np.any(settled) else {}
    of_parts |= {f"record {k}": spectrum.stretch == n for k, n in enumerate(spectrum.records, start=1)}
    return _gathered(
        {
            name: _mistakes(model, estimate, spectrum.select(np.flatnonzero(at)))
            for name, at in of_parts.items()
        }
    )


def mistakes_in_records(model: Model, estimate: Estimate, records: Sequence[Record]) -> tuple[Finding, ...]:
    """As `mistakes_in_lines`, of whole records of a nonlinear rig, whose estimate stands for guesses."""
    known = with_guesses(model, estimate)
    return _gathered(
        {f"record {k}": channel_mistakes(known, record) for k, record in enumerate(records, start=1)}
    )


def _gathered(of_parts: Mapping[str, tuple[Finding, ...]]) -> tuple[Finding, ...]:
    """The findings of the only part with what to do with its numbers, the first of each of several with its name."""
    if len(of_parts) == 1:
        (findings,) = of_parts.values()
        return tuple(_in_data(each, "the data") for each in findings)
    return tuple(
        _in_data(replace(each, text=f"in {name}, {each.text}"), name)
        for name, findings in of_parts.items()
        for each in findings[:1]
    )


def _in_data(cause: Finding, where: str) -> Finding:
    """With what to do with the numbers in `where`: the line of the rig file is right for other data."""
    return replace(cause, change=in_data(cause, where), channels=(), elements=())


def _mistakes(model: Model, estimate: Estimate, spectrum: Spectrum) -> tuple[Finding, ...]:
    """Of lines that belong together."""
    try:
        lines = steady_lines(model, spectrum) if spectrum.carries_loads else spectrum
        data = prepare(model, lines, states=False)
    except DashpotError:
        return ()
    (sign,) = lines.signs(estimate.signs)
    found = mistakes_of_data(LineProblem(data, sign, (estimate.values,)))
    if not found.as_is.reduced > SHOWN:
        return ()
    return tuple(cause.finding(data.noise_known) for cause in found.causes if cause.explains > EXPLAINED)
