"""Free decays of one to six masses and damper stands, linear and with every law: converged, and held by intervals.

`python3 dev.py bench decays_and_stands --seconds 600`.  Every draw is another rig with other noise, of the kinds in
turn until the processor time is over.  Motions and forces are computed here, from the formulas of the laws.  Decays:
one release, every displacement seen with 0.3 % noise of its rms, nothing known but the mass m1.  Stands: three
amplitudes at three frequencies, 2 % noise of the rms force.  No rig file has a guess.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import dashpot
from dashpot.arrays import Bools, Real

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the stands of the tests
from tests.recovery import test_damper_stands as stands

SAMPLES, FINE = 600, 16  # of a decay, and steps of the integration for each
NOISE = 0.003  # of a displacement, of its rms

Force = Callable[[Real, Real, Real, dict[str, Real]], Real]
Rate = Callable[[Real, Real, dict[str, Real]], Real]


@dataclass(frozen=True)
class Law:
    """Unit force of elongation, rate and state; dz/dt; text of the rig file; truth of k, elongation and its rate."""

    force: Force
    rate: Rate | None
    entry: str
    draw: Callable[[np.random.Generator, float, float, float], dict[str, float]]


def _stribeck(d: Real, v: Real, z: Real, p: dict[str, Real]) -> Real:
    return np.tanh(v / p["q.v0"]) * (1 + (p["q.ratio"] - 1) * np.exp(-((v / p["q.vs"]) ** 2)))


def _bouc_wen(z: Real, v: Real, p: dict[str, Real]) -> Real:
    return v - (p["q.gamma"] * np.abs(v) * np.sign(z) + p["q.delta"] * v) * np.abs(z)


def _bristles(z: Real, v: Real, p: dict[str, Real]) -> Real:
    return v - np.abs(v) * z / (p["q.slip"] * (1 + (p["q.ratio"] - 1) * np.exp(-((v / p["q.vs"]) ** 2))))


def _state(d: Real, v: Real, z: Real, p: dict[str, Real]) -> Real:
    return z


def _share(rng: np.random.Generator, least: float, most: float) -> float:
    return float(np.exp(rng.uniform(np.log(least), np.log(most))))


LAWS = {
    "cubic": Law(
        lambda d, v, z, p: d**3,
        None,
        "[springs] cubic",
        lambda g, k, a, w: {"q": _share(g, 0.1, 1) * k / a**2},
    ),
    "quadratic": Law(
        lambda d, v, z, p: v * np.abs(v),
        None,
        "[dampers] quadratic",
        lambda g, k, a, w: {"q": _share(g, 0.03, 0.3) * k / (a * w**2)},
    ),
    "coulomb": Law(
        lambda d, v, z, p: np.tanh(v / p["q.v0"]),
        None,
        "[dampers] coulomb, v0",
        lambda g, k, a, w: {"q": _share(g, 0.01, 0.03) * k * a, "q.v0": _share(g, 0.03, 0.1) * a * w},
    ),
    "stribeck": Law(
        _stribeck,
        None,
        "[dampers] stribeck, v0, ratio, vs",
        lambda g, k, a, w: {
            "q": _share(g, 0.01, 0.03) * k * a,
            "q.v0": _share(g, 0.03, 0.1) * a * w,
            "q.ratio": g.uniform(1.4, 2.0),
            "q.vs": _share(g, 0.2, 0.4) * a * w,
        },
    ),
    "gap": Law(
        lambda d, v, z, p: np.maximum(d - p["q.gap"], 0) + np.minimum(d + p["q.gap"], 0),
        None,
        "[springs] gap, gap",
        lambda g, k, a, w: {"q": _share(g, 0.3, 3) * k, "q.gap": g.uniform(0.2, 0.6) * a},
    ),
    "bilinear": Law(
        lambda d, v, z, p: np.maximum(d, 0) + p["q.ratio"] * np.minimum(d, 0),
        None,
        "[springs] bilinear, ratio",
        lambda g, k, a, w: {"q": k, "q.ratio": _share(g, 0.4, 2.5)},
    ),
    "jenkins": Law(
        _state,
        lambda z, v, p: np.where((np.abs(z) < p["q.slip"]) | (z * v < 0), v, 0.0),
        "[springs] jenkins, slip",
        lambda g, k, a, w: {"q": _share(g, 0.3, 1) * k, "q.slip": g.uniform(0.05, 0.2) * a},
    ),
    "bouc-wen": Law(
        _state,
        _bouc_wen,
        "[springs] bouc-wen, gamma, delta, nu = 1",
        lambda g, k, a, w: {
            "q": _share(g, 0.3, 1) * k,
            "q.gamma": g.uniform(3, 8) / a,
            "q.delta": g.uniform(-2, 2) / a,
        },
    ),
    "lugre": Law(
        _state,
        _bristles,
        "[springs] lugre, slip, ratio, vs, tau = 0",
        lambda g, k, a, w: {
            "q": _share(g, 0.3, 1) * k,
            "q.slip": g.uniform(0.03, 0.1) * a,
            "q.ratio": g.uniform(1.4, 2.0),
            "q.vs": _share(g, 0.2, 0.4) * a * w,
        },
    ),
    "maxwell": Law(
        _state,
        lambda z, v, p: v - z / p["q.tau"],
        "[springs] maxwell, tau",
        lambda g, k, a, w: {"q": _share(g, 0.3, 1) * k, "q.tau": _share(g, 0.3, 3) / w},
    ),
}


ALONE = {
    "bilinear": "k",
    "maxwell": "c",
}  # laws beside which the linear part of the same link is one too many


@dataclass(frozen=True)
class Drawn:
    """A rig, its data and the truth of its unknowns."""

    kind: str
    rig: dashpot.Rig
    data: object
    truth: dict[str, float]


def decay(law: str | None, count: int, rng: np.random.Generator) -> Drawn:
    """A row of masses on the ground, let go; the law in one of its links, a damper beside each spring."""
    points = [f"x{i}" for i in range(1, count + 1)]
    m, k = np.exp(rng.uniform(-0.5, 0.5, count)), 1000 * np.exp(rng.uniform(-0.5, 0.5, count))
    links = (
        np.eye(count, count + 1)[:, :count] - np.eye(count, count + 1, 1)[:, :count]
    )  # d of link i: x_i − x_i+1
    K = links.T @ np.diag(k) @ links
    rates = np.sqrt(np.linalg.eigvalsh(K / np.sqrt(m[:, None] * m)))
    c = k * rng.uniform(0.01, 0.04, count) / rates[0]
    shape = np.linalg.solve(K, np.abs(rng.standard_normal(count)) + 0.2)
    x0 = 0.01 * shape / np.max(shape)
    truth = {f"m{i + 1}": m[i] for i in range(1, count)} | {f"k{i + 1}": k[i] for i in range(count)}
    truth |= {f"c{i + 1}": c[i] for i in range(count)}
    at = int(rng.integers(count))
    own: dict[str, float] = {}
    if law is not None:
        a = max(abs(float(links[at] @ x0)), 0.1 * float(np.max(np.abs(x0))))
        own = LAWS[law].draw(rng, float(k[at]), a, float(rates[0]))
    if law in ALONE:
        truth.pop(f"{ALONE[law]}{at + 1}")
    step = 2 * np.pi / rates[-1] / 12
    span = max(1.0, min(3.0, SAMPLES * step / (6 * np.pi / rates[0])))
    step = step / span if SAMPLES * step < 6 * np.pi / rates[0] else step
    step = max(step, 8 * np.pi / rates[0] / SAMPLES)  # four periods of the slowest at least
    there = {"k": k, "c": c}
    if law in ALONE:
        there[ALONE[law]] = np.where(np.arange(count) == at, 0.0, there[ALONE[law]])
    x = _motion(law, own, at, m, there["c"], there["k"], links, x0, step)
    x += NOISE * np.sqrt(np.mean(x**2, axis=0)) * rng.standard_normal(x.shape)
    columns = {"time_s": step * np.arange(SAMPLES)} | dict(zip(points, x.T, strict=True))
    rig = dashpot.parse_rig(_text(law, count, at, float(m[0])))
    return Drawn(f"decay, {law or 'linear'}", rig, columns, {n: float(v) for n, v in (truth | own).items()})


def _motion(
    law: str | None,
    own: dict[str, float],
    at: int,
    m: Real,
    c: Real,
    k: Real,
    links: Real,
    x0: Real,
    step: float,
) -> Real:
    """Displacements (samples, masses) by Runge and Kutta."""
    count, h = len(m), step / FINE

    def rate(y: Real) -> Real:
        x, v, z = y[:count], y[count:-1], y[-1:]
        d, w = links @ x, links @ v
        force = k * d + c * w
        dz = np.zeros(1)
        if law is not None:
            force[at] += (own["q"] * LAWS[law].force(d[at : at + 1], w[at : at + 1], z, own))[0]
            of_state = LAWS[law].rate
            dz = dz if of_state is None else of_state(z, w[at : at + 1], own)
        return np.concatenate([v, -(links.T @ force) / m, dz])

    y, kept = np.concatenate([x0, np.zeros(count + 1)]), []
    for _ in range(SAMPLES):
        kept.append(y[:count])
        for _ in range(FINE):
            one = rate(y)
            two = rate(y + h / 2 * one)
            three = rate(y + h / 2 * two)
            y = y + h / 6 * (one + 2 * two + 2 * three + rate(y + h * three))
            if law == "jenkins":
                y[-1] = np.clip(y[-1], -own["q.slip"], own["q.slip"])
    return np.array(kept)


def _text(law: str | None, count: int, at: int, m1: float) -> str:
    ends = [f'["x{i}", "{"ground" if i == count else f"x{i + 1}"}"]' for i in range(1, count + 1)]
    masses = [f'm{i} = {{ at = "x{i}"{f", value = {m1!r}" if i == 1 else ""} }}' for i in range(1, count + 1)]
    sections = {
        "springs": [
            f"k{i + 1} = {{ between = {end} }}"
            for i, end in enumerate(ends)
            if not (ALONE.get(law or "") == "k" and i == at)
        ],
        "dampers": [
            f"c{i + 1} = {{ between = {end} }}"
            for i, end in enumerate(ends)
            if not (ALONE.get(law or "") == "c" and i == at)
        ],
    }
    if law is not None:
        section, name, *constants = LAWS[law].entry.replace(",", "").replace(" = ", "=").split()
        said = [c if "=" in c else f'{c} = "unknown"' for c in constants]
        entry = ", ".join([f'law = "{name}"', *said])
        sections[section.strip("[]")].append(f"q = {{ between = {ends[at]}, {entry} }}")
    names = ", ".join(f'"x{i}"' for i in range(1, count + 1))
    lines = [f"coordinates = [{names}]", "[masses]", *masses]
    for section, entries in sections.items():
        lines += [f"[{section}]", *entries]
    lines += ["[channels]", *(f'x{i} = {{ of = "x{i}" }}' for i in range(1, count + 1))]
    return "\n".join(lines)


def stand(law: str, rng: np.random.Generator) -> Drawn:
    """Dwells of three amplitudes at three frequencies, every true value within a factor of 1.5."""
    rig, usual = stands.stand(law)
    truth = {
        name: value * (np.exp(rng.uniform(-0.4, 0.4)) if name != "q.chi" else 1.0)
        for name, value in usual.items()
    }
    return Drawn(f"stand, {law}", rig, stands.dwells(law, truth, rng), truth)


def draws(kinds: list[str], seed: int) -> Iterator[Drawn]:
    """Without end: the kinds in turn, of one to six masses in turn."""
    number = 0
    while True:
        for kind in kinds:
            rng = np.random.default_rng((seed, number))
            place, law = kind.split(", ")
            yield (
                stand(law, rng)
                if place == "stand"
                else decay(None if law == "linear" else law, 1 + number // len(kinds) % 6, rng)
            )
            number += 1


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=600.0)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--only", default="", help="kinds, such as 'decay, cubic'; apart by ;")
    options.add_argument("--verbose", action="store_true")
    given = options.parse_args()
    kinds = [f"decay, {law}" for law in ("linear", *LAWS)] + [f"stand, {law}" for law in stands.LAWS]
    kinds = [
        kind for kind in kinds if not given.only or any(kind.startswith(o) for o in given.only.split(";"))
    ]
    found: dict[str, list[Found | None]] = {kind: [] for kind in kinds}
    spent = dict.fromkeys(kinds, 0.0)
    begun = time.process_time()
    for drawn in draws(kinds, given.seed):
        if time.process_time() - begun > given.seconds:
            break
        start = time.process_time()
        one, why = _found(drawn)
        spent[drawn.kind] += time.process_time() - start
        found[drawn.kind].append(one)
        if given.verbose:
            worst = "" if one is None else f"{np.max(np.abs(one.z)):.1f}"
            print(f"{drawn.kind} {drawn.rig.model.n} {'lost ' * _lost(one)}{worst} {why}", flush=True)
    print("| kind | draws | lost | held, % | rms of error/sd | s each |")
    print("|---|---|---|---|---|---|")
    for kind in kinds:
        _told(kind, found[kind], spent[kind])
    for place in ("decay", "stand"):
        mine = [kind for kind in kinds if kind.startswith(place)]
        if mine:
            _told(
                f"{place}, all",
                [one for kind in mine for one in found[kind]],
                sum(spent[kind] for kind in mine),
            )


@dataclass(frozen=True)
class Found:
    """(estimate − truth)/sd of every unknown, and whether its 95 % interval holds the truth, (unknowns,) each."""

    z: Real
    held: Bools


def _found(drawn: Drawn) -> tuple[Found | None, str]:
    """None where there is no converged estimate, and why."""
    try:
        estimate = drawn.rig.identify(drawn.data, judge=False)
    except dashpot.DashpotError as error:
        return None, str(error)
    if not bool(estimate.converged):
        return None, "not converged"
    pairs = [(estimate[name], value) for name, value in drawn.truth.items()]
    z = [(one.value - value) / one.sd for one, value in pairs]
    held = [one.interval95[0] <= value <= one.interval95[1] for one, value in pairs]
    return Found(np.array(z), np.array(held)), ""


def _lost(one: Found | None) -> bool:
    """Whether there is no estimate, or one that its interval does not help, beyond 6 standard deviations."""
    return one is None or bool(np.any((np.abs(one.z) > 6) & ~one.held))


def _told(kind: str, found: list[Found | None], seconds: float) -> None:
    lost = sum(_lost(one) for one in found)
    shares = np.array([np.mean(one.held) for one in found if one is not None])
    z = np.concatenate([one.z for one in found if one is not None] or [np.array([np.nan])])
    held, rms = 100 * np.mean(shares), np.sqrt(np.mean(np.minimum(np.abs(z), 6) ** 2))
    spread = 100 * np.std(shares) / np.sqrt(max(len(shares), 1))
    told = f"| {kind} | {len(found)} | {lost} | {held:.1f} ± {spread:.1f} | {rms:.2f} |"
    print(f"{told} {seconds / max(len(found), 1):.1f} |")


if __name__ == "__main__":
    main()
