"""How every data set of a fleet is treated."""

from __future__ import annotations

from dataclasses import dataclass, field

from dashpot.data.conditioning.settings import Conditioning
from dashpot.data.readers import Reading
from dashpot.data.spectrum import Spectrum
from dashpot.estimate.amplitudes import amplitudes_for
from dashpot.estimate.automatic import suited_method
from dashpot.estimate.method import Method
from dashpot.estimate.registry import method_class
from dashpot.model.rigfile import Rig


@dataclass(frozen=True)
class Treatment:
    """How every data set of a fleet is treated: method (None: the one that suits), conditioning of time records."""

    method: str | None = None
    conditioning: Conditioning = field(default_factory=Conditioning)
    frequency_hz: float | None = None
    positive: bool = False
    seed: int = 0

    def chosen(self, rig: Rig, spectrum: Spectrum) -> Method:
        """The method that one data set is identified by.

        Raises UsageError where there is no such method, DataError where a channel measures what the rig has not.
        """
        return suited_method(self.method, rig.model, spectrum, seed=self.seed, positive=self.positive)

    def spectrum(self, rig: Rig, reading: Reading) -> Spectrum:
        """The amplitudes of a data set; what its manifest says of conditioning counts first.

        Raises DataError where its samples cannot be used, UsageError where there is no such method.
        """
        methods = [] if self.method is None else [method_class(self.method).traits]
        return amplitudes_for(rig.model, reading, self.conditioning.changed(**reading.conditioning), methods)
