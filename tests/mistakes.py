"""Twenty kinds of mistake that people make with records and rig files, as changes of a clean test.

Each mistake takes (model, spectrum, generator) and gives the model and spectrum that a user would hand in, with the
kinds of finding that name the true cause and the names they must point at.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arrays import Complex
from dashpot.data.spectrum import Spectrum
from dashpot.model.elements import Kind
from dashpot.model.network import Model


@dataclass(frozen=True)
class Case:
    """What is handed in, and what should be said: one of `kinds`, of these names ("" in it: whatever names)."""

    model: Model
    spectrum: Spectrum
    kinds: tuple[str, ...]
    of: frozenset[str]


Mistake = Callable[[Model, Spectrum, np.random.Generator], Case]


def times(spectrum: Spectrum, channel: int, factor: Complex | complex) -> Spectrum:
    """One channel's raw numbers times a factor, a number or one for each line; its noise grows with it."""
    turn = np.ones((spectrum.lines, len(spectrum.channels)), dtype=complex)
    turn[:, channel] = factor
    V = turn[:, :, None] * spectrum.covariance * np.conj(turn)[:, None, :]
    return replace(spectrum, amplitudes=spectrum.amplitudes * turn, covariance=V)


def _motions(model: Model, spectrum: Spectrum) -> list[int]:
    """Channels that show coordinates."""
    return [c for c, channel in enumerate(spectrum.channels) if set(channel.of) & set(model.coordinates)]


def _inputs(model: Model, spectrum: Spectrum) -> list[int]:
    names = {*model.displacement_inputs, *model.force_inputs}
    return [c for c, channel in enumerate(spectrum.channels) if set(channel.of) <= names]


def _scaled(kinds: tuple[str, ...], factor: complex, of_input: bool = False) -> Mistake:
    def mistake(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
        chosen = (_inputs if of_input else _motions)(model, spectrum)
        c = int(rng.choice(chosen))
        name = spectrum.channels[c].name
        return Case(model, times(spectrum, c, factor), kinds, frozenset({name}))

    return mistake


def _late(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
    c = int(rng.choice(_motions(model, spectrum)))
    tau = 0.08 / np.max(spectrum.frequency_hz)
    name = spectrum.channels[c].name
    return Case(model, times(spectrum, c, np.exp(-1j * spectrum.omega * tau)), ("delay",), frozenset({name}))


def _derivative(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
    c = int(rng.choice(_motions(model, spectrum)))
    power = 1 if spectrum.channels[c].quantity.derivative < 2 else -1
    name = spectrum.channels[c].name
    return Case(model, times(spectrum, c, (1j * spectrum.omega) ** power), ("quantity",), frozenset({name}))


def _exchanged(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
    a, b = (int(c) for c in rng.choice(_motions(model, spectrum), 2, replace=False))
    order = np.arange(len(spectrum.channels))
    order[[a, b]] = order[[b, a]]
    V = spectrum.covariance[:, order][:, :, order]
    changed = replace(spectrum, amplitudes=spectrum.amplitudes[:, order], covariance=V)
    return Case(model, changed, ("swap",), frozenset({spectrum.channels[a].name, spectrum.channels[b].name}))


def _conjugate(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
    changed = replace(
        spectrum, amplitudes=np.conj(spectrum.amplitudes), covariance=np.conj(spectrum.covariance)
    )
    return Case(model, changed, ("conjugate",), frozenset())


def _one_conjugate(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
    c = int(rng.choice(_motions(model, spectrum)))
    Y = spectrum.amplitudes.copy()
    Y[:, c] = np.conj(Y[:, c])
    return Case(
        model, replace(spectrum, amplitudes=Y), ("conjugate",), frozenset({spectrum.channels[c].name})
    )


def _noise_only(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
    c = int(rng.choice(_motions(model, spectrum)))
    Y = spectrum.amplitudes.copy()
    size = np.sqrt(np.mean(np.abs(Y[:, c]) ** 2))
    Y[:, c] = size * (rng.standard_normal(spectrum.lines) + 1j * rng.standard_normal(spectrum.lines))
    return Case(model, replace(spectrum, amplitudes=Y), ("channel",), frozenset({spectrum.channels[c].name}))


def _bad_dwell(change: Callable[[Complex, np.random.Generator], Complex]) -> Mistake:
    def mistake(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
        line = int(rng.integers(2, spectrum.lines - 2))
        Y = spectrum.amplitudes.copy()
        motions = _motions(model, spectrum)
        Y[line, motions] = change(Y[line, motions], rng)
        of = frozenset({f"{spectrum.frequency_hz[line]:g} Hz"})
        return Case(model, replace(spectrum, amplitudes=Y), ("dwell", "frequency"), of)

    return mistake


def _mislabelled(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
    line = int(rng.integers(2, spectrum.lines - 2))
    f = spectrum.frequency_hz.copy()
    f[line] *= 1.17
    changed = replace(spectrum, frequency_hz=f)
    return Case(model, changed, ("frequency", "dwell"), frozenset({f"{f[line]:g} Hz"}))


def _time_base(factor: float) -> Mistake:
    def mistake(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
        changed = replace(spectrum, frequency_hz=spectrum.frequency_hz * factor)
        return Case(model, changed, ("frequency",), frozenset())

    return mistake


def _missing(kind: Kind) -> Mistake:
    def mistake(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
        candidates = [e for e in model.elements if e.kind is kind and e.value is None and e.same_as is None]
        tied = {e.same_as for e in model.elements}
        candidates = [e for e in candidates if e.name not in tied]
        lost = candidates[int(rng.integers(len(candidates)))]
        changed = replace(model, elements=tuple(e for e in model.elements if e.name != lost.name))
        points = tuple(lost.along)
        return Case(
            changed, spectrum, ("element",), frozenset(points if len(points) > 1 else (*points, "ground"))
        )

    return mistake


def _wrong_value(model: Model, spectrum: Spectrum, rng: np.random.Generator) -> Case:
    known = [e for e in model.elements if e.value is not None and e.sd is None]
    wrong = known[int(rng.integers(len(known)))]
    elements = tuple(
        replace(e, value=1.3 * e.value) if e.name == wrong.name and e.value else e for e in model.elements
    )
    return Case(replace(model, elements=elements), spectrum, ("value",), frozenset({wrong.name}))


MISTAKES: dict[str, Mistake] = {
    "sign of a motion": _scaled(("sign",), -1.0),
    "sign of the input": _scaled(("sign",), -1.0, of_input=True),
    "mm for m": _scaled(("unit",), 1e3),
    "m for mm": _scaled(("unit",), 1e-3),
    "g for m/s²": _scaled(("unit",), 1 / 9.80665),
    "rms for peak": _scaled(("unit",), 0.5**0.5),
    "unit of the input": _scaled(("unit",), 1e3, of_input=True),
    "gain 20 % off": _scaled(("gain",), 1.2),
    "late channel": _late,
    "another derivative": _derivative,
    "two channels exchanged": _exchanged,
    "phases the other way": _conjugate,
    "one phase the other way": _one_conjugate,
    "nothing but noise": _noise_only,
    "dead dwell": _bad_dwell(lambda y, rng: 1e-3 * y),
    "flipped dwell": _bad_dwell(lambda y, rng: -y),
    "mislabelled dwell": _mislabelled,
    "time base twice too fast": _time_base(2.0),
    "missing damper": _missing(Kind.DAMPER),
    "wrong known value": _wrong_value,
}
