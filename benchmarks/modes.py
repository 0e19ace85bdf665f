"""Modes of the same records by dashpot, pyOMA-2 and sdypy-EMA: error, intervals, time, and what was chosen by hand.

`python3 dev.py bench modes [--draws N] [--alone N] [--case NAME] [--rigs N [--first SEED] [--rows FILE]]`.
Systems of known modes (`tests/unit/free/bench.py`) under one random force up to 35 Hz, 100 s at 100 samples a second,
2 % noise on three accelerometers.

- dashpot gets the record and the name of the input; order, band and poles it finds.
- pyOMA-2 gets the record: stochastic subspace identification of the outputs (`cov`, its default of 20 block rows), and
  with the force (`IOcov`, 60 block rows); and the true frequencies, near which a user would pick poles.
- sdypy-EMA gets frequency responses (H1, Hann windows of 20 or 50 s with half overlap), a band, an order of 60, and
  the true frequencies, near which it picks poles, or we do, at the highest order.

`--alone N`: N more draws by dashpot alone, for the coverage of its intervals.  `--rigs N`: dashpot alone on N random
systems of two to eight modes (2 to 16 Hz, ζ 0.1 to 10 %; in half of them a pair 2 % apart with ζ of 1 % or less),
three to five accelerometers, 1 to 5 % noise, by kinds of test in turn; errors are compared with the Cramér-Rao bound
of the same lines with the noise known, as well.  `--rows FILE`: each draw is added to the file as it ends, draws
that it has are not made again, and the table is of all of them.  The peers are not among dashpot's
requirements: `pip install pyOMA-2 sdypy-EMA`; those that are missing are left out, and said to be.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import json
import logging
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

import dashpot
from dashpot.channel import Channel, Quantity
from dashpot.data.record import Record
from dashpot.errors import DataError
from dashpot.free.modes import RESIDUAL_POWERS, _Set, _solved
from dashpot.free.response import record_lines
from tests.unit.free.bench import FINER, RATE, Bench

SECONDS = 100.0
NOISE = 0.02
CASES = {
    "two modes": Bench((4.0, 9.0), (0.01, 0.02), 3),
    "a pair 2 % apart": Bench((4.0, 4.08, 9.0), (0.005, 0.005, 0.02), 3),
    "damping 0.1 to 10 %": Bench((3.0, 7.0, 12.0), (0.001, 0.1, 0.01), 3),
}
NEAR = 0.01  # of a frequency: a mode within it is found


@dataclass(frozen=True)
class Found:
    """Frequencies, damping ratios and shapes (modes, points), standard deviations where there are some."""

    frequency_hz: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    frequency_sd: np.ndarray | None = None
    damping_sd: np.ndarray | None = None
    shape_sd: np.ndarray | None = None


def by_dashpot(record: Record, bench: Bench) -> Found:
    found = dashpot.modes(record, "u0")
    return Found(
        found.frequency_hz,
        found.damping_ratio,
        found.shapes,
        found.frequency_sd,
        found.damping_sd,
        found.shape_sd,
    )


def by_pyoma(method: str, rows: int) -> Callable[[Record, Bench], Found]:
    def identified(record: Record, bench: Bench) -> Found:
        from pyoma2.algorithms import SSI
        from pyoma2.setup import SingleSetup

        setup = SingleSetup(np.array(record.values[:, 1:]), RATE)
        inputs = {"U": np.array(record.values[:, :1])} if method == "IOcov" else {}
        algorithm = SSI(name="ssi", method=method, br=rows, ordmax=40, **inputs)
        setup.add_algorithms(algorithm)
        setup.run_by_name("ssi")
        setup.mpe("ssi", sel_freq=list(bench.frequency_hz), order_in="find_min")
        result = setup["ssi"].result
        return Found(np.array(result.Fn), np.array(result.Xi), np.array(result.Phi).T)

    return identified


def by_sdypy(record: Record, bench: Bench, window: float, at_highest: bool) -> Found:
    from sdypy import EMA

    settings = {"fs": RATE, "window": "hann", "nperseg": round(window * RATE)}
    force, outputs = record.values[:, 0], record.values[:, 1:].T
    hz, cross = signal.csd(force[None], outputs, **settings)
    _, power = signal.welch(force, **settings)
    model = EMA.Model(cross / power, hz, lower=1.0, upper=20.0, pol_order_high=60, frf_form="accelerance")
    model.get_poles(show_progress=False)
    if at_highest:  # as one picks them by hand in the stabilisation chart
        hz_of, damping = np.array(model.pole_freq[-1]), np.array(model.pole_xi[-1])
        picked = [
            int(np.argmin(np.where(damping > 0, np.abs(hz_of - f), np.inf))) for f in bench.frequency_hz
        ]
        model.pole_ind = [[len(model.all_poles) - 1, pole] for pole in picked]
        frequency_hz, ratios = hz_of[picked], damping[picked]
    else:
        model.select_closest_poles(list(bench.frequency_hz), f_window=1)
        frequency_hz, ratios = np.array(model.nat_freq), np.array(model.nat_xi)
    _, constants = model.get_constants()
    return Found(frequency_hz, ratios, np.array(constants).T)


TOOLS: dict[str, tuple[str | None, Callable[[Record, Bench], Found]]] = {
    "dashpot": (None, by_dashpot),
    "pyOMA-2, outputs alone, default": ("pyoma2", by_pyoma("cov", 20)),
    "pyOMA-2, force and outputs": ("pyoma2", by_pyoma("IOcov", 60)),
    "sdypy-EMA, 20 s, its choice": ("sdypy.EMA", partial(by_sdypy, window=20.0, at_highest=False)),
    "sdypy-EMA, 50 s, order 60": ("sdypy.EMA", partial(by_sdypy, window=50.0, at_highest=True)),
}


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Without what tools print."""
    with (
        warnings.catch_warnings(),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        warnings.simplefilter("ignore")
        yield


@cache
def record_of(bench: Bench, seed: int) -> Record:
    """The record of one draw."""
    rng = np.random.default_rng(seed)
    return bench.record(bench.noise(rng, SECONDS, 1), rng, NOISE)


def true_shapes(bench: Bench) -> np.ndarray:
    """(modes, points), the largest entry 1."""
    shapes = bench.shapes[: bench.points].T
    largest = np.argmax(np.abs(shapes), axis=1)
    return shapes / shapes[np.arange(len(shapes)), largest][:, None]


def errors(found: Found, bench: Bench) -> dict[str, np.ndarray] | None:
    """Relative errors of frequencies and damping ratios, 1 − MAC, errors over standard deviations; None: not found."""
    true = np.array(bench.frequency_hz)
    if not len(found.frequency_hz) or not np.all(np.isfinite(found.frequency_hz)):
        return None
    nearest = [int(np.argmin(np.abs(found.frequency_hz - f))) for f in true]
    f, zeta = found.frequency_hz[nearest], found.damping[nearest]
    if len(set(nearest)) < len(true) or np.any(np.abs(f / true - 1) > NEAR):
        return None
    shapes, wanted = found.shapes[nearest], true_shapes(bench)
    product = np.abs(np.sum(np.conj(shapes) * wanted, axis=1)) ** 2
    mac = product / np.sum(np.abs(shapes) ** 2, axis=1) / np.sum(wanted**2, axis=1)
    each = {"frequency": f / true - 1, "damping": zeta / np.array(bench.damping) - 1, "1 - MAC": 1 - mac}
    if found.frequency_sd is not None and found.damping_sd is not None and found.shape_sd is not None:
        each["z of frequency"] = (f - true) / found.frequency_sd[nearest]
        each["z of damping"] = (zeta - np.array(bench.damping)) / found.damping_sd[nearest]
        sd = found.shape_sd[nearest]
        some = sd > 0
        each["z of shapes"] = np.concatenate([((shapes - wanted).real / np.where(some, sd, 1))[some]])
        each["z of shapes"] = np.append(each["z of shapes"], (shapes.imag / np.where(some, sd, 1))[some])
    return each


def run(name: str, bench: Bench, tool: str, draws: range) -> None:
    """Print the row of a tool."""
    module, identify = TOOLS[tool]
    rows: list[dict[str, np.ndarray]] = []
    seconds: list[float] = []
    for seed in draws:
        record = record_of(bench, seed)
        start = time.process_time()
        try:
            with _silence():
                found = identify(record, bench)
        except Exception as failure:  # of a tool that finds nothing
            if module is None:
                raise
            print(f"  {tool}: {failure}"[:110])
            continue
        seconds.append(time.process_time() - start)
        each = errors(found, bench)
        if each is not None:
            rows.append(each)
    line = f"| {name} | {tool} | {len(rows)} of {len(draws)} |"
    if rows:
        for part in ("frequency", "damping"):
            line += f" {100 * np.sqrt(np.mean([row[part] ** 2 for row in rows])):.3g} |"
        line += f" {np.mean([row['1 - MAC'] for row in rows]):.2g} |"
        for part in ("z of frequency", "z of damping", "z of shapes"):
            held = [np.abs(row[part]) < 1.96 for row in rows if part in row]
            line += f" {100 * np.mean(np.concatenate(held)):.1f} |" if held else " – |"
        line += f" {np.median(seconds):.2g} |"
    print(line, flush=True)


# Random systems, by kinds of test in turn.

KINDS = ("random force", "base motion", "two forces, two records", "hammer", "free decays", "responses")


def drawn(rng: np.random.Generator) -> Bench:
    """A random system."""
    n, pair = int(rng.integers(2, 9)), bool(rng.integers(2))
    hz = np.sort(rng.uniform(2, 16, n))
    while np.min(np.diff(hz) / hz[:-1]) < 0.06:
        hz = np.sort(rng.uniform(2, 16, n))
    damping = 10 ** rng.uniform(-3, -1, n)
    if pair:
        k = int(rng.integers(n - 1))
        hz[k + 1] = 1.02 * hz[k]
        damping[k : k + 2] = 10 ** rng.uniform(-3, -2, 2)
    order = np.argsort(hz)
    return Bench(tuple(hz[order]), tuple(damping[order]), min(max(n, 3), 5))


def periodic_part(
    bench: Bench, rng: np.random.Generator, noise: float, inputs: int, kind: Quantity = Quantity.FORCE
) -> Record:
    """100 s of random inputs with a period of more than 700 s, 0.1 to 35 Hz, and what they do: exact.

    Forces, or the acceleration of a base that moves the modes as a force at the first point would.
    """
    samples = round(SECONDS * RATE)
    period = 7 * samples + 13
    hz = np.fft.rfftfreq(period, 1 / RATE)
    inside = ((hz > 0.1) & (hz < 35))[:, None]
    U = inside * (rng.normal(size=(len(hz), inputs)) + 1j * rng.normal(size=(len(hz), inputs)))
    H = bench.accelerance(hz, inputs)
    Y = np.einsum("foi,fi->fo", 1 - H if kind is Quantity.ACCELERATION else H, U)
    u, y = (np.fft.irfft(one, period, axis=0)[:samples] * period**0.5 for one in (U, Y))
    y = y + noise * np.std(y, axis=0) * rng.standard_normal(y.shape)
    names = [f"u{i}" for i in range(inputs)]
    channels = [Channel(name, {name: 1.0}, kind) for name in names]
    channels += [Channel(f"a{i}", {f"a{i}": 1.0}, Quantity.ACCELERATION) for i in range(bench.points)]
    return Record(tuple(channels), np.arange(samples) / RATE, np.column_stack([u, y]))


def records_of(kind: str, bench: Bench, rng: np.random.Generator, noise: float) -> list[Record]:
    """The records of one test."""
    if kind == "two forces, two records":
        return [periodic_part(bench, rng, noise, 2) for _ in range(2)]
    if kind == "hammer":  # smooth blows of 20 ms, some 20 s apart
        t = np.arange(round(SECONDS * RATE * FINER)) / (RATE * FINER)
        at = np.arange(1.0, SECONDS - 10, 20) + rng.uniform(0, 5, len(np.arange(1.0, SECONDS - 10, 20)))
        force = sum(np.exp(-(((t - one) / 0.02) ** 2)) for one in at)
        return [bench.record(np.reshape(force, (-1, 1)), rng, noise)]
    if kind == "free decays":
        n = len(bench.damping)
        state = np.concatenate([rng.normal(size=n) / bench.omega, rng.normal(size=n)])
        still = np.zeros((round(SECONDS * RATE * FINER), 0))
        return [bench.record(still, rng, noise, state, shift=True)]
    moved = Quantity.ACCELERATION if kind == "base motion" else Quantity.FORCE
    return [periodic_part(bench, rng, noise, 1, moved)]


def bound(
    bench: Bench, records: list[Record], nu: int, levels: list[np.ndarray], band: tuple[float, float]
) -> np.ndarray:
    """Least standard deviations of frequencies and damping ratios (modes, 2), white noise of the outputs known.

    levels: of each record the standard deviation of a sample of each output's noise.
    """
    sets, unit = [], 2 * np.pi * band[1]
    for record, sd in zip(records, levels, strict=True):
        lines = record_lines(record, nu)
        inside = (lines.frequency_hz >= band[0]) & (lines.frequency_hz <= band[1])
        level = np.diag(4 * sd**2).astype(complex)
        noise = np.broadcast_to(level, (int(np.sum(inside)), *level.shape))
        U, Y = lines.inputs[inside], lines.outputs[inside]
        sets.append(_Set(lines.frequency_hz[inside], U, Y, noise, lines.duration_s / lines.samples, unit))
    zeta = np.array(bench.damping)
    poles = bench.omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
    fit, _ = _solved(sets, poles / unit, RESIDUAL_POWERS[1], full=True)
    found = []
    for k, pole in enumerate(poles):
        V = fit.covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] * unit**2
        size = abs(pole)
        of_f = np.array([pole.real, pole.imag]) / size / (2 * np.pi)
        of_zeta = np.array([-(pole.imag**2), pole.real * pole.imag]) / size**3
        found.append([(g @ V @ g) ** 0.5 for g in (of_f, of_zeta)])
    return np.array(found)


