"""Trials: the data as they would be had one thing been otherwise.

Every remedy that leaves the rig as it is becomes one row of a batch: the same model fitted to other amplitudes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Complex, Real
from dashpot.channel import Channel, Quantity
from dashpot.estimate.likelihood.objective import inputs_seen
from dashpot.estimate.preparation.prepared import Prepared
from dashpot.model.observation import ObservationModel

# What a channel shows against what the rest of the data say it should show: a factor, a delay, another
# derivative.


RATIOS = (
    1e3, 1e-3, 1e6, 1e-6, 100.0, 0.01, 9.80665, 1 / 9.80665, 2**0.5, 0.5**0.5, 2.0, 0.5,
    180 / np.pi, np.pi / 180, 2 * np.pi, 1 / (2 * np.pi), 25.4, 1 / 25.4, 0.0254, 1 / 0.0254, 9806.65, 1 / 9806.65,
)  # fmt: skip
OF_FORCES = RATIOS[:12]  # forces are in no inches and no degrees
CLOSE = 0.015  # relative distance within which a gain is taken for a known ratio
NEAR = 0.25  # nepers within which a usual ratio is tried in the place of what was found
PERIODS = 1.5  # of the highest frequency: the longest delay that is looked for
ALIKE = 0.05  # part of a channel's power (in relative terms) that a likeness may leave
BETTER = 0.3  # a less particular form must leave this much less than the more particular one


@dataclass(frozen=True)
class Likeness:
    """shown ≈ number · (jω)^power · e^{−jω delay} · expected (or its conjugate); `left` is the part not explained."""

    number: float
    power: int
    delay: float
    conjugate: bool
    left: float

    @property
    def kind(self) -> str:
        """The kind of finding that this is."""
        if self.conjugate:
            return "conjugate"
        if self.power:
            return "quantity"
        if self.delay:
            return "delay"
        if abs(self.number + 1) < CLOSE:
            return "sign"
        return "unit" if known_ratio(self.number) is not None else "gain"

    @property
    def found(self) -> float:
        """The number that the finding is about: a delay in s, else the factor."""
        return self.delay if self.kind == "delay" else self.number

    def rounded(self) -> list[Likeness]:
        """This, and before it what it may be meant to be: a usual ratio of units nearby, no delay."""
        if self.conjugate or self.delay:
            return [self]
        if self.power:
            plain = replace(self, number=float(np.copysign(1.0, self.number)))
            return [plain, self] if abs(np.log(abs(self.number))) < NEAR else [self]
        near = [ratio for ratio in RATIOS if abs(np.log(abs(self.number) / ratio)) < NEAR]
        exact = [replace(self, number=float(np.copysign(ratio, self.number))) for ratio in near]
        return [*exact, self]

    def factor(self, omega: Real) -> Complex:
        """What the channel must be multiplied by to be right, (lines,)."""
        wrong = self.number * (1j * omega) ** self.power * np.exp(-1j * omega * self.delay)
        return 1 / wrong


def known_ratio(number: float) -> float | None:
    """The usual ratio of units that a gain (of either sign) is, None where it is none."""
    for ratio in RATIOS:
        if abs(abs(number) / ratio - 1) < CLOSE:
            return ratio
    return None


def likeness(shown: Complex, expected: Complex, omega: Real, used: Bools) -> Likeness | None:
    """The simplest relation of what a channel shows to what it should, both (lines,); None where there is none."""
    used = used & (np.abs(expected) > 0) & np.isfinite(expected) & (np.abs(shown) > 0)
    if np.sum(used) < 3:
        return None
    y, e, w = shown[used], expected[used], omega[used]
    forms = [_real(y, e, w, 0, False), _real(y, e, w, 0, True)]
    forms += [_real(y, e, w, power, False) for power in (-2, -1, 1, 2)]
    forms.append(lateness(y, e, w))
    best = forms[0]
    for form in forms[1:]:
        if form.left < BETTER * best.left:
            best = form
    return best if best.left < ALIKE else None


def _real(y: Complex, e: Complex, omega: Real, power: int, conjugate: bool) -> Likeness:
    middle = float(np.exp(np.mean(np.log(omega))))
    model = (np.conj(e) if conjugate else e) * (1j * omega / middle) ** power
    relative = y / model
    # The median of each part stands up to some dwells that are wrong.
    number = float(np.median(relative.real))
    left = float(np.mean(np.minimum(np.abs(relative / number - 1) ** 2, 1.0))) if number else np.inf
    return Likeness(number / middle**power, power, 0.0, conjugate, left)


def lateness(y: Complex, e: Complex, omega: Real) -> Likeness:
    """The delay and the factor by which y (lines,) is nearest to e, however near that is."""
    relative = y / e
    turn = relative / np.abs(relative)
    reach = 2 * np.pi * PERIODS / np.max(omega)
    taus = np.linspace(-reach, reach, 1201)
    match = np.abs(np.mean(turn * np.exp(1j * np.outer(taus, omega)), axis=1).real)
    tau = float(taus[int(np.argmax(match))])
    phase = np.angle(
        turn * np.exp(1j * omega * tau) * np.sign(np.mean((turn * np.exp(1j * omega * tau)).real))
    )
    tau -= float(np.sum(phase * omega) / np.sum(omega**2))
    number = float(np.median((relative * np.exp(1j * omega * tau)).real))
    left = float(np.mean(np.minimum(np.abs(relative * np.exp(1j * omega * tau) / number - 1) ** 2, 1.0)))
    return Likeness(number, 0, tau, False, left)


@dataclass(frozen=True)
class Trial:
    """The data under one supposition.

    y (lines, channels) and V (lines, channels, channels) as they would be; kept (lines, channels): what is used.
    """

    kind: str
    of: tuple[str, ...]
    value: float
    y: Complex
    V: Complex
    kept: Bools


@dataclass(frozen=True)
class Outcome:
    """What a trial's fit left: χ² at ψ (M,), with `dof` degrees of freedom."""

    trial: Trial
    chi2: float
    dof: int
    psi: Real

    @property
    def reduced(self) -> float:
        """χ² over its degrees of freedom."""
        return self.chi2 / max(self.dof, 1)


