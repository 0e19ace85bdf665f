"""Rigs, tests and their data for blind_faults.py: drawn, simulated and judged by code of its own.

NumPy and SciPy only, nothing of dashpot.  Linear rigs are solved at lines; a record is a stretch of a motion that
repeats after a longer period, exact at every sample; nonlinear rigs are integrated (DOP853, relative 1e-9).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eig, eigh
from scipy.signal import cont2discrete

Rng = np.random.Generator
Array = np.ndarray

KINDS = ("table", "dwells", "record", "part", "nonlinear", "modes")
KNOWN_TO = 0.10  # relative standard deviation that every unknown must reach in a sound test
MARGIN = 4  # samples simulated before and after each stretch, for channels that are early or late

# Units of each kind of channel, and what one of them is in SI.
UNITS = {0: {"m": 1.0, "mm": 1e-3}, 1: {"m/s": 1.0, "mm/s": 1e-3}, 2: {"m/s^2": 1.0, "g": 9.80665}}
FORCES = {"N": 1.0, "kN": 1e3}


# ---------------------------------------------------------------------------------------------- rigs


@dataclass(frozen=True)
class Part:
    name: str
    section: str  # masses, springs, dampers, hysteretic
    ends: tuple[str, str]
    value: float  # the truth
    stated: float | None = None  # what the rig file says
    sd: float | None = None  # of what it says, relative
    law: str = ""
    constants: tuple[tuple[str, float], ...] = ()

    @property
    def free(self) -> bool:
        return self.stated is None or self.sd is not None

    @property
    def points(self) -> frozenset[str]:
        return frozenset(self.ends) - {"ground"}


@dataclass(frozen=True)
class Sensor:
    name: str
    reads: tuple[tuple[str, float], ...]  # points (or "f", "reaction") and factors
    order: int  # derivative of the displacement; 0 for forces
    unit: str
    scale: float  # SI value of one unit


@dataclass(frozen=True)
class Rig:
    coordinates: tuple[str, ...]
    drive: str  # "base" or "force"
    at: str  # where a force acts
    parts: tuple[Part, ...]
    sensors: tuple[Sensor, ...]  # the input's is the last
    guesses: bool = False

    @property
    def values(self) -> dict[str, float]:
        return {part.name: part.value for part in self.parts}

    @property
    def input(self) -> str:
        return "u" if self.drive == "base" else "f"

    def part(self, name: str) -> Part:
        return next(part for part in self.parts if part.name == name)

    def with_part(self, name: str, **changes: Any) -> Rig:
        return replace(self, parts=tuple(replace(p, **changes) if p.name == name else p for p in self.parts))

    def with_sensor(self, index: int, **changes: Any) -> Rig:
        sensors = list(self.sensors)
        sensors[index] = replace(sensors[index], **changes)
        return replace(self, sensors=tuple(sensors))

    def text(self, rng: Rng) -> str:
        """The rig file."""
        where = "" if self.drive == "base" else f', at = "{self.at}"'
        kind = "displacement" if self.drive == "base" else "force"
        coordinates = ", ".join(f'"{name}"' for name in self.coordinates)
        lines = ['name = "a drawn rig"', f"coordinates = [{coordinates}]", "[inputs]"]
        lines.append(f'{self.input} = {{ kind = "{kind}"{where} }}')
        for section in ("masses", "springs", "dampers", "hysteretic"):
            parts = [part for part in self.parts if part.section == section]
            lines += [f"[{section}]"] if parts else []
            for part in parts:
                ends = f'at = "{part.ends[0]}"'
                if section != "masses":
                    ends = f'between = ["{part.ends[0]}", "{part.ends[1]}"]'
                law = f', law = "{part.law}"' if part.law else ""
                law += "".join(f", {name} = {number:.8g}" for name, number in part.constants)
                said = "" if part.stated is None else f", value = {part.stated:.9g}"
                said += "" if part.sd is None else f", sd = {part.sd * (part.stated or 0):.6g}"
                if not said and self.guesses:
                    said = f", guess = {part.value * np.exp(rng.normal(0, 0.15)):.3g}"
                lines.append(f"{part.name} = {{ {ends}{law}{said} }}")
        lines.append("[channels]")
        for sensor in self.sensors:
            points = ", ".join(f"{point} = {factor:g}" for point, factor in sensor.reads)
            of = f'"{sensor.reads[0][0]}"' if len(sensor.reads) == 1 else f"{{ {points} }}"
            quantity = ("displacement", "velocity", "acceleration")[sensor.order]
            if sensor.reads[0][0] == "reaction":
                of, quantity = '"u"', "force"
            elif sensor.reads[0][0] == "f":
                quantity = "force"
            lines.append(f'{sensor.name} = {{ of = {of}, quantity = "{quantity}", unit = "{sensor.unit}" }}')
        return "\n".join(lines) + "\n"


def matrices(rig: Rig, values: dict[str, float]) -> dict[str, Array]:
    """M, C, K and hysteretic H over all coordinates and the base (last); nonlinear parts are left out."""
    points = (*rig.coordinates, "u")
    result = {
        section: np.zeros((len(points),) * 2) for section in ("masses", "dampers", "springs", "hysteretic")
    }
    for part in rig.parts:
        if not part.law:
            e = direction(points, part)
            result[part.section] += values[part.name] * np.outer(e, e)
    return result


def direction(points: tuple[str, ...], part: Part) -> Array:
    e = np.array([float(point == part.ends[0]) for point in points])
    return e - np.array([float(point == part.ends[1]) for point in points])


def responses(rig: Rig, values: dict[str, float], f: Array, force_at: str = "") -> Array:
    """Every channel (lines, channels) for a unit amplitude of the input, or of a force at a point."""
    m = matrices(rig, values)
    w = 2 * np.pi * f[:, None, None]
    dynamic = (
        m["springs"]
        + 1j * w * m["dampers"]
        + 1j * np.sign(w) * m["hysteretic"]
        - w**2 * m["masses"].astype(complex)
    )
    n = len(rig.coordinates)
    base = rig.drive == "base" and not force_at
    at = force_at or rig.at
    load = np.array([float(name == at) for name in rig.coordinates], complex)[None, :, None]
    x = np.linalg.solve(dynamic[:, :n, :n], -dynamic[:, :n, n:] if base else load + 0 * w)[:, :, 0]
    u = np.full(len(f), float(base))
    moves = {name: x[:, i] for i, name in enumerate(rig.coordinates)} | {"u": u, "f": u * 0 + (not force_at)}
    moves["reaction"] = np.einsum("li,li->l", dynamic[:, n, :n], x) + dynamic[:, n, n] * u
    jw = 2j * np.pi * f
    return np.array([sum(factor * moves[p] for p, factor in s.reads) * jw**s.order for s in rig.sensors]).T


def state_matrix(rig: Rig, values: dict[str, float]) -> Array:
    """Of displacements and velocities, the base at rest."""
    n = len(rig.coordinates)
    m = matrices(rig, values)
    M, C, K = (m[name][:n, :n] for name in ("masses", "dampers", "springs"))
    return np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])


def natural_frequencies(rig: Rig) -> Array:
    m = matrices(rig, rig.values)
    n = len(rig.coordinates)
    return np.sqrt(np.abs(eigh(m["springs"][:n, :n], m["masses"][:n, :n], eigvals_only=True))) / (2 * np.pi)


def spread(rng: Rng, low: float, high: float) -> float:
    """A number drawn evenly in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def pick(rng: Rng, items: Iterable[Any]) -> Any:
    """One of them, or None of nothing."""
    items = list(items)
    return items[int(rng.integers(len(items)))] if items else None


