"""Whether the true fault is named, and sound tests left in peace: random rigs, data and faults made by other code.

`python3 dev.py bench blind_faults --faults 1000 --clean 1000 --seed 1`.  The generator that decides and on which
nothing is tuned: simulator, rigs and faults are its own, and of dashpot it calls `read_rig(…).identify(…)` and the
command, no more.  Look at its totals, not at its cases.

One test: a rig is drawn (`draw_rig`), what is sampled of it (`draw_test`), a fault (`FAULTS`), its data are computed
without noise (`measure`), and the fault is kept if these data show it in principle: the distance `d` of the data from
the rig of the file, in standard deviations of the noise and with all unknowns free, is at least SHOWN (`free_fit`).
Then noise is added and both files are written (`write`).  Causes that fit the same data exactly (the gain of a force
and the only known mass) are found by the same fit and all count as right.  `--self-check` takes the faults out again.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import multiprocessing
import runpy
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtr
from scipy.stats import kstest

sys.path.insert(0, str(Path(__file__).parent))
from _blind_rigs import (
    KINDS,
    Array,
    Case,
    Data,
    OverdampedError,
    Part,
    Rng,
    Truth,
    channel_rms,
    draw_test,
    free_fit,
    measure,
    modal_sd,
    natural_frequencies,
    pick,
    responses,
    spread,
)

NOISES = ("Gaussian", "Student t3", "with the motion", "narrow-band", "coloured", "correlated")
SHOWN = 7.0  # standard deviations: below this a fault shows too little to be asked for
EXACT = 0.03  # of d: a cause that leaves less is the same thing physically
LIMIT = 60  # seconds of processor time for an answer
COMMAND_EVERY = 15  # every so many cases go through the command instead of Python

# ---------------------------------------------------------------------------------------------- faults

LINEAR = ("table", "dwells", "record", "part")
Fault = Callable[[Rng, Case], "Case | None"]
FAULTS: dict[str, tuple[tuple[str, ...], Fault]] = {}


def fault(name: str, *kinds: str) -> Callable[[Fault], Fault]:
    def register(draw: Fault) -> Fault:
        FAULTS[name] = (kinds, draw)
        return draw

    return register


def off(rng: Rng, low: float = 0.01, high: float = 0.5) -> float:
    """A factor that is off by so much, up or down."""
    return float(1 + spread(rng, low, high)) ** int(rng.choice((-1, 1)))


def outputs_of_points(case: Case) -> list[int]:
    return [i for i, s in enumerate(case.stated.sensors[:-1]) if s.reads[0][0] in case.stated.coordinates]


def any_channel(rng: Rng, case: Case) -> int:
    """A channel that may be at fault: any, of nonlinear tests and modes an output."""
    count = case.inputs + (case.kind in LINEAR)
    return int(rng.integers(count))


def edited(case: Case, channel: int, edit: tuple[Any, ...] | None, *kinds: str, late: Any = None) -> Case:
    """With a channel's fault; of two channels only their ratio is measured, so that the other one counts, too."""
    names = [sensor.name for sensor in case.stated.sensors]
    if case.kind == "modes":
        names = [sensor.reads[0][0] for sensor in case.stated.sensors[:-1]]
    if len(names) > 2 or edit is None:
        names = [names[channel]]
    accepted = tuple((kind, frozenset({name})) for kind in kinds for name in names)
    edits = case.edits + ([edit] if edit else [])
    return replace(case, edits=edits, late=case.late + ([late] if late else []), truth=Truth(accepted))


@fault("wrong sign", *KINDS)
def _(rng: Rng, case: Case) -> Case | None:
    channel = any_channel(rng, case)
    return edited(case, channel, ("times", channel, -1.0), "sign", "gain")


@fault("wrong unit", *KINDS)
def _(rng: Rng, case: Case) -> Case | None:
    channel = any_channel(rng, case)
    ratio = float(pick(rng, (1000, 9.80665, 25.4, np.sqrt(2), 4.448222))) ** int(rng.choice((-1, 1)))
    return edited(case, channel, ("times", channel, ratio), "unit", "gain")


@fault("gain", *KINDS)
def _(rng: Rng, case: Case) -> Case | None:
    channel = any_channel(rng, case)
    return edited(case, channel, ("times", channel, off(rng, 0.002, 0.4)), "gain", "unit")


@fault("scale of the force", *LINEAR)
def _(rng: Rng, case: Case) -> Case | None:
    if case.stated.drive != "force":
        return None
    factor = pick(rng, (off(rng, 0.003, 0.5), 4.448222, 9.80665, 0.5, 2.0))
    return edited(case, case.inputs, ("times", case.inputs, factor), "gain", "unit")


@fault("gain step", "dwells", "record", "part", "nonlinear")
def _(rng: Rng, case: Case) -> Case | None:
    factor, channel = off(rng, 0.004, 0.5), int(rng.integers(case.inputs))
    kinds = ("time", "gain", "channel", "clock")
    if case.kind == "dwells":
        first = int(len(case.f) * rng.uniform(0.3, 0.7))
        return edited(case, channel, ("times", channel, factor, first), *kinds)
    if not case.start:
        return None
    return edited(
        case,
        channel,
        None,
        *kinds,
        late=("step", channel, int(case.samples * rng.uniform(0.25, 0.75)), factor),
    )


