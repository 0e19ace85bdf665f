"""What is said of a linear rig fitted to data of a nonlinear one: a table of laws by kinds of test.

`python3 dev.py bench nonlinear_causes`.  Four rigs of one and two masses, shaken or pushed; settled stepped sine at one
and two drive levels, with harmonics 1, 3, 5 and 2, and whole records of random motion (by a Runge-Kutta method of its
own); noise of 0.3 to 3 %.  Each law exerts a fifth of its linear spring's force.  Counted is how often the fit is
refused, how often the first cause is a nonlinear element, at the true place, of the true law; with `--elements` how
often `compare --elements` ranks the true law at the true place first.  Linear rigs tell the false alarms.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dashpot.api import identify
from dashpot.arrays import Real
from dashpot.channel import Channel, Quantity
from dashpot.check.element_evidence import compare_in_dwells, compare_in_records
from dashpot.check.explain.rigs import points_of
from dashpot.data.record import Record
from dashpot.data.spectrum import Spectrum
from dashpot.errors import DashpotError
from dashpot.estimate.assessment import Finding
from dashpot.model.dynamics import matrices, response
from dashpot.model.elements import Element, Kind, between, mass
from dashpot.model.network import Input, Model
from dashpot.model.nonlinear.force_law import Constant, force_law

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the rigs of the tests
from tests.nonlinear_rigs import settled

SIZE, SPEED = 1e-3, 0.04  # of the element's elongation at the greatest resonance, m and m/s
STRENGTH = 0.2  # of the linear spring's force
STIFFNESS, DAMPING, MASS = 2500.0, 9.0, 1.7
FREQUENCIES = np.array([2, 3, 4, 4.5, 5, 5.5, 6, 6.5, 7, 8, 9.5, 11, 12.5, 14])
ORDERS = (1, 2, 3, 5)
RATE, SECONDS, FINER = 100.0, 15.0, 8


@dataclass(frozen=True)
class Law:
    """A law as rig files name it, and its unit force of d, v and the state z that a slider limits to `slip`."""

    name: str
    unit: Callable[[float, float, float], float]
    kind: Kind = Kind.SPRING
    sign: float = 1.0
    constants: Mapping[str, float] | None = None


GAP, ONE, SLIP, SLOW = 0.5 * SIZE, 0.3 * SIZE, 0.3 * SIZE, 0.05 * SPEED
LAWS = {
    "linear": Law("cubic", lambda d, v, z: 0.0, sign=0.0),
    "cubic, hardening": Law("cubic", lambda d, v, z: d**3),
    "cubic, softening": Law("cubic", lambda d, v, z: d**3, sign=-0.5),
    "square": Law("square", lambda d, v, z: d**2),
    "d|d|": Law("quadratic", lambda d, v, z: d * abs(d)),
    "gap": Law("gap", lambda d, v, z: max(d - GAP, 0.0) + min(d + GAP, 0.0), constants={"gap": GAP}),
    "one-sided": Law("one-sided", lambda d, v, z: max(d - ONE, 0.0), constants={"gap": ONE}),
    "v|v|": Law("quadratic", lambda d, v, z: v * abs(v), Kind.DAMPER),
    "coulomb": Law("coulomb", lambda d, v, z: np.tanh(v / SLOW), Kind.DAMPER, constants={"v0": SLOW}),
    "jenkins": Law("jenkins", lambda d, v, z: z, constants={"slip": SLIP}),
}


@dataclass(frozen=True)
class Bench:
    """A rig whose last element is nonlinear, its unknowns, and the input that moves that element by SIZE."""

    model: Model
    theta: Real
    drive: float

    @property
    def linear(self) -> Model:
        """The rig that is fitted."""
        return replace(self.model, elements=self.model.elements[:-1])

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Displacements of all that moves, and the force."""
        moving = [*self.model.coordinates, *self.model.displacement_inputs]
        forces = [Channel(f, {f: 1.0}, Quantity.FORCE) for f in self.model.force_inputs]
        return (*(Channel(point, {point: 1.0}) for point in moving), *forces)

    @property
    def strength(self) -> float:
        """Of the nonlinear element."""
        return float(self.theta[[u.name for u in self.model.unknowns].index("q")])