def draw_rig(rng: Rng, kind: str) -> Rig:
    """Structure, values, what is stated and what is seen."""
    n = int(rng.integers(1, 3 if kind == "nonlinear" else 6))
    n = max(n, 2) if kind in ("part", "modes") else n
    n = min(n, 4) if kind in ("part", "record") else n
    stem = pick(rng, [("x1", "x2", "x3", "x4", "x5"), ("bed", "table", "head", "arm", "tip"), tuple("abcde")])
    names = tuple(str(name) for name in rng.permutation(stem[:n]))
    drive = pick(rng, ("base", "force"))
    anchor = "u" if drive == "base" else "ground"
    mass, omega = spread(rng, 0.03, 2000), 2 * np.pi * spread(rng, 1, 60)
    stiffness, branched = mass * omega**2, rng.random() < 0.4
    zeta = spread(rng, 0.04, 0.12) if kind == "nonlinear" else spread(rng, 0.01, 0.1)
    damping = 2 * zeta * mass * omega
    parts = [
        Part(f"m{i + 1}", "masses", (name, "ground"), mass * spread(rng, 0.4, 2.5))
        for i, name in enumerate(names)
    ]
    links = []
    for i, name in enumerate(names):
        links.append((name, anchor if i == 0 else names[int(rng.integers(i))] if branched else names[i - 1]))
    for i, name in enumerate(names[1:], 1):
        if rng.random() < 0.25:
            links.append((name, pick(rng, ["ground", anchor, *names[: i - 1]])))
    links = list(dict.fromkeys(links))
    for i, ends in enumerate(links):
        parts.append(Part(f"k{i + 1}", "springs", ends, stiffness * spread(rng, 0.4, 4)))
        if i == 0 or rng.random() < 0.8:
            parts.append(Part(f"c{i + 1}", "dampers", ends, damping * spread(rng, 0.4, 3)))
    if rng.random() < 0.3:
        parts.append(Part("cg", "dampers", (pick(rng, names), "ground"), damping * spread(rng, 0.3, 2)))
    share = 0.5 if kind == "part" else 0.25
    known = rng.random(len(parts)) < share
    known[int(rng.integers(n))] |= drive == "base" or kind == "modes"  # a known mass gives the scale
    for i in np.flatnonzero(known):
        sd = spread(rng, 0.002, 0.02) if rng.random() < 0.3 else None
        stated = parts[i].value * (1 + (rng.normal(0, sd) if sd else 0))
        parts[i] = replace(parts[i], stated=stated, sd=sd)
    at = pick(rng, names)
    sensors = draw_sensors(rng, kind, names, drive)
    return Rig(names, drive, at, tuple(parts), sensors, kind in ("part", "nonlinear"))