@fault("late or early channel", *LINEAR, "nonlinear")
def _(rng: Rng, case: Case) -> Case | None:
    channel = any_channel(rng, case)
    samples = int(rng.choice((-3, -2, -1, 1, 2, 3)))
    late = samples / case.rate if case.kind != "table" else samples * spread(rng, 0.003, 0.05) / case.f[-1]
    return edited(case, channel, ("late", channel, late), "delay", "clock")


@fault("exchanged channels", *KINDS)
def _(rng: Rng, case: Case) -> Case | None:
    if case.inputs < 2:
        return None
    a, b = (int(i) for i in rng.choice(case.inputs, 2, replace=False))
    points = case.stated.sensors[a], case.stated.sensors[b]
    if case.kind == "modes":
        names = frozenset(sensor.reads[0][0] for sensor in points)
    else:
        names = frozenset(sensor.name for sensor in points)
    return replace(case, edits=[("swap", a, b)], truth=Truth((("swap", names),)))


@fault("another derivative", *LINEAR, "nonlinear")
def _(rng: Rng, case: Case) -> Case | None:
    channel = pick(rng, outputs_of_points(case))
    old = case.stated.sensors[channel].order
    true = case.true.with_sensor(channel, order=int(rng.choice([p for p in (0, 1, 2) if p != old])))
    return edited(replace(case, true=true), channel, None, "quantity")


@fault("phases the other way", "table")
def _(rng: Rng, case: Case) -> Case | None:
    channel = any_channel(rng, case)
    if rng.random() < 0.5:
        edits = [("conjugate", i) for i in range(case.inputs + 1)]
        return replace(case, edits=edits, truth=Truth((("conjugate", frozenset()),)))
    return edited(case, channel, ("conjugate", channel), "conjugate")


@fault("cross-talk", *LINEAR, "nonlinear")
def _(rng: Rng, case: Case) -> Case | None:
    a = int(rng.integers(case.inputs))
    b = pick(rng, [i for i in range(case.inputs + 1) if i != a])
    rms = channel_rms(measure(case))
    sensors = case.stated.sensors
    accepted: list[Any] = [("crosstalk", frozenset({sensors[a].name, sensors[b].name}))]
    if sensors[a].order == sensors[b].order and sensors[b].reads[0][0] != "f":
        accepted.append(("place", frozenset({sensors[a].name})))
    share = spread(rng, 0.002, 0.3) * rms[a] / rms[b] * rng.choice((-1, 1))
    return replace(case, edits=[("mix", a, b, share)], truth=Truth(tuple(accepted)))


@fault("low-pass channel", *LINEAR)
def _(rng: Rng, case: Case) -> Case | None:
    channel = any_channel(rng, case)
    f = case.f[np.abs(case.drive) > 0]
    return edited(case, channel, ("low-pass", channel, spread(rng, 0.7, 15) * f[-1]), "filter", "channel")


@fault("AC-coupled channel", *LINEAR)
def _(rng: Rng, case: Case) -> Case | None:
    channel = any_channel(rng, case)
    f = case.f[np.abs(case.drive) > 0]
    return edited(case, channel, ("high-pass", channel, spread(rng, 0.03, 1) * f[0]), "filter", "channel")


@fault("clipped channel", "dwells", "record", "part", "nonlinear")
def _(rng: Rng, case: Case) -> Case | None:
    channel = int(rng.integers(case.inputs))
    top = max(np.abs(part[:, channel]).max() for part in measure(case).parts)
    late = ("clip", channel, top * rng.uniform(0.4, 0.9))
    return edited(case, channel, None, "saturation", "channel", late=late)


@fault("sensor at another point", *LINEAR)
def _(rng: Rng, case: Case) -> Case | None:
    names, channel = case.stated.coordinates, pick(rng, outputs_of_points(case))
    sensor = case.stated.sensors[channel]
    here = sensor.reads[0][0]
    other = pick(rng, [name for name in names if name != here])
    if other is None or len(sensor.reads) > 1:
        return None
    share = pick(rng, (1.0, spread(rng, 0.05, 0.7)))
    reads = ((here, 1 - share), (other, share)) if share < 1 else ((other, 1.0),)
    result = edited(
        replace(case, true=case.true.with_sensor(channel, reads=reads)), channel, None, "place", "channel"
    )
    there = [s.name for s in case.stated.sensors if s.reads[0][0] == other and s.order == sensor.order]
    crosstalk = tuple(("crosstalk", frozenset({sensor.name, name})) for name in there)
    return replace(result, truth=Truth(result.truth.accepted + crosstalk))


@fault("mains hum", "dwells", "record", "part")
def _(rng: Rng, case: Case) -> Case | None:
    return tone_in_channel(rng, case, rng.uniform(0.03, 0.45) * case.rate)


@fault("aliased tone", "record", "part")
def _(rng: Rng, case: Case) -> Case | None:
    return tone_in_channel(rng, case, rng.uniform(0.55, 3) * case.rate)


