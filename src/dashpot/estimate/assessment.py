"""What an estimate is worth to someone who must sign it: a verdict, the worst misfits, and what may be wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Literal

from dashpot.channel import Channel
from dashpot.model.elements import Element
from dashpot.model.network import Model
from dashpot.notices import Notice

Judgement = Literal["fits", "does not fit", "cannot tell"]


@dataclass(frozen=True)
class Misfit:
    """One amplitude and how far it is from what the rig predicts, in standard deviations."""

    channel: str
    frequency_hz: float
    sd: float


@dataclass(frozen=True)
class Discrepancy:
    """What the rig leaves of a channel's motion beyond noise, as a share of it, with one-sided 95 % bounds.

    within  the share within which the channel counts as described: what was asked, or what suits its noise
    """

    value: float
    lower95: float
    upper95: float
    within: float


@dataclass(frozen=True)
class Finding:
    """One possible cause of a misfit.

    kind       "sign", "unit", "swap", "conjugate", "quantity", "frequency", "dwell", "delay", "gain", "value",
               "element", "two", "crosstalk", "nonlinear", "changed", "time" or "channel"; "damping" or "mode" of
               measured modes
    of         what is meant: the channel, both channels of a swap or of two mistakes, the frequency of a dwell or of
               two, the points that an element would join; empty where it concerns everything
    text, change  in words, and what to write in the rig file or to do with the data
    remaining  χ² over its degrees of freedom with the remedy taken; None if it was not tried or no noise is known
    number     what was found: a gain, a delay in s, a frequency in Hz, a parameter
    channels, elements  entries of the rig file as they would be; () where the data must be mended
    odds       of this cause after the data, among all that were tried and what was not; None if it has none
    explains   share of the misfit that it explains
    group      a number shared by causes that these data cannot tell apart; None if it stands alone
    beside     whether it is wrong in addition to the first cause, not in its place
    """

    kind: str
    of: tuple[str, ...]
    text: str
    change: str
    remaining: float | None
    number: float | None = None
    channels: tuple[Channel, ...] = ()
    elements: tuple[Element, ...] = ()
    odds: float | None = None
    explains: float | None = None
    group: int | None = None
    beside: bool = False

    def content(self) -> dict[str, Any]:
        """As the JSON of an estimate has it."""
        return {
            "kind": self.kind, "of": list(self.of), "text": self.text, "change": self.change,
            "remaining": self.remaining, "number": self.number, "odds": self.odds, "explains": self.explains,
            "group": self.group, "beside": self.beside,
        }  # fmt: skip


@dataclass(frozen=True)
class Assessment:
    """Does the rig fit, how well in parts of the motion, and what is worst.

    reasons            why the verdict is not "fits"
    relative_residual  rms of measured − predicted over rms of measured, for each channel
    relative_noise     what of that the noise alone would leave, for the same channels; empty where the noise is not
                       known from more than the residuals
    worst              the amplitudes furthest from the prediction, the worst first
    findings           possible causes, the best first; empty where all is well or nothing tried explains it
    discrepancy        what the rig leaves of each channel beyond noise; None if they cannot be told apart
    within             the share of the motion asked for, or the largest that the channels' noise suggests; None: none
    """

    verdict: Judgement
    reasons: tuple[Notice, ...] = ()
    relative_residual: Mapping[str, float] = field(default_factory=dict)
    worst: tuple[Misfit, ...] = ()
    findings: tuple[Finding, ...] = ()
    relative_noise: Mapping[str, float] = field(default_factory=dict)
    discrepancy: Mapping[str, Discrepancy | None] = field(default_factory=dict)
    within: float | None = None

    def __post_init__(self) -> None:
        for name in ("relative_residual", "relative_noise", "discrepancy"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def cause(self) -> Finding | None:
        """The likeliest cause; None if there is none, or something that is not listed is likelier."""
        return self.findings[0] if self.findings and self.findings[0].kind != "unexplained" else None

    def __reduce__(self) -> tuple[object, ...]:
        values = (getattr(self, each.name) for each in fields(self))
        return Assessment, tuple(
            dict(value) if isinstance(value, MappingProxyType) else value for value in values
        )

    @property
    def described(self) -> bool:
        """Whether the data show every channel to be described as closely as it should."""
        shares = self.discrepancy.values()
        return bool(shares) and all(each is not None and each.upper95 <= each.within for each in shares)

    def fit_content(self) -> dict[str, Any]:
        """What the JSON of an estimate says of the fit in addition to χ²."""
        return {
            "verdict": self.verdict,
            "reasons": [notice.text for notice in self.reasons],
            "reason_codes": [notice.code for notice in self.reasons],
            "relative_residual": dict(self.relative_residual),
            "relative_noise": dict(self.relative_noise),
            "discrepancy": {
                name: dict.fromkeys(("value", "lower95", "upper95", "within"))
                if each is None
                else asdict(each)
                for name, each in self.discrepancy.items()
            },
            "within": self.within,
            "worst": [
                {"channel": line.channel, "frequency_hz": line.frequency_hz, "sd": line.sd}
                for line in self.worst
            ],
        }


def assessment_from(fit: Mapping[str, Any], diagnosis: Sequence[Mapping[str, Any]]) -> Assessment | None:
    """The assessment in the JSON of an estimate; None if there is none.  Entries of rig files are not kept there."""
    if "verdict" not in fit:
        return None
    reasons = tuple(
        Notice(code, text) for code, text in zip(fit["reason_codes"], fit["reasons"], strict=True)
    )
    worst = tuple(Misfit(w["channel"], float(w["frequency_hz"]), float(w["sd"])) for w in fit["worst"])
    findings = tuple(
        Finding(
            d["kind"],
            tuple(d["of"]),
            d["text"],
            d["change"],
            d["remaining"],
            d["number"],
            odds=d.get("odds"),
            explains=d.get("explains"),
            group=d.get("group"),
            beside=d.get("beside", False),
        )
        for d in diagnosis
    )
    # Files of former versions have no noise and no discrepancy.
    shares = fit.get("discrepancy", {}).items()
    discrepancy = {name: None if share["value"] is None else Discrepancy(**share) for name, share in shares}
    noise, within = fit.get("relative_noise", {}), fit.get("within")
    return Assessment(
        fit["verdict"], reasons, fit["relative_residual"], worst, findings, noise, discrepancy, within
    )


def applied(model: Model, channels: Sequence[Channel], finding: Finding) -> tuple[Model, tuple[Channel, ...]]:
    """Model and channels with a finding's remedy taken: entries of the same names replaced, new elements added.

    Points of new elements that the rig has not are coordinates of a body that it lacks.
    """
    changed = {channel.name: channel for channel in finding.channels}
    elements = {element.name: element for element in finding.elements}
    kept = tuple(elements.pop(element.name, element) for element in model.elements)
    there = {*model.coordinates, *model.displacement_inputs}
    bodies = dict.fromkeys(point for each in elements.values() for point in each.along if point not in there)
    new_model = replace(
        model, coordinates=(*model.coordinates, *bodies), elements=(*kept, *elements.values())
    )
    return new_model, tuple(changed.get(channel.name, channel) for channel in channels)