def one_rig(seed: int) -> dict[str, Any]:
    """What one draw gives: a row of figures for each mode that was found."""
    rng, kind = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    bench, noise = drawn(rng), float(rng.uniform(0.01, 0.05))
    tests = records_of(kind, bench, rng, noise)
    inputs = [c.name for c in tests[0].channels if c.name.startswith("u")]
    start = time.process_time()
    given: Any = dashpot.frf(tests, inputs) if kind == "responses" else tests
    try:
        found = dashpot.modes(given, inputs)
    except DataError:  # no mode at all
        of, seconds = len(bench.frequency_hz), time.process_time() - start
        return {"seed": seed, "kind": kind, "of": of, "more": 0, "seconds": seconds, "modes": []}
    seconds = time.process_time() - start
    levels = [noise * np.std(one.values[:, len(inputs) :], axis=0) / (1 + noise**2) ** 0.5 for one in tests]
    band = float(found.frequency[0]), float(found.frequency[-1])
    least = bound(bench, tests, len(inputs), levels, band)
    true, zeta, shapes = np.array(bench.frequency_hz), np.array(bench.damping), true_shapes(bench)
    away = np.abs(
        found.eigenvalues[None] / (2 * np.pi * true[:, None]) - (1j * np.sqrt(1 - zeta**2) - zeta)[:, None]
    )
    modes = []
    for k in range(len(true)):
        j = int(np.argmin(away[k]))
        if away[k, j] > max(NEAR, zeta[k] / 2):
            continue
        errors_of = np.array([found.frequency_hz[j] - true[k], found.damping_ratio[j] - zeta[k]])
        some = found.shape_sd[j] > 0
        off = (found.shapes[j] - shapes[k] / shapes[k, ~some][0])[some] / found.shape_sd[j][some]
        modes.append(
            {
                "frequency_hz": true[k],
                "damping_ratio": zeta[k],
                "z": (errors_of / [found.frequency_sd[j], found.damping_sd[j]]).tolist(),
                "over_bound": (errors_of / least[k]).tolist(),
                "z_shape": [*off.real.tolist(), *off.imag.tolist()],
            }
        )
    more = max(0, len(found.frequency_hz) - len(true))
    return {
        "seed": seed,
        "kind": kind,
        "noise": noise,
        "of": len(true),
        "more": more,
        "seconds": seconds,
        "modes": modes,
    }