def tone_in_channel(rng: Rng, case: Case, f: float) -> Case:
    channel = int(rng.integers(case.inputs))
    size = spread(rng, 0.004, 0.5) * channel_rms(measure(case))[channel]
    kinds = ("channel", "input", "tone", "noise", "time")
    return edited(case, channel, None, *kinds, late=("tone", channel, f, size))


@fault("spikes", "record", "part", "nonlinear")
def _(rng: Rng, case: Case) -> Case | None:
    if not case.start:
        return None
    channel, count = int(rng.integers(case.inputs)), int(rng.integers(1, 6))
    where = np.sort(rng.choice(case.samples, count, replace=False))
    size = channel_rms(measure(case))[channel] * spread(rng, 0.1, 10) * rng.choice((-1, 1), count)
    return edited(case, channel, None, "time", "channel", "spike", late=("spikes", channel, where, size))


@fault("samples lost in one channel", "record", "part", "nonlinear")
def _(rng: Rng, case: Case) -> Case | None:
    if not case.start:
        return None
    channel = int(rng.integers(case.inputs))
    late = ("lost", channel, int(case.samples * rng.uniform(0.2, 0.8)), int(rng.integers(1, 8)))
    return edited(case, channel, None, "time", "clock", late=late)


@fault("samples lost in all channels", "record", "part")
def _(rng: Rng, case: Case) -> Case | None:
    late = ("lost", slice(None), int(case.samples * rng.uniform(0.2, 0.8)), int(rng.integers(2, 12)))
    return replace(case, late=[late], truth=Truth((("time", None), ("clock", None))))


@fault("input held between samples", "record", "part")
def _(rng: Rng, case: Case) -> Case | None:
    if case.stated.drive != "force" or any(len(s.reads) > 1 for s in case.stated.sensors):
        return None
    return replace(case, held=True, truth=Truth((("hold", None),)))


@fault("unmeasured force of one tone", "record", "part")
def _(rng: Rng, case: Case) -> Case | None:
    line = int(pick(rng, np.flatnonzero(case.drive)))
    point = pick(rng, case.stated.coordinates)
    unit = np.abs(responses(case.true, case.true.values, case.f[line : line + 1], point)[0, :-1])
    rms = channel_rms(measure(case))[:-1]
    size = spread(rng, 0.005, 1) * len(case.f) * float(np.median(rms / unit))
    return replace(case, tone=(point, line, size), truth=Truth((("input", None),), frozenset({point})))


@fault("wrong frequency label", "table")
def _(rng: Rng, case: Case) -> Case | None:
    line = int(rng.integers(len(case.f)))
    actual = case.f[line] * off(rng, 0.003, 0.5)
    return replace(case, labels={line: actual}, truth=Truth((("frequency", float(case.f[line])),)))


@fault("one bad dwell", "table", "dwells")
def _(rng: Rng, case: Case) -> Case | None:
    line, size = int(rng.integers(len(case.f))), spread(rng, 0.005, 1)
    wrong = 1 + size * (rng.normal(size=case.inputs + 1) + 1j * rng.normal(size=case.inputs + 1))
    return replace(case, edits=[("bad dwell", line, wrong)], truth=Truth((("dwell", float(case.f[line])),)))


@fault("time base", *LINEAR)
def _(rng: Rng, case: Case) -> Case | None:
    clock = off(rng, 0.005, 0.02)
    accepted = tuple((kind, what) for kind in ("frequency", "time", "clock") for what in (frozenset(), None))
    return replace(case, clock=clock, truth=Truth(accepted))


@fault("wrong known value", *KINDS)
def _(rng: Rng, case: Case) -> Case | None:
    part = pick(rng, [part for part in case.stated.parts if part.stated is not None])
    if part is None:
        return None
    factor = off(rng, 0.005, 0.6)
    if part.sd:
        factor = float(np.exp(rng.choice((-1, 1)) * part.sd * rng.uniform(5, 40)))
    return stated_wrongly(case, part, factor)


@fault("unit of a known value", *KINDS)
def _(rng: Rng, case: Case) -> Case | None:
    part = pick(rng, [part for part in case.stated.parts if part.stated is not None and not part.law])
    if part is None:
        return None
    return stated_wrongly(case, part, float(pick(rng, (1000, 9.80665, 2.204623))) ** int(rng.choice((-1, 1))))


def stated_wrongly(case: Case, part: Part, factor: float) -> Case:
    """Forces have the scale of what is stated and of what is measured of them: of two such things either may be off."""
    stated = case.stated.with_part(part.name, stated=(part.stated or 0) * factor)
    scales = {p.name: ("value", "unit") for p in stated.parts if p.stated is not None}
    scales |= {s.name: ("gain", "unit") for s in stated.sensors if s.reads[0][0] in ("f", "reaction")}
    names = list(scales) if len(scales) == 2 else [part.name]
    accepted = tuple((kind, frozenset({name})) for name in names for kind in scales[name])
    return replace(case, stated=stated, truth=Truth((*accepted, ("element", part.points)), part.points))