PLACES = (
    ("x1", "u"),
    ("x2", "u"),
    ("x1", "x2"),
    ("x2", "ground"),
)  # of the nonlinear element in the four rigs


def bench(number: int, law: Law) -> Bench:
    """0: one mass on a shaken base; 1, 2: two, the element to the base and between; 3: two that are pushed."""
    count, end = (1, 2, 2, 2)[number], "ground" if number == 3 else "u"
    points = [f"x{k}" for k in range(1, count + 1)]
    links = list(enumerate(zip(points, [*points[1:], end], strict=True), 1))
    constants = [Constant(name, value) for name, value in (law.constants or {}).items()]
    element = replace(
        between("q", law.kind, *PLACES[number]),
        force_law=force_law(law.name, constants, damper=law.kind is Kind.DAMPER),
    )
    masses = [mass(f"m{k}", point) for k, point in enumerate(points, 1)]
    if end == "u":
        masses[-1] = replace(masses[-1], value=MASS)
    straight = [between(f"k{k}", Kind.SPRING, *link) for k, link in links]
    straight += [between(f"c{k}", Kind.DAMPER, *link) for k, link in links]
    model = Model(
        tuple(points), (Input("u"),) if end == "u" else (Input("f", "force", {"x1": 1.0}),),
        (*masses, *straight, element),
    )  # fmt: skip
    largest = max(abs(law.unit(SIZE * np.sin(a), SPEED * np.cos(a), SLIP)) for a in np.linspace(0, 6.28, 100))
    values = {"q": law.sign * STRENGTH * STIFFNESS * SIZE / largest if law.sign else 0.0}
    for k in range(1, count + 1):
        values |= {f"m{k}": MASS, f"k{k}": STIFFNESS * (1 + 0.6 * (k - 1)), f"c{k}": DAMPING}
    theta = np.array([values[u.name] for u in model.unknowns])
    return Bench(model, theta, SIZE / amplification(model, theta, PLACES[number]))


def amplification(model: Model, theta: Real, place: tuple[str, str]) -> float:
    """Elongation at the greatest resonance of the linear rig, by a unit input."""
    p = model.parameters(theta)[:-1]
    linear = replace(model, elements=model.elements[:-1])
    omega = 2 * np.pi * np.linspace(2, 14, 400)
    U, f = (
        np.ones((len(omega), count), dtype=complex)
        for count in (len(model.displacement_inputs), len(model.force_inputs))
    )
    X = response(linear, p, omega, U, f)
    at = {**dict(zip(model.coordinates, X.T, strict=True)), "u": 1.0, "ground": 0.0}
    return float(np.max(np.abs(at[place[0]] - at[place[1]])))


def dwells(
    rig: Bench, levels: tuple[float, ...], orders: tuple[int, ...], noise: float, seed: int
) -> Spectrum:
    """Settled dwells at each level of the drive."""
    return settled(
        rig.model, rig.theta, rig.channels, np.tile(FREQUENCIES, len(levels)), orders=orders, noise=noise,
        amplitude=rig.drive * np.repeat(levels, len(FREQUENCIES)), rng=np.random.default_rng(seed),
    )  # fmt: skip


