"""How records become amplitudes: every treatment of the samples, in one value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypedDict, Unpack

from dashpot.data.noise import Still
from dashpot.errors import DataError

Noise = Literal["auto", "own", "white", "blocks"]
Orders = Sequence[int] | Literal["auto"]
Harmonics = Sequence[int] | Literal["auto", "none"] | None
Drift = int | Literal["auto", "none"] | None
Settle = bool | float | Literal["auto", "none"]
Refine = bool | Literal["auto", "always", "none"]
SampleMoments = bool | Literal["auto"]
Transients = Literal["auto", "estimate", "settle", "none"]
Band = tuple[float, float] | Literal["auto"]

USUAL_DRIFT = 1


class FitTreatments(TypedDict, total=False):
    """The fields of Conditioning that one fit of harmonics knows, as keywords."""

    orders: Orders
    harmonics: Harmonics
    drift: Drift
    noise: Noise


class Treatments(FitTreatments, total=False):
    """The fields of Conditioning as keywords."""

    moments: SampleMoments
    refine: Refine
    settle: Settle
    transients: Transients
    band_hz: Band
    still: Still | None


@dataclass(frozen=True)
class Conditioning:
    """How records become amplitudes.  Every treatment is "auto", a value, or "none".

    orders     multiples of the drive frequency whose amplitudes are used as data; "auto": the fundamental and, in long
               dwells, the harmonics that appear in every channel
    harmonics  further multiples that are fitted, so that they do not count as noise; "auto" (or None): the significant
               ones up to the tenth, below half the sampling rate
    drift      degree of the polynomial removed: 0 removes the mean, "none" (or None) nothing; "auto" is 1, or 0 if some
               dwell is short and a test over all dwells shows no slope
    noise      "white": covariance of least squares; "blocks": spectrum of the residual next to each harmonic; "own":
               "white" unless the residual is coloured and there are enough periods; "auto": as "own", with the noise of
               short dwells pooled
    moments    add the second moments of the samples (order 1 alone); "auto": where possible
    refine     "auto": the stated frequency, refined if all dwells together show that it is off; a record that responds
               elsewhere is refused; "always" (or True): the most likely one near it; "none" (or False): the stated one,
               and all samples count as measured
    settle     "auto" (or True): drop the transient of each record; a number: drop that many seconds; "none" (or False)
    transients "auto": records without a frequency, dwells that follow each other in time and unsettled dwells are used
               whole, with their transients estimated; "estimate": every dwell is; "settle": none is, and if some are
               unsettled the transient of each is dropped; "none": every dwell is treated as settled
    band_hz    lowest and highest frequency of the lines of continuous records; "auto": the band in which the rig moves
    still      the noise of an at-rest record, for continuous records

    Raises DataError for orders that are not multiples, and for a drift or a time out of range.
    """

    orders: Orders = "auto"
    harmonics: Harmonics = "auto"
    drift: Drift = "auto"
    noise: Noise = "auto"
    moments: SampleMoments = False
    refine: Refine = "auto"
    settle: Settle = "none"
    transients: Transients = "auto"
    band_hz: Band = "auto"
    still: Still | None = None

    def __post_init__(self) -> None:
        if self.orders != "auto":
            object.__setattr__(self, "orders", _multiples(self.orders, "orders"))
        if not self.orders:
            raise DataError("no orders are given", cure="orders of harmonics are 1, 2, 3, …")
        if self.harmonics is None or self.harmonics == "auto":
            object.__setattr__(self, "harmonics", "auto")
        elif self.harmonics == "none":
            object.__setattr__(self, "harmonics", ())
        else:
            object.__setattr__(self, "harmonics", _multiples(self.harmonics, "harmonics"))
        if self.drift is None:
            object.__setattr__(self, "drift", "none")
        for name, on in (("refine", "always"), ("settle", "auto")):
            value = getattr(self, name)
            if isinstance(value, bool):
                object.__setattr__(self, name, on if value else "none")
        if self.moments is True and self.wanted != (1,):
            raise DataError("second moments exist for the fundamental alone", cure="use orders (1,)")
        if not 0 <= self.degree + 1 <= 100:  # no record drifts so, and polynomials of such a degree cost time
            raise DataError(f"a drift of degree {self.degree}", cure='give a degree from 0, or "none"')
        if isinstance(self.settle, int | float) and not 0 <= self.settle < 1e12:
            raise DataError(f"a settling time of {self.settle:g} s", cure="give a time that is not negative")
        if self.band_hz != "auto" and not 0 <= self.band_hz[0] < self.band_hz[1] < 1e12:
            raise DataError(
                f"a band from {self.band_hz[0]:g} to {self.band_hz[1]:g} Hz",
                cure="give the lower end first, in Hz",
            )

    @property
    def wanted(self) -> tuple[int, ...]:
        """The orders asked for; the fundamental where the dwells choose."""
        return (1,) if self.orders == "auto" else tuple(int(order) for order in self.orders)

    @property
    def degree(self) -> int:
        """Degree of the drift; −1 is nothing."""
        if self.drift is None or self.drift == "none":
            return -1
        return USUAL_DRIFT if self.drift == "auto" else int(self.drift)

    @property
    def nuisance_orders(self) -> tuple[int, ...] | None:
        """Multiples solved for in addition to the orders; None: those that are significant."""
        if self.harmonics is None or self.harmonics == "auto":
            return None
        return tuple(int(order) for order in self.harmonics if not isinstance(order, str))

    @property
    def band(self) -> tuple[float, float] | None:
        """The band of whole records, Hz; None: as far as something moves."""
        return None if self.band_hz == "auto" else self.band_hz

    @property
    def dwells_may_be_whole(self) -> bool:
        """Whether dwells may count as whole records: nothing is asked of them that is a steady state's."""
        plain = self.wanted == (1,) and self.settle == "none" and self.refine != "always"
        return plain and not self.moments and self.transients in ("auto", "estimate")

    @property
    def untried(self) -> tuple[str, ...]:
        """Treatments that help where residuals are coloured and that were not chosen: "settle", "refine"."""
        chosen = (("settle", self.settle != "none"), ("refine", self.refine == "always"))
        return tuple(name for name, is_chosen in chosen if not is_chosen)

    def changed(self, **treatments: Unpack[Treatments]) -> Conditioning:
        """The same with some treatments changed."""
        return replace(self, **treatments) if treatments else self


def conditioning_of(settings: Conditioning | None, treatments: Treatments | FitTreatments) -> Conditioning:
    """The settings given (the usual ones where there are none), changed by keywords.  Raises as Conditioning."""
    return (Conditioning() if settings is None else settings).changed(**treatments)


def _multiples(orders: Sequence[int], name: str) -> tuple[int, ...]:
    """Ascending multiples of the frequency, each once."""
    multiples = tuple(sorted({int(order) for order in orders}))
    if multiples and multiples[0] < 1:
        raise DataError(f"{name} {tuple(orders)}", cure="orders of harmonics are 1, 2, 3, …")
    return multiples