def draw_sensors(rng: Rng, kind: str, names: tuple[str, ...], drive: str) -> tuple[Sensor, ...]:
    seen = list(names)
    if kind == "part":
        seen = [str(name) for name in rng.permutation(names)[: int(rng.integers(1, len(names)))]]
    order = int(rng.integers(3))
    sensors = []
    for point in seen:
        order = int(rng.integers(3)) if rng.random() < 0.25 else order
        order = 0 if kind == "modes" else order
        unit = pick(rng, UNITS[order])
        sensors.append(Sensor(f"{'dva'[order]}_{point}", ((point, 1.0),), order, unit, UNITS[order][unit]))
    if rng.random() < 0.15 and drive == "base" and kind != "modes":
        reads = ((seen[0], 1.0), ("u", -1.0))
        sensors.append(Sensor("relative", reads, 0, "mm", 1e-3))
    if rng.random() < 0.3 and drive == "base" and kind not in ("nonlinear", "modes"):
        sensors.append(Sensor("reaction", (("reaction", 1.0),), 0, "N", 1.0))
    if drive == "force":
        unit = pick(rng, FORCES)
        return (*sensors, Sensor("f", (("f", 1.0),), 0, unit, FORCES[unit]))
    order = pick(rng, (0, 0, 2))
    unit = pick(rng, UNITS[order])
    return (*sensors, Sensor("u", (("u", 1.0),), order, unit, UNITS[order][unit]))


# ---------------------------------------------------------------------------------------------- tests


@dataclass(frozen=True)
class Truth:
    """What counts as the right answer; a name of None stands for any."""

    accepted: tuple[tuple[str, frozenset[str] | float | None], ...] = ()
    points: frozenset[str] | None = None  # of a fault in the rig: where it sits


@dataclass
class Case:
    kind: str
    stated: Rig  # as the rig file has it
    true: Rig
    f: Array  # lines as stated, Hz: of tables and dwells; of records those of a whole period
    drive: Array  # complex amplitude of the input at them
    rate: float = 0.0  # samples a second, as stated
    samples: int = 0  # of a dwell, or of the record
    start: int = 0  # of a record within its period
    experiment: Array | None = None
    changed: tuple[Rig, int] | None = None  # another rig from this line on
    clock: float = 1.0  # true frequencies over stated ones
    labels: dict[int, float] = field(default_factory=dict)  # lines with a wrong label
    edits: list[tuple[Any, ...]] = field(default_factory=list)  # of channels, at lines
    late: list[tuple[Any, ...]] = field(default_factory=list)  # of samples
    held: bool = False  # the input is held between samples
    tone: tuple[str, int, float] | None = None  # an unmeasured force: point, line, amplitude
    sd: Array = field(default_factory=lambda: np.zeros(0))  # of each channel's noise, SI
    modes: int = 0  # how many of them are measured
    references: Array | None = None  # the point by which each is scaled
    truth: Truth = Truth()

    @property
    def inputs(self) -> int:
        return len(self.stated.sensors) - 1


