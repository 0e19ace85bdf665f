"""What a channel shows against what the rest of the data say it should show: a factor, a delay, another derivative."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Bools, Complex, Real

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
        right: Complex = 1 / wrong
        return right


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