@fault("missing spring", *KINDS)
def _(rng: Rng, case: Case) -> Case | None:
    return missing(rng, case, "springs")


@fault("missing damper", *KINDS)
def _(rng: Rng, case: Case) -> Case | None:
    return missing(rng, case, "dampers")


def missing(rng: Rng, case: Case, section: str) -> Case | None:
    """A part that the true rig has and the file lacks; of one beside it whose value is stated, that value counts."""
    rig = case.stated
    ends = (
        pick(rng, rig.coordinates),
        pick(rng, (*rig.coordinates, "ground", "u" if rig.drive == "base" else "ground")),
    )
    there = [
        part for part in rig.parts if part.section == section and set(part.ends) == set(ends) and not part.law
    ]
    if ends[0] == ends[1] or any(part.free for part in there):
        return None
    usual = float(np.median([part.value for part in rig.parts if part.section == section and not part.law]))
    extra = Part("extra", section, ends, usual * spread(rng, 0.001, 1))
    accepted = (("element", extra.points), *(("value", frozenset({part.name})) for part in there))
    true = replace(case.true, parts=(*case.true.parts, extra))
    return replace(case, true=true, truth=Truth(accepted, extra.points))


@fault("hidden oscillator", *LINEAR)
def _(rng: Rng, case: Case) -> Case | None:
    rig = case.stated
    point = pick(rng, rig.coordinates)
    mass = spread(rng, 0.002, 0.2) * next(
        p.value for p in rig.parts if p.section == "masses" and p.ends[0] == point
    )
    own = natural_frequencies(rig)
    w = 2 * np.pi * spread(rng, 0.7 * own[0], 1.2 * own[-1])
    hidden = (
        Part("hm", "masses", ("hidden", "ground"), mass),
        Part("hk", "springs", ("hidden", point), mass * w**2),
        Part("hc", "dampers", ("hidden", point), 2 * spread(rng, 0.01, 0.2) * mass * w),
    )
    true = replace(case.true, coordinates=(*rig.coordinates, "hidden"), parts=(*rig.parts, *hidden))
    truth = Truth((("oscillator", frozenset({point})),), frozenset({point}))
    return replace(case, true=true, truth=truth)


@fault("hysteretic for viscous damping", *LINEAR)
def _(rng: Rng, case: Case) -> Case | None:
    part = pick(rng, [part for part in case.stated.parts if part.section == "dampers"])
    own = natural_frequencies(case.stated)
    h = part.value * 2 * np.pi * float(np.sqrt(own[0] * own[-1]))
    true = case.true.with_part(part.name, section="hysteretic", value=h)
    return replace(
        case, true=true, truth=Truth((("hysteretic", part.points), ("element", part.points)), part.points)
    )


@fault("mass of a sensor", *LINEAR, "modes")
def _(rng: Rng, case: Case) -> Case | None:
    part = pick(
        rng, [p for p in case.stated.parts if p.section == "masses" and p.stated is not None and not p.sd]
    )
    if part is None:
        return None
    true = case.true.with_part(part.name, value=part.value * (1 + spread(rng, 0.003, 0.2)))
    return replace(
        case,
        true=true,
        truth=Truth((("value", frozenset({part.name})), ("element", part.points)), part.points),
    )


@fault("rig changed between dwells", "table", "dwells")
def _(rng: Rng, case: Case) -> Case | None:
    part = pick(rng, case.stated.parts)
    other = case.true.with_part(part.name, value=part.value * off(rng, 0.004, 0.5))
    first = int(len(case.f) * rng.uniform(0.35, 0.65))
    experiment = np.where(np.arange(len(case.f)) < first, 1, 2)
    truth = Truth((("changed", frozenset({part.name})), ("changed", part.points)), part.points)
    return replace(case, changed=(other, first), experiment=experiment, truth=truth)


@fault("modes outside the band", *LINEAR)
def _(rng: Rng, case: Case) -> Case | None:
    rig = case.stated
    if rig.drive != "force" or rig.at not in {sensor.reads[0][0] for sensor in rig.sensors}:
        return None
    top = 2 * np.pi * case.f[np.abs(case.drive) > 0][-1] * spread(rng, 2, 6)
    mass = 0.05 * next(p.value for p in rig.parts if p.section == "masses" and p.ends[0] == rig.at)
    foot = (
        Part("fm", "masses", ("foot", "ground"), mass),
        Part("fk", "springs", ("foot", rig.at), mass * top**2),
        Part("fc", "dampers", ("foot", rig.at), 0.04 * mass * top),
    )
    sensors = tuple(replace(s, reads=(("foot", 1.0),)) if s.reads[0][0] == rig.at else s for s in rig.sensors)
    true = replace(
        rig, coordinates=(*rig.coordinates, "foot"), parts=(*rig.parts, *foot), at="foot", sensors=sensors
    )
    return replace(case, true=true, truth=Truth((("residual", None),), frozenset({rig.at})))


def law_missing(law: str) -> Fault:
    def draw(rng: Rng, case: Case) -> Case | None:
        part = case.stated.part("kn")
        if part.law != law:
            return None
        stated = replace(case.stated, parts=tuple(p for p in case.stated.parts if p.name != "kn"))
        if not any(p.free for p in stated.parts):
            return None
        return replace(case, stated=stated, truth=Truth((("nonlinear", part.points),), part.points))

    return draw