def draw_test(rng: Rng, kind: str, law: str = "") -> Case:
    """A sound test in which every unknown can be seen well."""
    while True:
        rig = draw_rig(rng, kind)
        if kind != "nonlinear" and not any(part.free for part in rig.parts):
            continue
        own = natural_frequencies(rig)
        low, high = float(own[0]), float(own[-1])
        if high > (3 if kind == "nonlinear" else 8) * low or not 0.2 < low < 200:
            continue
        if kind == "nonlinear":
            case = draw_nonlinear(rng, rig, low, high, law)
        elif kind == "modes":
            modes = int(rng.integers(max(2, len(own) - 1), len(own) + 1))
            case = Case(kind, rig, rig, own, own * 0 + 1, modes=modes)
        elif kind in ("table", "dwells"):
            lines = int(rng.integers(15, 60) if kind == "table" else rng.integers(10, 22))
            f = np.geomspace(0.5 * low, 1.4 * high, lines) * (1 + rng.uniform(-0.01, 0.01, lines))
            f = np.unique(np.round(f, 3))
            drive = np.exp(1j * rng.uniform(0, 2 * np.pi, len(f)) * (rng.random() < 0.5))
            drive = drive * spread(rng, 0.1, 10) * drive_size(rig, f)
            rate = float(f"{high * rng.uniform(14, 25):.3g}")
            samples = int(rng.integers(250, 500)) * (2 if low * 6 < high else 1)
            case = Case(kind, rig, rig, f, drive, rate, samples)
        else:
            case = draw_record(rng, kind, rig, low, high)
            if case.samples < 600 or slowest_decay(rig) < 0.025 * low * 2 * np.pi:
                continue
        clean = measure(case)
        noise = spread(rng, 0.003, 0.03) if kind != "dwells" else spread(rng, 0.005, 0.08)
        rms = channel_rms(clean)
        case.sd = noise * rms * np.exp(rng.normal(0, 0.3, len(rms)))
        case.sd[-1] = 0.002 * rms[-1] * (rng.random() < 0.3)
        if kind == "modes":
            case.sd = np.full(len(rms), spread(rng, 0.005, 0.05))
        fit = free_fit(case, clean)
        if fit.names and np.all(fit.sd < KNOWN_TO) and fit.d < 0.5:
            return case


def channel_rms(data: Data) -> Array:
    return np.sqrt(np.mean([np.mean(np.abs(part) ** 2, axis=0) for part in data.parts], axis=0))


def slowest_decay(rig: Rig) -> float:
    """Rate of the mode that dies away last, 1/s."""
    return float(-np.linalg.eigvals(state_matrix(rig, rig.values)).real.max())


def drive_size(rig: Rig, f: Array) -> Array:
    """Motion of some millimetres at low frequencies, or a force that moves the masses likewise."""
    if rig.drive == "base":
        return 1e-3 * (f[0] / f) ** 0.5
    return np.full(len(f), 1e-3 * max(part.value for part in rig.parts if part.section == "springs"))


def draw_record(rng: Rng, kind: str, rig: Rig, low: float, high: float, finer: int = 1) -> Case:
    """A stretch of a motion that repeats after a longer period: exact at every sample, no start from rest."""
    rate = float(f"{finer * high * rng.uniform(3.6, 6):.3g}")
    samples = int(np.clip(rate / low * rng.uniform(15, 40), 700, 2400 if finer == 1 else 1500))
    period = 2 * int(samples * 0.75)  # even, as `irfft` takes it by its lines
    f = np.fft.rfftfreq(period, 1 / rate)
    band = (f > 0.3 * low) & (f < min(1.6 * high, 0.42 * rate))
    if rng.random() < 0.6:
        drive = (rng.normal(size=len(f)) + 1j * rng.normal(size=len(f))) * band
    else:
        t = np.arange(period) / period
        sweep = np.sin(2 * np.pi * (0.3 * low * t + (1.5 * high - 0.3 * low) * t**2 / 2) * period / rate)
        drive = np.fft.rfft(sweep * np.minimum(1, np.minimum(t, 1 - t) * 30)) * band
    drive[1:] *= drive_size(rig, f[1:]) if rig.drive == "force" else 1e-3 * (low / np.maximum(f[1:], low))
    drive *= spread(rng, 0.1, 10) * np.sqrt(period)
    return Case(kind, rig, rig, f, drive, rate, samples, int(0.3 * samples))


def draw_nonlinear(rng: Rng, rig: Rig, low: float, high: float, law: str) -> Case:
    """A nonlinear part whose force is between a twentieth and half that of the spring beside it."""
    if rng.random() < 0.5:
        case = draw_record(rng, "nonlinear", rig, low, high, finer=3)  # for the harmonics
    else:
        f = np.round(np.geomspace(0.6 * low, 1.2 * high, int(rng.integers(5, 8))), 3)
        drive = drive_size(rig, f) * spread(rng, 0.1, 10) * np.exp(rng.normal(0, 0.4, len(f)))
        case = Case("nonlinear", rig, rig, f, drive.astype(complex), float(f"{high * 16:.3g}"), 300)
    spring = pick(rng, [part for part in rig.parts if part.section == "springs"])
    ends = spring.ends if rng.random() < 0.5 else (spring.ends[0], "ground")
    probe = replace(rig, sensors=tuple(Sensor(n, ((n, 1.0),), 0, "m", 1.0) for n in (*rig.coordinates, "u")))
    e = direction((*rig.coordinates, "u"), Part("", "", ends, 0))
    moved = (responses(probe, rig.values, case.f) @ e) * case.drive
    scale = np.sqrt(2) / len(np.fft.irfft(moved)) if case.start else 1 / np.sqrt(2 * len(moved))
    d, v = (float(scale * np.linalg.norm(moved * (2 * np.pi * case.f) ** p)) for p in (0, 1))
    law = law or pick(rng, LAWS)
    force, constants = spring.value * d * spread(rng, 0.05, 0.5), ()
    size = {
        "cubic": force / (2 * d**3),
        "quadratic": force / v**2,
        "coulomb": 0.5 * force,
        "gap": 2 * force / d,
    }[law]
    if law == "gap":
        constants = (("gap", float(f"{d * rng.uniform(0.6, 1.1):.4g}")),)
    elif law == "coulomb":
        constants = (("v0", float(f"{0.08 * v:.4g}")),)
    section = "springs" if law in ("cubic", "gap") else "dampers"
    rig = replace(rig, parts=(*rig.parts, Part("kn", section, ends, size, law=law, constants=constants)))
    return replace(case, stated=rig, true=rig)


