"""Amplitudes for one rig: what its elements and the methods ask of the conditioning, decided here for everyone."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from dashpot.data.conditioning.settings import Conditioning, Orders, SampleMoments
from dashpot.data.readers import Reading
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.likelihood.settling import with_settling_decided
from dashpot.estimate.method import Traits
from dashpot.model.network import Model

HIGHEST = 5  # harmonics of dwells that tell of nonlinear elements, as far as the sampling shows them
USABLE = 0.45  # of the sampling rate


def amplitudes_for(
    model: Model, reading: Reading, settings: Conditioning, methods: Collection[Traits]
) -> Spectrum:
    """The amplitudes of all that was read, treated as the rig and the methods need, short dwells decided.

    `settings` as of `conditioning_for`.  Raises DataError where a method needs samples that the files do not hold.
    """
    treated = conditioning_for(model, reading, settings, methods)
    return with_settling_decided(model, reading.spectrum(treated))


def conditioning_for(
    model: Model, reading: Reading, settings: Conditioning, methods: Collection[Traits]
) -> Conditioning:
    """The settings, with what they leave open decided by the rig and by what the methods declare to need.

    Second moments: a single method that cannot do without insists on them.  Dwells that have not settled are cut to
    what has, rather than used whole, where one of the methods knows no transients or the rig is not linear.  Of a
    nonlinear rig, harmonics are data.
    """
    needs = [traits.moments for traits in methods]
    moments: SampleMoments = False
    if reading.amplitudes is None and any(needs):
        moments = needs[0] if len(needs) == 1 else "auto"
    changed = settings.changed(moments=moments)
    nonlinear = bool(len(model.nonlinear))
    if changed.transients == "auto" and (nonlinear or not all(traits.transients for traits in methods)):
        changed = changed.changed(transients="settle")
    if nonlinear and changed.orders == "auto":
        changed = changed.changed(orders=_orders_of_nonlinear(reading.records))
    return changed


def _orders_of_nonlinear(records: Sequence[Record]) -> Orders:
    """Multiples of the drive frequency of dwells, as far as they are sampled."""
    highest = HIGHEST
    for record in records:
        if record.frequency_hz is not None and len(record.time) > 1:
            rate = (len(record.time) - 1) / float(record.time[-1] - record.time[0])
            highest = min(highest, int(USABLE * rate / record.frequency_hz))
            highest = min(highest, (len(record.time) - 4) // 3)
    return tuple(range(1, max(highest, 1) + 1))
