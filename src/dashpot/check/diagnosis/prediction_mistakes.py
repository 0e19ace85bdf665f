"""Plain mistakes of data that a known rig predicts badly: what makes them its own.

The rig is what an estimate says: nothing is fitted but the inputs, within what their channels show.  Each channel is
laid beside what all others expect of it; whole records stand for a few of their lines without transients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dashpot.check.diagnosis.ranking import Cause, cause_of, ranked
from dashpot.check.diagnosis.record_channels import channel_mistakes
from dashpot.check.diagnosis.search import Workbench
from dashpot.check.diagnosis.steady_lines import steady_lines
from dashpot.check.diagnosis.trials import (
    Likeness,
    Trial,
    cells,
    exchanged,
    lateness,
    likeness,
    mistakes_of_a_channel,
    untouched,
    with_form,
    without,
)
from dashpot.check.diagnosis.wording import finding, mended_in_data
from dashpot.check.element_evidence import with_guesses
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.assessment import Finding
from dashpot.estimate.preparation.prepared import prepare
from dashpot.estimate.result import Estimate
from dashpot.model.network import Model
from dashpot.model.observation import measures_input

SHOWN = 1.5  # χ² per degree of freedom of the data as they are, below which nothing is looked for
EXPLAINED = 0.2  # of it that a mistake put right may leave
OF_FREQUENCY = ("conjugate",)  # mistakes that samples cannot have


def mistakes_in_lines(model: Model, estimate: Estimate, spectrum: Spectrum) -> tuple[Finding, ...]:
    """What is wrong with the channels or the clock of data that an estimate of a linear rig predicts badly.

    The likeliest first; of each whole record by itself, of settled lines together.  () where nothing explains it.
    """
    if len(model.nonlinear) or not model.inputs:
        return ()
    of_parts = {
        f"record {count}": _mistakes(
            model, estimate, spectrum.select(np.flatnonzero(spectrum.stretch == number))
        )
        for count, number in enumerate(spectrum.records, start=1)
    }
    settled = np.flatnonzero(~np.isin(spectrum.stretch, spectrum.records))
    if len(settled):
        of_parts = {"the settled lines": _mistakes(model, estimate, spectrum.select(settled)), **of_parts}
    return _gathered(of_parts)


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
        return tuple(mended_in_data(each, "the data") for each in findings)
    return tuple(
        mended_in_data(replace(each, text=f"in {name}, {each.text}"), name)
        for name, findings in of_parts.items()
        for each in findings[:1]
    )


def _mistakes(model: Model, estimate: Estimate, spectrum: Spectrum) -> tuple[Finding, ...]:
    """Of lines that belong together."""
    try:
        lines = steady_lines(model, spectrum) if spectrum.carries_loads else spectrum
        data = prepare(model, lines, states=False)
    except DashpotError:
        return ()
    (sign,) = lines.signs(estimate.signs)
    bench, base = Workbench(data, estimate.values, sign), untouched(data)
    (as_is,) = bench.judged([base])
    if not as_is.reduced > SHOWN:
        return ()
    channels = bench.view.channels
    trials = [
        trial
        for c, channel in enumerate(channels)
        for trial in mistakes_of_a_channel(base, channel, c, bench.view.omega)
        if not (spectrum.carries_loads and trial.kind in OF_FREQUENCY)
    ]
    tried = [
        cause_of(each)
        for each in bench.judged(trials + exchanged(base, [channel.name for channel in channels]))
    ]
    tried += _mended(bench, base)
    rate, left = bench.other_rate(base)
    tried.append(Cause("frequency", (), left, rate))
    most = max(EXPLAINED * as_is.reduced, 1.0)
    explaining = [cause for cause in tried if cause.remaining < most]
    inputs = {channel.name for channel in lines.channels if measures_input(model, channel)}
    return tuple(finding(model, lines.channels, cause) for cause in ranked(explaining, as_is.reduced, inputs))


def _mended(bench: Workbench, base: Trial) -> list[Cause]:
    """Each channel put right by the simplest relation to what the others expect of it."""
    trials, relations = list[Trial](), list[Likeness]()
    omega = bench.view.omega
    for c, channel in enumerate(bench.view.channels):
        left_out = without(base, "channel", (channel.name,), cells(base.kept, column=c))
        expected = bench.expected(bench.judged([left_out])[0])[:, c]
        y, used = base.y[:, c], base.kept[:, c] & (np.abs(base.y[:, c] * expected) > 0)
        relation = likeness(y, expected, omega, used)
        late = [replace(lateness(y[used], expected[used], omega[used]), number=1.0)] if np.any(used) else []
        for form in (*late, *([] if relation is None else relation.rounded())):
            trials.append(with_form(base, channel.name, c, form, omega))
            relations.append(form)
    return [
        Cause(form.kind, outcome.trial.of, outcome.reduced, form.found, form)
        for outcome, form in zip(bench.judged(trials), relations, strict=True)
        if form.kind not in OF_FREQUENCY
    ]