# ---------------------------------------------------------------------------------------------- data


@dataclass(frozen=True)
class Data:
    """Without noise, SI: amplitudes (lines, channels) of a table, or samples (samples, channels) of each stretch."""

    parts: list[Array]
    period: Array | None = None  # of a record: what the input's channel holds at all lines


def measure(case: Case) -> Data:
    """What the channels hold of the true rig, with all edits."""
    rig, values = case.true, case.true.values
    if case.kind == "modes":
        return Data([modal(case, rig, values)])
    if case.kind == "nonlinear":
        samples = [edited_channels(case, part[0], None) for part in simulate(case, rig, [values])]
        return Data(spoil_samples(case, [part[MARGIN:-MARGIN] for part in samples]))
    f = case.f * case.clock
    for line, wrong in case.labels.items():
        f[line] = wrong  # the frequency at which it really moved
    if case.held:
        amplitudes = held_responses(rig, values, case) * case.drive[:, None]
    else:
        amplitudes = responses(rig, values, f) * case.drive[:, None]
    if case.changed:
        other, first = case.changed
        amplitudes[first:] = (responses(other, other.values, f) * case.drive[:, None])[first:]
    if case.tone:
        point, line, size = case.tone
        amplitudes[line] += responses(rig, values, f[line : line + 1], point)[0] * size
    amplitudes = edited_channels(case, amplitudes, f)
    if case.kind == "table":
        return Data([amplitudes])
    if case.kind == "dwells":
        t = 2 * np.pi * case.f[:, None] * np.arange(case.samples) / case.rate
        samples = np.real(amplitudes[:, None, :] * np.exp(1j * t)[:, :, None])
        return Data(spoil_samples(case, list(samples)))
    whole = np.fft.irfft(amplitudes, axis=0)[case.start : case.start + case.samples]
    return Data(spoil_samples(case, [whole]), amplitudes[:, case.inputs])


def held_responses(rig: Rig, values: dict[str, float], case: Case) -> Array:
    """Of a force held from sample to sample: the exact discrete system, on the circle |z| = 1."""
    n = len(rig.coordinates)
    A = state_matrix(rig, values)
    inverse = np.linalg.inv(matrices(rig, values)["masses"][:n, :n])
    B = np.concatenate([np.zeros(n), inverse @ [float(name == rig.at) for name in rig.coordinates]])[:, None]
    rows = {0: (np.eye(2 * n)[:n], np.zeros(n)), 1: (np.eye(2 * n)[n:], np.zeros(n)), 2: (A[n:], B[n:, 0])}
    C, D = [], []
    for sensor in rig.sensors[:-1]:
        i = rig.coordinates.index(sensor.reads[0][0])
        C.append(rows[sensor.order][0][i])
        D.append([rows[sensor.order][1][i]])
    Ad, Bd, Cd, Dd, _ = cont2discrete((A, B, np.array(C), np.array(D)), 1 / case.rate)
    z = np.exp(2j * np.pi * case.f / case.rate)[:, None, None]
    outputs = (Cd @ np.linalg.solve(z * np.eye(2 * n) - Ad, Bd + 0 * z) + Dd)[:, :, 0]
    return np.concatenate([outputs, np.ones((len(z), 1))], axis=1)


def edited_channels(case: Case, rows: Array, f: Array | None) -> Array:
    """Amplitudes (lines, channels) or, without frequencies, samples with what is wrong with channels."""
    result = rows.copy()
    for what, channel, *how in case.edits:
        if what == "times":
            result[how[1] if len(how) > 1 else 0 :, channel] *= how[0]
        elif what == "late" and f is None:
            result[:, channel] = np.roll(result[:, channel], round(how[0] * case.rate))
        elif what == "late":
            result[:, channel] *= np.exp(-2j * np.pi * f * how[0])
        elif what == "swap":
            result[:, [channel, how[0]]] = result[:, [how[0], channel]]
        elif what == "mix":
            result[:, channel] += how[1] * result[:, how[0]]
        elif what == "low-pass":
            result[:, channel] /= 1 + 1j * f / how[0]
        elif what == "high-pass":
            result[:, channel] *= (1j * f / how[0]) / (1 + 1j * f / how[0])
        elif what == "conjugate":
            result[:, channel] = np.conj(result[:, channel])
        elif what == "bad dwell":
            result[channel] *= how[0]
    return result