def record(rig: Bench, law: Law, noise: float, seed: int) -> Record:
    """Random motion from rest, forty tones of 1.5 to 14 Hz."""
    model, rng = rig.model, np.random.default_rng(seed)
    h, N = 1 / (RATE * FINER), int(RATE * SECONDS)
    omega, phase = 2 * np.pi * rng.uniform(1.5, 14, 40), rng.uniform(0, 2 * np.pi, 40)
    at = omega * (np.arange(2 * FINER * (N - 1) + 1) * h / 2)[:, None] + phase
    size = 1.5 * rig.drive * (2 / 40) ** 0.5
    given, rate = size * np.sum(np.cos(at), axis=1), -size * np.sum(omega * np.sin(at), axis=1)
    parts = matrices(rig.linear, model.parameters(rig.theta)[:-1])
    n, B, D, p = model.n, model.B[-1], model.D[-1], rig.strength
    loads = (
        given[:, None] * parts.G[:, 0] + rate[:, None] * parts.F[:, 0]
        if len(D)
        else given[:, None] * model.S[:, 0]
    )
    on_u = float(D[0]) if len(D) else 0.0
    inverse = np.linalg.inv(parts.M)
    A, C = inverse @ parts.K, inverse @ parts.C
    loads, push = loads @ inverse.T, inverse @ B

    def rates(s: Real, i: int, slid: float) -> tuple[Real, float]:
        d, v = float(B @ s[:n]) + on_u * given[i], float(B @ s[n:]) + on_u * rate[i]
        a = loads[i] - A @ s[:n] - C @ s[n:] - p * law.unit(d, v, np.clip(d - slid, -SLIP, SLIP)) * push
        return np.concatenate([s[n:], a]), d

    s, slid, out = np.zeros(2 * n), 0.0, []
    for i in range(0, 2 * FINER * (N - 1) + 1, 2):
        first, d = rates(s, i, slid)
        slid = float(np.clip(slid, d - SLIP, d + SLIP))  # where the slider is
        if i % (2 * FINER) == 0:
            out.append(s[:n])
        if i < 2 * FINER * (N - 1):
            second, _ = rates(s + h / 2 * first, i + 1, slid)
            third, _ = rates(s + h / 2 * second, i + 1, slid)
            last, _ = rates(s + h * third, i + 2, slid)
            s = s + h / 6 * (first + 2 * second + 2 * third + last)
    values = np.column_stack([np.array(out), given[:: 2 * FINER]])
    sd = noise * np.std(values, axis=0) * np.array([1.0] * n + [0.0])
    return Record(rig.channels, np.arange(N) / RATE, values + sd * rng.standard_normal(values.shape))


Test = Callable[[Bench, Law, float, int], "Spectrum | Record"]
TESTS: dict[str, Test] = {
    "one level": lambda rig, law, noise, seed: dwells(rig, (1.0,), (1,), noise, seed),
    "two levels": lambda rig, law, noise, seed: dwells(rig, (0.4, 1.0), (1,), noise, seed),
    "harmonics": lambda rig, law, noise, seed: dwells(rig, (0.4, 1.0), ORDERS, noise, seed),
    "record": record,
}


@dataclass(frozen=True)
class Outcome:
    """What was said: the verdict; of the first cause its kind, whether the place is right, its law; `others` all."""

    verdict: str
    kind: str = ""
    right_place: bool = False
    law: str = ""
    others: tuple[str, ...] = ()
    seconds: float = 0.0


def said(finding: Finding, place: frozenset[str]) -> str:
    """A cause in a few words."""
    if finding.kind != "nonlinear":
        return f"{finding.kind} {' '.join(finding.of)}"
    (element,) = finding.elements
    return f"{named(element)}{'' if frozenset(finding.of) == place else ' at ' + ' '.join(finding.of)}"


def named(element: Element) -> str:
    """A law with the kind of its element where that matters."""
    assert element.force_law is not None
    text = element.force_law.text
    return f"damper {text}" if element.kind is Kind.DAMPER and text != "coulomb" else text


def diagnosed(rig: Bench, data: Spectrum | Record, place: tuple[str, str]) -> Outcome:
    """The linear rig fitted and judged."""
    begun = time.process_time()
    try:
        estimate = identify(rig.linear, data if isinstance(data, Spectrum) else [data], diagnose=True)
    except DashpotError as error:
        return Outcome("refused", str(error)[:60], seconds=time.process_time() - begun)
    seconds, assessment = time.process_time() - begun, estimate.assessment
    assert assessment is not None
    if not assessment.findings:
        return Outcome(assessment.verdict, seconds=seconds)
    first, points = assessment.findings[0], frozenset(place)
    law = named(first.elements[0]) if first.kind == "nonlinear" else ""
    others = tuple(said(each, points) for each in assessment.findings)
    return Outcome(assessment.verdict, first.kind, frozenset(first.of) == points, law, others, seconds)