def untouched(data: Prepared) -> Trial:
    """The data of one repeat as they are."""
    y = data.spectrum.amplitudes[0]
    return Trial("", (), 1.0, np.nan_to_num(y), data.covariance[0], np.isfinite(y))


def scaled(
    base: Trial, kind: str, channel: str, index: int, factor: Complex | complex, value: float
) -> Trial:
    """One channel times `factor`, a number or (lines,)."""
    turn = np.ones(base.y.shape, dtype=np.complex128)
    turn[:, index] = factor
    V = turn[:, :, None] * base.V * np.conj(turn)[:, None, :]
    return Trial(kind, (channel,), value, base.y * turn, V, base.kept)


def with_form(base: Trial, channel: str, index: int, form: Likeness, omega: Real) -> Trial:
    """One channel put right by its likeness to what it should show; omega (lines,), rad/s."""
    if form.conjugate:
        return conjugated(base, "conjugate", (channel,), np.arange(base.y.shape[1]) == index)
    return scaled(base, form.kind, channel, index, form.factor(omega), form.number)


def swapped(base: Trial, names: tuple[str, str], first: int, second: int) -> Trial:
    """Two channels exchanged."""
    order = np.arange(base.y.shape[1])
    order[[first, second]] = order[[second, first]]
    V = base.V[:, order][:, :, order]
    return Trial("swap", names, 1.0, base.y[:, order], V, base.kept[:, order])


def exchanged(base: Trial, channels: Sequence[str]) -> list[Trial]:
    """Any two of the channels, by their names, that are there in the same lines, exchanged."""
    return [
        swapped(base, (channels[i], channels[j]), i, j)
        for j in range(len(channels))
        for i in range(j)
        if np.array_equal(base.kept[:, i], base.kept[:, j])
    ]


def conjugated(base: Trial, kind: str, of: tuple[str, ...], chosen: Bools) -> Trial:
    """Phases of the chosen channels (channels,) counted the other way; correlations across are lost."""
    y = np.where(chosen, np.conj(base.y), base.y)
    both, neither = chosen[:, None] & chosen[None, :], ~chosen[:, None] & ~chosen[None, :]
    V = np.where(both, np.conj(base.V), np.where(neither, base.V, 0.0))
    return Trial(kind, of, 1.0, y, V, base.kept)