def spoil_samples(case: Case, stretches: list[Array]) -> list[Array]:
    for what, channel, *how in case.late:
        for i, old in enumerate(stretches):
            new = old.copy()
            if what == "clip":
                new[:, channel] = np.clip(new[:, channel], -how[0], how[0])
            elif what == "spikes":
                new[how[0], channel] += how[1]
            elif what == "step":
                new[how[0] :, channel] *= how[1]
            elif what == "tone":
                new[:, channel] += how[1] * np.cos(2 * np.pi * how[0] * np.arange(len(new)) / case.rate + i)
            elif what == "lost":
                first, count = how
                new = old[: len(old) - count].copy()
                new[first:, channel] = old[first + count :, channel]
            stretches[i] = new
    return stretches


class OverdampedError(Exception):
    """A trial of the unknowns leaves fewer modes than were measured."""


def modal(case: Case, rig: Rig, values: dict[str, float]) -> Array:
    """Frequency, damping ratio and shape at each sensor's point of the lowest modes: one row a mode, real numbers."""
    roots, vectors = eig(state_matrix(rig, values))
    keep = np.flatnonzero(roots.imag > 0)
    keep = keep[np.argsort(np.abs(roots[keep]))][: case.modes]
    if case.references is not None and len(keep) < len(case.references):
        raise OverdampedError
    seen = [rig.coordinates.index(sensor.reads[0][0]) for sensor in rig.sensors[:-1]]
    shapes = vectors[np.ix_(seen, keep)].T
    if case.references is None:
        case.references = np.argmax(np.abs(shapes), axis=1)
    shapes = shapes / shapes[np.arange(len(shapes)), case.references][:, None]
    rows = [np.abs(roots[keep]) / (2 * np.pi), -roots[keep].real / np.abs(roots[keep])]
    shapes = edited_channels(case, shapes, rows[0])
    for what, mode, factor in case.late:
        rows[{"frequency": 0, "damping": 1}[what]][mode] *= factor
    return np.column_stack([*rows, shapes.real, shapes.imag])


LAWS: dict[str, Callable[..., Array]] = {
    "cubic": lambda d, v: d**3,
    "quadratic": lambda d, v: v * np.abs(v),
    "coulomb": lambda d, v, v0: np.tanh(v / v0),
    "gap": lambda d, v, gap: np.maximum(d - gap, 0) + np.minimum(d + gap, 0),
}


SIMULATED: dict[Any, list[Array]] = {}  # of the test at hand: faults of channels leave the motion as it is


def simulate(case: Case, rig: Rig, copies: list[dict[str, float]]) -> list[Array]:
    key = (rig, tuple(tuple(values.items()) for values in copies), case.f.tobytes(), case.drive.tobytes())
    if key not in SIMULATED:
        if len(SIMULATED) > 8:
            SIMULATED.clear()
        SIMULATED[key] = integrate(case, rig, copies)
    return SIMULATED[key]


def integrate(case: Case, rig: Rig, copies: list[dict[str, float]]) -> list[Array]:
    """Each stretch (copies, samples, channels) of a nonlinear rig, several sets of values integrated side by side."""
    n = len(rig.coordinates)
    points = (*rig.coordinates, "u")
    sets = [matrices(rig, values) for values in copies]
    K, C = (np.array([m[name] for m in sets])[:, :n] for name in ("springs", "dampers"))
    inertia = np.array([np.diag(m["masses"])[:n] for m in sets])
    laws = [
        (direction(points, p), LAWS[p.law], dict(p.constants), np.array([v[p.name] for v in copies]))
        for p in rig.parts
        if p.law
    ]
    load = np.array([float(name == rig.at) for name in rig.coordinates])
    base = rig.drive == "base"

    def accelerations(x: Array, v: Array, q: float, rate: float) -> Array:
        X = np.concatenate([x, np.full((len(copies), 1), q if base else 0.0)], axis=1)
        V = np.concatenate([v, np.full((len(copies), 1), rate if base else 0.0)], axis=1)
        force = -(K @ X[:, :, None] + C @ V[:, :, None])[:, :, 0]
        if not base:
            force = force + load * q
        for e, law, constants, sizes in laws:
            force = force - (sizes * law(X @ e, V @ e, **constants))[:, None] * e[:n]
        return force / inertia

    stretches = []
    for drive, before in drives(case):
        count = case.samples + 2 * MARGIN
        t = (np.arange(count) - MARGIN) / case.rate
        first = min(-before, t[0])

        def slope(moment: float, state: Array, drive: Any = drive) -> Array:
            x, v = state.reshape(2, len(copies), n)
            return np.concatenate([v, accelerations(x, v, drive[0](moment), drive[1](moment))]).ravel()

        size = np.abs(drive[0](t)).max() / (1 if base else K[0].diagonal().max())
        tolerance = np.concatenate(
            [np.full(len(copies) * n, 1e-9 * size), np.full(len(copies) * n, 1e-8 * size)]
        )
        solved = solve_ivp(
            slope, (first, t[-1]), np.zeros(2 * len(copies) * n), "DOP853", t, rtol=1e-9, atol=tolerance
        )
        X, V = np.moveaxis(solved.y.reshape(2, len(copies), n, count), 3, 1)
        A = np.array([accelerations(x, v, drive[0](s), drive[1](s)) for x, v, s in zip(X, V, t, strict=True)])
        moves = {name: (X[:, :, i], V[:, :, i], A[:, :, i]) for i, name in enumerate(rig.coordinates)}
        moves[rig.input] = tuple(part(t)[:, None] + 0 * X[:, :, 0] for part in drive)
        channels = [
            sum(factor * moves[p][s.order] for p, factor in s.reads if p in moves) for s in rig.sensors
        ]
        stretches.append(np.moveaxis(np.array(channels), 0, 2).swapaxes(0, 1))
    return stretches