def ranked(rig: Bench, data: Spectrum | Record, place: tuple[str, str]) -> list[str]:
    """The elements that `compare --elements` ranks, the best first."""
    try:
        evidence = (
            compare_in_dwells(rig.linear, data)
            if isinstance(data, Spectrum)
            else compare_in_records(rig.linear, [data])
        )
    except DashpotError as error:
        return [f"refused: {error}"]
    names = []
    for each in evidence.ranked:
        parts = [
            named(e)
            + ("" if points_of(e, rig.linear) in (place, place[::-1]) else " at " + " ".join(e.along))
            for e in each.elements
        ]
        names.append(" + ".join(parts))
    return names


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, default=1)
    options.add_argument("--first", type=int, default=0, help="the first seed")
    options.add_argument("--laws", default=";".join(LAWS), help="separated by ;")
    options.add_argument("--tests", default=",".join(TESTS))
    options.add_argument("--rigs", default="0,1,2,3")
    options.add_argument("--noise", default="0.003,0.01,0.03")
    options.add_argument("--elements", action="store_true", help="rank elements as well")
    options.add_argument("--verbose", action="store_true", help="what was said of each case")
    given = options.parse_args()
    for test in given.tests.split(","):
        for name in given.laws.split(";"):
            counts, instead = Counter[str](), Counter[str]()
            for number in map(int, given.rigs.split(",")):
                for noise in map(float, given.noise.split(",")):
                    for seed in range(given.first, given.first + given.seeds):
                        case(test, name, number, noise, seed, counts, instead, given)
            print(line(test, name, counts, instead), flush=True)


def case(
    test: str, name: str, number: int, noise: float, seed: int, counts: Counter[str], instead: Counter[str],
    given: argparse.Namespace,
) -> None:  # fmt: skip
    """One rig and test, into the counts."""
    law, rig, place = LAWS[name], bench(number, LAWS[name]), PLACES[number]
    data = TESTS[test](rig, law, noise, seed)
    outcome = diagnosed(rig, data, place)
    true = named(rig.model.elements[-1])
    counts["cases"] += 1
    counts["time"] += round(1e3 * outcome.seconds)
    refused = outcome.verdict in ("does not fit", "refused")
    counts["refused"] += refused
    counts["place"] += outcome.kind == "nonlinear" and outcome.right_place
    counts["law"] += outcome.kind == "nonlinear" and outcome.right_place and outcome.law == true
    first = outcome.others[0] if outcome.others else outcome.kind if refused else ""
    if first != true and (refused or name == "linear"):
        instead[first or outcome.verdict] += 1
    order: list[str] = []
    if given.elements and name != "linear":
        order = ranked(rig, data, place)
        counts["ranked"] += order[:1] == [true]
    if given.verbose:
        print(f"  {test}, {name}, rig {number}, {noise}, seed {seed}: {outcome.verdict}: {list(outcome.others)} "
              f"{order} {outcome.seconds:.1f} s", flush=True)  # fmt: skip


def line(test: str, name: str, counts: Counter[str], instead: Counter[str]) -> str:
    """A row of the table."""
    shown = ["refused", "place", "law", *(["ranked"] if counts["ranked"] else [])]
    cells = " ".join(f"{key} {counts[key]}" for key in shown)
    others = ", ".join(f"{what} {count}" for what, count in instead.most_common(6))
    seconds = counts["time"] / 1e3 / counts["cases"]
    return f"{test}, {name}: of {counts['cases']} {cells}; {seconds:.1f} s; instead: {others}"


if __name__ == "__main__":
    main()