def with_phases_times(base: Trial, kind: str, factor: float) -> Trial:
    """All phases times a factor: those of another unit."""
    y = np.abs(base.y) * np.exp(1j * factor * np.angle(base.y))
    return Trial(kind, (), factor, y, base.V, base.kept)


def without(base: Trial, kind: str, of: tuple[str, ...], dropped: Bools) -> Trial:
    """Some amplitudes left out, (lines, channels)."""
    return Trial(kind, of, 1.0, base.y, base.V, base.kept & ~dropped)


def untested(view: ObservationModel, base: Trial, trial: Trial) -> float:
    """Share of the lines which tested the rig that only give their inputs in a trial that leaves amplitudes out."""
    before, after = (
        np.count_nonzero(each.kept, axis=1) > inputs_seen(view, each.kept) for each in (base, trial)
    )
    return float(np.mean(~after[before])) if np.any(before) else 0.0


def prepared(data: Prepared, trial: Trial) -> Prepared:
    """The data of one repeat as a trial supposes them."""
    spectrum = replace(
        data.spectrum,
        amplitudes=np.where(trial.kept, trial.y, np.nan)[None],
        covariance=np.nan_to_num(trial.V)[None],
        moments=None,
    )
    return replace(data, spectrum=spectrum, covariance=trial.V[None], states=None)


def cells(kept: Bools, *, column: int | None = None, line: int | None = None) -> Bools:
    """One column or one line of amplitudes (lines, channels)."""
    chosen = np.zeros(kept.shape, dtype=bool)
    if column is not None:
        chosen[:, column] = True
    if line is not None:
        chosen[line] = True
    return chosen


def exchanged_lines(base: Trial, kind: str, of: tuple[str, ...], first: int, second: int) -> Trial:
    """Two lines with the amplitudes of each other."""
    order = np.arange(len(base.y))
    order[[first, second]] = order[[second, first]]
    return Trial(kind, of, np.nan, base.y[order], base.V[order], base.kept[order])


def conjugated_line(base: Trial, kind: str, of: tuple[str, ...], line: int) -> Trial:
    """One line with all phases counted the other way."""
    y, V = base.y.copy(), base.V.copy()
    y[line], V[line] = np.conj(y[line]), np.conj(V[line])
    return Trial(kind, of, 1.0, y, V, base.kept)


def of_another_derivative(
    base: Trial, channels: Sequence[Channel], motions: Sequence[int], omega: Real
) -> list[Trial]:
    """All channels of the motion, which state one derivative, as another one: a table of accelerances as receptances.

    motions: their indices; omega (lines,), rad/s.  None where they are one, or state several.
    """
    stated = {channels[c].quantity for c in motions}
    if len(motions) < 2 or len(stated) > 1 or Quantity.FORCE in stated:
        return []
    (quantity,) = stated
    trials = []
    for power in (power for power in (-2, -1, 1, 2) if 0 <= quantity.derivative + power <= 2):
        trial = base
        for c in motions:
            factor = ((1j * omega) ** -power).astype(np.complex128)
            trial = scaled(trial, "quantity", channels[c].name, c, factor, power)
        trials.append(replace(trial, of=tuple(channels[c].name for c in motions)))
    return trials


def mistakes_of_a_channel(base: Trial, channel: Channel, index: int, omega: Real) -> list[Trial]:
    """A channel with its sign or its phases turned, in another unit, as another derivative; omega (lines,), rad/s."""
    name = channel.name
    trials = [
        scaled(base, "sign", name, index, -1.0, -1.0),
        conjugated(base, "conjugate", (name,), np.arange(base.y.shape[1]) == index),
    ]
    ratios = OF_FORCES if channel.quantity is Quantity.FORCE else RATIOS
    trials += [scaled(base, "unit", name, index, 1 / ratio, ratio) for ratio in ratios]
    trials += [
        scaled(base, "quantity", name, index, ((1j * omega) ** -power).astype(np.complex128), power)
        for power in (-2, -1, 1, 2)
        if channel.quantity is not Quantity.FORCE and 0 <= channel.quantity.derivative + power <= 2
    ]
    return trials