LAW_OF = {f"{law} law not in the rig": law for law in ("coulomb", "gap", "cubic", "quadratic")}
for _name, _law in LAW_OF.items():
    fault(_name, "nonlinear")(law_missing(_law))


@fault("frequency of one mode", "modes")
def _(rng: Rng, case: Case) -> Case | None:
    mode = int(rng.integers(case.modes))
    late = [("frequency", mode, off(rng, 0.003, 0.2))]
    return replace(case, late=late, truth=Truth((("mode", None), ("frequency", None), ("dwell", None))))


@fault("rad/s for Hz", "modes")
def _(rng: Rng, case: Case) -> Case | None:
    late = [("frequency", mode, 2 * np.pi) for mode in range(case.modes)]
    return replace(case, late=late, truth=Truth((("frequency", None), ("unit", None))))


@fault("loss factors for damping ratios", "modes")
def _(rng: Rng, case: Case) -> Case | None:
    late = [("damping", mode, 2.0) for mode in range(case.modes)]
    return replace(case, late=late, truth=Truth((("damping", None),)))


def equivalents(case: Case, data: Data, d: float) -> list[tuple[str, frozenset[str]]]:
    """Gains, delays and stated values that fit these data exactly: the same thing physically."""
    if case.kind == "nonlinear":
        return []
    found: list[tuple[str, frozenset[str]]] = []
    causes: list[tuple[str, Any]] = [("value", p.name) for p in case.stated.parts if p.stated is not None]
    if case.kind in LINEAR:
        causes += [(kind, i) for kind in ("gain", "delay") for i in range(case.inputs + 1)]
    for kind, what in causes:
        left = free_fit(case, data, ((kind, what),)).d
        if left < min(1.0, EXACT * d):
            name = frozenset({what if kind == "value" else case.stated.sensors[what].name})
            found += [(k, name) for k in ((kind, "unit") if kind == "gain" else (kind,))]
    return found


def draw_fault(rng: Rng, kind: str, name: str) -> tuple[Case, Data, float]:
    """A test with this fault, shown by its data; how far it moves an unknown, in standard deviations."""
    draw = FAULTS[name][1]
    for _ in range(300):
        sound = draw_test(rng, kind, LAW_OF.get(name, ""))
        for _ in range(3):
            case = draw(rng, replace(sound, edits=[], late=[]))
            if case is None:
                break
            data = measure(case)
            if name == "samples lost in all channels":
                return case, data, np.nan
            try:
                fit = free_fit(case, data)
                same = equivalents(case, data, fit.d) if fit.d > SHOWN else []
            except OverdampedError:
                continue
            if fit.d > SHOWN:
                accepted = case.truth.accepted + tuple(same)
                return replace(case, truth=replace(case.truth, accepted=accepted)), data, fit.moved
    raise RuntimeError(f"no test of kind {kind} shows: {name}")


# ---------------------------------------------------------------------------------------------- files