def drives(case: Case) -> list[tuple[tuple[Callable[..., Any], ...], float]]:
    """The input of each stretch with two derivatives, as functions of time, and how long before 0 it sets in."""
    result = []
    if case.start:
        period = 2 * (len(case.f) - 1)
        fine = 16
        padded = np.concatenate([case.drive, np.zeros((fine - 1) * period // 2)]) * fine
        t = (np.arange(fine * period) / fine - case.start) / case.rate
        keep = t < (case.samples + 2 * MARGIN) / case.rate
        waves = [
            np.fft.irfft(padded * (2j * np.pi * case.rate / period * np.arange(len(padded))) ** p)
            for p in range(3)
        ]
        splines = tuple(CubicSpline(t[keep], wave[: len(t)][keep]) for wave in waves)
        return [(splines, case.start / case.rate)]
    slow = 10 / slowest_decay(case.true)
    for f, size in zip(case.f, case.drive, strict=True):
        w = 2 * np.pi * f
        waves = tuple(
            (lambda t, w=w, p=p, size=size: np.real(size * (1j * w) ** p * np.exp(1j * w * t)))
            for p in range(3)
        )
        result.append((waves, slow))
    return result


# ------------------------------------------------------------------------------------- what data can show


@dataclass(frozen=True)
class Fit:
    names: list[str]
    d: float  # what is left over, standard deviations
    sd: Array  # relative, of each unknown
    moved: float  # the largest shift of an unknown from the truth, in its standard deviations


def free_fit(case: Case, data: Data, extra: tuple[tuple[str, Any], ...] = ()) -> Fit:
    """The rig of the file fitted to data without noise, in logarithms, from the truth.

    From the truth in the scale of each value that is stated wrongly, too: with one known mass all others follow it.
    """
    parts = case.stated.parts
    scales = {0.0} | {float(np.log(p.stated / p.value)) for p in parts if p.stated and p.stated * p.value > 0}
    fits = [fit for scale in sorted(scales) if (fit := _fit_from(case, data, extra, scale)) is not None]
    return min(fits, key=lambda fit: fit.d)


def _fit_from(case: Case, data: Data, extra: tuple[tuple[str, Any], ...], scale: float) -> Fit | None:
    """By Gauss-Newton from the true values times e^scale; None where that is no rig to begin with."""
    rig = case.stated
    names = [part.name for part in rig.parts if part.free or ("value", part.name) in extra]
    start = {part.name: part.value * np.exp(scale) if part.free else part.stated for part in rig.parts}
    others = [e for e in extra if e[0] != "value"]
    priors = [
        (names.index(p.name), p) for p in rig.parts if p.sd is not None and ("value", p.name) not in extra
    ]

    def residual(theta: Array) -> Array:
        values = start | {name: start[name] * np.exp(step) for name, step in zip(names, theta, strict=False)}
        calibration = list(zip(others, theta[len(names) :], strict=True))
        rows = [(np.log(values[p.name] / p.stated)) / p.sd for _, p in priors if p.stated and p.sd]
        return np.concatenate([left_over(case, data, values, calibration), rows])

    theta = np.zeros(len(names) + len(others))
    step = np.array([1e-4] * len(names) + [1e-4 if kind == "gain" else 1e-3 for kind, _ in others])
    try:
        if case.kind == "nonlinear":
            rows, J = nonlinear_slopes(case, data, names, start, priors)
            theta = np.linalg.lstsq(J, -rows, rcond=None)[0]
            rows = rows + J @ theta
        else:
            rows = residual(theta)
            for _ in range(40):
                J = np.array([(residual(theta + h) - rows) / h.sum() for h in np.diag(step)]).T
                change = np.clip(np.linalg.lstsq(J, -rows, rcond=None)[0], -0.5, 0.5)
                tried = [residual(theta + change / 2**k) for k in range(6)]
                best = int(np.argmin([rows @ rows for rows in tried]))
                if not tried[best] @ tried[best] < (1 - 1e-6) * rows @ rows:
                    break
                theta, rows = theta + change / 2**best, tried[best]
    except OverdampedError:
        if scale:
            return None
        raise
    singular = np.linalg.svd(J, compute_uv=False)
    if not len(names) or singular[-1] < 1e-9 * singular[0]:
        return Fit([], float(np.linalg.norm(rows)), np.full(len(names), np.inf), 0)
    sd = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))[: len(names)]
    begun = np.array([scale if part.free else 0.0 for part in rig.parts if part.name in names])
    moved = np.abs((theta[: len(names)] + begun) / sd)
    return Fit(names, float(np.linalg.norm(rows)), sd, float(moved.max()))


def left_over(case: Case, data: Data, values: dict[str, float], calibration: list[Any]) -> Array:
    """Measured outputs less those that the rig of the file gives for the measured input, over the noise."""
    rig, last = case.stated, case.inputs
    outputs = slice(0, last)
    if case.kind == "modes":
        measured = data.parts[0]
        shapes = measured[:, 2 : 2 + last] + 1j * measured[:, 2 + last :]
        shapes = shapes / shapes[np.arange(len(shapes)), case.references][:, None]
        scaled = np.column_stack([measured[:, :2], shapes.real, shapes.imag])
        predicted = modal(replace(case, edits=[], late=[]), rig, values)
        return ((scaled - predicted) / modal_sd(case, measured)).ravel()
    gains = responses(rig, values, case.f)
    for (kind, channel), size in calibration:
        w = 2j * np.pi * case.f / case.f.max()
        gains[:, channel] *= np.exp(size) if kind == "gain" else np.exp(-w * size)
    if case.kind in ("table", "dwells"):
        Y = data.parts[0] if case.kind == "table" else amplitudes_of(case, data.parts)
        sd = case.sd[outputs] * (1 if case.kind == "table" else np.sqrt(2 / case.samples))
        rows = (Y[:, outputs] - gains[:, outputs] / gains[:, last:] * Y[:, last:]) / sd
        return np.concatenate([rows.real.ravel(), rows.imag.ravel()])
    drive = data.period if data.period is not None else case.drive
    quotient = np.zeros(len(case.f), complex)
    np.divide(drive, gains[:, last], out=quotient, where=np.abs(drive) > 1e-14 * np.abs(drive).max())
    predicted = np.fft.irfft(gains[:, outputs] * quotient[:, None], axis=0)[case.start :]
    measured = data.parts[0][:, outputs]
    return ((measured - predicted[: len(measured)]) / case.sd[outputs]).ravel()


def amplitudes_of(case: Case, stretches: list[Array]) -> Array:
    rows = []
    for f, samples in zip(case.f, stretches, strict=True):
        t = 2 * np.pi * f * np.arange(len(samples)) / case.rate
        basis = np.column_stack([np.cos(t), np.sin(t)])
        cosine, sine = np.linalg.lstsq(basis, samples, rcond=None)[0]
        rows.append(cosine - 1j * sine)
    return np.array(rows)


def nonlinear_slopes(
    case: Case, data: Data, names: list[str], start: dict[str, float], priors: list[Any]
) -> Any:
    copies = [start, *[start | {name: start[name] * (1 + 1e-4)} for name in names]]
    blocks, rows = [], []
    for stretch, measured in zip(simulate(case, case.stated, copies), data.parts, strict=True):
        predicted = stretch[:, MARGIN:-MARGIN, : case.inputs][:, : len(measured)]
        rows.append(((measured[:, : case.inputs] - predicted[0]) / case.sd[:-1]).ravel())
        blocks.append(((predicted[:1] - predicted[1:]) / 1e-4 / case.sd[:-1]).reshape(len(names), -1).T)
    for i, part in priors:
        rows.append(np.array([np.log(start[part.name] / part.stated) / part.sd]))
        blocks.append(np.eye(len(names))[i : i + 1] / part.sd)
    return np.concatenate(rows), np.concatenate(blocks)


def modal_sd(case: Case, modes: Array) -> Array:
    """Of a table of modes: frequencies, damping ratios and shapes, of which the largest entry is about 1."""
    sd = np.full(modes.shape, case.sd[0])
    sd[:, 0] = modes[:, 0] * case.sd[0] / 10
    sd[:, 1] = modes[:, 1] * max(5 * case.sd[0], 0.05)
    return sd