def rigs(draws: range, kept: Path | None) -> None:
    """Print a row of each kind of test, and of all."""
    rows: list[dict[str, Any]] = []
    if kept is not None and kept.exists():
        rows = [json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()]
    done = {row["seed"] for row in rows}
    for seed in draws:
        if seed in done:
            continue
        rows.append(one_rig(seed))
        if kept is not None:
            with kept.open("a", encoding="utf-8") as file:
                print(json.dumps(rows[-1]), file=file)
    print(
        "| test | modes found | held: f, ζ, shapes, % | mean error / sd | rms error / bound: f, ζ | / sd | s |"
    )
    print("|---|---|---|---|---|---|---|")
    for kind in (*KINDS, "all"):
        some = [row for row in rows if kind in (row["kind"], "all")]
        modes = [mode for row in some for mode in row["modes"]]
        if not modes:
            continue
        z, ratio = (np.array([mode[part] for mode in modes]) for part in ("z", "over_bound"))
        all_z = (z[:, 0], z[:, 1], np.concatenate([mode["z_shape"] for mode in modes]))
        held = ", ".join(f"{100 * np.mean(np.abs(one) < 1.96):.1f}" for one in all_z)
        biases = ", ".join(f"{np.mean(one):.2f}" for one in all_z)
        to_bound, of_sd = (
            ", ".join(f"{np.sqrt(np.mean(one[:, k] ** 2)):.2f}" for k in (0, 1)) for one in (ratio, z)
        )
        of, more = (sum(row[part] for row in some) for part in ("of", "more"))
        seconds = np.median([row["seconds"] for row in some])
        print(
            f"| {kind} | {len(modes)} of {of}, {more} more | {held} | {biases} | {to_bound} | {of_sd} "
            f"| {seconds:.2g} |",
            flush=True,
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--alone", type=int, default=0)
    parser.add_argument("--case", choices=list(CASES), help="this one alone")
    parser.add_argument("--rigs", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="seed of the first of them")
    parser.add_argument("--rows", type=Path, help="file that keeps them")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    if options.rigs:
        rigs(range(options.first, options.first + options.rigs), options.rows)
        return
    missing = []
    for tool, (module, _) in TOOLS.items():
        try:
            importlib.import_module(module or "dashpot")
        except ImportError:
            missing.append(tool)
    for tool in missing:
        print(f"{tool}: not installed, left out (pip install pyOMA-2 sdypy-EMA)")
    print(
        "| case | tool | all modes found | frequency, % | damping, % | 1 − MAC | held: f | ζ | shapes, % | s |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name, bench in CASES.items():
        if options.case not in (None, name):
            continue
        for tool in TOOLS:
            if tool not in missing:
                run(name, bench, tool, range(options.draws))
        if options.alone:
            run(name, bench, "dashpot", range(1000, 1000 + options.alone))


if __name__ == "__main__":
    main()