def noise_of_samples(rng: Rng, kind: str, clean: Array, sd: Array) -> Array:
    """Of one stretch (samples, channels), with the variance sd² on average."""
    shape = clean.shape
    white = rng.normal(size=shape)
    if kind == "Student t3":
        white = rng.standard_t(3, size=shape) / np.sqrt(3)
    elif kind == "with the motion":
        window = np.ones(max(3, shape[0] // 25))
        size = np.array([np.convolve(np.abs(column), window, "same") for column in clean.T]).T
        white *= size / np.sqrt(np.mean(size**2, axis=0))
    elif kind in ("narrow-band", "coloured"):
        turn = 0.9 if kind == "coloured" else 0.98 * np.exp(1j * rng.uniform(0.2, 1.5))
        long = rng.normal(size=(shape[0] + 400, shape[1]))
        poles = np.real(np.poly([turn, np.conj(turn)])) if kind == "narrow-band" else [1, -turn]
        impulse = lfilter([1], poles, np.eye(1, 2000)[0])
        white = lfilter([1], poles, long, axis=0)[400:] / np.linalg.norm(impulse)
    elif kind == "correlated":
        white = np.sqrt(0.95) * rng.normal(size=(shape[0], 1)) + np.sqrt(0.05) * white
    return white * sd


def noise_of_amplitudes(rng: Rng, kind: str, clean: Array, sd: Array, f: Array) -> tuple[Array, Array]:
    """Of a table, complex, and the standard deviations that it states: true ones."""
    size = sd * np.ones(clean.shape)
    if kind == "with the motion":
        size = np.abs(clean) * sd / np.sqrt(np.mean(np.abs(clean) ** 2, axis=0))
    elif kind == "narrow-band":
        size *= 1 + 4 * np.exp(-((np.log(f / pick(rng, f)) / 0.1) ** 2))[:, None]
    elif kind == "coloured":
        size *= (np.sqrt(f[0] * f[-1]) / f)[:, None]
    parts = [noise_of_samples(rng, kind, clean, size * 0 + 1) for _ in range(2)]
    if kind not in ("Student t3", "correlated"):
        parts = [rng.normal(size=clean.shape) for _ in range(2)]
    return (parts[0] + 1j * parts[1]) * size, size


def write(rng: Rng, case: Case, data: Data, folder: Path, noise: str = NOISES[0]) -> tuple[Path, Path]:
    """The rig file and the data with noise."""
    rig, file = folder / "rig.toml", folder / ("modes.csv" if case.kind == "modes" else "data.csv")
    rig.write_text(case.stated.text(rng), encoding="utf-8")
    sensors = case.stated.sensors
    scale = np.array([sensor.scale for sensor in sensors])
    columns: dict[str, Array] = {}
    if case.kind == "modes":
        sd = modal_sd(case, data.parts[0])
        shape_of_noise = noise if noise in ("Student t3", "correlated") else NOISES[0]  # modes have no time
        draws = noise_of_samples(rng, shape_of_noise, sd, np.ones(sd.shape[1]))
        count = case.inputs
        sd[np.arange(len(sd)), 2 + case.references] = sd[np.arange(len(sd)), 2 + count + case.references] = 0
        rows = data.parts[0] + draws * sd
        columns = {"frequency_hz": rows[:, 0], "frequency_sd": sd[:, 0]}
        columns |= {"damping_ratio": rows[:, 1], "damping_sd": sd[:, 1]}
        for i, sensor in enumerate(sensors[:-1]):
            name = sensor.reads[0][0]
            columns |= {
                f"{name}_re": rows[:, 2 + i],
                f"{name}_im": rows[:, 2 + count + i],
                f"{name}_sd": sd[:, 2 + i],
            }
    elif case.kind == "table":
        draws, sd = noise_of_amplitudes(rng, noise, data.parts[0], case.sd, case.f)
        rows = (data.parts[0] + draws) / scale
        columns["frequency_hz"] = case.f
        if case.experiment is not None:
            columns["experiment"] = case.experiment
        for i, sensor in enumerate(sensors):
            columns[f"{sensor.name}_re"], columns[f"{sensor.name}_im"] = rows[:, i].real, rows[:, i].imag
            columns[f"{sensor.name}_sd"] = sd[:, i] / scale[i]
    else:
        rms = channel_rms(data)
        noisy = []
        for part in data.parts:
            share = np.sqrt(np.mean(part**2, axis=0)) / rms if noise == "with the motion" else 1.0
            noisy.append((part + noise_of_samples(rng, noise, part, case.sd * share)) / scale)
        if not case.start:
            columns["frequency_hz"] = np.repeat(case.f, [len(part) for part in noisy])
        columns["time_s"] = np.concatenate([np.arange(len(part)) / case.rate for part in noisy])
        columns |= {sensor.name: np.concatenate([p[:, i] for p in noisy]) for i, sensor in enumerate(sensors)}
    np.savetxt(
        file, np.column_stack(list(columns.values())), "%.10g", ",", header=",".join(columns), comments=""
    )
    return rig, file


# ------------------------------------------------------------------------------------ asking and judging


def ask(rig: Path, data: Path, by_command: bool) -> tuple[str, dict[str, Any]]:
    """What dashpot answers: "answered", "refused", "late" or "failure" (a traceback), and its JSON."""
    import dashpot

    out = rig.with_name("out.json")
    quiet = io.StringIO()
    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet):
            warnings.simplefilter("ignore")
            if by_command:
                sys.argv = ["dashpot", "identify", str(rig), str(data), "--json", str(out)]
                runpy.run_module("dashpot", run_name="__main__")
            return "answered", json.loads(dashpot.read_rig(str(rig)).identify(str(data)).to_json())
    except SystemExit as end:
        if not end.code:
            return "answered", json.loads(out.read_text(encoding="utf-8"))
        return ("refused" if end.code in (2, 3) else "failure"), {}
    except dashpot.DashpotError as error:  # what it names as a likely cause is an answer, too
        return "refused", {"diagnosis": [each.content() for each in error.causes]}
    except TimeoutError:
        return "late", {}
    except Exception:
        traceback.print_exc()
        return "failure", {}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def stop(*_: Any) -> None:
    raise TimeoutError


def is_right(finding: dict[str, Any], truth: Truth) -> bool:
    names = [str(name) for name in finding.get("of") or [] if str(name) not in ("ground", "")]
    for kind, what in truth.accepted:
        if finding.get("kind") != kind:
            continue
        if what is None or (isinstance(what, frozenset) and frozenset(names) == what):
            return True
        if isinstance(what, float) and len(names) == 1 and names[0].endswith("Hz"):
            with contextlib.suppress(ValueError):
                if abs(float(names[0].removesuffix("Hz").replace(",", "")) - what) < 0.005 * what:
                    return True
    return False


@dataclass(frozen=True)
class Outcome:
    kind: str
    name: str  # of the fault or the noise
    status: str
    verdict: str = ""
    right: tuple[bool, ...] = ()  # of each finding
    grouped: bool = False  # one in the first finding's group of at most three is right
    unexplained: bool = False  # "no listed cause" stands first
    odds: tuple[tuple[float, bool], ...] = ()
    z: tuple[float, ...] = ()  # of unknowns away from the fault, all of a sound test
    held: tuple[bool, ...] = ()  # whether their 95 % intervals hold the truth
    moved: float = 0.0
    seconds: float = 0.0


def judge(case: Case, name: str, status: str, answer: dict[str, Any]) -> Outcome:
    findings = answer.get("diagnosis") or []
    right = tuple(is_right(finding, case.truth) for finding in findings)
    groups = [finding.get("group") for finding in findings]
    first = [i for i, group in enumerate(groups) if i == 0 or (group is not None and group == groups[0])]
    causes = zip(findings, right, strict=True)
    odds = tuple(
        (float(each["odds"]), r)
        for each, r in causes
        if each.get("odds") is not None and each.get("kind") != "unexplained"
    )
    z, held = [], []
    points = case.truth.points
    for part in case.stated.parts:
        entry = (answer.get("parameters") or {}).get(part.name)
        away = not name or name in NOISES or (points is not None and not part.points & points)
        told = part.sd is not None and name in NOISES  # stated with a tolerance, as the truth was drawn
        if entry and (part.stated is None or told) and away and entry.get("sd"):
            z.append((entry["value"] - part.value) / entry["sd"])
            low, high = (np.nan if end is None else end for end in entry["interval95"])
            held.append(not low > part.value and not high < part.value)
    verdict = (answer.get("fit") or {}).get("verdict", "")
    unexplained = bool(findings) and findings[0].get("kind") == "unexplained"
    grouped = len(first) <= 3 and any(right[i] for i in first)
    listed = (verdict, right, grouped, unexplained, odds)
    return Outcome(case.kind, name, status, *listed, tuple(z), tuple(held))


def run(job: tuple[str, int, int, str, str]) -> Outcome | None:
    """One job: faults or clean, seed, number, kind of data, name of the fault or the noise."""
    what, seed, number, kind, name = job
    rng = np.random.default_rng([seed, ("faults", "clean", "without").index(what), number])
    moved = 0.0
    if what == "clean":
        case = draw_test(rng, kind)
        data = measure(case)
    else:
        try:
            case, data, moved = draw_fault(rng, kind, name)
        except RuntimeError as error:
            print(error, file=sys.stderr)
            return None
    if what == "without":  # the same test with the fault taken out
        honest = {part.name: part for part in case.stated.parts}
        parts = tuple(replace(p, stated=p.value) if p.stated is not None else p for p in honest.values())
        parts += tuple(part for part in case.true.parts if part.law and part.name not in honest)
        rig = replace(case.stated, parts=parts)
        lines, part = (case.kind, rig, rig, case.f, case.drive), (case.rate, case.samples, case.start)
        case = Case(*lines, *part, sd=case.sd, modes=case.modes)
        data, name = measure(case), ""
    noise = name if what == "clean" else NOISES[0]
    with tempfile.TemporaryDirectory() as folder:
        rig_file, data_file = write(rng, case, data, Path(folder), noise)
        began = time.process_time()
        by_command = kind == "modes" or number % COMMAND_EVERY == COMMAND_EVERY - 1
        status, answer = ask(rig_file, data_file, by_command)
        seconds = time.process_time() - began
    return replace(judge(case, name, status, answer), moved=moved, seconds=seconds)


# ---------------------------------------------------------------------------------------------- totals


def percent(part: int, whole: int) -> str:
    return f"{part:4d} ({100 * part / whole:3.0f} %)" if whole else "   -      "


FAULT_COLUMNS: dict[str, Callable[[Outcome], bool]] = {
    "does not fit": lambda o: o.verdict == "does not fit",
    "first": lambda o: o.right[:1] == (True,),
    "first group": lambda o: o.grouped,
    "in list": lambda o: any(o.right),
    "wrong first": lambda o: bool(o.right) and not (o.right[0] or o.grouped or o.unexplained),
    "refused": lambda o: o.status == "refused",
    "late": lambda o: o.status == "late",
    "traceback": lambda o: o.status == "failure",
}
CLEAN_COLUMNS: dict[str, Callable[[Outcome], bool]] = {
    "alarms": lambda o: o.verdict == "does not fit",
    "fits": lambda o: o.verdict == "fits",
    "|z| > 4": lambda o: bool(o.z) and float(np.abs(o.z).max()) > 4,
    **{name: FAULT_COLUMNS[name] for name in ("refused", "late", "traceback")},
}


def print_table(outcomes: list[Outcome], columns: dict[str, Callable[[Outcome], bool]]) -> None:
    """A row for each kind of data, for each fault or noise, and for all."""
    print(f"\n{'':34s} {'cases':>5s}  " + "  ".join(f"{title:12s}" for title in columns) + "  in 95 %")
    rows = [(kind, [o for o in outcomes if o.kind == kind]) for kind in KINDS]
    rows += [
        (name, [o for o in outcomes if o.name == name]) for name in sorted({o.name for o in outcomes} - {""})
    ]
    for title, chosen in (*rows, ("all", outcomes)):
        counts = "  ".join(percent(sum(map(column, chosen)), len(chosen)) for column in columns.values())
        held = [h for o in chosen for h in o.held]
        share = f"{100 * np.mean(held):5.1f} %" if held else "   -"
        if chosen:
            print(f"{title:34s} {len(chosen):5d}  {counts}  {share}")


def print_ranks(outcomes: list[Outcome]) -> None:
    """Whether truths are spread over their estimates' distributions as over draws of them (Talts et al. 2018).

    One unknown of each test, as those of one test depend on each other; p by Kolmogorov and Smirnov.
    """
    print("\nranks of truths, in fifths of the estimates' distributions")
    for kind in (*KINDS, *NOISES, "all"):
        chosen = [o for o in outcomes if o.z and kind in (o.kind, o.name, "all")]
        ranks = ndtr(-np.array([o.z[i % len(o.z)] for i, o in enumerate(chosen)]))
        if len(ranks):
            fifths = np.histogram(ranks, 5, (0, 1))[0]
            print(f"{kind:34s} {len(ranks):5d}  {fifths}  p {kstest(ranks, 'uniform').pvalue:.3f}")


def print_faults(outcomes: list[Outcome]) -> None:
    print_table(outcomes, FAULT_COLUMNS)
    moving = [o for o in outcomes if o.moved > 2]
    found = sum(o.verdict == "does not fit" for o in moving)
    print(f"of {len(moving)} that move a value by more than 2 sd do not fit: {percent(found, len(moving))}")
    for kind in KINDS:
        chosen = [o for o in outcomes if o.kind == kind and o.z]
        if chosen:
            largest = np.median([np.abs(o.z).max() for o in chosen])
            print(f"median largest |z| away from the fault, {kind}: {largest:.1f} in {len(chosen)} tests")
    odds = [pair for o in outcomes for pair in o.odds]
    if odds:
        said, right = np.array([p for p, _ in odds]), np.array([r for _, r in odds])
        bins = np.minimum((said * 10).astype(int), 9)
        error = 0.0
        for b in np.unique(bins):
            inside = bins == b
            error += abs(said[inside].mean() - right[inside].mean()) * inside.mean()
            means = f"{said[inside].mean():.2f} of which {right[inside].mean():.2f} are right"
            print(f"{inside.sum()} causes with odds of about {means}")
        print(f"expected calibration error {100 * error:.1f} %")
    else:
        print("no odds are given")


def jobs_of(settings: argparse.Namespace) -> list[tuple[str, int, int, str, str]]:
    kinds = [settings.data] if settings.data else list(KINDS)
    order = {}
    for kind in kinds:
        names = [name for name, (possible, _) in FAULTS.items() if kind in possible]
        names += [name for name in names if name in LAW_OF] * 2  # two fifths of the nonlinear faults
        rng = np.random.default_rng([settings.seed, KINDS.index(kind)])
        order[kind] = [str(name) for name in rng.permutation(names)]
    jobs = []
    for what, count in (("faults", settings.faults), ("without", settings.self_check)):
        for i in range(count):
            kind = kinds[i % len(kinds)]
            jobs.append((what, settings.seed, i, kind, order[kind][i // len(kinds) % len(order[kind])]))
    for i in range(settings.clean * len(NOISES)):
        j = i // len(NOISES)
        jobs.append(("clean", settings.seed, i, kinds[(i + j) % len(kinds)], NOISES[i % len(NOISES)]))
    return jobs


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--faults", type=int, default=24, help="tests with a fault, kinds of data in turn")
    options.add_argument("--clean", type=int, default=2, help="sound tests with each kind of noise")
    options.add_argument("--self-check", type=int, default=0, help="faults taken out again: must fit")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--data", choices=KINDS, help="one kind of data only")
    options.add_argument("--minutes", type=float, default=60.0, help="after which no other test is begun")
    options.add_argument("--processes", type=int, default=1)
    settings = options.parse_args()
    outcomes: dict[str, list[Outcome]] = defaultdict(list)
    began = time.monotonic()
    jobs = jobs_of(settings)
    pool = multiprocessing.Pool(settings.processes) if settings.processes > 1 else None
    answers = pool.imap(run, jobs) if pool else map(run, jobs)
    for (what, *_), outcome in zip(jobs, answers, strict=True):
        if outcome is not None:
            outcomes[what].append(outcome)
        if time.monotonic() - began > 60 * settings.minutes:
            print(f"stopped after {sum(map(len, outcomes.values()))} of {len(jobs)} tests")
            break
    if pool:
        pool.terminate()
    if outcomes["faults"]:
        print_faults(outcomes["faults"])
    for what in ("clean", "without"):
        if outcomes[what]:
            print("\nSound tests" if what == "clean" else "\nFaults taken out again")
            print_table(outcomes[what], CLEAN_COLUMNS)
            print_ranks(outcomes[what])
    every = [o for group in outcomes.values() for o in group]
    print(
        f"\nprocessor time of an answer, s: median {np.median([o.seconds for o in every]):.1f}, "
        f"largest {max(o.seconds for o in every):.1f}; {dict(Counter(o.status for o in every))}"
    )


if __name__ == "__main__":
    main()
