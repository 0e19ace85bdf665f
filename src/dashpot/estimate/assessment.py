"""What an estimate is worth to someone who must sign it: a verdict, the worst misfits, and what may be wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from dashpot.arrays import Complex, Frozen, Ints, Real
from dashpot.channel import Channel
from dashpot.io.json_document import numbers_of
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
class Residuals(Frozen):
    """Measured against predicted, SI units.

    channels, units       names, and SI units of their amplitudes
    input_names, input_units  of the inputs
    frequency_hz, experiment  of the lines, (lines,)
    measured, predicted   complex amplitudes, (lines, channels); NaN where a channel was not measured
    sd                    of the real (and of the imaginary) part of the measured amplitude, (lines, channels)
    normalised            (measured − predicted) over the standard deviation of this difference after v was fitted,
                          (lines, channels); NaN where that is 0.  Real and imaginary parts have variance 1 if the model
                          is right and the noise is as stated.
    variance              of measured − predicted if the model is right, real and imaginary parts together,
                          (lines, channels)
    inputs                v̂, (lines, inputs), in the order of `input_names`
    scaled                whether the noise was unknown and was scaled to give `normalised` an overall variance of 1
    transients            whether `measured` and `predicted` have those of the ends of whole records
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    frequency_hz: Real
    experiment: Ints
    measured: Complex
    predicted: Complex
    sd: Real
    normalised: Complex
    variance: Real
    inputs: Complex
    scaled: bool
    transients: bool = False

    def compared(self) -> list[int]:
        """Places of the channels that can be compared with a prediction."""
        return [i for i in range(len(self.channels)) if np.any(np.isfinite(self.normalised[:, i]))]

    def largest(self, count: int) -> list[Misfit]:
        """The largest residuals, `count` at the most; those of 0 are none."""
        size = np.nan_to_num(np.abs(self.normalised)) / np.sqrt(2)
        # Equal ones, such as those of two channels that show one motion, in their order whatever the rounding.
        order = np.argsort(-np.round(size / np.max(size, initial=1e-300), 9), axis=None, kind="stable")
        places = (np.unravel_index(int(k), size.shape) for k in order[:count])
        found = (
            (self.channels[c], float(self.frequency_hz[line]), float(size[line, c])) for line, c in places
        )
        return [Misfit(*each) for each in found if each[2] > 0]

    def rms(self) -> Real:
        """Root mean square of the normalised residuals of each channel, (channels,): 1 if model and noise are right."""
        finite = np.isfinite(self.normalised)
        power = np.sum(np.where(finite, np.abs(self.normalised) ** 2, 0.0), axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            rms: Real = np.sqrt(power / (2 * np.sum(finite, axis=0)))
        return rms

    def content(self) -> dict[str, Any]:
        """As the JSON of an estimate has it, to 7 digits."""
        off = np.where(np.isfinite(self.normalised), np.sqrt(self.variance / 2), np.nan)
        channels = {
            name: {
                "unit": unit,
                "measured": _parts(self.measured[:, c]) | {"sd": _short(self.sd[:, c])},
                "predicted": _parts(self.predicted[:, c]),
                "sd_of_difference": _short(off[:, c]),
            }
            for c, (name, unit) in enumerate(zip(self.channels, self.units, strict=True))
        }
        named = zip(self.input_names, self.input_units, self.inputs.T, strict=True)
        return {
            "frequency_hz": self.frequency_hz.tolist(),
            "experiment": self.experiment.tolist(),
            "channels": channels,
            "inputs": {name: {"unit": unit} | _parts(values) for name, unit, values in named},
            "scaled": self.scaled,
            "transients": self.transients,
        }


def _parts(values: Complex) -> dict[str, list[float]]:
    return {"re": _short(values.real), "im": _short(values.imag)}


def _short(values: Real) -> list[float]:
    return [float(f"{value:.7g}") for value in values.tolist()]


def residuals_from(content: Mapping[str, Any]) -> Residuals:
    """The residuals in the JSON of an estimate.  Raises what Python raises where something is missing or wrong."""
    channels, inputs = content["channels"], content["inputs"]
    frequency_hz = np.array(content["frequency_hz"], dtype=float)

    def table(entries: Sequence[Sequence[Any]]) -> Real:
        return np.array([*map(numbers_of, entries)]).reshape(len(entries), len(frequency_hz)).T

    def both(entries: Sequence[Mapping[str, Any]]) -> Complex:
        return table([each["re"] for each in entries]) + 1j * table([each["im"] for each in entries])

    each = [*channels.values()]
    measured, predicted = (both([entry[of] for entry in each]) for of in ("measured", "predicted"))
    off = table([entry["sd_of_difference"] for entry in each])
    with np.errstate(invalid="ignore", divide="ignore"):
        normalised = (measured - predicted) / off
    return Residuals(
        tuple(channels),
        tuple(str(entry["unit"]) for entry in each),
        tuple(inputs),
        tuple(str(entry["unit"]) for entry in inputs.values()),
        frequency_hz,
        np.array(content["experiment"], dtype=np.int64).reshape(frequency_hz.shape),
        measured,
        predicted,
        table([entry["measured"]["sd"] for entry in each]),
        normalised,
        2 * np.nan_to_num(off) ** 2,
        both([*inputs.values()]),
        bool(content["scaled"]),
        bool(content["transients"]),
    )


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
    residuals          line by line; None where the data have no lines
    """

    verdict: Judgement
    reasons: tuple[Notice, ...] = ()
    relative_residual: Mapping[str, float] = field(default_factory=dict)
    worst: tuple[Misfit, ...] = ()
    findings: tuple[Finding, ...] = ()
    relative_noise: Mapping[str, float] = field(default_factory=dict)
    discrepancy: Mapping[str, Discrepancy | None] = field(default_factory=dict)
    within: float | None = None
    residuals: Residuals | None = field(default=None, repr=False, compare=False)

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


def assessment_from(content: Mapping[str, Any]) -> Assessment | None:
    """The assessment in the JSON of an estimate; None if there is none.  Entries of rig files are not kept there."""
    fit, diagnosis, lines = content["fit"], content.get("diagnosis", ()), content.get("lines")
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
        fit["verdict"],
        reasons,
        fit["relative_residual"],
        worst,
        findings,
        noise,
        discrepancy,
        within,
        None if lines is None else residuals_from(lines),
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
